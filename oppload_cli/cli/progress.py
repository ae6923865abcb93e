"""Progress on standard error: a bar on a terminal, a plain line now and then elsewhere."""

from __future__ import annotations

import sys
import time
from typing import TYPE_CHECKING, Never

import click

from oppload_cli.cli import stop_if_asked

if TYPE_CHECKING:
    from tqdm import tqdm

    from oppload_cli.results.record import FrameRecord
    from oppload_cli.video.source import Video

LINE_EVERY_S = 30.0


class Progress:
    """Shows how one input gets on.

    Parameters
    ----------
    name : str
        The input.
    verbosity : int
        -1 shows nothing, 0 the progress, 1 also the sizes that the models see.
    whole : bool
        Whether the input is read to its end, so that its length is the total.
    """

    def __init__(self, name: str, verbosity: int, *, whole: bool) -> None:
        self._name = name
        self._verbosity = verbosity
        self._whole = whole
        self._bar: tqdm[Never] | None = None
        self._frames = 0
        self._next_line = time.monotonic() + LINE_EVERY_S

    def opened(self, video: Video) -> None:
        """Show the sizes, and start the bar.

        Parameters
        ----------
        video : Video
            The open input.
        """
        if self._verbosity >= 1:
            click.echo(described(video), err=True)
        if self._verbosity >= 0 and sys.stderr.isatty():
            from tqdm import tqdm  # noqa: PLC0415 - only where a bar is shown

            total = video.facts.frames_declared if self._whole else None
            self._bar = tqdm(total=total, desc=self._name, unit="frame", leave=False)

    def frame(self, record: FrameRecord) -> None:
        """Count a frame.

        Parameters
        ----------
        record : FrameRecord
            The frame.
        """
        stop_if_asked()
        self._frames += 1
        if self._bar is not None:
            self._bar.update()
        elif self._verbosity >= 0 and time.monotonic() >= self._next_line:
            self._next_line += LINE_EVERY_S
            click.echo(f"{self._name}: {self._frames} frames, {record.time_s:.1f} s", err=True)

    def close(self) -> None:
        """Take the bar away; its total was only what the container declared."""
        if self._bar is not None:
            self._bar.total = self._frames
            self._bar.close()


def described(video: Video) -> str:
    """Say in one line at which size the models see an input, and what 1 px/frame means there.

    Parameters
    ----------
    video : Video
        The open input.

    Returns
    -------
    str
    """
    facts, working = video.facts, video.working
    rate = float(facts.frame_rate) if facts.frame_rate else None
    timing = f" at {rate:.6g} frames/s" if rate else ""
    per_second = f" = {working.scale_x * rate:.4g} source px/s" if rate else ""
    return (
        f"{facts.name}: {facts.width} x {facts.height}{timing}, seen at "
        f"{working.width} x {working.height}; 1 px/frame there = "
        f"{working.scale_x:.4g} source px/frame{per_second}"
    )
