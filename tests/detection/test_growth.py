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


def test_samples_are_taken_where_they_are_said_to_be() -> None:
    """On a slope of luminance, at every level."""
    across, down = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
    pyramid = Pyramid(np.asarray((across + 2 * down) / 1000, np.float32))
    along = (np.arange(SIDE) + 0.5) / SIDE * 2 - 1
    wanted = (150 + 60 * along[None, :] + 2 * (110 + 50 * along[:, None])) / 1000
    for level in range(4):
        assert pyramid.samples(REGION, level) == pytest.approx(wanted, abs=1e-3)
    assert (pyramid.samples((0, 110, 60, 50), 1)[:, : SIDE // 2 - 1] < 0).all()


def test_frames_of_one_pixel_have_all_levels() -> None:
    pyramid = Pyramid(np.full((1, 1), 0.25, np.float32))
    assert pyramid.samples((0.5, 0.5, 0.1, 0.1), 3).shape == (SIDE, SIDE)
