"""Ground truth: the objects of each frame as numbers, and the file that holds them."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from oppload_cli.errors import StimulusError
from oppload_cli.files.reading import reading, text_of
from oppload_cli.stimulus.geometry import Projection
from oppload_cli.stimulus.kinematics import aperture_centre, motion_times, passes, pose_of
from oppload_cli.stimulus.objects import FIELDS, LOOMING, PICTURE, SIZED
from oppload_cli.stimulus.pictures import cutout_of
from oppload_cli.stimulus.staging import NEAREST_M, camera_of, contact_of, miss_of, sight_of
from oppload_cli.version import __version__

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from oppload_cli.stimulus.geometry import Pose
    from oppload_cli.stimulus.objects import Object
    from oppload_cli.stimulus.protocol import Protocol


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
        Speed of the edges away from the anchor (negative: towards it); of an object that
        does not grow, the speed of its movement.
    edge_speed_px_frame : float
        The same on the display, in pixels per frame.
    centre_x_px, centre_y_px : float
        Middle of the shape as drawn; of a pattern its origin, or the middle of its aperture.
        x right, y down, pixel i covers [i, i + 1).
    time_to_contact_s : float or None
        Only while it approaches and does not pass.
    looming : bool
        Whether its complete outline grows, and it does not move aside so far that it passes.
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

    Its size is the angle that its longer side would span straight ahead; its edge speed is half
    of that angle's growth. It looms while it is seen on a course to hit the camera, from
    ``camera.looming_within_s`` before contact on. While it is not drawn its centre is the middle
    of the display.

    Attributes
    ----------
    box_px : tuple of float or None
        Left, top, width and height around its opaque part; it may reach beyond the display. None
        while it is not drawn.
    offset_m : tuple of float
        Position from the camera, along the world's axes [right, up, ahead].
    miss_sizes : float or None
        Least distance of its course from the camera in its own sizes: at most 0.5 for one that
        hits. None for one that comes no nearer.
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
    """Return the ground truth of a frame (0-based)."""
    time = protocol.time_of(frame)
    objects = tuple(
        _picture_truth(protocol, obj, time)
        if obj.kind == PICTURE
        else _object_truth(protocol, obj, pose_of(protocol, obj, time))
        for obj in protocol.objects
    )
    return FrameTruth(frame, time, any(obj.looming for obj in objects), objects)


def ground_truth(protocol: Protocol) -> dict[str, Any]:
    """Return the ground truth of a stimulus as ``docs/stimuli.md`` describes it."""
    return {**_head(protocol), "frames": list(_frames(protocol))}


def ground_truth_text(protocol: Protocol) -> Iterator[str]:
    """Return the ground truth as the text of its file, a line for each frame.

    Yields
    ------
    str
        Part of the JSON, so that the truth of a long clip need not fit into memory.
    """
    yield json.dumps(_head(protocol), indent=1, ensure_ascii=False)[:-2] + ',\n "frames": ['
    for index, frame in enumerate(_frames(protocol)):
        yield ("," if index else "") + "\n  " + json.dumps(frame, ensure_ascii=False)
    yield "\n ]\n}\n"


def _frames(protocol: Protocol) -> Iterator[dict[str, Any]]:
    for index in range(protocol.frame_count):
        truth = frame_truth(protocol, index)
        yield {**asdict(truth), "objects": [asdict(obj) for obj in truth.objects]}


def _head(protocol: Protocol) -> dict[str, Any]:
    display = protocol.display
    rate = display.frame_rate
    truths = (frame_truth(protocol, index) for index in range(protocol.frame_count))
    return {
        "schema": _SCHEMA,
        "name": protocol.name,
        "description": protocol.description,
        "source": protocol.source,
        "tool_version": __version__,
        "seed": protocol.seed,
        "protocol": protocol.as_table(),
        "display": {
            "width": display.width,
            "height": display.height,
            "frame_rate": f"{rate.numerator}/{rate.denominator}",
            "pixels_per_degree": display.scale,
            "projection": display.projection,
        },
        "looming": any(truth.looming for truth in truths),
        "contact_time_s": contact_time(protocol),
    }


def contact_time(protocol: Protocol) -> float | None:
    """Return the first time of contact.

    Returns
    -------
    float or None
        Seconds of the clip, maybe after its end; None where nothing approaches, or all passes.
    """
    times = [
        end if obj.growth.contact_s is None else obj.growth.contact_s
        for obj in protocol.objects
        if obj.kind in LOOMING and not obj.reverse
        if obj.growth is not None and obj.growth.kind == "approach"
        for start, end in [motion_times(protocol.timing, obj)]
        if not passes(obj, start, end)
    ]
    staged = (contact_of(protocol, obj) for obj in protocol.objects if obj.kind == PICTURE)
    return min([*times, *(time for time in staged if time is not None)], default=None)


def read_ground_truth(path: Path) -> dict[str, Any]:
    """Read a ``.stimulus.json`` file into the dict that :func:`ground_truth` returned.

    Raises
    ------
    StimulusError
        If the file cannot be read or is not the ground truth of a stimulus.
    """
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
        looming=pose.looming and pose.visible,
    )


def _picture_truth(protocol: Protocol, obj: Object, time: float) -> PictureTruth:
    sight, cutout = sight_of(protocol, obj, time), cutout_of(obj, protocol.seed)
    half, ahead = (obj.size_m or 0.0) / 2, sight.offset[2]
    seen = sight.view.from_camera(sight.offset)
    x, y = sight.view.to_px(seen) if sight.visible else sight.view.middle
    speed = -half * sight.velocity[2]
    left = sight.contact_in_s
    soon = left is not None and left <= camera_of(protocol).looming_within_s
    box = sight.box(half * cutout.width, half * cutout.height) if sight.visible else None
    return PictureTruth(
        id=obj.id,
        kind=obj.kind,
        visible=sight.visible,
        angular_size_deg=2 * math.degrees(math.atan2(half, max(ahead, 0.0))),
        edge_speed_deg_s=math.degrees(speed / (ahead**2 + half**2)),
        edge_speed_px_frame=sight.view.eye_px
        * speed
        / max(ahead, NEAREST_M) ** 2
        / float(protocol.display.frame_rate),
        centre_x_px=x,
        centre_y_px=y,
        time_to_contact_s=left,
        looming=soon and sight.visible,
        box_px=box,
        offset_m=sight.offset,
        miss_sizes=miss_of(protocol, obj),
    )


def _edge_speed(projection: Projection, pose: Pose) -> tuple[float, float]:
    """Speed of the faster end in deg/s and px/s, or the speed of the anchor."""
    extent = pose.extent
    if extent.forward_speed or extent.backward_speed:
        ends = (
            (extent.forward, extent.forward_speed),
            (extent.backward, extent.backward_speed),
        )
        reach, speed = max(ends, key=lambda end: abs(end[1]))
        return speed, projection.reach_speed(reach, speed)
    (x, y), (vx, vy) = pose.centre_deg, pose.velocity_deg_s
    speed = math.hypot(vx, vy)
    if not speed:
        return 0.0, 0.0
    # pixels per degree in this direction, from a short step each way
    step = 1e-3
    x_step, y_step = vx / speed * step, vy / speed * step
    ahead = projection.to_px(x + x_step, y + y_step)
    behind = projection.to_px(x - x_step, y - y_step)
    return speed, speed * math.dist(ahead, behind) / (2 * step)
