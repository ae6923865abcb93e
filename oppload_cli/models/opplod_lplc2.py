"""OppLoD tuned like LPLC2 neurons: units with four arms, and a calcium signal (``docs/lplc2.md``).

Each unit has an arm in each cardinal direction. Motion along an arm away from the unit's middle
excites the arm. Motion towards the middle, motion across the arm, and all motion in the field
suppress it.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, NamedTuple

import cv2
import numpy as np

from oppload_cli.errors import ParameterError
from oppload_cli.models.detector import AlarmRule, Column, Response, inner
from oppload_cli.models.dpc import (
    DpcParams,
    directional_inhibition,
    excitation,
    inhibition,
    rectified,
    referred,
)
from oppload_cli.models.timebase import ROUNDING
from oppload_cli.models.units import CellDetector, UnitParams, has_history
from oppload_cli.schema import parameter

if TYPE_CHECKING:
    from collections.abc import Sequence
    from typing import Any

    from oppload_cli.models.dpc import Kernels, Map
    from oppload_cli.models.layers import Dpc
    from oppload_cli.models.units import Maps

AXES = 0, 90  # of the DPC pathways, in degrees
DIRECTIONS = 0, 90, 180, 270  # of the arms, in degrees
_ARM_EDGE = 4.0  # degrees: the larger, the more gradually an arm's weight falls at its cone's edge
_HEIGHT = 240  # working height in px to which the DPC constants belong; they scale with the height


@dataclass(frozen=True, kw_only=True)
class OpplodLplc2Params(UnitParams):
    """Parameters of the units with arms, fitted to LPLC2 neurons (``docs/lplc2.md``).

    Fields are 60 degrees across on displays of 72 degrees.

    Examples
    --------
    >>> import oppload_cli as oppload
    >>> oppload.OpplodLplc2Params().replaced(inward=20).inward
    20.0
    """

    _field_share: ClassVar[float] = 5 / 6
    _cell_share: ClassVar[float] = 11 / 240

    pool_sigma: float = parameter(
        0.5, "sigma of the pooling over cells; 0: no pooling", unit="cells", low=0, high=10
    )
    arm_cone: float = parameter(
        87.0, "half-width of the cone where motion excites an arm", unit="deg", low=1, high=180
    )
    suppression_cone: float = parameter(
        35.5, "half-width of the cone where motion suppresses an arm", unit="deg", low=1, high=180
    )
    suppression_field: float = parameter(
        1.07, "reach of an arm's suppression, divided by that of its excitation", low=0.1, high=10
    )
    inward: float = parameter(
        35.0, "suppression of an arm by motion towards the middle", low=0, high=1000
    )
    lateral: float = parameter(11.5, "suppression of an arm by motion across it", low=0, high=1000)
    surround: float = parameter(
        0.45, "suppression of an arm by all motion in the field (normalisation)", low=0, high=1000
    )
    suppression_s: float = parameter(
        0.12, "time constant of suppression; 0: it acts at once", low=0, high=60
    )
    half_saturation: float = parameter(
        7e-4, "excitation at which an arm without suppression responds by half", low=1e-12, high=1e9
    )
    saturation: float = parameter(0.92, "exponent of an arm's saturation", low=0.05, high=20)
    threshold: float = parameter(
        0.65, "threshold of the sum of the arms, T_o; at or below it the response is 0",
        low=0, high=1e9,
    )  # fmt: skip
    arm_power: float = parameter(
        0.75, "exponent of that part of the arms' sum that is above the threshold", low=0.1, high=10
    )
    gain: float = parameter(1.0, "gain of the response, c2", low=0, high=1e9)
    calcium_s: float = parameter(
        1.0, "time constant of the calcium signal; 0: no calcium signal", low=0, high=60
    )

    def scaled(self, height: int) -> DpcParams:
        """Return the DPC constants in px scaled to a working height, from that of 240 px.

        Raises
        ------
        ParameterError
            If the scaled constants leave their allowed ranges.
        """
        scale = height / _HEIGHT
        ranges = {declared.name: declared for declared in self.declared()}
        least_scale = max(
            self.latency_lambda / (ranges["latency_lambda"].high or math.inf),
            (ranges["sigma_excitation"].low or 0) / self.sigma_excitation,
            (ranges["sigma_inhibition"].low or 0) / self.sigma_inhibition,
        )
        if scale < least_scale:
            raise ParameterError(
                f"opplod_lplc2 needs a working height of at least "
                f"{math.ceil(_HEIGHT * least_scale)} px, not {height}; raise the working height "
                "(--height)"
            )
        return self.dpc().replaced(
            sigma_excitation=self.sigma_excitation * scale,
            sigma_inhibition=self.sigma_inhibition * scale,
            kernel_radius=min(50, max(1, round(self.kernel_radius * scale))),
            latency_lambda=self.latency_lambda / scale,
        )


@dataclass(frozen=True)
class OpplodLplc2Response(Response):
    """The response of the units with arms to one frame.

    Attributes
    ----------
    response : float
        The response of the winning unit, at least 0.
    box : Box or None
        Receptive field of the winning unit in working pixels; None if the response is 0.
    opponency : float
        The sum R of the winning unit's arms, at least 0.
    calcium : float or None
        The largest calcium signal of all units, at least 0; None if ``calcium_s`` is 0.

    Examples
    --------
    >>> import oppload_cli as oppload
    >>> oppload.OpplodLplc2Response(0.5).calcium is None
    True
    """

    opponency: float = inner(0.0, "", "sum of the arms of the winning unit, R")
    calcium: float | None = None


# ---- The equations -------------------------------------------------------------------------


class _Motion(NamedTuple):
    """Motion at every pixel in units of S: its amount, and its components to the right and up.

    All are arrays of float32, shape (height, width); `right` and `up` may be negative.
    """

    amount: Map
    right: Map
    up: Map


def graded_motion(p: Sequence[Map], kernels: Kernels) -> _Motion:
    """Return the motion at every pixel; both axes together give its direction.

    A single S_phi only passes or blocks an edge. The differences ``I_(phi+180) - I_phi`` of both
    axes form a vector v, which points in the direction in which the edge moves. A pathway of
    exactly this direction would have the inhibition ``(I - |v|) / 2``, and therefore the
    presynaptic sum ``S = max(0, E - (I - |v|) / 2)``.

    Parameters
    ----------
    p : sequence of ndarray of float32, shape (height, width)
        P(t), P(t-1) and P(t-2).
    kernels : Kernels
        The kernels, with the masks of the axes 0 and 90 degrees.

    Source: ``docs/model.md``, section 4, and ``docs/lplc2.md``.
    """
    e, i = excitation(p, kernels), inhibition(p, kernels)
    right, up = (i - 2 * directional_inhibition(p, kernels, axis) for axis in (0, 90))
    length = np.hypot(right, up)
    amount = rectified(e, (i - length) / 2)
    share = amount / np.maximum(length, np.float32(1e-12))
    return _Motion(amount, share * right, share * up)


def arm_weights(reach: float, direction: float, cone: float) -> Map:
    """Return the weights with which an arm sums the cells around its unit.

    `reach` is the length of the arm in cells, above 0. `direction` (counter-clockwise, 0 = right)
    and `cone`, the half-width of the arm's cone, are in degrees. The weights, 0 to 1, are arranged
    by row and column of the offset; in the middle is 0.
    """
    n = math.ceil(reach)
    y, x = np.mgrid[n : -n - 1 : -1, -n : n + 1].astype(np.float64)
    distance = np.hypot(x, y)
    angle = np.degrees(np.angle(np.exp(1j * (np.arctan2(y, x) - math.radians(direction)))))
    within = 1 / (1 + np.exp((np.abs(angle) - cone) / _ARM_EDGE))
    weights = within * np.clip(reach - distance + 0.5, 0, 1) * (distance > 0)
    return np.asarray(weights, np.float32)


def field_weights(reach: float) -> Map:
    """Return the weights of all cells in a unit's field, arranged as those of `arm_weights`."""
    weights = arm_weights(reach, 0, 360)
    weights[len(weights) // 2, len(weights) // 2] = 1
    return weights


def arm_response(outward: Map, suppression: Map, half: float, exponent: float) -> Map:
    """Return ``o^g / (o^g + (s + q)^g)``: excitation, saturating and divided by suppression.

    Parameters
    ----------
    outward : ndarray of float32
        o, the excitation of an arm, at least 0.
    suppression : ndarray of float32
        q, at least 0.
    half : float
        s, the excitation at which an arm without suppression has the response 1/2, above 0.
    exponent : float
        g, above 0.
    """
    # The inverse may overflow to infinity, for which the response 1 / (1 + inf) is 0, as it ought.
    with np.errstate(divide="ignore", over="ignore"):
        inverse = (np.float32(half) + np.maximum(suppression, 0)) / np.maximum(outward, 0)
        return np.asarray(1 / (1 + inverse**exponent), np.float32)


def smoothing(elapsed: float, constant: float) -> float:
    """Return the weight of a new value in a first-order low-pass; 1 if the time constant is 0.

    `elapsed` and the time constant are in intervals.
    """
    return 1 - math.exp(-elapsed / constant) if constant else 1.0


# ---- The detector --------------------------------------------------------------------------


class OpplodLplc2(CellDetector):
    """OppLoD with units like LPLC2 neurons; arguments as `Detector`.

    Source: ``docs/lplc2.md``; ``docs/model.md``, sections 1, 2 and 4.

    Examples
    --------
    >>> import numpy as np, oppload_cli as oppload
    >>> model = oppload.OpplodLplc2((240, 320))
    >>> model.units.field
    200.0
    """

    name = "opplod_lplc2"
    label = "OppLoD LPLC2"
    colour = "#0099B8"
    evaluated = False  # if no version of OppLoD is chosen, two are evaluated
    year = 2026
    reference = "oppload 2026, fitted to Klapoetke et al., Nature 2017"
    answers_to = "outward motion from a centre, as LPLC2 neurons of the fruit fly do"
    made_for = "240 px high, 30 frames/s; other rates by its presentation times"
    cost_ms = 8.4
    meaning = "for neuroscience: tuned like LPLC2 neurons, with a calcium signal"
    response_column = "", "response of the winning unit; empty during warm-up"
    responses = OpplodLplc2Response
    parameters = OpplodLplc2Params
    alarm: ClassVar = AlarmRule(
        None, why_none="it responds like a neuron, and nobody has measured which response warns of "
        "a contact"
    )  # fmt: skip
    least_object: ClassVar = 1e-3, 0.01
    columns: ClassVar = (
        Column(
            "calcium",
            "",
            "response as a calcium indicator shows it: the largest low-passed response of a unit",
        ),
    )

    params: OpplodLplc2Params

    def __init__(
        self, shape: tuple[int, int], params: OpplodLplc2Params | None = None, **others: Any
    ) -> None:
        super().__init__(shape, params, **others)
        own = self.params
        self._dpc = self.layers.dpc(own.scaled(min(self.shape)), AXES)
        reach = own.field_px / 2 / own.cell_px
        cone, further = own.suppression_cone, reach * own.suppression_field
        self._excitation = [arm_weights(reach, phi, own.arm_cone) for phi in DIRECTIONS]
        self._suppression = [arm_weights(further, phi, cone) for phi in DIRECTIONS]
        self._field = field_weights(reach)
        self._forget()

    def _forget(self) -> None:
        self._calcium = np.zeros_like(self.units.responses)
        zeros = np.zeros((len(DIRECTIONS), *self._calcium.shape), np.float32)
        self._now = 0.0  # intervals
        # Times and suppressions of the youngest frame that is an interval old, and of later frames.
        self._suppressions: deque[tuple[float, Maps]] = deque([(0.0, zeros)])

    def reset(self) -> None:
        """Forget all frames: the next frame is frame 0."""
        super().reset()
        self._forget()

    @property
    def calcium(self) -> float | None:
        """The largest calcium signal of all units; None if `calcium_s` is 0."""
        return float(self._calcium.max()) if self.params.calcium_s else None

    def at_rest(self) -> OpplodLplc2Response:
        """Return the response, 0, to a frame in which nothing changed.

        The calcium signal keeps its latest value, so that it does not change during a few repeats.
        In a scene at rest it falls, because then the detector gets every frame.
        """
        return OpplodLplc2Response(0.0, calcium=self.calcium)

    def step(self, luma: Map) -> OpplodLplc2Response | None:
        """Take the next frame.

        The response is that of the unit with the largest R, the sum of its arms' responses:
        ``c2 (R - T_o)^p`` with `arm_power` p if R is above T_o, else 0. The result is None until
        frames have been compared over three intervals.
        """
        if not self._dpc.step(luma):
            return None
        params, dpc = self.params, self._dpc.layer
        elapsed = dpc.photoreceptors.elapsed
        amount, motion = self.pooled(dpc)
        self._now += elapsed
        total = self._sum_of_arms(_weighted(amount, self._field), motion) * self._units.selected
        above = np.maximum(total - np.float32(params.threshold), 0)
        responses = np.asarray(params.gain * above**params.arm_power, np.float32)
        self._units.respond(responses)
        if params.calcium_s:
            new = smoothing(elapsed, params.calcium_s * self.layers.clock.per_second)
            self._calcium += np.float32(new) * (responses - self._calcium)
        row, column = divmod(int(total.argmax()), total.shape[1])
        response = float(responses[row, column])
        box = self.units.box(row, column) if response else None
        return OpplodLplc2Response(response, box, float(total[row, column]), self.calcium)

    def _sum_of_arms(self, in_field: Map, motion: list[Map]) -> Map:
        """Return R, the sum of the arms' responses, of all units.

        `in_field` is the sum of all motion in a unit's field, `motion` that in each direction.
        """
        params = self.params
        # Each suppression follows from its value an interval ago, not from its latest value.
        latest = self._now - (1 - ROUNDING)
        while len(self._suppressions) > 1 and self._suppressions[1][0] <= latest:
            self._suppressions.popleft()
        then, before = self._suppressions[0]
        weight = smoothing(
            max(1.0, self._now - then), params.suppression_s * self.layers.clock.per_second
        )
        suppressions = before.copy()
        self._suppressions.append((self._now, suppressions))
        total = np.zeros_like(in_field)
        for arm, suppression in enumerate(suppressions):
            across = motion[(arm + 1) % 4] + motion[(arm + 3) % 4]
            suppressing = params.inward * motion[(arm + 2) % 4] + params.lateral * across
            target = _weighted(suppressing, self._suppression[arm]) + params.surround * in_field
            suppression[:] += np.float32(weight) * (target - suppression)
            outward = _weighted(motion[arm], self._excitation[arm])
            total += arm_response(outward, suppression, params.half_saturation, params.saturation)
        return total

    def pooled(self, dpc: Dpc) -> tuple[Map, list[Map]]:
        """Return the pooled motion: its amount, and its parts in `DIRECTIONS`.

        All are arrays of float32, shape (rows, columns), at least 0, divided by the sum of W_E.
        `dpc` has the axes 0 and 90 degrees.
        """
        photoreceptors = dpc.photoreceptors
        amount, right, up = graded_motion(photoreceptors.maps, dpc.kernels)
        parts = [amount, *(np.maximum(part, 0) for part in (right, up, -right, -up))]
        pooled = self._units.pool(parts)
        amount, sum_of_w_e = pooled[0], dpc.kernels.excitation.sum()
        # Where inhibition is so strong that W_E is 0, so are E and all motion.
        factor = np.full_like(amount, 1 / max(sum_of_w_e, 1e-12))
        if photoreceptors.share != 1:
            p = self._units.pool(photoreceptors.maps[:1])[0]
            scaled = referred(
                amount, p * np.float32(sum_of_w_e), photoreceptors.share, directional=True
            )
            factor *= scaled / np.maximum(amount, np.float32(1e-12))
        if self.params.history:
            factor *= has_history(photoreceptors.coarse(amount.shape), self.params.history)
        return amount * factor, [part * factor for part in pooled[1:]]


def _weighted(values: Map, weights: Map) -> Map:
    """Return the weighted sum of the values around each cell."""
    summed = cv2.filter2D(values, cv2.CV_32F, weights, borderType=cv2.BORDER_CONSTANT)
    return np.asarray(summed, np.float32)
