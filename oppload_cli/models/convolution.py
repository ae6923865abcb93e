"""True 2-D convolutions of the photoreceptor maps with the DPC kernels.

One forward transform of a map serves every kernel. The kernels are even (W_I1, W_I2)
or odd (their directional parts), so that their spectra are real or imaginary, and a
product of spectra is a plain multiplication, entry by entry, of the map's spectrum,
or of i times it, which is kept beside it. Large frames are cut into tiles, so that
what is worked on stays in the cache, and several cores can share a frame.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import cv2
import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from oppload_cli.models.kernels import Inhibition, Kernel, Map

MEMORY = 3  # P(t), P(t-1) and P(t-2)
EVEN, ODD = 0, 1
LARGEST_TILE = (256, 450)  # rows and columns, with its padding


class _Factors(NamedTuple):
    """What the spectra of P(t-1) and P(t-2) are multiplied by, and their kernels' parity."""

    one: Map
    two: Map
    parity: int


class Convolution:
    """Convolutions, zero outside the frame, of the maps of one and two frames ago.

    Parameters
    ----------
    shape : tuple of int
        Height and width of the maps.
    radius : int
        Kernel radius in pixels.
    kernels : sequence of (Inhibition, int)
        Pairs of kernels for P(t-1) and P(t-2), each with their parity: EVEN if
        ``W(-d) = W(d)``, ODD if ``W(-d) = -W(d)``.

    Attributes
    ----------
    values : ndarray of float32, shape (height, width)
        P(t): where the caller writes it before `advance`.
    results : list of ndarray of float32, shape (height, width)
        ``W_1 * P(t-1) + W_2 * P(t-2)``, for each pair of kernels.
    parts : list of callable
        The work on one frame, after `advance`: they may run in any order, or at once.
    """

    def __init__(
        self, shape: tuple[int, int], radius: int, kernels: Sequence[tuple[Inhibition, int]]
    ) -> None:
        rows, columns = (
            _evenly(side, most - 2 * radius) for side, most in zip(shape, LARGEST_TILE, strict=True)
        )
        padded = _padded_shape((rows[0].stop + 2 * radius, columns[0].stop + 2 * radius))
        factors = [
            _Factors(_factor(pair.one, padded), _factor(pair.two, padded), parity)
            for pair, parity in kernels
        ]
        places = [(down, across) for down in rows for across in columns]
        tiles = [_Tile(shape, place, radius, factors, padded) for place in places]
        self._tiles = tiles
        # A frame of one tile is handed over and out as a part of its buffers, uncopied.
        if len(tiles) == 1:
            self.values, self.results = tiles[0].source, tiles[0].results
        else:
            self.values = np.zeros(shape, np.float32)
            self.results = [np.zeros(shape, np.float32) for _ in kernels]
        self.parts = [partial(self._convolve, tile) for tile in tiles]
        self._latest = 0

    def reset(self) -> None:
        """Forget all maps."""
        for tile in self._tiles:
            tile.spectra[:] = 0

    def advance(self) -> None:
        """Count the maps on: the one in `values` is the latest now."""
        self._latest = (self._latest + 1) % MEMORY

    def _convolve(self, tile: _Tile) -> None:
        copied = len(self._tiles) > 1
        if copied:
            np.copyto(tile.source, self.values[tile.reach])
        tile.convolve(self._latest)
        if copied:
            for mine, whole in zip(tile.results, self.results, strict=True):
                np.copyto(whole[tile.place], mine)


class _Tile:
    """A part of the frame: it is transformed with the kernels' reach around it.

    What its circular convolutions carry over its edges stays within that reach.
    """

    def __init__(
        self,
        shape: tuple[int, int],
        place: tuple[slice, slice],
        radius: int,
        factors: Sequence[_Factors],
        padded: tuple[int, int],
    ) -> None:
        self.place = place
        self.reach = tuple(
            slice(max(0, side.start - radius), min(length, side.stop + radius))
            for side, length in zip(place, shape, strict=True)
        )
        # Where pixel 0 of the tile stands in the buffers: at `radius`.
        inside, around = (
            tuple(
                slice(part.start - side.start + radius, part.stop - side.start + radius)
                for part, side in zip(parts, place, strict=True)
            )
            for parts in (place, self.reach)
        )
        # In one piece: the system backs it with large pages then.
        buffers = np.zeros((1 + 2 * MEMORY + len(factors), *padded), np.float32)
        self._padded, *self._products = buffers[0], *buffers[1 + 2 * MEMORY :]
        self.source: Map = self._padded[around]
        # By age modulo MEMORY, and by parity: the spectrum, and i times it.
        self.spectra = buffers[1 : 1 + 2 * MEMORY].reshape(MEMORY, 2, *padded)
        self._factors = factors
        self.results: list[Map] = [each[inside] for each in self._products]
        self._rows_in, self._rows_out = around[0].stop, inside[0].stop

    def convolve(self, latest: int) -> None:
        """Transform the latest map, and convolve those before it."""
        even, odd = self.spectra[latest]
        cv2.dft(self._padded, dst=even, nonzeroRows=self._rows_in)
        _times_i(even, odd)
        one, two = (self.spectra[(latest - age) % MEMORY] for age in (1, 2))
        inverse = cv2.DFT_INVERSE | cv2.DFT_REAL_OUTPUT
        for factors, products in zip(self._factors, self._products, strict=True):
            cv2.multiply(one[factors.parity], factors.one, dst=products)
            cv2.accumulateProduct(two[factors.parity], factors.two, products)
            cv2.dft(products, dst=products, flags=inverse, nonzeroRows=self._rows_out)


def _evenly(length: int, most: int) -> list[slice]:
    """Cut a side into the fewest parts of at most so many pixels, all but the last alike."""
    step = -(-length // -(-length // max(1, most)))
    return [slice(start, min(length, start + step)) for start in range(0, length, step)]


def _padded_shape(shape: tuple[int, int]) -> tuple[int, int]:
    """Return sizes of at least these that transform fast."""
    # Columns are transformed fastest at multiples of 16, rows at any even product of 2, 3 and 5.
    height, width = (
        step * cv2.getOptimalDFTSize(-(-side // step))
        for side, step in zip(shape, (16, 2), strict=True)
    )
    return height, width


def _factor(kernel: Kernel, shape: tuple[int, int]) -> Map:
    """Return the spectrum of a kernel, less its i if it is odd, packed as factors."""
    padded = np.zeros(shape)
    padded[: kernel.shape[0], : kernel.shape[1]] = kernel
    centre = kernel.shape[0] // 2
    spectrum = np.fft.fft2(np.roll(padded, (-centre, -centre), axis=(0, 1))) / padded.size
    # One of the two parts is 0 all over.
    real = spectrum.real + spectrum.imag
    return _packed(real + 1j * real)


def _packed(spectrum: NDArray[np.complex128]) -> Map:
    """Pack a spectrum as OpenCV packs that of a real image (CCS).

    Columns 2k - 1 and 2k hold the real and imaginary parts of frequency k; the first
    column, and the last of an even width, hold theirs in turn down the rows.
    """
    rows, columns = spectrum.shape
    across, down = (np.arange(columns) + 1) // 2, (np.arange(rows) + 1) // 2
    out = np.where(np.arange(columns) % 2, spectrum[:, across].real, spectrum[:, across].imag)
    for column in (0, columns - 1):
        line = spectrum[down, across[column]]
        out[:, column] = np.where(np.arange(rows) % 2, line.real, line.imag)
        out[0, column] = line[0].real
        out[-1, column] = line[-1].real
    return np.ascontiguousarray(out, np.float32)


def _times_i(spectrum: Map, out: Map) -> None:
    """Multiply a packed spectrum by i; its four real entries have no place, and become 0."""
    pairs = (values[:, 1:-1].view(np.complex64) for values in (spectrum, out))
    np.multiply(next(pairs), np.complex64(1j), out=next(pairs))
    first_and_last = slice(None, None, spectrum.shape[1] - 1)
    out[1:-1:2, first_and_last] = -spectrum[2::2, first_and_last]
    out[2::2, first_and_last] = spectrum[1:-1:2, first_and_last]
