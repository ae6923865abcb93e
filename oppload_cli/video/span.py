"""What of an input is read: the part that ``--start`` and ``--end`` choose, stream, and rate."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, replace
from fractions import Fraction
from numbers import Real
from typing import TYPE_CHECKING, Any, NamedTuple

from oppload_cli.errors import ParameterError
from oppload_cli.frame_times import FrameTimes, ticks
from oppload_cli.schema import is_integer

if TYPE_CHECKING:
    from collections.abc import Iterator

    from oppload_cli.video.frames import Picture, PictureSource

_CLOCK = re.compile(r"(?:([0-9]{1,9}):)?([0-9]{1,2}):([0-9]{1,2}(?:\.[0-9]{1,99})?)")


class Reading(NamedTuple):
    """What a user states about an input that its file does not say, or says otherwise.

    Attributes
    ----------
    image_rate : Fraction or None
        Frames per second of images; None for that of their ground truth, or 30.
    true_rate : Fraction or None
        Frames per second that the camera took; None for those of the file.
    stream : int or None
        The number of the video stream, from 1; None for the one that programs show.
    """

    image_rate: Fraction | None = None
    true_rate: Fraction | None = None
    stream: int | None = None


@dataclass(frozen=True)
class Position:
    """A position in an input: the number of a frame, or a presentation time.

    Raises
    ------
    ParameterError
        If both `frame` and `seconds` are given, or neither, or if the frame is not a whole number
        of at least 0, or the time is not a finite number of at least 0.

    Examples
    --------
    >>> import oppload_cli as oppload
    >>> oppload.Position(frame=30).seconds is None
    True
    """

    frame: int | None = None
    seconds: float | None = None

    def __post_init__(self) -> None:
        frame: Any = self.frame  # a caller may give a text, in spite of the type
        seconds: Any = self.seconds
        if (frame is None) == (seconds is None):
            raise ParameterError("a position is a frame or a number of seconds; give one of them")
        if frame is not None and not is_integer(frame, 0):
            raise ParameterError(
                f"the frame of a position must be a whole number of at least 0, not {frame!r}"
            )
        if seconds is not None and not (
            isinstance(seconds, Real) and 0 <= float(seconds) < math.inf
        ):
            raise ParameterError(
                f"the seconds of a position must be a finite number of at least 0, not {seconds!r}"
            )

    def reached(self, frame: int, time: int, begin: tuple[int, int] = (0, 0)) -> bool:
        """Return whether a frame is at or after this position, counted from another frame.

        Both are given by their number and their time in ticks; `begin` is the input's first frame
        if left out.
        """
        if self.frame is not None:
            return frame >= begin[0] + self.frame
        # A Fraction, because ticks of the largest floats are infinite.
        return time >= begin[1] + ticks(Fraction(float(self.seconds or 0)))


@dataclass(frozen=True)
class Span:
    """The part of an input that begins at `start` and ends before `end`, or after `duration`.

    Raises
    ------
    ParameterError
        If both an end and a duration are given, or a value is no `Position`.

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
            raise ParameterError("end and duration exclude each other; give one of them")
        given: tuple[object, ...] = self.start, self.end, self.duration
        for position in given:
            if not isinstance(position, Position | None):
                raise ParameterError(
                    f"a span has positions, such as Position(seconds=1.5), not {position!r}"
                )

    @property
    def open_ended(self) -> bool:
        """Whether the input is read to its end."""
        return self.end is None and self.duration is None

    def within(self, source: PictureSource) -> Iterator[Picture]:
        """Yield the pictures in this part; decode and drop those before it.

        Positions are compared with the corrected times of :class:`FrameTimes`. If this part has a
        start, its pictures also get these times, which they would have in the complete input. If
        this part reaches the end of the input, it calls `finish` of the source.
        """
        times = FrameTimes(source.facts.rate_declared, source.facts.tick_s)
        start, end, begin = self.start, self.end or self.duration, (0, 0)
        first = True
        for picture in source.pictures():
            if source.stopping:
                return
            wrong_before = times.wrong
            time = times.step(picture.time)
            if start is not None:
                if not start.reached(picture.index, time):
                    continue
                start = None  # it is reached
            if first and self.duration is not None:  # it counts from the first picture
                begin = picture.index, time
            first = False
            if end is not None and end.reached(picture.index, time, begin):
                return
            if self.start is None:
                yield picture
            else:
                wrong = times.wrong > wrong_before
                yield replace(picture, time=time, corrected=wrong)
        source.finish()


def parse_position(text: str) -> Position:
    """Return the position of a text: seconds ``12.5`` or ``12.5s``, a frame ``f300``, a clock.

    Raises ParameterError for any other text.
    """
    if re.fullmatch(r"f[0-9]{1,18}", text):
        return Position(frame=int(text[1:]))
    clock = _CLOCK.fullmatch(text)
    if clock:
        hours, minutes, seconds = clock.groups(default="0")
        return Position(seconds=int(hours) * 3600 + int(minutes) * 60 + float(seconds))
    try:
        return Position(seconds=float(text.removesuffix("s")))
    except ValueError as error:  # ParameterError is one too
        raise ParameterError(
            f"'{text}' is no position; write seconds (12.5), a frame (f300) or a clock (00:01:02.5)"
        ) from error
