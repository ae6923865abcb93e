"""Surfaces in perspective: their edges, and the mean of a texture over each pixel."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import pytest

from oppload_cli.stimulus.background import _Surroundings
from oppload_cli.stimulus.courses import AHEAD, RIGHT, UP
from oppload_cli.stimulus.geometry import Projection
from oppload_cli.stimulus.staging import CameraView
from oppload_cli.stimulus.surfaces import Surface, Texture

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.floating]

SIDE, EYE = 300, 100.0
PLAIN = Texture(np.ones((4, 4), np.float32), repeats=True)


def view(ahead: float = 0.0) -> CameraView:
    """Return the view of a camera that has moved ahead; its eye is 100 px from the screen."""
    projection = Projection((SIDE, SIDE), math.radians(EYE), perspective=True)
    return CameraView((0.0, 0.0, ahead), (RIGHT, UP, AHEAD), projection)


def wall(high: float) -> Surface:
    """Return a wall 2 m to the right that appears in the columns 175.3 to 200.25."""
    far, near = 2 * EYE / 25.3, 2 * EYE / 50.25
    extent = (near, -20.0, far, high)
    return Surface((2.0, 0.0, 0.0), AHEAD, UP, PLAIN, 1.0, extent=extent)


def test_the_edges_of_a_wall_cover_their_shares_of_pixels() -> None:
    placed = wall(high=1.5).seen(view())
    assert placed is not None
    covered = np.zeros((SIDE, SIDE))
    covered[placed.window.slices] = placed.covered
    below = covered[150:]
    assert below[:, 175] == pytest.approx(0.7, abs=0.03)
    assert below[:, 200] == pytest.approx(0.25, abs=0.03)
    assert (below[:, 176:200] == 1).all()
    assert not covered[:, :175].any()
    assert not covered[:, 201:].any()
    # Its upper edge rises by 0.75 px from column to column, as 1.5 m are 3/4 of 2 m.
    rises = 0.75 * (np.arange(176, 200) + 0.5 - 150)
    assert covered[:150, 176:200].sum(axis=0) == pytest.approx(rises, abs=0.1)


def test_the_flow_of_a_pixel_is_that_of_what_covers_half_of_it() -> None:
    """The camera moves 1 m ahead; behind the wall stands a screen at a distance of 100 m."""
    screen = Surface((0.0, 0.0, 100.0), RIGHT, UP, PLAIN, 1.0, extent=(-400, -400, 400, 400))
    flow = _Surroundings([screen, wall(high=20.0)], 0.5).flow(view(), view(ahead=1.0))
    x = np.arange(SIDE) + 0.5 - SIDE / 2
    of_screen, of_wall = x * 100 / 99 - x, x * (2 * EYE / x) / (2 * EYE / x - 1) - x
    shows_wall = (np.arange(SIDE) >= 175) & (np.arange(SIDE) < 200)
    wanted = np.where(shows_wall, of_wall, of_screen)
    assert flow[150, :, 0] == pytest.approx(wanted, abs=1e-6)
    # What comes to lie behind the camera has no flow: the wall, if the camera moves 5 m ahead.
    flow = _Surroundings([wall(high=20.0)], 0.5).flow(view(), view(ahead=5.0))
    distance = 2 * EYE / x
    np.testing.assert_array_equal(np.isfinite(flow[150, :, 0]), shows_wall & (distance > 5))


@pytest.mark.long
def test_a_pixel_shows_the_mean_of_the_part_of_the_texture_that_it_covers() -> None:
    """Waves of 0.8 m on the ground, 1 m below; their mean over 8 x 8 places in each pixel."""
    fine = 8

    def waves(right: Floats, ahead: Floats) -> Floats:
        both, along = (2 * np.pi / 0.8 * metres for metres in (right + ahead, ahead))
        return np.asarray(0.5 + 0.2 * np.sin(both) + 0.2 * np.cos(along))

    at = (np.arange(64)[None, :] + 0.5) * 0.05
    texture = Texture(waves(at, -at.T).astype(np.float32), repeats=True)
    ground = Surface((0, -1.0, 0), RIGHT, AHEAD, texture, 64 * 0.05)
    placed = ground.seen(view())
    assert placed is not None
    found = ground.values(placed)[:, 90:210]  # pixels at the sides see it at a larger angle
    # Row 0 is the first one below the horizon, and the middle of the screen lies at column 60.
    ahead = EYE / (20 + (np.arange(130 * fine)[:, None] + 0.5) / fine)
    right = ((np.arange(120 * fine)[None, :] + 0.5) / fine - 60) * ahead / EYE
    mean = waves(right, ahead).reshape(130, fine, 120, fine).mean(axis=(1, 3))
    assert found[20:] == pytest.approx(mean, abs=0.02)
    # A pixel far away covers many waves, and is plain.
    assert found[3:6] == pytest.approx(0.5, abs=0.01)
