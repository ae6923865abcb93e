"""The extent of an object, its growth, and its time to contact (``docs/places.md``)."""

from __future__ import annotations

import math
from collections import deque
from functools import cache
from typing import TYPE_CHECKING, NamedTuple

import cv2
import numpy as np

from oppload_cli.models.dpc import smaller

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from oppload_cli.detection.parameters import PlaceParams
    from oppload_cli.models.detector import UnitMaps
    from oppload_cli.models.dpc import Map

    Floats = NDArray[np.float64]
    Region = tuple[float, float, float, float]


_WINDOW = 2.0  # sizes: how far around an object its own motion is looked for
_LEAST_WINDOW = 3  # cells: less holds no more than one blurred point
_WINDOWS = 4  # that follow the size; it settles in two or three
SIDE = 24  # samples across a region
_ROUNDS = 3  # of the registration
_LEAST_SEEN = 0.15  # share of the region that both frames must show
_MOST_GROWTH = 4.0  # between the two frames, and the inverse of the least
_FURTHEST = 1.0  # half sizes that the middle may have moved
_NOISE = 1 / 255  # of a sample: one grey level of 8 bits
_ALIKE = 9  # errors of 3 x 3 neighbouring samples are correlated: one in 9 is independent
_MOST_SAMPLES = 256  # in case of very many frames per second
_TOO_FAR = 2.5  # contact times so many standard deviations off the mean are dropped, once
_PRIOR = _NOISE**2 * np.eye(3)  # keeps a, b or k small where the picture does not determine it
_BEYOND = -1e3  # samples beyond the frame; luminance is at least 0
_NEIGHBOURS = np.ones((3, 3), np.uint8)


class Extent(NamedTuple):
    """Half sizes of an object in working pixels, seen from its focus.

    Attributes
    ----------
    x, y : float
        Half width and half height.
    opponency : float
        Outward minus inward products within its window.
    """

    x: float
    y: float
    opponency: float


class Products:
    """The opponent products about any one unit of the latest frame, over all of the frame.

    ``O(u) = S_phi(c + u) S_(phi+180)(c - u)``, summed over both axes, as in
    ``docs/model.md``, section 5, but not cut off by the receptive field.

    `maps` must have pooled pathways.
    """

    def __init__(self, maps: UnitMaps) -> None:
        self._maps = maps
        rows, columns = maps.responses.shape
        self._offsets_y = np.arange(-rows, rows + 1)
        self._offsets_x = np.arange(-columns, columns + 1)
        self._middle = rows, columns
        self._pairs = [
            (maps.pathways[phi], maps.pathways[(phi + 180) % 360], _signs(rows, columns, phi))
            for phi in maps.pathways
            if phi < 180
        ]
        self._cell_y, self._cell_x = _spacing(maps.centres_y), _spacing(maps.centres_x)

    def extent(self, row: int, column: int, x: float, y: float) -> Extent | None:
        """Measure an object about a unit.

        A ring of radius r that widens gives ``E[u_x^2] = r^2 / 2`` over its
        products, and the pooling by sigma adds ``sigma^2 / 2``: the product of two
        Gaussians is one of sigma / sqrt(2). So an ellipse's half width is
        ``sqrt(2 E[u_x^2] - sigma^2)``.

        Parameters
        ----------
        row, column : int
            The unit.
        x, y : float
            Half sizes to begin with, in working pixels.

        Returns
        -------
        Extent or None
            None where nothing moves outward on both sides.
        """
        found = None
        for _ in range(_WINDOWS):
            moments = self._moments(row, column, *self._reach(row, column, x, y))
            if moments is None:
                break
            square_x, square_y, opponency = moments
            before = x, y
            x, y = self._half(square_x * self._cell_x**2), self._half(square_y * self._cell_y**2)
            found = Extent(x, y, opponency)
            if abs(x - before[0]) < self._cell_x / 4 and abs(y - before[1]) < self._cell_y / 4:
                break
        return found

    def better_unit(self, row: int, column: int, extent: Extent) -> tuple[int, int]:
        """Return the unit with the most outward motion about it, among a unit and its 8 neighbours.

        The window of `extent` serves all nine.
        """
        rows, columns = self._maps.responses.shape
        best, found = -math.inf, (row, column)
        for y in range(max(0, row - 1), min(rows, row + 2)):
            for x in range(max(0, column - 1), min(columns, column + 2)):
                moments = self._moments(y, x, *self._reach(y, x, extent.x, extent.y))
                if moments is not None and moments[2] > best:
                    best, found = moments[2], (y, x)
        return found

    def _reach(self, row: int, column: int, x: float, y: float) -> tuple[int, int]:
        """Return the window in cells to each side: it ends where the frame does."""
        rows, columns = self._maps.responses.shape
        wanted_y = max(_LEAST_WINDOW, math.ceil(_WINDOW * y / self._cell_y))
        wanted_x = max(_LEAST_WINDOW, math.ceil(_WINDOW * x / self._cell_x))
        reach_y = min(wanted_y, row, rows - 1 - row)
        reach_x = min(wanted_x, column, columns - 1 - column)
        return reach_y, reach_x

    def _moments(
        self, row: int, column: int, reach_y: int, reach_x: int
    ) -> tuple[float, float, float] | None:
        """Return E[u_x^2] and E[u_y^2] over the outward products, and outward minus inward."""
        here = np.s_[row - reach_y : row + reach_y + 1, column - reach_x : column + reach_x + 1]
        middle_y, middle_x = self._middle
        span_y = slice(middle_y - reach_y, middle_y + reach_y + 1)
        span_x = slice(middle_x - reach_x, middle_x + reach_x + 1)
        outward = np.zeros((2 * reach_y + 1, 2 * reach_x + 1), np.float32)
        difference = 0.0
        for one, other, signs in self._pairs:
            products = one[here] * other[here][::-1, ::-1]
            products *= signs[span_y, span_x]
            difference += float(products.sum())
            outward += np.maximum(products, 0)
        total = float(outward.sum())
        if total <= 0:
            return None
        along_x = outward.sum(axis=0) @ self._offsets_x[span_x] ** 2
        along_y = outward.sum(axis=1) @ self._offsets_y[span_y] ** 2
        return float(along_x) / total, float(along_y) / total, difference

    def _half(self, square: float) -> float:
        """Return the half size of an ellipse: at least half of the blur, and half a pixel."""
        least = max(1.0, self._maps.spread) / 2
        return math.sqrt(max(2 * square - self._maps.spread**2, least**2))


@cache
def _signs(rows: int, columns: int, phi: int) -> Map:
    """Return 1 at the offsets u with u . u_phi > 0, -1 where it is below 0."""
    across, up = math.cos(math.radians(phi)), math.sin(math.radians(phi))
    y, x = np.mgrid[-rows : rows + 1, -columns : columns + 1]
    return np.asarray(np.sign(np.round(x * across - y * up, 6)), np.float32)


def _spacing(centres: Floats) -> float:
    return float(centres[1] - centres[0]) if len(centres) > 1 else 1.0


class Growth(NamedTuple):
    """The growth of an object between two frames.

    Attributes
    ----------
    shrinkage : float
        Earlier over later size, less 1: below 0 for an object that grew.
    error : float
        Standard error of the shrinkage.
    """

    shrinkage: float
    error: float


class Picture:
    """A frame, and on demand the same frame at a half of its size, a quarter and so on.

    Parameters
    ----------
    luma : ndarray of float32, shape (height, width)
        Luminance, 0 to 1; it is copied.
    """

    def __init__(self, luma: Map) -> None:
        self._levels = [luma.copy()]

    def samples(self, region: Region, level: int) -> Map:
        """Sample a region evenly.

        Parameters
        ----------
        region : tuple of float
            Centre (x, y) and half sizes in pixels of the frame.
        level : int
            0 for the frame, 1 for half its size and so on.

        Returns
        -------
        ndarray of float32, shape (SIDE, SIDE)
            Below 0 beyond the frame.
        """
        while level >= len(self._levels):
            self._levels.append(smaller(self._levels[-1], 2))
        x, y, half_x, half_y = region
        scale = 0.5**level
        step_x, step_y = 2 * half_x / SIDE * scale, 2 * half_y / SIDE * scale
        # Pixel i covers [i, i + 1), and OpenCV counts from the centre of pixel 0.
        first_x = (x - half_x) * scale + step_x / 2 - 0.5
        first_y = (y - half_y) * scale + step_y / 2 - 0.5
        samples = cv2.warpAffine(
            self._levels[level],
            np.array([[step_x, 0.0, first_x], [0.0, step_y, first_y]]),
            (SIDE, SIDE),
            flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
            borderMode=cv2.BORDER_CONSTANT,
            borderValue=_BEYOND,
        )
        return np.asarray(samples, np.float32)


def growth(now: Picture, before: Picture, region: Region, start: float = 0.0) -> Growth | None:
    """Measure how much the content of a region has grown since an earlier frame.

    A point p of the region, counted from its middle, lies at ``p + (a, b) + k p`` in the earlier
    frame: (a, b) is the displacement and k the shrinkage on the way back. Least squares over the
    region's ellipse give a, b and k; each round moves the earlier picture by them.

    Parameters
    ----------
    now, before : Picture
        The later and the earlier frame.
    region : tuple of float
        Centre (x, y) and half sizes in the later one, in its pixels.
    start : float
        The shrinkage to begin with, above -1.

    Returns
    -------
    Growth or None
        None where the earlier frame does not show the content of the region.

    Source: ``docs/places.md``, "Time to contact".
    """
    x, y, half_x, half_y = region
    # The level with as many pixels as samples, or up to twice as many.
    level = max(0, math.floor(math.log2(2 * math.sqrt(half_x * half_y) / SIDE)))
    here = now.samples(region, level)
    seen, steps = _steps(here)
    exact = steps.astype(np.float64)  # one straight edge does not determine a, b and k
    _, inverse = cv2.invert(exact @ exact.T + _PRIOR)
    flat = here.ravel()
    scale, a, b = 1 + start, 0.0, 0.0
    for _ in range(_ROUNDS):
        region = (x + a * half_x, y + b * half_y, scale * half_x, scale * half_y)
        there = before.samples(region, level).ravel()
        both = seen & (there >= 0)
        count = int(np.count_nonzero(both))
        if count < _LEAST_SEEN * SIDE**2:
            return None
        rest = (there - flat) * both
        moved_a, moved_b, shrunk = (inverse @ (steps @ rest)).tolist()
        if shrunk <= -1:
            return None
        scale /= 1 + shrunk
        a, b = a - scale * moved_a, b - scale * moved_b
        if not 1 / _MOST_GROWTH < scale < _MOST_GROWTH or max(abs(a), abs(b)) > _FURTHEST:
            return None
    variance = max(float(rest @ rest) / count, _NOISE**2)
    return Growth(scale - 1, math.sqrt(_ALIKE * variance * float(inverse[2, 2])))


def _steps(here: Map) -> tuple[NDArray[np.bool_], Map]:
    """Return which samples count, and how each changes with a, b and k."""
    across, down, within = _grid()
    seen = within & (cv2.erode(here, _NEIGHBOURS) >= 0)
    steps = np.zeros((3, SIDE, SIDE), np.float32)
    steps[0, :, 1:-1] = here[:, 2:] - here[:, :-2]
    steps[1, 1:-1] = here[2:] - here[:-2]
    steps *= seen * np.float32(SIDE / 4)  # per half size, over two samples
    steps[2] = steps[0] * across + steps[1] * down
    return seen.ravel(), steps.reshape(3, -1)


@cache
def _grid() -> tuple[Map, Map, NDArray[np.bool_]]:
    """Return how far each sample is from the middle in half sizes, and which are inside."""
    along = (2 * np.arange(SIDE) + 1 - SIDE) / SIDE
    across, down = np.meshgrid(along.astype(np.float32), along.astype(np.float32))
    inside = np.zeros((SIDE, SIDE), bool)
    inside[1:-1, 1:-1] = (across**2 + down**2 <= 1)[1:-1, 1:-1]
    return across, down, inside


class Contact:
    """The growth of one object, and its time to contact.

    In a camera's picture the size of an object that approaches at constant speed is
    ``s = A / (T - t)``. So two of its sizes give the time of contact T, and the mean of several
    such times, weighted by their standard errors, gives it better.

    Parameters
    ----------
    params : PlaceParams
        Gives the conditions under which the estimate is determined.

    Source: ``docs/places.md``, "Time to contact".
    """

    def __init__(self, params: PlaceParams) -> None:
        self._params = params
        self._samples: deque[tuple[float, float, float, float]] = deque(maxlen=_MOST_SAMPLES)

    def add(self, time_s: float, passed_s: float, growth: Growth) -> None:
        """Take the growth up to a time.

        Parameters
        ----------
        time_s : float
            Seconds.
        passed_s : float
            How long it grew until then, in seconds, above 0.
        growth : Growth
            If it is within its standard error of none, nothing approaches, and earlier growths are
            forgotten. If its error is above the share `largest_error` of it, it does not count.
        """
        shrinkage, error = growth
        if shrinkage + error >= 0:
            self._samples.clear()
        elif error < -shrinkage * self._params.largest_error:
            contact_s = time_s - passed_s * (1 + 1 / shrinkage)
            contact_error = passed_s * error / shrinkage**2
            self._samples.append((time_s, contact_s, contact_error, passed_s))

    def expected(self, time_s: float, before_s: float) -> float:
        """Return the shrinkage between two times by the latest growth; 0 without one."""
        if not self._samples:
            return 0.0
        contact_s = self._samples[-1][1]
        return (before_s - time_s) / (contact_s - before_s) if contact_s > time_s else 0.0

    def remaining(self, time_s: float) -> tuple[float, float] | None:
        """Return the time to contact and its error.

        Both are in seconds, above 0. None unless it is determined: enough frames over a long
        enough time, enough growth, and a standard error of the mean below `largest_error` of it.
        The error is that of a time from a single growth: the growths of an object err alike, so
        that their mean is hardly better.
        """
        while self._samples and self._samples[0][0] < time_s - self._params.memory_s:
            self._samples.popleft()
        if len(self._samples) < self._params.least_frames:
            return None
        times, contacts, errors, passed = np.array(self._samples).T
        span = times[-1] - times[0]
        if span < self._params.least_s:
            return None
        contact, error, away = _mean(contacts, errors)
        kept = np.abs(away) <= _TOO_FAR * math.sqrt(float(away @ away) / len(away))
        if self._params.least_frames <= kept.sum() < len(kept):
            times, contacts, errors = times[kept], contacts[kept], errors[kept]
            contact, error, _ = _mean(contacts, errors)
        left = contact - time_s
        grown = (contact - times[0]) / left if left > 0 else 0.0
        # Growths over times that overlap tell less than as many that do not.
        error *= math.sqrt(max(1.0, passed.mean() * (len(passed) - 1) / span))
        sure = grown >= self._params.least_growth and error < self._params.largest_error * left
        return (left, float(np.mean(errors**-2)) ** -0.5) if sure else None


def _mean(values: Floats, errors: Floats) -> tuple[float, float, Floats]:
    """Return the weighted mean, its standard error by the scatter, and how far each is off it."""
    weights = errors**-2
    mean = float(weights @ values / weights.sum())
    away = (values - mean) / errors
    variance = float(away @ away) / (len(values) - 1) / float(weights.sum())
    return mean, math.sqrt(variance), away
