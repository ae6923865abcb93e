"""Ground truth: what each frame shows, as numbers, and the file that holds it."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from oppload_cli.errors import StimulusError
from oppload_cli.stimulus.geometry import Projection
from oppload_cli.stimulus.kinematics import motion_times, pose_of
from oppload_cli.stimulus.objects import LOOMING, SIZED
from oppload_cli.stimulus.outline import middle_of
from oppload_cli.version import __version__

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from oppload_cli.stimulus.kinematics import Pose
    from oppload_cli.stimulus.objects import Object
    from oppload_cli.stimulus.protocol import Protocol

SCHEMA = "oppload.stimulus/1"


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
        How fast the edges move away from the anchor (negative: towards it); for what
        does not grow, how fast it moves.
    edge_speed_px_frame : float
        The same on the display, in pixels per frame.
    centre_x_px, centre_y_px : float
        Middle of the figure as drawn; x right, y down, pixel i covers [i, i + 1).
    time_to_contact_s : float or None
        Only while it approaches.
    looming : bool
        Whether its whole outline grows.
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
    """Return what a frame shows.

    Parameters
    ----------
    protocol : Protocol
        The stimulus.
    frame : int
        0-based.

    Returns
    -------
    FrameTruth
    """
    time = protocol.time_of(frame)
    things = tuple(
        _object_truth(protocol, thing, pose_of(protocol, thing, time)) for thing in protocol.objects
    )
    return FrameTruth(frame, time, any(thing.looming for thing in things), things)


def ground_truth(protocol: Protocol) -> dict[str, Any]:
    """Return the ground truth of a stimulus, ready for JSON.

    Parameters
    ----------
    protocol : Protocol
        The stimulus.

    Returns
    -------
    dict
        As described in ``docs/stimuli.md``.
    """
    return {**_head(protocol), "frames": list(_frames(protocol))}


def ground_truth_text(protocol: Protocol) -> Iterator[str]:
    """Return the ground truth as the text of its file, a line for each frame.

    Parameters
    ----------
    protocol : Protocol
        The stimulus.

    Yields
    ------
    str
        Part of the JSON; the clip's truth is never in memory as a whole.
    """
    yield json.dumps(_head(protocol), indent=1, ensure_ascii=False)[:-2] + ',\n "frames": ['
    for index, frame in enumerate(_frames(protocol)):
        yield ("," if index else "") + "\n  " + json.dumps(frame, ensure_ascii=False)
    yield "\n ]\n}\n"


def _frames(protocol: Protocol) -> Iterator[dict[str, Any]]:
    for index in range(protocol.frame_count):
        truth = frame_truth(protocol, index)
        yield {**asdict(truth), "objects": [asdict(thing) for thing in truth.objects]}


def _head(protocol: Protocol) -> dict[str, Any]:
    display = protocol.display
    rate = display.frame_rate
    truths = (frame_truth(protocol, index) for index in range(protocol.frame_count))
    return {
        "schema": SCHEMA,
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

    Parameters
    ----------
    protocol : Protocol
        The stimulus.

    Returns
    -------
    float or None
        Seconds of the clip, maybe after its end; None where nothing approaches.
    """
    times = [
        motion_times(protocol.timing, thing)[1]
        if thing.growth.contact_s is None
        else thing.growth.contact_s
        for thing in protocol.objects
        if thing.kind in LOOMING and not thing.reverse
        if thing.growth is not None and thing.growth.kind == "approach"
    ]
    return min(times, default=None)


def read_ground_truth(path: Path) -> dict[str, Any]:
    """Read a ``.stimulus.json`` file.

    Parameters
    ----------
    path : Path
        The file.

    Returns
    -------
    dict
        As :func:`ground_truth` returned it.

    Raises
    ------
    StimulusError
        If it cannot be read or is not the ground truth of a stimulus.
    """
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as problem:
        reason = problem.strerror if isinstance(problem, OSError) else "it is not valid JSON"
        raise StimulusError(
            f"{path}: cannot read the ground truth: {reason}; generate the stimulus again"
        ) from None
    schema = data.get("schema") if isinstance(data, dict) else None
    if schema != SCHEMA or not isinstance(data.get("frames"), list):
        raise StimulusError(
            f"{path}: its schema is {schema!r}, not '{SCHEMA}'; generate the stimulus again with "
            "this version"
        )
    return dict(data)


def _object_truth(protocol: Protocol, thing: Object, pose: Pose) -> ObjectTruth:
    projection = Projection.of(protocol.display)
    (x, y), _ = middle_of(projection, pose)
    degrees, pixels = _edge_speed(projection, pose)
    return ObjectTruth(
        id=thing.id,
        kind=thing.kind,
        visible=pose.visible,
        angular_size_deg=pose.extent.size if thing.kind in SIZED else None,
        edge_speed_deg_s=degrees,
        edge_speed_px_frame=pixels / float(protocol.display.frame_rate),
        centre_x_px=x,
        centre_y_px=y,
        time_to_contact_s=pose.contact_in_s,
        looming=pose.looming and pose.visible,
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
