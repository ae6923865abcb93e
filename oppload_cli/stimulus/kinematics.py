"""The pose of an object at any time of the clip: its place, size, speeds and luminance.

Closed forms of time, never steps: the same protocol has the same sizes at the same
times at every frame rate.
"""

from __future__ import annotations

import bisect
import math
import random
from dataclasses import replace
from typing import TYPE_CHECKING

from oppload_cli.stimulus.courses import HIT_SIZES
from oppload_cli.stimulus.geometry import Extent, Pose, Projection
from oppload_cli.stimulus.objects import FIELDS, LOOMING
from oppload_cli.stimulus.tables import exact_sum

if TYPE_CHECKING:
    from oppload_cli.stimulus.objects import Brightness, Growth, Motion, Object
    from oppload_cli.stimulus.tables import Camera, ProtocolTables, Timing


_Vector = tuple[float, float]
_STILL: _Vector = (0.0, 0.0)
# Seconds since a start are differences of floats: a frame on a switch is on the side after it.
ROUNDING_S = 1e-9


def motion_times(timing: Timing, obj: Object) -> tuple[float, float]:
    """Return when an object's motion starts and ends, in seconds of the clip."""
    begun = timing.before_s, obj.onset_s
    if obj.duration_s is None:
        return float(exact_sum(*begun)), timing.end_s
    return float(exact_sum(*begun)), float(exact_sum(*begun, obj.duration_s))


def pose_of(protocol: ProtocolTables, obj: Object, time: float) -> Pose:
    """Return the pose of an object of the protocol at a time, in seconds of the clip."""
    start, end = motion_times(protocol.timing, obj)
    moving = start <= time < end
    elapsed = min(max(time - start, 0.0), end - start)
    # backwards, the growth and the movement run from their end to their start
    phase = end - start - elapsed if obj.reverse else elapsed
    sign = (-1.0 if obj.reverse else 1.0) if moving else 0.0
    extent = _extent_of(obj, phase, start, end).times(sign)
    travel, velocity, turn = _movement(obj.motion, phase, obj.axis_deg, f"{protocol.seed}/{obj.id}")
    x, y = obj.centre_deg[0] + travel[0], obj.centre_deg[1] + travel[1]
    centre, moved = _in_scene(protocol, (x, y), (sign * velocity[0], sign * velocity[1]), time)
    speed = extent.forward_speed + extent.backward_speed
    return Pose(
        visible=shown(obj, time, start, end),
        centre_deg=centre,
        velocity_deg_s=moved,
        orientation_deg=obj.axis_deg + turn + _scene_turn(protocol, time),
        extent=extent,
        luminance=_luminance_at(
            obj.brightness, obj.base_luminance, min(time, end) - start, end - start
        ),
        zoom=math.exp(obj.motion.zoom_per_s * phase) if obj.motion else 1.0,
        travel_deg=travel,
        contact_in_s=_contact_in(obj, time, start, end),
        looming=obj.kind in LOOMING and speed > 0 and not passes(obj, start, end),
    )


def aperture_centre(protocol: ProtocolTables, obj: Object) -> tuple[float, float]:
    """Return the middle [right, up] of a pattern's aperture in degrees; no motion moves it."""
    scene = protocol.scene
    x, y = _turned(obj.centre_deg, math.radians(scene.rotation_deg))
    return x + scene.centre_deg[0], y + scene.centre_deg[1]


def reaches_field(protocol: ProtocolTables, obj: Object, pose: Pose) -> bool:
    """Tell whether an object may touch the display.

    It is False only where the object is not drawn, or where the bounding circle of a shape
    is outside the display; a pattern always fills the display.
    """
    if not pose.visible:
        return False
    if obj.kind in FIELDS or obj.kind == "edge":
        return True
    display = protocol.display
    projection = Projection.of(display)
    reach = max(pose.extent.forward, pose.extent.backward)
    across = reach if obj.kind in {"square", "cross"} else (obj.width_deg or 0.0) / 2
    if not pose.extent.forward + pose.extent.backward > 0:
        return False
    radius = math.hypot(projection.reach(reach), projection.reach(across))
    x, y = projection.to_px(*pose.centre_deg)
    dx = max(-x, 0.0, x - display.width)
    dy = max(-y, 0.0, y - display.height)
    return math.hypot(dx, dy) < radius


def shown(obj: Object, time: float, start: float, end: float) -> bool:
    """Tell whether an object is drawn at a time; its motion lasts from `start` to `end`."""
    appeared = obj.appears == "start" or time >= start
    return appeared and (obj.vanishes == "never" or time < end)


def _contact_in(obj: Object, time: float, start: float, end: float) -> float | None:
    growth = obj.growth
    if growth is None or growth.kind != "approach" or obj.reverse or passes(obj, start, end):
        return None
    contact = end if growth.contact_s is None else growth.contact_s
    return contact - time if start <= time < min(contact, end) else None


def passes(obj: Object, start: float, end: float) -> bool:
    """Tell whether a shape that grows moves aside so far that it passes the observer.

    The distance at which an object on a straight course passes, in its own sizes, is the movement
    of its middle over the growth of its size, both as angles (Regan and Kaushal 1994, Vision Res
    34:163): at more than half, all of its edges move to the same side. The movement is that from
    the start to the end of its growth. A shake and the movement of the scene, which are those of a
    camera, do not count.

    Parameters
    ----------
    obj : Object
        The shape.
    start, end : float
        When its motion starts and ends, in seconds of the clip.
    """
    if obj.growth is None or obj.motion is None:
        return False
    first, last = _growing(obj.growth, obj.size_deg or 0.0, start, end)
    motion = replace(obj.motion, shake_deg=0.0)
    before, after = (
        (_movement(motion, time, obj.axis_deg, "")[0], _extent_of(obj, time, start, end).size)
        for time in (first, last)
    )
    grown = (before[1] - after[1]) if obj.reverse else (after[1] - before[1])
    return 0 < HIT_SIZES * grown < math.dist(before[0], after[0])


def _growing(growth: Growth, size: float, start: float, end: float) -> tuple[float, float]:
    """Return the first and the last second of a growth, from the start of the motion."""
    first, last = 0.0, end - start
    if growth.kind == "approach":
        ratio = (growth.l_over_v_ms or 0.0) / 1000
        ends = (end if growth.contact_s is None else growth.contact_s) - start
        if growth.least_deg > 0:
            first = max(first, ends - ratio / math.tan(math.radians(growth.least_deg / 2)))
        last = min(last, ends - ratio / math.tan(math.radians(growth.most_deg / 2)))
    elif growth.kind == "edge-speed" and growth.end_deg is not None:
        edges = (growth.speed_deg_s or 0.0) * (2 if growth.sides == "both" else 1)
        last = min(last, abs(growth.end_deg - size) / edges)
    return min(first, last), last


def _in_scene(
    protocol: ProtocolTables, point: tuple[float, float], velocity: tuple[float, float], time: float
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Turn and shift a point and its velocity as the scene does."""
    scene, timing = protocol.scene, protocol.timing
    angle = math.radians(_scene_turn(protocol, time))
    x, y = _turned(point, angle)
    vx, vy = _turned(velocity, angle)
    elapsed = min(max(time - timing.before_s, 0.0), timing.motion_s)
    (dx, dy), (dvx, dvy), _ = _movement(
        scene.motion, elapsed, scene.rotation_deg, f"{protocol.seed}/scene"
    )
    if scene.motion is not None and timing.before_s <= time < timing.end_s:
        spin = math.radians(scene.motion.rotation_deg_s)
        vx, vy = vx + dvx - spin * y, vy + dvy + spin * x
    return (x + scene.centre_deg[0] + dx, y + scene.centre_deg[1] + dy), (vx, vy)


def _scene_turn(protocol: ProtocolTables, time: float) -> float:
    scene, timing = protocol.scene, protocol.timing
    if scene.motion is None:
        return scene.rotation_deg
    elapsed = min(max(time - timing.before_s, 0.0), timing.motion_s)
    return scene.rotation_deg + scene.motion.rotation_deg_s * elapsed


def _turned(point: tuple[float, float], angle: float) -> tuple[float, float]:
    if angle == 0:
        return point
    x, y = point
    return x * math.cos(angle) - y * math.sin(angle), x * math.sin(angle) + y * math.cos(angle)


def _movement(
    motion: Motion | None, elapsed: float, axis_deg: float, seed: str
) -> tuple[_Vector, _Vector, float]:
    """Displacement [right, up] in degrees, velocity in deg/s, and turn in degrees.

    `axis_deg` is the direction where the motion has none; the text `seed` sets the shake.
    """
    if motion is None:
        return _STILL, _STILL, 0.0
    heading = math.radians(axis_deg if motion.direction_deg is None else motion.direction_deg)
    x_speed, y_speed = (
        motion.speed_deg_s * math.cos(heading),
        motion.speed_deg_s * math.sin(heading),
    )
    x, y = x_speed * elapsed, y_speed * elapsed
    for (dx, dy), (vx, vy) in (_path(motion, elapsed), shaken(motion, elapsed, seed)):
        x, y, x_speed, y_speed = x + dx, y + dy, x_speed + vx, y_speed + vy
    return (x, y), (x_speed, y_speed), motion.rotation_deg_s * elapsed


def _luminance_at(
    brightness: Brightness | None, base: float, elapsed: float, duration: float
) -> float:
    """Luminance some seconds after the start of the motion (negative before it)."""
    if brightness is None or elapsed + ROUNDING_S < brightness.start_s:
        return base
    since = max(elapsed - brightness.start_s, 0.0)
    if brightness.kind == "step":
        share = 1.0
    elif brightness.kind == "ramp":
        length = brightness.duration_s or max(duration - brightness.start_s, 1e-9)
        share = min(since / length, 1.0)
    else:
        cycle = since * (brightness.frequency_hz or 0.0)
        sine = brightness.waveform == "sine"
        # a cycle starts at the base; 1e-9 keeps a frame on the switch on one side of it
        share = (
            (1 - math.cos(2 * math.pi * cycle)) / 2 if sine else float((cycle + 1e-9) % 1 >= 0.5)
        )
    return base + (brightness.to - base) * share


def _path(motion: Motion, elapsed: float) -> tuple[_Vector, _Vector]:
    points, times = motion.path_deg, motion.path_s
    if not points:
        return _STILL, _STILL
    for index in range(1, len(points)):
        if times[index - 1] <= elapsed + ROUNDING_S < times[index]:
            (x0, y0), (x1, y1) = points[index - 1], points[index]
            length = times[index] - times[index - 1]
            vx, vy = (x1 - x0) / length, (y1 - y0) / length
            since = elapsed - times[index - 1]
            return (x0 + vx * since, y0 + vy * since), (vx, vy)
    return points[0] if elapsed + ROUNDING_S < times[0] else points[-1], _STILL


def shaken(motion: Motion | Camera, elapsed: float, seed: str) -> tuple[_Vector, _Vector]:
    """Return the displacement [right, up] in degrees of a shake, and its velocity in deg/s.

    It is a sum of seeded sinusoids: random to the eye, but a function of time.
    """
    if not motion.shake_deg:
        return _STILL, _STILL
    # a generator of its own for each object; text seeds are the same in every process
    chance = random.Random(f"{seed}/shake")  # noqa: S311
    waves = 6
    amplitude = motion.shake_deg / math.sqrt(waves)
    place, speed = [0.0, 0.0], [0.0, 0.0]
    for axis in (0, 1):
        for _ in range(waves):
            rate = 2 * math.pi * motion.shake_hz * chance.uniform(0.5, 1.5)
            phase = chance.uniform(0, 2 * math.pi)
            place[axis] += amplitude * (math.sin(rate * elapsed + phase) - math.sin(phase))
            speed[axis] += amplitude * rate * math.cos(rate * elapsed + phase)
    return (place[0], place[1]), (speed[0], speed[1])


def _extent_of(obj: Object, elapsed: float, start: float, end: float) -> Extent:
    """Reach of a shape, with its speeds when time runs forwards.

    `elapsed` counts from the start of its motion; `start` and `end` are seconds of the clip.
    """
    growth, size = obj.growth, obj.size_deg or 0.0
    if growth is None:
        return Extent(size / 2, size / 2)
    if growth.kind == "approach":
        contact = end if growth.contact_s is None else growth.contact_s
        return _approach(growth, contact - start - elapsed)
    if growth.kind == "steps":
        index = bisect.bisect_right(growth.times_s, elapsed + ROUNDING_S)
        size = growth.sizes_deg[index - 1] if index else size
        return Extent(size / 2, size / 2)
    return _constant_edge_speed(growth, size, elapsed)


def _approach(growth: Growth, remaining: float) -> Extent:
    """Reach of an object that approaches at constant speed, some seconds before contact.

    Its angular size is ``2 atan((l/v) / (contact - t))``, with l the half size of the
    object and v its speed (Gabbiani et al. 1999). From contact on it fills the view.
    """
    ratio = (growth.l_over_v_ms or 0.0) / 1000
    half = math.degrees(math.atan2(ratio, remaining)) if remaining > 0 else 90.0
    speed = math.degrees(ratio / (remaining**2 + ratio**2)) if remaining > 0 else 0.0
    if half <= growth.least_deg / 2 or half >= growth.most_deg / 2:
        half, speed = min(max(half, growth.least_deg / 2), growth.most_deg / 2), 0.0
    return Extent(half, half, speed, speed)


def _constant_edge_speed(growth: Growth, size: float, elapsed: float) -> Extent:
    """Reach of a shape of this size at the start, its edges moving at constant speed."""
    speed = growth.speed_deg_s or 0.0
    forward = speed if growth.sides in {"both", "forward"} else 0.0
    backward = speed if growth.sides in {"both", "backward"} else 0.0
    moving = True
    if growth.end_deg is not None:
        lasts = abs(growth.end_deg - size) / (forward + backward)
        moving, elapsed = elapsed + ROUNDING_S < lasts, min(elapsed, lasts)
        if growth.end_deg < size:
            forward, backward = -forward, -backward
    reach = Extent(size / 2 + forward * elapsed, size / 2 + backward * elapsed, forward, backward)
    return reach.times(1.0 if moving else 0.0)
