"""pLGMD: LGMD1 with synapses that transmit at random (2023)."""

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
    from numpy.typing import NDArray

    from oppload_cli.models.published.parts import Plane

    Mask = NDArray[np.bool_]

_TAPS = [(y, x) for y in (0, 1, 2) for x in (0, 1, 2) if (y, x) != (1, 1)]
_INHIBITION, _DECAY, _THRESHOLD = 0.3, 0.15, 15.0
_RESOLUTION = 1 << 16  # of a probability


@dataclass(frozen=True, kw_only=True)
class PlgmdParams(Parameters):
    """Parameters of plgmd."""

    p: float = parameter(0.55, "probability that a synapse transmits", low=0, high=1)
    seed: int = parameter(1, "seed of the random numbers", low=0, high=2**31 - 1)
    runs: int = parameter(
        1,
        "number of runs, each with random numbers of its own; the response is their mean",
        low=1,
        high=100,
    )


@dataclass(frozen=True)
class PlgmdResponse(Response):
    """The answer of plgmd, with its inner values."""

    k: float = inner(0.0, "0 to 1", "sigmoid of the sum of G over the number of pixels, first run")
    sum_abs_g: float = inner(0.0, "grey levels", "sum of G of the first run")
    k_mean: float = inner(0.0, "0 to 1", "mean of k over the runs")
    k_sd: float = inner(0.0, "0 to 1", "standard deviation of k over the runs")
    sumg_mean: float = inner(0.0, "grey levels", "mean of the sum of G over the runs")
    sumg_sd: float = inner(0.0, "grey levels", "standard deviation of the sum of G over the runs")


class Plgmd(ChangeDetector):
    """The LGMD1 with grouping in which each synapse transmits with probability p in each frame.

    Independent masks lie on Q and on each of the 8 taps of the inhibition, on E and on I again,
    and on G; nothing is divided by p. The masks on Q and E are one mask of probability p^2.
    With p = 1 it is `lgmd1_group`; below 1, single precision is enough. The authors find p = 0.55
    best and show means of 20 runs.

    Source: fuqinbing's pLGMD.m, 2023; ``docs/detectors.md``.
    """

    name = "plgmd"
    label = "pLGMD"
    colour = "#00B08E"
    meaning = "LGMD1 with grouping and random synapses"
    unit = "grey levels"
    response_column = "grey levels", "mean sum of G over the number of pixels"
    details = details_of(PlgmdResponse)
    answers = PlgmdResponse
    parameters = PlgmdParams
    alarm_floors: ClassVar = {DEFAULT_PRESET: 20.0}
    year = 2023
    reference = "Fu, pLGMD"
    answers_to = "moving edges in clusters, and where they were; weak motion drowns"
    made_for = "any size, 30 frames/s"
    cost_ms = 3.0
    warm_up = 0
    precision = np.float64

    params: PlgmdParams

    def forget(self) -> None:
        """Forget all changes, and begin the random numbers again."""
        self._q = [self.zeros()] * 2  # Q(t-1), Q(t-2)
        self._t = 0
        self._random = np.random.SFC64(self.params.seed)

    def first(self) -> PlgmdResponse:
        """Return the answer to frame 0."""
        return PlgmdResponse(0.0)

    def answer(self, p: Plane) -> PlgmdResponse:
        """Answer to the change of a frame."""
        self._t += 1
        if self._t == 1:  # as in lgmd1_group, the change of frame 1 is not used
            return PlgmdResponse(0.0)
        before, earlier = self._q
        q = p + np.asarray(cv2.addWeighted(before, 0.5, earlier, 0.5, 0))
        self._q = [q, before]
        sums = np.array([self._sum_of_g(q, before) for _ in range(self.params.runs)])
        potentials = np.array([sigmoid(each / self.pixels) for each in sums])
        spreads = [float(each.std(ddof=min(1, len(each) - 1))) for each in (potentials, sums)]
        k, total = float(potentials.mean()), float(sums.mean())
        first = float(potentials[0]), float(sums[0])
        return PlgmdResponse(total / self.pixels, None, *first, k, spreads[0], total, spreads[1])

    def _sum_of_g(self, q: Plane, before: Plane) -> float:
        """Return the sum of G of one run."""
        if self.params.p == 1:
            s = q - _INHIBITION * spread(before, k3(0, 1 / 4, 1 / 8), ZERO)
            g, _ = grouped(s, 4, 0.01, ZERO)
            return float(g[_DECAY * g >= _THRESHOLD].sum())
        masks = self._masks()
        s = np.asarray(q, np.float32) * masks[0]
        inhibition = self._inhibition(before, masks[3:])
        cv2.scaleAdd(inhibition, -_INHIBITION, s, dst=inhibition)
        np.copyto(s, inhibition, where=masks[1])
        g, _ = grouped(s, 4, 0.01, ZERO)
        return float(g[(_DECAY * g >= _THRESHOLD) & masks[2]].sum(dtype=np.float64))

    def _inhibition(self, q: Plane, masks: Mask) -> Plane:
        """Return the sum of the 8 taps on Q(t-1), each with a mask of its own."""
        height, width = self.shape
        nearest = np.pad(np.asarray(q, np.float32) / 4, 1)
        diagonal = nearest / 2
        out = np.zeros(self.shape, np.float32)
        for (y, x), mask in zip(_TAPS, masks.view(np.uint8), strict=True):
            padded = nearest if 1 in {y, x} else diagonal
            tap = padded[y : y + height, x : x + width]
            cv2.add(out, tap, dst=out, mask=mask)
        return out

    def _masks(self) -> Mask:
        """Return 11 independent masks: of Q and E in one, of I, of G, and of the 8 taps.

        The first is set with probability p^2 at each pixel, the others with p.
        """
        p, count = self.params.p, 3 + len(_TAPS)
        words = -(-2 * count * self.pixels // 8)
        numbers = self._random.random_raw(words).view(np.uint16)[: count * self.pixels]
        parts = numbers.reshape(count, *self.shape)
        limits = np.array([p**2, *[p] * (count - 1)]) * _RESOLUTION
        highest = np.minimum(np.rint(limits), _RESOLUTION - 1).astype(np.uint16)
        return np.asarray(parts < highest[:, None, None])
