"""Growth on flows made by hand, on pictures that are magnified, and on rendered approaches."""

from __future__ import annotations

import math
from functools import cache
from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest

from oppload_cli import analyse, stimulus
from oppload_cli.motion.flow import DenseFlow, Flow
from oppload_cli.motion.growth import RadialGrowth, Windows, box_about, motion_about
from oppload_cli.pipeline.sources import StimulusVideo
from oppload_cli.stimulus.truth import contact_time

if TYPE_CHECKING:
    from oppload_cli.motion.growth import LocalMotion, Map

pytestmark = pytest.mark.once

# A frame of 240 x 320 px: samples of the flow and places of the growth, both with sides of 8 px.
SHAPE, GRID, SIDE = (240, 320), (30, 40), 8
WINDOW, MEMORY_S = 72.0, 0.1
CENTRE = 15, 20  # of the frame
Y, X = (np.mgrid[:30, :40] + 0.5) * SIDE - np.array([120, 160])[:, None, None]


def field(across: float = 0, down: float = 0, x: float = 0, y: float = 0, turn: float = 0) -> Map:
    """The vectors of a growth of width and height, a motion (x, y) and a turn."""
    return np.stack([x + across * X - turn * Y, y + down * Y + turn * X], -1).astype(np.float32)


def flow(vectors: Map, passed_s: float = 1 / 30) -> Flow:
    return Flow(vectors, np.ones(GRID, np.float32), SIDE, passed_s)


def noise(sigma: float) -> Map:
    return np.asarray(np.random.default_rng(2).normal(0, sigma, (*GRID, 2)), np.float32)


def test_an_even_growth_is_found_and_explained_also_in_windows_that_the_frame_cuts() -> None:
    fit = Windows(SHAPE, GRID, WINDOW).fit(field(0.05, 0.05, x=3, y=-2))
    for growth in (fit.across, fit.down):
        np.testing.assert_allclose(growth, 0.05, rtol=1e-3)
    np.testing.assert_allclose(fit.explained, 1, atol=0.01)
    # The motion is that of the middle of the window, also where the frame cuts it.
    np.testing.assert_allclose(fit.x, 3 + 0.05 * X, atol=2e-3)
    np.testing.assert_allclose(fit.y, -2 + 0.05 * Y, atol=2e-3)


def test_the_growths_of_width_and_height_are_told_apart() -> None:
    fit = Windows(SHAPE, GRID, WINDOW).fit(field(0.06, 0.02))
    np.testing.assert_allclose(fit.across, 0.06, rtol=1e-3)
    np.testing.assert_allclose(fit.down, 0.02, rtol=1e-3)
    # Of 0.06^2 + 0.02^2 an even growth of 0.04 explains 2 x 0.04^2.
    assert fit.explained[CENTRE] == pytest.approx(0.8, abs=0.01)


@pytest.mark.parametrize(
    ("vectors", "growth"),
    [
        (field(x=4, y=-3), 0),
        (field(turn=0.05), 0),
        (field(0.05, -0.05), None),  # a shear
        (field(), 0),
        (field(0.001, 0.001), 0.001),  # less than the error of the flow
    ],
    ids=["translation", "turn", "shear", "still", "noise"],
)
def test_other_motion_is_not_explained(vectors: Map, growth: float | None) -> None:
    fit = Windows(SHAPE, GRID, WINDOW).fit(vectors)
    assert fit.explained.max() < 0.5
    if growth is not None:
        np.testing.assert_allclose([fit.across, fit.down], growth, atol=1e-5)


def test_growth_in_noise_is_explained_by_its_share_of_the_variance() -> None:
    fit = Windows(SHAPE, GRID, WINDOW).fit(field(0.05, 0.05) + noise(1))
    by_growth = 2 * 0.05**2 * np.mean((np.arange(-4, 5) * SIDE) ** 2)
    assert np.median(fit.explained) == pytest.approx(by_growth / (by_growth + 2), abs=0.05)


def followed(vectors: Map, frames: int, memory_s: float = MEMORY_S) -> RadialGrowth:
    growth = RadialGrowth(SHAPE, GRID, WINDOW, memory_s)
    for _ in range(frames):
        growth.step(flow(vectors), 1 / 30)
    return growth


def test_growth_rises_with_the_time_constant() -> None:
    """A memory of 0.1 s is three frames; the rate is 0.05 in 1/30 s."""
    constant = field(0.05, 0.05)
    assert followed(constant, 1, 0).growth[CENTRE] == pytest.approx(1.5, rel=0.02)
    growth = followed(constant, 3)
    assert growth.growth[CENTRE] == pytest.approx(1.5 * (1 - math.exp(-1)), rel=0.02)
    # One step of 0.1 s has the same weight as three, and a flow of 1/15 s half the rate.
    growth = followed(constant, 0)
    growth.step(flow(constant, 1 / 15), 0.1)
    assert growth.growth[CENTRE] == pytest.approx(0.75 * (1 - math.exp(-1)), rel=0.02)


def test_the_side_that_grows_less_counts_and_what_shrinks_does_not() -> None:
    found = followed(field(0.06, 0.02), 1, 0).growth[CENTRE]
    assert found == pytest.approx(30 * 0.02 * 0.8**2, rel=0.03)
    assert not followed(field(-0.05, -0.05), 3).growth.any()
    assert not followed(field(0.09, -0.01), 3).growth.any()


@pytest.mark.parametrize(("sides", "weight"), [(0, 1), (0.5, math.exp(-0.25)), (3, 0), (1e6, 0)])
def test_a_focus_far_from_the_window_is_no_collision_course(sides: float, weight: float) -> None:
    found = followed(field(0.05, 0.05, x=sides * 0.05 * WINDOW), 1, 0).growth
    middle = (found[14, 19] + found[15, 20]) / 2  # on both sides of the frame's middle
    assert middle == pytest.approx(1.5 * weight, abs=0.03)


@pytest.mark.parametrize("elapsed", [1 / 30, 1 / 60])
def test_growth_follows_a_place_that_moves(elapsed: float) -> None:
    """By two cells in 1/30 s, and by one in half of the time."""
    growth = RadialGrowth(SHAPE, GRID, WINDOW, MEMORY_S)
    growth.growth[15, 12] = 1
    growth.step(flow(field(x=16)), elapsed)
    column = 12 + round(60 * elapsed)
    assert divmod(int(growth.growth.argmax()), GRID[1]) == (15, column)
    assert growth.growth[15, column] == pytest.approx(math.exp(-elapsed / MEMORY_S), rel=1e-3)


def about(vectors: Map, x: float = 160, y: float = 120) -> LocalMotion:
    found = motion_about(flow(vectors), x, y)
    assert found is not None
    return found


def test_shift_growth_and_turn_about_a_place_are_told_apart() -> None:
    for x, y in ((160, 120), (40, 200), (312, 10)):
        found = about(field(0.04, 0.04, x=5, y=-1, turn=0.03), x, y)
        assert found.factor == pytest.approx(0.04 + 0.03j, rel=1e-4)
        away = (x - 160) + 1j * (y - 120)
        assert found.shift == pytest.approx(5 - 1j + (0.04 + 0.03j) * away, rel=1e-4)
    assert about(field(0.06, 0.02)).factor.real == pytest.approx(0.04, rel=1e-4)
    assert motion_about(flow(field()), 400, 120) is None
    assert motion_about(flow(np.zeros((0, 0, 2), np.float32)), 160, 120) is None


def test_the_error_rises_with_the_noise_and_holds_what_the_growth_differs() -> None:
    clear, noisy, worse = (about(field(0.04, 0.04) + noise(sigma)) for sigma in (0, 0.3, 1))
    assert 0 < clear.error < noisy.error < worse.error
    for found in (clear, noisy, worse):
        assert abs(found.factor.real - 0.04) < 2 * found.error


def test_the_box_holds_what_moves_as_its_place_does() -> None:
    """An object of 12 x 8 samples grows and moves; another one grows apart from it."""
    vectors = field(x=-6)
    vectors[11:19, 14:26] = field(0.1, 0.1, x=2)[11:19, 14:26]
    vectors[2:6, 30:38] = field(0.1, 0.1, x=2)[2:6, 30:38]
    found = box_about(flow(vectors), 160, 120, about(vectors))
    assert found == pytest.approx((14 * 8, 11 * 8, 26 * 8, 19 * 8), abs=8)
    assert box_about(flow(field(x=-6)), 160, 120, about(field(x=-6))) is None
    assert box_about(flow(vectors), 20, 20, about(vectors)) is None


@cache
def magnified(by: float) -> Map:
    noisy = np.random.default_rng(7).random(SHAPE, np.float32)
    texture = 0.5 + 3 * (cv2.GaussianBlur(noisy, (0, 0), 3) - 0.5)
    move = cv2.getRotationMatrix2D((159.5, 119.5), 0, by)
    return np.asarray(cv2.warpAffine(texture, move, (320, 240)), np.float32)


@pytest.mark.parametrize("by", [1.03, 1.06, 1 / 1.03])
def test_the_flow_of_a_magnified_texture_shows_its_growth(by: float) -> None:
    search = DenseFlow()
    search.step(magnified(1), 0)
    measured = search.step(magnified(by), 1 / 30)
    assert measured is not None
    found = motion_about(measured, 160, 120)
    assert found is not None
    assert found.factor.real == pytest.approx(by - 1, rel=0.2)


@pytest.mark.long
def test_the_time_to_contact_of_a_rendered_approach() -> None:
    [protocol] = stimulus.load_all("controls/looming-perspective")
    contact_s = contact_time(protocol)
    assert contact_s is not None
    records = analyse(StimulusVideo(protocol, 240), ["opplod"], rmo=None)
    errors = [
        left_s / (contact_s - record.time_s) - 1
        for record in records
        if contact_s - 0.5 < record.time_s < contact_s
        and (found := record["opplod"].object)
        and (left_s := found.time_to_contact_s)
    ]
    assert len(errors) > 15
    assert np.median(np.abs(errors)) < 0.2
    assert np.abs(errors).max() < 0.4
