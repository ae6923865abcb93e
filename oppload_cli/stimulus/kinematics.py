"""Where an object is, how large, and how fast it changes, at any time of the clip.

Closed forms of time, never steps: the same protocol has the same sizes at the same
times whatever its frame rate.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from oppload_cli.stimulus.geometry import Projection
from oppload_cli.stimulus.growth import Extent, extent_of
from oppload_cli.stimulus.movement import luminance_at, movement
from oppload_cli.stimulus.objects import FIELDS, LOOMING

if TYPE_CHECKING:
    from oppload_cli.stimulus.objects import Object
    from oppload_cli.stimulus.protocol import Protocol
    from oppload_cli.stimulus.tables import Timing


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
        luminance=luminance_at(
            thing.brightness, thing.base_luminance, min(time, end) - start, end - start
        ),
        zoom=math.exp(thing.motion.zoom_per_s * phase) if thing.motion else 1.0,
        travel_deg=travel,
        contact_in_s=_contact_in(thing, time, start, end),
        looming=thing.kind in LOOMING and speed > 0,
    )


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
