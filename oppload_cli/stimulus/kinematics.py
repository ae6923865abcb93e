"""The pose of an object at any time of the clip: its place, size, speeds and luminance.

Every value is a closed formula of time and does not depend on the frame before. A protocol
therefore has the same sizes at the same times at every frame rate.
"""

from __future__ import annotations

import bisect
import itertools
import math
import random
from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING

from oppload_cli.stimulus.courses import HIT_SIZES
from oppload_cli.stimulus.geometry import Extent, Pose, Projection
from oppload_cli.stimulus.objects import (
    FIELDS,
    LOOMING,
    SIZED,
    Brightness,
    Growth,
    Motion,
    Object,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from oppload_cli.stimulus.protocol_tables import Camera, ProtocolTables

_Vector = tuple[float, float]
_STILL: _Vector = (0.0, 0.0)
# Times are rounded. A change at the time of a frame counts as done in this frame.
ROUNDING_S = 1e-9


def pose_of(protocol: ProtocolTables, obj: Object, time: float) -> Pose:
    """Return the pose of an object of the protocol at a time, in seconds of the clip."""
    start, end = protocol.motion_of(obj)
    moving = start <= time < end
    elapsed = min(max(time - start, 0.0), end - start)
    # With `reverse`, growth and movement run from their end to their start.
    phase = end - start - elapsed if obj.reverse else elapsed
    sign = (-1.0 if obj.reverse else 1.0) if moving else 0.0
    growth_phase = phase
    if obj.growth is not None and obj.growth.kind == "steps":
        # In the pause, a step of the size at the start of the motion has not yet come.
        growth_phase = min(phase, end - time if obj.reverse else time - start)
    extent = _extent_of(protocol, obj, growth_phase).with_speeds_times(sign)
    travel, velocity, turn = _movement(
        obj.motion, phase, obj.axis_deg, f"{protocol.seed}/{obj.id}", backwards=obj.reverse
    )
    x, y = obj.centre_deg[0] + travel[0], obj.centre_deg[1] + travel[1]
    centre, moved = _in_scene(protocol, (x, y), (sign * velocity[0], sign * velocity[1]), time)
    speed = extent.forward_speed + extent.backward_speed
    contact = contact_of_shape(protocol, obj) if moving else None
    scene_turn = _scene_turn(protocol, time)
    pose = Pose(
        visible=is_drawn(protocol, obj, time),
        centre_deg=centre,
        velocity_deg_s=moved,
        orientation_deg=obj.axis_deg + turn + scene_turn,
        extent=extent,
        luminance=obj.base_luminance,
        zoom=math.exp(obj.motion.zoom_per_s * phase) if obj.motion else 1.0,
        travel_deg=travel,
        scene_turn_deg=scene_turn,
        contact_in_s=None if contact is None else contact - time,
        looming=obj.kind in LOOMING and speed > 0 and not _passes(protocol, obj),
    )
    if obj.brightness is None:
        return pose
    return replace(pose, luminance=_luminance_at(protocol, obj, obj.brightness, time, pose))


def aperture_centre(protocol: ProtocolTables, obj: Object) -> tuple[float, float]:
    """Return the middle [right, up] of a pattern's aperture in degrees; motions do not move it."""
    scene = protocol.scene
    x, y = _turned(obj.centre_deg, math.radians(scene.rotation_deg))
    return x + scene.centre_deg[0], y + scene.centre_deg[1]


def shape_may_show(protocol: ProtocolTables, obj: Object, time: float) -> bool:
    """Tell whether a shape or a pattern may touch the display at a time, in seconds of the clip.

    The answer is False if the object is not drawn, or if the circle around a shape is outside the
    display. A pattern always touches the display.
    """
    pose = pose_of(protocol, obj, time)
    if not pose.visible:
        return False
    if obj.kind in FIELDS or obj.kind == "edge":
        return True
    display = protocol.display
    projection = Projection.of(display)
    reach = max(pose.extent.forward, pose.extent.backward)
    across = reach if obj.kind == "square" else (obj.width_deg or 0.0) / 2
    if pose.extent.size <= 0:
        return False
    radius = math.hypot(projection.reach(reach), projection.reach(across))
    x, y = projection.to_px(*pose.centre_deg)
    dx = max(-x, 0.0, x - display.width)
    dy = max(-y, 0.0, y - display.height)
    return math.hypot(dx, dy) < radius


def is_drawn(protocol: ProtocolTables, obj: Object, time: float) -> bool:
    """Tell whether an object is drawn at a time, in seconds of the clip."""
    start, end = protocol.motion_of(obj)
    appeared = obj.appears == "start" or time >= start
    return appeared and (obj.vanishes == "never" or time < end)


def contact_of_shape(protocol: ProtocolTables, obj: Object) -> float | None:
    """Return when a shape reaches the observer, in seconds of the clip.

    None if it does not approach, or if it passes.
    """
    if obj.kind not in LOOMING or obj.reverse or _passes(protocol, obj):
        return None
    return _approach_contact(protocol, obj)


def _approach_contact(protocol: ProtocolTables, obj: Object) -> float | None:
    """Return when a shape that approaches would reach the observer; None for other growths."""
    if obj.growth is None or obj.growth.kind != "approach":
        return None
    return protocol.motion_of(obj)[1] if obj.growth.contact_s is None else obj.growth.contact_s


def _passes(protocol: ProtocolTables, obj: Object) -> bool:
    """Tell whether a shape that grows moves sideways so far that it passes the observer.

    An object on a straight course passes at a distance, in its own sizes, that equals the movement
    of its middle divided by the growth of its size, both as angles (Regan and Kaushal 1994, Vision
    Res 34:163). Above half a size, all of its edges move to the same side. The movement counts
    from the start to the end of the growth. The shake of the object and the movement of the scene
    do not count, because they show the movement of a camera.
    """
    if obj.growth is None or obj.motion is None:
        return False
    motion = replace(obj.motion, shake_deg=0.0)
    before, after = (
        (_movement(motion, time, obj.axis_deg, "")[0], _extent_of(protocol, obj, time).size)
        for time in _growth_times(protocol, obj, obj.growth)
    )
    grown = (before[1] - after[1]) if obj.reverse else (after[1] - before[1])
    return 0 < HIT_SIZES * grown < math.dist(before[0], after[0])


def _growth_times(protocol: ProtocolTables, obj: Object, growth: Growth) -> tuple[float, float]:
    """Return when a growth starts and ends, in seconds after the start of the motion."""
    start, end = protocol.motion_of(obj)
    first, last = 0.0, end - start
    contact = _approach_contact(protocol, obj)
    if contact is not None:
        ratio = (growth.l_over_v_ms or 0.0) / 1000
        if growth.least_deg > 0:
            least = math.tan(math.radians(growth.least_deg / 2))
            first = max(first, contact - start - ratio / least)
        last = min(last, contact - start - ratio / math.tan(math.radians(growth.most_deg / 2)))
    elif growth.kind == "edge-speed" and growth.end_deg is not None:
        edges = (growth.speed_deg_s or 0.0) * (2 if growth.sides == "both" else 1)
        last = min(last, abs(growth.end_deg - (obj.size_deg or 0.0)) / edges)
    elif growth.kind == "path":
        sizes, times = _points_of(growth, obj.size_deg or 0.0)
        sign = -1 if obj.reverse else 1
        steps = (sign * (after - before) for before, after in itertools.pairwise(sizes))
        rising = [line for line, step in enumerate(steps) if step > 0]
        if rising:
            first, last = times[rising[0]], min(last, times[rising[-1] + 1])
    return min(first, last), last


def _in_scene(
    protocol: ProtocolTables, point: _Vector, velocity: _Vector, time: float
) -> tuple[_Vector, _Vector]:
    """Turn and shift a point and its velocity by the turn and the shift of the scene."""
    scene, timing = protocol.scene, protocol.timing
    angle = math.radians(_scene_turn(protocol, time))
    x, y = _turned(point, angle)
    vx, vy = _turned(velocity, angle)
    (dx, dy), (dvx, dvy), _ = _movement(
        scene.motion, timing.elapsed(time), scene.rotation_deg, f"{protocol.seed}/scene"
    )
    if scene.motion is not None and timing.before_s <= time < timing.end_s:
        spin = math.radians(scene.motion.rotation_deg_s)
        vx, vy = vx + dvx - spin * y, vy + dvy + spin * x
    return (x + scene.centre_deg[0] + dx, y + scene.centre_deg[1] + dy), (vx, vy)


def _scene_turn(protocol: ProtocolTables, time: float) -> float:
    scene = protocol.scene
    spin = scene.motion.rotation_deg_s if scene.motion is not None else 0.0
    return scene.rotation_deg + spin * protocol.timing.elapsed(time)


def _turned(point: _Vector, angle: float) -> _Vector:
    if angle == 0:
        return point
    x, y = point
    return x * math.cos(angle) - y * math.sin(angle), x * math.sin(angle) + y * math.cos(angle)


def _movement(
    motion: Motion | None, elapsed: float, axis_deg: float, seed: str, *, backwards: bool = False
) -> tuple[_Vector, _Vector, float]:
    """Return displacement [right, up] in degrees, velocity in deg/s, and turn in degrees.

    `axis_deg` is the direction of a motion that states none; the text `seed` sets the shake.
    `backwards` tells whether the motion is played backwards, so that `elapsed` falls.
    """
    if motion is None:
        return _STILL, _STILL, 0.0
    heading = math.radians(axis_deg if motion.direction_deg is None else motion.direction_deg)
    speed = motion.speed_deg_s
    x_speed, y_speed = speed * math.cos(heading), speed * math.sin(heading)
    x, y = x_speed * elapsed, y_speed * elapsed
    for (dx, dy), (vx, vy) in (_path(motion, elapsed, backwards), shaken(motion, elapsed, seed)):
        x, y, x_speed, y_speed = x + dx, y + dy, x_speed + vx, y_speed + vy
    return (x, y), (x_speed, y_speed), motion.rotation_deg_s * elapsed


def _luminance_at(
    protocol: ProtocolTables, obj: Object, brightness: Brightness, time: float, pose: Pose
) -> float:
    """Return the luminance of an object in a pose at a time, in seconds of the clip."""
    base = obj.base_luminance
    start, end = protocol.motion_of(obj)
    elapsed = min(time, end) - start
    if brightness.kind != "approach" and elapsed + ROUNDING_S < brightness.start_s:
        return base
    since = max(elapsed - brightness.start_s, 0.0)
    if brightness.kind == "step":
        share = 1.0
    elif brightness.kind == "ramp":
        length = brightness.duration_s or max(end - start - brightness.start_s, 1e-9)
        share = min(since / length, 1.0)
    elif brightness.kind == "approach":
        contact = end if brightness.contact_s is None else brightness.contact_s
        share = _share_of_largest(protocol, obj, brightness, contact - start - since, pose)
    else:
        cycle = since * (brightness.frequency_hz or 0.0)
        if brightness.waveform == "sine":
            share = (1 - math.cos(2 * math.pi * cycle)) / 2
        else:  # 1e-9: a rounded time may lie just before the switch
            share = float((cycle + 1e-9) % 1 >= 0.5)
    return base + (brightness.to - base) * share


def _share_of_largest(
    protocol: ProtocolTables, obj: Object, approach: Brightness, remaining: float, pose: Pose
) -> float:
    """Return the area of an approaching shape on the display, divided by its largest area there.

    The shape is that of the object; in place of a pattern or an edge, a disk approaches.
    """
    projection, half = Projection.of(protocol.display), (approach.most_deg or 180.0) / 2
    area, largest = (
        _area_on_display(projection, obj, replace(pose, extent=extent))
        for extent in (_approach(approach, remaining), Extent(half, half))
    )
    # On the display, a ring may have been larger before.
    return min(area / largest, 1.0) if largest else 1.0


@lru_cache(256)  # the ground truth and the picture of a frame ask for the same areas
def _area_on_display(projection: Projection, obj: Object, pose: Pose) -> float:
    """Return the area in px that a shape covers, or, for a pattern or an edge, a disk."""
    from oppload_cli.stimulus.coverage import (  # noqa: PLC0415 - the catalogue needs no NumPy
        disk_coverage,
        shape_coverage,
    )

    if obj.kind in SIZED:
        return float(shape_coverage(projection, obj, pose)[1].sum())
    centre, radius = projection.to_px(*pose.centre_deg), projection.reach(pose.extent.forward)
    return float(disk_coverage(*centre, radius, *projection.shape)[1].sum())


def _path(motion: Motion, elapsed: float, backwards: bool) -> tuple[_Vector, _Vector]:
    """Return the displacement and the velocity along the points of a path."""
    if not motion.path_deg:
        return _STILL, _STILL
    (x, vx), (y, vy) = (
        _joined(values, motion.path_s, elapsed, backwards)
        for values in zip(*motion.path_deg, strict=True)
    )
    return (x, y), (vx, vy)


def _joined(
    values: Sequence[float], times: Sequence[float], elapsed: float, backwards: bool
) -> tuple[float, float]:
    """Return the value at a time, and its speed, if straight lines join values at given times."""
    if backwards:  # at a given time, the speed is that from the value before to this one
        reached = bisect.bisect_left(times, elapsed - ROUNDING_S)
    else:
        reached = bisect.bisect_right(times, elapsed + ROUNDING_S)
    if reached in {0, len(values)}:  # before the first value, or after the last one
        return values[max(reached - 1, 0)], 0.0
    speed = (values[reached] - values[reached - 1]) / (times[reached] - times[reached - 1])
    return values[reached - 1] + speed * (elapsed - times[reached - 1]), speed


def shaken(motion: Motion | Camera, elapsed: float, seed: str) -> tuple[_Vector, _Vector]:
    """Return the displacement [right, up] in degrees of a shake, and its velocity in deg/s.

    The shake is a sum of sine waves whose frequencies and phases follow from `seed`. It looks
    random, but is a function of time.
    """
    if not motion.shake_deg:
        return _STILL, _STILL
    # Every object has its own generator. A text gives the same numbers in every process.
    chance = random.Random(f"{seed}/shake")  # noqa: S311
    waves = 6
    amplitude = motion.shake_deg / math.sqrt(waves)
    shift, speed = [0.0, 0.0], [0.0, 0.0]
    for axis in (0, 1):
        for _ in range(waves):
            rate = 2 * math.pi * motion.shake_hz * chance.uniform(0.5, 1.5)
            phase = chance.uniform(0, 2 * math.pi)
            shift[axis] += amplitude * (math.sin(rate * elapsed + phase) - math.sin(phase))
            speed[axis] += amplitude * rate * math.cos(rate * elapsed + phase)
    return (shift[0], shift[1]), (speed[0], speed[1])


def _extent_of(protocol: ProtocolTables, obj: Object, elapsed: float) -> Extent:
    """Return the reach of a shape and its speeds, without regard to `reverse`.

    `elapsed` counts in seconds from the start of its motion.
    """
    growth, size = obj.growth, obj.size_deg or 0.0
    if growth is None:
        return Extent(size / 2, size / 2)
    contact = _approach_contact(protocol, obj)
    if contact is not None:
        return _approach(growth, contact - protocol.motion_of(obj)[0] - elapsed)
    if growth.kind == "edge-speed":
        return _constant_edge_speed(growth, size, elapsed, obj.reverse)
    if growth.kind == "path":
        size, speed = _joined(*_points_of(growth, size), elapsed, obj.reverse)
        return Extent(size / 2, size / 2, speed / 2, speed / 2)
    reached = bisect.bisect_right(growth.times_s, elapsed + ROUNDING_S)
    size = growth.sizes_deg[reached - 1] if reached else size
    return Extent(size / 2, size / 2)


def _points_of(growth: Growth, size: float) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return the sizes that a path of sizes joins, and their times; `size` is the first size."""
    return (size, *growth.sizes_deg), (0.0, *growth.times_s)


def _approach(growth: Growth | Brightness, remaining: float) -> Extent:
    """Return the reach of an object that approaches at constant speed.

    Its angular size is ``2 atan((l/v) / remaining)``, with l the half size of the object, v its
    speed and `remaining` the seconds until contact (Gabbiani et al. 1999, J Neurosci 19:1122). From
    contact on, the object fills the view.
    """
    ratio, most = (growth.l_over_v_ms or 0.0) / 1000, (growth.most_deg or 180.0) / 2
    half = math.degrees(math.atan2(ratio, remaining))  # from contact on at least 90
    speed = math.degrees(ratio / (remaining**2 + ratio**2))
    if half <= growth.least_deg / 2 or half >= most:
        half, speed = min(max(half, growth.least_deg / 2), most), 0.0
    return Extent(half, half, speed, speed)


def _constant_edge_speed(growth: Growth, size: float, elapsed: float, backwards: bool) -> Extent:
    """Return the reach of a shape whose edges move at constant speed; `size` is its first size."""
    speed = growth.speed_deg_s or 0.0
    forward = speed if growth.sides in {"both", "forward"} else 0.0
    backward = speed if growth.sides in {"both", "backward"} else 0.0
    moving = True
    if growth.end_deg is not None:
        duration = abs(growth.end_deg - size) / (forward + backward)
        # At the time of its last size a growth is over; played backwards, it begins there.
        late = -ROUNDING_S if backwards else ROUNDING_S
        moving, elapsed = elapsed + late < duration, min(elapsed, duration)
        if growth.end_deg < size:
            forward, backward = -forward, -backward
    reach = Extent(size / 2 + forward * elapsed, size / 2 + backward * elapsed, forward, backward)
    return reach.with_speeds_times(1.0 if moving else 0.0)
