"""What surrounds the search for flow, by compiled loops and by OpenCV."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from oppload_cli.motion import sampling
from oppload_cli.motion.parameters import RmoParams
from oppload_cli.motion.sampling import Cells, reduce, sampled
from oppload_cli.native.library import library


@pytest.mark.parametrize("reduction", [1, 2, 4])
@pytest.mark.parametrize("shape", [(60, 106), (1, 1), (17, 31)])
def test_reducing_rounds_as_opencv_does(reduction: int, shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(reduction)
    size = tuple(side * reduction for side in shape)
    wider = rng.integers(0, 256, (size[0], size[1] + 5)).astype(np.uint8)
    wider[: size[0] // 2] //= 64  # sums of few values: many halves
    frame = wider[:, 2 : 2 + size[1]]
    out = np.empty(shape, np.uint8)
    reduce(frame, reduction, out)
    expected = cv2.resize(
        np.ascontiguousarray(frame), shape[::-1], interpolation=cv2.INTER_AREA
    ).reshape(shape)
    np.testing.assert_array_equal(out, expected)
    means = frame.reshape(shape[0], reduction, shape[1], reduction).mean(axis=(1, 3))
    assert np.abs(out - means).max() <= 0.5


@pytest.mark.parametrize(
    ("shape", "cells"),
    [
        ((60, 106), (17, 30)),
        ((61, 107), (17, 30)),
        ((60, 106), (15, 30)),
        ((33, 41), (32, 41)),
        ((16, 50), (1, 3)),
        ((60, 105), (15, 35)),  # whole cells
        ((20, 30), (25, 29)),  # more rows of cells than of samples
    ],
)
def test_sampling_has_the_bits_of_opencv(shape: tuple[int, int], cells: tuple[int, int]) -> None:
    rng = np.random.default_rng(shape[0])
    before, now = rng.integers(0, 9, (2, *shape)).astype(np.uint8)
    now[:, : shape[1] // 3] = before[:, : shape[1] // 3]
    flow = rng.normal(0.3, 1, (*shape, 2)).astype(np.float32)
    grid, params = Cells(*cells, 4, 24, 8), RmoParams(minimum_speed=0.5)
    found = sampled(before, now, flow, grid, params)
    expected = sampling._portable(before, now, flow, grid, params)
    assert 0 < len(expected.vectors) < cells[0] * cells[1]
    np.testing.assert_array_equal(found.starts, expected.starts)
    np.testing.assert_array_equal(found.vectors, expected.vectors)


def test_sampling_averages_over_the_area_of_a_cell() -> None:
    """Cells of 2.5 by 1.5 samples; a flow that grows along x has its value at their centres."""
    before, now = np.zeros((6, 10), np.uint8), np.full((6, 10), 9, np.uint8)
    flow = np.zeros((6, 10, 2), np.float32)
    flow[..., 0] = np.arange(10) + 1
    motion = sampled(before, now, flow, Cells(4, 4, 2, 100, 50), RmoParams())
    np.testing.assert_allclose(motion.starts[:4, 0], 100 + np.array([2.0, 7.0, 12.0, 17.0]))
    np.testing.assert_allclose(motion.starts[::4, 1], 50 + np.array([1.0, 4.0, 7.0, 10.0]))
    weights = [[1, 1, 0.5], [0.5, 1, 1], [1, 1, 0.5], [0.5, 1, 1]]
    samples = [[1, 2, 3], [3, 4, 5], [6, 7, 8], [8, 9, 10]]
    means = 2 * np.average(samples, axis=1, weights=weights)
    np.testing.assert_allclose(motion.vectors[:4, 0], means, rtol=1e-6)
    assert not motion.vectors[:, 1].any()


def test_the_compiled_loops_are_used_where_they_may_be(monkeypatch: pytest.MonkeyPatch) -> None:
    if not library():
        pytest.skip("portable")
    monkeypatch.setattr(sampling, "_portable", None)
    ones = np.ones((60, 106), np.uint8)
    flow = np.ones((60, 106, 2), np.float32)
    motion = sampled(0 * ones, 255 * ones, flow, Cells(17, 30, 4, 0, 0), RmoParams())
    np.testing.assert_allclose(motion.vectors, 4.0, rtol=1e-6)
