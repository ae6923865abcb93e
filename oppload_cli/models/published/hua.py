"""A bio-inspired LPLC2 network about the centre of view (after Hua et al. 2022)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import cv2
import numpy as np

from oppload_cli.models.detector import AlarmRule, Detector, Response, inner
from oppload_cli.models.dpc import grey_levels
from oppload_cli.models.published.parts import (
    DECAY,
    EDGE,
    USUAL_RATE,
    averaged,
    low_pass_share,
    positive,
    radial_gaussian,
)
from oppload_cli.schema import Parameters, parameter

if TYPE_CHECKING:
    from typing import Any

    from numpy.typing import NDArray

    from oppload_cli.models.dpc import Map

_LOW_PASS_MS = 30.0
_EXPONENTS = 0.9, 0.5  # of T4 (ON) and T5 (OFF)
_RIGHT, _LEFT, _DOWN, _UP = range(4)
_FIRST_FRAME = 2  # the authors' code skips the difference between the first two frames
_SMALLEST = np.float32(1e-22)
_LEAST = np.float32(1e-30)


# ---- The motion, which both variants share ---------------------------------------------------


class _Pathway:
    """T4 (from ON signals) or T5 (from OFF signals): motion in four directions, to a power.

    `share` is the weight of the input in each low-passed value.
    """

    def __init__(self, shape: tuple[int, int], exponent: float, share: float) -> None:
        self._exponent, self._share = exponent, share
        self._bias = radial_gaussian(shape, 1).astype(np.float32)
        self._spread = cv2.getGaussianKernel(11, 5.0)
        self._signal, self._delayed, self._contrast = np.zeros((3, *shape), np.float32)
        # Low-passed T of each pixel with its neighbour to the right, and with the one below.
        self._across, self._down = np.zeros((2, *shape), np.float32)

    def step(self, change: Map) -> list[Map]:
        """Return the motion to the right, left, down and up.

        `change` is the band-passed change of luminance, towards ON or OFF.
        """
        share, bias = self._share, self._bias
        self._signal = _flushed(cv2.scaleAdd(self._signal, DECAY, positive(change)))
        s = _flushed(_blurred(self._signal, self._spread))
        self._delayed = d = _flushed(cv2.addWeighted(s, share, self._delayed, 1 - share, 0))
        rise = self._rise(s)
        self._low_pass(self._across[:, :-1], s[:, :-1], s[:, 1:], d[:, :-1], d[:, 1:])
        self._low_pass(self._down[:-1], s[:-1], s[1:], d[:-1], d[1:])
        # T of a pixel with its left (upper) neighbour is -T of the neighbour with the pixel. T is 0
        # at the edge, because outside the frame the nearest pixel is repeated.
        left, up = np.zeros((2, *s.shape), np.float32)
        left[:, 1:] = -bias[:, 1:] * self._across[:, :-1]
        up[1:] = -bias[1:] * self._down[:-1]
        motion = bias * self._across, left, bias * self._down, up
        return [_to_power(value - rise, self._exponent) for value in motion]

    def _rise(self, s: Map) -> Map:
        """Return the change, since the frame before, of the contrast of S with its 8 neighbours.

        The mean of the neighbours is ``(9 A3 * S - S) / 8``, and so the contrast
        ``9/8 |S - A3 * S|``.
        """
        before, self._contrast = self._contrast, np.asarray(cv2.absdiff(s, averaged(s)), np.float32)
        return np.asarray(cv2.addWeighted(self._contrast, 9 / 8, before, -9 / 8, 0), np.float32)

    def _low_pass(self, t: Map, s_here: Map, s_there: Map, d_here: Map, d_there: Map) -> None:
        """Low-pass T in place; its input correlates the signals of a pixel and of a neighbour."""
        new = (d_here - d_there) * s_here * s_there
        t *= np.float32(1 - self._share)
        t += new * np.float32(self._share)
        t += _SMALLEST  # as `_flushed`, for both signs
        t -= _SMALLEST


def _to_power(values: Map, exponent: float) -> Map:
    """Return the values above 0 to a power; the others become close to 0."""
    values = np.maximum(values, _LEAST)
    if exponent == 0.5:
        return np.sqrt(values)
    # This takes less time than `np.power`: NumPy computes several logarithms at once.
    return np.asarray(np.exp(np.log(values) * np.float32(exponent)), np.float32)


def _flushed(values: NDArray[Any]) -> Map:
    """Return a map in which values below 1e-9 of a grey level are replaced by 0.

    Otherwise values that decay from frame to frame would become so small ("subnormal") that the
    processor computes with them many times slower.
    """
    return np.asarray(cv2.threshold(values, 1e-9, 0, cv2.THRESH_TOZERO)[1], np.float32)


def _blurred(values: Map, line: NDArray[Any]) -> Map:
    return np.asarray(cv2.sepFilter2D(values, -1, line, line, borderType=EDGE), np.float32)


class _NetMotion:
    """The model up to its last layer, which both variants share: net motion along both axes.

    `sums`, shape (2, 2, 2, 2), are sums of net motion after the Gaussian error linear unit (GELU).
    The indices are axis (across, down), row (upper, lower) and column (left, right) of the
    quadrant, and direction: 0 for motion to the right or downwards, 1 for the opposite motion.
    """

    def __init__(self, shape: tuple[int, int], low_pass_ms: float, interval_ms: float) -> None:
        self.shape, self._share = shape, low_pass_share(interval_ms, low_pass_ms)
        self._bands = cv2.getGaussianKernel(3, 1.0), cv2.getGaussianKernel(5, 2.0)
        self.reset()

    def reset(self) -> None:
        self.frames = 0
        self.sums = np.zeros((2, 2, 2, 2))
        self._before: NDArray[np.uint8] | None = None
        self._pathways = [_Pathway(self.shape, exponent, self._share) for exponent in _EXPONENTS]

    @property
    def ready(self) -> bool:
        return self.frames > _FIRST_FRAME

    def step(self, luma: Map) -> bool:
        now = grey_levels(luma, self.shape)
        before, self._before = self._before, now
        self.frames += 1
        if before is None or not self.ready:
            return False
        p = np.asarray(cv2.subtract(now, before, dtype=cv2.CV_32F), np.float32)
        fine, coarse = (_blurred(p, line) for line in self._bands)
        on = self._pathways[0].step(fine - coarse)
        off = self._pathways[1].step(coarse - fine)
        for axis, (forward, backward) in enumerate(((_RIGHT, _LEFT), (_DOWN, _UP))):
            self.sums[axis] = self._sums(on[forward] - on[backward] + off[forward] - off[backward])
        return True

    def _sums(self, x: Map) -> Any:
        """Return the sums of GELU(x) and GELU(-x) over the quadrants, shape (2, 2, 2).

        In its approximation by tanh, ``GELU(x) = x / 2 + b`` with
        ``b = x / 2 tanh(0.7978846 (x + 0.044715 x^3))``, and ``GELU(-x) = b - x / 2``.
        """
        bent = x * np.tanh(x * (np.float32(0.7978846) + np.float32(0.7978846 * 0.044715) * x**2))
        # The authors count rows and columns from 1.
        row, column = self.shape[0] // 2 - 1, self.shape[1] // 2 - 1
        sums = np.empty((2, 2, 2))
        for y, rows in enumerate((slice(row), slice(row, None))):
            for z, columns in enumerate((slice(column), slice(column, None))):
                half, curved = (
                    values[rows, columns].sum(dtype=np.float64) / 2 for values in (x, bent)
                )
                sums[y, z] = curved + half, curved - half
        return sums


# ---- The detectors ---------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class HuaFixedParams(Parameters):
    """Parameters of the model after Hua et al."""

    low_pass_ms: float = parameter(_LOW_PASS_MS, "time constant of the delay", low=0)


@dataclass(frozen=True, kw_only=True)
class HuaLiteralParams(HuaFixedParams):
    """Parameters of the model after Hua et al., as its authors coded it."""


@dataclass(frozen=True)
class HuaResponse(Response):
    """The response of the model to one frame, with its inner values."""

    q_right_down: float = inner(0.0, "", "outward motion in the lower right quadrant")
    q_left_down: float = inner(0.0, "", "outward motion in the lower left quadrant")
    q_left_up: float = inner(0.0, "", "outward motion in the upper left quadrant")
    q_right_up: float = inner(0.0, "", "outward motion in the upper right quadrant")
    product: float = inner(0.0, "", "product of the four quadrants, each at least 0")


class HuaFixed(Detector):
    """Motion away from the middle of the frame in all four quadrants at once.

    The authors did not publish nine functions of their code; ``docs/detectors.md`` lists the
    assumptions that replace them. This variant corrects the sign of the vertical difference, and
    does not add the sums of earlier frames.

    Source: after Hua et al. 2022 and the published part of the authors' code.
    """

    name = "hua_fixed"
    label = "Hua et al."
    colour = "#B4182A"
    meaning = "LPLC2 network about the centre of view (after Hua et al. 2022), corrected"
    response_column = "", "geometric mean of the four quadrants, each at least 0"
    year: ClassVar[int | None] = 2022
    reference = "after Hua et al. 2022"
    answers_to = "motion out of the middle of the frame on all four sides"
    made_for = "an object in the middle of view, 30 frames/s"
    cost_ms = 2.2
    least_size = (8, 8)
    evaluated = False
    responses = HuaResponse
    parameters: ClassVar[type[Parameters]] = HuaFixedParams
    alarm: ClassVar = AlarmRule(7000.0)
    warm_up = _FIRST_FRAME

    params: HuaFixedParams

    way_below: ClassVar[int] = 0  # vertical motion that counts below the middle: 0, downwards

    def __init__(
        self, shape: tuple[int, int], params: Parameters | None = None, **others: Any
    ) -> None:
        super().__init__(shape, params, **others)
        interval_ms = 1000 / (self.frame_rate or USUAL_RATE)
        constants = shape, self.params.low_pass_ms, interval_ms
        self._motion = self.layers.other(("hua", *constants), lambda: _NetMotion(*constants))
        self._sums = np.zeros(4)

    def reset(self) -> None:
        """Forget all frames: the next frame is frame 0."""
        self._motion.reset()
        self._sums = np.zeros(4)

    def step(self, luma: Map) -> HuaResponse | None:
        """Take the next frame; None for the first two."""
        if not self._motion.step(luma):
            return None
        self._sums = self._quadrants()
        return self._with_sums(self._product**0.25)

    @property
    def _product(self) -> float:
        return float(np.prod(np.maximum(self._sums, 0)))

    def _with_sums(self, response: float) -> HuaResponse:
        values = *self._sums.tolist(), self._product
        return HuaResponse(response, None, *values)

    def _quadrants(self) -> Any:
        """Return the sums of the outward motion over the quadrants, in the order of the columns."""
        across, down = self._motion.layer.sums
        below, above = self.way_below, 1 - self.way_below
        return np.array(
            [
                across[1, 1, 0] + down[1, 1, below],
                across[1, 0, 1] + down[1, 0, below],
                across[0, 0, 1] + down[0, 0, above],
                across[0, 1, 0] + down[0, 1, above],
            ]
        )


class HuaLiteral(HuaFixed):
    """The model as its authors coded it: inward vertical motion counts, sums are never reset."""

    name = "hua_literal"
    label = "Hua et al. (literal)"
    colour = "#FFA286"
    meaning = "LPLC2 network about the centre of view (after Hua et al. 2022), as coded"
    answers_to = "motion sideways out of the middle and vertically into it, summed over all frames"
    parameters: ClassVar[type[Parameters]] = HuaLiteralParams
    alarm: ClassVar = AlarmRule(100_000.0)

    way_below: ClassVar[int] = 1

    def at_rest(self) -> HuaResponse:
        """Return the response, 0, to a frame in which nothing changed; the sums stay."""
        return self._with_sums(0.0)

    def _quadrants(self) -> Any:
        return self._sums + super()._quadrants()
