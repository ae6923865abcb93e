"""E, I, J and S by OpenCV: discrete Fourier transforms, and passes over whole maps.

``I_phi + I_(phi+180) = I`` halves the number of convolutions: with
``J_phi = I_phi - I / 2`` the opposite pathway has ``-J_phi``.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import cv2
import numpy as np

from oppload_cli.models.convolution import EVEN, ODD, Convolution
from oppload_cli.models.kernels import direction_mask, excitation_kernel, inhibition_kernels
from oppload_cli.models.presynaptic import Layers

if TYPE_CHECKING:
    from oppload_cli.models.crew import Crew
    from oppload_cli.models.kernels import Inhibition, Kernel, Map
    from oppload_cli.models.parameters import DpcParams
    from oppload_cli.models.presynaptic import Live


class SpectralSums:
    """The presynaptic sums of one video, by OpenCV.

    Parameters
    ----------
    shape : tuple of int
        Height and width of the maps.
    params : DpcParams
        The DPC constants.
    axes : tuple of int
        Directions phi in degrees of the pathways' axes.
    crew : Crew
        Shares out the work.

    Attributes
    ----------
    presynaptic, pathways, live
        As :class:`oppload_cli.models.presynaptic.Presynaptic` has them.
    """

    def __init__(
        self, shape: tuple[int, int], params: DpcParams, axes: tuple[int, ...], crew: Crew
    ) -> None:
        self._crew = crew
        self._kernel = _cropped(excitation_kernel(params))
        kernels = inhibition_kernels(params)
        self._convolution = Convolution(
            shape,
            params.kernel_radius,
            [(kernels, EVEN), *((_directional(kernels, params, phi), ODD) for phi in axes)],
        )
        inhibition, *parts = self._convolution.results
        self._layers = Layers(
            np.zeros(shape, np.float32), inhibition, dict(zip(axes, parts, strict=True))
        )
        self._luma: list[Map] = [np.zeros(shape, np.float32) for _ in range(2)]
        self._balance = np.zeros(shape, np.float32)
        self.live: Live | None = None
        self.presynaptic: Map = np.zeros(shape, np.float32)
        self.pathways: dict[int, Map] = {
            phi: np.zeros(shape, np.float32) for axis in axes for phi in (axis, axis + 180)
        }

    @property
    def photoreceptors(self) -> Map:
        """P(t), the latest map taken."""
        return self._convolution.values

    def reset(self) -> None:
        """Forget all maps."""
        self._convolution.reset()

    def begin(self, luma: Map) -> None:
        """Keep L of the first frame."""
        np.copyto(self._luma[0], luma)

    def change(self, luma: Map) -> float:
        """Compute P(t) from L(t) and the L that was kept; return its mean."""
        kept, spare = self._luma
        np.copyto(spare, luma)
        return cv2.mean(cv2.absdiff(luma, kept, dst=self._convolution.values))[0]

    def take(self, *, ready: bool) -> None:
        """Take what `change` has computed; compute the sums too if they are valid."""
        self._luma.reverse()
        self._convolution.advance()
        self._crew(self._excite, *self._convolution.parts)
        if ready:
            layers = self._layers
            cv2.scaleAdd(layers.inhibition, -0.5, layers.excitation, dst=self._balance)
            pairs = (partial(self._extract_pair, axis) for axis in layers.directional)
            self._crew(self._sum, *pairs)

    def layers(self) -> Layers:
        """Return what the sums of the latest map are made from."""
        return self._layers

    def _excite(self) -> None:
        cv2.filter2D(
            self.photoreceptors,
            cv2.CV_32F,
            self._kernel,
            dst=self._layers.excitation,
            borderType=cv2.BORDER_CONSTANT,
        )

    def _sum(self) -> None:
        """S = max(0, E - I), eq. (original layer S) with its rectifier."""
        cv2.subtract(self._layers.excitation, self._layers.inhibition, dst=self.presynaptic)
        self._rectify(self.presynaptic)

    def _extract_pair(self, axis: int) -> None:
        """S_phi = max(0, E - I / 2 - J_phi), and with + J_phi for the opposite one."""
        directional = self._layers.directional[axis]
        passing, opposite = self.pathways[axis], self.pathways[axis + 180]
        cv2.subtract(self._balance, directional, dst=passing)
        cv2.add(self._balance, directional, dst=opposite)
        self._rectify(passing)
        self._rectify(opposite)

    def _rectify(self, values: Map) -> None:
        # At most E: where nothing changed, E is exactly 0, and so must S be, whatever
        # the last digits of I are.
        cv2.min(values, self._layers.excitation, dst=values)
        cv2.threshold(values, 0, 0, cv2.THRESH_TOZERO, dst=values)


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
