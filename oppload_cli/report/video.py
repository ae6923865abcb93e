"""The copy of a result's video that its page plays: H.264 of the page's size, frame by frame."""

from __future__ import annotations

import os
from contextlib import contextmanager
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING

import cv2
import numpy as np
from av.video.reformatter import Colorspace

from oppload_cli.errors import SourceError
from oppload_cli.files.atomic import PartFile, output_errors
from oppload_cli.processes.pool import Seldom
from oppload_cli.processes.threads import Call, Prefetch
from oppload_cli.video.colour import Colour, colour_size
from oppload_cli.video.inputs import Position, Span
from oppload_cli.video.source import source_of, stop
from oppload_cli.video.writers import Recording

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    import av
    from numpy.typing import NDArray

    from oppload_cli.results.reading import BaseResult
    from oppload_cli.video.frames import InputFacts, PictureSource


_LONGEST_SIDE = 960  # px: half a screen, and all of a phone's
MANY_FRAMES, SIDE_OF_MANY = 9000, 720  # px of longer videos, whose pages take time and space
MOST_EMBEDDED = 16 << 20  # bytes; a larger copy is a file beside the page
_STILL_SIDE, _QUALITY = 320, 80  # px and JPEG quality of the picture in the index
_AHEAD = 4  # pictures that wait to be encoded
# A key frame at least every half second at 30 frames/s: a step backwards decodes 15 frames at most.
# With look-ahead, the encoder sometimes gives other bytes for the same frames.
_NO_LOOK_AHEAD = "rc-lookahead=0:mbtree=0"
_CODEC = {"preset": "superfast", "crf": "25", "bf": "0", "g": "15", "x264-params": _NO_LOOK_AHEAD}


@dataclass(frozen=True)
class VideoCopy:
    """The copy of a video.

    Attributes
    ----------
    times_s : ndarray of float64, shape (rows,)
        For each row of the result, when the copy shows its frame; NaN where it never does.
    still : bytes
        The frame of one row as JPEG; empty if it was not decoded.
    content : bytes or None
        The MP4; None where it is a file of its own.
    note : str
        A possible fault of the copy, as a sentence; else empty.
    """

    times_s: NDArray[np.float64]
    still: bytes
    content: bytes | None
    note: str = ""


def copy_video(
    result: BaseResult, name: str, path: Path, *, still: int, tell: Callable[[int], object]
) -> VideoCopy:
    """Encode the frames of a result once more, as every browser plays them.

    Parameters
    ----------
    result : Result
        The rows of this result say which frames.
    name : str
        The video, from :func:`~oppload_cli.results.reading.find_video`.
    path : Path
        The name of the copy where it is too large to be embedded.
    still : int
        The row whose frame is kept as a picture.
    tell : callable
        Takes the number of frames done since its last call.

    Raises
    ------
    SourceError
        If the video cannot be read, or holds none of the frames.
    OutputError
        If the copy cannot be written.
    """
    frames = result.frames["frame"].to_numpy(int)
    rows = {int(frame): row for row, frame in enumerate(frames)}
    span = Span(Position(frame=int(frames[0])), Position(frame=int(frames[-1]) + 1))
    times_s, picture = np.full(len(frames), np.nan), b""
    count = Seldom(tell)
    source = Call(lambda: source_of(name, _image_rate(result), 0)).result()
    size = _even_size(source.facts, len(frames))
    file = PartFile(path)
    ahead: Prefetch[tuple[int, float, av.VideoFrame]] | None = None
    try:
        recording = Recording(file, *size, source.facts.frame_rate, _CODEC)
        with output_errors(path), _abandoned(recording):
            ahead = _ahead(source, span, size)
            for frame, time_s, shown in ahead:
                written_s = recording.write(shown, time_s)
                row = rows.get(frame)
                if row is not None:
                    times_s[row] = written_s
                    picture = _jpeg(shown) if row == still else picture
                count(1)
            count.flush()
            if np.isnan(times_s).all():
                raise SourceError(f"{name}: holds none of the frames of this result")
            recording.finish()
        content = None
        if file.raw.seek(0, os.SEEK_END) <= MOST_EMBEDDED:
            file.raw.seek(0)
            content = file.raw.read()
        else:
            file.commit()
    finally:
        stop(source, ahead)
        file.discard()
    return VideoCopy(times_s, picture, content, _difference(result, name, source.facts, times_s))


def _ahead(
    source: PictureSource, span: Span, size: tuple[int, int]
) -> Prefetch[tuple[int, float, av.VideoFrame]]:
    """Return frames, times and pictures, which a thread decodes ahead of the caller."""
    colour = Colour(source.facts, size)
    pictures = span.within(source)
    return Prefetch(((each.index, each.time_s, colour.planes(each)) for each in pictures), _AHEAD)


@contextmanager
def _abandoned(recording: Recording) -> Iterator[None]:
    """Abandon a recording if an error comes."""
    try:
        yield
    except BaseException:
        recording.abandon()
        raise


def _even_size(facts: InputFacts, frames: int) -> tuple[int, int]:
    """Return the size of the copy; H.264 of these colours has even sides only."""
    longest = _LONGEST_SIDE if frames < MANY_FRAMES else SIDE_OF_MANY
    width, height = colour_size(facts, longest)
    return max(2, width - width % 2), max(2, height - height % 2)


def _image_rate(result: BaseResult) -> Fraction | None:
    try:
        return Fraction(result.part("input")["frame_rate"])
    except (KeyError, TypeError, ValueError, ZeroDivisionError):
        return None


def _jpeg(frame: av.VideoFrame) -> bytes:
    colour = frame.to_ndarray(format="bgr24", src_colorspace=Colorspace.ITU709)
    scale = min(1.0, _STILL_SIDE / max(colour.shape[:2]))
    small = cv2.resize(colour, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    _, data = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
    return data.tobytes()


def _difference(
    result: BaseResult, name: str, facts: InputFacts, times_s: NDArray[np.float64]
) -> str:
    """Return a sentence where this is not the video of the run, or not all of it."""
    stated = result.part("input")
    for fact in ("bytes", "width", "height"):
        before, now = stated.get(fact), getattr(facts, fact)
        if before is not None and now != before:
            return (
                f"{name}: is not the video of the run ({fact} was {before}, is {now}); "
                f"boxes and curves may not fit"
            )
    lost = int(np.isnan(times_s).sum())
    return f"{name}: {lost} frames of the result could not be decoded again" if lost else ""
