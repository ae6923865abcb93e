"""OppLoD, the opponency based looming detector (``docs/model.md``, sections 4 and 5)."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from oppload_cli.models.layers import Dpc
from oppload_cli.models.opponency import PooledJudge, judge_for
from oppload_cli.models.parameters import OpplodParams, axes_of
from oppload_cli.models.strides import StridedDpc

if TYPE_CHECKING:
    from oppload_cli.models.kernels import Map


class Box(NamedTuple):
    """A rectangle in pixels: its left top corner, width and height."""

    x: float
    y: float
    width: float
    height: float


class OpplodResponse(NamedTuple):
    """What OppLoD answers to one frame.

    Attributes
    ----------
    response : float
        The enhanced response of the frame, at least 0.
    opponency : float
        R of the winning unit before enhancing, at least 0.
    box : Box or None
        Receptive field of the winning unit in working pixels, centred where the
        object is looming; it may reach over the frame's edge. None when the
        response is 0.
    """

    response: float
    opponency: float
    box: Box | None


class Opplod:
    """The OppLoD model.

    Parameters
    ----------
    shape : tuple of int
        Height and width of the working frames.
    params : OpplodParams, optional
        Its parameters; what follows from the height is filled in.
    dpc : Dpc, optional
        Layers shared with another model of the same DPC constants, made with
        this model's axes; whoever shares them steps them, and calls `respond`
        instead of `step`.

    Source: the OppLoD paper; ``docs/model.md``, sections 1, 2, 4 and 5.
    """

    name = "opplod"

    def __init__(
        self, shape: tuple[int, int], params: OpplodParams | None = None, *, dpc: Dpc | None = None
    ) -> None:
        self.params = (params or OpplodParams()).resolved(shape[0])
        self.dpc = dpc or Dpc(shape, self.params, axes_of(self.params))
        # The widest stride first: what the judge has pooled last is that of stride 1.
        self._strided = [
            StridedDpc(shape, self.params, axes_of(self.params), stride)
            for stride in range(self.params.strides, 1, -1)
        ]
        self.judge = judge_for(shape, self.params)

    @property
    def pathways(self) -> dict[int, Map]:
        """S_phi of the latest frame, shape (height, width), by direction phi in degrees."""
        return self.dpc.pathways

    def reset(self) -> None:
        """Start over: the next frame is frame 0."""
        self.dpc.reset()
        self.judge.reset()
        for strided in self._strided:
            strided.reset()

    def step(self, luma: Map) -> OpplodResponse | None:
        """Take the next frame and answer to it.

        Parameters
        ----------
        luma : ndarray of float32, shape (height, width)
            Luminance, 0 to 1.

        Returns
        -------
        OpplodResponse or None
            None during warm-up, frames 0 to 2.

        Raises
        ------
        FrameError
            If the array is not a luminance image of the right shape.
        """
        ready = self.dpc.step(luma)
        self.see(luma)
        return self.respond() if ready else None

    def see(self, luma: Map) -> None:
        """Take the next frame into the layers that are this model's own.

        Parameters
        ----------
        luma : ndarray of float32, shape (height, width)
            Luminance, 0 to 1, as the shared layers took it.

        Raises
        ------
        FrameError
            If the array is not a luminance image of the right shape.
        """
        for strided in self._strided:
            strided.step(luma)

    def respond(self) -> OpplodResponse:
        """Answer to the frame that the DPC layers hold: MDE, OMJ, enhancing.

        Returns
        -------
        OpplodResponse
        """
        if isinstance(self.judge, PooledJudge):
            for strided in self._strided:
                if strided.latest.ready:
                    # S is referred to the time of one frame.
                    share = strided.stride ** (-2 * self.params.compression)
                    dpc = strided.latest
                    self.judge.add(self._inside_border(dpc), share, dpc.live)
        verdict = self.judge.judge(self._inside_border(self.dpc), self.dpc.live)
        if verdict.response == 0:
            return OpplodResponse(0.0, verdict.opponency, None)
        field = float(self.params.receptive_field or 0)
        box = Box(verdict.centre_x - field / 2, verdict.centre_y - field / 2, field, field)
        return OpplodResponse(verdict.response, verdict.opponency, box)

    def at_rest(self) -> OpplodResponse:
        """Return the answer to a frame in which nothing changed.

        Returns
        -------
        OpplodResponse
            Zeros: E is 0 where P(t) is.
        """
        return OpplodResponse(0.0, 0.0, None)

    def _inside_border(self, dpc: Dpc) -> dict[int, Map]:
        """Return the S_phi, 0 where what comes into the frame meets no inhibition yet."""
        border = self.params.border
        if border:
            for values in dpc.pathways.values():
                values[:border] = values[-border:] = 0
                values[:, :border] = values[:, -border:] = 0
        return dpc.pathways
