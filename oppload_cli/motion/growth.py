"""Radial growth: how fast the flow says that something about a place becomes larger.

It is the second witness of OppLoD's alarm (``docs/footage.md``). An object on course to hit grows
about a centre that lies inside it, in all directions alike, and keeps growing.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import cv2
import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from oppload_cli.motion.flow import Flow

    Map = NDArray[np.float32]
    Complex = NDArray[np.complexfloating]
    Edges = tuple[float, float, float, float]

# Variance of the error of the flow in px^2 (0.045 px): where less moves, growth explains nothing.
_FLOW_VARIANCE = 0.002
# The search moves patches of 8 samples every 4 samples, so that neighbouring vectors err alike: one
# vector in 16 is independent.
_ALIKE = 16
# Half the side of the square in which the growth of an object is measured, as a share of the
# shorter side of the frame: 16 px of 240.
_HALF_SHARE = 1 / 15
_FEWEST = 9  # samples of the flow in this square
_NOISE_PX = 0.3  # difference of the flow that noise alone causes within an object
_NEIGHBOURS = np.ones((3, 3), np.uint8)


class WindowFit(NamedTuple):
    """Least squares of a growth to the flow in a window about every place; arrays over places.

    Attributes
    ----------
    across, down : ndarray of float32
        Growth of the width, ``g_x = cov(x, u) / var(x)``, and of the height, between two pictures.
    x, y : ndarray of float32
        Mean motion in the window in px: of its middle, if it grows evenly.
    explained : ndarray of float32
        Share of the variance of the flow that an even growth explains, 0 to 1. Motion that
        differs within the window otherwise, as that of limbs, noise or shear, lowers it.
    """

    across: Map
    down: Map
    x: Map
    y: Map
    explained: Map


class Windows:
    """Square windows about every place of a grid over the frame.

    Parameters
    ----------
    shape : tuple of int
        Height and width of the working frame in px.
    grid : tuple of int
        Number of places down and across, which are spread evenly.
    side : float
        Side of a window in px. It becomes an odd number of places, at least 3; what lies outside
        the frame is left out.
    """

    def __init__(self, shape: tuple[int, int], grid: tuple[int, int], side: float) -> None:
        rows, columns = grid
        self.step = shape[0] / rows  # px from place to place; across it is the same within 2 %
        self._size = columns, rows
        count = max(3, 2 * round((side / self.step - 1) / 2) + 1)
        self._window = count, count
        y, x = np.mgrid[:rows, :columns].astype(np.float32)
        self.places = x, y  # in places
        # Sums of squares stay small if x and y are measured from the middle of the frame.
        self._x = (x - np.float32((columns - 1) / 2)) * np.float32(shape[1] / columns)
        self._y = (y - np.float32((rows - 1) / 2)) * np.float32(self.step)
        self._share = 1 / self._sum(np.ones_like(x))
        self._mean_x, self._mean_y = self._mean(self._x), self._mean(self._y)
        # A grid of one row or column shows no growth: the covariance, 0, is divided by 1.
        self._variance_x = self._mean(self._x**2) - self._mean_x**2 + np.float32(columns == 1)
        self._variance_y = self._mean(self._y**2) - self._mean_y**2 + np.float32(rows == 1)

    def _sum(self, values: Map) -> Map:
        sums = cv2.boxFilter(
            values, cv2.CV_32F, self._window, normalize=False, borderType=cv2.BORDER_CONSTANT
        )
        return np.asarray(sums, np.float32)

    def _mean(self, values: Map) -> Map:
        return np.asarray(self._sum(values) * self._share, np.float32)

    def fit(self, vectors: Map) -> WindowFit:
        """Fit a growth to the flow in each window; `vectors` as in :class:`Flow`."""
        means = cv2.resize(vectors, self._size, interpolation=cv2.INTER_AREA)
        u, v = (np.asarray(component, np.float32) for component in cv2.split(means))
        mean_u, mean_v = self._mean(u), self._mean(v)
        along_x = self._mean(u * self._x) - mean_u * self._mean_x
        along_y = self._mean(v * self._y) - mean_v * self._mean_y
        variance = self._mean(u * u + v * v) - mean_u**2 - mean_v**2
        across, down = along_x / self._variance_x, along_y / self._variance_y
        even = (across + down) / 2
        by_growth = even**2 * (self._variance_x + self._variance_y)
        explained = np.minimum(by_growth / (variance + np.float32(_FLOW_VARIANCE)), 1)
        # In a window that the frame cuts off, the mean place is not the middle.
        middle_x = mean_u + even * (self._x - self._mean_x)
        middle_y = mean_v + even * (self._y - self._mean_y)
        return WindowFit(across, down, middle_x, middle_y, explained)


class RadialGrowth:
    """The growth about every place, followed over time along its motion.

    The rate at a place is ``q = min(g_x, g_y) e^2 w / dt``: the growth of the side that grows less,
    times the square of the explained share e, times the weight w of a collision course. The focus
    of expansion, the point that does not move, is ``m / g`` from the place, m being its motion:
    ``w = exp(-(m / (g side))^2)`` is small if the object moves on as a whole. The growth follows
    the place: ``A(c, t) = d A(c - m, t - dt) + (1 - d) q(c, t)`` with ``d = exp(-dt / memory)``.

    Parameters
    ----------
    shape, grid, side
        As for :class:`Windows`.
    memory_s : float
        Time constant of following in seconds; 0: the latest rate counts alone.

    Attributes
    ----------
    growth : ndarray of float32, shape (rows, columns)
        A at the latest frame, in 1/s, at least 0; zeros before the first flow.
    """

    def __init__(
        self, shape: tuple[int, int], grid: tuple[int, int], side: float, memory_s: float
    ) -> None:
        self._windows, self._side = Windows(shape, grid, side), np.float32(side)
        self._memory_s = memory_s
        self.growth: Map = np.zeros(grid, np.float32)

    def step(self, flow: Flow, elapsed_s: float) -> None:
        """Take the flow of the next frame, `elapsed_s` seconds (above 0) after the frame before."""
        fit = self._windows.fit(flow.vectors)
        even = (fit.across + fit.down) / 2
        rate = np.maximum(np.minimum(fit.across, fit.down), 0) * fit.explained**2
        focus = np.hypot(fit.x, fit.y) / (np.maximum(even, 1e-6) * self._side)
        rate *= np.exp(-(focus**2)) / np.float32(flow.passed_s)
        moved = np.float32(elapsed_s / flow.passed_s / self._windows.step)
        x, y = self._windows.places
        before = cv2.remap(
            self.growth, x - moved * fit.x, y - moved * fit.y,
            cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE,
        )  # fmt: skip
        kept = math.exp(-elapsed_s / self._memory_s) if self._memory_s else 0.0
        self.growth = np.asarray(kept * before + (1 - kept) * rate, np.float32)


class LocalMotion(NamedTuple):
    """How the picture moves about a place, between two pictures: shift, growth and turn.

    Attributes
    ----------
    shift : complex
        Motion of the place, as ``x + i y``, in px.
    factor : complex
        k + i w: the growth k, later size divided by earlier size minus 1, and the turn w in
        radians. A point p from the place moves by ``shift + factor p``.
    error : float
        Standard error of the growth.
    """

    shift: complex
    factor: complex
    error: float


def motion_about(flow: Flow, x: float, y: float) -> LocalMotion | None:
    """Measure the motion about a place, in a small square.

    The square lies inside most objects that are near contact: a larger one includes ground, and
    makes the contact seem later (``docs/footage.md``). Least squares fit a shift, a growth and a
    turn to the flow; the error follows from what they leave.

    Parameters
    ----------
    flow : Flow
        The motion since an earlier picture.
    x, y : float
        The place in px of the working frame.

    Returns
    -------
    LocalMotion or None
        None if fewer than 3 x 3 samples of the flow lie in the square.
    """
    places, motion = _complex(flow, x, y)
    half = _half(flow)
    near = (np.abs(places.real) <= half) & (np.abs(places.imag) <= half)
    if np.count_nonzero(near) < _FEWEST:
        return None
    place, vector = places[near].mean(), motion[near].mean()
    centred, moved = places[near] - place, motion[near] - vector
    size = float((np.abs(centred) ** 2).sum())
    factor = complex((np.conj(centred) * moved).sum()) / size
    left_over = float((np.abs(moved - factor * centred) ** 2).mean()) / 2 + _FLOW_VARIANCE
    error = math.sqrt(_ALIKE * left_over / size)
    return LocalMotion(complex(vector - factor * place), factor, error)


def box_about(flow: Flow, x: float, y: float, about: LocalMotion) -> Edges | None:
    """Return the edges of the object at a place: of the part that moves as the place does.

    A sample belongs to the object if its motion differs from the object's by less than half of what
    growth moves it, and by the noise of the flow. The object is the connected part about the place,
    without 4 % of its samples at each edge.

    Parameters
    ----------
    flow, x, y
        As for :func:`motion_about`.
    about : LocalMotion
        The motion about the place.

    Returns
    -------
    tuple of float or None
        Left, top, right and bottom in px of the working frame; None where nothing grows.
    """
    if about.factor.real <= about.error:
        return None
    places, motion = _complex(flow, x, y)
    reach = np.maximum(np.abs(places), _half(flow))
    differs = np.abs(motion - about.shift - about.factor * places)
    moves = differs < abs(about.factor) * reach / 2 + _NOISE_PX
    clean = cv2.morphologyEx(moves.astype(np.uint8), cv2.MORPH_OPEN, _NEIGHBOURS)
    _, labels = cv2.connectedComponents(clean, connectivity=4)
    rows, columns = clean.shape
    row, column = (
        min(max(int(value / flow.side), 0), count - 1) for value, count in ((y, rows), (x, columns))
    )
    if not labels[row, column]:
        return None
    down, across = np.nonzero(labels == labels[row, column])
    (left, right), (top, bottom) = (
        np.quantile(samples, (0.04, 0.96)).tolist() for samples in (across, down)
    )
    side = flow.side
    return left * side, top * side, (right + 1) * side, (bottom + 1) * side


def _complex(flow: Flow, x: float, y: float) -> tuple[Complex, Complex]:
    """Return the middle of each sample, from a place, and its motion, as complex numbers in px."""
    rows, columns = flow.vectors.shape[:2]
    across = (np.arange(columns) + 0.5) * flow.side - x
    down = (np.arange(rows) + 0.5) * flow.side - y
    return across + 1j * down[:, None], flow.vectors[..., 0] + 1j * flow.vectors[..., 1]


def _half(flow: Flow) -> float:
    rows, columns, _ = flow.vectors.shape
    return _HALF_SHARE * float(min(rows, columns) * flow.side)
