"""The DPC layers of frames several apart, for edges too slow to be seen from one to the next."""

from __future__ import annotations

from typing import TYPE_CHECKING

from oppload_cli.models.layers import Dpc

if TYPE_CHECKING:
    from oppload_cli.models.kernels import Map
    from oppload_cli.models.parameters import DpcParams


class StridedDpc:
    """DPC layers over every n-th frame, valid at each frame.

    ``P(t) = |L(t) - L(t - n)|``, and the inhibition comes from P(t - n) and P(t - 2 n):
    as many sets of layers as the stride is long take the frames in turn.

    Parameters
    ----------
    shape : tuple of int
        Height and width of the working frames.
    params : DpcParams
        The DPC constants.
    axes : tuple of int
        Directions phi in degrees for which J_phi is computed.
    stride : int
        How many frames apart the frames are, at least 1.

    Source: ``docs/robust.md``; the layers are those of ``docs/model.md``, sections 1, 2 and 4.
    """

    def __init__(
        self, shape: tuple[int, int], params: DpcParams, axes: tuple[int, ...], stride: int
    ) -> None:
        self.stride = stride
        self._turns = [Dpc(shape, params, axes) for _ in range(stride)]
        self._turn = 0

    @property
    def latest(self) -> Dpc:
        """The layers that took the latest frame; they may not be ready."""
        return self._turns[self._turn]

    def reset(self) -> None:
        """Start over: the next frame is frame 0."""
        for dpc in self._turns:
            dpc.reset()

    def step(self, luma: Map) -> bool:
        """Take the next frame.

        Parameters
        ----------
        luma : ndarray of float32, shape (height, width)
            Luminance L(t), 0 to 1.

        Returns
        -------
        bool
            Whether the layers are valid: from frame 3 times the stride on.

        Raises
        ------
        FrameError
            If the array is not a luminance image of the right shape.
        """
        turn = (self._turn + 1) % self.stride
        ready = self._turns[turn].step(luma)
        self._turn = turn  # a frame that is refused takes no turn
        return ready
