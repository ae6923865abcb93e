"""Where an object is, how large, and how fast it changes, at any time of the clip.

Closed forms of time, never steps: the same protocol has the same sizes at the same
times whatever its frame rate.
"""

from __future__ import annotations

import math
import random
from dataclasses import dataclass
from typing import TYPE_CHECKING

from oppload_cli.stimulus.geometry import Projection
from oppload_cli.stimulus.growth import Extent, extent_of
from oppload_cli.stimulus.objects import FIELDS, LOOMING

if TYPE_CHECKING:
    from oppload_cli.stimulus.objects import Brightness, Object
    from oppload_cli.stimulus.protocol import Protocol
    from oppload_cli.stimulus.tables import Motion, Timing


@dataclass(frozen=True)
class Pose:
    """An object at one time.

    Attributes
    ----------
    visible : bool
        Whether it is drawn.
    centre_deg, velocity_deg_s : tuple of float
        Anchor point [right, up] and its velocity.
    orientation_deg : float
        Direction of its axis.
    extent : Extent
        Reach to both sides of the anchor along the axis, and its speeds.
    luminance : float
        0 to 1.
    zoom : float
        Scale of a pattern.
    travel_deg : tuple of float
        Its own movement since the start, in the scene's frame before any turn.
    contact_in_s : float or None
        Time to contact while it approaches.
    looming : bool
        Whether its whole outline grows.
    """

    visible: bool
    centre_deg: tuple[float, float]
    velocity_deg_s: tuple[float, float]
    orientation_deg: float
    extent: Extent
    luminance: float
    zoom: float
    travel_deg: tuple[float, float]
    contact_in_s: float | None
    looming: bool

    @property
    def look(self) -> tuple[object, ...]:
        """All that the picture depends on."""
        reach = (self.extent.forward, self.extent.backward)
        place = (self.centre_deg, self.orientation_deg, self.zoom, self.travel_deg)
        return (self.visible, self.luminance, *reach, *place)


def motion_times(timing: Timing, thing: Object) -> tuple[float, float]:
    """Return when an object's motion starts and ends.

    Parameters
    ----------
    timing : Timing
        The clip's.
    thing : Object
        The object.

    Returns
    -------
    tuple of float
        Seconds of the clip.
    """
    start = timing.before_s + thing.onset_s
    end = timing.end_s if thing.duration_s is None else start + thing.duration_s
    return start, end


def pose_of(protocol: Protocol, thing: Object, time: float) -> Pose:
    """Return an object's pose at a time.

    Parameters
    ----------
    protocol : Protocol
        The stimulus.
    thing : Object
        One of its objects.
    time : float
        Seconds of the clip.

    Returns
    -------
    Pose
    """
    start, end = motion_times(protocol.timing, thing)
    moving = start <= time < end
    elapsed = min(max(time - start, 0.0), end - start)
    # backwards, the growth and the movement run from their end to their start
    phase = end - start - elapsed if thing.reverse else elapsed
    sign = (-1.0 if thing.reverse else 1.0) if moving else 0.0
    extent = extent_of(thing, phase, start, end).times(sign)
    travel, velocity, turn = movement(
        thing.motion, phase, thing.axis_deg, f"{protocol.seed}/{thing.id}"
    )
    x, y = thing.centre_deg[0] + travel[0], thing.centre_deg[1] + travel[1]
    centre, moved = _in_scene(protocol, (x, y), (sign * velocity[0], sign * velocity[1]), time)
    speed = extent.forward_speed + extent.backward_speed
    return Pose(
        visible=_visible(thing, time, start, end),
        centre_deg=centre,
        velocity_deg_s=moved,
        orientation_deg=thing.axis_deg + turn + _scene_turn(protocol, time),
        extent=extent,
        luminance=luminance_at(thing.brightness, thing.base_luminance, elapsed, end - start),
        zoom=math.exp(thing.motion.zoom_per_s * phase) if thing.motion else 1.0,
        travel_deg=travel,
        contact_in_s=_contact_in(thing, time, start, end),
        looming=thing.kind in LOOMING and speed > 0,
    )


def movement(
    motion: Motion | None, elapsed: float, axis_deg: float, seed: str
) -> tuple[tuple[float, float], tuple[float, float], float]:
    """Return what a motion has done after some time.

    Parameters
    ----------
    motion : Motion or None
        The motion; None does nothing.
    elapsed : float
        Seconds since its start.
    axis_deg : float
        The direction where the motion names none.
    seed : str
        Of the shake.

    Returns
    -------
    tuple of float
        Displacement [right, up] in degrees.
    tuple of float
        Velocity in deg/s.
    float
        Turn in degrees, counter-clockwise.
    """
    if motion is None:
        return (0.0, 0.0), (0.0, 0.0), 0.0
    heading = math.radians(axis_deg if motion.direction_deg is None else motion.direction_deg)
    x_speed, y_speed = (
        motion.speed_deg_s * math.cos(heading),
        motion.speed_deg_s * math.sin(heading),
    )
    x, y = x_speed * elapsed, y_speed * elapsed
    for (dx, dy), (vx, vy) in (_path(motion, elapsed), _shake(motion, elapsed, seed)):
        x, y, x_speed, y_speed = x + dx, y + dy, x_speed + vx, y_speed + vy
    return (x, y), (x_speed, y_speed), motion.rotation_deg_s * elapsed


def luminance_at(
    brightness: Brightness | None, base: float, elapsed: float, duration: float
) -> float:
    """Return an object's luminance.

    Parameters
    ----------
    brightness : Brightness or None
        How it changes.
    base : float
        The object's luminance, 0 to 1.
    elapsed, duration : float
        Seconds since its motion's start, and how long its motion lasts.

    Returns
    -------
    float
        0 to 1.
    """
    if brightness is None or elapsed < brightness.start_s:
        return base
    since = elapsed - brightness.start_s
    if brightness.kind == "step":
        share = 1.0
    elif brightness.kind == "ramp":
        length = brightness.duration_s or max(duration - brightness.start_s, 1e-9)
        share = min(since / length, 1.0)
    else:
        cycle = since * (brightness.frequency_hz or 0.0)
        sine = brightness.waveform == "sine"
        # a cycle starts at the base; 1e-9 keeps a frame on the switch on one side of it
        share = (1 - math.cos(2 * math.pi * cycle)) / 2 if sine else float((cycle + 1e-9) % 1 < 0.5)
    return base + (brightness.to - base) * share


def reaches_field(protocol: Protocol, thing: Object, pose: Pose) -> bool:
    """Tell whether a figure may touch the display.

    Parameters
    ----------
    protocol : Protocol
        The stimulus.
    thing : Object
        A figure; a pattern always fills the display.
    pose : Pose
        The figure's pose.

    Returns
    -------
    bool
        False only where its bounding circle is outside the display or it is not drawn.
    """
    if not pose.visible:
        return False
    if thing.kind in FIELDS or thing.kind == "edge":
        return True
    display = protocol.display
    projection = Projection.of(display)
    reach = max(pose.extent.forward, pose.extent.backward)
    across = reach if thing.kind in {"square", "cross"} else (thing.width_deg or 0.0) / 2
    if not pose.extent.forward + pose.extent.backward > 0:
        return False
    radius = math.hypot(projection.reach(reach), projection.reach(across))
    x, y = projection.to_px(*pose.centre_deg)
    dx = max(-x, 0.0, x - display.width)
    dy = max(-y, 0.0, y - display.height)
    return math.hypot(dx, dy) < radius


def _visible(thing: Object, time: float, start: float, end: float) -> bool:
    shown = thing.appears == "start" or time >= start
    return shown and (thing.vanishes == "never" or time < end)


def _contact_in(thing: Object, time: float, start: float, end: float) -> float | None:
    growth = thing.growth
    if growth is None or growth.kind != "approach" or thing.reverse:
        return None
    contact = end if growth.contact_s is None else growth.contact_s
    return contact - time if start <= time < min(contact, end) else None


def _in_scene(
    protocol: Protocol, point: tuple[float, float], velocity: tuple[float, float], time: float
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Turn and shift a point and its velocity as the scene does."""
    scene, timing = protocol.scene, protocol.timing
    angle = math.radians(_scene_turn(protocol, time))
    x, y = _turned(point, angle)
    vx, vy = _turned(velocity, angle)
    elapsed = min(max(time - timing.before_s, 0.0), timing.motion_s)
    (dx, dy), (dvx, dvy), _ = movement(
        scene.motion, elapsed, scene.rotation_deg, f"{protocol.seed}/scene"
    )
    if scene.motion is not None and timing.before_s <= time < timing.end_s:
        spin = math.radians(scene.motion.rotation_deg_s)
        vx, vy = vx + dvx - spin * y, vy + dvy + spin * x
    return (x + scene.centre_deg[0] + dx, y + scene.centre_deg[1] + dy), (vx, vy)


def _scene_turn(protocol: Protocol, time: float) -> float:
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


def _path(motion: Motion, elapsed: float) -> tuple[tuple[float, float], tuple[float, float]]:
    points, times = motion.path_deg, motion.path_s
    if not points:
        return (0.0, 0.0), (0.0, 0.0)
    for index in range(1, len(points)):
        if times[index - 1] <= elapsed < times[index]:
            (x0, y0), (x1, y1) = points[index - 1], points[index]
            length = times[index] - times[index - 1]
            vx, vy = (x1 - x0) / length, (y1 - y0) / length
            since = elapsed - times[index - 1]
            return (x0 + vx * since, y0 + vy * since), (vx, vy)
    return points[0] if elapsed < times[0] else points[-1], (0.0, 0.0)


def _shake(
    motion: Motion, elapsed: float, seed: str
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Sum of seeded sinusoids: random to the eye, but a function of time."""
    if not motion.shake_deg:
        return (0.0, 0.0), (0.0, 0.0)
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
