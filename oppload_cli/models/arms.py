"""The judgement of preset ``lplc2``: the four arms of an LPLC2 neuron (``docs/lplc2.md``).

It replaces the opponent products of :mod:`oppload_cli.models.opposing_motion`. Each unit has an
arm in each cardinal direction. Motion along an arm away from the unit's middle excites the arm.
Motion towards the middle, motion across the arm, and all motion in the field suppress it.
"""

from __future__ import annotations

import math
from collections import deque
from typing import TYPE_CHECKING, NamedTuple

import cv2
import numpy as np

from oppload_cli.models.dpc import (
    directional_inhibition,
    excitation,
    inhibition,
    rectified,
    referred,
)
from oppload_cli.models.opplod_parameters import OpplodResponse
from oppload_cli.models.opposing_motion import CellJudgement, has_history, pool
from oppload_cli.models.timebase import ROUNDING

if TYPE_CHECKING:
    from collections.abc import Sequence

    from oppload_cli.models.dpc import Kernels, Map
    from oppload_cli.models.layers import Dpc
    from oppload_cli.models.opplod_parameters import OpplodParams
    from oppload_cli.models.opposing_motion import Maps

DIRECTIONS = 0, 90, 180, 270  # of the arms, in degrees
_ARM_EDGE = 4.0  # degrees: the larger, the more gradually an arm's weight falls at its cone's edge


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


# ---- The judgement over one video ----------------------------------------------------------


class ArmsJudgement(CellJudgement):
    """The judgement with four arms at every cell, and the calcium signal.

    The responses of a unit's arms are summed, and the part of the sum above a threshold is
    enhanced. The `pathways` in `maps` hold the motion in the four directions.
    """

    def __init__(
        self, shape: tuple[int, int], params: OpplodParams, per_second: float = 30.0
    ) -> None:
        super().__init__(shape, params, per_second)
        reach = self.maps.field / 2 / params.cell_px
        cone, further = params.suppression_cone, reach * params.suppression_field
        self._excitation = [arm_weights(reach, phi, params.arm_cone) for phi in DIRECTIONS]
        self._suppression = [arm_weights(further, phi, cone) for phi in DIRECTIONS]
        self._field = field_weights(reach)

    def reset(self) -> None:
        """Forget all frames."""
        super().reset()
        self._calcium = np.zeros_like(self.maps.responses)
        zeros = np.zeros((len(DIRECTIONS), *self._calcium.shape), np.float32)
        self._now = 0.0  # intervals
        # Times and suppressions of the youngest frame that is an interval old, and of later frames.
        self._suppressions: deque[tuple[float, Maps]] = deque([(0.0, zeros)])

    @property
    def calcium(self) -> float | None:
        """The largest calcium signal of all units; None if `calcium_s` is 0."""
        return float(self._calcium.max()) if self._params.calcium_s else None

    def judge(self, dpc: Dpc) -> OpplodResponse:
        """Judge the motion of one frame.

        The response is that of the unit with the largest R, the sum of its arms' responses:
        ``c2 (R - T_o)^p`` with `arm_power` p if R is above T_o, else 0.
        """
        params, elapsed = self._params, dpc.photoreceptors.elapsed
        amount, motion = self.pooled(dpc)
        self._now += elapsed
        total = self._sum_of_arms(_weighted(amount, self._field), motion) * self._selected
        above = np.maximum(total - np.float32(params.threshold), 0)
        responses = np.asarray(params.gain * above**params.arm_power, np.float32)
        pathways = dict(zip(DIRECTIONS, motion, strict=True))
        self.maps = self.maps._replace(responses=responses, pathways=pathways)
        if params.calcium_s:
            new = smoothing(elapsed, params.calcium_s * self._per_second)
            self._calcium += np.float32(new) * (responses - self._calcium)
        row, column = divmod(int(total.argmax()), total.shape[1])
        response = float(responses[row, column])
        box = self.maps.box(row, column) if response else None
        return OpplodResponse(response, box, float(total[row, column]), calcium=self.calcium)

    def _sum_of_arms(self, in_field: Map, motion: list[Map]) -> Map:
        """Return R, the sum of the arms' responses, of all units.

        `in_field` is the sum of all motion in a unit's field, `motion` that in each direction.
        """
        params = self._params
        # Each suppression follows from its value an interval ago, not from its latest value.
        latest = self._now - (1 - ROUNDING)
        while len(self._suppressions) > 1 and self._suppressions[1][0] <= latest:
            self._suppressions.popleft()
        then, before = self._suppressions[0]
        weight = smoothing(max(1.0, self._now - then), params.suppression_s * self._per_second)
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
        if self._params.graded:
            amount, right, up = graded_motion(photoreceptors.maps, dpc.kernels)
            parts = [amount, *(np.maximum(part, 0) for part in (right, up, -right, -up))]
        else:
            directed = [dpc.sums.pathways[phi] for phi in DIRECTIONS]
            parts = [np.maximum.reduce(directed), *directed]
        pooled = pool(parts, self._down, self._across)
        amount, sum_of_w_e = pooled[0], dpc.kernels.excitation.sum()
        # Where inhibition is so strong that W_E is 0, so are E and all motion.
        factor = np.full_like(amount, 1 / max(sum_of_w_e, 1e-12))
        if photoreceptors.share != 1:
            p = pool(photoreceptors.maps[:1], self._down, self._across)[0]
            scaled = referred(
                amount, p * np.float32(sum_of_w_e), photoreceptors.share, directional=True
            )
            factor *= scaled / np.maximum(amount, np.float32(1e-12))
        if self._params.history:
            factor *= has_history(photoreceptors.coarse(amount.shape), self._params.history)
        return amount * factor, [part * factor for part in pooled[1:]]


def _weighted(values: Map, weights: Map) -> Map:
    """Return the weighted sum of the values around each cell."""
    summed = cv2.filter2D(values, cv2.CV_32F, weights, borderType=cv2.BORDER_CONSTANT)
    return np.asarray(summed, np.float32)
