"""The flow and the motion vectors of rendered videos, whose motion is known at every pixel."""

from __future__ import annotations

from functools import cache, partial
from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest

from oppload_cli.errors import FrameError
from oppload_cli.motion.flow import DenseFlow, Flow, motion_vectors, rmo_of
from oppload_cli.motion.rmo import RmoMetrics, RmoParams

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


def flows(frames: Sequence[Image]) -> list[Flow]:
    """Return the flow of every frame after the first one, at 30 frames/s."""
    search = DenseFlow()
    first, *later = [search.step(frame, t / 30) for t, frame in enumerate(frames)]
    assert first is None
    return [flow for flow in later if flow is not None]


def vectors(before: Image, now: Image, params: RmoParams | None = None) -> MotionVectors:
    [flow] = flows([before, now])
    return motion_vectors(flow, params or RmoParams())


def measured(frames: Sequence[Image]) -> list[RmoMetrics]:
    return [rmo_of(flow, RmoParams()) for flow in flows(frames)]


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
    motion = vectors(texture(x, y), texture(x - 1, y))
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
    search = DenseFlow()
    assert search.step(grey[0], 0) is None
    from_bytes = search.step(grey[1], 1 / 30)
    assert from_bytes is not None
    [from_floats] = flows([frame.astype(np.float32) / np.float32(255) for frame in grey])
    # The means of squares are rounded to grey levels in another way.
    away = np.hypot(*np.moveaxis(from_bytes.vectors - from_floats.vectors, -1, 0))
    assert np.median(away) < 0.01
    np.testing.assert_allclose(from_bytes.change, from_floats.change, atol=1.01 / 255)
    assert rmo_of(from_bytes, RmoParams()).rom_pairs > 1000


def test_reset_starts_over() -> None:
    search = DenseFlow()
    frames = [scaled(1), scaled(1.03), shifted(3, 0)]
    first = [search.step(frame, t / 30) for t, frame in enumerate(frames)]
    search.reset()
    again = [search.step(frame, t / 30) for t, frame in enumerate(frames)]
    assert first[0] is again[0] is None
    for one, other in zip(first[1:], again[1:], strict=True):
        assert one is not None
        assert other is not None
        np.testing.assert_array_equal(one.vectors, other.vectors)
    search.reset()
    assert search.step(np.zeros((50, 60), dtype=np.float32), 0) is None


def test_a_flow_does_not_depend_on_frames_before_both_pictures() -> None:
    *_, after = flows([shifted(0, 0), shifted(30, 20), scaled(1), scaled(1.03)])
    [alone] = flows([scaled(1), scaled(1.03)])
    np.testing.assert_array_equal(after.vectors, alone.vectors)


@pytest.mark.parametrize("part", [np.s_[:, :], np.s_[:48, :48]], ids=["reduced", "as it is"])
def test_the_frame_given_may_be_overwritten(part: tuple[slice, slice]) -> None:
    before, now = (np.round(255 * scaled(by)[part]).astype(np.uint8) for by in (1, 1.03))
    search, frame = DenseFlow(), before.copy()
    search.step(frame, 0)
    frame[:] = now
    overwritten, other = search.step(frame, 1 / 30), DenseFlow()
    other.step(before, 0)
    untouched = other.step(now, 1 / 30)
    assert overwritten is not None
    assert untouched is not None
    np.testing.assert_array_equal(overwritten.vectors, untouched.vectors)


def ages(search: DenseFlow, times_s: list[float]) -> list[int]:
    """Return how many frames older the picture was with which each frame was compared."""
    found = []
    for t, time_s in enumerate(times_s):  # each frame is lighter by 20 grey levels
        if flow := search.step(np.full((32, 32), 20 * t, np.uint8), time_s):
            found.append(round(float(flow.change.mean()) * 255 / 20))
            assert flow.passed_s == pytest.approx(time_s - times_s[t - found[-1]])
    return found


@pytest.mark.parametrize(
    ("rate", "frames"),
    [(10, 1), (24, 1), (30, 1), (44, 1), (46, 2), (60, 2), (74, 2), (76, 3), (120, 4), (240, 8)],
)
def test_a_frame_is_compared_with_the_one_whose_age_is_nearest_to_an_interval(
    rate: int, frames: int
) -> None:
    """1.5 frames are 1/30 s at 45 frames/s, and 2.5 frames at 75."""
    times_s = [t / rate for t in range(12)]
    assert ages(DenseFlow(), times_s) == [min(t, frames) for t in range(1, 12)]


@pytest.mark.parametrize(
    ("interval_s", "frames"),
    [(0, [1, 1, 1, 1, 1]), (1 / 30, [1, 2, 1, 1, 1]), (0.1, [1, 2, 3, 4, 3])],
)
def test_uneven_times_and_other_intervals(interval_s: float, frames: list[int]) -> None:
    assert ages(DenseFlow(interval_s), [0.0, 0.01, 0.03, 0.07, 0.1, 0.13]) == frames


def test_rows_and_columns_beyond_the_last_square_are_left_out() -> None:
    before, now = shifted(0, 0), shifted(2, 1)
    params = RmoParams(grid=14)
    odd = vectors(before[:103, :131].copy(), now[:103, :131].copy(), params)
    even = vectors(before[:102, :130].copy(), now[:102, :130].copy(), params)
    assert len(odd.starts) == 7 * 9
    np.testing.assert_array_equal(odd.vectors, even.vectors)


def test_the_search_has_the_measured_settings() -> None:
    """Patches of 8 samples every 4 samples; the errors of growth assume them."""
    search = DenseFlow()._search
    settings = search.getFinestScale(), search.getPatchSize(), search.getPatchStride()
    assert settings == (0, 8, 4)


def test_grid_and_minimum_speed() -> None:
    before, now = shifted(0, 0), shifted(1, 0)
    coarse = vectors(before, now, RmoParams(grid=40))
    np.testing.assert_allclose(np.unique(coarse.starts[:, 0]), np.arange(19.5, 320, 40))
    np.testing.assert_allclose(np.unique(coarse.starts[:, 1]), np.arange(19.5, 240, 40))
    assert len(vectors(before, now).starts) == 17 * 23
    assert len(vectors(before, now, RmoParams(minimum_speed=1.5)).starts) == 0


def test_the_grid_of_an_upright_video_is_that_of_a_lying_one() -> None:
    """The working height is the shorter side, whichever way the camera is turned."""
    upright = vectors(shifted(0, 0).T.copy(), shifted(1, 0).T.copy())
    assert len(upright.starts) == 17 * 23


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
        DenseFlow().step(frame, 0)


def test_frames_of_two_sizes() -> None:
    flow = DenseFlow()
    flow.step(np.zeros((40, 60), dtype=np.float32), 0)
    with pytest.raises(FrameError, match=r"shape \(60, 40\) after one of \(40, 60\)"):
        flow.step(np.zeros((60, 40), dtype=np.float32), 1)


def test_sampling_averages_over_the_area_of_a_cell() -> None:
    """Cells of 2.5 by 7/3 samples of 4 px; the motion grows along x and along y."""
    motion = np.zeros((7, 10, 2), np.float32)
    motion[..., 0] = np.arange(10) + 1
    motion[..., 1] = 10 * np.arange(7)[:, None]
    flow = Flow(motion, np.ones((7, 10), np.float32), 4, 1 / 30)
    starts, found = motion_vectors(flow, RmoParams(grid=10))
    np.testing.assert_allclose(starts[:4, 0], [4.5, 14.5, 24.5, 34.5])
    np.testing.assert_allclose(starts[::4, 1], (np.arange(3) + 0.5) * 28 / 3 - 0.5)
    weights = [[1, 1, 0.5], [0.5, 1, 1], [1, 1, 0.5], [0.5, 1, 1]]
    samples = [[1, 2, 3], [3, 4, 5], [6, 7, 8], [8, 9, 10]]
    np.testing.assert_allclose(
        found[:4, 0], np.average(samples, axis=1, weights=weights), rtol=1e-6
    )
    # Samples 0, 1 and a third of 2; two thirds of 2, 3, two thirds of 4; and so on.
    np.testing.assert_allclose(found[::4, 1], [50 / 7, 30, 370 / 7], rtol=1e-5)


@pytest.mark.parametrize(("speed", "change", "kept"), [(2, 1, 6), (2.01, 1, 0), (2, 1.01, 0)])
def test_cells_at_the_minimum_are_kept(speed: float, change: float, kept: int) -> None:
    """All samples change by a grey level and move by 2 px."""
    motion = np.zeros((8, 12, 2), np.float32)
    motion[..., 1] = 2
    flow = Flow(motion, np.full((8, 12), 1 / 255, np.float32), 4, 1 / 30)
    least = RmoParams(grid=16, minimum_speed=speed, minimum_change=change / 255)
    starts, found = motion_vectors(flow, least)
    assert len(starts) == len(found) == kept
