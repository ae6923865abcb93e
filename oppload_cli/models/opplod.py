"""OppLoD for cameras: the opponent units and the growth of the optical flow must agree.

Both measure an approach, in different ways: the units respond to edges that move apart, fast, at
once; the growth says how fast everything about a place becomes larger, for a tenth of a second
(:mod:`oppload_cli.motion.growth`). Their errors are different, so that their product is right more
often than either (``docs/footage.md``).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import cv2
import numpy as np

from oppload_cli.models.detector import AlarmRule, Column, Response
from oppload_cli.models.opplod_reference import (
    OpplodReference,
    OpplodReferenceParams,
    enhanced,
)
from oppload_cli.motion.flow import SHORTEST_SIDE
from oppload_cli.motion.growth import RadialGrowth
from oppload_cli.schema import parameter

if TYPE_CHECKING:
    from typing import Any

    from oppload_cli.models.dpc import Map

# Growth in 1/s that is assumed where no flow can be measured: then an alarm needs a response of the
# units that is about as large as that of ``opplod_reference``.
_ASSUMED_GROWTH = 0.26


@dataclass(frozen=True, kw_only=True)
class OpplodParams(OpplodReferenceParams):
    """Parameters of OppLoD with growth (``docs/model.md``, sections 4 and 5; ``docs/footage.md``).

    Examples
    --------
    >>> import oppload_cli as oppload
    >>> oppload.OpplodParams().replaced(gain=2).gain
    2.0
    """

    growth_share: float = parameter(
        0.3,
        "side of the window in which growth is measured, as a share of the working height; the "
        "focus of expansion may be about as far from its middle",
        low=0.05,
        high=1,
    )
    growth_memory_s: float = parameter(
        0.1, "time constant with which growth is followed along its motion", low=0, high=10
    )
    opponency_weight: float = parameter(
        0.15, "exponent of the units' response in its product with the growth", low=0, high=10
    )
    opponency_floor: float = parameter(
        1e-6,
        "added to the opponent units' response, so that units which do not see an object, as "
        "before a ground that moves, lower the product only to a limit",
        low=1e-12,
        high=1e9,
    )


@dataclass(frozen=True)
class OpplodResponse(Response):
    """The response of OppLoD to one frame.

    Attributes
    ----------
    response : float
        The largest product of growth and opponency, at least 0.
    box : Box or None
        Receptive field of the unit at this place in working pixels. The box may reach over the
        frame's edge. None if the response is 0.
    opponency : float
        First witness: the largest enhanced response of the units around the place, ``c2 R^2``.
    growth : float or None
        Second witness: growth at the place in 1/s, at least 0; None where no flow can be measured.

    Examples
    --------
    >>> import oppload_cli as oppload
    >>> oppload.OpplodResponse(0.5, opponency=0.7).opponency
    0.7
    """

    opponency: float = 0.0
    growth: float | None = None


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


class Opplod(OpplodReference):
    """The OppLoD model with growth; arguments as :class:`~oppload_cli.models.detector.Detector`.

    Give `frame_rate`, because without it each frame counts as 1/30 s.

    Source: the OppLoD paper; ``docs/model.md``, sections 1, 2, 4 and 5; ``docs/footage.md``.

    Examples
    --------
    >>> import oppload_cli as oppload
    >>> with oppload.open_source("controls/looming-perspective") as frames:
    ...     model = oppload.Opplod(frames.working.shape, frame_rate=frames.facts.frame_rate)
    ...     responses = [model.step(frame.luma) for frame in frames]
    >>> responses[0] is None, responses[80].response > 0
    (True, True)
    """

    name = "opplod"
    label = "OppLoD"
    colour = "#D55E00"
    answers_to = "edges that move outward from a centre on opposite sides, where the flow grows too"
    cost_ms = 2.6
    meaning = "for cameras: OppLoD's opponent units and the growth of the flow must agree"
    response_column = "", "growth times a power of the units' response; empty during warm-up"
    responses = OpplodResponse
    parameters = OpplodParams
    # The growth of a scene that always moves does not reach the floor: no background is needed.
    alarm: ClassVar = AlarmRule(0.09, factor=0.0)
    least_object: ClassVar = 0.02, 0.2
    by_default = True
    columns: ClassVar = (
        Column(
            "growth",
            "1/s",
            "second witness: growth of what is at the place; empty where no flow can be measured",
        ),
        Column(
            "opponency",
            "",
            "first witness: largest enhanced response of the units whose fields reach the place",
        ),
    )
    witnesses = "growth", "opponency"

    params: OpplodParams

    def __init__(
        self, shape: tuple[int, int], params: OpplodParams | None = None, **others: Any
    ) -> None:
        super().__init__(shape, params, **others)
        self._measured = min(self.shape) >= SHORTEST_SIDE
        # A unit's receptive field reaches a place if it is at most half a field away.
        reach = int(self.params.field_px / 2 // self.params.cell_px)
        self._field = np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)
        self._begin_growth()

    def _begin_growth(self) -> None:
        params = self.params
        rows, columns = self.units.responses.shape
        side = params.growth_share * min(self.shape)
        self._growth = RadialGrowth(self.shape, (rows, columns), side, params.growth_memory_s)
        self._elapsed = 0.0  # intervals since the latest flow

    def reset(self) -> None:
        """Forget all frames: the next frame is frame 0."""
        super().reset()
        self.layers.flow().reset()
        self._begin_growth()

    def at_rest(self) -> OpplodResponse:
        """Return the response, 0, to a frame in which nothing changed."""
        return OpplodResponse(0.0, growth=0.0 if self._measured else None)

    def step(self, luma: Map) -> OpplodResponse | None:  # type: ignore[override]
        """Take the next frame: MDE, OMJ, enhancing, and growth.

        The result is None until frames have been compared over three intervals.
        """
        frames = self._dpc.frames
        ready = self._dpc.step(luma)
        dpc = self._dpc.layer
        self._elapsed += dpc.photoreceptors.elapsed if frames else 0.0
        # Frames without a flow of their own are the first one, and pictures between frames.
        flow = self.layers.flow().of(luma, frames)
        if flow is not None and flow.vectors.size:
            self._growth.step(flow, self._elapsed / self.layers.clock.per_second)
            self._elapsed = 0.0
        return self._agreed(self._opponency(dpc)) if ready else None

    def _agreed(self, opponency: Map) -> OpplodResponse:
        """Return the largest product of growth and opponency, at the place of the growth."""
        params = self.params
        responses = enhanced(opponency, params.gain, params.threshold)
        around = np.asarray(cv2.dilate(responses, self._field), np.float32)
        growth = self._growth.growth
        if not self._measured:  # frames of this size have no flow: the units alone are the evidence
            growth = np.float32(_ASSUMED_GROWTH) * (responses > 0)
        product = evidence(growth, around, params) * self._units.selected
        self._units.respond(product)
        row, column = divmod(int(product.argmax()), product.shape[1])
        response = float(product[row, column])
        box = self.units.box(row, column) if response else None
        largest = float(around[row, column] if response else responses.max())
        return OpplodResponse(
            response, box, largest, float(growth[row, column]) if self._measured else None
        )
