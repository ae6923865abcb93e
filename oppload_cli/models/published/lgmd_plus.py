"""LGMD+: local weights, a noise gate and an adaptive bias (Fu et al. 2020)."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import cv2
import numpy as np

from oppload_cli.models.detector import AlarmRule, Column, Response, inner
from oppload_cli.models.published.parts import (
    EDGE,
    Adaptation,
    ChangeDetector,
    DelayedSpread,
    grouped,
    k3,
    low_pass_share,
    low_passed,
    mean_change,
    positive,
    radial_gaussian,
    sigmoid,
    spikes,
    split,
    spread,
    total,
)
from oppload_cli.schema import Parameters, parameter

if TYPE_CHECKING:
    from oppload_cli.models.published.parts import Plane

# Constants of the best agent that the authors' genetic algorithm found.
_LEAST_BIAS, _FIELD_SPREAD = 0.6190473, 0.5307723
_GATE = 12.0  # grey levels
_LAST_FRAMES = 10  # number of frames over which the rate of spikes is counted


@dataclass(frozen=True, kw_only=True)
class LgmdPlusParams(Parameters):
    """Parameters of lgmd_plus."""

    on_gain: float = parameter(2.0, "weight of ON", low=0, high=100)
    off_gain: float = parameter(1.0, "weight of OFF", low=0, high=100)
    threshold: float = parameter(
        18.0, "G counts where half of it is at least this", unit="grey levels", above=0, high=1e6
    )
    spike: float = parameter(0.68, "least adapted potential of a spike", low=0, high=1)
    rate: float = parameter(56.0, "rate of spikes that makes a collision", unit="Hz", above=0)


@dataclass(frozen=True)
class LgmdPlusResponse(Response):
    """The response of lgmd_plus, with its inner values; `collision` stays once it is 1."""

    mp: float = inner(0.0, "grey levels", "membrane potential, the sum of the low-passed G")
    smp: float = inner(0.5, "0.5 to 1", "sigmoid of the membrane potential")
    sfa: float = inner(0.5, "0.5 to 1", "the sigmoid after spike-frequency adaptation")
    ffi: float = inner(0.0, "grey levels", "feed-forward inhibition: low-passed mean change")
    spike: int = inner(0, "", "spikes of the frame")
    spike_rate: float = inner(0.0, "Hz", "rate of spikes in the last 10 frames")
    bias: float = inner(_LEAST_BIAS, "", "weight of inhibition")
    tau_g: float = inner(10.0, "ms", "time constant of G")
    collision: int = 0


class LgmdPlus(ChangeDetector):
    """The LGMD+ of Fu et al. 2020, with the constants of their best evolved agent.

    P is smoothed, and each product of the smoothing is cut to an integer. So changes below 5 grey
    levels vanish, and much noise with them. Inhibition grows with the mean change and with the
    distance from the centre of the frame. G is low-passed; the time constant falls as the mean
    change grows.

    Source: Fu et al. 2020; ``docs/detectors.md``.
    """

    name = "lgmd_plus"
    label = "LGMD+"
    colour = "#D56D7F"
    meaning = "LGMD+: noise gate, local weights, bias that follows the mean change"
    unit = "grey levels"
    response_column = "grey levels", "membrane potential, divided by the number of pixels"
    columns = (
        Column("collision", "0 or 1", "1 once the rate of spikes reached 56 Hz; it stays 1"),
    )
    responses = LgmdPlusResponse
    parameters = LgmdPlusParams
    alarm: ClassVar = AlarmRule(2.1)
    year = 2020
    reference = "Fu, Wang, Peng and Yue, IEEE Access"
    answers_to = "strong moving edges, brightening ones twice as much, mostly away from the centre"
    made_for = "any size, 30 frames/s; tuned on videos of car crashes"
    cost_ms = 0.6

    params: LgmdPlusParams

    def _forget(self) -> None:
        gaussian = np.outer(*[cv2.getGaussianKernel(3, 1).ravel()] * 2)
        self._taps = [float(gaussian[1, 1]), float(gaussian[0, 1]), float(gaussian[0, 0])]
        self._on = self._off = self._g = self._zeros()
        self._spread = DelayedSpread((1, 1 / 4, 1 / 8), (10, 20, 30), self.ti)
        self._adaptation = Adaptation(783, self.ti)
        # The weight of inhibition: least in the middle of the frame, at most 1.
        local = np.maximum(1 - radial_gaussian(self.shape, _FIELD_SPREAD), 0.1)
        self._local = local.astype(np.float32)
        self._counts: deque[int] = deque([0] * _LAST_FRAMES, maxlen=_LAST_FRAMES)
        self._ffi, self._collision = 0.0, 0

    def at_rest(self) -> LgmdPlusResponse:
        """Return the response, 0, to a frame in which nothing changed."""
        return LgmdPlusResponse(0.0, collision=self._collision)

    def _respond(self, p: Plane) -> LgmdPlusResponse:
        self._ffi = low_passed(mean_change(p), self._ffi, self.ti, 10)
        rest = 1 - self._ffi / _GATE
        tau_g = 10 * (rest if rest >= 0 else 0.5)
        bias = max(self._ffi / _GATE, _LEAST_BIAS)
        v, _ = grouped(self._sums(p, bias), 4, 0.5, EDGE)
        v *= 0.5 * v >= self.params.threshold
        share = low_pass_share(self.ti, tau_g)
        self._g = np.asarray(cv2.addWeighted(v, share, self._g, 1 - share, 0))
        mp = total(self._g)
        smp = sigmoid(mp / (0.6 * self.pixels))
        sfa = self._adaptation.step(smp)
        spike = spikes(sfa, 10, self.params.spike)
        self._counts.append(spike)
        rate = 1000 * sum(self._counts) / (_LAST_FRAMES * self.ti)
        self._collision |= int(rate >= self.params.rate)
        values = mp, smp, sfa, self._ffi, spike, rate, bias, tau_g, self._collision
        return LgmdPlusResponse(mp / self.pixels, None, *values)

    def _sums(self, p: Plane, bias: float) -> Plane:
        on, off = split(self._smoothed(p), self._on, self._off)
        weights = self._local * bias
        so = positive(on - weights * self._spread(on, self._on))
        sf = positive(off - weights * self._spread(off, self._off))
        self._on, self._off = on, off
        gains = self.params.on_gain, self.params.off_gain
        return np.asarray(cv2.addWeighted(so, gains[0], sf, gains[1], 0))

    def _smoothed(self, p: Plane) -> Plane:
        """Return P convolved with a Gaussian, with every product cut to an integer."""
        centre, nearest, diagonal = (np.trunc(p * tap) for tap in self._taps)
        b: Plane = centre + spread(nearest, k3(0, 1, 0))
        b += spread(diagonal, k3(0, 0, 1))
        return b
