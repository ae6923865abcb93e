"""Peaks and extents on maps made by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from oppload_cli.detection.growth import Extent, Products
from oppload_cli.detection.parameters import PlaceParams
from oppload_cli.detection.places import _focus, _peaks
from oppload_cli.models.detector import UnitMaps

CELLS, CELL = 41, 8.0
MIDDLE = CELLS // 2


def blank() -> UnitMaps:
    centres = np.asarray((np.arange(CELLS) + 0.5) * CELL, np.float64)
    maps = {phi: np.zeros((CELLS, CELLS), np.float32) for phi in (45, 225, 135, 315)}
    field, spread = 100.0, 4.0
    return UnitMaps(
        np.zeros((CELLS, CELLS), np.float32), maps, centres, centres.copy(), field, spread
    )


def extent_of(maps: UnitMaps, guess: float = 50) -> Extent:
    extent = Products(maps).extent(MIDDLE, MIDDLE, guess, guess)
    assert extent is not None
    return extent


def apart(maps: UnitMaps, right: int, up: int, energy: float) -> None:
    """Let two points move away from the middle, along 45 degrees."""
    maps.pathways[45][MIDDLE - up, MIDDLE + right] += energy
    maps.pathways[225][MIDDLE + up, MIDDLE - right] += energy


def test_the_extent_of_two_points_that_move_apart() -> None:
    maps = blank()
    apart(maps, 5, 3, 1.0)
    extent = extent_of(maps)
    assert extent.x == pytest.approx(math.sqrt(2 * 40**2 - 4**2))
    assert extent.y == pytest.approx(math.sqrt(2 * 24**2 - 4**2))
    assert extent.opponency == 1


def test_what_moves_far_outside_an_object_does_not_count() -> None:
    maps = blank()
    apart(maps, 2, 2, 1.0)
    apart(maps, 8, 8, 0.1)
    extent = extent_of(maps, 100)
    assert math.sqrt(extent.x * extent.y) == pytest.approx(math.sqrt(2 * 16**2 - 4**2))


def test_what_moves_together_counts_against_the_opponency_only() -> None:
    maps = blank()
    apart(maps, 3, 3, 2.0)
    apart(maps, -2, -2, 1.0)
    extent = extent_of(maps)
    assert extent.x == pytest.approx(math.sqrt(2 * 24**2 - 4**2))
    assert extent.opponency == 4 - 1
    assert Products(blank()).extent(MIDDLE, MIDDLE, 50, 50) is None


def test_peaks_have_a_receptive_field_to_themselves() -> None:
    maps = blank()
    for row, column, response in ((20, 20, 9.0), (20, 26, 8.0), (20, 27, 0.0), (27, 20, 5.0)):
        maps.responses[row, column] = response
    found = _peaks(maps, PlaceParams(share=0))
    # 48 px away is within half a field of 100 px, 56 px is not.
    assert found == [(20, 20, 9.0), (27, 20, 5.0)]


def test_without_a_floor_every_answer_counts() -> None:
    maps = blank()
    maps.responses[5, 5], maps.responses[30, 30] = 1.0, 1e-30
    everything = PlaceParams(floor=0, share=0)
    assert [(peak.row, peak.column) for peak in _peaks(maps, everything)] == [(5, 5), (30, 30)]


def test_nothing_answers_in_empty_maps() -> None:
    assert _peaks(blank(), PlaceParams(floor=0, share=0)) == []


def test_the_focus_is_the_top_of_a_bell() -> None:
    maps = blank()
    y, x = np.mgrid[:CELLS, :CELLS]
    maps.responses[:] = np.exp(-((x - 20.3) ** 2 + (y - 11.8) ** 2) / 6)
    [peak] = _peaks(maps, PlaceParams())
    assert (peak.row, peak.column) == (12, 20)
    assert _focus(maps, 12, 20) == pytest.approx((20.8 * CELL, 12.3 * CELL), abs=0.01)
    assert _focus(maps, 0, 40) == (maps.centres_x[40], maps.centres_y[0])
