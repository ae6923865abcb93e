from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest

from oppload_cli.detection.growth import SIDE, Growth, Products, Pyramid, growth
from oppload_cli.models.detector import UnitMaps
from tests.media import disk

if TYPE_CHECKING:
    from tests.media import Luma

WIDTH, HEIGHT = 320, 240
REGION = 150.0, 110.0, 60.0, 50.0


def patterned(scale: float, x: float = 150, y: float = 110, turn: float = 0.0) -> Luma:
    """A pattern at a scale, turned about a place that is at (150, 110) of the pattern."""
    right, below = (np.arange(WIDTH) + 0.5 - x)[None, :], (np.arange(HEIGHT) + 0.5 - y)[:, None]
    across = (right * np.cos(turn) + below * np.sin(turn)) / scale
    down = (below * np.cos(turn) - right * np.sin(turn)) / scale
    waves = np.sin(across / 6 + 1) + np.cos(down / 8) + np.sin((across + 2 * down) / 15)
    return np.asarray(0.5 + 0.15 * waves, np.float32)


def grown(now: Luma, before: Luma, region: tuple[float, float, float, float] = REGION) -> Growth:
    found = growth(Pyramid(now), Pyramid(before), region)
    assert found is not None
    return found


@pytest.mark.parametrize("scale", [0.9, 1.02, 1.1, 1.25])
@pytest.mark.parametrize("moved", [(0, 0), (4, -3)])
def test_the_growth_of_a_pattern(scale: float, moved: tuple[int, int]) -> None:
    before = patterned(1, 150 - moved[0], 110 - moved[1])
    shrinkage, error = grown(patterned(scale), before)
    assert shrinkage == pytest.approx(1 / scale - 1, rel=0.03)
    assert abs(shrinkage - (1 / scale - 1)) < 2 * error < 0.05


def test_what_only_moves_does_not_grow() -> None:
    assert grown(patterned(1), patterned(1, 145, 113)).shrinkage == pytest.approx(0, abs=5e-4)


@pytest.mark.parametrize("scale", [1.0, 1.05])
@pytest.mark.parametrize("degrees", [-5, 3])
def test_a_turn_is_not_taken_for_growth(scale: float, degrees: int) -> None:
    """As by a camera that rolls: 3 degrees between two frames are 90 degrees/s."""
    before = patterned(1, 152, 109, turn=np.radians(degrees))
    shrinkage, error = grown(patterned(scale), before)
    assert shrinkage == pytest.approx(1 / scale - 1, abs=1e-3)
    assert error < 0.002


@pytest.mark.parametrize("degrees", [-5, 3, 6])
def test_nor_in_a_region_that_is_three_times_as_wide_as_high(degrees: int) -> None:
    before = patterned(1, 152, 109, turn=np.radians(degrees))
    shrinkage, error = grown(patterned(1.05), before, (150, 110, 60, 20))
    assert shrinkage == pytest.approx(1 / 1.05 - 1, abs=2e-4)
    assert error < 0.0013


@pytest.mark.parametrize(
    ("contrast", "aspect", "noise"), [(1, 0.5, 0.0), (0.5, 0.5, 0.0), (1, 1.0, 0.02)]
)
def test_the_error_is_that_of_least_squares(contrast: float, aspect: float, noise: float) -> None:
    """Of displacement, shrinkage and turn; one sample in 9 is independent."""
    region = 150.0, 110.0, 12.0, 12 / aspect
    now = 0.5 + contrast * (patterned(1) - 0.5)
    before = now + noise * np.random.default_rng(1).standard_normal(now.shape)
    samples = Pyramid(now).samples(region, 0).astype(np.float64)
    down, across = (each * SIDE / 2 for each in np.gradient(samples))  # per half size
    along = (np.arange(SIDE) + 0.5) / SIDE * 2 - 1
    x, y = np.meshgrid(along, along)
    turn = down * x * aspect - across * y / aspect
    steps = np.array([across, down, across * x + down * y, turn])
    inside = x**2 + y**2 <= 1
    inside[[0, -1]] = inside[:, [0, -1]] = False  # they have no neighbour
    covariance = np.linalg.inv(steps[:, inside] @ steps[:, inside].T)
    expected = 3 * max(noise, 1 / 255) * np.sqrt(covariance[2, 2])
    ratio = grown(now, np.asarray(before, np.float32), region).error / expected
    # Samples between pixels have less noise.
    assert (0.8 if noise else 1 - 1e-5) < ratio < 1 + 1e-5


def test_a_displacement_of_up_to_a_half_size_is_found() -> None:
    """On a slope of luminance, which every sample shows alike."""
    slope = np.arange(WIDTH) + np.zeros((HEIGHT, 1))
    for half_sizes, found in ((0.4, True), (0.9, True), (1.1, False), (2, False)):
        now, before = (
            Pyramid(np.asarray(0.1 + 0.002 * (slope + right), np.float32))
            for right in (0, 60 * half_sizes)
        )
        measured = growth(now, before, (200, 110, 60, 50))
        assert (measured and measured.shrinkage) == (pytest.approx(0, abs=1e-6) if found else None)


def test_samples_that_the_earlier_frame_does_not_show_are_left_out() -> None:
    """The object moved by 8 px; before, more of it was outside the frame than now."""
    shrinkage, error = grown(patterned(1.1, 30), patterned(1, 22), (30, 110, 60, 50))
    assert shrinkage == pytest.approx(1 / 1.1 - 1, abs=2e-3)
    assert error < 0.002


@pytest.mark.parametrize(("x", "found"), [(0, True), (-30, False)])
def test_both_frames_must_show_15_percent_of_the_samples(x: float, found: bool) -> None:
    """Half of the region, or a fifth of its width: 37 and 14 % of the samples."""
    pyramid = Pyramid(patterned(1))
    assert bool(growth(pyramid, pyramid, (x, 110, 60, 50))) == found


def test_a_large_growth_is_found_from_a_start_near_it() -> None:
    now, before = Pyramid(patterned(2.5)), Pyramid(patterned(1))
    found, lost = (growth(now, before, REGION, start) for start in (-0.55, 0.0))
    assert found is not None
    assert found.shrinkage == pytest.approx(1 / 2.5 - 1, rel=0.02)
    assert lost is None or lost.error > 2 * found.error


@pytest.mark.parametrize(("x", "radius"), [(150, 52), (310, 52), (150, 100)])
def test_an_outline_alone_shows_the_growth(x: float, radius: float) -> None:
    """Also where the frame cuts it, or it is larger than the frame is high."""
    now, before = disk(WIDTH, x, 110, radius)[:HEIGHT], disk(WIDTH, x, 110, radius / 1.1)[:HEIGHT]
    shrinkage, error = grown(now, before, (x, 110, 1.15 * radius, 1.15 * radius))
    # OpenCV 4 shifts pictures by multiples of 1/32 px, OpenCV 5 by any distance.
    within = 0.035 if cv2.__version__.startswith("4.") else 0.03
    assert shrinkage == pytest.approx(1 / 1.1 - 1, rel=within)
    assert error < 0.2 * -shrinkage


@pytest.mark.parametrize("moved", [-6, -3, 3, 6])
def test_a_noisy_edge_that_moves_is_no_sure_growth(moved: int) -> None:
    """An edge alone tells growth from motion by its width only."""
    rng, columns = np.random.default_rng(0), np.arange(WIDTH)
    frames = []
    for at in (150, 150 - moved):
        edge = np.clip((columns - at) / 6, 0, 1) + 0.02 * rng.standard_normal((HEIGHT, WIDTH))
        frames.append(Pyramid(np.asarray(edge + 0.1, np.float32)))
    found = growth(frames[0], frames[1], REGION)
    assert found is None or found.error > -0.2 * found.shrinkage


def test_a_region_without_anything_tells_nothing() -> None:
    grey = np.full((HEIGHT, WIDTH), 0.5, np.float32)
    assert grown(grey, grey).shrinkage == 0
    # So the guess stays, unless it is beyond a factor of 4.
    for start, expected in ((-0.74, -0.74), (-0.76, None), (2.9, 2.9), (3.1, None)):
        found = growth(Pyramid(grey), Pyramid(grey), (160, 120, 24, 24), start)
        assert (found and found.shrinkage) == (expected and pytest.approx(expected))
    assert grown(grey, grey).error > 1


def test_noise_alone_is_no_growth() -> None:
    rng = np.random.default_rng(0)
    for _ in range(20):
        now, before = (rng.random((HEIGHT, WIDTH), np.float32) for _ in range(2))
        found = growth(Pyramid(now), Pyramid(before), REGION)
        assert found is None or found.error > 0.2 * -found.shrinkage


def test_what_the_frames_do_not_show_has_no_growth() -> None:
    pyramid = Pyramid(patterned(1))
    assert growth(pyramid, pyramid, (-60, 110, 60, 50)) is None


def test_an_object_without_width_has_a_size() -> None:
    """Two points of motion, one above the other, that no pooling spreads."""
    up, down = np.zeros((2, 9, 9), np.float32)
    up[2, 4] = down[6, 4] = 1
    centres = np.arange(9.0)
    pathways = {0: 0 * up, 90: up, 180: 0 * up, 270: down}
    maps = UnitMaps(up, pathways, centres, centres, 9, 0)
    extent = Products(maps).extent(4, 4, 4, 4)
    assert extent is not None
    assert (extent.x, extent.y) == pytest.approx((0.5, 8**0.5))


def test_points_that_move_along_a_line_but_across_the_axis_are_no_object() -> None:
    """One moves up, and one beside it down, as in a turn."""
    up, down = np.zeros((2, 9, 9), np.float32)
    up[4, 6] = down[4, 2] = 1
    centres = np.arange(9.0)
    pathways = {0: 0 * up, 90: up, 180: 0 * up, 270: down}
    assert Products(UnitMaps(up, pathways, centres, centres, 9, 0)).extent(4, 4, 4, 4) is None


def test_samples_are_taken_where_they_are_said_to_be() -> None:
    """On a slope of luminance, at every level."""
    across, down = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
    pyramid = Pyramid(np.asarray((across + 2 * down) / 1000, np.float32))
    along = (np.arange(SIDE) + 0.5) / SIDE * 2 - 1
    wanted = (150 + 60 * along[None, :] + 2 * (110 + 50 * along[:, None])) / 1000
    for level in range(4):
        assert pyramid.samples(REGION, level) == pytest.approx(wanted, abs=1e-3)
    assert (pyramid.samples((0, 110, 60, 50), 1)[:, : SIDE // 2 - 1] < 0).all()


def test_a_sample_that_the_edge_of_the_frame_cuts_is_outside() -> None:
    white = Pyramid(np.ones((HEIGHT, WIDTH), np.float32))
    samples = white.samples((0, 0, 7.7, 9.1), 0)
    assert set(np.unique(samples[samples >= 0])) == {1}
    assert np.count_nonzero(samples < 0) > SIDE**2 / 2


def test_frames_of_one_pixel_have_all_levels() -> None:
    pyramid = Pyramid(np.full((1, 1), 0.25, np.float32))
    assert pyramid.samples((0.5, 0.5, 0.1, 0.1), 3).shape == (SIDE, SIDE)
