"""Peaks and extents on maps made by hand."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import pytest

from oppload_cli.detection import places as module
from oppload_cli.detection.contact import Extent, PlaceParams, Products
from oppload_cli.detection.places import Places, _focus, _peaks
from oppload_cli.models.detector import UnitMaps
from oppload_cli.motion.flow import Flow
from oppload_cli.motion.growth import Growth

if TYPE_CHECKING:
    from oppload_cli.models.dpc import Map

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


def small(up: Map, down: Map) -> UnitMaps:
    """Nine by nine units that no pooling spreads, with motion up and down only."""
    centres = np.arange(9.0)
    pathways = {0: 0 * up, 90: up, 180: 0 * up, 270: down}
    return UnitMaps(up, pathways, centres, centres, 9, 0)


def test_an_object_without_width_has_a_size() -> None:
    """Two points of motion, one above the other."""
    up, down = np.zeros((2, 9, 9), np.float32)
    up[2, 4] = down[6, 4] = 1
    extent = Products(small(up, down)).extent(4, 4, 4, 4)
    assert extent is not None
    assert (extent.x, extent.y) == pytest.approx((0.5, 8**0.5))


def test_points_that_move_along_a_line_but_across_the_axis_are_no_object() -> None:
    """One moves up, and one beside it down, as in a turn."""
    up, down = np.zeros((2, 9, 9), np.float32)
    up[4, 6] = down[4, 2] = 1
    assert Products(small(up, down)).extent(4, 4, 4, 4) is None


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
            [track] = places.step(shown, None, t / 30)
            assert (track.identity, track.x) == (identity if t else 1, 164 + 8 * right * t)


@pytest.mark.parametrize("responses", [(2, 1), (1, 2)])
def test_a_peak_belongs_to_the_nearest_object(responses: tuple[float, float]) -> None:
    """Without pathways each object has half a field, 50 px, and may grow to 62 px: 7 cells."""
    first, second = (blank()._replace(pathways={}) for _ in range(2))
    first.responses[MIDDLE, [10, 20]] = responses
    second.responses[MIDDLE, 17] = 1
    places = Places(PlaceParams())
    both = {track.x: track.identity for track in places.step(first, None, 0)}
    assert sorted(both) == [84, 164]
    [track] = places.step(second, None, 1 / 30)
    assert track.identity == both[164]


@pytest.mark.parametrize(("later_s", "identity"), [(0.2005, 1), (0.203, 2)])
def test_an_object_keeps_its_number_for_a_fifth_of_a_second(later_s: float, identity: int) -> None:
    """Times may be rounded to milliseconds."""
    maps = blank()._replace(pathways={})
    maps.responses[MIDDLE, MIDDLE] = 1
    places = Places(PlaceParams())
    places.step(maps, None, 0)
    assert places.step(maps._replace(responses=0 * maps.responses), None, 0.1) == []
    assert [track.identity for track in places.step(maps, None, later_s)] == [identity]


def test_an_object_is_first_sought_within_a_field_around_its_unit() -> None:
    """At 16 cells, 128 px, other motion is outside the first window, which reaches 100 px."""
    maps = blank()
    apart(maps, 2, 2, 1.0)
    apart(maps, 16, 16, 0.5)
    maps.responses[MIDDLE, MIDDLE] = 1
    [track] = Places(PlaceParams()).step(maps, None, 0)
    assert track.extent.x == pytest.approx(math.sqrt(2 * 16**2 - 4**2))


def test_growth_is_measured_about_the_place_of_the_largest_response(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    given = []

    def growth_within(flow: Flow, x: float, y: float) -> Growth:
        given.append((flow, x, y))
        return Growth(0.1, 0.001)

    monkeypatch.setattr(module, "growth_within", growth_within)
    maps = blank()
    apart(maps, 5, 3, 1.0)
    maps.responses[MIDDLE, MIDDLE] = 1
    places = Places(PlaceParams())
    still = np.zeros((1, 1, 2), np.float32)
    flows = [Flow(still, still[..., 0], 8, passed_s) for passed_s in (0.03, 0.04, 0.05, 0.02)]
    places.step(maps, None, 0.0)
    for time_s, flow in zip((0.1, 0.15, 0.2, 0.25), flows, strict=True):
        [track] = places.step(maps, flow, time_s)
    assert given == [(flow, 164, 164) for flow in flows]
    # A growth of 0.1 in d seconds gives the contact 10 d later.
    contacts_s = [each[1] for each in track.contact._samples]
    assert contacts_s == pytest.approx([0.1 + 0.3, 0.15 + 0.4, 0.2 + 0.5, 0.25 + 0.2])
    # An estimate holds for its frame only.
    track.time_to_contact_s = track.time_to_contact_error_s = 1.0
    monkeypatch.setattr(module, "growth_within", lambda *_: None)
    [track] = places.step(maps, flow, 9.0)
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
