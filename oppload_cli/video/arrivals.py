"""When frames were taken, estimated from the times at which they arrive."""

from __future__ import annotations

import math
from collections import deque
from itertools import accumulate, pairwise
from statistics import fmean, linear_regression

_MOST, _FEWEST = 30, 15  # frames through which the line is fitted
# Delays that do not depend on each other scatter about the line by 0.71 of the scatter of the
# steps, bursts by less. Uneven steps of the camera add up, to about 1.4 over 30 frames.
_MOST_SCATTER = 0.85
_BETTER = 0.4  # lost frames are counted if the line then fits this much better
_MOST_OFF, _ROUNDING_S = 3.0, 0.002  # distance from the line, in standard deviations, plus a time
_MOST_LOST = 7  # in a row; a step of more pictures beside shorter ones comes from a burst
_PAUSE_S = 0.5  # after a longer time without a frame the line begins anew
_LEAST_STEP_S = 0.001


class Arrivals:
    """Smooths the times of arrival of frames that have no other time.

    A camera takes pictures in equal steps, but each one has another delay on its way, and some are
    lost. So the time of a frame is the value of a line through the latest 30 arrivals, over the
    number of the picture. It is the time of arrival itself

    - for the first frames, and after a pause;
    - if the arrivals scatter about the line as uneven steps of the camera would;
    - if the frame arrives much further from the line than those before it.

    A time depends only on this frame and those before it, and is always later than the time before.
    `smoothed` is the number of frames whose time is the line's. Source: ``docs/howto/camera.md``.
    """

    def __init__(self) -> None:
        self.smoothed = 0
        self._latest: deque[float] = deque(maxlen=_MOST)
        self._spread_s = 0.0  # the scatter about the line, up to the frame before
        self._before_s = -math.inf

    def step(self, arrived_s: float) -> float:
        """Take the time of arrival of the next frame, in seconds; return the frame's time."""
        if self._latest and arrived_s - self._latest[-1] > _PAUSE_S:
            self._latest.clear()
        self._latest.append(arrived_s)
        time_s = arrived_s
        if len(self._latest) >= _FEWEST - 1:
            most_s = _MOST_OFF * self._spread_s + _ROUNDING_S
            line_s, self._spread_s, is_even = self._line()
            if len(self._latest) >= _FEWEST and is_even and abs(arrived_s - line_s) <= most_s:
                time_s = line_s
                self.smoothed += 1
        self._before_s = max(time_s, self._before_s + _LEAST_STEP_S)
        return self._before_s

    def _line(self) -> tuple[float, float, bool]:
        """Return the line's latest value, the scatter about it, and whether the steps are even."""
        steps = [after - before for before, after in pairwise(self._latest)]
        by_length = sorted(steps)
        # Of steps of one and two pictures, one of these lasts for one picture.
        short_s, usual_s = by_length[len(steps) // 4], by_length[len(steps) // 2]
        best = self._fit([1] * len(steps), steps)
        for period_s in (short_s, usual_s / 2):
            pictures = [round(step / period_s) for step in steps] if period_s > 0 else [0]
            if min(pictures) > 0 and 1 < max(pictures) <= _MOST_LOST + 1:
                fit = self._fit(pictures, steps)
                best = fit if fit[1] < _BETTER * best[1] else best
        return best

    def _fit(self, pictures: list[int], steps: list[float]) -> tuple[float, float, bool]:
        """Fit the line, with the number of pictures that each step takes; return as `_line`."""
        numbers = list(accumulate(pictures, initial=0))
        period_s, first_s = linear_regression(numbers, self._latest)
        off = [
            arrival_s - first_s - period_s * n
            for n, arrival_s in zip(numbers, self._latest, strict=True)
        ]
        spread_s = _scatter(off)
        uneven_s = _scatter([s - period_s * n for n, s in zip(pictures, steps, strict=True)])
        return self._latest[-1] - off[-1], spread_s, spread_s <= _MOST_SCATTER * uneven_s


def _scatter(values: list[float]) -> float:
    """Return the standard deviation; the one of `statistics` is slower."""
    middle = fmean(values)
    return math.sqrt(fmean((value - middle) ** 2 for value in values))
