"""Motion vectors as they are given, and those of them that are opposite to each other."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from oppload_cli.errors import ParameterError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import ArrayLike, NDArray

# Pairs handled at once: bounds the memory, and keeps the temporary arrays in the cache.
_BLOCK = 4096


class Moving:
    """The vectors that are not zero, sorted by direction.

    So the opposites of a vector stand in one run, and no other pair is ever formed.

    Parameters
    ----------
    starts, vectors : array_like, shape (n, 2)
        Where each motion vector starts, and the vector (x, y).

    Raises
    ------
    ParameterError
        As by :func:`matching`.
    """

    def __init__(self, starts: ArrayLike, vectors: ArrayLike) -> None:
        motion, origin = matching(starts, vectors)
        speeds = length(motion)
        rows = np.flatnonzero(speeds)
        angles = np.arctan2(motion[rows, 1], motion[rows, 0])
        order = np.argsort(angles, kind="stable")
        self.rows = rows[order]
        self.angles = angles[order]
        self.speeds = speeds[self.rows]
        # As complex numbers x + iy: one gather per pair for both.
        self.units = _plane(motion[self.rows]) / self.speeds
        self.starts = _plane(origin[self.rows])

    def opposite(self, tolerance: float) -> Iterator[tuple[NDArray[np.intp], NDArray[np.intp]]]:
        """Yield the opposite pairs in blocks.

        Parameters
        ----------
        tolerance : float
            Degrees by which a pair may miss being opposite.

        Yields
        ------
        first, second : ndarray of int, shape (pairs,)
            Positions in the sorted arrays.
        """
        wide = math.radians(tolerance)
        if self.angles.size < 2 or self.angles[-1] - self.angles[0] <= math.pi - wide:
            return
        low = np.searchsorted(self.angles, self.angles + (math.pi - wide), side="right")
        high = np.searchsorted(self.angles, self.angles + (math.pi + wide), side="left")
        counts = np.maximum(high - low, 0)
        block = np.cumsum(counts) // _BLOCK
        for some in np.split(np.arange(counts.size), np.flatnonzero(np.diff(block)) + 1):
            run = counts[some]
            first = np.repeat(some, run)
            offset = low[some] - (np.cumsum(run) - run)
            second = np.arange(first.size) + np.repeat(offset, run)
            if first.size:
                yield first, second

    def radial(
        self, first: NDArray[np.intp], second: NDArray[np.intp], tolerance: float
    ) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Return which of some pairs are outward, and which inward.

        Parameters
        ----------
        first, second : ndarray of int, shape (pairs,)
            Positions in the sorted arrays.
        tolerance : float
            Degrees between the line of the starts and that of the vectors, at most.

        Returns
        -------
        outward, inward : ndarray of bool, shape (pairs,)
        """
        # In place: for thousands of pairs, fresh arrays cost more than the arithmetic.
        line, apart = self.units[first], self.starts[first]
        line -= self.units[second]
        apart -= self.starts[second]
        along = line.real * apart.real
        along += line.imag * apart.imag
        across = line.real * apart.imag
        across -= line.imag * apart.real
        # Compares the angle between the two with the tolerance, without computing it.
        along *= math.tan(math.radians(tolerance))
        np.abs(across, out=across)
        outward = along > across
        np.negative(along, out=along)
        return outward, along > across

    def named(
        self, first: NDArray[np.intp], second: NDArray[np.intp]
    ) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Turn positions into the caller's row numbers.

        Parameters
        ----------
        first, second : ndarray of int, shape (pairs,)
            Positions in the sorted arrays.

        Returns
        -------
        smaller, larger : ndarray of int, shape (pairs,)
            Row numbers, in ascending order.
        """
        pairs = np.sort([self.rows[first], self.rows[second]], axis=0)
        smaller, larger = pairs[:, np.lexsort(pairs[::-1])]
        return smaller, larger


def matching(
    starts: ArrayLike, vectors: ArrayLike
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return vectors and their starts, checked.

    Parameters
    ----------
    starts, vectors : array_like, shape (n, 2)
        Where each motion vector starts, and the vector (x, y).

    Returns
    -------
    vectors, starts : ndarray of float64, shape (n, 2)

    Raises
    ------
    ParameterError
        If they are not of one shape (n, 2), or hold a number that is not finite.
    """
    motion, origin = points("vectors", vectors), points("starts", starts)
    if motion.ndim != 2 or origin.shape != motion.shape:
        raise ParameterError(
            f"starts and vectors are of shapes {origin.shape} and {motion.shape}; "
            "give two arrays of one shape (n, 2)"
        )
    return motion, origin


def points(name: str, values: ArrayLike) -> NDArray[np.float64]:
    """Return points of the plane, checked.

    Parameters
    ----------
    name : str
        For errors.
    values : array_like, shape (..., 2)
        The points (x, y).

    Returns
    -------
    ndarray of float64, shape (..., 2)

    Raises
    ------
    ParameterError
        If the last axis is not of 2, or a number is not finite.
    """
    array = np.asarray(values, dtype=np.float64)
    if array.ndim == 0 or array.shape[-1] != 2:
        raise ParameterError(f"{name} is of shape {array.shape}; its last axis must be (x, y)")
    if not np.isfinite(array).all():
        raise ParameterError(f"{name} holds numbers that are not finite; leave those rows out")
    return array


def length(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return how long vectors are.

    Parameters
    ----------
    points : ndarray of float64, shape (..., 2)
        The vectors (x, y).

    Returns
    -------
    ndarray of float64, shape (...)
        At least 0.
    """
    lengths: NDArray[np.float64] = np.hypot(points[..., 0], points[..., 1])
    return lengths


def _plane(points: NDArray[np.float64]) -> NDArray[np.complex128]:
    return points[:, 0] + 1j * points[:, 1]
