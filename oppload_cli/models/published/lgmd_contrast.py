"""LGMD with contrast vision beside motion vision (Fu et al. 2022)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import cv2
import numpy as np

from oppload_cli.models.detector import AlarmRule, Response, inner
from oppload_cli.models.published.parts import (
    MIRROR,
    ChangeDetector,
    grouped,
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
class LgmdContrastParams(Parameters):
    """Parameters of lgmd_contrast."""

    baseline: float = parameter(
        3.0, "constant in the divisor of each change", unit="grey levels", above=0, high=255
    )
    inhibition: float = parameter(0.4, "weight of inhibition", low=0, high=100)
    decay: float = parameter(
        0.5, "factor: G counts where decay times G is at least the threshold", above=0, high=1
    )
    threshold: float = parameter(0.7, "threshold of decay times G", above=0, high=1e6)


@dataclass(frozen=True)
class LgmdContrastResponse(Response):
    """The response of lgmd_contrast, with its inner values."""

    mp: float = inner(0.5, "0.5 to 1", "sigmoid of the sum of G; 0 for frame 0")
    sum_s: float = inner(0.0, "", "sum of S")
    sum_m_on: float = inner(0.0, "", "sum of M of brightening")
    sum_m_off: float = inner(0.0, "", "sum of M of darkening")
    sum_c_on: float = inner(0.0, "", "sum of C of brightening")
    sum_i_off: float = inner(0.0, "", "sum of I of darkening")


class LgmdContrast(ChangeDetector):
    """The LGMD of Fu et al. 2022: each change is normalised by the changes around it.

    ``M = tanh(x / (g * x + 3))``, where x is the brightening or the darkening and g a Gaussian of 9
    x 9 px with sigma 5. ``S = max(M - 0.4 I - C, 0)``, where I is the spread M of the frame before,
    and ``C = |K3(1, -1/8, -1/8) * M|`` the contrast of M. ``S_on + S_off + S_on S_off`` is grouped.
    The response hardly depends on contrast; a flash of the complete frame gives the largest
    response. No rule for spikes was published.

    Source: Fu et al. 2022; ``docs/detectors.md``.
    """

    name = "lgmd_contrast"
    label = "LGMD (contrast)"
    colour = "#989A2B"
    meaning = "LGMD with contrast normalisation: nearly the same response at all contrasts"
    response_column = "", "sum of G, divided by the number of pixels"
    responses = LgmdContrastResponse
    parameters = LgmdContrastParams
    alarm: ClassVar = AlarmRule(0.27)
    year = 2022
    reference = "Fu, Li and Peng, Array"
    answers_to = "changes over areas, at any contrast; also flashes"
    made_for = "any size and rate"
    cost_ms = 0.9
    warm_up = 0

    params: LgmdContrastParams

    def _forget(self) -> None:
        self._m = self._zeros(), self._zeros()

    def _first_response(self) -> LgmdContrastResponse:
        return LgmdContrastResponse(0.0, mp=0.0)

    def _respond(self, p: Plane) -> LgmdContrastResponse:
        on = positive(p)
        before, self._m = self._m, (self._normalised(on), self._normalised(on - p))
        inhibitions = [spread(m, k3(0, 1 / 4, 1 / 8), MIRROR) for m in before]
        contrasts = [np.abs(spread(m, k3(1, -1 / 8, -1 / 8), MIRROR)) for m in self._m]
        s_on, s_off = (
            positive(m - self.params.inhibition * i - c)
            for m, i, c in zip(self._m, inhibitions, contrasts, strict=True)
        )
        s = s_on + s_off + s_on * s_off
        g, _ = grouped(s, 4, 0.01, MIRROR)
        response = total(g[self.params.decay * g >= self.params.threshold])
        sums = [total(values) for values in (s, *self._m, contrasts[0], inhibitions[1])]
        potential = sigmoid(response / (0.1 * self.pixels))
        return LgmdContrastResponse(response / self.pixels, None, potential, *sums)

    def _normalised(self, x: Plane) -> Plane:
        around = cv2.GaussianBlur(x, (9, 9), 5, borderType=MIRROR)
        m: Plane = x / (np.asarray(around) + self.params.baseline)
        return np.tanh(m, out=m)
