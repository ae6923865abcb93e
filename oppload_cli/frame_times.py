"""Time as a whole number of ticks, and the times of the frames of an input.

Seconds as floating-point numbers round, so that a sum of steps is not the span that it should be.
From the door of the program on, a time is a whole number of ticks of 1/705,600,000 s: a frame at
24, 25, 30, 48, 50, 60, 90, 100 or 120 frames per second, a millisecond, and a tick of the 90 kHz
clock of MPEG last a whole number of them (Facebook's "flick"). Files and users get seconds.
"""

from __future__ import annotations

import math
from collections import deque
from datetime import UTC, datetime
from fractions import Fraction
from statistics import fmean, median_low
from typing import Any

from oppload_cli.errors import counted

TICKS_PER_S = 705_600_000
USUAL_RATE = Fraction(30)  # frames/s, assumed if an input states no rate
_LEAST_RATE = 9.0  # frames/s; at lower rates few responses have a meaning (docs/time.md)
# Slow parts that last so long in all give a remark, even if the rate of most frames is higher.
_FOR_LONG_S = 2.0
_GAP_S = 0.5  # a longer time without a frame gives a remark; alarms begin anew after it
# A step is the time between two frames.
_MOST_STEPS = 1 << 10  # the rate follows from the first 1024 steps
_USUAL = 0.5  # a step is usual if it differs from the median by at most this share of the median
_ROUNDED = TICKS_PER_S // 1000  # to which the times of an input without a known tick may be rounded
LATEST_STEPS = 15  # the usual step is the median of the latest 15 steps
_CONTRADICTION = 0.1  # a larger relative difference from the declared rate gives a remark
# At a mean of less than 100 frames/s no camera takes pictures less than 5 ms apart. Frames that
# come so, if they are a larger share and more than a few, have the times of their arrival.
_BURST, _SHARE_IN_BURSTS, _FEW_IN_BURSTS = TICKS_PER_S // 200, 0.05, 10
_LASTING = TICKS_PER_S  # a shift of at least this time stays: the clock was set to another time
_TAKEN_BACK = 10  # each step reduces a shorter shift by at most a tenth of the step


def ticks(seconds: float | Fraction) -> int:
    """Return a time or a span in ticks, of which a second has 705,600,000.

    Parameters
    ----------
    seconds : float or Fraction
        Time or span in seconds; the result is the nearest whole number of ticks.

    Examples
    --------
    >>> import oppload_cli as oppload
    >>> oppload.ticks(1 / 30)
    23520000
    """
    # A float is exact to a hundredth of a tick for more than a day, and several times as fast.
    number = seconds if isinstance(seconds, Fraction) else float(seconds)
    return round(number * TICKS_PER_S)


def seconds_of(time: int) -> float:
    """Return a time or a span in seconds."""
    return time / TICKS_PER_S


class FrameTimes:
    """The presentation times of the frames of one input, in the order of the frames.

    A step is the time between two frames; the usual step is the median of the latest steps. The
    returned times strictly increase. As long as those of the input do not go back, none differs
    from it by more than a tick of the input: frames with the same time are spread inside the tick.
    If a time goes back, the frame gets a time one usual step after the frame before. The clock may
    go on from such an earlier time, for example if somebody sets a camera's clock back. Then all
    later times are shifted by the same amount. If the shift is less than a second, the following
    frames reduce it step by step to 0.

    Parameters
    ----------
    rate : Fraction or float, optional
        Frames per second that the input declares.
    tick_s : Fraction, optional
        Length in seconds of a tick of the input's own clock, if it is known.

    Source: ``docs/time.md``.
    """

    def __init__(self, rate: float | Fraction | None, tick_s: Fraction | None = None) -> None:
        self._declared = Fraction(rate) if rate and 0 < rate < math.inf else None
        self._tick = max(1, ticks(tick_s or 0))
        self._steps: list[int] = []
        self._latest: deque[int] = deque(maxlen=LATEST_STEPS)
        self._corrected = self._given = 0  # times of the latest frame
        self._first = self._shift = self._longest = self._gap_from = 0
        self._slow = 0  # time in which the usual rate was below `_LEAST_RATE`
        self._frames = self._first_wrong = 0
        self._zero_s = math.inf  # see `arrived`
        self._in_bursts = 0  # number of frames that came right after the frame before
        self.wrong = 0  # number of times that were not later than the time before

    def step(self, time: int, *, corrected: bool = False) -> int:
        """Take the time of the next frame in ticks, as the input gives it; return its own time.

        `corrected` tells that the time was wrong, and that another `FrameTimes` put it right.
        """
        before, now = self._corrected, time + self._shift
        if not self._frames:
            self._first = now
        elif corrected or now <= before:
            self._first_wrong = self._first_wrong or self._frames
            self.wrong += 1
            if not corrected:
                now = self._put_right(time, now)
            if self._usual_step() <= self._tick:  # the clock is too coarse for the frame rate
                self._count(now - before)
        else:
            now = self._later(now, now - before)
        self._corrected, self._given = now, time
        self._frames += 1
        return now

    def _put_right(self, time: int, now: int) -> int:
        """Return the time of a frame that is not later than the frame before."""
        before, usual, tick = self._corrected, self._usual_step(), self._tick
        rest = now + tick - before  # of the tick in which the input says that the frame is
        if time >= self._given and rest > 1:
            # The next frames have half of the tick left, a third, a quarter and so on.
            return before + min(usual, rest - rest * tick // (rest + tick))
        if time > self._given:  # the clock goes on from the earlier time
            self._shift = before + usual - time
        return before + usual

    def _later(self, now: int, step: int) -> int:
        """Count a step to a later frame; return its time after a shift was taken back in part."""
        if 0 < self._shift < _LASTING:
            taken_back = min(self._shift, step // _TAKEN_BACK)
            self._shift -= taken_back
            now -= taken_back
        if step > self._longest:
            self._longest, self._gap_from = step, self._corrected
        self._in_bursts += step < _BURST
        self._count(step)
        # The usual step is counted instead of the step, which may be a pause of hours.
        usual = median_low(self._latest)
        if len(self._latest) == LATEST_STEPS and usual * _LEAST_RATE > TICKS_PER_S:
            self._slow += usual
        return now

    def _count(self, step: int) -> None:
        self._latest.append(step)
        if len(self._steps) < _MOST_STEPS:
            self._steps.append(step)

    def _usual_step(self) -> int:
        if self._latest:
            return median_low(self._latest)
        return max(1, ticks(1 / (self._declared or USUAL_RATE)))

    def arrived(self, clock_s: float) -> None:
        """Take the time of day, in seconds since 1970, at which the latest frame arrived.

        Time zero is that of the frame with the least delay.
        """
        self._zero_s = min(self._zero_s, clock_s - seconds_of(self._corrected))

    @property
    def seconds(self) -> float:
        """Time from the first frame to the latest one, in seconds."""
        return seconds_of(self._corrected - self._first)

    @property
    def rate(self) -> float | None:
        """Frames per second, from the usual steps among the first 1024; None for one frame.

        A step is usual if it differs from the median by at most half of the median, or by a tick of
        the input (1 ms if it is not known). The rate is 1 over the mean of these steps; their
        median would be less exact, because files round times.
        """
        if not self._steps:
            return None
        middle = median_low(self._steps)  # one of the steps, so that at least one is usual
        tick = self._tick if self._tick > 1 else _ROUNDED
        spread = max(_USUAL * middle, tick)
        return TICKS_PER_S / fmean(step for step in self._steps if abs(step - middle) <= spread)

    def as_dict(self) -> dict[str, Any]:
        """Return the facts for the sidecar."""
        known = self._zero_s < math.inf
        zero = datetime.fromtimestamp(self._zero_s, UTC).isoformat() if known else None
        return {
            "zero_utc": zero,
            "frames_per_s": None if self.rate is None else round(self.rate, 3),
            "longest_step_s": round(seconds_of(self._longest), 6),
            "not_after_the_one_before": self.wrong,
        }

    def remarks(self) -> list[str]:
        """Return remarks about the times, a sentence each."""
        remarks = []
        if self.wrong:
            have = "has" if self.wrong == 1 else "have"
            remarks.append(
                f"{counted(self.wrong, 'frame')} {have} a time that is not later than that of the "
                f"frame before (the earliest comes {counted(self._first_wrong, 'frame')} after the "
                "first one); equal times are spread inside a tick of the file's clock, and where "
                "the clock goes back it goes on one usual step after the frame before"
            )
        rate = self.rate
        if rate is None:
            return remarks
        most = max(_SHARE_IN_BURSTS * self._frames, _FEW_IN_BURSTS)
        without_pause_s = self.seconds - seconds_of(self._longest)
        if self._in_bursts > most and without_pause_s > 2 * seconds_of(_BURST) * self._frames:
            remarks.append(
                f"{self._in_bursts} frames come less than {1000 * seconds_of(_BURST):.0f} ms after "
                "the frame before, as in bursts over a network; times to contact are wrong unless "
                "the frames have the times at which they were taken"
            )
        if self._declared and abs(rate / self._declared - 1) > _CONTRADICTION:
            remarks.append(
                f"{in_digits(float(self._declared))} frames/s are declared, but the times of most "
                f"frames say {in_digits(rate)}; the times are used"
            )
        longest_s, from_s = seconds_of(self._longest), seconds_of(self._gap_from)
        if rate * longest_s > 2 and longest_s > _GAP_S:
            remarks.append(
                f"the longest time without a frame is {longest_s:.2f} s, from {from_s:.2f} s on; "
                "what happened then was not seen"
            )
        if rate < _LEAST_RATE:
            remarks.append(
                f"{rate:.3g} frames/s are too few for the models, which compare pictures 1/30 s "
                f"apart; below {_LEAST_RATE:.0f} frames/s expect missed approaches"
            )
        elif seconds_of(self._slow) > _FOR_LONG_S:
            remarks.append(
                f"for {seconds_of(self._slow):.0f} s in all, frames came at less than "
                f"{_LEAST_RATE:.0f} per second, too few for the models, which compare pictures "
                "1/30 s apart: expect missed approaches"
            )
        return remarks


def in_digits(rate: float) -> str:
    """Return frames per second as a text without a power of ten."""
    return f"{rate:.0f}" if rate >= 1000 else f"{rate:.4g}"
