"""Photoreceptors, DPC and MDE: the layers that both models share (sections 1, 2 and 4)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from oppload_cli.errors import FrameError
from oppload_cli.models.convolution import MEMORY
from oppload_cli.models.crew import Crew
from oppload_cli.models.direct import DirectSums
from oppload_cli.models.spectral import SpectralSums
from oppload_cli.native.library import library

if TYPE_CHECKING:
    from oppload_cli.models.kernels import Map
    from oppload_cli.models.parameters import DpcParams
    from oppload_cli.models.presynaptic import Layers, Live, Presynaptic


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
        Directions phi in degrees of the pathways' axes: none, (45, 135) or (0, 90);
        each serves the pair of pathways phi and phi + 180.

    Source: ``docs/model.md``, sections 1, 2 and 4.
    """

    def __init__(
        self, shape: tuple[int, int], params: DpcParams, axes: tuple[int, ...] = ()
    ) -> None:
        self.shape = shape
        self.params = params
        self.axes = axes
        sums = DirectSums if library() else SpectralSums
        self._sums: Presynaptic = sums(shape, params, axes, Crew(shape))
        self.reset()

    def reset(self) -> None:
        """Start over: the next frame is frame 0."""
        self._frames = 0
        self._means = [0.0] * MEMORY
        self._sums.reset()

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
        return self._sums.photoreceptors

    @property
    def presynaptic(self) -> Map:
        """S of D-LGMD, shape (height, width), at least 0; of meaning once `ready`."""
        return self._sums.presynaptic

    @property
    def pathways(self) -> dict[int, Map]:
        """S_phi by direction phi in degrees, shape (height, width); once `ready`."""
        return self._sums.pathways

    @property
    def live(self) -> Live | None:
        """Where S and the S_phi may be above 0, for whoever wants to pass over the rest.

        For each `LANES` columns, 0 where all are 0, shape (height, ...); None if not known.
        """
        return self._sums.live

    @property
    def layers(self) -> Layers:
        """E, I and the J_phi of the latest frame, which S is made from."""
        return self._sums.layers()

    def step(self, luma: Map) -> bool:
        """Take the next frame and compute S and the S_phi.

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
        if self._frames == 0:
            self._sums.begin(luma)
        else:
            self._see(luma)
        self._frames += 1
        if self._frames > 1:
            self._sums.take(ready=self.ready)
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
        layers = self.layers
        half = 0.5 * layers.inhibition
        if direction in layers.directional:
            return half + layers.directional[direction]
        return half - layers.directional[(direction + 180) % 360]

    def _check(self, luma: Map) -> None:
        if luma.shape != self.shape or luma.dtype != np.float32:
            raise FrameError(
                f"a frame must be a float32 array of shape {self.shape}, "
                f"not {luma.dtype} of shape {luma.shape}"
            )

    def _see(self, luma: Map) -> None:
        mean = self._sums.change(luma)
        if not np.isfinite(mean):
            raise FrameError("a frame holds luminance that is not finite (NaN or infinite)")
        self._means = [mean, *self._means[:-1]]
