from __future__ import annotations

import math
from copy import copy
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from oppload_cli.detection.contact import Contact, Extent
from oppload_cli.detection.places import Places, Track, _Peak
from oppload_cli.models.opplod import Opplod
from oppload_cli.motion.flow import DenseFlow
from oppload_cli.motion.growth import growth_within
from tests.detection.showing import LENGTH, RATE, SIZE, approaching, remaining, shown, together
from tests.media import disk, texture
from tests.presets import PLACES, REFERENCE


def test_a_disk_is_one_object_with_its_focus_and_its_box() -> None:
    """The moving edge of a frame lies between this frame's outline and the last one's."""
    found = shown(approaching(131, 103, 24, 20))
    assert [len(tracks) for tracks in found[12:]] == [1] * 8
    for t, [track] in enumerate(found[12:], 12):
        assert track.identity == 1
        assert (track.x, track.y) == pytest.approx((131, 103), abs=1.5)
        last, now = (LENGTH / remaining(at, 24) for at in (t - 1, t))
        for half in (track.extent.x, track.extent.y):
            assert last - 1 < half < now + 1


@pytest.mark.parametrize(("width", "height"), [(1.0, 0.6), (0.6, 1.0)])
def test_a_box_has_the_width_and_the_height_of_an_ellipse(width: float, height: float) -> None:
    across = np.arange(SIZE) + 0.5 - 120
    found = []
    for t in range(16):
        radius = LENGTH / remaining(t, 22)
        distance = np.hypot(across[None, :] / width, across[:, None] / height)
        found.append((1 - np.clip(radius - distance + 0.5, 0, 1)).astype(np.float32))
    [track] = shown(found)[-1]
    radius = LENGTH / (remaining(15, 22) + 0.5 / RATE)
    assert math.sqrt(track.extent.x * track.extent.y) == pytest.approx(
        radius * (width * height) ** 0.5, rel=0.05
    )
    # The far ends move faster and answer more: long objects look a little longer.
    assert track.extent.x == pytest.approx(width * radius, rel=0.17)
    assert track.extent.y == pytest.approx(height * radius, rel=0.17)


def test_an_object_larger_than_the_field_keeps_its_focus_and_number() -> None:
    """From frame 20 on its edge is out of the field of the unit at its focus."""
    found = shown(approaching(120, 120, 26, 23))
    for t in (20, 21, 22):
        first = found[t][0]
        assert first.identity == 1
        assert (first.x, first.y) == pytest.approx((120, 120), abs=6)
        assert math.sqrt(first.extent.x * first.extent.y) == pytest.approx(
            LENGTH / (remaining(t, 26) + 0.5 / RATE), rel=0.1
        )


def test_an_object_larger_than_the_field_is_followed() -> None:
    """Its edge is out of the field from frame 5 on."""
    found = shown([disk(SIZE, 90 + 1.5 * t, 120, 40 + 2.5 * t) for t in range(24)])
    for t, tracks in enumerate(found[10:], 10):
        assert [track.identity for track in tracks] == [1]
        assert (tracks[0].x, tracks[0].y) == pytest.approx((90 + 1.5 * (t - 0.5), 120), abs=8)


@pytest.mark.parametrize(("around_focus", "column"), [(0.9, 7), (1.1, 2)])
def test_of_two_units_that_with_more_outward_motion_is_the_object_s(
    monkeypatch: pytest.MonkeyPatch, around_focus: float, column: int
) -> None:
    """The peak is at column 7, with an opponency of 1; the object was at column 2 or 3."""
    places, centres = Places(PLACES), 8.0 * np.arange(9)
    opponency = {7: 1.0, 2: around_focus}
    units: Any = SimpleNamespace(
        responses=np.zeros((9, 9), np.float32), centres_x=centres, centres_y=centres
    )
    products: Any = SimpleNamespace(
        better_unit=lambda *_: (4, 2), extent=lambda _, at, *__: Extent(9, 9, opponency[at])
    )
    places._maps, places._products = units, products
    monkeypatch.setattr(places, "_estimate_contact", lambda *_: None)
    track = Track(1, 4, 3, 24, 32, Extent(9, 9, 1), 2, 0, Contact(PLACES))
    places._follow(track, _Peak(4, 7, 3), 0.1)
    assert (track.column, track.x, track.response) == (column, 8 * column, 3)


def test_two_disks_are_two_objects_that_keep_their_numbers() -> None:
    found = shown(together(approaching(65, 70, 26, 21), approaching(178, 165, 28, 21)))
    both = [{track.identity: track for track in tracks} for tracks in found[15:]]
    assert [sorted(tracks) for tracks in both] == [[1, 2]] * 6
    for tracks in both:
        assert (tracks[1].x, tracks[1].y) == pytest.approx((65, 70), abs=3)
        assert (tracks[2].x, tracks[2].y) == pytest.approx((178, 165), abs=3)
    assert all(tracks[0].response >= tracks[1].response for tracks in found[15:])


def test_a_moving_object_keeps_its_number() -> None:
    frames = [disk(SIZE, 60 + 4 * t, 120, LENGTH / remaining(t, 24)) for t in range(19)]
    found = shown(frames)
    assert {track.identity for tracks in found for track in tracks} == {1}
    assert found[-1][0].x == pytest.approx(60 + 4 * 17.5, abs=5)


def test_an_object_keeps_its_number_over_a_short_gap() -> None:
    frames = approaching(120, 120, 28, 24)
    short = shown(frames, hidden=range(16, 20))
    assert [len(tracks) for tracks in short[15:21]] == [1, 0, 0, 0, 0, 1]
    assert short[20][0].identity == 1
    long = shown(frames, PLACES.replaced(gap_s=0.1), hidden=range(16, 20))
    assert long[20][0].identity == 2


def test_an_object_of_a_slow_video_keeps_its_number() -> None:
    """At 2 frames/s the last frame is longer ago than any gap allowed."""
    found = shown(approaching(120, 120, 24, 20), rate=2)
    assert {track.identity for tracks in found for track in tracks} == {1}


@pytest.mark.parametrize("seed", range(3))
def test_the_first_object_is_the_winning_unit(seed: int) -> None:
    rng = np.random.default_rng(seed)
    model = Opplod((SIZE, 300), REFERENCE.replaced(history=0))
    for scale in (0.0, 0.0, 0.05, 0.1, 1.0):
        luma = rng.random((SIZE, 300), dtype=np.float32) * np.float32(scale)
        answer = model.step(luma)
    assert answer is not None
    assert answer.box is not None
    first, *others = Places(PLACES.replaced(share=0, most=20)).step(model.units, None, 0)
    assert first.response == pytest.approx(answer.response, rel=1e-5)
    field = answer.box.width
    middle = answer.box.x + field / 2, answer.box.y + field / 2
    assert (first.x, first.y) == pytest.approx(middle, abs=4)
    assert others
    for other in others:
        assert max(abs(other.x - first.x), abs(other.y - first.y)) > field / 2 - 8


def test_the_floor_the_share_and_the_number_leave_objects_out() -> None:
    frames = together(approaching(65, 70, 24, 19), approaching(178, 165, 28, 19))
    first, second = shown(frames)[-1]
    ratio = second.response / first.response
    assert len(shown(frames, PLACES.replaced(share=1.1 * ratio))[-1]) == 1
    assert len(shown(frames, PLACES.replaced(share=0.9 * ratio))[-1]) == 2
    assert len(shown(frames, PLACES.replaced(most=1))[-1]) == 1
    assert len(shown(frames, PLACES.replaced(floor=1.1 * second.response))[-1]) == 1
    assert shown(frames, PLACES.replaced(floor=1.1 * first.response))[-1] == []


def test_nothing_is_found_where_nothing_looms() -> None:
    image = texture(SIZE, 320, 4)
    still = [image[:, :SIZE].copy()] * 10
    drift = [np.ascontiguousarray(image[:, 2 * t : 2 * t + SIZE]) for t in range(14)]
    moving = [disk(SIZE, 60 + 4 * t, 120, 30) for t in range(16)]
    # Once the first frames are over: before, nothing moves, and there is no inhibition.
    receding = approaching(120, 120, 26, 20)[::-1]
    for frames in (still, drift, moving, receding):
        assert not any(shown(frames)[5:])


def test_an_object_that_no_longer_moves_keeps_its_extent() -> None:
    """The unit responds, but no product shows the size of the object."""
    model, places = Opplod((SIZE, SIZE), REFERENCE), Places(PLACES)
    for frame in approaching(120, 120, 24, 18):
        model.step(frame)
    first = copy(places.step(model.units, None, 0)[0])
    still = {phi: np.zeros_like(s) for phi, s in model.units.pathways.items()}
    later = places.step(model.units._replace(pathways=still), None, 1 / RATE)[0]
    assert (later.identity, later.extent) == (first.identity, first.extent)
    assert later.time_to_contact_s is None


def test_growth_is_measured_over_the_time_between_the_pictures_of_the_flow() -> None:
    """At 240 frames/s a frame is compared with the one that is eight frames older."""
    model, places, measured = Opplod((SIZE, SIZE), REFERENCE), Places(PLACES), DenseFlow()
    for frame in approaching(120, 120, 24, 18):
        model.step(frame)
    passed_s = []
    for t in range(12):
        flow = measured.step(disk(SIZE, 120, 120, 50 + t / 2), t / 240)
        [track] = places.step(model.units, flow, t / 240)
        if flow and (found := growth_within(flow, track.x, track.y)):
            time_s, contact_s, _ = track.contact._samples[-1]
            passed_s.append((contact_s - time_s) * found.growth)
    assert passed_s == pytest.approx([min(t, 8) / 240 for t in range(1, 12)])


def test_units_of_the_literal_model_are_objects_with_their_field() -> None:
    params = REFERENCE.replaced(
        judgement="pixelwise", receptive_field=100, cell=1, pool_sigma=0, periphery=0, units="3x3",
        history=0, interpolated="none",
    )  # fmt: skip
    model = Opplod((SIZE, SIZE), params)
    for frame in approaching(120, 120, 24, 18):
        model.step(frame)
    first = Places(PLACES).step(model.units, None, 0)[0]
    assert (first.x, first.y, first.extent.x, first.extent.y) == (120, 120, 50, 50)
    assert first.time_to_contact_s is None
