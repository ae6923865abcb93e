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


class Factors(NamedTuple):
    """What the spectra of P(t-1) and P(t-2) are multiplied by, and their kernels' parity."""

    one: Map
    two: Map
    parity: int


class Convolution:
    """Convolutions, zero outside the frame, of the maps pushed one and two frames ago.

    They are circular over a frame padded by the kernel radius, which is the linear
    convolution inside the frame.

    Parameters
    ----------
    shape : tuple of int
        Height and width of the maps.
    radius : int
        Kernel radius in pixels.
    """

    def __init__(self, shape: tuple[int, int], radius: int) -> None:
        self._shape = shape
        padded = _padded_shape(shape, radius)
        self._padded = np.zeros(padded, np.float32)
        # By age modulo MEMORY, and by parity: the spectrum, and i times it.
        self._spectra = np.zeros((MEMORY, 2, *padded), np.float32)
        self._i = _packed(np.full(padded, 1j))
        self._sum = np.zeros(padded, np.float32)
        self._product = np.zeros(padded, np.float32)
        self._latest = 0

    def reset(self) -> None:
        """Forget all maps."""
        self._spectra[:] = 0

    def push(self, values: Map) -> None:
        """Take the next map.

        Parameters
        ----------
        values : ndarray of float32, shape (height, width)
            P(t).
        """
        height, width = self._shape
        self._latest = (self._latest + 1) % MEMORY
        self._padded[:height, :width] = values
        even, odd = self._spectra[self._latest]
        cv2.dft(self._padded, dst=even, nonzeroRows=height)
        cv2.mulSpectrums(even, self._i, 0, c=odd)

    def prepared(self, kernels: Inhibition, parity: int) -> Factors:
        """Transform a pair of kernels.

        Parameters
        ----------
        kernels : Inhibition
            For P(t-1) and P(t-2).
        parity : int
            EVEN if ``W(-d) = W(d)``, ODD if ``W(-d) = -W(d)``.

        Returns
        -------
        Factors
        """
        return Factors(self._factor(kernels.one), self._factor(kernels.two), parity)

    def apply(self, factors: Factors, out: Map) -> None:
        """Convolve: ``W_1 * P(t-1) + W_2 * P(t-2)``.

        Parameters
        ----------
        factors : Factors
            Of the two kernels.
        out : ndarray of float32, shape (height, width)
            Takes the result.
        """
        height, width = self._shape
        one, two = (self._spectra[(self._latest - age) % MEMORY, factors.parity] for age in (1, 2))
        cv2.multiply(one, factors.one, dst=self._sum)
        cv2.multiply(two, factors.two, dst=self._product)
        cv2.add(self._sum, self._product, dst=self._sum)
        inverse = cv2.DFT_INVERSE | cv2.DFT_REAL_OUTPUT
        cv2.dft(self._sum, dst=self._product, flags=inverse, nonzeroRows=height)
        np.copyto(out, self._product[:height, :width])

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
