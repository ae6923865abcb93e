"""OppLoD, the opponency based looming detector (``docs/model.md``, sections 4 and 5)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import cv2
import numpy as np

from oppload_cli.models.crew import Crew
from oppload_cli.models.layers import Dpc, rectified
from oppload_cli.models.opponency import judge_for
from oppload_cli.models.parameters import OpplodParams, axes_of

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
        self.judge = judge_for(shape, self.params)
        self.pathways = {
            direction: self.judge.map(direction)
            for axis in axes_of(self.params)
            for direction in (axis, axis + 180)
        }
        self._balance = np.zeros(shape, np.float32)
        self._crew = Crew(shape)
        self._extract = [partial(self._extract_pair, axis) for axis in axes_of(self.params)]

    def reset(self) -> None:
        """Start over: the next frame is frame 0."""
        self.dpc.reset()

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
        return self.respond() if self.dpc.step(luma) else None

    def respond(self) -> OpplodResponse:
        """Answer to the frame that the DPC layers hold: MDE, OMJ, enhancing.

        Returns
        -------
        OpplodResponse
        """
        self._extract_directions()
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

    def _extract_directions(self) -> None:
        """S_phi = max(0, E - I / 2 - J_phi), and with + J_phi for the opposite one."""
        cv2.scaleAdd(self.dpc.inhibition, -0.5, self.dpc.excitation, dst=self._balance)
        self._crew(*self._extract)

    def _extract_pair(self, axis: int) -> None:
        directional = self.dpc.directional[axis]
        passing, opposite = self.pathways[axis], self.pathways[axis + 180]
        cv2.subtract(self._balance, directional, dst=passing)
        cv2.add(self._balance, directional, dst=opposite)
        rectified(passing, self.dpc.excitation)
        rectified(opposite, self.dpc.excitation)
