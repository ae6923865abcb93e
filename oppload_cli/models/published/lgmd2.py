"""LGMD2: ON and OFF pathways that are biased towards darkening (Fu et al. 2019)."""

from __future__ import annotations

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
    low_passed,
    mean_change,
    positive,
    sigmoid,
    spikes,
    split,
    total,
)
from oppload_cli.schema import Parameters, parameter

if TYPE_CHECKING:
    from oppload_cli.models.published.parts import Plane


@dataclass(frozen=True, kw_only=True)
class Lgmd2Params(Parameters):
    """Parameters of lgmd2."""

    on_bias: float = parameter(1.0, "least weight of inhibition in ON, w_on", low=0, high=100)
    off_bias: float = parameter(0.5, "least weight of inhibition in OFF, w_off", low=0, high=100)
    mediation: float = parameter(
        8.0,
        "weights of inhibition are mean change / T_pm, but at least w_on and w_off",
        unit="grey levels",
        above=0,
        high=255,
    )
    decay: float = parameter(
        0.5, "factor C_de: G counts where C_de G is at least the threshold", above=0, high=1
    )
    threshold: float = parameter(
        15.0, "threshold of C_de G, T_de", unit="grey levels", above=0, high=1e6
    )
    spike: float = parameter(0.78, "least adapted potential of a spike, T_sp", low=0, high=1)
    enough: int = parameter(8, "spikes in consecutive frames that make a collision", low=1)


@dataclass(frozen=True)
class Lgmd2Response(Response):
    """The response of lgmd2, with its inner values."""

    mp: float = inner(0.0, "grey levels", "membrane potential, the sum of G")
    smp: float = inner(0.5, "0.5 to 1", "sigmoid of the membrane potential")
    sfa: float = inner(0.5, "0.5 to 1", "the sigmoid after spike-frequency adaptation")
    pm: float = inner(0.0, "grey levels", "photoreceptor mediation: low-passed mean change")
    w_on: float = inner(1.0, "", "weight of inhibition in ON")
    w_off: float = inner(0.5, "", "weight of inhibition in OFF")
    spike: int = inner(0, "", "spikes of the frame")
    nsp: int = inner(0, "", "number of spikes in consecutive frames")
    collision: int = 0


class Lgmd2(ChangeDetector):
    """The LGMD2 of Fu et al. 2019, as in their open source.

    ``So = max(ON - w_on ST_on(ON), 0)`` and ``Sf = max(OFF - w_off ST_off(OFF), 0)`` give
    ``S = So + Sf + So Sf``, which is grouped. The inhibition of ON is strong and fast, so that
    brightening edges are suppressed. If a bright object approaches, or a dark object recedes, the
    potential stays at 0.5.

    Source: Fu et al. 2019; ``docs/detectors.md``.
    """

    name = "lgmd2"
    label = "LGMD2"
    colour = "#098D45"
    meaning = "LGMD2: ON and OFF pathways biased towards darkening, grouping, adaptation"
    unit = "grey levels"
    response_column = "grey levels", "membrane potential, divided by the number of pixels"
    columns = (Column("collision", "0 or 1", "1 while at least 8 spikes came without a pause"),)
    responses = Lgmd2Response
    parameters = Lgmd2Params
    alarm: ClassVar = AlarmRule(1.7)
    year = 2019
    reference = "Fu, Hu, Peng, Rind and Yue, IEEE Trans. Cybernetics"
    answers_to = "edges that darken: dark objects that approach, not bright ones"
    made_for = "99 x 72 to 432 x 240 px, 30 frames/s"
    cost_ms = 0.4

    params: Lgmd2Params

    def _forget(self) -> None:
        self._on = self._off = self._zeros()
        self._spread_on = DelayedSpread((2, 1 / 2, 1 / 4), (15, 30, 45), self.ti)
        self._spread_off = DelayedSpread((1, 1 / 4, 1 / 8), (60, 120, 180), self.ti)
        self._adaptation = Adaptation(800, self.ti)
        self._pm, self._nsp = 0.0, 0

    def _respond(self, p: Plane) -> Lgmd2Response:
        params = self.params
        self._pm = low_passed(mean_change(p), self._pm, self.ti, 90)
        mediated = self._pm / params.mediation
        w_on, w_off = max(mediated, params.on_bias), max(mediated, params.off_bias)
        g, _ = grouped(self._sums(p, w_on, w_off), 4, 0.01, EDGE)
        mp = total(g[params.decay * g >= params.threshold])
        smp = sigmoid(mp / self.pixels)
        sfa = self._adaptation.step(smp)
        spike = spikes(sfa, 4, params.spike)
        self._nsp = self._nsp + spike if spike else 0
        collision = int(self._nsp >= params.enough)
        values = mp, smp, sfa, self._pm, w_on, w_off, spike, self._nsp, collision
        return Lgmd2Response(mp / self.pixels, None, *values)

    def _sums(self, p: Plane, w_on: float, w_off: float) -> Plane:
        on, off = split(p, self._on, self._off)
        so = positive(np.asarray(cv2.scaleAdd(self._spread_on(on, self._on), -w_on, on)))
        sf = positive(np.asarray(cv2.scaleAdd(self._spread_off(off, self._off), -w_off, off)))
        self._on, self._off = on, off
        s: Plane = so * sf
        s += so
        s += sf
        return s
