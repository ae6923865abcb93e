"""Outlines of figures in pixels."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from oppload_cli.stimulus.geometry import Projection
    from oppload_cli.stimulus.kinematics import Pose
    from oppload_cli.stimulus.objects import Object

Point = tuple[float, float]


def middle_of(projection: Projection, pose: Pose) -> tuple[Point, tuple[float, float]]:
    """Return the middle of a figure as drawn, and its reach from its anchor.

    Parameters
    ----------
    projection : Projection
        From degrees to pixels.
    pose : Pose
        Where the figure is.

    Returns
    -------
    tuple of float
        (x, y) of the middle in pixels, y down.
    tuple of float
        Reach along the axis and against it, in pixels.
    """
    x, y = projection.to_px(*pose.centre_deg)
    ahead, behind = projection.reach(pose.extent.forward), projection.reach(pose.extent.backward)
    shift = (ahead - behind) / 2
    if shift:
        angle = math.radians(pose.orientation_deg)
        x, y = x + shift * math.cos(angle), y - shift * math.sin(angle)
    return (x, y), (ahead, behind)


def corners_of(
    projection: Projection, thing: Object, pose: Pose, height: int, width: int
) -> list[Point]:
    """Return the corners of a figure with straight sides.

    Parameters
    ----------
    projection : Projection
        From degrees to pixels.
    thing : Object
        A square, bar, cross or edge.
    pose : Pose
        Where it is.
    height, width : int
        The display in pixels.

    Returns
    -------
    list of tuple of float
        (x, y) in pixels, in order around the figure.
    """
    (x, y), (ahead, behind) = middle_of(projection, pose)
    half = (ahead + behind) / 2
    if thing.kind == "edge":
        # the covered side of an edge reaches beyond every corner of the display
        far = 2.0 * (height + width + math.hypot(x, y))
        outline = [(0.0, far), (-far, far), (-far, -far), (0.0, -far)]
    elif thing.kind == "cross":
        arm = min(projection.reach((thing.width_deg or 0.0) / 2), half)
        quarter = [(half, arm), (arm, arm), (arm, half)]
        outline = [
            point
            for turn in range(4)
            for point in (_quarter_turns(corner, turn) for corner in quarter)
        ]
    else:
        across = projection.reach((thing.width_deg or 0.0) / 2) if thing.kind == "bar" else half
        outline = [(half, across), (-half, across), (-half, -across), (half, -across)]
    angle = math.radians(pose.orientation_deg)
    cosine, sine = _exact(math.cos(angle)), _exact(math.sin(angle))
    return [(x + u * cosine - v * sine, y - u * sine - v * cosine) for u, v in outline]


def _quarter_turns(point: Point, turns: int) -> Point:
    x, y = point
    for _ in range(turns):
        x, y = -y, x
    return x, y


def _exact(value: float) -> float:
    """Take the rounding error off the sines of multiples of 90 degrees."""
    return float(round(value)) if abs(value - round(value)) < 1e-12 else value
