"""H.264 in colour, with any presentation times: what a browser plays."""

from __future__ import annotations

import math
from contextlib import contextmanager, suppress
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import av
from av.video.reformatter import VideoReformatter

from oppload_cli.errors import OutputError
from oppload_cli.video.sink import Sink

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    import numpy as np
    from numpy.typing import NDArray

TICKS_HZ = 90_000  # holds the frame times of 24, 25, 30, 50, 60 and 1000 frames/s
MOST_TICKS_HZ = 1_000_000  # FFmpeg has 31 bits for the time between two frames
CLOCK_BACK_S, CLOCK_ON_S = 1.0, 900.0  # from here on a source's clock was set anew
USUAL_RATE = Fraction(30)  # frames/s where the source states none
BT709, LIMITED = 1, 1  # AVCOL_*_BT709, AVCOL_RANGE_MPEG
EXACTLY = 0x2 | 0x40000 | 0x80000  # SWS_BILINEAR, SWS_ACCURATE_RND, SWS_BITEXACT
# Two threads whatever the machine: another number gives other bytes.
THREADS = 2
# No frame is predicted from a later one: then decoding order is that of the times.
CODEC = {"preset": "superfast", "crf": "22", "bf": "0"}
# No dates and no random identifiers; the index first, so that it plays while it loads.
CONTAINER = {"fflags": "+bitexact", "movflags": "+faststart"}


def ticks_hz(rate: Fraction | None) -> int:
    """Return the ticks per second in which frame times are written.

    Parameters
    ----------
    rate : Fraction or None
        Frames per second of the source.

    Returns
    -------
    int
        A multiple of 90000 that holds the times of this rate exactly, up to 10^6;
        else 90000.
    """
    exact = math.lcm(TICKS_HZ, rate.numerator) if rate else TICKS_HZ
    return exact if exact <= MOST_TICKS_HZ else TICKS_HZ


class Recording:
    """Writes an MP4 of 8-bit H.264 (yuv420p, BT.709, limited range).

    Parameters
    ----------
    part : Path
        What to write.
    width, height : int
        Of every frame, in pixels; both even.
    rate : Fraction or None
        Frames per second of the source, as far as it is known.

    Raises
    ------
    OSError
        If the file cannot be written; also by the other methods.
    OutputError
        If this installation has no H.264 encoder.

    Attributes
    ----------
    frames : int
        How many are written.
    """

    def __init__(self, part: Path, width: int, height: int, rate: Fraction | None) -> None:
        self._hz = ticks_hz(rate)
        self._tick = Fraction(1, self._hz)
        self._frame_s = float(1 / (rate or USUAL_RATE))
        self.frames = 0
        self._origin_s = 0.0
        self._last = -1
        self._converter = VideoReformatter()
        self._sink = Sink(part)
        try:
            self._container: Any = av.open(self._sink, "w", format="mp4", options=CONTAINER)
            self._stream = self._added(width, height, rate or USUAL_RATE)
        except BaseException as error:
            self._sink.fail(OSError("abandoned"))
            if isinstance(error, av.codec.codec.UnknownCodecError):
                raise OutputError(
                    f"{part}: this PyAV has no H.264 encoder; install the wheel of PyPI"
                ) from error
            raise

    def write(self, picture: NDArray[np.uint8], time_s: float) -> None:
        """Write the next frame.

        Parameters
        ----------
        picture : ndarray of uint8, shape (height, width, 3)
            Blue, green and red.
        time_s : float
            Its presentation time in seconds; the first one's becomes 0. One that is
            not later than the one before is put right after it; where the clock jumps
            (back by a second, or on by a quarter of an hour) it goes on a frame later.
        """
        frame = self._converter.reformat(
            av.VideoFrame.from_ndarray(picture, "bgr24"),
            format="yuv420p",
            dst_colorspace=BT709,
            dst_color_range=LIMITED,
            interpolation=EXACTLY,
            threads=1,
        )
        frame.pts, frame.time_base = self._ticks(time_s), self._tick
        with self._errors():
            self._container.mux(self._stream.encode(frame))
        self.frames += 1

    def finish(self) -> None:
        """Write what the encoder still holds, and the index."""
        with self._errors():
            if self.frames:
                self._container.mux(self._stream.encode())
            self._container.close()
        self._sink.close()

    def abandon(self) -> None:
        """Close the file as it is; it cannot be played."""
        self._sink.fail(OSError("abandoned"))
        # The sink tells that once more, and the library passes it on.
        with suppress(OSError, av.error.FFmpegError):
            self._container.close()
        with suppress(OSError):
            self._sink.close()

    @contextmanager
    def _errors(self) -> Iterator[None]:
        """Raise what the disk said, or else what the library says, as an OSError."""
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
        elif not -CLOCK_BACK_S < time_s - self._origin_s - last_s < CLOCK_ON_S:
            self._origin_s = time_s - last_s - self._frame_s
        self._last = max(self._last + 1, round((time_s - self._origin_s) * self._hz))
        return self._last

    def _added(self, width: int, height: int, rate: Fraction) -> Any:
        stream: Any = self._container.add_stream("libx264", rate=rate, options=CODEC)
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        context = stream.codec_context
        stream.time_base = context.time_base = self._tick
        context.thread_count = THREADS
        context.bit_rate = 0
        context.color_range = LIMITED
        context.colorspace = context.color_primaries = context.color_trc = BT709
        return stream
