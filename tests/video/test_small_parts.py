"""Span, working size, prefetching, repeats, camera and inputs."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import pytest

from oppload_cli.errors import ParameterError, SourceError
from oppload_cli.native import library
from oppload_cli.video.frames import InputFacts, Picture
from oppload_cli.video.inputs import result_stems, single_inputs
from oppload_cli.video.luminance import Luminance, luminance_table
from oppload_cli.video.parameters import RepeatParams
from oppload_cli.video.prefetch import Prefetch
from oppload_cli.video.repeats import Repeats
from oppload_cli.video.source import open_video
from oppload_cli.video.span import Position, Span, parse_position
from oppload_cli.video.working import WorkingSize, working_size

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path


@pytest.mark.parametrize(
    ("text", "position"),
    [
        ("f300", Position(frame=300)),
        ("12.5", Position(seconds=12.5)),
        ("00:01:02.5", Position(seconds=62.5)),
        ("2:03", Position(seconds=123)),
    ],
)
def test_positions(text: str, position: Position) -> None:
    assert parse_position(text) == position


@pytest.mark.parametrize("text", ["", "f", "x", "-1", "nan", "inf", "1:2:3:4", "f1.5"])
def test_what_is_no_position(text: str) -> None:
    with pytest.raises(ParameterError, match="is no position"):
        parse_position(text)


def test_end_and_duration_exclude_each_other() -> None:
    with pytest.raises(ParameterError, match="exclude each other"):
        Span(end=Position(frame=1), duration=Position(frame=1))


def facts(width: int, height: int) -> InputFacts:
    return InputFacts("a.mp4", "container", width, height, None, None)


@pytest.mark.parametrize(
    ("source", "height", "working"),
    [
        ((1280, 720), 240, (427, 240)),
        ((1280, 720), None, (1280, 720)),
        ((160, 120), 240, (320, 240)),
        ((10, 1000), 240, (2, 240)),
        ((1, 1000), 100, (1, 100)),
    ],
)
def test_working_size(
    source: tuple[int, int], height: int | None, working: tuple[int, int]
) -> None:
    size = working_size(facts(*source), height)
    assert (size.width, size.height) == working
    assert size.scale_x == source[0] / working[0]


def test_a_working_size_that_is_too_large() -> None:
    with pytest.raises(ParameterError, match="choose a smaller --height"):
        working_size(facts(4000, 1), 240)


def test_luminance_of_codes() -> None:
    limited, full = luminance_table(8, full_range=False), luminance_table(8, full_range=True)
    assert [limited[0], limited[16], limited[235], limited[255]] == [0, 0, 1, 1]
    assert limited[126] == pytest.approx(110 / 219)
    assert [full[0], full[51], full[255]] == [0, np.float32(51 / 255), 1]
    ten = luminance_table(10, full_range=False)
    assert [ten[64], ten[940]] == [0, 1]


@pytest.mark.parametrize("portable", [True, False])
@pytest.mark.parametrize("full_range", [True, False])
@pytest.mark.parametrize("apart", [np.s_[:, :19], np.s_[:, ::2], np.s_[::3]])
def test_every_code_has_the_luminance_of_the_table(
    portable: bool,
    full_range: bool,
    apart: tuple[slice, ...] | slice,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(library, "portable", portable)
    codes = np.arange(120 * 37).astype(np.uint8).reshape(120, 37)[apart]
    assert np.unique(codes).size == 256
    height, width = codes.shape
    convert = Luminance(WorkingSize(width, height, 1.0, 1.0), 0)
    found = convert(Picture(0, 0.0, codes, 8, full_range))
    np.testing.assert_array_equal(found, luminance_table(8, full_range)[codes])


def test_enlarging_is_allowed() -> None:
    convert = Luminance(WorkingSize(8, 8, 0.5, 0.5), 0)
    luma = convert(Picture(0, 0.0, np.full((4, 4), 255, np.uint8)))
    assert luma.shape == (8, 8)
    assert (luma == 1).all()


def test_prefetching_keeps_order_and_joins() -> None:
    before = threading.active_count()
    items = Prefetch(iter(range(20)), ahead=2)
    assert list(items) == list(range(20))
    assert list(items) == []
    items.close()
    assert threading.active_count() == before


def test_an_error_in_the_thread_is_raised_in_the_caller_after_what_came_before() -> None:
    def failing() -> Iterator[int]:
        yield 1
        raise SourceError("gone")

    items = Prefetch(failing())
    assert next(items) == 1
    with pytest.raises(SourceError, match="gone"):
        next(items)
    items.close()


def test_closing_early_joins_the_thread() -> None:
    before = threading.active_count()
    items = Prefetch(iter(range(10**9)), ahead=2)
    assert next(items) == 0
    items.close()
    items.close()
    assert threading.active_count() == before


def test_a_few_repeats_are_copies_and_many_are_a_still_scene() -> None:
    repeats = Repeats(RepeatParams(most=2))
    one, other = np.zeros((2, 2), np.float32), np.ones((2, 2), np.float32)
    shown = [one, one.copy(), other, other, other, other, one]
    answers = [repeats.step(frame) for frame in shown]
    assert answers == [
        (False, False),
        (True, True),
        (False, False),
        (True, True),
        (True, True),
        (True, False),
        (False, False),
    ]
    assert repeats.count == 4


class FakeCamera:
    """Three pictures, then nothing."""

    def __init__(self, number: int) -> None:
        self.left = 3 if number == 0 else 0
        self.released = False

    def read(self) -> tuple[bool, Any]:
        self.left -= 1
        return self.left >= 0, np.full((48, 64, 3), 255, np.uint8)

    def get(self, _property: int) -> float:
        return 30.0

    def release(self) -> None:
        self.released = True


def test_a_camera_is_a_source_like_any_other(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cv2, "VideoCapture", FakeCamera)
    with open_video("camera:0", height=24) as video:
        frames = list(video)
        assert video.facts.frame_rate == 30
        assert not video.decode.complete
    assert [frame.index for frame in frames] == [0, 1, 2]
    assert (frames[0].luma.shape, frames[0].time_s) == ((24, 32), 0)


@pytest.mark.parametrize(
    ("name", "message"), [("camera:x", "no camera's name"), ("camera:1", "gives no picture")]
)
def test_a_camera_that_is_not_there(
    monkeypatch: pytest.MonkeyPatch, name: str, message: str
) -> None:
    monkeypatch.setattr(cv2, "VideoCapture", FakeCamera)
    with pytest.raises(SourceError, match=message):
        open_video(name)


def test_a_folder_of_videos_is_each_of_them(tmp_path: Path) -> None:
    for name in ("b.mp4", "a.avi", "cover.png"):
        (tmp_path / name).touch()
    assert single_inputs(str(tmp_path)) == [str(tmp_path / "a.avi"), str(tmp_path / "b.mp4")]


def test_an_empty_folder(tmp_path: Path) -> None:
    with pytest.raises(SourceError, match="no video and no image in this folder"):
        single_inputs(str(tmp_path))


def test_stems_are_told_apart() -> None:
    names = ["x/a.mp4", "y/a.mp4", "b_%04d.png", "camera:0", "rtsp://host/cam?key=1"]
    stems = result_stems(names)
    assert stems[2:] == ["b", "camera-0", "rtsp-host-cam"]
    assert stems[0].startswith("a-")
    assert stems[0] != stems[1]
    assert len(stems[0]) == len("a-") + 8


@pytest.mark.parametrize(
    ("source", "working", "bits"),
    [
        ((1080, 1920), (240, 427), 8),
        ((97, 131), (41, 50), 8),
        ((300, 400), (240, 320), 8),
        ((270, 480), (90, 160), 10),
    ],
)
def test_shrinking_averages_areas(
    source: tuple[int, int], working: tuple[int, int], bits: int
) -> None:
    rng = np.random.default_rng(3)
    plane: Any = rng.integers(0, 2**bits, source, np.uint8 if bits == 8 else np.uint16)
    size = WorkingSize(working[1], working[0], 1.0, 1.0)
    luma = Luminance(size, 0)(Picture(0, 0.0, plane, bits=bits))
    down, across = (areas(a, b) for a, b in zip(source, working, strict=True))
    exact = down @ plane.astype(np.float64) @ across.T
    error = luma * (2**bits - 1) - exact
    assert np.abs(error).max() < (0.8 if bits == 8 else 2)
    assert abs(error.mean()) < 0.1


def areas(source: int, working: int) -> np.ndarray:
    """How much of each source pixel lies in each working pixel, in shares of the latter."""
    ends = np.arange(working + 1) * source / working
    pixels = np.arange(source)
    upper = np.minimum(ends[1:, None], pixels + 1)
    lower = np.maximum(ends[:-1, None], pixels)
    return np.asarray(np.clip(upper - lower, 0, None) * working / source)
