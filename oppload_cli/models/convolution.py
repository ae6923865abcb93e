"""True 2-D convolutions of the photoreceptor maps with the DPC kernels.

One forward transform of a map serves every kernel. The kernels are even (W_I1, W_I2)
or odd (their directional parts), so that their spectra are real or imaginary, and a
product of spectra is a plain multiplication, entry by entry, of the map's spectrum,
or of i times it, which is kept beside it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import cv2
import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from oppload_cli.models.kernels import Inhibition, Kernel, Map

MEMORY = 3  # P(t), P(t-1) and P(t-2)
EVEN, ODD = 0, 1


class Filter(NamedTuple):
    """What the spectra of P(t-1) and P(t-2) are multiplied by, and where the result goes."""

    one: Map
    two: Map
    parity: int  # of the kernels
    padded: Map
    result: Map  # the frame's part of it


class Convolution:
    """Convolutions, zero outside the frame, of the maps pushed one and two frames ago.

    They are circular over a frame padded by the kernel radius, which is the linear
    convolution inside the frame. Maps are handed over and out as parts of padded
    buffers, so that nothing is copied.

    Parameters
    ----------
    shape : tuple of int
        Height and width of the maps.
    radius : int
        Kernel radius in pixels.

    Attributes
    ----------
    values : ndarray of float32, shape (height, width)
        P(t): where the caller writes it before `advance` and `transform`.
    """

    def __init__(self, shape: tuple[int, int], radius: int) -> None:
        self._shape = shape
        padded = _padded_shape(shape, radius)
        self._padded = np.zeros(padded, np.float32)
        self.values: Map = self._inside(self._padded)
        # By age modulo MEMORY, and by parity: the spectrum, and i times it.
        self._spectra = np.zeros((MEMORY, 2, *padded), np.float32)
        self._latest = 0

    def reset(self) -> None:
        """Forget all maps."""
        self._spectra[:] = 0

    def advance(self) -> None:
        """Count the maps on: the one in `values` is the latest now."""
        self._latest = (self._latest + 1) % MEMORY

    def transform(self) -> None:
        """Transform the latest map; `apply` needs it from the next one on."""
        even, odd = self._spectra[self._latest]
        cv2.dft(self._padded, dst=even, nonzeroRows=self._shape[0])
        _times_i(even, odd)

    def prepared(self, kernels: Inhibition, parity: int) -> Filter:
        """Transform a pair of kernels.

        Parameters
        ----------
        kernels : Inhibition
            For P(t-1) and P(t-2).
        parity : int
            EVEN if ``W(-d) = W(d)``, ODD if ``W(-d) = -W(d)``.

        Returns
        -------
        Filter
        """
        padded = np.zeros_like(self._padded)
        one, two = self._factor(kernels.one), self._factor(kernels.two)
        return Filter(one, two, parity, padded, self._inside(padded))

    def apply(self, kernels: Filter) -> None:
        """Convolve: ``W_1 * P(t-1) + W_2 * P(t-2)``.

        Parameters
        ----------
        kernels : Filter
            The two kernels; its `result` takes the result.
        """
        one, two = (self._spectra[(self._latest - age) % MEMORY, kernels.parity] for age in (1, 2))
        cv2.multiply(one, kernels.one, dst=kernels.padded)
        cv2.accumulateProduct(two, kernels.two, kernels.padded)
        inverse = cv2.DFT_INVERSE | cv2.DFT_REAL_OUTPUT
        cv2.dft(kernels.padded, dst=kernels.padded, flags=inverse, nonzeroRows=self._shape[0])

    def _inside(self, padded: Map) -> Map:
        height, width = self._shape
        return padded[:height, :width]

    def _factor(self, kernel: Kernel) -> Map:
        """Return the spectrum of a kernel, less its i if it is odd, packed as factors."""
        padded = np.zeros(self._padded.shape)
        padded[: kernel.shape[0], : kernel.shape[1]] = kernel
        centre = kernel.shape[0] // 2
        spectrum = np.fft.fft2(np.roll(padded, (-centre, -centre), axis=(0, 1))) / padded.size
        # One of the two parts is 0 all over.
        real = spectrum.real + spectrum.imag
        return _packed(real + 1j * real)


def _padded_shape(shape: tuple[int, int], radius: int) -> tuple[int, int]:
    """Return sizes that hold the frame, its padding and the kernel, and transform fast."""
    # Columns are transformed fastest at multiples of 16, rows at any even product of 2, 3 and 5.
    height, width = (
        step * cv2.getOptimalDFTSize(-(-max(side + radius, 2 * radius + 1) // step))
        for side, step in zip(shape, (16, 2), strict=True)
    )
    return height, width


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
