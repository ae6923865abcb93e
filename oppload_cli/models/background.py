"""The background of a response: its recent median, without the latest moment."""

from __future__ import annotations

from bisect import bisect_left, insort
from collections import deque

MOST = 1 << 14  # values that are kept, also where times stand still


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

    def reset(self) -> None:
        """Forget all values."""
        self._waiting.clear()
        self._counted.clear()
        self._sorted.clear()

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
            The median of the background before it (of an even number of values, the
            upper one in the middle); 0 where there is none yet.
        """
        while self._waiting and self._waiting[0][0] < time - self._guard:
            counted = self._waiting.popleft()
            self._counted.append(counted)
            insort(self._sorted, counted[1])
        oldest = time - self._guard - self._reach
        while self._counted and (self._counted[0][0] < oldest or len(self._counted) > MOST):
            del self._sorted[bisect_left(self._sorted, self._counted.popleft()[1])]
        if len(self._waiting) < MOST:
            self._waiting.append((time, value))
        return self._sorted[len(self._sorted) // 2] if self._sorted else 0.0
