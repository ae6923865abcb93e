"""Working sizes, and luminance at these sizes."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from typing import Any

import av
import numpy as np
import pytest

from oppload_cli.errors import ParameterError
from oppload_cli.frame_times import in_digits
from oppload_cli.video.frames import (
    InputFacts,
    Picture,
    WorkingSize,
    frames_ahead,
    sizes_in_words,
)
from oppload_cli.video.luminance import Luminance, luminance_table
from oppload_cli.video.planes import Resizing, luma_plane, resized


def facts(width: int, height: int) -> InputFacts:
    return InputFacts("a.mp4", "container", width, height, None, None)


@pytest.mark.parametrize(
    ("source", "height", "working"),
    [
        ((1280, 720), 240, (427, 240)),
        ((1280, 720), None, (1280, 720)),
        ((160, 120), 240, (320, 240)),
        ((720, 1280), 240, (240, 427)),
        ((120, 160), 240, (240, 320)),
        ((10, 100), 100, (100, 1000)),
        ((1000, 333), 100, (300, 100)),
    ],
)
def test_working_size(
    source: tuple[int, int], height: int | None, working: tuple[int, int]
) -> None:
    size = WorkingSize.of(facts(*source), height)
    assert (size.width, size.height) == working
    assert size.scale_x == source[0] / working[0]
    assert size.scale_y == source[1] / working[1]


def test_sides_of_13_px_are_large_enough() -> None:
    assert [len(WorkingSize(side, 40, 1.0, 1.0).remarks()) for side in (12, 13)] == [1, 0]


def test_enlarging_by_more_than_two_and_a_half_gives_a_remark() -> None:
    small = facts(320, 240)
    assert WorkingSize.of(small, 600).remarks() == []
    [remark] = WorkingSize.of(small, 720).remarks()
    assert remark.startswith("is enlarged 3 times, to 960 x 720 px: the models see no more detail")


@pytest.mark.parametrize(
    ("size", "changes", "colour", "ahead"),
    [
        ((64, 48), {}, False, 16),
        ((640, 480), {}, False, 6),  # of 1.2 MB each in 8 MB
        ((1920, 1080), {}, False, 2),
        ((64, 48), {}, True, 2),
        ((64, 48), {"kind": "camera"}, False, 1),
        ((64, 48), {"kind": "stream"}, True, 1),
    ],
)
def test_frames_that_wait_between_threads(
    size: tuple[int, int], changes: dict[str, Any], colour: bool, ahead: int
) -> None:
    source = replace(facts(*size), **changes)
    assert frames_ahead(source, WorkingSize.of(source, None), colour=colour) == ahead


def test_sizes_and_rate_in_words() -> None:
    source = replace(facts(320, 240), frame_rate=Fraction(30000, 1001))
    text = sizes_in_words(source, WorkingSize.of(source, 120))
    assert text == "320 x 240 at 29.97 frames/s, seen at 160 x 120"
    assert [in_digits(rate) for rate in (29.97, 999.96, 12345.0)] == ["29.97", "1000", "12345"]


def test_a_working_size_that_is_too_large() -> None:
    for size in ((4000, 1), (1, 4000)):
        with pytest.raises(ParameterError, match="choose a smaller working height"):
            WorkingSize.of(facts(*size), 240)


def test_luminance_of_codes() -> None:
    limited, full = luminance_table(8, full_range=False), luminance_table(8, full_range=True)
    assert [limited[0], limited[16], limited[235], limited[255]] == [0, 0, 1, 1]
    assert limited[126] == pytest.approx(110 / 219)
    assert [full[0], full[51], full[255]] == [0, np.float32(51 / 255), 1]
    ten = luminance_table(10, full_range=False)
    assert [ten[64], ten[940]] == [0, 1]


@pytest.mark.parametrize("full_range", [True, False])
@pytest.mark.parametrize("part", [np.s_[:, :19], np.s_[:, ::2], np.s_[::3]])
def test_every_code_has_the_luminance_of_the_table(
    full_range: bool, part: tuple[slice, ...] | slice
) -> None:
    codes = np.arange(120 * 37).astype(np.uint8).reshape(120, 37)[part]
    assert np.unique(codes).size == 256
    height, width = codes.shape
    convert = Luminance(WorkingSize(width, height, 1.0, 1.0))
    found = convert(Picture(0, 0, codes, 8, full_range))
    np.testing.assert_array_equal(found, luminance_table(8, full_range)[codes])


def test_enlarging_is_allowed() -> None:
    convert = Luminance(WorkingSize(8, 8, 0.5, 0.5))
    luma = convert(Picture(0, 0, np.full((4, 4), 255, np.uint8)))
    assert luma.shape == (8, 8)
    assert (luma == 1).all()


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
    luma = Luminance(size)(Picture(0, 0, plane, bits=bits))
    down, across = (areas(a, b) for a, b in zip(source, working, strict=True))
    exact = down @ plane.astype(np.float64) @ across.T
    error = luma * (2**bits - 1) - exact
    assert np.abs(error).max() < (0.8 if bits == 8 else 2)
    assert abs(error.mean()) < 0.1


def test_a_side_that_is_hardly_reduced_is_averaged_by_opencv() -> None:
    """swscale averages well from a reduction of both sides by 1.5 on."""
    plane = np.random.default_rng(4).integers(0, 256, (90, 60), np.uint8)
    for size in ((20, 88), (58, 20)):
        np.testing.assert_array_equal(Resizing(*size)(plane), resized(plane, size))


def test_the_samples_of_p010_are_the_highest_bits_of_16() -> None:
    grey = np.arange(0, 256, 4, dtype=np.uint8).reshape(8, 8)
    deep = av.VideoFrame.from_ndarray(grey, "gray").reformat(format="yuv420p10le")
    (ten, few), (high, many) = (luma_plane(each) for each in (deep, deep.reformat(format="p010le")))
    assert (few, many) == (10, 16)
    np.testing.assert_array_equal(high, ten.astype(np.uint16) << 6)


def areas(source: int, working: int) -> np.ndarray:
    """Return the share of each working pixel that each source pixel covers."""
    ends = np.arange(working + 1) * source / working
    pixels = np.arange(source)
    upper = np.minimum(ends[1:, None], pixels + 1)
    lower = np.maximum(ends[:-1, None], pixels)
    return np.asarray(np.clip(upper - lower, 0, None) * working / source)
