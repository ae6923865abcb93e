"""The extent of an object, its growth, and its time to contact (``docs/explanation/boxes.md``)."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, ClassVar, NamedTuple

import numpy as np

from oppload_cli.models.presets import DEFAULT_PRESET
from oppload_cli.models.timebase import ROUNDING_S
from oppload_cli.schema import Parameters, parameter

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from oppload_cli.models.detector import UnitMaps
    from oppload_cli.models.dpc import Map
    from oppload_cli.motion.growth import Growth

    Floats = NDArray[np.float64]


_WINDOW = 2.0  # half side of the window in which an object's motion is measured, in half sizes
_LEAST_WINDOW = 3  # least half side in cells; a smaller window shows one blurred point only
_WINDOWS = 4  # most windows that are tried; the size settles in two or three
_MOST_SAMPLES = 256  # largest number of growths kept, for very high frame rates


@dataclass(frozen=True, kw_only=True)
class PlaceParams(Parameters):
    """Parameters of looming objects: their search, their identity and their time to contact.

    Source: ``docs/explanation/boxes.md``.

    Examples
    --------
    >>> import oppload_cli as oppload
    >>> few = oppload.PlaceParams(most=1)
    >>> records = oppload.analyse("controls/two-looming-disks", places=few, rmo=False)
    >>> max(len(record.detections) for record in records)
    1
    """

    _set: ClassVar[str] = "places"

    floor: float = parameter(1e-5, "least response of an object", low=0, high=1e9)
    share: float = parameter(
        0.01,
        "least response of an object, as a share of the largest response of the frame",
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


# Responses under these presets are on another scale than those under preset default.
_PLACES = dict.fromkeys(("reference", "paper"), PlaceParams(floor=1e-6))


def place_params(preset: str = DEFAULT_PRESET) -> PlaceParams:
    """Return the parameters of the looming objects under a preset."""
    return _PLACES.get(preset, PlaceParams())


class Extent(NamedTuple):
    """Half sizes of an object in working pixels, measured from its focus of expansion.

    Attributes
    ----------
    x, y : float
        Half width and half height.
    opponency : float
        Sum of outward minus inward products in the window around the object.
    """

    x: float
    y: float
    opponency: float


class Products:
    """The opponent products around any unit of the latest frame, up to the edges of the frame.

    They are ``O(u) = S_phi(c + u) S_(phi+180)(c - u)``, summed over both axes, as in section 5 of
    ``docs/model.md``, but not limited to the receptive field. `maps` must have pooled pathways.
    """

    def __init__(self, maps: UnitMaps) -> None:
        self._maps = maps
        rows, columns = maps.responses.shape
        self._offsets_y = np.arange(-rows, rows + 1)
        self._offsets_x = np.arange(-columns, columns + 1)
        self._middle = rows, columns
        self._pairs = [
            (maps.pathways[phi], maps.pathways[phi + 180], _signs(rows, columns, phi))
            for phi in maps.pathways
            if phi < 180
        ]
        self._cell_y, self._cell_x = _spacing(maps.centres_y), _spacing(maps.centres_x)

    def extent(self, row: int, column: int, x: float, y: float) -> Extent | None:
        """Measure an object around a unit.

        For an expanding ring of radius r the mean of u_x^2, weighted by the products, is
        ``E[u_x^2] = r^2 / 2``. Pooling with sigma adds ``sigma^2 / 2``, since the product of two
        Gaussians of width sigma is a Gaussian of width sigma / sqrt(2). So an ellipse's half width
        is ``sqrt(2 E[u_x^2] - sigma^2)``.

        Parameters
        ----------
        row, column : int
            The unit.
        x, y : float
            First guess of the half sizes, in working pixels.

        Returns
        -------
        Extent or None
            None if nothing moves outward on both sides.
        """
        latest = None
        for _ in range(_WINDOWS):
            moments = self._moments(row, column, *self._reach(row, column, x, y))
            if moments is None:
                break
            square_x, square_y, opponency = moments
            before = x, y
            x = self._half_size(square_x * self._cell_x**2)
            y = self._half_size(square_y * self._cell_y**2)
            latest = Extent(x, y, opponency)
            if abs(x - before[0]) < self._cell_x / 4 and abs(y - before[1]) < self._cell_y / 4:
                break
        return latest

    def better_unit(self, row: int, column: int, extent: Extent) -> tuple[int, int]:
        """Return the unit with most outward motion around it: the given unit or a neighbour.

        The window follows from `extent`, and is the same for all nine units.
        """
        rows, columns = self._maps.responses.shape
        most_outward, unit = -math.inf, (row, column)
        for y in range(max(0, row - 1), min(rows, row + 2)):
            for x in range(max(0, column - 1), min(columns, column + 2)):
                moments = self._moments(y, x, *self._reach(y, x, extent.x, extent.y))
                if moments is not None and moments[2] > most_outward:
                    most_outward, unit = moments[2], (y, x)
        return unit

    def _reach(self, row: int, column: int, x: float, y: float) -> tuple[int, int]:
        """Return the half sides of the window in cells; it does not reach beyond the frame."""
        rows, columns = self._maps.responses.shape
        wanted_y = max(_LEAST_WINDOW, math.ceil(_WINDOW * y / self._cell_y))
        wanted_x = max(_LEAST_WINDOW, math.ceil(_WINDOW * x / self._cell_x))
        reach_y = min(wanted_y, row, rows - 1 - row)
        reach_x = min(wanted_x, column, columns - 1 - column)
        return reach_y, reach_x

    def _moments(
        self, row: int, column: int, reach_y: int, reach_x: int
    ) -> tuple[float, float, float] | None:
        """Return E[u_x^2], E[u_y^2] (weighted by outward products) and outward minus inward."""
        window = np.s_[row - reach_y : row + reach_y + 1, column - reach_x : column + reach_x + 1]
        middle_y, middle_x = self._middle
        span_y = slice(middle_y - reach_y, middle_y + reach_y + 1)
        span_x = slice(middle_x - reach_x, middle_x + reach_x + 1)
        outward = np.zeros((2 * reach_y + 1, 2 * reach_x + 1), np.float32)
        difference = 0.0
        for passing, opposite, signs in self._pairs:
            products = passing[window] * opposite[window][::-1, ::-1]
            products *= signs[span_y, span_x]
            difference += float(products.sum())
            outward += np.maximum(products, 0)
        total = float(outward.sum())
        if total <= 0:
            return None
        along_x = outward.sum(axis=0) @ self._offsets_x[span_x] ** 2
        along_y = outward.sum(axis=1) @ self._offsets_y[span_y] ** 2
        return float(along_x) / total, float(along_y) / total, difference

    def _half_size(self, square: float) -> float:
        """Return the half size of an ellipse: at least half of the blur and half a pixel."""
        least = max(1.0, self._maps.spread) / 2
        return math.sqrt(max(2 * square - self._maps.spread**2, least**2))


@cache
def _signs(rows: int, columns: int, phi: int) -> Map:
    """Return 1 at offsets u with u . u_phi > 0, -1 at those with u . u_phi < 0, else 0."""
    across, up = math.cos(math.radians(phi)), math.sin(math.radians(phi))
    y, x = np.mgrid[-rows : rows + 1, -columns : columns + 1]
    return np.asarray(np.sign(np.round(x * across - y * up, 6)), np.float32)


def _spacing(centres: Floats) -> float:
    return float(centres[1] - centres[0]) if len(centres) > 1 else 1.0


class Contact:
    """The growth of one object, and its time to contact.

    If an object approaches at constant speed, its size in the frame is ``s = A / (T - t)``. So a
    growth k since ``t - d`` gives the time of contact, ``T = t + d / k``. The mean of several such
    times, weighted by their standard errors, is a better estimate.

    Parameters
    ----------
    params : PlaceParams
        Gives the conditions that an estimate must meet.

    Source: ``docs/explanation/boxes.md``, "Time to contact".
    """

    def __init__(self, params: PlaceParams) -> None:
        self._params = params
        self._samples: deque[tuple[float, float, float]] = deque(maxlen=_MOST_SAMPLES)

    def add(self, time_s: float, passed_s: float, growth: Growth) -> None:
        """Take a measured growth.

        Parameters
        ----------
        time_s : float
            Time of the later of the two frames, in seconds.
        passed_s : float
            Time between the two frames in seconds, above 0.
        growth : Growth
            If it is at most its standard error, nothing approaches, and earlier growths are
            forgotten. If its error is above the share `largest_error` of it, it is left out.
        """
        grown, error = growth
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
        oldest = time_s - self._params.memory_s - ROUNDING_S
        while self._samples and self._samples[0][0] < oldest:
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
