"""Pooling of the S maps over cells (``docs/model.md``, section 5, step 1)."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from oppload_cli.models.layers import Map

    Floats = NDArray[np.float64]

REACH_SIGMAS = 5  # what lies beyond weighs less than a millionth


def cell_centres(length: int, cell: int) -> Floats:
    """Return where the cells' centres lie along one side of the frame.

    Parameters
    ----------
    length : int
        Side of the frame in pixels.
    cell : int
        Spacing of the cells in pixels.

    Returns
    -------
    ndarray, shape (n,)
        As many whole cells as fit (one at the least), centred in the frame;
        pixel i covers [i, i + 1).
    """
    count = max(1, length // cell)
    return np.asarray((length - count * cell) / 2 + (np.arange(count) + 0.5) * cell, np.float64)


class Pooling:
    """Gaussian smoothing of a map, sampled once per cell.

    Each sample is a plain weighted sum in a fixed order: a matrix product of a
    threaded library would be a little faster, and differ in its last digits with
    the number of threads.

    Parameters
    ----------
    shape : tuple of int
        Height and width of the maps.
    cell : int
        Spacing of the cells in pixels.
    sigma : float
        Spread of the Gaussian in pixels; 0 takes the pixel at a cell's centre.
    """

    def __init__(self, shape: tuple[int, int], cell: int, sigma: float) -> None:
        self.centres_y, self.centres_x = (cell_centres(length, cell) for length in shape)
        self.shape = len(self.centres_y), len(self.centres_x)
        self._reach = reach = math.ceil(REACH_SIGMAS * sigma)
        self._down, self._across = (
            _weights(float(centres[0]), reach, sigma)
            for centres in (self.centres_y, self.centres_x)
        )
        # Zeros around the map: beyond the frame there is nothing to pool.
        self._padded = np.zeros((shape[0] + 2 * reach, shape[1]), np.float32)
        self._half = np.zeros((self.shape[0], shape[1] + 2 * reach), np.float32)
        self._windows_down = _windows(self._padded, self.centres_y, 2 * reach + 1, cell, axis=0)
        self._windows_across = _windows(self._half, self.centres_x, 2 * reach + 1, cell, axis=1)

    def __call__(self, values: Map, out: Map) -> None:
        """Pool a map.

        Parameters
        ----------
        values : ndarray of float32, shape (height, width)
            The map.
        out : ndarray of float32, shape (rows, columns)
            Takes one value per cell. The weights of a cell have sum 1 on an
            endless map.
        """
        height, width = values.shape
        self._padded[self._reach : self._reach + height] = values
        half = self._half[:, self._reach : self._reach + width]
        np.einsum("rck,k->rc", self._windows_down, self._down, out=half)
        np.einsum("rck,k->rc", self._windows_across, self._across, out=out)


def _weights(centre: float, reach: int, sigma: float) -> Map:
    """Weigh the pixels around a centre; every cell of a side has the same weights."""
    if sigma == 0:
        return np.ones(1, np.float32)
    offsets = np.arange(-reach, reach + 1)
    total = np.exp(-(offsets**2) / (2 * sigma**2)).sum()
    distance = math.floor(centre) + offsets + 0.5 - centre
    return np.asarray(np.exp(-(distance**2) / (2 * sigma**2)) / total, np.float32)


def _windows(padded: Map, centres: Floats, taps: int, cell: int, axis: int) -> Map:
    """View the pixels around each cell's centre, as (rows, columns, taps)."""
    first = math.floor(centres[0])
    windows = sliding_window_view(padded, taps, axis=axis)
    chosen = slice(first, first + (len(centres) - 1) * cell + 1, cell)
    view: Map = windows[chosen] if axis == 0 else windows[:, chosen]
    return view
