"""LGMD1 with persistence and grouping (Yue and Rind 2006), and pLGMD, its random version (2023).

The label of `lgmd1_group` is "LGMD1".
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import cv2
import numpy as np

from oppload_cli.models.detector import AlarmRule, Response, inner
from oppload_cli.models.published.parts import (
    ZERO,
    ChangeDetector,
    grouped,
    k3,
    sigmoid,
    spread,
)
from oppload_cli.schema import Parameters, parameter

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from oppload_cli.models.published.parts import Plane

    Mask = NDArray[np.bool_]

# p1 and p2. With the values of "literal" Q is an integral; with the published ones, 1 / (1 + e^i),
# Q decays.
_PERSISTENCE = {"literal": (0.5, 0.5), "paper": (1 / (1 + np.e), 1 / (1 + np.e**2))}
_MEANING = (
    "weights of earlier Q: 'literal', as coded, keeps Q for ever; 'paper', 1 / (1 + e^i): Q decays"
)

_TAPS = [(y, x) for y in (0, 1, 2) for x in (0, 1, 2) if (y, x) != (1, 1)]
_LEAST_SCALE = 0.01  # grey levels: w where nothing moves
_INHIBITION, _DECAY, _THRESHOLD = 0.3, 0.15, 15.0  # of pLGMD
_RESOLUTION = 1 << 16  # probabilities are multiples of 1 / 2^16


@dataclass(frozen=True, kw_only=True)
class Lgmd1GroupParams(Parameters):
    """Parameters of lgmd1_group."""

    persistence: str = parameter("literal", _MEANING, choices=tuple(_PERSISTENCE))
    inhibition: float = parameter(0.3, "weight of inhibition", low=0, high=100)
    grouping: float = parameter(
        4.0, "divisor C_w: the scale of grouping is the largest Ce / C_w", above=0, high=1000
    )
    decay: float = parameter(
        0.15, "factor C_de: G counts where C_de G is at least the threshold", above=0, high=1
    )
    threshold: float = parameter(
        15.0, "threshold of C_de G, T_de", unit="grey levels", above=0, high=1e6
    )
    layer_threshold: float = parameter(
        0.0, "absolute values below this are 0 in each layer", unit="grey levels", low=0, high=255
    )


@dataclass(frozen=True, kw_only=True)
class Lgmd1GroupPaperParams(Lgmd1GroupParams):
    """Parameters of lgmd1_group_paper."""

    persistence: str = parameter("paper", _MEANING, choices=tuple(_PERSISTENCE))


@dataclass(frozen=True)
class Lgmd1GroupResponse(Response):
    """The response of lgmd1_group, with its inner values."""

    k: float = inner(
        0.5, "0 to 1", "sigmoid of the sum of G, divided by the number of pixels; 0 for frames 0, 1"
    )
    sum_abs_g: float = inner(0.0, "grey levels", "K, the sum of G")
    omega: float = inner(_LEAST_SCALE, "grey levels", "w, the scale of grouping; 0 for frames 0, 1")
    sum_abs_s: float = inner(0.0, "grey levels", "sum of the absolute S")
    sum_abs_p: float = inner(0.0, "grey levels", "sum of the absolute Q")


class _Persistent(ChangeDetector):
    """A detector that works on ``Q(t) = P(t) + p1 Q(t-1) + p2 Q(t-2)``.

    The change from frame 0 to frame 1 is left out. A subclass defines `_respond_to`.
    """

    warm_up = 0
    precision = np.float64

    def _forget(self) -> None:
        self._q = [self._zeros()] * 2  # Q(t-1), Q(t-2)
        self._t = 0
        self._persistence = _PERSISTENCE["literal"]  # p1, p2

    def _respond(self, p: Plane) -> Response | None:
        self._t += 1
        if self._t == 1:
            return self._first_response()
        before, earlier = self._q
        p1, p2 = self._persistence
        q = p + np.asarray(cv2.addWeighted(before, p1, earlier, p2, 0))
        self._q = [q, before]
        return self._respond_to(q, before)

    @abstractmethod
    def _respond_to(self, q: Plane, before: Plane) -> Response:
        """Respond to Q(t) and Q(t-1)."""


class Lgmd1Group(_Persistent):
    """The LGMD1 with persistence and grouping.

    ``S = Q(t) - 0.3 K3(0, 1/4, 1/8) * Q(t-1)``, and ``G = S Ce / w`` where ``0.15 G >= 15``. Signs
    do not count: dark and bright objects give the same response. In the authors' code p1 = p2 =
    0.5. Q is then an integral, in which an edge that has passed stays for ever. The code has no
    rule for spikes; in Fu's papers k must be at least 0.78 or 0.8 for 4 to 5 frames.

    Source: fuqinbing's LGMD.m, after Yue and Rind 2006; ``docs/detectors.md``.
    """

    name = "lgmd1_group"
    label = "LGMD1"
    colour = "#332288"
    meaning = "LGMD1 with persistence and grouping"
    unit = "grey levels"
    response_column = "grey levels", "K, the sum of G, divided by the number of pixels"
    responses = Lgmd1GroupResponse
    parameters = Lgmd1GroupParams
    alarm: ClassVar = AlarmRule(200.0)
    year = 2006
    reference = "Yue and Rind, with grouping, as coded by Fu for pLGMD"
    answers_to = "moving edges, dark or bright, in clusters, and places that edges have passed"
    made_for = "any size, 30 frames/s"
    cost_ms = 0.4

    params: Lgmd1GroupParams

    def _forget(self) -> None:
        super()._forget()
        self._persistence = _PERSISTENCE[self.params.persistence]

    def _first_response(self) -> Lgmd1GroupResponse:
        return Lgmd1GroupResponse(0.0, k=0.0, omega=0.0)

    def _respond_to(self, q: Plane, before: Plane) -> Lgmd1GroupResponse:
        i = self._thresholded(spread(self._thresholded(before), k3(0, 1 / 4, 1 / 8), ZERO))
        s = self._thresholded(q) - self.params.inhibition * i
        g, w = grouped(s, self.params.grouping, _LEAST_SCALE, ZERO)
        # 0.15 G is compared, not G with 15 / 0.15: the rounding of 0.15 G decides ties.
        k = float(g[self.params.decay * g >= self.params.threshold].sum())
        norms = [float(cv2.norm(layer, cv2.NORM_L1)) for layer in (s, q)]
        mean = k / self.pixels
        return Lgmd1GroupResponse(mean, None, sigmoid(mean), k, w, *norms)

    def _thresholded(self, values: Plane) -> Plane:
        least = self.params.layer_threshold
        return values * (np.abs(values) >= least) if least else values


class Lgmd1GroupPaper(Lgmd1Group):
    """The LGMD1 with grouping and the persistence of the papers, ``p_i = 1 / (1 + e^i)``."""

    name = "lgmd1_group_paper"
    label = "LGMD1 (paper)"
    colour = "#6652C4"
    meaning = "LGMD1 with grouping and a persistence that forgets"
    parameters = Lgmd1GroupPaperParams
    answers_to = "moving edges, dark or bright, in clusters"
    alarm: ClassVar = AlarmRule(110.0)


# ---- pLGMD ---------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class PlgmdParams(Parameters):
    """Parameters of plgmd."""

    p: float = parameter(0.55, "probability that a synapse transmits", low=0, high=1)
    seed: int = parameter(1, "seed of the random numbers", low=0, high=2**31 - 1)
    runs: int = parameter(
        1,
        "number of runs, each with other random numbers; the response is the mean of the runs",
        low=1,
        high=100,
    )


@dataclass(frozen=True)
class PlgmdResponse(Response):
    """The response of plgmd, with its inner values."""

    k: float = inner(
        0.5, "0 to 1", "sigmoid of the sum of G per pixel, first run; 0 for frames 0, 1"
    )
    sum_abs_g: float = inner(0.0, "grey levels", "sum of G of the first run")
    k_mean: float = inner(0.5, "0 to 1", "mean of k over the runs")
    k_sd: float = inner(0.0, "0 to 1", "standard deviation of k over the runs")
    sumg_mean: float = inner(0.0, "grey levels", "mean of the sum of G over the runs")
    sumg_sd: float = inner(0.0, "grey levels", "standard deviation of the sum of G over the runs")


class Plgmd(_Persistent):
    """The LGMD1 with grouping in which each synapse transmits with probability p in each frame.

    Independent random masks multiply Q, each of the 8 taps of the inhibition, then E and I, and
    last G; nothing is divided by p. The masks of Q and E are computed as one mask of probability
    p^2. With p = 1 the detector equals `lgmd1_group`. Below 1 it computes in single precision. The
    authors find p = 0.55 best and show means of 20 runs.

    Source: fuqinbing's pLGMD.m, 2023; ``docs/detectors.md``.
    """

    name = "plgmd"
    label = "pLGMD"
    colour = "#00B08E"
    meaning = "LGMD1 with grouping and random synapses"
    unit = "grey levels"
    response_column = "grey levels", "mean sum of G, divided by the number of pixels"
    responses = PlgmdResponse
    parameters = PlgmdParams
    alarm: ClassVar = AlarmRule(20.0)
    year = 2023
    reference = "Fu, pLGMD"
    answers_to = "moving edges in clusters, and places that edges have passed; hardly weak motion"
    made_for = "any size, 30 frames/s"
    cost_ms = 1.5

    params: PlgmdParams

    def _forget(self) -> None:
        super()._forget()
        self._random = np.random.SFC64(self.params.seed)

    def _first_response(self) -> PlgmdResponse:
        return PlgmdResponse(0.0, k=0.0, k_mean=0.0)

    def _respond_to(self, q: Plane, before: Plane) -> PlgmdResponse:
        sums = np.array([self._sum_of_g(q, before) for _ in range(self.params.runs)])
        potentials = np.array([sigmoid(total / self.pixels) for total in sums])
        spreads = [float(values.std(ddof=min(1, len(values) - 1))) for values in (potentials, sums)]
        k, total = float(potentials.mean()), float(sums.mean())
        first = float(potentials[0]), float(sums[0])
        return PlgmdResponse(total / self.pixels, None, *first, k, spreads[0], total, spreads[1])

    def _sum_of_g(self, q: Plane, before: Plane) -> float:
        if self.params.p == 1:
            s = q - _INHIBITION * spread(before, k3(0, 1 / 4, 1 / 8), ZERO)
            g, _ = grouped(s, 4, _LEAST_SCALE, ZERO)
            return float(g[_DECAY * g >= _THRESHOLD].sum())
        masks = self._masks()
        s = np.asarray(q, np.float32) * masks[0]
        inhibition = self._inhibition(before, masks[3:])
        cv2.scaleAdd(inhibition, -_INHIBITION, s, dst=inhibition)
        np.copyto(s, inhibition, where=masks[1])
        g, _ = grouped(s, 4, _LEAST_SCALE, ZERO)
        return float(g[(_DECAY * g >= _THRESHOLD) & masks[2]].sum(dtype=np.float64))

    def _inhibition(self, before: Plane, masks: Mask) -> Plane:
        """Return the sum of the 8 taps on Q(t-1), each with a mask of its own."""
        height, width = self.shape
        nearest = np.pad(np.asarray(before, np.float32) / 4, 1)
        diagonal = nearest / 2
        out = np.zeros(self.shape, np.float32)
        for (y, x), mask in zip(_TAPS, masks.view(np.uint8), strict=True):
            padded = nearest if 1 in {y, x} else diagonal
            tap = padded[y : y + height, x : x + width]
            cv2.add(out, tap, dst=out, mask=mask)
        return out

    def _masks(self) -> Mask:
        """Return 11 independent masks: one for Q and E, one for I, one for G, one for each tap.

        A pixel is set with probability p^2 in the first mask, and with p in the others.
        """
        p, count = self.params.p, 3 + len(_TAPS)
        words = -(-2 * count * self.pixels // 8)
        numbers = self._random.random_raw(words).view(np.uint16)[: count * self.pixels]
        parts = numbers.reshape(count, *self.shape)
        limits = np.array([p**2, *[p] * (count - 1)]) * _RESOLUTION
        highest = np.minimum(np.rint(limits), _RESOLUTION - 1).astype(np.uint16)
        return np.asarray(parts < highest[:, None, None])
