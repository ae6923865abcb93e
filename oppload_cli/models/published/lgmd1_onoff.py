"""LGMD1 with ON and OFF pathways and spike-frequency adaptation (Fu et al. 2018)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from oppload_cli.models.detector import AlarmRule, Column, Response, inner
from oppload_cli.models.published.parts import (
    Adaptation,
    ChangeDetector,
    DelayedSpread,
    at_least,
    averaged,
    low_passed,
    mean_change,
    sigmoid,
    spikes,
    split,
    total,
)
from oppload_cli.schema import Parameters, parameter

if TYPE_CHECKING:
    from oppload_cli.models.published.parts import Plane

_TAUS = 30.0, 60.0, 90.0  # ms: of nearest neighbours, diagonals, feed-forward inhibition


@dataclass(frozen=True, kw_only=True)
class Lgmd1OnoffParams(Parameters):
    """Parameters of lgmd1_onoff."""

    on_inhibition: float = parameter(0.5, "weight of spread ON: it inhibits ON", low=0, high=100)
    off_inhibition: float = parameter(1.0, "weight of direct OFF: it inhibits OFF", low=0, high=100)
    threshold: float = parameter(
        30.0, "S below this threshold counts as 0, T_s", unit="grey levels", above=0, high=1e6
    )
    gate: float = parameter(
        10.0,
        "the response is 0 while the low-passed mean change is at least this, T_ffi",
        unit="grey levels",
        low=0,
    )
    spike: float = parameter(0.78, "least adapted potential of a spike, T_sp", low=0, high=1)
    enough: int = parameter(5, "spikes in consecutive frames that make a collision", low=1)


@dataclass(frozen=True)
class Lgmd1OnoffResponse(Response):
    """The response of lgmd1_onoff, with its inner values; `collision` stays once it is 1."""

    mp: float = inner(0.0, "grey levels", "membrane potential")
    smp: float = inner(0.5, "0.5 to 1", "sigmoid of the membrane potential")
    sfa: float = inner(0.5, "0.5 to 1", "the sigmoid after spike-frequency adaptation")
    ffi: float = inner(0.0, "grey levels", "feed-forward inhibition: low-passed mean change")
    spike: int = inner(0, "", "spikes of the frame")
    nsp: int = inner(0, "", "number of spikes in consecutive frames")
    collision: int = 0


class Lgmd1Onoff(ChangeDetector):
    """The LGMD1 with two pathways of Fu et al. 2018, in the default build of their open source.

    ``S = (ON - 0.5 ST(ON)) + (ST(OFF) - 1.0 OFF)``, and 0 where this sum is below 30. ST spreads a
    signal with a delay. In the OFF pathway the direct signal inhibits and the spread signal
    excites. The membrane potential is the sum of ``A3 * S``; its sigmoid adapts and gives spikes.

    ON and OFF are kept in two slots, one for even and one for odd frames. If the feed-forward
    inhibition silences a frame, the frame's slot keeps its former content. A later frame then uses
    values that are two or more frames older than those of the frame before.

    Source: Fu et al. 2018; ``docs/detectors.md``.
    """

    name = "lgmd1_onoff"
    label = "LGMD1 (ON, OFF)"
    colour = "#A13AAE"
    meaning = "LGMD1, ON and OFF pathways with spike-frequency adaptation"
    unit = "grey levels"
    response_column = "grey levels", "membrane potential, divided by the number of pixels"
    columns = (
        Column("collision", "0 or 1", "1 once five spikes came without a pause; it stays 1"),
    )
    responses = Lgmd1OnoffResponse
    parameters = Lgmd1OnoffParams
    alarm: ClassVar = AlarmRule(5.7)
    year = 2018
    reference = "Fu, Hu, Peng and Yue, Neural Networks"
    answers_to = "edges that brighten, and the surroundings of edges that darken"
    made_for = "99 x 72 to 432 x 240 px, 30 frames/s"
    cost_ms = 0.3

    params: Lgmd1OnoffParams

    def _forget(self) -> None:
        self._slots = [(self._zeros(), self._zeros()) for _ in range(2)]
        self._spread = DelayedSpread((0, 1 / 4, 1 / 8), (0, *_TAUS[:2]), self.ti)
        self._adaptation = Adaptation(800, self.ti)
        self._ffi, self._t = 0.0, 0
        self._nsp = self._collision = 0

    def at_rest(self) -> Lgmd1OnoffResponse:
        """Return the response, 0, to a frame in which nothing changed."""
        return Lgmd1OnoffResponse(0.0, collision=self._collision)

    def _respond(self, p: Plane) -> Lgmd1OnoffResponse:
        self._t += 1
        self._ffi = low_passed(mean_change(p), self._ffi, self.ti, _TAUS[2])
        if self._ffi >= self.params.gate:
            mp, smp, sfa = 0.0, 0.5, 0.5
            self._adaptation.potential = self._adaptation.adapted = 0.5
        else:
            mp = self._potential(p)
            smp = sigmoid(mp / self.pixels)
            sfa = self._adaptation.step(smp)
        spike = spikes(sfa, 4, self.params.spike)
        self._nsp = self._nsp + spike if spike else 0
        self._collision |= int(self._nsp >= self.params.enough)
        return Lgmd1OnoffResponse(
            mp / self.pixels, None, mp, smp, sfa, self._ffi, spike, self._nsp, self._collision
        )

    def _potential(self, p: Plane) -> float:
        on_before, off_before = self._slots[(self._t - 1) % 2]
        on, off = self._slots[self._t % 2] = split(p, on_before, off_before)
        s = on - self.params.on_inhibition * self._spread(on, on_before)
        s += self._spread(off, off_before)
        s -= self.params.off_inhibition * off
        return total(averaged(at_least(s, self.params.threshold)))
