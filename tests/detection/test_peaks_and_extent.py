"""Peaks and extents on maps made by hand."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import pytest

from oppload_cli.detection import places as module
from oppload_cli.detection.growth import Extent, Growth, PlaceParams, Products
from oppload_cli.detection.places import Places, _focus, _peaks
from oppload_cli.models.detector import UnitMaps

if TYPE_CHECKING:
    from oppload_cli.detection.growth import Pyramid, Region

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


def test_the_window_reaches_twice_as_far_as_the_object() -> None:
    """Two half sizes of the points at 2 cells are 6 cells, and with the others as well."""
    maps = blank()
    apart(maps, 2, 2, 1.0)
    apart(maps, 6, 6, 0.1)
    square = (2**2 + 0.01 * 6**2) / 1.01
    assert extent_of(maps).x == pytest.approx(math.sqrt(2 * square * 8**2 - 4**2))


def test_the_window_reaches_at_least_three_cells_far() -> None:
    maps = blank()
    apart(maps, 1, 0, 1.0)
    apart(maps, 1, 3, 0.1)
    apart(maps, 1, 4, 0.2)
    assert extent_of(maps, 5).opponency == pytest.approx(1 + 0.1**2)


@pytest.mark.parametrize("down", [True, False])
def test_the_window_shrinks_until_both_sizes_settle(down: bool) -> None:
    """It leaves out the points at 18 cells first, then those at 9; one of the sizes is constant."""
    maps = blank()
    for far, energy in ((2, 1.0), (9, 0.2), (18, 0.2)):
        apart(maps, *((2, far) if down else (far, 2)), energy)
    extent = extent_of(maps, 100)
    assert (extent.x, extent.y) == pytest.approx([math.sqrt(2 * 16**2 - 4**2)] * 2)


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


def test_the_slope_of_a_wide_peak_is_no_peak() -> None:
    maps = blank()
    y, x = np.mgrid[:CELLS, :CELLS]
    maps.responses[:] = np.exp(-((x - 20) ** 2 + (y - 12) ** 2) / 200)
    for share in (0, 1):
        assert _peaks(maps, PlaceParams(share=share)) == [(12, 20, 1.0)]


def moved(maps: UnitMaps, right: int) -> UnitMaps:
    """Return the maps with everything some cells to the right."""
    pathways = {phi: np.roll(each, right, 1) for phi, each in maps.pathways.items()}
    return maps._replace(responses=np.roll(maps.responses, right, 1), pathways=pathways)


STILL = np.full((CELLS * 8, CELLS * 8), 0.5, np.float32)


@pytest.mark.parametrize(("size", "within"), [(1, 3), (5, 8)])
def test_an_object_is_found_again_near_its_focus_or_within_its_growth(
    size: int, within: int
) -> None:
    """Near is a quarter of a field, 25 px: 3 cells. An object of 56 px may grow to 70 px: 8."""
    maps = blank()
    apart(maps, size, size, 1.0)
    maps.responses[MIDDLE, MIDDLE] = 1
    for right, identity in ((within, 1), (within + 1, 2)):
        places = Places(PlaceParams())
        for t, shown in enumerate((maps, moved(maps, right))):
            [track] = places.step(shown, STILL, t / 30)
            assert (track.identity, track.x) == (identity if t else 1, 164 + 8 * right * t)


@pytest.mark.parametrize("responses", [(2, 1), (1, 2)])
def test_a_peak_belongs_to_the_nearest_object(responses: tuple[float, float]) -> None:
    """Without pathways each object has half a field, 50 px, and may grow to 62 px: 7 cells."""
    first, second = (blank()._replace(pathways={}) for _ in range(2))
    first.responses[MIDDLE, [10, 20]] = responses
    second.responses[MIDDLE, 17] = 1
    places = Places(PlaceParams())
    both = {track.x: track.identity for track in places.step(first, STILL, 0)}
    assert sorted(both) == [84, 164]
    [track] = places.step(second, STILL, 1 / 30)
    assert track.identity == both[164]


@pytest.mark.parametrize(("later_s", "identity"), [(0.2005, 1), (0.203, 2)])
def test_an_object_keeps_its_number_for_a_fifth_of_a_second(later_s: float, identity: int) -> None:
    """Times may be rounded to milliseconds."""
    maps = blank()._replace(pathways={})
    maps.responses[MIDDLE, MIDDLE] = 1
    places = Places(PlaceParams())
    places.step(maps, STILL, 0)
    assert places.step(maps._replace(responses=0 * maps.responses), STILL, 0.1) == []
    assert [track.identity for track in places.step(maps, STILL, later_s)] == [identity]


def test_an_object_is_first_sought_within_a_field_around_its_unit() -> None:
    """At 16 cells, 128 px, other motion is outside the first window, which reaches 100 px."""
    maps = blank()
    apart(maps, 2, 2, 1.0)
    apart(maps, 16, 16, 0.5)
    maps.responses[MIDDLE, MIDDLE] = 1
    [track] = Places(PlaceParams()).step(maps, STILL, 0)
    assert track.extent.x == pytest.approx(math.sqrt(2 * 16**2 - 4**2))


def test_growth_is_measured_around_the_box_since_the_youngest_frame_of_an_interval_ago(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The region is 1.15 times the box, which is up to 10 % too small; the frames have numbers."""
    given = []

    def growth(now: Pyramid, before: Pyramid, region: Region, start: float) -> Growth:
        frames = (float(each.samples((9, 9, 1, 1), 0)[0, 0]) for each in (now, before))
        given.append((*frames, region, start))
        return Growth(-0.1, 0.001)

    monkeypatch.setattr(module, "growth", growth)
    maps = blank()
    apart(maps, 5, 3, 1.0)
    maps.responses[MIDDLE, MIDDLE] = 1
    places = Places(PlaceParams(), 1 / 30)
    for t, time_s in enumerate((0.0, 0.01, 0.02, 0.0325, 0.1, 0.14)):
        [track] = places.step(maps, np.full_like(STILL, t), time_s)
    extent = extent_of(maps)
    assert [each[:2] for each in given] == [(3, 0), (4, 3), (5, 4)]
    for each in given:
        assert each[2] == pytest.approx((164, 164, 1.15 * extent.x, 1.15 * extent.y))
    # A shrinkage of 0.1 in s seconds gives the contact 9 s later.
    contact_s = (0.0325 + 9 * 0.0325, 0.1 + 9 * 0.0675)
    expected = [-0.0675 / (contact_s[0] - 0.0325), -0.04 / (contact_s[1] - 0.1)]
    assert [each[3] for each in given] == pytest.approx([0, *expected])
    # An estimate holds for its frame only.
    track.time_to_contact_s = track.time_to_contact_error_s = 1.0
    monkeypatch.setattr(module, "growth", lambda *_: None)
    [track] = places.step(maps, STILL, 9.0)
    assert (track.time_to_contact_s, track.time_to_contact_error_s) == (None, None)


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
