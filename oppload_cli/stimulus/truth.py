"""Ground truth: the objects of each frame as numbers, and the file that holds them."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from oppload_cli.errors import StimulusError
from oppload_cli.files.reading import path_of, reading, text_of
from oppload_cli.stimulus.geometry import Pose, Projection
from oppload_cli.stimulus.kinematics import aperture_centre, pose_of
from oppload_cli.stimulus.objects import FIELDS, PICTURE, SIZED, Object
from oppload_cli.stimulus.patterns import cutout_of
from oppload_cli.stimulus.protocol import Protocol, check_frame, check_protocol
from oppload_cli.stimulus.staging import NEAREST_M, camera_of, contact_of, miss_of, sight_of
from oppload_cli.version import __version__

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from oppload_cli.stimulus.protocol_tables import Display


_SCHEMA = "oppload.stimulus/1"


@dataclass(frozen=True)
class ObjectTruth:
    """One object in one frame.

    Attributes
    ----------
    id, kind : str
        As in the protocol.
    visible : bool
        Whether it is drawn.
    angular_size_deg : float or None
        Diameter, side, or length along the axis; None for an edge or a pattern.
    edge_speed_deg_s : float
        Speed of the faster edge away from the anchor point (negative: towards it). For an object
        that does not grow, the speed of its movement.
    edge_speed_px_frame : float
        The same speed on the display, in pixels per frame.
    centre_x_px, centre_y_px : float
        Middle of the drawn shape. For a pattern its origin, or the middle of its aperture.
        x right, y down, pixel i covers [i, i + 1).
    time_to_contact_s : float or None
        A number only while the object approaches and does not pass.
    looming : bool
        Whether its complete outline grows, and it does not move sideways so far that it passes.
    """

    id: str
    kind: str
    visible: bool
    angular_size_deg: float | None
    edge_speed_deg_s: float
    edge_speed_px_frame: float
    centre_x_px: float
    centre_y_px: float
    time_to_contact_s: float | None
    looming: bool


@dataclass(frozen=True)
class PictureTruth(ObjectTruth):
    """One picture of a staged scene in one frame.

    Its angular size is the angle that its longer side would span straight ahead; its edge speed
    is half the growth of that angle, and 0 while it is not in front of the camera. It looms while
    it is drawn, its course hits the camera, and contact is at most ``camera.looming_within_s``
    away. While it is not drawn, its centre is the middle of the display.

    Attributes
    ----------
    box_px : tuple of float or None
        Left, top, width and height around its opaque part; the box may reach beyond the display.
        None while the picture is not drawn.
    offset_m : tuple of float
        Position relative to the camera, along the world's axes [right, up, ahead].
    miss_sizes : float or None
        Miss distance in its own sizes; at most 0.5 if the picture hits the camera. None if it
        never comes nearer.
    """

    box_px: tuple[float, float, float, float] | None
    offset_m: tuple[float, float, float]
    miss_sizes: float | None


@dataclass(frozen=True)
class FrameTruth:
    """One frame.

    Attributes
    ----------
    frame : int
        0-based.
    time_s : float
        Seconds from the first frame.
    looming : bool
        Whether any object looms.
    objects : tuple of ObjectTruth
        In the protocol's order.
    """

    frame: int
    time_s: float
    looming: bool
    objects: tuple[ObjectTruth, ...]


def frame_truth(protocol: Protocol, frame: int) -> FrameTruth:
    """Return the ground truth of a frame.

    Parameters
    ----------
    protocol : Protocol
        The stimulus.
    frame : int
        Number of the frame, from 0 to `frame_count` of the protocol minus 1.

    Raises
    ------
    StimulusError
        If there is no such frame.

    Examples
    --------
    >>> from oppload_cli import stimulus
    >>> truth = stimulus.frame_truth(stimulus.load("controls/looming-perspective"), 30)
    >>> truth.time_s, truth.looming, round(truth.objects[0].time_to_contact_s, 3)
    (0.5, True, 1.1)
    """
    check_frame(protocol, frame)
    time = protocol.time_of(frame)
    objects = tuple(
        _picture_truth(protocol, obj, time)
        if obj.kind == PICTURE
        else _object_truth(protocol, obj, pose_of(protocol, obj, time))
        for obj in protocol.objects
    )
    return FrameTruth(frame, time, any(obj.looming for obj in objects), objects)


def ground_truth(protocol: Protocol) -> dict[str, Any]:
    """Return the ground truth of a stimulus, as in its ``.stimulus.json``.

    Parameters
    ----------
    protocol : Protocol
        The stimulus.

    Returns
    -------
    dict
        Values for JSON; ``docs/stimuli.md`` describes the keys.

    Examples
    --------
    >>> from oppload_cli import stimulus
    >>> truth = stimulus.ground_truth(stimulus.load("controls/looming-perspective"))
    >>> len(truth["frames"]), truth["frames"][0]["objects"][0]["kind"]
    (102, 'disk')
    """
    return {**_head(protocol), "frames": list(_frames(protocol))}


def ground_truth_text(protocol: Protocol) -> Iterator[str]:
    """Yield the JSON text of a ground truth in parts, so that it need not fit into memory."""
    yield json.dumps(_head(protocol), indent=1, ensure_ascii=False)[:-2] + ',\n "frames": ['
    for index, frame in enumerate(_frames(protocol)):
        yield ("," if index else "") + "\n  " + json.dumps(frame, ensure_ascii=False)
    yield "\n ]\n}\n"


def _frames(protocol: Protocol) -> Iterator[dict[str, Any]]:
    for index in range(protocol.frame_count):
        truth = frame_truth(protocol, index)
        yield {**vars(truth), "objects": [asdict(obj) for obj in truth.objects]}


def _head(protocol: Protocol) -> dict[str, Any]:
    check_protocol(protocol)
    truths = (frame_truth(protocol, index) for index in range(protocol.frame_count))
    return {
        "schema": _SCHEMA,
        "name": protocol.name,
        "description": protocol.description,
        "source": protocol.source,
        "tool_version": __version__,
        "seed": protocol.seed,
        "protocol": protocol.as_table(),
        "display": display_facts(protocol.display),
        "looming": any(truth.looming for truth in truths),
        "contact_time_s": contact_time(protocol),
    }


def display_facts(display: Display) -> dict[str, Any]:
    """Return the facts of a display as a ground truth has them."""
    rate = display.frame_rate
    return {
        "width": display.width,
        "height": display.height,
        "frame_rate": f"{rate.numerator}/{rate.denominator}",
        "pixels_per_degree": display.scale,
        "projection": display.projection,
    }


def contact_time(protocol: Protocol) -> float | None:
    """Return the first time of contact in seconds of the clip, maybe after its end.

    None if no object approaches, or if all of them pass.
    """
    times = (contact_of(protocol, obj) for obj in protocol.objects)
    return min((time for time in times if time is not None), default=None)


def read_ground_truth(path: Path | str) -> dict[str, Any]:
    """Read a ``.stimulus.json`` file; return a dict like that of :func:`ground_truth`.

    Parameters
    ----------
    path : Path or str
        The file.

    Raises
    ------
    StimulusError
        If the file cannot be read or is not the ground truth of a stimulus.
    """
    path = path_of(path, "path")
    again = "generate the stimulus again"
    with reading(path, StimulusError, form="JSON", check=again, repair=again):
        data = json.loads(text_of(path))
    schema = data.get("schema") if isinstance(data, dict) else None
    if schema != _SCHEMA or not isinstance(data.get("frames"), list):
        raise StimulusError(
            f"{path}: its schema is {schema!r}, not '{_SCHEMA}'; {again} with this version"
        )
    return dict(data)


def _object_truth(protocol: Protocol, obj: Object, pose: Pose) -> ObjectTruth:
    projection = Projection.of(protocol.display)
    (x, y), _ = projection.middle_of(pose)
    if obj.kind in FIELDS and obj.size_deg is not None:
        x, y = projection.to_px(*aperture_centre(protocol, obj))
    degrees, pixels = _edge_speed(projection, pose)
    return ObjectTruth(
        id=obj.id,
        kind=obj.kind,
        visible=pose.visible,
        angular_size_deg=pose.extent.size if obj.kind in SIZED else None,
        edge_speed_deg_s=degrees,
        edge_speed_px_frame=pixels / float(protocol.display.frame_rate),
        centre_x_px=x,
        centre_y_px=y,
        time_to_contact_s=pose.contact_in_s,
        looming=pose.looming,
    )


def _picture_truth(protocol: Protocol, obj: Object, time: float) -> PictureTruth:
    sight, cutout = sight_of(protocol, obj, time), cutout_of(obj, protocol.seed)
    half, ahead, view = (obj.size_m or 0.0) / 2, sight.offset[2], sight.view
    x, y = view.projection.middle
    if sight.visible:
        x, y = view.to_px(view.from_camera(sight.offset))
    in_front = ahead > NEAREST_M
    speed = -half * sight.velocity[2] if in_front else 0.0
    rate = float(protocol.display.frame_rate)
    contact = sight.contact_in_s
    near = contact is not None and contact <= camera_of(protocol).looming_within_s
    return PictureTruth(
        id=obj.id,
        kind=obj.kind,
        visible=sight.visible,
        angular_size_deg=2 * math.degrees(math.atan2(half, max(ahead, 0.0))),
        edge_speed_deg_s=math.degrees(speed / (ahead**2 + half**2)),
        edge_speed_px_frame=view.projection.eye_px * speed / ahead**2 / rate if in_front else 0.0,
        centre_x_px=x,
        centre_y_px=y,
        time_to_contact_s=contact,
        looming=near and sight.visible,
        box_px=sight.box(half * cutout.width, half * cutout.height) if sight.visible else None,
        offset_m=sight.offset,
        miss_sizes=miss_of(protocol, obj),
    )


def _edge_speed(projection: Projection, pose: Pose) -> tuple[float, float]:
    """Return the speed of the faster end, or else of the anchor point, in deg/s and px/s."""
    extent = pose.extent
    ends = (extent.forward, extent.forward_speed), (extent.backward, extent.backward_speed)
    reach, speed = max(ends, key=lambda end: abs(end[1]))
    if speed:
        return speed, projection.reach_speed(reach, speed)
    (x, y), (vx, vy) = pose.centre_deg, pose.velocity_deg_s
    speed = math.hypot(vx, vy)
    if not speed:
        return 0.0, 0.0
    # Pixels per degree in this direction, from a short step each way.
    step = 1e-3
    x_step, y_step = vx / speed * step, vy / speed * step
    ahead = projection.to_px(x + x_step, y + y_step)
    behind = projection.to_px(x - x_step, y - y_step)
    return speed, speed * math.dist(ahead, behind) / (2 * step)
