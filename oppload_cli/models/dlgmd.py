"""D-LGMD, the baseline (``docs/model.md``, section 3)."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from oppload_cli.models.grouping import grouping_of
from oppload_cli.models.layers import Dpc
from oppload_cli.models.parameters import DlgmdParams

if TYPE_CHECKING:
    from oppload_cli.models.kernels import Map


class DlgmdResponse(NamedTuple):
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
        self._grouping = grouping_of(self.dpc, self.params)

    @property
    def grouped(self) -> Map:
        """G of the latest frame, shape (height, width), 0 to `grouped_limit`."""
        return self._grouping.grouped

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
        threshold = min(
            self.params.threshold_factor * self.dpc.luma_change_before_last,
            self.params.threshold_limit,
        )
        mean_s, mean_g = self._grouping(threshold)
        return DlgmdResponse(response=mean_g, s=mean_s)

    def at_rest(self) -> DlgmdResponse:
        """Return the answer to a frame in which nothing changed.

        Returns
        -------
        DlgmdResponse
            Zeros: E is 0 where P(t) is.
        """
        return DlgmdResponse(0.0, 0.0)
