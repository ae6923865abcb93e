"""Staged scenes: the camera and its pictures at any time, in metres and in pixels.

The camera is an exact pinhole. World positions are ``(right, up, ahead)`` in metres from the
camera's place at the start; the ground lies ``height_m`` below the camera. A picture is flat,
upright, and at right angles to the world's axis ahead.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

from oppload_cli.errors import StimulusError, faults_at
from oppload_cli.stimulus.courses import HIT_SIZES, Line, Vector
from oppload_cli.stimulus.geometry import Projection
from oppload_cli.stimulus.kinematics import (
    ROUNDING_S,
    contact_of_shape,
    is_drawn,
    shaken,
    shape_may_show,
)
from oppload_cli.stimulus.objects import PICTURE, Object
from oppload_cli.stimulus.protocol_tables import Camera, ProtocolTables

NEAREST_M = 0.01  # a picture that is nearer to the camera is not drawn
_DEFAULT_CAMERA = Camera()


class CameraView(NamedTuple):
    """The camera at one time."""

    place: Vector  # in the world, in metres
    axes: tuple[Vector, Vector, Vector]  # the camera's right, up and ahead, in the world's axes
    projection: Projection  # of the display

    def from_camera(self, offset: Vector) -> Vector:
        """Convert an offset from the camera from the world's axes to the camera's axes."""
        right, up, ahead = (
            axis[0] * offset[0] + axis[1] * offset[1] + axis[2] * offset[2] for axis in self.axes
        )
        return right, up, ahead

    def to_px(self, point: Vector) -> tuple[float, float]:
        """Return the pixel position (x, y), y down, of a point in the camera's axes."""
        right, up, ahead = point
        (x, y), eye_px = self.projection.middle, self.projection.eye_px
        return x + eye_px * right / ahead, y - eye_px * up / ahead


@dataclass(frozen=True)
class Sight:
    """A picture at one time, relative to the camera, in the world's axes."""

    visible: bool  # whether it has appeared, has not vanished, and is in front of the camera
    offset: Vector  # of its middle from the camera, in metres
    velocity: Vector  # in m/s
    contact_in_s: float | None  # time to contact, while its course hits the camera
    view: CameraView

    def box(
        self, half_width: float, half_height: float
    ) -> tuple[float, float, float, float] | None:
        """Return left, top, width and height in pixels of the box around the picture.

        The arguments are half the size of the picture in metres. The box may reach beyond the
        display; it is None if a corner of the picture is beside or behind the camera.
        """
        right, up, ahead = self.offset
        corners = [
            self.view.from_camera((right + x, up + y, ahead))
            for x in (-half_width, half_width)
            for y in (-half_height, half_height)
        ]
        if min(corner[2] for corner in corners) <= 0:
            return None
        xs, ys = zip(*(self.view.to_px(corner) for corner in corners), strict=True)
        return min(xs), min(ys), max(xs) - min(xs), max(ys) - min(ys)


def camera_of(protocol: ProtocolTables) -> Camera:
    """Return the camera of a protocol, or the default camera."""
    return protocol.camera or _DEFAULT_CAMERA


def view_of(protocol: ProtocolTables, time: float) -> CameraView:
    """Return the view of a protocol's camera at a time, in seconds of the clip."""
    camera, elapsed = camera_of(protocol), protocol.timing.elapsed(time)
    (shake_x, shake_y), _ = shaken(camera, elapsed, f"{protocol.seed}/camera")
    turn = math.radians(camera.start_deg + camera.pan_deg_s * elapsed + shake_x)
    tilt = math.radians(shake_y)
    cosine, sine = math.cos(turn), math.sin(turn)
    right = (cosine, 0.0, -sine)
    up = (-math.sin(tilt) * sine, math.cos(tilt), -math.sin(tilt) * cosine)
    ahead = (math.cos(tilt) * sine, math.sin(tilt), math.cos(tilt) * cosine)
    place = (0.0, 0.0, camera.forward_m_s * elapsed)
    return CameraView(place, (right, up, ahead), Projection.of(protocol.display))


@lru_cache(maxsize=256)
def _line(protocol: ProtocolTables, obj: Object) -> Line:
    start, end = protocol.motion_of(obj)
    if obj.course is None or obj.size_m is None:
        raise StimulusError(f"object '{obj.id}' has no course")
    return Line.of(obj.course, obj.size_m, end - start)


def sight_of(protocol: ProtocolTables, obj: Object, time: float) -> Sight:
    """Return a picture of the protocol at a time, in seconds of the clip."""
    start, end = protocol.motion_of(obj)
    line, view = _line(protocol, obj), view_of(protocol, time)
    elapsed = min(max(time - start, 0.0), end - start)
    offset = line.position(elapsed)
    moving = start <= time < end
    velocity = line.velocity(elapsed) if moving else (0.0, 0.0, 0.0)
    contact = contact_of(protocol, obj)
    contact_in_s = None
    if contact is not None and moving and time + ROUNDING_S < contact:
        contact_in_s = contact - time
    visible = is_drawn(protocol, obj, time) and view.from_camera(offset)[2] > NEAREST_M
    return Sight(visible, offset, velocity, contact_in_s, view)


def contact_of(protocol: ProtocolTables, obj: Object) -> float | None:
    """Return when an object reaches the observer, in seconds of the clip; None if it never does."""
    if obj.kind != PICTURE:
        return contact_of_shape(protocol, obj)
    nearest, distance = _line(protocol, obj).closest()
    if nearest is None or distance > HIT_SIZES * (obj.size_m or 0.0) + 1e-9:
        return None
    return protocol.motion_of(obj)[0] + nearest


def miss_of(protocol: ProtocolTables, obj: Object) -> float | None:
    """Return the miss distance of a picture, in its own sizes; None if it never comes nearer."""
    line = _line(protocol, obj)
    distance = line.closest()[1]
    if not line.speed or distance >= math.hypot(*line.start) - 1e-9:
        return None
    return distance / (obj.size_m or 1.0)


def may_show(protocol: ProtocolTables, obj: Object, time: float) -> bool:
    """Tell whether an object may touch the display; of a picture counts the square around it."""
    if obj.kind != PICTURE:
        return shape_may_show(protocol, obj, time)
    sight, half = sight_of(protocol, obj, time), (obj.size_m or 0.0) / 2
    if not sight.visible:
        return False
    box = sight.box(half, half)
    if box is None:
        return True
    left, top, width, height = box
    display = protocol.display
    return left < display.width and top < display.height and left + width > 0 < top + height


def check_stage(protocol: ProtocolTables) -> None:
    """Check that the camera, the background and the pictures of a protocol go together.

    Raises
    ------
    StimulusError
        If they do not; the message names the key.
    """
    pictures = [obj for obj in protocol.objects if obj.kind == PICTURE]
    scene, camera = protocol.scene, protocol.camera
    if camera is not None and not pictures and scene.background is None:
        raise StimulusError("camera goes with scene.background or an object of kind 'picture'")
    if scene.background is None and not pictures:
        return
    if protocol.display.projection != "perspective":
        raise StimulusError(
            "display: projection must be 'perspective' with scene.background and with objects of "
            "kind 'picture'"
        )
    if camera is not None and camera.moves and scene.has_file:
        raise StimulusError(
            "camera: forward_m_s, pan_deg_s, start_deg and shake_deg need drawn surroundings; "
            f"scene.background = '{scene.background}', an image or a video, does not move with "
            "the camera; remove them"
        )
    for obj in pictures:
        where = f"object '{obj.id}': course"
        with faults_at(where):
            ahead = _line(protocol, obj).start[2]
        if ahead <= 0 and obj.course is not None and obj.course.kind != "overtaking":
            raise StimulusError(
                f"{where}: it starts {-ahead:g} m behind the camera; change start_m, or use kind "
                "'overtaking'"
            )
        contact, (_, end) = contact_of(protocol, obj), protocol.motion_of(obj)
        total, stays = protocol.timing.total_s, obj.vanishes == "never"
        if stays and contact is not None and end + ROUNDING_S < contact <= total:
            raise StimulusError(
                f"{where}: its contact, at {contact:g} s, lies inside the pause after its motion "
                f"({end:g} to {total:g} s), in which it rests; change contact_s or timing"
            )
