"""OppLoD, the opponency based looming detector (``docs/model.md``, sections 4 and 5)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import cv2
import numpy as np

from oppload_cli.models.crew import Crew
from oppload_cli.models.layers import Dpc, rectified
from oppload_cli.models.opponency import PooledJudge, judge_for
from oppload_cli.models.parameters import OpplodParams, axes_of
from oppload_cli.models.strides import StridedDpc

if TYPE_CHECKING:
    from oppload_cli.models.kernels import Map


@dataclass(frozen=True)
class Box:
    """A rectangle in pixels: its left top corner, width and height."""

    x: float
    y: float
    width: float
    height: float


@dataclass(frozen=True)
class OpplodResponse:
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
        self.pathways = {
            direction: self.judge.map(direction)
            for axis in axes_of(self.params)
            for direction in (axis, axis + 180)
        }
        self._balance = np.zeros(shape, np.float32)
        self._crew = Crew(shape)

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
                    self._extract_directions(strided.latest)
                    # S is referred to the time of one frame.
                    share = strided.stride ** (-2 * self.params.compression)
                    self.judge.add(self.pathways, share)
        self._extract_directions(self.dpc)
        verdict = self.judge.judge(self.pathways)
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

    def _extract_directions(self, dpc: Dpc) -> None:
        """S_phi = max(0, E - I / 2 - J_phi), and with + J_phi for the opposite one."""
        cv2.scaleAdd(dpc.inhibition, -0.5, dpc.excitation, dst=self._balance)
        self._crew(*(partial(self._extract_pair, dpc, axis) for axis in dpc.directional))

    def _extract_pair(self, dpc: Dpc, axis: int) -> None:
        passing, opposite = self.pathways[axis], self.pathways[axis + 180]
        cv2.subtract(self._balance, dpc.directional[axis], dst=passing)
        cv2.add(self._balance, dpc.directional[axis], dst=opposite)
        for values in (passing, opposite):
            rectified(values, dpc.excitation)
            self._clear_border(values)

    def _clear_border(self, values: Map) -> None:
        """Set S to 0 where what comes into the frame meets no inhibition from outside it."""
        border = self.params.border
        if border:
            values[:border] = values[-border:] = 0
            values[:, :border] = values[:, -border:] = 0
