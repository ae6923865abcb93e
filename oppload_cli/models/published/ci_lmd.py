"""CI-LMD: ON and OFF pathways that inhibit each other (2026)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import cv2
import numpy as np

from oppload_cli.models.detector import AlarmRule, Response, inner
from oppload_cli.models.published.parts import (
    DECAY,
    EDGE,
    ChangeDetector,
    averaged,
    k3,
    positive,
    sigmoid,
    spread,
    total,
)
from oppload_cli.schema import Parameters, parameter

if TYPE_CHECKING:
    from oppload_cli.models.published.parts import Plane


@dataclass(frozen=True, kw_only=True)
class CiLmdParams(Parameters):
    """Parameters of ci_lmd."""

    on_inhibition: float = parameter(0.4, "inhibition of ON by earlier, spread ON", low=0, high=100)
    off_inhibition: float = parameter(
        0.6, "inhibition of OFF by earlier, spread OFF", low=0, high=100
    )
    off_on: float = parameter(0.25, "inhibition of ON by OFF", low=0, high=100)
    on_off: float = parameter(0.3, "inhibition of OFF by ON", low=0, high=100)
    threshold: float = parameter(10.0, "least G that counts", unit="grey levels", above=0, high=1e6)


@dataclass(frozen=True)
class CiLmdResponse(Response):
    """The response of ci_lmd, with the value that its authors publish."""

    ci_lmd: float = inner(
        0.5, "0.5 to 1", "sigmoid of the sum of G, divided by 0.9 times the number of pixels"
    )


class CiLmd(ChangeDetector):
    """The looming detector with cross-inhibition of ON and OFF.

    P is convolved with an excitatory Gaussian (5 x 5 px, sigma 4) and an inhibitory Gaussian (9 x 9
    px, sigma 2; the smaller kernel has the larger sigma). Neither has sum 1. Where both results
    have the same sign, D is their absolute difference with this sign; elsewhere D is 0. ON and OFF
    are the positive and the negative part of D.
    ``So = ON - 0.4 W * ON(t-1) - 0.25 OFF``, ``Sf = OFF - 0.6 W * OFF(t-1) - 0.3 ON`` and
    ``S = So + 0.9 Sf + 0.5 So Sf``.

    Source: fuqinbing's CI model, 2026; ``docs/detectors.md``.
    """

    name = "ci_lmd"
    label = "CI-LMD"
    colour = "#BBC57A"
    meaning = "cross-inhibition of ON and OFF after a difference of Gaussians"
    unit = "grey levels"
    response_column = "grey levels", "sum of G, divided by the number of pixels"
    responses = CiLmdResponse
    parameters = CiLmdParams
    alarm: ClassVar = AlarmRule(9.0)
    year = 2026
    reference = "Fu, CI model for looming detection"
    answers_to = "places where a strong change has just ended; not weak edges"
    made_for = "any size and rate"
    cost_ms = 0.8
    warm_up = 0

    params: CiLmdParams

    def _forget(self) -> None:
        self._on = self._off = self._zeros()

    def _respond(self, p: Plane) -> CiLmdResponse:
        params, d = self.params, _difference(p)
        brighter = positive(d)
        on = cv2.scaleAdd(self._on, DECAY, brighter)
        off = cv2.scaleAdd(self._off, DECAY, brighter - d)
        w = k3(0, 1 / 4, 1 / 8)
        so = cv2.addWeighted(on, 1, spread(self._on, w), -params.on_inhibition, 0)
        so = cv2.scaleAdd(off, -params.off_on, so)
        sf = cv2.addWeighted(off, 1, spread(self._off, w), -params.off_inhibition, 0)
        sf = cv2.scaleAdd(on, -params.on_off, sf)
        self._on, self._off = np.asarray(on), np.asarray(off)
        s = cv2.addWeighted(so, 1, sf, 0.9, 0) + cv2.multiply(so, sf, scale=0.5)
        g = averaged(np.asarray(s))
        mean = total(g[g >= params.threshold]) / self.pixels
        return CiLmdResponse(mean, None, sigmoid(mean / 0.9))


def _difference(p: Plane) -> Plane:
    """Return D: ``+-|e - i|`` where excitation and inhibition have the same sign, else 0."""
    e, i = _blurred(p, 5, 4), _blurred(p, 9, 2)
    d = np.abs(e - i)
    d[(e < 0) & (i < 0)] *= -1
    d[(e < 0) != (i < 0)] = 0
    return d


def _blurred(p: Plane, side: int, sigma: float) -> Plane:
    """Return P convolved with a Gaussian of amplitude ``1 / (2 pi sigma^2)``, cut to a square."""
    offsets = np.arange(side) - side // 2
    line = np.exp(-(offsets**2) / (2 * sigma**2)) / (sigma * math.sqrt(2 * math.pi))
    return np.asarray(cv2.sepFilter2D(p, -1, line, line, borderType=EDGE))
