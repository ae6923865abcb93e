"""Photoreceptors, DPC and MDE: the layers that both models share (sections 1, 2 and 4).

``I_phi + I_(phi+180) = I`` halves the number of convolutions: with
``J_phi = I_phi - I / 2`` the opposite pathway has ``-J_phi``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np

from oppload_cli.errors import FrameError
from oppload_cli.models.convolution import EVEN, MEMORY, ODD, Convolution
from oppload_cli.models.crew import Crew
from oppload_cli.models.kernels import (
    direction_mask,
    excitation_kernel,
    inhibition_kernels,
)

if TYPE_CHECKING:
    from oppload_cli.models.kernels import Inhibition, Kernel, Map
    from oppload_cli.models.parameters import DpcParams


class Dpc:
    """The photoreceptors and the distributed presynaptic connections of one video.

    Buffers are made once: every array that it hands out is overwritten by the
    next frame.

    Parameters
    ----------
    shape : tuple of int
        Height and width of the working frames, each at least 1.
    params : DpcParams
        The DPC constants.
    axes : tuple of int
        Directions phi in degrees for which J_phi is computed; each serves the
        pair of pathways phi and phi + 180.

    Source: ``docs/model.md``, sections 1, 2 and 4.
    """

    def __init__(
        self, shape: tuple[int, int], params: DpcParams, axes: tuple[int, ...] = ()
    ) -> None:
        self.shape = shape
        self.params = params
        self.axes = axes
        self._crew = Crew(shape)
        self._excitation_kernel = _cropped(excitation_kernel(params))
        kernels = inhibition_kernels(params)
        directional = [(_directional(kernels, params, phi), ODD) for phi in axes]
        self._convolution = Convolution(
            shape, params.kernel_radius, [(kernels, EVEN), *directional]
        )
        self._luma = np.zeros(shape, np.float32)
        self.excitation = np.zeros(shape, np.float32)
        self.inhibition, *parts = self._convolution.results
        self.directional = dict(zip(axes, parts, strict=True))
        self.reset()

    def reset(self) -> None:
        """Start over: the next frame is frame 0."""
        self._frames = 0
        self._means = [0.0] * MEMORY
        self._convolution.reset()

    @property
    def ready(self) -> bool:
        """Whether P(t), P(t-1) and P(t-2) exist: from the fourth frame on."""
        return self._frames > MEMORY

    @property
    def luma_change(self) -> float | None:
        """Mean of P(t) over the frame, 0 to 1; None on the first frame."""
        return self._means[0] if self._frames > 1 else None

    @property
    def luma_change_before_last(self) -> float:
        """Mean of P(t-2) over the frame, 0 to 1, for the threshold of D-LGMD."""
        return self._means[2]

    @property
    def photoreceptors(self) -> Map:
        """P(t), shape (height, width), 0 to 1 (``docs/model.md``, section 1)."""
        return self._convolution.values

    def step(self, luma: Map) -> bool:
        """Take the next frame and compute E, I and the J_phi.

        Parameters
        ----------
        luma : ndarray of float32, shape (height, width)
            Luminance L(t), 0 to 1.

        Returns
        -------
        bool
            Whether the layers are valid (see `ready`).

        Raises
        ------
        FrameError
            If the array is not float32 of the right shape, or holds a value
            that is not finite.
        """
        self._check(luma)
        self._frames += 1
        if self._frames > 1:
            self._see(luma)
        np.copyto(self._luma, luma)
        if self._frames > 1:
            self._crew(self._excite, *self._convolution.parts)
        return self.ready

    def inhibition_of(self, direction: int) -> Map:
        """Return I_phi, the inhibition of one pathway (``docs/model.md``, section 4).

        Parameters
        ----------
        direction : int
            One of `axes`, or 180 degrees from it.

        Returns
        -------
        ndarray of float32, shape (height, width)
        """
        half = 0.5 * self.inhibition
        if direction in self.directional:
            return half + self.directional[direction]
        return half - self.directional[(direction + 180) % 360]

    def _check(self, luma: Map) -> None:
        if luma.shape != self.shape or luma.dtype != np.float32:
            raise FrameError(
                f"a frame must be a float32 array of shape {self.shape}, "
                f"not {luma.dtype} of shape {luma.shape}"
            )

    def _see(self, luma: Map) -> None:
        change = cv2.absdiff(luma, self._luma, dst=self.photoreceptors)
        mean = cv2.mean(change)[0]
        if not np.isfinite(mean):
            self._frames -= 1
            raise FrameError("a frame holds luminance that is not finite (NaN or infinite)")
        self._means = [mean, *self._means[:-1]]
        self._convolution.advance()

    def _excite(self) -> None:
        cv2.filter2D(
            self.photoreceptors,
            cv2.CV_32F,
            self._excitation_kernel,
            dst=self.excitation,
            borderType=cv2.BORDER_CONSTANT,
        )


def presynaptic_sum(excitation: Map, inhibition: Map, out: Map) -> Map:
    """Compute S = max(0, E - I), eq. (original layer S) with its rectifier.

    Parameters
    ----------
    excitation, inhibition : ndarray of float32, shape (height, width)
        E and I (or I_phi).
    out : ndarray of float32, shape (height, width)
        Where S is written.

    Returns
    -------
    ndarray of float32, shape (height, width)
        `out`.
    """
    cv2.subtract(excitation, inhibition, dst=out)
    return rectified(out, excitation)


def rectified(values: Map, excitation: Map) -> Map:
    """Rectify E - I in place.

    The result is held at or below E: where nothing changed, E is exactly 0, and so
    must S be, whatever the last digits of I are.

    Parameters
    ----------
    values, excitation : ndarray of float32, shape (height, width)
        E - I (or E - I_phi), and E.

    Returns
    -------
    ndarray of float32, shape (height, width)
        `values`, now S.
    """
    cv2.min(values, excitation, dst=values)
    cv2.threshold(values, 0, 0, cv2.THRESH_TOZERO, dst=values)
    return values


def _directional(kernels: Inhibition, params: DpcParams, phi: float) -> Inhibition:
    mask = direction_mask(params, phi) - 0.5
    return type(kernels)(kernels.one * mask, kernels.two * mask)


def _cropped(kernel: Kernel) -> Map:
    """Cut a kernel to the centred square that holds all its non-zero pixels."""
    radius = kernel.shape[0] // 2
    rows, columns = np.nonzero(kernel)
    reach = (
        int(max(np.abs(rows - radius).max(), np.abs(columns - radius).max())) if len(rows) else 0
    )
    inner = slice(radius - reach, radius + reach + 1)
    return kernel[inner, inner].astype(np.float32)
