"""H.264 in colour, with any presentation times, as browsers play it."""

from __future__ import annotations

import math
from contextlib import contextmanager, suppress
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import av
from av.video.reformatter import (
    ColorPrimaries,
    ColorRange,
    Colorspace,
    ColorTrc,
    VideoReformatter,
)

from oppload_cli.errors import OutputError
from oppload_cli.video.colour import as_yuv420p
from oppload_cli.video.frames import USUAL_RATE

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from io import FileIO

    import numpy as np
    from numpy.typing import NDArray

    from oppload_cli.files.atomic import PartFile


class Sink:
    """A file that keeps an error to itself until `check` or `close`.

    The encoder's library calls it from C, where an exception cannot pass: a full disk
    would be printed as a stack of tracebacks.

    Parameters
    ----------
    file : FileIO
        The file; it stays open.
    """

    def __init__(self, file: FileIO) -> None:
        # The library reads the file back by this name; "a:b" alone would be an address.
        self.name = f"file:{file.name}"
        self._file = file
        self._problem: OSError | None = None

    def write(self, data: bytes) -> int:
        """Write the data, unless an error has happened before."""
        if self._problem is None:
            try:
                rest = memoryview(data)
                while rest:
                    rest = rest[self._file.write(rest) :]
            except OSError as problem:
                self._problem = problem
        return len(data)

    def seek(self, offset: int, origin: int = 0, /) -> int:
        """Go to a position; return it."""
        if self._problem is None:
            try:
                return self._file.seek(offset, origin)
            except OSError as problem:
                self._problem = problem
        return 0

    def tell(self) -> int:
        """Return the position."""
        return self._file.tell() if self._problem is None else 0

    def fail(self, problem: OSError) -> None:
        """Write nothing more."""
        self._problem = self._problem or problem

    def check(self) -> None:
        """Raise the error, if one has happened."""
        if self._problem is not None:
            raise self._problem


_TICKS_HZ = 90_000  # holds the frame times of 24, 25, 30, 50, 60 and 1000 frames/s
_MOST_TICKS_HZ = 1_000_000  # FFmpeg has 31 bits for the time between two frames
_CLOCK_BACK_S, _CLOCK_ON_S = 1.0, 900.0  # a larger step means that the source's clock was reset
# By itself x264 chooses algorithms by the processor, some of which only approximate.
ON_ANY_PROCESSOR = {"x264-params": "cpu-independent=1"}
# Two threads on every machine: another number gives other bytes.
_THREADS = 2
# No frame is predicted from a later one: then decoding order is that of the times.
_CODEC = {"preset": "superfast", "crf": "22", "bf": "0", **ON_ANY_PROCESSOR}
# No dates and no random identifiers; the index first, so that it plays while it loads.
_CONTAINER = {"fflags": "+bitexact", "movflags": "+faststart"}


def _ticks_hz(rate: Fraction | None) -> int:
    """Return the ticks per second of the frame times of a source.

    It is a multiple of 90000 that holds the times of its frame rate exactly, if one up
    to 10^6 exists, else 90000.
    """
    exact = math.lcm(_TICKS_HZ, rate.numerator) if rate else _TICKS_HZ
    return exact if exact <= _MOST_TICKS_HZ else _TICKS_HZ


class Recording:
    """Writes an MP4 of 8-bit H.264 (yuv420p, BT.709, limited range).

    Parameters
    ----------
    part : PartFile
        The file.
    width, height : int
        Of every frame, in pixels; both even.
    rate : Fraction or None
        Frames per second of the source, if known.
    codec : mapping of str to str
        Options of the encoder; without ``bf: 0`` frames would not be in the order of the file.

    Raises
    ------
    OSError
        If the file cannot be written; also by the other methods.
    OutputError
        If this installation has no H.264 encoder.
    """

    def __init__(
        self,
        part: PartFile,
        width: int,
        height: int,
        rate: Fraction | None,
        codec: Mapping[str, str] = _CODEC,
    ) -> None:
        self._hz = _ticks_hz(rate)
        self._tick = Fraction(1, self._hz)
        self._frame_s = float(1 / (rate or USUAL_RATE))
        self.frames = 0
        self._origin_s = 0.0
        self._last = -1
        self._converter = VideoReformatter()
        self._sink = Sink(part.raw)
        try:
            self._container: Any = av.open(self._sink, "w", format="mp4", options=_CONTAINER)
            self._stream = self._added(width, height, rate or USUAL_RATE, codec)
        except BaseException as error:
            self._sink.fail(OSError("abandoned"))
            if isinstance(error, av.codec.codec.UnknownCodecError):
                raise OutputError(
                    f"{part.path}: this PyAV has no H.264 encoder; install the wheel of PyPI"
                ) from error
            raise

    def write(self, picture: NDArray[np.uint8] | av.VideoFrame, time_s: float) -> float:
        """Write the next frame.

        Parameters
        ----------
        picture : ndarray of uint8, shape (height, width, 3)
            Blue, green and red; or a frame in the file's own format, from
            :meth:`oppload_cli.video.colour.Colour.planes`.
        time_s : float
            Presentation time of the frame in seconds; the first frame's becomes 0. A time that is
            not later than the one before is put directly after that one; where the clock jumps
            (back by a second, or on by a quarter of an hour) the frame comes one frame later.

        Returns
        -------
        float
            Presentation time of the frame in the file, in seconds.
        """
        frame = picture
        if not isinstance(frame, av.VideoFrame):
            frame = as_yuv420p(av.VideoFrame.from_ndarray(frame, "bgr24"), self._converter)
        frame.pts, frame.time_base = self._ticks(time_s), self._tick
        with self._errors():
            self._container.mux(self._stream.encode(frame))
        self.frames += 1
        return self._last / self._hz

    def finish(self) -> None:
        """Write the frames that the encoder still holds, and the index."""
        with self._errors():
            if self.frames:
                self._container.mux(self._stream.encode())
            self._container.close()
        self._sink.check()

    def abandon(self) -> None:
        """Stop writing; the file cannot be played."""
        self._sink.fail(OSError("abandoned"))
        # The sink raises its error once more, and the library passes it on.
        with suppress(OSError, av.error.FFmpegError):
            self._container.close()

    @contextmanager
    def _errors(self) -> Iterator[None]:
        """Raise the error of the disk, or else that of the library, as an OSError."""
        try:
            yield
        except av.error.FFmpegError as error:
            self._sink.check()
            raise OSError(error.errno, error.strerror) from error
        self._sink.check()

    def _ticks(self, time_s: float) -> int:
        last_s = self._last / self._hz
        if self.frames == 0:
            self._origin_s = time_s
        elif not -_CLOCK_BACK_S < time_s - self._origin_s - last_s < _CLOCK_ON_S:
            self._origin_s = time_s - last_s - self._frame_s
        self._last = max(self._last + 1, round((time_s - self._origin_s) * self._hz))
        return self._last

    def _added(self, width: int, height: int, rate: Fraction, codec: Mapping[str, str]) -> Any:
        stream: Any = self._container.add_stream("libx264", rate=rate, options=dict(codec))
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        context = stream.codec_context
        stream.time_base = context.time_base = self._tick
        context.thread_count = _THREADS
        context.bit_rate = 0
        context.color_range, context.colorspace = ColorRange.MPEG, Colorspace.ITU709
        context.color_primaries, context.color_trc = ColorPrimaries.BT709, ColorTrc.BT709
        return stream
