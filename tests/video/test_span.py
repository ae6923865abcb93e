"""Positions in an input, and the part between two of them."""

from __future__ import annotations

import math
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from oppload_cli.errors import ParameterError
from oppload_cli.frame_times import ticks
from oppload_cli.video.opening import Opening
from oppload_cli.video.source import open_video
from oppload_cli.video.span import Position, Span, parse_position
from tests.media import grey_frames, write_video

if TYPE_CHECKING:
    from pathlib import Path


@pytest.mark.parametrize(
    ("text", "position"),
    [
        ("f300", Position(frame=300)),
        ("12.5s", Position(seconds=12.5)),
        ("12.5", Position(seconds=12.5)),
        ("00:01:02.5", Position(seconds=62.5)),
        ("2:03", Position(seconds=123)),
    ],
)
def test_positions(text: str, position: Position) -> None:
    assert parse_position(text) == position


@pytest.mark.parametrize("text", ["", "f", "x", "-1", "nan", "inf", "1:2:3:4", "f1.5"])
def test_a_text_that_is_no_position(text: str) -> None:
    with pytest.raises(ParameterError, match="is no position"):
        parse_position(text)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({}, "give one of them"),
        ({"frame": 1, "seconds": 2}, "give one of them"),
        ({"frame": "a"}, "a whole number of at least 0, not 'a'"),
        ({"frame": 1.5}, "a whole number of at least 0, not 1.5"),
        ({"frame": -1}, "a whole number of at least 0, not -1"),
        ({"seconds": "1"}, "a finite number of at least 0, not '1'"),
        ({"seconds": math.nan}, "a finite number of at least 0, not nan"),
        ({"seconds": math.inf}, "a finite number of at least 0, not inf"),
        ({"seconds": -1}, "a finite number of at least 0, not -1"),
    ],
)
def test_a_wrong_position_is_refused(given: dict[str, Any], message: str) -> None:
    with pytest.raises(ParameterError, match=message):
        Position(**given)


def test_numbers_of_other_libraries_are_positions() -> None:
    frame: Any = np.int64(3)
    assert [Position(frame=frame).reached(at, 0) for at in (2, 3)] == [False, True]
    assert not Position(seconds=1e308).reached(3, 1 << 62)
    for seconds in (np.float32(0.5), Fraction(1, 2)):
        half: Any = seconds
        times = ticks(0.5) - 1, ticks(0.5)
        assert [Position(seconds=half).reached(0, at) for at in times] == [False, True]


def test_end_and_duration_exclude_each_other() -> None:
    with pytest.raises(ParameterError, match="exclude each other"):
        Span(end=Position(frame=1), duration=Position(frame=1))


def test_a_number_is_no_position() -> None:
    number: Any = 1.5
    with pytest.raises(ParameterError, match=r"such as Position\(seconds=1.5\), not 1.5"):
        Span(start=number)


def set_back(folder: Path, frames: int) -> Path:
    """Write a transport stream whose clock goes back after the first and the second part."""
    images = grey_frames(frames)
    part = write_video(folder / "part.ts", images, codec="libx264", pixel_format="yuv420p", rate=25)
    path = folder / "a.ts"
    path.write_bytes(part.read_bytes() * 3)
    return path


@pytest.mark.parametrize("own_process", [False, True])
@pytest.mark.parametrize(
    ("span", "first", "last"),
    [
        (Span(end=Position(seconds=2)), 0, 49),
        (Span(Position(seconds=2)), 50, 89),
        (Span(Position(seconds=0.4), Position(seconds=1.6)), 10, 39),
        (Span(Position(frame=65), duration=Position(seconds=0.2)), 65, 69),
    ],
)
def test_positions_count_on_where_the_clock_was_set_back(
    tmp_path: Path, span: Span, first: int, last: int, *, own_process: bool
) -> None:
    path = set_back(tmp_path, 30)
    with Opening(str(path), height=240, span=span, own_process=own_process).result() as video:
        frames = list(video)
        assert [frame.index for frame in frames] == list(range(first, last + 1))
        times = [frame.time_s for frame in frames]
        assert times == pytest.approx([t / 25 for t in range(first, last + 1)])
        assert video.times.wrong == sum(first < frame <= last for frame in (30, 31, 60, 61))


@pytest.mark.parametrize("start", [20, 21, 33, 41])
def test_a_part_has_the_times_of_the_complete_input(tmp_path: Path, start: int) -> None:
    """A shift of less than a second shrinks step by step."""
    path = set_back(tmp_path, 20)
    with open_video(path) as video:
        complete = [frame.time_s for frame in video]
    assert complete[59] == pytest.approx(59 / 25 - 0.072, abs=0.01)
    with open_video(path, span=Span(Position(frame=start))) as video:
        error = {frame.index: frame.time_s - complete[frame.index] for frame in video}
    assert set(error.values()) == {0}
