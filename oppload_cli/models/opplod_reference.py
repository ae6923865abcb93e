"""OppLoD with its judgement of opposing motion made to work (``docs/model.md``, sections 4 and 5).

The paper's literal judgement cannot tell outward from inward motion, and works only if an object is
at the middle of a unit (:mod:`oppload_cli.models.opplod_paper`). Here units at every cell pool the
motion about them, multiply opposite motion on opposite sides, and subtract the inward products from
the outward ones.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from oppload_cli.compute.loops import with_twin
from oppload_cli.models.detector import AlarmRule, Response, inner
from oppload_cli.models.dpc import referred
from oppload_cli.models.units import CellDetector, UnitParams, has_history
from oppload_cli.schema import parameter

if TYPE_CHECKING:
    from typing import Any

    from oppload_cli.models.dpc import Map
    from oppload_cli.models.layers import Dpc
    from oppload_cli.models.units import Maps


@dataclass(frozen=True, kw_only=True)
class OpplodReferenceParams(UnitParams):
    """Parameters of OppLoD: DPC, opponency and enhancing (``docs/model.md``, sections 4 and 5).

    Examples
    --------
    >>> import oppload_cli as oppload
    >>> oppload.OpplodReferenceParams().replaced(gain=2).gain
    2.0
    """

    axes: int = parameter(
        45, "first axis of opponency; the second is at a right angle", unit="deg", choices=(0, 45)
    )
    periphery: float = parameter(
        1.0, "weight w_p of inward motion, which is subtracted from outward", low=0, high=1000
    )
    threshold: float = parameter(
        0.0, "threshold of opponency, T_o; at or below it the response is 0", low=0, high=1e9
    )
    gain: float = parameter(1.0, "gain of enhancing, c2", low=0, high=1e9)

    @property
    def both_axes(self) -> tuple[int, int]:
        """The two axes of opponency in degrees, 90 apart."""
        return self.axes, self.axes + 90


@dataclass(frozen=True)
class OpplodReferenceResponse(Response):
    """The response of OppLoD to one frame.

    Attributes
    ----------
    response : float
        The enhanced response of the winning unit, at least 0.
    box : Box or None
        Receptive field of the winning unit in working pixels; the object looms at its centre. The
        box may reach over the frame's edge. None if the response is 0.
    opponency : float
        R of the winning unit before enhancing, at least 0.

    Examples
    --------
    >>> import oppload_cli as oppload
    >>> oppload.OpplodReferenceResponse(0.5, opponency=0.7).opponency
    0.7
    """

    opponency: float = inner(0.0, "", "R of the winning unit, before enhancing")


# ---- The equations -------------------------------------------------------------------------


def offset_weights(reach: int, axis: int, periphery: float) -> Map:
    """Return the weights of the offsets u of the opponent products, steps 2 and 3 of section 5.

    Parameters
    ----------
    reach : int
        Largest offset in cells, across and down.
    axis : int
        Direction phi of the passing pathway in degrees: 0, 45, 90 or 135.
    periphery : float
        w_p, the weight with which inward motion is subtracted.

    Returns
    -------
    ndarray of float32, shape (2 reach + 1, 2 reach + 1)
        By row and column of u: 1 where ``u . u_phi > 0`` (outward), -w_p where it is below 0
        (inward), else 0.
    """
    # For these directions both components of u_phi, times a common factor, are -1, 0 or 1.
    right = round(math.cos(math.radians(axis)) * math.sqrt(2))
    up = round(math.sin(math.radians(axis)) * math.sqrt(2))
    y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    along = x * right - y * up
    return np.asarray((along > 0) - periphery * (along < 0), np.float32)


@with_twin
def opponent_products(pooled: Maps, weights: Maps) -> Maps:
    """Return the weighted sums of ``O(c, u) = S_phi(c + u) S_(phi+180)(c - u)`` over offsets u.

    Parameters
    ----------
    pooled : ndarray of float32, shape (2 axes, rows, columns)
        The pooled S_phi of each axis, followed by the pooled S_(phi+180), contiguous. Outside the
        frame they count as 0.
    weights : ndarray of float32, shape (axes, 2 reach + 1, 2 reach + 1)
        :func:`offset_weights` of each axis, contiguous.

    Returns
    -------
    ndarray of float32, shape (axes, rows, columns)
        ``out(c) - w_p in(c)`` of the unit at every cell c.
    """
    axes, reach = len(weights), weights.shape[-1] // 2
    sums = np.zeros_like(pooled[:axes])
    rows, columns = sums.shape[1:]
    for axis, dy, dx in np.argwhere(weights) - (0, reach, reach):
        y, x = abs(dy), abs(dx)  # for units nearer to the edge, c + u or c - u is outside
        if 2 * y < rows and 2 * x < columns:
            ahead = pooled[axis, y + dy : rows - y + dy, x + dx : columns - x + dx]
            behind = pooled[axes + axis, y - dy : rows - y - dy, x - dx : columns - x - dx]
            products = weights[axis, reach + dy, reach + dx] * ahead * behind
            sums[axis, y : rows - y, x : columns - x] += products
    return sums


def enhanced(opponency: Map, gain: float, threshold: float) -> Map:
    """Return ``c2 R^2`` where R is above T_o, and 0 elsewhere, step 4 of section 5."""
    return np.where(opponency > threshold, np.float32(gain) * opponency**2, np.float32(0))


# ---- The detector --------------------------------------------------------------------------


class OpplodReference(CellDetector):
    """OppLoD as in the paper, made to work at any frame rate and place; arguments as `Detector`.

    Source: the OppLoD paper; ``docs/model.md``, sections 1, 2, 4 and 5.

    Examples
    --------
    >>> import oppload_cli as oppload
    >>> with oppload.open_source("controls/looming-perspective") as frames:
    ...     model = oppload.OpplodReference(frames.working.shape, frame_rate=60)
    ...     responses = [model.step(frame.luma) for frame in frames]
    >>> responses[0] is None, responses[80].response > 0
    (True, True)
    """

    name = "opplod_reference"
    label = "OppLoD reference"
    colour = "#D666C2"
    evaluated = False  # if no version of OppLoD is chosen, two are evaluated
    year = 2023
    reference = "Shuang et al., OppLoD, arXiv:2302.10284"
    answers_to = "edges that move outward from a centre on opposite sides, at the same time"
    made_for = "240 px high, 30 frames/s; other rates by its presentation times"
    cost_ms = 0.9
    meaning = "the paper's OppLoD made to work: DPC, directional inhibition, opponency, enhancing"
    response_column = "", "enhanced response of the winning unit; empty during warm-up"
    responses: ClassVar[type[Response]] = OpplodReferenceResponse
    parameters: ClassVar = OpplodReferenceParams
    # Its responses to the first edges after a rest are high: two of three frames must agree.
    alarm: ClassVar = AlarmRule(8e-4, factor=30.0, enough_s=0.03, window_s=0.09)
    least_object: ClassVar = 1e-6, 0.01

    params: OpplodReferenceParams

    def __init__(
        self, shape: tuple[int, int], params: OpplodReferenceParams | None = None, **others: Any
    ) -> None:
        super().__init__(shape, params, **others)
        own = self.params
        self._dpc = self.layers.dpc(own, own.both_axes)
        reach = int(own.field_px / 2 // own.cell_px)
        self._weights = np.array(
            [offset_weights(reach, axis, own.periphery) for axis in own.both_axes]
        )

    def step(self, luma: Map) -> OpplodReferenceResponse | None:
        """Take the next frame: MDE, OMJ and enhancing.

        The result is None until frames have been compared over three intervals.
        """
        if not self._dpc.step(luma):
            return None
        params, opponency = self.params, self._opponency(self._dpc.layer)
        responses = enhanced(opponency, params.gain, params.threshold)
        self._units.respond(responses)
        row, column = divmod(int(opponency.argmax()), opponency.shape[1])
        best = float(opponency[row, column])
        response = params.gain * best**2 if best > params.threshold else 0.0
        box = self.units.box(row, column) if response else None
        return OpplodReferenceResponse(response, box, best)

    def _opponency(self, dpc: Dpc) -> Map:
        """Return R(c) of the unit at every cell, ``max(0, out - w_p in)`` summed over both axes.

        Cells where motion has only just begun are left out (`history`). So is all motion at the
        start of a video, and after a rest of the complete scene (``docs/time.md``).
        """
        params, photoreceptors = self.params, dpc.photoreceptors
        if params.history and not photoreceptors.motion_lasts:
            return np.zeros_like(self._units.selected)
        directions = *params.both_axes, *(axis + 180 for axis in params.both_axes)
        pooled = self._units.pool([dpc.sums.pathways[phi] for phi in directions])
        if photoreceptors.share != 1:
            p = self._units.pool(photoreceptors.maps[:1])
            e = np.float32(dpc.kernels.excitation.sum()) * p
            pooled = referred(pooled, e, photoreceptors.share, directional=True)
        if params.history:
            pooled *= has_history(photoreceptors.coarse(pooled.shape[1:]), params.history)
        products = np.maximum(opponent_products(pooled, self._weights), 0)
        return np.asarray(products.sum(axis=0) * self._units.selected, np.float32)
