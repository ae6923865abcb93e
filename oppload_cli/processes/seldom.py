"""Counts on their way from one process to another."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

TELL_EVERY_S = 0.25


class Seldom:
    """A count that is passed on now and then: each message costs both processes time.

    Parameters
    ----------
    tell : callable
        Called with what came since its last call.
    every_s : float
        Seconds between two calls, at least.
    """

    def __init__(self, tell: Callable[[int], object], every_s: float = TELL_EVERY_S) -> None:
        self._tell = tell
        self._every_s = every_s
        self._count = 0
        self._next = time.monotonic() + every_s

    def __call__(self, count: int) -> None:
        """Count more.

        Parameters
        ----------
        count : int
            How many, at least 0.
        """
        self._count += count
        if time.monotonic() >= self._next:
            self.flush()

    def flush(self) -> None:
        """Pass on what was not yet."""
        if self._count:
            self._tell(self._count)
        self._count = 0
        self._next = time.monotonic() + self._every_s
