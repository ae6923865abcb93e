"""Progress on standard error: a bar on a terminal, a plain line now and then elsewhere."""

from __future__ import annotations

import os.path
import time
from typing import TYPE_CHECKING, Never

import click

from oppload_cli.cli import on_terminal, say
from oppload_cli.errors import printable
from oppload_cli.interruption import stop_if_asked

if TYPE_CHECKING:
    from collections.abc import Iterable

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
        if self._verbosity >= 0 and on_terminal():
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


class BatchProgress:
    """Shows how many inputs get on: one bar over the inputs, with those that are running.

    Parameters
    ----------
    total : int
        Number of inputs.
    verbosity : int
        -1 shows nothing, 0 the progress.
    """

    def __init__(self, total: int, verbosity: int) -> None:
        self._total = total
        self._verbosity = verbosity
        self._running: dict[str, None] = {}
        self._done = self._frames = 0
        self._started = time.monotonic()
        self._next_line = self._started + LINE_EVERY_S
        self._bar: tqdm[Never] | None = None
        if verbosity >= 0 and on_terminal():
            from tqdm import tqdm  # noqa: PLC0415 - only where a bar is shown

            self._bar = tqdm(total=total, unit="input", leave=False, dynamic_ncols=True)

    @property
    def on_terminal(self) -> bool:
        """Whether a bar is shown."""
        return self._bar is not None

    def started(self, name: str) -> None:
        """Name an input among those that are running.

        Parameters
        ----------
        name : str
            The input.
        """
        self._running[name] = None
        self.frames(0)

    def frames(self, count: int) -> None:
        """Count frames.

        Parameters
        ----------
        count : int
            How many more.
        """
        self._frames += count
        if self._bar is not None:
            self._bar.set_postfix_str(self._now(), refresh=count > 0)
        elif self._verbosity >= 0 and time.monotonic() >= self._next_line:
            self._next_line = time.monotonic() + LINE_EVERY_S
            say(f"{self._done} of {self._total} inputs, {self._now()}")

    def ended(self, name: str, lines: Iterable[str]) -> None:
        """Count an input, and print what is to be said of it.

        Parameters
        ----------
        name : str
            The input.
        lines : iterable of str
            What to print.
        """
        self._running.pop(name, None)
        self._done += 1
        if self._bar is not None:
            self._bar.clear()
        for line in lines:
            say(line)
        if self._bar is not None:
            self._bar.set_postfix_str(self._now(), refresh=False)
            self._bar.update()

    def close(self) -> None:
        """Take the bar away."""
        if self._bar is not None:
            self._bar.close()

    def _now(self) -> str:
        seconds = time.monotonic() - self._started
        running = ", ".join(printable(os.path.basename(name)) for name in self._running)  # noqa: PTH119
        return f"{self._frames / max(seconds, 1e-3):.0f} frames/s, {running}"


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
