"""Which part of an input is analysed: ``--start``, ``--end`` and ``--duration``."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

from oppload_cli.errors import ParameterError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from oppload_cli.video.frames import Picture, PictureSource

CLOCK = re.compile(r"(?:(\d+):)?(\d{1,2}):(\d{1,2}(?:\.\d+)?)")


@dataclass(frozen=True)
class Position:
    """A place in an input: a frame ordinal or a presentation time, never both."""

    frame: int | None = None
    seconds: float | None = None

    def reached(self, frame: int, seconds: float) -> bool:
        """Tell whether a frame lies at or after this place.

        Parameters
        ----------
        frame : int
            The frame's decode ordinal, from 0.
        seconds : float
            Its presentation time minus that of frame 0.

        Returns
        -------
        bool
        """
        if self.frame is not None:
            return frame >= self.frame
        return self.seconds is not None and seconds >= self.seconds - 1e-9

    def after(self, frame: int, seconds: float) -> Position:
        """Return the place that lies this far after a frame.

        Parameters
        ----------
        frame, seconds
            Where it is counted from.

        Returns
        -------
        Position
        """
        if self.frame is not None:
            return Position(frame=frame + self.frame)
        return Position(seconds=seconds + (self.seconds or 0.0))


@dataclass(frozen=True)
class Span:
    """The part of an input from `start` to before `end`, or for `duration`.

    Raises
    ------
    ParameterError
        If both an end and a duration are given.
    """

    start: Position | None = None
    end: Position | None = None
    duration: Position | None = None

    def __post_init__(self) -> None:
        if self.end and self.duration:
            raise ParameterError("--end and --duration exclude each other; give one of them")

    @property
    def open_ended(self) -> bool:
        """Whether the input is read to its own end."""
        return self.end is None and self.duration is None

    def within(self, source: PictureSource) -> Iterator[Picture]:
        """Yield the pictures in this part. There is no seeking: what comes before is decoded.

        Parameters
        ----------
        source : PictureSource
            Told to finish if this part goes to its own end.

        Yields
        ------
        Picture
        """
        started, end = self.start is None, self.end
        for picture in source.pictures():
            if source.stopping:
                return
            place = (picture.index, picture.time_s)
            if not started:
                if self.start is not None and not self.start.reached(*place):
                    continue
                started = True
            if end is None and self.duration is not None:
                end = self.duration.after(*place)
            if end is not None and end.reached(*place):
                return
            yield picture
        source.finish()


def parse_position(text: str) -> Position:
    """Read a position: bare numbers are seconds, ``f300`` a frame, ``00:01:02.5`` a clock.

    Parameters
    ----------
    text : str
        As written by the user.

    Returns
    -------
    Position

    Raises
    ------
    ParameterError
        If it is none of the three.
    """
    if re.fullmatch(r"f\d+", text):
        return Position(frame=int(text[1:]))
    clock = CLOCK.fullmatch(text)
    if clock:
        hours, minutes, seconds = clock.groups(default="0")
        return Position(seconds=int(hours) * 3600 + int(minutes) * 60 + float(seconds))
    try:
        seconds_only = float(text)
    except ValueError:
        seconds_only = math.nan
    if not (math.isfinite(seconds_only) and seconds_only >= 0):
        raise ParameterError(
            f"'{text}' is no position; write seconds (12.5), a frame (f300) or a clock (00:01:02.5)"
        )
    return Position(seconds=seconds_only)
