"""Motion vectors of rendered videos, whose motion is known at every pixel."""

from __future__ import annotations

from functools import cache, partial
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import pytest

from oppload_cli.errors import FrameError
from oppload_cli.motion.flow import Cells, DenseFlow, sampled
from oppload_cli.motion.rmo import RmoMetrics, RmoParams, rmo_metrics

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from oppload_cli.motion.flow import MotionVectors

pytestmark = pytest.mark.once

HEIGHT, WIDTH = 240, 320
CENTRE = (170.0, 110.0)

Image = np.ndarray[tuple[int, ...], np.dtype[np.float32]]
Plane = np.ndarray[tuple[int, ...], np.dtype[np.float64]]


def pixels(height: int = HEIGHT, width: int = WIDTH) -> tuple[Plane, Plane]:
    y, x = np.mgrid[:height, :width].astype(np.float64)
    return x, y


def texture(x: Plane, y: Plane) -> Image:
    """Return a sum of gratings, which can be evaluated anywhere."""
    random = np.random.default_rng(4)
    total = np.zeros(x.shape)
    for _ in range(40):
        frequency, angle = 2 * np.pi / random.uniform(12, 80), random.uniform(0, 2 * np.pi)
        along = x * np.cos(angle) + y * np.sin(angle)
        total += np.cos(frequency * along + random.uniform(0, 2 * np.pi))
    return np.clip(0.5 + 0.05 * total, 0, 1).astype(np.float32)


def disk(centre: tuple[float, float], radius: float) -> Image:
    x, y = pixels()
    inside = np.clip(radius + 0.5 - np.hypot(x - centre[0], y - centre[1]), 0, 1)
    return (0.9 - 0.8 * inside).astype(np.float32)


@cache
def scaled(factor: float) -> Image:
    x, y = pixels()
    return texture(CENTRE[0] + (x - CENTRE[0]) / factor, CENTRE[1] + (y - CENTRE[1]) / factor)


@cache
def turned(angle: float) -> Image:
    x, y = pixels()
    right, down = x - CENTRE[0], y - CENTRE[1]
    cosine, sine = np.cos(angle), np.sin(angle)
    return texture(
        CENTRE[0] + cosine * right + sine * down, CENTRE[1] - sine * right + cosine * down
    )


@cache
def shifted(right: float, down: float) -> Image:
    x, y = pixels()
    return texture(x - right, y - down)


def vectors(before: Image, now: Image, params: RmoParams | None = None) -> MotionVectors:
    flow = DenseFlow(params)
    assert flow.motion(before) is None
    motion = flow.motion(now)
    assert motion is not None
    return motion


def measured(frames: Sequence[Image], params: RmoParams | None = None) -> list[RmoMetrics]:
    flow = DenseFlow(params)
    assert flow.step(frames[0]) is None
    return [metrics for frame in frames[1:] if (metrics := flow.step(frame)) is not None]


def away_from_border(motion: MotionVectors) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    x, y = motion.starts[:, 0], motion.starts[:, 1]
    return (x > 20) & (x < WIDTH - 20) & (y > 20) & (y < HEIGHT - 20)


@pytest.mark.parametrize("velocity", [(1.6, -1.2), (0.4, 0.3), (-4.0, 3.0), (0.0, 8.0)])
def test_vectors_of_a_pan(velocity: tuple[float, float]) -> None:
    motion = vectors(shifted(0, 0), shifted(*velocity))
    inside = motion.vectors[away_from_border(motion)]
    assert len(inside) > 250
    error = np.hypot(*(inside - velocity).T)
    assert np.median(error) < 0.15
    assert np.percentile(error, 95) < 0.3


@pytest.mark.parametrize("factor", [1.02, 1.05, 1 / 1.02])
def test_vectors_of_a_zoom(factor: float) -> None:
    motion = vectors(scaled(1), scaled(factor))
    inside = away_from_border(motion)
    expected = (factor - 1) * (motion.starts[inside] - CENTRE)
    error = np.hypot(*(motion.vectors[inside] - expected).T)
    assert np.median(error) < 0.4
    assert np.median(error) < 0.12 * np.median(np.hypot(*expected.T))


@pytest.mark.parametrize(
    ("now", "low", "high"),
    [
        (partial(scaled, 1.03), 0.95, 1.0),
        (partial(scaled, 1 / 1.03), -1.0, -0.95),
        (partial(turned, 0.03), -0.05, 0.05),
        (partial(turned, -0.03), -0.05, 0.05),
        (partial(shifted, 2, 1), 0.0, 0.0),
        (partial(shifted, 0, 0), 0.0, 0.0),
    ],
    ids=["expansion", "contraction", "rotation", "other rotation", "pan", "still"],
)
def test_index_of_a_moving_texture(now: Callable[[], Image], low: float, high: float) -> None:
    (metrics,) = measured([scaled(1), now()])
    assert low <= metrics.rmo_index <= high


def test_index_of_a_looming_receding_and_translating_disk() -> None:
    radii = [12 + 2.0 * frame for frame in range(30)]
    looming = measured([disk((160, 120), radius) for radius in radii])
    receding = measured([disk((160, 120), radius) for radius in reversed(radii)])
    translating = measured([disk((60 + 2.0 * frame, 100 + frame), 30) for frame in range(30)])
    assert min(metrics.rmo_index for metrics in looming) >= 0.85
    assert max(metrics.rmo_index for metrics in receding) <= -0.85
    assert max(abs(metrics.rmo_index) for metrics in translating) <= 0.1
    assert min(metrics.rom_pairs for metrics in looming) > max(
        metrics.rom_pairs for metrics in [*receding, *translating]
    )
    assert min(metrics.rmo_mean for metrics in looming) > 0.6


@pytest.mark.parametrize("level", [0.0, 0.37, 1.0])
def test_flat_video_gives_zeros(level: float) -> None:
    frames = [np.full((HEIGHT, WIDTH), level, dtype=np.float32)] * 3
    assert measured(frames) == [RmoMetrics()] * 2


def test_uniform_flicker_is_not_motion_in_opposite_directions() -> None:
    frames = [np.full((HEIGHT, WIDTH), level, dtype=np.float32) for level in (0.2, 0.8, 0.1)]
    assert measured(frames) == [RmoMetrics()] * 2


@pytest.mark.parametrize(
    "shape", [(1, 1), (8, 8), (15, 15), (1, 300), (300, 1), (12, 200), (16, 16), (17, 90), (63, 65)]
)
def test_small_frames_do_not_fail(shape: tuple[int, int]) -> None:
    random = np.random.default_rng(0)
    frames = [random.random(shape, dtype=np.float32) for _ in range(4)]
    results = measured(frames)
    assert len(results) == 3
    if min(shape) < 16:
        assert results == [RmoMetrics()] * 3


def test_small_frames_are_reduced_less_and_have_vectors_every_4_px() -> None:
    x, y = pixels(48, 48)
    flow = DenseFlow()
    flow.motion(texture(x, y))
    motion = flow.motion(texture(x - 1, y))
    assert motion is not None
    assert len(motion.vectors) > 100
    assert np.diff(np.unique(motion.starts[:, 0])).min() == 4
    assert np.median(motion.vectors[:, 0]) == pytest.approx(1.0, abs=0.15)


@pytest.fixture
def restored_threads() -> Iterator[None]:
    threads = cv2.getNumThreads()
    yield
    cv2.setNumThreads(threads)


@pytest.mark.usefixtures("restored_threads")
def test_the_number_of_threads_changes_nothing() -> None:
    random = np.random.default_rng(2)
    noisy = [
        frame + random.normal(0, 0.03, frame.shape).astype(np.float32)
        for frame in (scaled(1), scaled(1.04), turned(0.05), shifted(7, -5))
    ]
    frames = [np.clip(frame, 0, 1) for frame in noisy]
    results = []
    for threads in (1, 2, 4):
        cv2.setNumThreads(threads)
        results.append(measured(frames))
    assert results[0] == results[1] == results[2]
    assert results[0][0].flow_vectors > 300


def test_bytes_and_floats_give_the_same() -> None:
    grey = [np.round(frame * 255).astype(np.uint8) for frame in (scaled(1), scaled(1.03))]
    floats = [frame.astype(np.float32) / np.float32(255) for frame in grey]
    flow = DenseFlow()
    from_bytes = [flow.step(frame) for frame in grey]
    assert from_bytes[1:] == measured(floats)
    assert from_bytes[1] is not None
    assert from_bytes[1].rom_pairs > 1000


def test_reset_starts_over() -> None:
    frames = [scaled(1), scaled(1.03), shifted(3, 0)]
    flow = DenseFlow()
    first = [flow.step(frame) for frame in frames]
    flow.reset()
    assert [flow.step(frame) for frame in frames] == first
    flow.reset()
    assert flow.step(np.zeros((50, 60), dtype=np.float32)) is None


def test_a_frame_does_not_depend_on_those_before_the_last() -> None:
    flow = DenseFlow()
    for frame in (shifted(0, 0), shifted(30, 20), scaled(1)):
        flow.step(frame)
    assert [flow.step(scaled(1.03))] == measured([scaled(1), scaled(1.03)])


def test_the_frame_given_may_be_overwritten() -> None:
    """A disk of 6 px is seen at a finer resolution, for which the flow keeps the frame itself."""
    grey: list[Any] = [
        np.round(255 * disk((160, 120), radius)).astype(np.uint8) for radius in (6, 7)
    ]
    for before, now in ((scaled(1), scaled(1.03)), grey):
        flow, frame = DenseFlow(), before.copy()
        flow.step(frame)
        frame[:] = now
        assert [flow.step(frame)] == measured([before, now])


def test_rows_and_columns_beyond_the_last_square_are_left_out() -> None:
    before, now = shifted(0, 0), shifted(2, 1)
    params = RmoParams(grid=14)
    odd = vectors(before[:103, :130].copy(), now[:103, :130].copy(), params)
    even = vectors(before[:100, :128].copy(), now[:100, :128].copy(), params)
    assert len(odd.starts) == 7 * 9
    np.testing.assert_array_equal(odd.vectors, even.vectors)


def test_the_search_has_the_measured_settings() -> None:
    """Patches of 8 px every 6 px; ``docs/rmo.md`` links to the measurement."""
    flow = DenseFlow()
    flow.step(shifted(0, 0))
    search = flow._search
    settings = search.getFinestScale(), search.getPatchSize(), search.getPatchStride()
    assert settings == (0, 8, 6)


def test_grid_and_minimum_speed() -> None:
    before, now = shifted(0, 0), shifted(1, 0)
    coarse = vectors(before, now, RmoParams(grid=40))
    np.testing.assert_allclose(np.unique(coarse.starts[:, 0]), np.arange(19.5, 320, 40))
    np.testing.assert_allclose(np.unique(coarse.starts[:, 1]), np.arange(19.5, 240, 40))
    assert len(vectors(before, now).starts) == 17 * 23
    assert len(vectors(before, now, RmoParams(minimum_speed=1.5)).starts) == 0


def test_motion_in_a_small_part_is_seen_at_a_finer_resolution() -> None:
    """A disk of 6 px, less than half a cell of the complete frame's grid, has vectors around it."""
    before, now = disk((160, 120), 6), disk((160, 120), 7)
    motion = vectors(before, now)
    away = motion.starts - (159.5, 119.5)
    assert len(motion.starts) >= 8
    assert np.hypot(*away.T).max() < 16
    assert (np.einsum("ij,ij->i", away, motion.vectors) > 0).all()
    metrics = rmo_metrics(motion.starts, motion.vectors)
    assert metrics.rom_pairs >= 4
    assert metrics.rmo_index == 1


def test_the_grid_of_an_upright_video_is_that_of_a_lying_one() -> None:
    """The working height is the shorter side, whichever way the camera is turned."""
    upright = vectors(shifted(0, 0).T.copy(), shifted(1, 0).T.copy())
    assert len(upright.starts) == 17 * 23


@pytest.mark.parametrize(("radius", "spacing"), [(34, 7.07), (38, 320 / 23)])
def test_a_part_is_seen_at_the_finest_resolution_that_costs_half(
    radius: int, spacing: float
) -> None:
    """A square of 98 px at half its size costs as much as half of the frame at a quarter."""
    motion = vectors(disk((160, 120), radius), disk((160, 120), radius + 2))
    steps = np.diff(np.unique(motion.starts[:, 0].round(3)))
    assert steps.min() == pytest.approx(spacing, abs=0.02)


def test_a_part_has_sixteen_samples_and_a_margin_on_each_side() -> None:
    flow = DenseFlow()
    flow.step(np.zeros((240, 320), np.float32))
    for extent, left, right in ((10, 3, 3), (11, 3, 3), (12, 2, 2), (30, 2, 2)):
        part = flow._with_margin(20, extent, 80)
        assert part == slice(4 * (20 - left), 4 * (20 + extent + right))
    assert flow._with_margin(1, 78, 80) == slice(0, 320)


def test_minimum_change_drops_vectors_that_the_search_guessed() -> None:
    before, now = disk((160, 120), 30), disk((160, 120), 32)
    far_away, kept = [
        float(np.hypot(*(motion.starts - (160, 120)).T).max())
        for motion in (vectors(before, now, RmoParams(minimum_change=0.0)), vectors(before, now))
    ]
    assert far_away > 50
    assert kept < 32 + 14


@pytest.mark.parametrize(
    "frame",
    [np.zeros((4, 4)), np.zeros((4, 4, 3), dtype=np.uint8), np.zeros((0, 4), dtype=np.float32)],
)
def test_not_a_luminance_image(frame: Image) -> None:
    with pytest.raises(FrameError, match="give float32 luminance"):
        DenseFlow().step(frame)


def test_frames_of_two_sizes() -> None:
    flow = DenseFlow()
    flow.step(np.zeros((40, 60), dtype=np.float32))
    with pytest.raises(FrameError, match=r"shape \(60, 40\) after one of \(40, 60\)"):
        flow.step(np.zeros((60, 40), dtype=np.float32))


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


@pytest.mark.parametrize(("speed", "change", "kept"), [(2, 1, 6), (2.01, 1, 0), (2, 1.01, 0)])
def test_cells_at_the_minimum_are_kept(speed: float, change: float, kept: int) -> None:
    """All samples change by a grey level and move by half a sample, 2 px."""
    before, now = np.zeros((7, 11), np.uint8), np.ones((7, 11), np.uint8)
    flow = np.zeros((7, 11, 2), np.float32)
    flow[..., 1] = 0.5
    least = RmoParams(minimum_speed=speed, minimum_change=change / 255)
    starts, vectors = sampled(before, now, flow, Cells(2, 3, 4, 0, 0), least)
    assert len(starts) == len(vectors) == kept
