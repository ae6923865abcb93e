"""Counting frames for whoever watches a batch, a few at a time."""

from __future__ import annotations

from typing import TYPE_CHECKING

from oppload_cli.processes.seldom import TELL_EVERY_S, Seldom

if TYPE_CHECKING:
    from collections.abc import Callable

    from oppload_cli.results.record import FrameRecord
    from oppload_cli.video.source import Video


class Counting:
    """A watcher of one task that passes on how many frames came.

    Parameters
    ----------
    tell : callable
        Called with a number of frames; what it raises ends the task.
    every_s : float
        Seconds between two calls, at least.
    """

    def __init__(self, tell: Callable[[int], object], every_s: float = TELL_EVERY_S) -> None:
        self._count = Seldom(tell, every_s)

    def opened(self, video: Video) -> None:
        """Do nothing: a batch shows inputs, not their sizes.

        Parameters
        ----------
        video : Video
            The open input.
        """

    def frame(self, record: FrameRecord) -> None:  # noqa: ARG002 - only its coming counts
        """Count a frame.

        Parameters
        ----------
        record : FrameRecord
            The frame.
        """
        self._count(1)

    def flush(self) -> None:
        """Pass on what was not yet."""
        self._count.flush()
