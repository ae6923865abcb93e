"""Remarks on a stimulus that is valid, but of which the frames do not show all that it states."""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING

from oppload_cli.stimulus.kinematics import ROUNDING_S, motion_times, pose_of
from oppload_cli.stimulus.objects import GRATINGS

if TYPE_CHECKING:
    from collections.abc import Iterator

    from oppload_cli.stimulus.objects import Motion, Object
    from oppload_cli.stimulus.protocol import Protocol


_LATE = "after the end of the motion and is never reached; correct it, or make the motion longer"


def remarks_on(protocol: Protocol) -> list[str]:
    """Return a sentence for each value of a protocol that its frames cannot show."""
    return list(_remarks(protocol))


def _remarks(protocol: Protocol) -> Iterator[str]:
    scene, timing = protocol.scene, protocol.timing
    if scene.cut_s is not None and scene.cut_s >= timing.total_s - ROUNDING_S:
        yield "scene: cut_s is after the end of the clip, and has no effect; correct it"
    if _has_late_points(scene.motion, timing.motion_s):
        yield f"scene: a time of motion.path_s is {_LATE}"
    for obj in protocol.objects:
        for remark in (*_late_changes(protocol, obj), *_too_fast(protocol, obj)):
            yield f"object '{obj.id}': {remark}"


def _late_changes(protocol: Protocol, obj: Object) -> Iterator[str]:
    start, end = motion_times(protocol.timing, obj)
    last_frame = protocol.time_of(protocol.frame_count - 1)
    shown = min(end, last_frame) - start + ROUNDING_S
    if obj.brightness is not None and obj.brightness.start_s > shown:
        yield f"brightness.start_s is {_LATE}"
    # In reverse, the first frame shows the end of the motion.
    steps_shown = end - start + ROUNDING_S if obj.reverse else shown
    if obj.growth is not None and max(obj.growth.times_s, default=0.0) > steps_shown:
        yield f"a time of growth.times_s is {_LATE}"
    if _has_late_points(obj.motion, end - start):
        yield f"a time of motion.path_s is {_LATE}"


def _has_late_points(motion: Motion | None, duration_s: float) -> bool:
    return motion is not None and max(motion.path_s, default=0.0) > duration_s + ROUNDING_S


def _too_fast(protocol: Protocol, obj: Object) -> Iterator[str]:
    if obj.kind in GRATINGS and _greatest_step(protocol, obj) >= 0.5 - 1e-9:
        yield (
            "it moves by half of its period or more from one frame to the next, so that its "
            "direction cannot be seen; lower its speed, or raise display.frame_rate"
        )
    brightness = obj.brightness
    if brightness is not None and (brightness.frequency_hz or 0) > protocol.display.frame_rate / 2:
        yield (
            "brightness.frequency_hz is above half of display.frame_rate, so that the frames "
            "flicker at a lower frequency; change one of them"
        )


def _greatest_step(protocol: Protocol, obj: Object) -> float:
    """Return the longest way of a grating from frame to frame along its axis, in periods."""
    if obj.motion is None and protocol.scene.motion is None:
        return 0.0
    turns = (-obj.plaid_deg / 2, obj.plaid_deg / 2) if obj.kind == "plaid" else (0.0,)
    times = (protocol.time_of(frame) for frame in range(protocol.frame_count))
    longest = 0.0
    for before, after in itertools.pairwise(pose_of(protocol, obj, time) for time in times):
        right, up = (b - a for a, b in zip(before.centre_deg, after.centre_deg, strict=True))
        for turn in turns:
            axis = math.radians(after.orientation_deg + turn)
            way = abs(right * math.cos(axis) + up * math.sin(axis))
            longest = max(longest, way / after.zoom / (obj.period_deg or 1.0))
    return longest
