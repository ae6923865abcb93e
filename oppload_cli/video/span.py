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


_CLOCK = re.compile(r"(?:([0-9]{1,9}):)?([0-9]{1,2}):([0-9]{1,2}(?:\.[0-9]{1,99})?)")


@dataclass(frozen=True)
class Position:
    """A position in an input: a frame ordinal or a presentation time, never both.

    Examples
    --------
    >>> import oppload_cli as oppload
    >>> oppload.Position(frame=30).seconds is None
    True
    """

    frame: int | None = None
    seconds: float | None = None

    def reached(self, frame: int, seconds: float) -> bool:
        """Tell whether a frame, given by its ordinal and time, lies at or after this position."""
        if self.frame is not None:
            return frame >= self.frame
        return self.seconds is not None and seconds >= self.seconds - 1e-9

    def after(self, frame: int, seconds: float) -> Position:
        """Return the position that lies this far after a frame."""
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

    Examples
    --------
    >>> import oppload_cli as oppload
    >>> second = oppload.Span(oppload.Position(seconds=1), duration=oppload.Position(seconds=1))
    >>> second.start.seconds
    1
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
        """Yield the pictures in this part; those before it are decoded and dropped.

        Parameters
        ----------
        source : PictureSource
            Its `finish` is called if this part reaches its end.
        """
        started, end = self.start is None, self.end
        for picture in source.pictures():
            if source.stopping:
                return
            position = (picture.index, picture.time_s)
            if not started:
                if self.start is not None and not self.start.reached(*position):
                    continue
                started = True
            if end is None and self.duration is not None:
                end = self.duration.after(*position)
            if end is not None and end.reached(*position):
                return
            yield picture
        source.finish()


def parse_position(text: str) -> Position:
    """Read a position: bare numbers are seconds, ``f300`` a frame, ``00:01:02.5`` a clock.

    Raises
    ------
    ParameterError
        If the text is none of the three.
    """
    if re.fullmatch(r"f[0-9]{1,18}", text):
        return Position(frame=int(text[1:]))
    clock = _CLOCK.fullmatch(text)
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
