"""The time to contact of an object, from its growth (``docs/places.md``)."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from oppload_cli.frame_times import ticks
from oppload_cli.schema import Parameters, parameter

if TYPE_CHECKING:
    from oppload_cli.motion.growth import LocalMotion


@dataclass(frozen=True, kw_only=True)
class PlaceParams(Parameters):
    """Parameters of looming objects: their search, their identity and their time to contact.

    Source: ``docs/places.md``.

    Examples
    --------
    >>> import oppload_cli as oppload
    >>> few = oppload.PlaceParams(most=1)
    >>> records = oppload.analyse("controls/two-looming-disks", places=few, rmo=False)
    >>> max(len(record.detections) for record in records)
    1
    """

    _set: ClassVar[str] = "places"

    floor: float | None = parameter(
        None, "least response of an object; auto: the detector's own, 0.02 for OppLoD",
        low=0, high=1e9,
    )  # fmt: skip
    share: float | None = parameter(
        None,
        "least response of an object, as a share of the largest response of the frame; auto: the "
        "detector's own, 0.2 for OppLoD",
        low=0,
        high=1,
    )
    most: int = parameter(
        5, "largest number of objects in a frame", unit="objects", low=1, high=100
    )
    gap_s: float = parameter(
        0.2, "time for which an object keeps its number without being seen", low=0, high=60
    )
    memory_s: float = parameter(
        0.2, "time over which the growth of an object is measured", low=0.01, high=60
    )
    least_frames: int = parameter(
        3,
        "least number of measured growths for a time to contact",
        unit="growths",
        low=2,
        high=1000,
    )
    least_growth: float = parameter(
        1.15, "least total growth of the size for a time to contact, as a factor", low=1, high=100
    )
    largest_error: float = parameter(
        0.5, "largest standard error of a time to contact, as a share of it", low=0.001, high=10
    )

    def of(self, least_object: tuple[float, float]) -> PlaceParams:
        """Return these parameters for a detector, whose own `floor` and `share` are given."""
        floor, share = least_object
        return self.replaced(
            floor=floor if self.floor is None else self.floor,
            share=share if self.share is None else self.share,
        )


class Contact:
    """The growth of one object, and its time to contact.

    If an object approaches at constant speed, its size in the frame is ``s = A / (T - t)``. So a
    growth k since ``t - d`` gives the time of contact, ``T = t + d / k``. The mean of several such
    times, weighted by their standard errors, is a better estimate.

    Parameters
    ----------
    params : PlaceParams
        Gives the conditions that an estimate must meet.

    Source: ``docs/places.md``.
    """

    def __init__(self, params: PlaceParams) -> None:
        self._params = params
        self._samples: deque[tuple[float, float, float]] = deque()

    def add(self, time_s: float, passed_s: float, motion: LocalMotion) -> None:
        """Take a measured growth.

        Parameters
        ----------
        time_s : float
            Time of the later of the two frames, in seconds.
        passed_s : float
            Time between the two frames in seconds, above 0.
        motion : LocalMotion
            Has the growth and its error. If the growth is at most its standard error, nothing
            approaches, and earlier growths are forgotten. If its error is above the share
            `largest_error` of it, it is left out.
        """
        grown, error = motion.factor.real, motion.error
        if grown <= error:
            self._samples.clear()
        elif error < grown * self._params.largest_error:
            contact_error = passed_s * error / grown**2
            self._samples.append((time_s, time_s + passed_s / grown, contact_error))

    def remaining(self, time_s: float) -> tuple[float, float] | None:
        """Return the time to contact and its error.

        Both are in seconds, above 0. The result is None unless there are enough growths, enough
        growth in all, and an error below the share `largest_error` of the time. The error is the
        scatter of the single times: neighbouring growths err alike, so that their mean is hardly
        better.
        """
        oldest = ticks(time_s) - ticks(self._params.memory_s)
        while self._samples and ticks(self._samples[0][0]) < oldest:
            self._samples.popleft()
        if len(self._samples) < self._params.least_frames:
            return None
        times, contacts, errors = np.array(self._samples).T
        weights = errors**-2 / (errors**-2).sum()
        contact = float(weights @ contacts)
        error = math.sqrt(float(weights @ (errors**2 + (contacts - contact) ** 2)))
        remaining = contact - time_s
        if remaining <= 0 or error > self._params.largest_error * remaining:
            return None
        grown = (contact - times[0]) / remaining
        return (remaining, error) if grown >= self._params.least_growth else None
