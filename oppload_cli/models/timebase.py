"""Time: when each frame is presented, and how the models count it (``docs/time.md``).

The step of the models is a time, the interval, and not a frame: the paper and the authors of
D-LGMD took it from one frame of 30 per second to the next. The background of a response, its
recent median, goes by times too.
"""

from __future__ import annotations

import math
from bisect import bisect_left, insort
from collections import deque
from dataclasses import dataclass
from fractions import Fraction
from statistics import median
from typing import Any

from oppload_cli.errors import ParameterError
from oppload_cli.models.presets import DEFAULT_PRESET, preset_named
from oppload_cli.schema import Parameters, parameter

FRAME = "frame"
_REFERENCE_S = Fraction(1, 30)
_SHORTEST_S, _LONGEST_S = 1e-4, 10.0
NEARLY_ONE = 0.03  # times in files are rounded, often to milliseconds
_USUAL_RATE = 30.0  # frames/s, where nothing is known
_MOST_STEPS = 1 << 10  # from frame to frame, of which the median is taken
_MOST_VALUES = 1 << 14  # of a background, also where times stand still
_CONTRADICTION = 0.1  # of the declared rate
_LEAST_RATE = 9.0  # frames/s; below it few responses mean anything (docs/time.md)


@dataclass(frozen=True, kw_only=True)
class TimeParams(Parameters):
    """The time base (``docs/time.md``)."""

    interval: str = parameter(
        str(_REFERENCE_S),
        "step of the models in seconds, such as 1/30 or 0.04; 'frame': from frame to frame",
        unit="s",
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.interval != FRAME:
            self._seconds()

    def _seconds(self) -> Fraction:
        try:
            seconds = Fraction(self.interval)
        except (ValueError, ZeroDivisionError):
            seconds = Fraction(0)
        if not _SHORTEST_S <= seconds <= _LONGEST_S:
            raise ParameterError(
                f"parameter 'interval' of time must be 'frame', or {_SHORTEST_S:g} to "
                f"{_LONGEST_S:g} seconds such as 1/30 or 0.04, not '{self.interval}'"
            )
        return seconds

    @property
    def per_second(self) -> float | None:
        """Intervals per second; None where frames are counted."""
        return None if self.interval == FRAME else float(1 / self._seconds())


_PAPER = TimeParams(interval=FRAME)


def time_params(preset: str = DEFAULT_PRESET) -> TimeParams:
    """Return the time base under a preset: frames for ``paper``, 1/30 s for the others."""
    return _PAPER if preset_named(preset).name == "paper" else TimeParams()


class Clock:
    """Tells the time of frames in intervals.

    Parameters
    ----------
    params : TimeParams, optional
        The time base.
    frame_rate : float, optional
        Frames per second of the video, for frames whose time nobody tells; without it each of
        them lasts one interval.

    Attributes
    ----------
    time_s : float or None
        Presentation time in seconds of the frame that is given now; None where nobody tells it.
    per_second : float
        Intervals per second.
    step : float
        Intervals from frame to frame, by the frame rate of the video.
    """

    def __init__(self, params: TimeParams | None = None, frame_rate: float | None = None) -> None:
        per_second = (params or TimeParams()).per_second
        known = frame_rate if frame_rate and math.isfinite(frame_rate) else None
        self._counts = per_second is None
        self.per_second = per_second or known or float(1 / _REFERENCE_S)
        self.step = 1.0 if self._counts or not known else nearly_one(self.per_second / known)
        self.time_s: float | None = None

    def now(self, before: float | None) -> float:
        """Return the time of the frame that is given now, in intervals.

        Parameters
        ----------
        before : float or None
            The time that the frame before was given; None for the first frame.

        Returns
        -------
        float
            Above `before`: a frame whose time does not lie after it comes one step later.
        """
        if not self._counts and self.time_s is not None:
            now = float(self.time_s) * self.per_second  # a NumPy number would widen the maps
            if before is None or now > before:
                return now
        return 0.0 if before is None else before + self.step


def nearly_one(ratio: float) -> float:
    """Return 1 for a ratio within 3 % of it, else the ratio."""
    return 1.0 if abs(ratio - 1) <= NEARLY_ONE else ratio


class FrameTimes:
    """The presentation times of the frames of one input.

    Parameters
    ----------
    rate : float, optional
        Frames per second as the input declares them.
    """

    def __init__(self, rate: float | None = None) -> None:
        usable = rate is not None and math.isfinite(rate) and rate > 0
        self._declared = rate if usable else None
        self._step_s = 1 / (self._declared or _USUAL_RATE)
        self._steps: list[float] = []
        self._first_s: float | None = None
        self._now_s = 0.0
        self._frames = self._wrong = 0
        self._first_wrong = 0
        self._longest_s = 0.0

    def step(self, time_s: float) -> float:
        """Take the time of the next frame.

        Parameters
        ----------
        time_s : float
            Presentation time in seconds, as the input gives it.

        Returns
        -------
        float
            The same, where it lies after that of the frame before; else the time before and
            the latest step that was right.
        """
        if self._first_s is None:
            self._first_s = self._now_s = time_s
        elif time_s > self._now_s:
            self._step_s = time_s - self._now_s
            self._longest_s = max(self._longest_s, self._step_s)
            if len(self._steps) < _MOST_STEPS:
                self._steps.append(self._step_s)
            self._now_s = time_s
        else:
            if not self._wrong:
                self._first_wrong = self._frames
            self._wrong += 1
            self._now_s += self._step_s
        self._frames += 1
        return self._now_s

    @property
    def seconds(self) -> float:
        """Time from the first frame to the latest one, in seconds."""
        return self._now_s - (self._first_s or 0.0)

    @property
    def rate(self) -> float | None:
        """Frames per second by the median step of the first 1024 frames; None for one frame."""
        return 1 / median(self._steps) if self._steps else None

    def as_dict(self) -> dict[str, Any]:
        """Return the facts for the sidecar."""
        return {
            "frames_per_s": None if self.rate is None else round(self.rate, 3),
            "longest_step_s": round(self._longest_s, 6),
            "not_after_the_one_before": self._wrong,
            "notes": self.notes(),
        }

    def notes(self) -> list[str]:
        """Return remarks about the times, a sentence each."""
        notes = []
        if self._wrong:
            notes.append(
                f"{self._wrong} frames, the first one {self._first_wrong} after the first, have a "
                f"time that does not lie after that of the frame before; the models take them "
                f"one step of {self._step_s:.3g} s later"
            )
        rate = self.rate
        if rate is None:
            return notes
        if self._declared and abs(rate / self._declared - 1) > _CONTRADICTION:
            notes.append(
                f"{self._declared:.4g} frames/s are declared, but the times of most frames say "
                f"{rate:.4g}; the times count"
            )
        if rate < _LEAST_RATE:
            notes.append(
                f"{rate:.3g} frames/s are too few for the models, whose interval is 1/30 s; "
                f"below {_LEAST_RATE:.0f} expect missed approaches"
            )
        return notes


class Background:
    """The median of the recent responses, at most 16384 of them.

    Parameters
    ----------
    reach : float
        How far back it reaches, in the unit of the times, above 0.
    guard : float
        The latest time that is not yet background, at least 0: an event must not raise the
        background that it is compared with.
    """

    def __init__(self, reach: float, guard: float) -> None:
        self._reach = reach
        self._guard = guard
        self._waiting: deque[tuple[float, float]] = deque()
        self._counted: deque[tuple[float, float]] = deque()
        self._sorted: list[float] = []

    def step(self, value: float, time: float) -> float:
        """Take the next value.

        Parameters
        ----------
        value : float
            A finite number.
        time : float
            When it was; never before the value that came last.

        Returns
        -------
        float
            The median of the background before it; 0 where there is none yet.
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
