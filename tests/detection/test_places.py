from __future__ import annotations

from copy import copy

import numpy as np
import pytest

from oppload_cli.detection.contact import PlaceParams
from oppload_cli.detection.places import Places
from oppload_cli.models.opplod_paper import OpplodPaper, OpplodPaperParams
from oppload_cli.models.opplod_reference import OpplodReference, OpplodReferenceParams
from oppload_cli.motion.flow import DenseFlow
from oppload_cli.motion.growth import motion_about
from tests.detection.showing import LENGTH, RATE, SIZE, approaching, remaining, shown, together
from tests.media import disk, texture

PLACES = PlaceParams().of(OpplodReference.least_object)


def test_a_disk_is_one_object_with_its_focus_and_its_box() -> None:
    """Patches of the search are 32 px wide, so that the box is larger than the disk."""
    found = shown(approaching(131, 103, 24, 20))
    assert [len(tracks) for tracks in found[12:]] == [1] * 8
    for t, [track] in enumerate(found[12:], 12):
        assert track.identity == 1
        assert (track.x, track.y) == pytest.approx((131, 103), abs=4)
        assert track.box.centre == pytest.approx((131, 103), abs=16)
        mean = 2 * LENGTH / (remaining(t, 24) + 0.5 / RATE)
        assert (track.box.width, track.box.height) == pytest.approx((mean, mean), abs=36)


@pytest.mark.parametrize(("width", "height"), [(1.0, 0.6), (0.6, 1.0)])
def test_a_box_has_the_width_and_the_height_of_an_ellipse(width: float, height: float) -> None:
    across = np.arange(SIZE) + 0.5 - 120
    found = []
    for t in range(16):
        radius = LENGTH / remaining(t, 22)
        distance = np.hypot(across[None, :] / width, across[:, None] / height)
        found.append((1 - np.clip(radius - distance + 0.5, 0, 1)).astype(np.float32))
    [track] = shown(found)[-1]
    mean = 2 * LENGTH / (remaining(15, 22) + 0.5 / RATE)
    assert track.box.width == pytest.approx(width * mean, rel=0.3)
    assert track.box.height == pytest.approx(height * mean, rel=0.3)
    assert (track.box.width > track.box.height) == (width > height)


def test_an_object_larger_than_the_field_keeps_its_focus_and_number() -> None:
    """From frame 20 on its edge is out of the field of the unit at its focus."""
    found = shown(approaching(120, 120, 26, 23))
    for t in (20, 21, 22):
        first = found[t][0]
        assert first.identity == 1
        assert (first.x, first.y) == pytest.approx((120, 120), abs=12)
        mean = 2 * LENGTH / (remaining(t, 26) + 0.5 / RATE)
        assert (first.box.width, first.box.height) == pytest.approx((mean, mean), rel=0.35)


def test_an_object_larger_than_the_field_is_followed() -> None:
    """Its edge is out of the field from frame 5 on."""
    found = shown([disk(SIZE, 90 + 1.5 * t, 120, 40 + 2.5 * t) for t in range(24)])
    for tracks in found[10:]:
        assert [track.identity for track in tracks] == [1]
        # The point that does not move is to the left of the middle: 36 px at a radius of 60.
        assert tracks[0].y == pytest.approx(120, abs=10)


def test_two_disks_are_two_objects_that_keep_their_numbers() -> None:
    found = shown(together(approaching(65, 70, 26, 21), approaching(178, 165, 28, 21)))
    both = [{track.identity: track for track in tracks} for tracks in found[15:]]
    assert [sorted(tracks) for tracks in both] == [[1, 2]] * 6
    for tracks in both:
        assert (tracks[1].x, tracks[1].y) == pytest.approx((65, 70), abs=5)
        assert (tracks[2].x, tracks[2].y) == pytest.approx((178, 165), abs=5)
    assert all(tracks[0].response >= tracks[1].response for tracks in found[15:])


def test_a_moving_object_keeps_its_number() -> None:
    """Its focus is drawn to the point that does not move, which is to the left of the middle."""
    frames = [disk(SIZE, 60 + 4 * t, 120, LENGTH / remaining(t, 24)) for t in range(19)]
    found = shown(frames)
    assert {track.identity for tracks in found for track in tracks} == {1}
    assert found[-1][0].x == pytest.approx(118, abs=5)
    assert found[-1][0].box.centre[0] == pytest.approx(60 + 4 * 17.5, abs=10)


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
    model = OpplodReference((SIZE, 300), OpplodReferenceParams(history=0))
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
    every = PlaceParams(share=0)
    first, second = shown(frames, every)[-1]
    ratio = second.response / first.response
    assert len(shown(frames, every.replaced(share=1.1 * ratio))[-1]) == 1
    assert len(shown(frames, every.replaced(share=0.9 * ratio))[-1]) == 2
    assert len(shown(frames, every.replaced(most=1))[-1]) == 1
    assert len(shown(frames, every.replaced(floor=1.1 * second.response))[-1]) == 1
    assert shown(frames, every.replaced(floor=1.1 * first.response))[-1] == []


def test_nothing_is_found_where_nothing_looms() -> None:
    image = texture(SIZE, 320, 4)
    still = [image[:, :SIZE].copy()] * 10
    drift = [np.ascontiguousarray(image[:, 2 * t : 2 * t + SIZE]) for t in range(14)]
    moving = [disk(SIZE, 60 + 4 * t, 120, 30) for t in range(16)]
    # Once the first frames are over: before, nothing moves, and there is no inhibition.
    receding = approaching(120, 120, 26, 20)[::-1]
    for frames in (still, drift, moving, receding):
        assert not any(shown(frames)[5:])


def test_an_object_that_no_longer_moves_keeps_its_box() -> None:
    frames = approaching(120, 120, 24, 18)
    model, places, measured = OpplodReference((SIZE, SIZE)), Places(PLACES), DenseFlow()
    for t, frame in enumerate(frames):
        flow = measured.step(frame, t / RATE)
        model.step(frame)
        tracks = places.step(model.units, flow, t / RATE)
    [first] = map(copy, tracks)
    assert first.time_to_contact_s is not None
    still = measured.step(frames[-1], 18 / RATE)
    later = places.step(model.units, still, 18 / RATE)[0]
    assert (later.identity, later.box) == (first.identity, first.box)
    assert later.time_to_contact_s is None


def test_growth_is_measured_over_the_time_between_the_pictures_of_the_flow() -> None:
    """At 240 frames/s a frame is compared with the one that is eight frames older."""
    model, places, measured = OpplodReference((SIZE, SIZE)), Places(PLACES), DenseFlow()
    for frame in approaching(120, 120, 24, 18):
        model.step(frame)
    passed_s = []
    for t in range(12):
        flow = measured.step(disk(SIZE, 120, 120, 50 + t / 2), t / 240)
        [track] = places.step(model.units, flow, t / 240)
        if flow and (found := motion_about(flow, track.x, track.y)):
            time_s, contact_s, _ = track.contact._samples[-1]
            passed_s.append((contact_s - time_s) * found.factor.real)
    assert passed_s == pytest.approx([min(t, 8) / 240 for t in range(1, 12)])


def test_units_of_the_literal_model_are_objects_with_their_field() -> None:
    params = OpplodPaperParams(receptive_field=100, units="3x3")
    model = OpplodPaper((SIZE, SIZE), params)
    for frame in approaching(120, 120, 24, 18):
        model.step(frame)
    first = Places(PLACES).step(model.units, None, 0)[0]
    assert (first.x, first.y, [*first.box]) == (120, 120, [70, 70, 100, 100])
    assert first.time_to_contact_s is None
