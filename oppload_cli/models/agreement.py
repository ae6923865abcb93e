"""The judgement of ``opplod``: the opponent units and the growth of the flow must agree.

Both measure an approach, in different ways: the units respond to edges that move apart, fast, at
once; the growth says how fast everything about a place becomes larger, for a tenth of a second
(:mod:`oppload_cli.motion.growth`). Their errors are different, so that their product is right more
often than either (``docs/footage.md``).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np

from oppload_cli.models.opplod_parameters import OpplodResponse
from oppload_cli.models.opposing_motion import PooledJudgement
from oppload_cli.motion.growth import RadialGrowth

if TYPE_CHECKING:
    from oppload_cli.models.dpc import Map
    from oppload_cli.models.layers import Dpc
    from oppload_cli.models.opplod_parameters import OpplodParams
    from oppload_cli.motion.flow import Flow

# Growth in 1/s that is assumed where no flow can be measured: then an alarm needs a response of the
# units that is about as large as that of preset ``reference``.
_ASSUMED_GROWTH = 0.26


def evidence(growth: Map, opponency: Map, params: OpplodParams) -> Map:
    """Return ``A (c2 R^2 + R_0)^k``, what both measurements say together.

    Its logarithm is the sum of both logarithms with the weights 1 and k, as in a likelihood ratio.

    Parameters
    ----------
    growth : ndarray of float32
        A, in 1/s, at least 0.
    opponency : ndarray of float32
        ``c2 R^2``, the enhanced response of the units, at least 0.
    params : OpplodParams
        `opponency_floor` is R_0, and `opponency_weight` is k.
    """
    floor = np.float32(params.opponency_floor)
    units = (opponency + floor) ** np.float32(params.opponency_weight)
    return np.asarray(growth * units, np.float32)


class AgreementJudgement(PooledJudgement):
    """Opponent units and growth, multiplied at each place; parameters as `CellJudgement`."""

    def __init__(
        self, shape: tuple[int, int], params: OpplodParams, per_second: float = 30.0
    ) -> None:
        self._shape = shape  # before the base class, which calls `reset`
        super().__init__(shape, params, per_second)
        # A unit's receptive field reaches a place if it is at most half a field away.
        reach = int(self.maps.field / 2 // params.cell_px)
        self._field = np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)

    def reset(self) -> None:
        """Forget all frames."""
        super().reset()
        side = self._params.growth_share * min(self._shape)
        rows, columns = self.maps.responses.shape
        memory_s = self._params.growth_memory_s
        self._growth = RadialGrowth(self._shape, (rows, columns), side, memory_s)
        self._elapsed = 0.0  # intervals since the latest flow

    def see(self, flow: Flow | None, elapsed: float) -> None:
        """Take the flow of the next frame, `elapsed` intervals after the frame before.

        None is a frame without a flow of its own: the first one, and pictures between frames.
        """
        self._elapsed += elapsed
        if flow is not None and flow.vectors.size:
            self._growth.step(flow, self._elapsed / self._per_second)
            self._elapsed = 0.0

    def respond(self, dpc: Dpc, *, measured: bool) -> OpplodResponse:
        """Judge the motion of one frame.

        Parameters
        ----------
        dpc : Dpc
            S_phi of the frame.
        measured : bool
            Whether frames of this size have a flow. Without one the units alone are the evidence.

        Returns
        -------
        OpplodResponse
            The largest product, at the place of the growth.
        """
        units = self.judge(dpc)
        params = self._params
        opponency = np.asarray(cv2.dilate(self.maps.responses, self._field), np.float32)
        growth = self._growth.growth
        if not measured:
            growth = np.float32(_ASSUMED_GROWTH) * (self.maps.responses > 0)
        product = evidence(growth, opponency, params)
        self.maps = self.maps._replace(responses=product * self._selected)
        row, column = divmod(int(self.maps.responses.argmax()), product.shape[1])
        response = float(self.maps.responses[row, column])
        return OpplodResponse(
            response,
            self.maps.box(row, column) if response else None,
            float(opponency[row, column]) if response else units.response,
            float(growth[row, column]) if measured else None,
        )
