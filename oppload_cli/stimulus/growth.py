"""How far a figure reaches, and how fast its edges move."""

from __future__ import annotations

import bisect
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from oppload_cli.stimulus.changes import Growth
    from oppload_cli.stimulus.objects import Object


@dataclass(frozen=True)
class Extent:
    """Reach of a figure to both sides of its anchor, along its axis.

    Attributes
    ----------
    forward, backward : float
        Degrees, at least 0.
    forward_speed, backward_speed : float
        How fast they grow, in deg/s.
    """

    forward: float
    backward: float
    forward_speed: float = 0.0
    backward_speed: float = 0.0

    @property
    def size(self) -> float:
        """The whole size in degrees."""
        return self.forward + self.backward

    def times(self, sign: float) -> Extent:
        """Return the same reach with its speeds multiplied.

        Parameters
        ----------
        sign : float
            1 forwards in time, -1 backwards, 0 at rest.

        Returns
        -------
        Extent
        """
        return Extent(
            self.forward, self.backward, sign * self.forward_speed, sign * self.backward_speed
        )


def extent_of(thing: Object, elapsed: float, start: float, end: float) -> Extent:
    """Return the reach of a figure.

    Parameters
    ----------
    thing : Object
        The figure; a pattern has none.
    elapsed : float
        Seconds since its motion's start.
    start, end : float
        When its motion starts and ends, in seconds of the clip.

    Returns
    -------
    Extent
        With the speeds it has when time runs forwards.
    """
    growth, size = thing.growth, thing.size_deg or 0.0
    if growth is None:
        return Extent(size / 2, size / 2)
    if growth.kind == "approach":
        contact = end if growth.contact_s is None else growth.contact_s
        return approach(growth, contact - start - elapsed)
    if growth.kind == "steps":
        index = bisect.bisect_right(growth.times_s, elapsed + 1e-9)
        size = growth.sizes_deg[index - 1] if index else size
        return Extent(size / 2, size / 2)
    return constant_edge_speed(growth, size, elapsed)


def approach(growth: Growth, remaining: float) -> Extent:
    """Return the reach of an object that approaches at constant speed.

    Its angular size is ``2 atan((l/v) / (contact - t))``, with l the half size of the
    object and v its speed (Gabbiani et al. 1999).

    Parameters
    ----------
    growth : Growth
        With ``l_over_v_ms``, and the least and most size shown.
    remaining : float
        Time to contact in seconds; from 0 on the object fills the view.

    Returns
    -------
    Extent
    """
    ratio = (growth.l_over_v_ms or 0.0) / 1000
    half = math.degrees(math.atan2(ratio, remaining)) if remaining > 0 else 90.0
    speed = math.degrees(ratio / (remaining**2 + ratio**2)) if remaining > 0 else 0.0
    if half <= growth.least_deg / 2 or half >= growth.most_deg / 2:
        half, speed = min(max(half, growth.least_deg / 2), growth.most_deg / 2), 0.0
    return Extent(half, half, speed, speed)


def constant_edge_speed(growth: Growth, size: float, elapsed: float) -> Extent:
    """Return the reach of a figure whose edges move at constant speed.

    Parameters
    ----------
    growth : Growth
        With ``speed_deg_s``, ``sides`` and maybe ``end_deg``.
    size : float
        Size at the start, in degrees.
    elapsed : float
        Seconds since the start.

    Returns
    -------
    Extent
    """
    speed = growth.speed_deg_s or 0.0
    forward = speed if growth.sides in {"both", "forward"} else 0.0
    backward = speed if growth.sides in {"both", "backward"} else 0.0
    moving = True
    if growth.end_deg is not None:
        lasts = abs(growth.end_deg - size) / (forward + backward)
        moving, elapsed = elapsed < lasts, min(elapsed, lasts)
        if growth.end_deg < size:
            forward, backward = -forward, -backward
    reach = Extent(size / 2 + forward * elapsed, size / 2 + backward * elapsed, forward, backward)
    return reach.times(1.0 if moving else 0.0)
