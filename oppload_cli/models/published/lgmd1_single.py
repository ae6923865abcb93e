"""LGMD1 after Yue and Rind 2006, with one pathway and without a grouping layer."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from oppload_cli.models.detector import AlarmRule, Column, Response, inner
from oppload_cli.models.published.parts import (
    ChangeDetector,
    at_least,
    k3,
    mean_change,
    sigmoid,
    spread,
    total,
)
from oppload_cli.schema import Parameters, parameter

if TYPE_CHECKING:
    from oppload_cli.models.published.parts import Plane

_VARIANTS = "literal", "paper"
_MEANING = "'literal', as coded: only brightening counts; 'paper': absolute changes count"


@dataclass(frozen=True, kw_only=True)
class Lgmd1SingleParams(Parameters):
    """Parameters of lgmd1_single."""

    variant: str = parameter("literal", _MEANING, choices=_VARIANTS)
    inhibition: float = parameter(0.6, "weight of inhibition, W_i", low=0, high=100)
    threshold: float = parameter(
        30.0, "s below this threshold counts as 0, T_s", unit="grey levels", above=0, high=1e6
    )
    gate: float = parameter(
        10.0,
        "the response is 0 if the mean change of the frame before is at least this, T_ffi",
        unit="grey levels",
        low=0,
    )
    spike: float = parameter(0.78, "least potential of a frame with a spike, T_sp", low=0, high=1)
    enough: int = parameter(5, "spikes in a row that make a collision", unit="frames", low=1)


@dataclass(frozen=True, kw_only=True)
class Lgmd1SinglePaperParams(Lgmd1SingleParams):
    """Parameters of lgmd1_single_paper."""

    variant: str = parameter("paper", _MEANING, choices=_VARIANTS)


@dataclass(frozen=True)
class Lgmd1SingleResponse(Response):
    """The response of lgmd1_single, with its inner values; `collision` stays once it is 1."""

    mp: float = inner(0.0, "grey levels", "membrane potential, the sum of s")
    smp: float = inner(0.5, "0.5 to 1", "sigmoid of the membrane potential")
    ffi: float = inner(
        0.0, "grey levels", "feed-forward inhibition: mean change of the frame before"
    )
    spike: int = inner(0, "0 or 1", "whether the frame has a spike")
    nsp: int = inner(0, "", "spikes in a row")
    collision: int = 0


class Lgmd1Single(ChangeDetector):
    """The LGMD1 of Yue and Rind 2006, as in Fu's open source.

    ``s = E - 0.6 I`` with ``E = P(t)`` and ``I = K3(0, 1/4, 1/8) * P(t-1)`` where E and I have the
    same sign and s is at least 30; elsewhere s is 0. The membrane potential is the sum of s. If the
    mean change of the frame before is at least 10 grey levels (feed-forward inhibition), the
    response is 0. This happens just before contact.

    Where the frame darkens, E and I are negative, and s is too. So the authors' code responds to
    brightening only. The variant ``paper`` takes absolute values.

    Source: Yue and Rind 2006; ``docs/detectors.md``.
    """

    name = "lgmd1_single"
    label = "LGMD1 (single)"
    colour = "#882255"
    meaning = "LGMD1, one pathway: excitation minus lateral inhibition, gated by the mean change"
    unit = "grey levels"
    response_column = "grey levels", "membrane potential, divided by the number of pixels"
    columns = (Column("collision", "0 or 1", "1 once five spikes came in a row; it stays 1"),)
    responses = Lgmd1SingleResponse
    parameters = Lgmd1SingleParams
    alarm: ClassVar = AlarmRule(2.7)
    year = 2006
    reference = "Yue and Rind, IEEE Trans. Neural Networks, as coded by Fu"
    answers_to = "edges that brighten, until just before contact; not dark objects"
    made_for = "any size, 30 frames/s"
    cost_ms = 0.4

    params: Lgmd1SingleParams

    def _forget(self) -> None:
        self._p_before = self._zeros()
        self._nsp = self._collision = 0

    def at_rest(self) -> Lgmd1SingleResponse:
        """Return the response, 0, to a frame in which nothing changed."""
        return Lgmd1SingleResponse(0.0, collision=self._collision)

    def _respond(self, p: Plane) -> Lgmd1SingleResponse:
        e = np.abs(p) if self.params.variant == "paper" else p
        before, self._p_before = self._p_before, e
        ffi = mean_change(before)
        mp = 0.0 if ffi >= self.params.gate else self._potential(e, before)
        smp = sigmoid(mp / self.pixels)
        spike = int(smp >= self.params.spike)
        self._nsp = (self._nsp + 1) % 256 if spike else 0  # the authors count with a byte
        self._collision |= int(self._nsp >= self.params.enough)
        return Lgmd1SingleResponse(
            mp / self.pixels, None, mp, smp, ffi, spike, self._nsp, self._collision
        )

    def _potential(self, e: Plane, before: Plane) -> float:
        i = spread(before, k3(0, 1 / 4, 1 / 8))
        s = at_least(e - self.params.inhibition * i, self.params.threshold)
        return total(s[e * i > 0])


class Lgmd1SinglePaper(Lgmd1Single):
    """The LGMD1 of Yue and Rind 2006 with absolute changes, as the paper has it."""

    name = "lgmd1_single_paper"
    label = "LGMD1 (single, paper)"
    colour = "#AC4F76"
    meaning = "LGMD1, one pathway of absolute changes, gated by the mean change"
    parameters = Lgmd1SinglePaperParams
    answers_to = "edges that brighten or darken, until just before contact"
    alarm: ClassVar = AlarmRule(5.5)
