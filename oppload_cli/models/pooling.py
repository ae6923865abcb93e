"""Pooling of the S maps over cells (``docs/model.md``, section 5, step 1)."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import TYPE_CHECKING

import cv2
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from oppload_cli.models.kernels import Map

    Floats = NDArray[np.float64]

REACH_SIGMAS = 5  # what lies beyond weighs less than a millionth
LEAST_SIGMA = 6  # samples per sigma of a halved map


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

    Where the Gaussian is wide against a pixel, the map is halved first with the
    binomial weights 1 4 6 4 1, which add 1 to the variance (in samples squared): the
    Gaussian is given so much less. Such weights follow a smooth curve up to its
    third derivative, so that at six samples per sigma what is left is below 1e-5.

    Each sample is a plain weighted sum in a fixed order: a matrix product of a
    threaded library would differ in its last digits with the number of threads.

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
        spacing = _spacing(cell, sigma)
        rest = math.sqrt(max(0.0, sigma**2 - (spacing**2 - 1) / 3))
        margin = 2 * spacing if spacing > 1 else 0
        whole = np.zeros([length + 2 * margin for length in shape], np.float32)
        self._inside = whole[margin : margin + shape[0], margin : margin + shape[1]]
        self._levels = [whole]
        for _ in range(spacing.bit_length() - 1):
            self._levels.append(cv2.pyrDown(self._levels[-1]).astype(np.float32))
        height, width = self._levels[-1].shape
        down, across = (
            _Line(centres, cell, spacing, margin, rest)
            for centres in (self.centres_y, self.centres_x)
        )
        # Zeros around the map: beyond the frame there is nothing to pool.
        padded = np.zeros((height + 2 * down.reach, width), np.float32)
        half = np.zeros((self.shape[0], width + 2 * across.reach), np.float32)
        self._padded = padded[down.reach : down.reach + height]
        self._half = half[:, across.reach : across.reach + width]
        self._down, self._across = down.weights, across.weights
        self._windows_down = down.windows(padded, axis=0)
        self._windows_across = across.windows(half, axis=1)

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
        np.copyto(self._inside, values)
        for finer, coarser in pairwise(self._levels):
            cv2.pyrDown(finer, dst=coarser)
        np.copyto(self._padded, self._levels[-1])
        np.einsum("rck,k->rc", self._windows_down, self._down, out=self._half)
        np.einsum("rck,k->rc", self._windows_across, self._across, out=out)


class _Line:
    """The weights along one side: every cell has the same, a whole number of samples on."""

    def __init__(self, centres: Floats, cell: int, spacing: int, margin: int, sigma: float) -> None:
        self.reach = math.ceil(REACH_SIGMAS * sigma / spacing)
        # Sample i lies in the middle of pixel i * spacing - margin.
        first = (centres[0] - 0.5 + margin) / spacing
        self._first = math.floor(first + 0.5) if spacing > 1 else math.floor(centres[0])
        self._step, self._count = cell // spacing, len(centres)
        self.weights = np.ones(1, np.float32)
        if sigma > 0:
            offsets = np.arange(-self.reach, self.reach + 1)
            distance = (self._first + offsets - first) * spacing
            total = np.exp(-((offsets * spacing) ** 2) / (2 * sigma**2)).sum()
            weights = np.exp(-(distance**2) / (2 * sigma**2)) / total
            self.weights = np.asarray(weights, np.float32)

    def windows(self, padded: Map, axis: int) -> Map:
        """View the samples around each cell's centre, as (rows, columns, taps)."""
        windows = sliding_window_view(padded, len(self.weights), axis=axis)
        chosen = slice(self._first, self._first + (self._count - 1) * self._step + 1, self._step)
        view: Map = windows[chosen] if axis == 0 else windows[:, chosen]
        return view


def _spacing(cell: int, sigma: float) -> int:
    """Return how far apart the samples may be that the Gaussian weighs: 1, 2, 4, ... pixels."""
    spacing = 1
    while cell % (2 * spacing) == 0 and sigma >= LEAST_SIGMA * 2 * spacing:
        spacing *= 2
    return spacing
