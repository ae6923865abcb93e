"""Time: the presentation times of frames, counted in intervals (``docs/time.md``).

The models compare frames over a time, the interval, and not over a number of frames. The paper and
the authors of D-LGMD compared successive frames, at 30 frames per second. Which frames are compared
is decided in :mod:`oppload_cli.models.layers`. The background of a response, the median of recent
responses, covers a span of time too.
"""

from __future__ import annotations

import math
from bisect import bisect_left, insort
from collections import deque
from dataclasses import dataclass
from fractions import Fraction
from numbers import Real

from oppload_cli.errors import ParameterError
from oppload_cli.schema import Parameters, parameter

FRAME = "frame"
REFERENCE_INTERVAL = "1/30"  # seconds
_REFERENCE_S = Fraction(REFERENCE_INTERVAL)
_SHORTEST_S, _LONGEST_S = Fraction("0.0001"), Fraction(10)  # exact, as the values are
ROUNDING = 0.03  # share of an interval: times in files are rounded, often to milliseconds
_MOST_VALUES = 1 << 14  # largest number of values of a background, if the times do not grow


@dataclass(frozen=True, kw_only=True)
class TimeParams(Parameters):
    """The time base (``docs/time.md``)."""

    interval: str | None = parameter(
        None,
        "step of the models in seconds, such as 1/30 or 0.04; 'frame': one step per frame; auto: "
        "each detector's own, 1/30 s of all but opplod_paper, which counts frames",
        unit="s",
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.interval not in {None, FRAME}:
            self._seconds()

    def _seconds(self) -> Fraction:
        try:
            seconds = Fraction(REFERENCE_INTERVAL if self.interval is None else self.interval)
        except (ValueError, ZeroDivisionError):
            seconds = Fraction(0)
        if not _SHORTEST_S <= seconds <= _LONGEST_S:
            raise ParameterError(
                f"parameter 'interval' of time must be 'frame', or {float(_SHORTEST_S):g} to "
                f"{_LONGEST_S} seconds such as 1/30 or 0.04, not '{self.interval}'"
            )
        return seconds

    @property
    def per_second(self) -> float | None:
        """Intervals per second, 30 if `interval` is auto; None if each frame is one interval."""
        return None if self.interval == FRAME else float(1 / self._seconds())

    def of(self, interval: str) -> TimeParams:
        """Return the time base of a detector whose own one is `interval`."""
        return TimeParams(interval=interval) if self.interval is None else self


class Clock:
    """Tells the time of frames in intervals.

    Parameters
    ----------
    params : TimeParams, optional
        The time base.
    frame_rate : float or Fraction, optional
        Frames per second of the video, used for frames without a presentation time. Without a frame
        rate each of these frames lasts one interval.

    Attributes
    ----------
    time_s : float or None
        Presentation time in seconds of the current frame; None if it is not known.
    per_second : float
        Intervals per second.
    step : float
        Intervals from frame to frame, according to the frame rate of the video.
    """

    def __init__(
        self, params: TimeParams | None = None, frame_rate: float | Fraction | None = None
    ) -> None:
        given: object = frame_rate  # a caller may give a text, in spite of the type
        if given is not None and not (isinstance(given, Real) and 0 < float(given) < math.inf):
            raise ParameterError(
                f"frame_rate must be a finite number above 0, not {given!r:.60}; leave it out if "
                "it is not known"
            )
        per_second = (params or TimeParams()).per_second
        rate = None if frame_rate is None else float(frame_rate)
        self._counts_frames = per_second is None
        self.per_second = per_second or rate or float(1 / _REFERENCE_S)
        self.step = nearly_one(self.per_second / rate) if rate else 1.0
        self.time_s: float | None = None

    def now(self, before: float | None) -> float:
        """Return the time of the current frame, in intervals.

        `before` is the time of the frame before, None for the first frame. A frame without a time,
        or with a time not later than `before`, comes one step after the frame before.
        """
        if not self._counts_frames and self.time_s is not None:
            now = float(self.time_s) * self.per_second  # a NumPy number would widen the maps
            if before is None or now > before:
                return now
        return 0.0 if before is None else before + self.step

    def lasted(self, frames: int, seconds: float) -> float:
        """Return the length of a time of so many frames and seconds, in intervals."""
        return float(frames) if self._counts_frames else seconds * self.per_second


def nearly_one(ratio: float) -> float:
    """Return 1 if a ratio differs from 1 by at most 3 %, else the ratio."""
    return 1.0 if abs(ratio - 1) <= ROUNDING else ratio


class Background:
    """The median of the recent responses, at most 16384 of them.

    `reach`, above 0, is the length of the background in ticks. `guard`, at least 0, is the length
    of the latest span of time that is not yet background: an event must not raise the background
    with which it is compared.
    """

    def __init__(self, reach: int, guard: int) -> None:
        self._reach = reach
        self._guard = guard
        self._waiting: deque[tuple[int, float]] = deque()
        self._counted: deque[tuple[int, float]] = deque()
        self._sorted: list[float] = []

    def step(self, value: float, time: int) -> float:
        """Take the next value; return the median of the background, 0 if it is still empty.

        The value must be finite, and its time not earlier than that of the previous value.
        """
        while self._waiting and self._waiting[0][0] < time - self._guard:
            counted = self._waiting.popleft()
            self._counted.append(counted)
            insort(self._sorted, counted[1])
        oldest = time - self._guard - self._reach
        while self._counted and (self._counted[0][0] < oldest or len(self._counted) > _MOST_VALUES):
            del self._sorted[bisect_left(self._sorted, self._counted.popleft()[1])]
        if len(self._waiting) < _MOST_VALUES:
            self._waiting.append((time, value))
        values, half = self._sorted, len(self._sorted) // 2
        return (values[half] + values[-half - 1]) / 2 if values else 0.0
