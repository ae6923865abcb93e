"""mLPLC2: LPLC2 units with fields of attention (Liu and Fu 2025)."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, ClassVar

import cv2
import numpy as np

from oppload_cli.models.detector import AlarmRule, Box, Response, inner
from oppload_cli.models.published.parts import (
    DECAY,
    USUAL_RATE,
    ZERO,
    ChangeDetector,
    low_pass_share,
    spread,
)
from oppload_cli.schema import Parameters, parameter

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from oppload_cli.models.published.parts import Plane

    Places = NDArray[np.intp]  # numbers of pixels, in the order of rows

# Gaussians: the number of taps of each, how many of them are used, and sigma.
_EXCITATION, _INHIBITION, _COMPRESSION = (7, 3, 10.0), (11, 5, 20.0), (5, 5, 20.0)
_INHIBITION_WEIGHT, _HALF_COMPRESSED, _NEARLY = 1.2, 0.2, 1 - 1e-15
_GAIN, _EXPONENTS = 10.0, (0.9, 0.5)  # of T4 (ON) and T5 (OFF)
_LEAST_MOTION, _LOST_MOTION = 2.0, 1e-20
# Least sum of the latest outputs with which a field is kept; least output that is a collision.
_KEPT_ABOVE, _COLLISION = 10_000.0, 1000.0
_BAND = 5  # px: width of the band at the frame's edge in which no motion is computed
_DELAYS_MS = 80.0, 70.0, 60.0, 50.0, 40.0  # at distances of 1 to 5 px
_NULL_WEIGHT, _MOTION_MS = 1.5, 30.0  # weight of opposite motion; time constant of motion
_NEIGHBOURS = (0, 1), (0, -1), (1, 0), (-1, 0)  # (rows, columns) to the right, left, below, above
_HALF_FIELD, _SUMMED_FRAMES = 75, 5  # px, frames
_FAINTEST_MOTION = 1e-12  # less motion counts as 0


# ---- Fields cut at the edge, correlators of neighbours, and fields of attention --------------


def _corner_line(size: int, used: int, sigma: float) -> Plane:
    """Return the first taps of a Gaussian with sum 1; the authors use them as a centred kernel."""
    line = np.exp(-((np.arange(size) - size // 2) ** 2) / (2 * sigma**2))
    return np.asarray(line[:used] / line.sum(), np.float64)


def _cut(p: Plane, line: Plane) -> Plane:
    """Return P convolved with a square kernel, as the authors' loop computes it.

    The kernel is the outer product of `line` with itself. The loop goes through the taps row by
    row, and sets the sum to 0 after each tap that lies in the band at the frame's edge. So a pixel
    whose last tap lies in the band gets 0. Near the upper edge only the rows below the band count,
    and near the left edge only that part of the last row that lies to the right of the band.
    """
    reach = len(line) // 2
    inside, last_row = p.copy(), np.zeros((len(line), len(line)))
    inside[:_BAND], inside[:, :_BAND], last_row[-1] = 0, 0, line[-1] * line
    out = np.asarray(cv2.sepFilter2D(inside, -1, line, line, borderType=ZERO))
    side = _BAND + reach
    out[:, :side] = spread(inside[:, : side + reach], last_row, ZERO)[:, :side]
    out[: _BAND - reach], out[-side:], out[:, : _BAND - reach], out[:, -side:] = 0, 0, 0, 0
    return np.asarray(out, np.float64)


def _correlate(
    motion: Plane, here: Places, signals: Sequence[Plane], width: int, interval_ms: float
) -> None:
    """Add the low-passed correlation of some pixels with their neighbours in four directions.

    `motion`, shape (4, pixels), is changed at the pixels `here`, which lie outside the band at the
    edge. `signals` are the compressed signals of this frame and of the frame before. `width` is the
    width of the frame in px.
    """
    share = low_pass_share(interval_ms, _MOTION_MS)
    now, before = signals
    now_here, before_here = now[here], before[here]
    for distance, tau in enumerate(_DELAYS_MS, 1):
        late = low_pass_share(interval_ms, tau)
        d_here = late * now_here + (1 - late) * before_here
        for in_direction, (dy, dx) in zip(motion, _NEIGHBOURS, strict=True):
            there = here + distance * (dy * width + dx)
            now_there = now[there]
            d_there = late * now_there + (1 - late) * before[there]
            e = d_here * d_there * (now_there - _NULL_WEIGHT * now_here)
            e[e < 0] = 0  # at most 1, so that the authors' second condition has no effect
            in_direction[here] += share * e


def _powered(motion: Plane, exponent: float) -> Plane:
    """Return a power of the motion, 0 where almost no motion remains."""
    if exponent == 0.5:
        return np.sqrt(motion)
    return np.where(motion > _FAINTEST_MOTION, np.maximum(motion, _FAINTEST_MOTION) ** exponent, 0)


def _within(offsets: Places) -> NDArray[np.bool_]:
    return (offsets >= -_HALF_FIELD) & (offsets < _HALF_FIELD)


@dataclass
class _Attention:
    """A field of attention: its number, place and first frame, and its latest outputs."""

    number: int
    y: int
    x: int
    birth: int = 0
    quadrants: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    sums: deque[float] = field(default_factory=lambda: deque(maxlen=_SUMMED_FRAMES))
    outputs: deque[float] = field(default_factory=lambda: deque([0.0], _SUMMED_FRAMES))

    def take(self, y: Places, x: Places, net: Plane) -> None:
        """Sum the outward part of the motion in each quadrant.

        `net`, shape (2, n), is the motion to the right and downwards of the pixels at y, x.
        """
        dy, dx = y - self.y, x - self.x
        inside = _within(dy) & _within(dx)
        dy, dx, (across, downward) = dy[inside], dx[inside], net[:, inside]
        right, left = np.maximum(across, 0), np.maximum(-across, 0)
        down, up = np.maximum(downward, 0), np.maximum(-downward, 0)
        middle = (dy == 0) & (dx == 0)
        self.quadrants = (
            float((right + up)[(dy <= 0) & (dx > 0)].sum()),
            float((left + up)[(dy < 0) & (dx <= 0)].sum()),
            float((left + down)[(dy >= 0) & (dx < 0)].sum()),
            float((right + down)[((dy > 0) & (dx >= 0)) | middle].sum()),
        )
        # The plain `sum` of floats rounds in another way since Python 3.12.
        self.sums.append(math.fsum(self.quadrants) if all(self.quadrants) else 0.0)
        self.outputs.append(math.fsum(self.sums))


# ---- The detector ----------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Mlplc2Params(Parameters):
    """Parameters of mLPLC2."""

    compression_threshold: float = parameter(0.75, "threshold of compressed signals", low=0, high=1)


@dataclass(frozen=True)
class Mlplc2Response(Response):
    """The response of mLPLC2 to one frame, with its inner values."""

    max_mag: float = inner(0.0, "", "largest motion of a pixel")
    max_x: int = inner(0, "px", "column of the largest motion, working size")
    max_y: int = inner(0, "px", "row of the largest motion, working size")
    sum_lm: float = inner(0.0, "", "sum of the net motion in all directions")
    n_fields: int = inner(0, "", "fields of attention")
    field_id: int = inner(0, "", "number of the oldest field; 0: none")
    field_x: int = inner(
        -1, "px", "column of the middle of the oldest field, working size; -1: none"
    )
    field_y: int = inner(-1, "px", "row of the middle of the oldest field, working size")
    q_ru: float = inner(0.0, "", "outward motion of the oldest field, upper right")
    q_lu: float = inner(0.0, "", "outward motion of the oldest field, upper left")
    q_lb: float = inner(0.0, "", "outward motion of the oldest field, lower left")
    q_rb: float = inner(0.0, "", "outward motion of the oldest field, lower right")
    field_out: float = inner(0.0, "", "output of the oldest field")
    best_out: float = inner(0.0, "", "largest output of a field")
    collision: int = inner(0, "", "1 where the largest output is at least 1000")


class Mlplc2(ChangeDetector):
    """LPLC2 units in square fields of attention, 150 px wide, which open where motion is largest.

    Source: Liu and Fu 2025 and the authors' published code; ``docs/detectors.md``.
    """

    name = "mlplc2"
    label = "mLPLC2"
    colour = "#8D6FB1"
    meaning = "LPLC2 units in fields of attention (Liu and Fu 2025)"
    response_column = "", "largest output of a field of attention"
    year = 2025
    reference = "Liu and Fu 2025"
    answers_to = "motion outward about places of large motion; drifting texture too"
    made_for = "fields of 150 px, 30 frames/s"
    cost_ms = 0.8
    least_size = (15, 15)
    responses = Mlplc2Response
    parameters = Mlplc2Params
    alarm: ClassVar = AlarmRule(25_000.0)
    places = True
    precision = np.float64

    params: Mlplc2Params

    def _forget(self) -> None:
        self._interval_ms = 1000 / (self.frame_rate or USUAL_RATE)
        line = _corner_line(*_COMPRESSION)
        self._reach = reach = spread(np.ones(self.shape), np.outer(line, line), ZERO).ravel()
        # A compressed signal is above the threshold if the signal is above this limit.
        least = np.arctanh(min(self.params.compression_threshold, _NEARLY))
        with np.errstate(divide="ignore"):
            limit = _HALF_COMPRESSED * least / np.maximum(1 - least * reach, 0)
        self._limit = np.asarray(limit, np.float64)
        self._slots = [self._zeros(), self._zeros()]
        self._signal, self._now, self._former = np.zeros((3, 2, self.pixels))
        self._motion = np.zeros((2, 4, self.pixels))
        self._moves = np.zeros(self.pixels, bool)
        inner_part = np.zeros(self.shape, bool)
        inner_part[_BAND:-_BAND, _BAND:-_BAND] = True
        self._inner = inner_part.ravel()
        self._active: list[Places] = [np.empty(0, np.intp)] * 2
        self._earlier = list(self._active)
        self._fields: list[_Attention] = []
        self._frames = self._opened = 0

    def at_rest(self) -> Mlplc2Response:
        """Return the response, 0, to a frame in which nothing changed; the fields stay."""
        count, oldest = len(self._fields), self._oldest
        number, x, y = oldest.number, oldest.x, oldest.y
        return Mlplc2Response(0.0, n_fields=count, field_id=number, field_x=x, field_y=y)

    @property
    def _oldest(self) -> _Attention:
        return self._fields[0] if self._fields else _Attention(0, -1, -1)

    def _respond(self, p: Plane) -> Mlplc2Response:
        self._frames += 1
        # The present change goes into each slot in turn. So at every second frame the present
        # change inhibits and the former change excites, as in the authors' program.
        self._slots[self._frames % 2] = p
        self._drive(*self._slots)
        self._compress()
        # Most pixels show no motion; motion is computed only for the others.
        for active, earlier in zip(self._active, self._earlier, strict=True):
            self._moves[active] = self._moves[earlier] = True
        moving = np.flatnonzero(self._moves & self._inner)
        self._motion[:, :, moving] *= 1 - low_pass_share(self._interval_ms, _MOTION_MS)
        for pathway, active, earlier, *signals in zip(
            self._motion, self._active, self._earlier, self._now, self._former, strict=True
        ):
            pixels = np.union1d(active, earlier)
            pixels = pixels[self._inner[pixels]]
            _correlate(pathway, pixels, signals, self.shape[1], self._interval_ms)
        motion = self._motion[:, :, moving]
        self._moves[moving] = (motion > _LOST_MOTION).any(axis=(0, 1))
        t4, t5 = (
            _powered(pathway, exponent)
            for pathway, exponent in zip(motion, _EXPONENTS, strict=True)
        )
        return self._attend(moving, _GAIN * (t4 + t5))

    def _drive(self, inhibiting: Plane, exciting: Plane) -> None:
        """Let the ON and the OFF signal decay, and add excitation minus inhibition to them."""
        excitation = _cut(exciting, _corner_line(*_EXCITATION))
        s = excitation - _INHIBITION_WEIGHT * _cut(inhibiting, _corner_line(*_INHIBITION))
        bright = excitation >= 0
        # ON where excitation and the difference are above 0, OFF where both are below 0.
        s *= (s > 0) == bright
        self._signal *= DECAY
        on, off = self._signal.reshape(2, *self.shape)
        on += np.maximum(s, 0, out=excitation)
        off -= np.minimum(s, 0, out=excitation)

    def _compress(self) -> None:
        """Compress each signal; compressed signals up to the threshold become 0."""
        self._now, self._former = self._former, self._now
        oldest, self._earlier = self._earlier, self._active
        self._active = [np.flatnonzero(signal > self._limit) for signal in self._signal]
        for compressed, signal, former, at in zip(
            self._now, self._signal, oldest, self._active, strict=True
        ):
            compressed[former] = 0
            values = signal[at]
            compressed[at] = np.tanh(values / (_HALF_COMPRESSED + values * self._reach[at]))

    def _attend(self, at: Places, motion: Plane) -> Mlplc2Response:
        right, left, down, up = motion
        y, x = np.divmod(at, self.shape[1])
        magnitude = np.hypot(right + left, down + up)
        net = np.stack([right - left, down - up])
        net[np.abs(net) < _LEAST_MOTION] = 0
        self._open(y, x, magnitude)
        for attention in list(self._fields):
            attention.take(y, x, net)
            is_old = self._frames > attention.birth + _SUMMED_FRAMES
            if is_old and math.fsum(attention.outputs) < _KEPT_ABOVE and len(self._fields) > 1:
                self._fields.remove(attention)
        largest_motion = 0.0, 0, 0
        if magnitude.any():
            best = int(magnitude.argmax())
            largest_motion = float(magnitude[best]), int(x[best]), int(y[best])
        oldest = self._oldest
        largest = max(self._fields or [oldest], key=lambda attention: attention.outputs[-1])
        output, side = largest.outputs[-1], 2.0 * _HALF_FIELD
        left_top = largest.x - _HALF_FIELD, largest.y - _HALF_FIELD
        box = Box(*left_top, side, side) if output > 0 else None
        fields = len(self._fields), oldest.number, oldest.x, oldest.y, *oldest.quadrants
        last = oldest.outputs[-1], output, int(output >= _COLLISION)
        values = *largest_motion, float(np.abs(net).sum()), *fields, *last
        return Mlplc2Response(output, box, *values)

    def _open(self, y: Places, x: Places, magnitude: Plane) -> None:
        """Open a field at the largest motion that the authors' scan finds outside other fields."""
        # The scan considers only pixels with more motion than all pixels before them.
        records = np.flatnonzero(np.diff(np.maximum.accumulate(magnitude), prepend=0.0) > 0)
        y, x = y[records], x[records]
        outside = np.ones(len(records), bool)
        for attention in self._fields:
            outside &= ~(_within(y - attention.y) & _within(x - attention.x))
        if outside.any():
            last = np.flatnonzero(outside)[-1]  # the last of these pixels has the largest motion
            self._opened += 1
            self._fields.append(_Attention(self._opened, int(y[last]), int(x[last]), self._frames))
