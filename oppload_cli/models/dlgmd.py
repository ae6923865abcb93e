"""D-LGMD, the baseline (``docs/model.md``, section 3)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np

from oppload_cli.models.layers import Dpc, presynaptic_sum
from oppload_cli.models.parameters import DlgmdParams

if TYPE_CHECKING:
    from oppload_cli.models.kernels import Map


@dataclass(frozen=True)
class DlgmdResponse:
    """What D-LGMD answers to one frame.

    Attributes
    ----------
    response : float
        Mean of the grouped map G over the frame, 0 to `grouped_limit`.
    s : float
        Mean of the presynaptic sum S over the frame, at least 0.
    """

    response: float
    s: float


class Dlgmd:
    """The D-LGMD model.

    Parameters
    ----------
    shape : tuple of int
        Height and width of the working frames.
    params : DlgmdParams, optional
        Its parameters.
    dpc : Dpc, optional
        Layers shared with another model of the same DPC constants; whoever
        shares them steps them, and calls `respond` instead of `step`.

    Source: Zhao et al. 2021 with the constants of the authors' code;
    ``docs/model.md``, sections 1 to 3.
    """

    name = "dlgmd"

    def __init__(
        self, shape: tuple[int, int], params: DlgmdParams | None = None, *, dpc: Dpc | None = None
    ) -> None:
        self.params = params or DlgmdParams()
        self.dpc = dpc or Dpc(shape, self.params)
        self.presynaptic = np.zeros(shape, np.float32)
        self.grouped = np.zeros(shape, np.float32)

    def reset(self) -> None:
        """Start over: the next frame is frame 0."""
        self.dpc.reset()

    def step(self, luma: Map) -> DlgmdResponse | None:
        """Take the next frame and answer to it.

        Parameters
        ----------
        luma : ndarray of float32, shape (height, width)
            Luminance, 0 to 1.

        Returns
        -------
        DlgmdResponse or None
            None during warm-up, frames 0 to 2.

        Raises
        ------
        FrameError
            If the array is not a luminance image of the right shape.
        """
        return self.respond() if self.dpc.step(luma) else None

    def respond(self) -> DlgmdResponse:
        """Answer to the frame that the DPC layers hold: S, grouping, means.

        Returns
        -------
        DlgmdResponse
        """
        presynaptic_sum(self.dpc.excitation, self.dpc.inhibition, self.presynaptic)
        self._group()
        return DlgmdResponse(response=cv2.mean(self.grouped)[0], s=cv2.mean(self.presynaptic)[0])

    def at_rest(self) -> DlgmdResponse:
        """Return the answer to a frame in which nothing changed.

        Returns
        -------
        DlgmdResponse
            Zeros: E is 0 where P(t) is.
        """
        return DlgmdResponse(0.0, 0.0)

    def _group(self) -> None:
        """C = ones * S, G = S C, G = 0 below T, G = min(G, 1)."""
        side = self.params.group_size
        anchor = (side - 1) // 2  # of MATLAB's conv2(..., 'same')
        cv2.boxFilter(
            self.presynaptic,
            cv2.CV_32F,
            (side, side),
            dst=self.grouped,
            anchor=(anchor, anchor),
            normalize=False,
            borderType=cv2.BORDER_CONSTANT,
        )
        cv2.multiply(self.grouped, self.presynaptic, dst=self.grouped)
        threshold = min(
            self.params.threshold_factor * self.dpc.luma_change_before_last,
            self.params.threshold_limit,
        )
        # THRESH_TOZERO keeps what is strictly above; the model keeps T itself too.
        below = float(np.nextafter(np.float32(threshold), np.float32(-np.inf)))
        cv2.threshold(self.grouped, below, 0, cv2.THRESH_TOZERO, dst=self.grouped)
        limit = self.params.grouped_limit
        cv2.threshold(self.grouped, limit, limit, cv2.THRESH_TRUNC, dst=self.grouped)
