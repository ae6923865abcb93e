"""Time to contact from the growth of an object (``docs/places.md``)."""

from __future__ import annotations

import math
from collections import deque
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from oppload_cli.detection.parameters import PlaceParams

    _Series = NDArray[np.float64]

MOST_SAMPLES = 256  # in case times stand still
TOO_FAR = 2.5  # standard deviations: a size off the line by more is left out once


class Contact:
    """The growth of one object, and when it will touch.

    In a camera's picture the size of what approaches at constant speed is
    ``s = A / (T - t)``: ``1 / s`` falls on a straight line that meets 0 at the time of
    contact T. An error e of s is one of ``e / s^2`` in ``1 / s``, so that the least
    squares weigh by ``s^4``.

    Parameters
    ----------
    params : PlaceParams
        When the estimate is determined.
    """

    def __init__(self, params: PlaceParams) -> None:
        self._params = params
        self._samples: deque[tuple[float, float]] = deque(maxlen=MOST_SAMPLES)

    def add(self, time_s: float, size: float) -> None:
        """Take the size at a time.

        Parameters
        ----------
        time_s : float
            Seconds.
        size : float
            Any measure in pixels, above 0.
        """
        self._samples.append((time_s, size))
        while self._samples[0][0] < time_s - self._params.memory_s:
            self._samples.popleft()

    def remaining(self, time_s: float) -> float | None:
        """Return the time to contact.

        Parameters
        ----------
        time_s : float
            Now, in seconds.

        Returns
        -------
        float or None
            Seconds, above 0; None unless it is determined: enough frames, enough
            growth, and a standard error of the fit below `largest_error` of it.
        """
        if len(self._samples) < self._params.least_frames:
            return None
        times, sizes = np.array(self._samples).T
        times -= time_s
        estimate = self._fitted(times, sizes)
        if estimate is None:
            return None
        contact, error = estimate
        return contact if contact > 0 and error < self._params.largest_error * contact else None

    def _fitted(self, times: _Series, sizes: _Series) -> tuple[float, float] | None:
        """Return the time of contact and its standard error; None where nothing grows."""
        contact, error, residuals = _line(times, sizes)
        spread = math.sqrt(float(residuals @ residuals) / len(times))
        kept = np.abs(residuals) <= TOO_FAR * spread
        if self._params.least_frames <= kept.sum() < len(times):
            times, sizes = times[kept], sizes[kept]
            contact, error, _ = _line(times, sizes)
        if not math.isfinite(contact) or times[0] >= contact:
            return None
        grown = (contact - times[0]) / (contact - times[-1]) if contact > times[-1] else math.inf
        return (contact, error) if grown >= self._params.least_growth else None


def _line(times: _Series, sizes: _Series) -> tuple[float, float, _Series]:
    """Fit 1/s = slope (t - T): return T, its standard error, and the residuals of s."""
    weights = sizes**4
    inverse = 1 / sizes
    total = weights.sum()
    mean_t, mean_y = weights @ times / total, weights @ inverse / total
    t, y = times - mean_t, inverse - mean_y
    about = weights @ t**2
    slope = weights @ (t * y) / about if about > 0 else 0.0
    residuals = (y - slope * t) * sizes**2
    if slope >= 0:
        return math.inf, math.inf, residuals
    contact = mean_t - mean_y / slope
    variance = residuals @ residuals / (len(times) - 2)
    # T = mean_t - mean_y / slope: errors of the mean and of the slope add.
    error = math.sqrt(variance * (1 / total + (mean_y / slope) ** 2 / about)) / -slope
    return float(contact), error, residuals
