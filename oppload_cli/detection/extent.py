"""How far an object reaches around a focus of expansion (``docs/places.md``)."""

from __future__ import annotations

import math
from functools import cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from oppload_cli.models.detector import UnitMaps
    from oppload_cli.models.dpc import Map

    Floats = NDArray[np.float64]


_WINDOW = 2.0  # sizes: how far around an object its own motion is looked for
_LEAST_WINDOW = 3  # cells: less holds no more than one blurred point
_ROUNDS = 4  # windows that follow the size; it settles in two or three


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

    @property
    def size(self) -> float:
        """Geometric mean of the half sizes."""
        return math.sqrt(self.x * self.y)


class Products:
    """The opponent products about any one unit of the latest frame, over all of the frame.

    ``O(u) = S_phi(c + u) S_(phi+180)(c - u)``, summed over both axis pairs, as in
    ``docs/model.md``, section 5, but not cut off by the receptive field.

    Parameters
    ----------
    maps : UnitMaps
        With pooled pathways.
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
        for _ in range(_ROUNDS):
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
        """Return the unit among one and its eight neighbours about which most moves outward.

        Parameters
        ----------
        row, column : int
            The unit.
        extent : Extent
            Of the object; its window serves all nine.

        Returns
        -------
        tuple of int
            Row and column.
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
        """Return the half size of an ellipse, at least half of the blur."""
        return math.sqrt(max(2 * square - self._maps.spread**2, (self._maps.spread / 2) ** 2))


@cache
def _signs(rows: int, columns: int, phi: int) -> Map:
    """Return 1 at the offsets u with u . u_phi > 0, -1 where it is below 0."""
    across, up = math.cos(math.radians(phi)), math.sin(math.radians(phi))
    y, x = np.mgrid[-rows : rows + 1, -columns : columns + 1]
    return np.asarray(np.sign(np.round(x * across - y * up, 6)), np.float32)


def _spacing(centres: Floats) -> float:
    return float(centres[1] - centres[0]) if len(centres) > 1 else 1.0
