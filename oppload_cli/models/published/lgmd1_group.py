"""LGMD1 with a grouping layer (Yue and Rind 2006; Fu's LGMD.m); its label is "LGMD1"."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import cv2
import numpy as np

from oppload_cli.models.detector import Response, details_of, inner
from oppload_cli.models.presets import DEFAULT_PRESET
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
    from oppload_cli.models.published.parts import Plane

# p1 and p2. With the first pair Q is an integral; with the published 1 / (1 + e^i) it decays.
_PERSISTENCE = {"literal": (0.5, 0.5), "paper": (1 / (1 + np.e), 1 / (1 + np.e**2))}
_MEANING = (
    "weights of earlier Q: 'literal', as coded, keeps them; 'paper', 1 / (1 + e^i), lets them decay"
)


@dataclass(frozen=True, kw_only=True)
class Lgmd1GroupParams(Parameters):
    """Parameters of lgmd1_group."""

    persistence: str = parameter("literal", _MEANING, choices=tuple(_PERSISTENCE))
    inhibition: float = parameter(0.3, "weight of inhibition", low=0, high=100)
    grouping: float = parameter(4.0, "divisor of the largest Ce in w, C_w", above=0, high=1000)
    decay: float = parameter(0.15, "share of G that is compared, C_de", above=0, high=1)
    threshold: float = parameter(
        15.0, "share of G that counts, T_de", unit="grey levels", above=0, high=1e6
    )
    layer_threshold: float = parameter(
        0.0, "absolute values below it are 0 in every layer", unit="grey levels", low=0, high=255
    )


@dataclass(frozen=True, kw_only=True)
class Lgmd1GroupPaperParams(Lgmd1GroupParams):
    """Parameters of lgmd1_group_paper."""

    persistence: str = parameter("paper", _MEANING, choices=tuple(_PERSISTENCE))


@dataclass(frozen=True)
class Lgmd1GroupResponse(Response):
    """The answer of lgmd1_group, with its inner values."""

    k: float = inner(0.0, "0 to 1", "sigmoid of the sum of G over the number of pixels")
    sum_abs_g: float = inner(0.0, "grey levels", "K, the sum of G")
    omega: float = inner(0.0, "grey levels", "w, the scale of grouping")
    sum_abs_s: float = inner(0.0, "grey levels", "sum of the absolute S")
    sum_abs_p: float = inner(0.0, "grey levels", "sum of the absolute Q")


class Lgmd1Group(ChangeDetector):
    """The LGMD1 with persistence and grouping.

    ``Q(t) = P(t) + p1 Q(t-1) + p2 Q(t-2)``, ``S = Q(t) - 0.3 K3(0, 1/4, 1/8) * Q(t-1)``, and
    ``G = S Ce / w`` where ``0.15 G >= 15``. Signs do not count: dark and bright objects give the
    same. As coded, p1 = p2 = 0.5: Q integrates, and an edge that has passed stays for ever. The
    change of frame 1 is not used. The code has no rule for spikes; Fu's papers take k from 0.78 or
    0.8 during 4 to 5 frames.

    Source: fuqinbing's LGMD.m, after Yue and Rind 2006; ``docs/detectors.md``.
    """

    name = "lgmd1_group"
    label = "LGMD1"
    colour = "#332288"
    meaning = "LGMD1 with persistence and grouping"
    unit = "grey levels"
    response_column = "grey levels", "K, the sum of G, over the number of pixels"
    details = details_of(Lgmd1GroupResponse)
    answers = Lgmd1GroupResponse
    parameters = Lgmd1GroupParams
    alarm_floors: ClassVar = {DEFAULT_PRESET: 200.0}
    year = 2006
    reference = "Yue and Rind, with grouping, as coded by Fu for pLGMD"
    answers_to = "moving edges, dark or bright, in clusters; as coded also to where they were"
    made_for = "any size, 30 frames/s"
    cost_ms = 1.0
    warm_up = 0
    precision = np.float64

    params: Lgmd1GroupParams

    def forget(self) -> None:
        """Forget all changes."""
        self._q = [self.zeros()] * 2  # Q(t-1), Q(t-2)
        self._t = 0

    def first(self) -> Lgmd1GroupResponse:
        """Return the answer to frame 0."""
        return Lgmd1GroupResponse(0.0)

    def answer(self, p: Plane) -> Lgmd1GroupResponse:
        """Answer to the change of a frame."""
        self._t += 1
        if self._t == 1:
            return Lgmd1GroupResponse(0.0)
        before, earlier = self._q
        p1, p2 = _PERSISTENCE[self.params.persistence]
        q = p + np.asarray(cv2.addWeighted(before, p1, earlier, p2, 0))
        self._q = [q, before]
        i = self._thresholded(spread(self._thresholded(before), k3(0, 1 / 4, 1 / 8), ZERO))
        s = self._thresholded(q) - self.params.inhibition * i
        g, w = grouped(s, self.params.grouping, 0.01, ZERO)
        # 0.15 G is compared, not G: its rounding decides about ties.
        k = float(g[self.params.decay * g >= self.params.threshold].sum())
        norms = [float(cv2.norm(each, cv2.NORM_L1)) for each in (s, q)]
        mean = k / self.pixels
        return Lgmd1GroupResponse(mean, None, sigmoid(mean), k, w, *norms)

    def _thresholded(self, values: Plane) -> Plane:
        least = self.params.layer_threshold
        return values * (np.abs(values) >= least) if least else values


class Lgmd1GroupPaper(Lgmd1Group):
    """The LGMD1 with grouping and the persistence of the papers, ``p_i = 1 / (1 + e^i)``."""

    name = "lgmd1_group_paper"
    variant_of = "lgmd1_group"
    label = "LGMD1 (paper)"
    colour = "#6652C4"
    meaning = "LGMD1 with grouping and a persistence that forgets"
    parameters = Lgmd1GroupPaperParams
    answers_to = "moving edges, dark or bright, in clusters"
    alarm_floors: ClassVar = {DEFAULT_PRESET: 110.0}
