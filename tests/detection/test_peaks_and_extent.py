"""Peaks, and the objects about them, on maps made by hand."""

from __future__ import annotations

import numpy as np
import pytest

from oppload_cli.detection import places as module
from oppload_cli.detection.contact import PlaceParams
from oppload_cli.detection.places import Places, _focus, _peaks
from oppload_cli.models.detector import UnitMaps
from oppload_cli.motion.flow import Flow
from oppload_cli.motion.growth import LocalMotion

CELLS, CELL = 41, 8.0
MIDDLE = CELLS // 2

PLACES = PlaceParams().of((0.02, 0.2))


def blank() -> UnitMaps:
    centres = np.asarray((np.arange(CELLS) + 0.5) * CELL, np.float64)
    return UnitMaps(np.zeros((CELLS, CELLS), np.float32), centres, centres.copy(), 100.0)


def test_peaks_have_a_receptive_field_to_themselves() -> None:
    maps = blank()
    for row, column, response in ((20, 20, 9.0), (20, 26, 8.0), (20, 27, 0.0), (27, 20, 5.0)):
        maps.responses[row, column] = response
    found = _peaks(maps, PLACES.replaced(share=0))
    # 48 px away is within half a field of 100 px, 56 px is not.
    assert found == [(20, 20, 9.0), (27, 20, 5.0)]


def test_the_slope_of_a_wide_peak_is_no_peak() -> None:
    maps = blank()
    y, x = np.mgrid[:CELLS, :CELLS]
    maps.responses[:] = np.exp(-((x - 20) ** 2 + (y - 12) ** 2) / 200)
    for share in (0, 1):
        assert _peaks(maps, PLACES.replaced(share=share)) == [(12, 20, 1.0)]


STILL = np.zeros((1, 1, 2), np.float32)
FLOW = Flow(STILL, STILL[..., 0], 8, 1 / 30)
GROWING = LocalMotion(0j, 0.1 + 0j, 0.001)


@pytest.mark.parametrize(("half", "within"), [(8, 3), (56, 8)])
def test_an_object_is_found_again_near_its_focus_or_within_its_growth(
    half: float, within: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Near is a quarter of a field, 25 px: 3 cells. A half size of 56 px may grow to 70 px: 8."""
    monkeypatch.setattr(module, "motion_about", lambda *_: GROWING)
    edges = 164 - half, 164 - half, 164 + half, 164 + half
    monkeypatch.setattr(module, "box_about", lambda *_: edges)
    maps = blank()
    maps.responses[MIDDLE, MIDDLE] = 1
    for right, identity in ((within, 1), (within + 1, 2)):
        places, later = Places(PLACES), np.roll(maps.responses, right, 1)
        [track] = places.step(maps, FLOW, 0)
        assert (track.identity, track.x, [*track.box]) == (1, 164, [*edges[:2], *[2 * half] * 2])
        [track] = places.step(maps._replace(responses=later), FLOW, 1 / 30)
        assert (track.identity, track.x) == (identity, 164 + 8 * right)


@pytest.mark.parametrize("responses", [(2, 1), (1, 2)])
def test_a_peak_belongs_to_the_nearest_object(responses: tuple[float, float]) -> None:
    """Without a flow each object has half a field, 50 px, and may grow to 62 px: 7 cells."""
    first, second = blank(), blank()
    first.responses[MIDDLE, [10, 20]] = responses
    second.responses[MIDDLE, 17] = 1
    places = Places(PLACES)
    both = {track.x: track.identity for track in places.step(first, None, 0)}
    assert sorted(both) == [84, 164]
    [track] = places.step(second, None, 1 / 30)
    assert track.identity == both[164]


@pytest.mark.parametrize(("later_s", "identity"), [(0.2, 1), (0.2005, 2)])
def test_an_object_keeps_its_number_for_a_fifth_of_a_second(later_s: float, identity: int) -> None:
    maps = blank()
    maps.responses[MIDDLE, MIDDLE] = 1
    places = Places(PLACES)
    places.step(maps, None, 0)
    assert places.step(maps._replace(responses=0 * maps.responses), None, 0.1) == []
    assert [track.identity for track in places.step(maps, None, later_s)] == [identity]


def test_before_the_flow_shows_an_object_its_box_is_the_field_of_its_unit() -> None:
    maps = blank()
    maps.responses[MIDDLE, MIDDLE] = 1
    [track] = Places(PLACES).step(maps, None, 0)
    assert (track.x, track.y, [*track.box]) == (164, 164, [114, 114, 100, 100])


def test_growth_is_measured_about_the_place_of_the_largest_response(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    given = []

    def motion_about(flow: Flow, x: float, y: float) -> LocalMotion:
        given.append((flow, x, y))
        return GROWING

    monkeypatch.setattr(module, "motion_about", motion_about)
    monkeypatch.setattr(module, "box_about", lambda *_: None)
    maps = blank()
    maps.responses[MIDDLE, MIDDLE] = 1
    places = Places(PLACES)
    flows = [FLOW._replace(passed_s=passed_s) for passed_s in (0.03, 0.04, 0.05, 0.02)]
    places.step(maps, None, 0.0)
    for time_s, flow in zip((0.1, 0.15, 0.2, 0.25), flows, strict=True):
        [track] = places.step(maps, flow, time_s)
    assert given == [(flow, 164, 164) for flow in flows]
    # A growth of 0.1 in d seconds gives the contact 10 d later.
    contacts_s = [contact_s for _, contact_s, _ in track.contact._samples]
    assert contacts_s == pytest.approx([0.1 + 0.3, 0.15 + 0.4, 0.2 + 0.5, 0.25 + 0.2])
    # An estimate holds for its frame only.
    track.time_to_contact_s = track.time_to_contact_error_s = 1.0
    monkeypatch.setattr(module, "motion_about", lambda *_: None)
    [track] = places.step(maps, flow, 9.0)
    assert (track.time_to_contact_s, track.time_to_contact_error_s) == (None, None)


def test_without_a_floor_every_answer_counts() -> None:
    maps = blank()
    maps.responses[5, 5], maps.responses[30, 30] = 1.0, 1e-30
    everything = PLACES.replaced(floor=0, share=0)
    assert [(peak.row, peak.column) for peak in _peaks(maps, everything)] == [(5, 5), (30, 30)]


def test_nothing_answers_in_empty_maps() -> None:
    assert _peaks(blank(), PLACES.replaced(floor=0, share=0)) == []


def test_the_focus_is_the_top_of_a_bell() -> None:
    maps = blank()
    y, x = np.mgrid[:CELLS, :CELLS]
    maps.responses[:] = np.exp(-((x - 20.3) ** 2 + (y - 11.8) ** 2) / 6)
    [peak] = _peaks(maps, PLACES)
    assert (peak.row, peak.column) == (12, 20)
    assert _focus(maps, 12, 20) == pytest.approx((20.8 * CELL, 12.3 * CELL), abs=0.01)
    assert _focus(maps, 0, 40) == (maps.centres_x[40], maps.centres_y[0])
