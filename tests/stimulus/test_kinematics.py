"""Poses of objects: closed forms of time."""

from __future__ import annotations

import dataclasses
import math
from fractions import Fraction
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from oppload_cli.errors import StimulusError
from oppload_cli.stimulus import (
    Brightness,
    Display,
    Growth,
    Motion,
    Object,
    Protocol,
    Renderer,
    Scene,
    Timing,
    frame_truth,
)
from oppload_cli.stimulus.kinematics import pose_of, shaken
from oppload_cli.stimulus.truth import contact_time


def made(obj: Object, rate: object = 30, **tables: Any) -> Protocol:
    values: dict[str, Any] = {"timing": Timing(before_s=0.2, motion_s=1.0, after_s=0.3), **tables}
    display = Display(width=200, height=200, pixels_per_degree=4, frame_rate=Fraction(str(rate)))
    return Protocol(display=display, objects=(obj,), **values)


def disk(**keys: Any) -> Object:
    return Object(id="disk", kind="disk", **keys)


def size(protocol: Protocol, time: float) -> float:
    return pose_of(protocol, protocol.objects[0], time).extent.size


@pytest.mark.parametrize("l_over_v_ms", [10, 40, 200])
def test_constant_approach_is_never_shifted(l_over_v_ms: float) -> None:
    protocol = made(disk(growth=Growth(kind="approach", l_over_v_ms=l_over_v_ms)))
    for time in (0.2, 0.5, 0.9, 1.1, 1.19):
        expected = 2 * math.degrees(math.atan(l_over_v_ms / 1000 / (1.2 - time)))
        assert size(protocol, time) == pytest.approx(expected, abs=1e-12)
    # in the pauses it stands still at the sizes of the motion's start and end
    assert size(protocol, 0.0) == size(protocol, 0.2)
    assert size(protocol, 1.3) == 180


def test_bounds_cut_the_approach_and_do_not_shift_it() -> None:
    growth = Growth(kind="approach", l_over_v_ms=50, least_deg=10, most_deg=40)
    protocol = made(disk(growth=growth))
    free = made(disk(growth=Growth(kind="approach", l_over_v_ms=50)))
    assert size(protocol, 0.2) == 10
    assert size(protocol, 0.9) == size(free, 0.9)
    assert size(protocol, 1.19) == 40
    held, growing = (frame_truth(protocol, frame).objects[0] for frame in (7, 27))
    assert not held.looming
    assert held.edge_speed_deg_s == 0
    assert growing.looming
    assert growing.time_to_contact_s == pytest.approx(1.2 - 27 / 30)


def test_contact_may_lie_beyond_the_clip() -> None:
    growth = Growth(kind="approach", l_over_v_ms=100, contact_s=3.0)
    protocol = made(disk(growth=growth))
    assert size(protocol, 0.7) == pytest.approx(2 * math.degrees(math.atan(0.1 / 2.3)))
    assert frame_truth(protocol, 21).objects[0].time_to_contact_s == pytest.approx(2.3)


@pytest.mark.long
@settings(max_examples=50)
@given(
    frame=st.integers(0, 44),
    speed=st.floats(1, 60),
    l_over_v=st.floats(5, 300),
    shake=st.floats(0, 3),
    turn=st.floats(-90, 90),
)
def test_frame_rate_does_not_matter(
    frame: int, speed: float, l_over_v: float, shake: float, turn: float
) -> None:
    """The same time at 30, 60 and 144 Hz shows the same sizes and places, to 1e-9."""
    time = Fraction(frame, 30)
    motion = Motion(speed_deg_s=speed / 10, shake_deg=shake, rotation_deg_s=turn)
    for growth in (
        Growth(kind="edge-speed", speed_deg_s=speed, end_deg=40),
        Growth(kind="approach", l_over_v_ms=l_over_v),
    ):
        start = 2.0 if growth.kind == "edge-speed" else None
        obj = disk(size_deg=start, growth=growth, motion=motion)
        # 144 / 30 is no integer; a frame at 30, 60 or 144 Hz is one at 720 Hz too
        truths = []
        for rate in (30, 60, 720):
            protocol = made(obj, rate, scene=Scene(motion=motion))
            truths.append(frame_truth(protocol, int(time * rate)))
        for other in truths[1:]:
            assert other.time_s == pytest.approx(truths[0].time_s, abs=1e-12)
            first, second = truths[0].objects[0], other.objects[0]
            assert second.angular_size_deg == pytest.approx(first.angular_size_deg, abs=1e-9)
            assert second.centre_x_px == pytest.approx(first.centre_x_px, abs=1e-9)
            assert second.edge_speed_deg_s == pytest.approx(first.edge_speed_deg_s, abs=1e-6)


def test_receding_is_the_same_backwards() -> None:
    growth = Growth(kind="edge-speed", speed_deg_s=10)
    obj = disk(size_deg=5, growth=growth, motion=Motion(speed_deg_s=4))
    forwards, backwards = made(obj), made(dataclasses.replace(obj, reverse=True))
    for late in (0.0, 0.1, 0.55, 1.0):
        a = pose_of(forwards, forwards.objects[0], 0.2 + late)
        b = pose_of(backwards, backwards.objects[0], 1.2 - late)
        assert b.extent.size == pytest.approx(a.extent.size)
        assert b.centre_deg == pytest.approx(a.centre_deg)
    truth = frame_truth(backwards, 15).objects[0]
    assert truth.edge_speed_deg_s == -10
    assert not truth.looming
    approach = made(disk(growth=Growth(kind="approach", l_over_v_ms=40), reverse=True))
    assert frame_truth(approach, 15).objects[0].time_to_contact_s is None
    assert contact_time(approach) is None
    zoomed = made(
        Object(
            id="ground", kind="texture", contrast=0.3, reverse=True, motion=Motion(zoom_per_s=0.6)
        )
    )
    assert pose_of(zoomed, zoomed.objects[0], 0.5).zoom == pytest.approx(math.exp(0.6 * 0.7))


@pytest.mark.parametrize(("speed", "looms"), [(4.9, True), (5.1, False)])
def test_a_disk_that_shrinks_backwards_passes_as_one_that_grows(speed: float, looms: bool) -> None:
    """Its edges grow by 5 deg/s to both sides; moved aside faster, both go to the same side."""
    growth = Growth(kind="edge-speed", speed_deg_s=5, end_deg=2)
    obj = disk(size_deg=12, growth=growth, motion=Motion(speed_deg_s=speed), reverse=True)
    truth = frame_truth(made(obj), 15)
    assert truth.objects[0].edge_speed_deg_s == 5
    assert truth.looming is looms


@pytest.mark.parametrize(
    ("moves_s", "reverse", "looms"),
    [
        ((0.05, 0.2), False, True),  # before the growth
        ((0.2, 0.3), False, False),
        ((0.4, 0.5), False, False),  # while the growth pauses
        ((0.6, 0.7), False, False),
        ((0.7, 0.8), False, True),
        ((0.8, 0.9), False, True),
        ((0.8, 0.9), True, False),  # backwards, the disk grows where it shrinks otherwise
        ((0.6, 0.8), True, True),
    ],
)
def test_movement_counts_while_a_path_of_sizes_grows(
    moves_s: tuple[float, ...], reverse: bool, looms: bool
) -> None:
    """A disk grows by 20 degrees from 0.2 to 0.7 s, and shrinks by 20 degrees from 0.8 to 0.9 s."""
    growth = Growth(
        kind="path",
        times_s=(0.2, 0.4, 0.5, 0.7, 0.8, 0.9),
        sizes_deg=(5, 15, 15, 25, 25, 5),
    )
    aside = Motion(path_s=moves_s, path_deg=((0, 0), (11, 0)))
    protocol = made(disk(size_deg=5, growth=growth, motion=aside, reverse=reverse))
    assert any(frame_truth(protocol, frame).looming for frame in range(45)) is looms


def test_a_growth_played_backwards_moves_from_its_first_frame_on() -> None:
    """The growth takes the complete second; forwards it moves in the frames 6 to 35, too."""
    obj = disk(size_deg=20, growth=Growth(kind="edge-speed", speed_deg_s=5, end_deg=10))
    for reverse in (False, True):
        protocol = made(dataclasses.replace(obj, reverse=reverse))
        truths = [frame_truth(protocol, frame) for frame in range(protocol.frame_count)]
        moving = [truth.frame for truth in truths if truth.objects[0].edge_speed_deg_s]
        assert moving == list(range(6, 36))
        assert [truth.frame for truth in truths if truth.looming] == (moving if reverse else [])


def test_at_a_point_of_a_path_played_backwards_the_speed_is_that_of_the_next_way() -> None:
    path = Motion(path_s=(0.0, 0.5, 1.0), path_deg=((0, 0), (4, 0), (4, 1)))
    protocol = made(disk(size_deg=5, motion=path, reverse=True))
    speeds = [frame_truth(protocol, frame).objects[0].edge_speed_deg_s for frame in range(45)]
    assert speeds == pytest.approx([0] * 6 + [2] * 15 + [8] * 15 + [0] * 9)


def test_one_end_only() -> None:
    growth = Growth(kind="edge-speed", speed_deg_s=20, sides="forward", end_deg=20)
    bar = Object(id="bar", kind="bar", size_deg=10, width_deg=4, axis_deg=90, growth=growth)
    pose = pose_of(made(bar), bar, 0.2 + 0.25)
    assert (pose.extent.backward, pose.extent.forward) == (5, 10)
    truth = frame_truth(made(bar), 60 // 4).objects[0]
    assert truth.angular_size_deg is not None
    assert truth.angular_size_deg == pytest.approx(min(20, 10 + 20 * (0.5 - 0.2)))
    # the middle as drawn moves up, at half the speed
    assert truth.centre_x_px == pytest.approx(100)
    assert truth.centre_y_px == pytest.approx(100 - 4 * (truth.angular_size_deg - 10) / 2)


def test_an_end_that_draws_back_has_the_speed_of_the_edge() -> None:
    growth = Growth(kind="edge-speed", speed_deg_s=10, sides="forward", end_deg=4)
    bar = made(Object(id="bar", kind="bar", size_deg=14, width_deg=4, growth=growth))
    assert size(bar, 0.7) == 9
    assert frame_truth(bar, 15).objects[0].edge_speed_deg_s == -10


def test_shrinking_to_a_smaller_end() -> None:
    growth = Growth(kind="edge-speed", speed_deg_s=10, end_deg=4)
    protocol = made(disk(size_deg=14, growth=growth))
    assert size(protocol, 0.4) == pytest.approx(10)
    assert size(protocol, 1.1) == 4
    assert frame_truth(protocol, 10).objects[0].edge_speed_deg_s == -10


def test_steps() -> None:
    growth = Growth(kind="steps", sizes_deg=(10, 20), times_s=(0.2, 0.5))
    protocol = made(disk(size_deg=5, growth=growth))
    assert [size(protocol, t) for t in (0, 0.39, 0.41, 0.69, 0.71, 1.4)] == [5, 5, 10, 10, 20, 20]
    assert not frame_truth(protocol, 14).objects[0].looming


def test_a_size_along_a_path() -> None:
    """It grows, pauses, and shrinks."""
    growth = Growth(kind="path", sizes_deg=(20, 20, 12), times_s=(0.5, 0.7, 0.9))
    protocol = made(disk(size_deg=10, growth=growth))  # its motion begins at 0.2 s
    sizes = [size(protocol, t) for t in (0, 0.2, 0.45, 0.7, 0.8, 1.0, 1.1, 1.5)]
    assert sizes == pytest.approx([10, 10, 15, 20, 20, 16, 12, 12])
    # The speed is that of each edge, so half of that of the size.
    truths = [frame_truth(protocol, index).objects[0] for index in (5, 6, 20, 21, 26, 27, 33)]
    speeds = [truth.edge_speed_deg_s for truth in truths]
    assert speeds == pytest.approx([0, 10, 10, 0, 0, -20, 0])
    assert [truth.looming for truth in truths] == [False, True, True, False, False, False, False]
    assert contact_time(protocol) is None
    backwards = made(dataclasses.replace(protocol.objects[0], reverse=True))
    assert size(backwards, 0.4) == pytest.approx(size(protocol, 1.0))
    with pytest.raises(StimulusError, match="times_s of a path must begin after 0"):
        Growth(kind="path", sizes_deg=(20,), times_s=(0,))
    for times_s in ((0.5, 0.5), (0.5, 0.4)):
        with pytest.raises(StimulusError, match="times_s must rise from value to value"):
            Growth(kind="steps", sizes_deg=(10, 20), times_s=times_s)


def test_a_step_at_the_start_of_the_motion_comes_after_the_pause() -> None:
    obj = disk(size_deg=0, growth=Growth(kind="steps", sizes_deg=(10, 20), times_s=(0, 0.4)))
    protocol = made(obj)  # its motion begins at 0.2 s and ends at 1.2 s
    assert [size(protocol, t) for t in (0, 0.19, 0.2, 0.59, 0.61)] == [0, 0, 10, 10, 20]
    backwards = made(dataclasses.replace(obj, reverse=True))
    assert [size(backwards, t) for t in (0, 0.79, 0.81, 1.19, 1.21)] == [20, 20, 10, 10, 0]


def test_onset_duration_appearance() -> None:
    obj = disk(
        size_deg=8,
        onset_s=0.3,
        duration_s=0.4,
        appears="onset",
        vanishes="end",
        motion=Motion(speed_deg_s=10, direction_deg=90),
    )
    protocol = made(obj)
    seen = [pose_of(protocol, obj, time).visible for time in (0.49, 0.51, 0.89, 0.91)]
    assert seen == [False, True, True, False]
    assert pose_of(protocol, obj, 0.7).centre_deg == pytest.approx((0, 2))


@pytest.mark.parametrize(
    ("before", "onset", "lasts", "first", "last"),
    [(0.1, 0.0, 0.2, 3, 8), (0.2, 0.0, 0.4, 6, 17), (0.1, 0.2, 0.5, 9, 23), (0.1, 0.2, 0.4, 9, 20)],
)
def test_motions_start_and_end_at_the_frames_of_their_times(
    before: float, onset: float, lasts: float, first: int, last: int
) -> None:
    """0.1 + 0.2 is more than 0.3 as a sum of floats, and 9 / 30 is 0.3."""
    obj = disk(
        growth=Growth(kind="approach", l_over_v_ms=40),
        onset_s=onset,
        duration_s=lasts if onset else None,
        appears="onset",
        vanishes="end",
    )
    timing = Timing(before_s=before, motion_s=1.0 if onset else lasts, after_s=0.3)
    protocol = made(obj, timing=timing)
    truths = [frame_truth(protocol, frame) for frame in range(protocol.frame_count)]
    assert [truth.frame for truth in truths if truth.looming] == list(range(first, last + 1))
    assert [one.frame for one in truths if one.objects[0].visible] == list(range(first, last + 1))
    lefts = [one.objects[0].time_to_contact_s for one in truths]
    assert min(left for left in lefts if left is not None) == pytest.approx(1 / 30)
    assert timing.total_s == protocol.time_of(protocol.frame_count)


def test_changes_within_a_motion_come_at_the_frames_of_their_times() -> None:
    """0.3 - 0.1 is less than 0.2 as a difference of floats."""
    obj = disk(
        size_deg=8,
        luminance=0.2,
        growth=Growth(kind="edge-speed", speed_deg_s=10, end_deg=12),
        brightness=Brightness(kind="step", to=0.8, start_s=0.2),
    )
    protocol = made(obj, timing=Timing(before_s=0.1, motion_s=1.0))
    assert [frame_truth(protocol, frame).looming for frame in (8, 9)] == [True, False]
    assert [pose_of(protocol, obj, time).luminance for time in (8 / 30, 9 / 30)] == [0.2, 0.8]
    flicker = Brightness(kind="flicker", to=0.8, frequency_hz=2.5)  # half a cycle is 0.2 s
    flickers = dataclasses.replace(obj, brightness=flicker)
    assert [pose_of(protocol, flickers, time).luminance for time in (8 / 30, 9 / 30)] == [0.2, 0.8]
    moved = disk(size_deg=8, motion=Motion(path_deg=((0, 0), (4, 0)), path_s=(0, 0.2)))
    protocol = made(moved, timing=Timing(before_s=0.1, motion_s=1.0))
    speeds = [frame_truth(protocol, frame).objects[0].edge_speed_deg_s for frame in (8, 9)]
    assert speeds == [pytest.approx(20), 0]
    steps = Growth(kind="steps", sizes_deg=(12,), times_s=(0.2,))
    protocol = made(disk(size_deg=8, growth=steps), timing=Timing(before_s=0.1, motion_s=1.0))
    assert [size(protocol, time) for time in (8 / 30, 9 / 30)] == [8, 12]


def test_scene_turns_and_shifts_everything() -> None:
    obj = disk(size_deg=8, centre_deg=(10, 0), motion=Motion(speed_deg_s=5))
    protocol = made(obj, scene=Scene(centre_deg=(1, 2), rotation_deg=90))
    pose = pose_of(protocol, obj, 0.2 + 0.4)
    assert pose.centre_deg == pytest.approx((1, 2 + 12))
    assert pose.velocity_deg_s == pytest.approx((0, 5))
    # The axis of the scene is its turn; a stated direction is that on the display.
    for direction, moved in ((None, (1, 14 + 4)), (0, (1 + 4, 14))):
        motion = Motion(speed_deg_s=10, direction_deg=direction)
        scene = dataclasses.replace(protocol.scene, motion=motion)
        assert pose_of(made(obj, scene=scene), obj, 0.6).centre_deg == pytest.approx(moved)


def test_a_bar_that_grows_into_the_display_by_its_far_end_is_inside() -> None:
    growth = Growth(kind="edge-speed", speed_deg_s=20, sides="backward")
    bar = Object(id="b", kind="bar", size_deg=4, width_deg=4, centre_deg=(40, 0), growth=growth)
    truth = frame_truth(made(bar), 36).objects[0]
    assert truth.centre_x_px == pytest.approx(100 + 4 * (40 - 10))


def test_velocity_is_the_change_of_the_place_while_the_motion_lasts() -> None:
    """A central difference gives the same for an object and a scene that move, turn and shake."""
    obj = disk(size_deg=8, centre_deg=(10, 3), motion=Motion(speed_deg_s=5, shake_deg=1))
    motion = Motion(speed_deg_s=7, direction_deg=20, rotation_deg_s=30, shake_deg=2)
    protocol = made(obj, scene=Scene(centre_deg=(1, 2), rotation_deg=40, motion=motion))
    before, now, after = (pose_of(protocol, obj, 0.7 + step) for step in (-1e-5, 0, 1e-5))
    change = [(b - a) / 2e-5 for a, b in zip(before.centre_deg, after.centre_deg, strict=True)]
    assert now.velocity_deg_s == pytest.approx(change, rel=1e-6)
    assert now.orientation_deg == 40 + 0.5 * 30
    for paused in (0.1, 1.2, 1.3):
        assert pose_of(protocol, obj, paused).velocity_deg_s == (0, 0)
    assert pose_of(protocol, obj, 1.2) == pose_of(protocol, obj, 1.4)


def test_path_is_followed() -> None:
    motion = Motion(path_deg=((0, 0), (4, 0), (4, 6)), path_s=(0, 0.4, 0.8))
    obj = disk(size_deg=8, motion=motion)
    early, later, end = (pose_of(made(obj), obj, 0.2 + time) for time in (0.2, 0.6, 5))
    assert early.centre_deg == pytest.approx((2, 0))
    assert early.velocity_deg_s == pytest.approx((10, 0))
    assert later.centre_deg == pytest.approx((4, 3))
    assert later.velocity_deg_s == pytest.approx((0, 15))
    assert end.centre_deg == (4, 6)


def test_shake_has_the_stated_size_and_starts_at_the_middle() -> None:
    obj = disk(size_deg=8, motion=Motion(shake_deg=2, shake_hz=5))
    protocol = made(obj, timing=Timing(motion_s=40))
    places = [pose_of(protocol, obj, index / 100).centre_deg for index in range(4000)]
    assert places[0] == pytest.approx((0, 0), abs=0)
    middle = [sum(place[axis] for place in places) / len(places) for axis in (0, 1)]
    squares = [math.dist(place, middle) ** 2 for place in places]
    assert math.sqrt(sum(squares) / len(squares)) == pytest.approx(2, rel=0.05)
    # The frequencies of its waves are spread evenly from 0.5 to 1.5 times the middle one.
    motion = Motion(shake_deg=2, shake_hz=5)
    speeds = [math.hypot(*shaken(motion, 7.3, str(seed))[1]) for seed in range(1000)]
    spread = math.sqrt(sum(speed**2 for speed in speeds) / len(speeds))
    assert spread == pytest.approx(2 * 2 * math.pi * 5 * math.sqrt(13 / 12), rel=0.05)


def test_shake_is_smooth_and_differs_from_object_to_object() -> None:
    motion = Motion(shake_deg=2)
    first, second = (Object(id=name, kind="disk", size_deg=4, motion=motion) for name in "ab")
    protocol = made(first)
    here, soon = (pose_of(protocol, first, time) for time in (0.7, 0.7 + 1e-5))
    moved = math.dist(here.centre_deg, soon.centre_deg)
    assert moved == pytest.approx(math.hypot(*here.velocity_deg_s) * 1e-5, rel=0.01)
    assert pose_of(protocol, second, 0.7).centre_deg != here.centre_deg
    assert pose_of(made(first, seed=1), first, 0.7).centre_deg != here.centre_deg


def test_brightness() -> None:
    def at(brightness: Brightness, *times: float) -> list[float]:
        obj = disk(size_deg=10, luminance=0.2, brightness=brightness)
        return [pose_of(made(obj), obj, time).luminance for time in times]

    assert at(Brightness(kind="step", to=0.8), 0.1, 0.3, 1.4) == [0.2, 0.8, 0.8]
    ramp = Brightness(kind="ramp", to=0.8, start_s=0.2, duration_s=0.4)
    assert at(ramp, 0.0, 0.3, 0.6, 0.9) == pytest.approx([0.2, 0.2, 0.5, 0.8])
    even = Brightness(kind="ramp", to=0.8)
    assert at(even, 0.2, 0.7, 1.2) == pytest.approx([0.2, 0.5, 0.8])
    late = Brightness(kind="ramp", to=0.8, start_s=0.5)
    assert at(late, 0.7, 0.95, 1.2) == pytest.approx([0.2, 0.5, 0.8])
    square = Brightness(kind="flicker", to=0.8, frequency_hz=2)
    assert at(square, 0.1, 0.21, 0.5, 0.75) == [0.2, 0.2, 0.8, 0.2]
    assert at(square, 1.19, 1.45) == [0.8, 0.2]  # from the end of the motion on it stays
    sine = Brightness(kind="flicker", to=0.8, frequency_hz=2, waveform="sine")
    assert at(sine, 0.2, 0.45, 0.7) == pytest.approx([0.2, 0.8, 0.2])


@pytest.mark.parametrize("projection", ["flat", "perspective"])
@pytest.mark.parametrize("kind", ["disk", "square"])
def test_a_shape_that_dims_gives_as_much_light_beyond_the_display_too(
    kind: str, projection: str
) -> None:
    display = Display(width=120, height=90, pixels_per_degree=2, projection=projection)
    approach: dict[str, Any] = {"l_over_v_ms": 60, "most_deg": 100}
    where: dict[str, Any] = {
        "centre_deg": (20.0, -8.0),
        "axis_deg": 30.0,
        "id": "shape",
        "kind": kind,
    }
    near = Object(**where, luminance=0.1, growth=Growth(kind="approach", **approach))
    dimming = Brightness(kind="approach", to=0.1, **approach)
    still = Object(**where, luminance=1.0, size_deg=100, brightness=dimming)
    one, other = (
        Renderer(Protocol(display=display, timing=Timing(motion_s=1.0), objects=(obj,)))
        for obj in (near, still)
    )
    light = [[float(renderer.luminance(i).sum()) for i in range(30)] for renderer in (one, other)]
    assert light[1] == pytest.approx(light[0], rel=1e-5)


@pytest.mark.parametrize("projection", ["flat", "perspective"])
def test_a_disk_that_dims_as_another_approaches_gives_as_much_light(projection: str) -> None:
    approach: dict[str, Any] = {"l_over_v_ms": 60, "least_deg": 8, "most_deg": 40}
    display = Display(
        width=240, height=240, pixels_per_degree=4, background=0.8, projection=projection
    )
    timing = Timing(before_s=0.2, motion_s=1.0, after_s=0.2)
    near = disk(luminance=0.1, growth=Growth(kind="approach", **approach))
    dimming = Brightness(kind="approach", to=0.1, **approach)
    still = disk(luminance=0.8, size_deg=40, brightness=dimming)
    one, other = (
        Renderer(Protocol(display=display, timing=timing, objects=(obj,))) for obj in (near, still)
    )
    light = [[float(renderer.luminance(i).sum()) for i in range(42)] for renderer in (one, other)]
    assert light[1] == pytest.approx(light[0], rel=1e-5)
    assert light[0][0] > 1.2 * light[0][-1]
    later = dataclasses.replace(still, brightness=dataclasses.replace(dimming, contact_s=1.6))
    protocol = Protocol(display=display, timing=timing, objects=(later,))
    half = math.degrees(math.atan(0.06 / 0.6))
    share = half / 20 if projection == "flat" else 0.1 / math.tan(math.radians(20))
    assert pose_of(protocol, later, 1.0).luminance == pytest.approx(0.8 - 0.7 * share**2)
    with pytest.raises(StimulusError, match="least_deg must be below most_deg"):
        Brightness(kind="approach", to=0, l_over_v_ms=60, least_deg=50, most_deg=40)
