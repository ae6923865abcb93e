"""Pooling of the S maps over cells (``docs/model.md``, section 5, step 1)."""

from __future__ import annotations

import ctypes
import math
from typing import TYPE_CHECKING, Protocol

import cv2
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from oppload_cli.native.library import LANES, MapOf, address, compiled, library, rows_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from oppload_cli.models.kernels import Map
    from oppload_cli.models.presynaptic import Live

    Floats = NDArray[np.float64]

REACH_SIGMAS = 5  # what lies beyond weighs less than a millionth
MOST_JOBS = 64  # that are kept prepared
AT_ONCE = 4  # vectors: that of models.c
LEAST_SIGMA = 3  # samples per sigma of a halved map


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
    binomial weights 1 4 6 4 1. Their variance is 1 and their fourth cumulant -1/2 (in
    samples): the Gaussian is given so much less of the one, and so much more of the
    other. At three samples per sigma what is left is below 3e-6 of the map's largest
    value on most maps, and 3e-5 on the worst: stripes of a period of four pixels.

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
        margin = 3 * spacing if spacing > 1 else 0
        down, across = (
            _Line(centres, cell, spacing, margin, sigma)
            for centres in (self.centres_y, self.centres_x)
        )
        halvings = spacing.bit_length() - 1
        kind = _CompiledSums if library() else _PortableSums
        self._sums: _Sums = kind(shape, margin, halvings, down, across)

    def __call__(self, values: Map, out: Map, live: Live | None = None) -> None:
        """Pool a map.

        Parameters
        ----------
        values : ndarray of float32, shape (height, width)
            The map; its rows may stand apart.
        out : ndarray of float32, shape (rows, columns)
            Takes one value per cell. The weights of a cell have sum 1 on an
            endless map.
        live : ndarray of uint8, optional
            Where it may be other than 0, as :attr:`oppload_cli.models.layers.Dpc.live`.
        """
        self._sums(values, out, live)


class _Sums(Protocol):
    """Halves maps, and weighs what is left down and across."""

    def __call__(self, values: Map, out: Map, live: Live | None) -> None: ...


class _PortableSums:
    """The sums by OpenCV and NumPy."""

    def __init__(
        self, shape: tuple[int, int], margin: int, halvings: int, down: _Line, across: _Line
    ) -> None:
        # Zeros around the map: beyond the frame there is nothing to pool.
        self._whole = np.zeros((shape[0] + 2 * margin, shape[1] + 2 * margin), np.float32)
        self._inside = self._whole[margin : margin + shape[0], margin : margin + shape[1]]
        self._halved = _halves(*self._whole.shape, halvings)
        height, width = (self._halved or [self._whole])[-1].shape
        padded = np.zeros((height + 2 * down.reach, width), np.float32)
        half = np.zeros((down.count, width + 2 * across.reach), np.float32)
        self._coarsest = padded[down.reach : down.reach + height]
        self._halved[-1:] = [self._coarsest][: len(self._halved)]
        self._half = half[:, across.reach : across.reach + width]
        self._down, self._across = down.weights, across.weights
        self._windows_down = down.windows(padded, axis=0)
        self._windows_across = across.windows(half, axis=1)

    def __call__(self, values: Map, out: Map, live: Live | None) -> None:
        del live  # OpenCV goes over everything
        np.copyto(self._inside, values)
        finer = self._whole
        for coarser in self._halved:
            cv2.pyrDown(finer, dst=coarser)
            finer = coarser
        if not self._halved:
            np.copyto(self._coarsest, finer)
        np.einsum("rck,k->rc", self._windows_down, self._down, out=self._half)
        np.einsum("rck,k->rc", self._windows_across, self._across, out=out)


class _LineJob(ctypes.Structure):
    """``struct line`` of models.c."""

    _fields_ = (
        ("weights", ctypes.c_void_p),
        ("reach", ctypes.c_int),
        ("first", ctypes.c_int),
        ("step", ctypes.c_int),
        ("count", ctypes.c_int),
    )


class _Job(ctypes.Structure):
    """``struct pooling`` of models.c."""

    _fields_ = (
        ("maps", ctypes.POINTER(MapOf)),
        ("halvings", ctypes.c_int),
        ("margin", ctypes.c_int),
        ("lines", ctypes.c_void_p),
        ("line_stride", ctypes.c_ssize_t),
        ("down", _LineJob),
        ("across", _LineJob),
        ("row", ctypes.c_void_p),
        ("out", ctypes.c_void_p),
        ("out_stride", ctypes.c_ssize_t),
    )


class _CompiledSums:
    """The sums by compiled loops."""

    def __init__(
        self, shape: tuple[int, int], margin: int, halvings: int, down: _Line, across: _Line
    ) -> None:
        self._pool = compiled().pool
        self._margin = margin
        self._halved = _halves(shape[0] + 2 * margin, shape[1] + 2 * margin, halvings)
        # One for each halving: what is zero between the rows of one is not in another.
        self._scratch = np.zeros((halvings, 5 * (shape[1] + 2 * margin + 16)), np.float32)
        coarsest = self._halved[-1].shape if halvings else shape
        samples = coarsest[1] + 2 * across.reach + across.step * (AT_ONCE * LANES + 1)
        self._row = np.zeros(2 * samples, np.float32)
        self._lines = down, across
        self._jobs: dict[tuple[int, ...], tuple[_Job, int, tuple[object, ...]]] = {}

    def __call__(self, values: Map, out: Map, live: Live | None) -> None:
        key = id(values), id(out), id(live)
        if key not in self._jobs:
            if len(self._jobs) == MOST_JOBS:
                self._jobs.clear()
            job = self._job(values, out, live)
            # The arrays are kept, so that no others can come to have the same identities.
            self._jobs[key] = job, ctypes.addressof(job), (values, out, live)
        self._pool(self._jobs[key][1])

    def _job(self, values: Map, out: Map, live: Live | None) -> _Job:
        """Prepare to pool a map: finding out where arrays stand costs as much."""
        halves = (MapOf.of(each, None) for each in self._halved)
        lines = (
            _LineJob(address(each.weights), each.reach, each.first, each.step, each.count)
            for each in self._lines
        )
        out_address, out_stride = rows_of(out)
        return _Job(
            (MapOf * (1 + len(self._halved)))(MapOf.of(values, live), *halves),
            *(len(self._halved), self._margin, address(self._scratch), self._scratch.shape[1]),
            *(*lines, address(self._row), out_address, out_stride),
        )


def _halves(height: int, width: int, count: int) -> list[Map]:
    """Return maps for the results of so many halvings."""
    halves = []
    for _ in range(count):
        height, width = (height + 1) // 2, (width + 1) // 2
        halves.append(np.zeros((height, width), np.float32))
    return halves


class _Line:
    """The weights along one side: every cell has the same, a whole number of samples on."""

    def __init__(self, centres: Floats, cell: int, spacing: int, margin: int, sigma: float) -> None:
        # Less what the halvings have, at samples of 1, 2, 4, ... pixels.
        rest = math.sqrt(sigma**2 - (spacing**2 - 1) / 3)
        fourth = -(spacing**4 - 1) / 30
        self.reach = math.ceil(REACH_SIGMAS * rest / spacing)
        # Sample i lies in the middle of pixel i * spacing - margin.
        first = (centres[0] - 0.5 + margin) / spacing
        self.first = math.floor(first + 0.5) if spacing > 1 else math.floor(centres[0])
        self.step, self.count = cell // spacing, len(centres)
        self.weights = np.ones(1, np.float32)
        if sigma > 0:
            offsets = np.arange(-self.reach, self.reach + 1)
            distance = (self.first + offsets - first) * spacing / rest
            total = np.exp(-((offsets * spacing / rest) ** 2) / 2).sum()
            # The first term of the Edgeworth series takes the fourth cumulant away.
            series = 1 - fourth / (24 * rest**4) * (distance**4 - 6 * distance**2 + 3)
            self.weights = np.asarray(np.exp(-(distance**2) / 2) * series / total, np.float32)

    def windows(self, padded: Map, axis: int) -> Map:
        """View the samples around each cell's centre, as (rows, columns, taps)."""
        windows = sliding_window_view(padded, len(self.weights), axis=axis)
        chosen = slice(self.first, self.first + (self.count - 1) * self.step + 1, self.step)
        view: Map = windows[chosen] if axis == 0 else windows[:, chosen]
        return view


def _spacing(cell: int, sigma: float) -> int:
    """Return how far apart the samples may be that the Gaussian weighs: 1, 2, 4, ... pixels."""
    spacing = 1
    while cell % (2 * spacing) == 0 and sigma >= LEAST_SIGMA * 2 * spacing:
        spacing *= 2
    return spacing
