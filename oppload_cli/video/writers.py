"""Makes colour pictures of frames, and writes videos: colour for browsers, grey in several formats.

The same frames always give the same bytes.
"""

from __future__ import annotations

import errno
import io
import math
import os
import zipfile
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING, Any, NamedTuple

import av
import cv2
import numpy as np
from av.video.reformatter import (
    ColorPrimaries,
    ColorRange,
    Colorspace,
    ColorTrc,
    Interpolation,
    VideoReformatter,
)
from PIL import Image

from oppload_cli.errors import OutputError
from oppload_cli.files.atomic import PartFile, PartFolder
from oppload_cli.frame_times import USUAL_RATE
from oppload_cli.video.frames import turned
from oppload_cli.video.luminance import as_displayed, luminance_table
from oppload_cli.video.planes import convertible, resized

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping
    from io import FileIO
    from pathlib import Path

    from numpy.typing import NDArray

    from oppload_cli.video.frames import InputFacts, Picture

    Grey = NDArray[np.uint8]
    Bgr = NDArray[np.uint8]  # rows x columns x 3: blue, green, red


# ---- Colour pictures, as they are displayed ------------------------------------------------

LONGEST_SIDE = 1920  # px; larger pictures are reduced
_EXACT_SCALING = Interpolation.BILINEAR | Interpolation.ACCURATE_RND | Interpolation.BITEXACT
_UNSPECIFIED = 2  # AVCOL_SPC_UNSPECIFIED
_STANDARD_LINES = 576  # pictures with more lines that state no colour space use BT.709


def colour_size(facts: InputFacts, longest: int = LONGEST_SIDE) -> tuple[int, int]:
    """Return width and height of an input's colour pictures: no side is above `longest` px."""
    scale = min(1.0, longest / max(facts.width, facts.height))
    return max(1, round(facts.width * scale)), max(1, round(facts.height * scale))


def _as_yuv420p(
    frame: av.VideoFrame,
    converter: VideoReformatter,
    size: tuple[int | None, int | None] = (None, None),
    colour_space: int | None = None,
) -> av.VideoFrame:
    """Return a frame in the format that the H.264 encoder takes: yuv420p, BT.709, limited range.

    `converter` keeps its tables for the next frame of the same size. If left out, `size` (width and
    height) is that of `frame`, and `colour_space` the one that `frame` states.
    """
    return converter.reformat(
        frame, *size, "yuv420p", colour_space, Colorspace.ITU709,
        dst_color_range=ColorRange.MPEG, interpolation=_EXACT_SCALING, threads=1,
    )  # fmt: skip


class Colour:
    """Makes the colour pictures of one input, all of the same size.

    `size` is the width and height of the pictures; that of :func:`colour_size` if left out.
    """

    def __init__(self, facts: InputFacts, size: tuple[int, int] | None = None) -> None:
        self._facts = facts
        self._coded = turned(*(size or colour_size(facts)), facts.rotation)
        self._converter = VideoReformatter()

    def __call__(self, picture: Picture) -> Bgr:
        """Return the displayed picture: uint8, shape (height, width, 3), blue, green and red.

        It is grey if the source is grey, or if a damaged colour space cannot be converted.
        """
        return as_displayed(self._converted(picture), self._facts)

    def planes(self, picture: Picture) -> av.VideoFrame:
        """Return a picture in the format that the H.264 encoder takes.

        A picture that need not be mirrored or turned is scaled in its own planes, which takes a
        quarter of the time.
        """
        original, facts = picture.original, self._facts
        if isinstance(original, av.VideoFrame) and not (facts.mirrored or facts.rotation):
            with suppress(av.error.FFmpegError, ValueError):
                space = self._assumed_space(original)
                return _as_yuv420p(original, self._converter, self._coded, space)
        return _as_yuv420p(av.VideoFrame.from_ndarray(self(picture), "bgr24"), self._converter)

    def _converted(self, picture: Picture) -> Bgr:
        original = picture.original
        if isinstance(original, np.ndarray):
            return resized(original, self._coded)
        if original is not None and not original.format.name.startswith("gray"):
            with suppress(av.error.FFmpegError, ValueError):
                space = self._assumed_space(original)
                frame = convertible(original)
                converted = self._converter.reformat(
                    frame, *self._coded, "bgr24", space, interpolation=_EXACT_SCALING, threads=1
                )
                return np.asarray(converted.to_ndarray(), np.uint8)
        table = np.rint(luminance_table(picture.bits, picture.full_range) * 255).astype(np.uint8)
        grey = np.asarray(cv2.cvtColor(table[picture.plane], cv2.COLOR_GRAY2BGR))
        return resized(grey, self._coded)

    def _assumed_space(self, frame: av.VideoFrame) -> int | None:
        """Return the colour space to assume for a frame; None: use the one that it states."""
        large = min(frame.width, frame.height) > _STANDARD_LINES
        return Colorspace.ITU709 if large and frame.colorspace == _UNSPECIFIED else None


# ---- Encoding ------------------------------------------------------------------------------

# Without this option x264 chooses algorithms by the processor, so that the bytes differ.
ON_ANY_PROCESSOR = {"x264-params": "cpu-independent=1"}
# With this option FFmpeg writes no dates and no random identifiers.
_EXACT = {"fflags": "+bitexact"}


class _Sink:
    """A file that keeps the first error of the system; only `check` raises this error.

    FFmpeg calls the methods from C, through which no exception can pass: without this class a full
    disk would print many tracebacks. After an error the methods do nothing.
    """

    def __init__(self, file: FileIO) -> None:
        # FFmpeg reads the file back by this name; it would take "a:b" for an address.
        self.name = f"file:{file.name}"
        self._file = file
        self._error: OSError | None = None

    def write(self, data: bytes) -> int:
        if self._error is None:
            try:
                rest = memoryview(data)
                while rest:
                    rest = rest[self._file.write(rest) :]
            except OSError as error:
                self._error = error
        return len(data)

    def seek(self, offset: int, origin: int = 0, /) -> int:
        if self._error is None:
            try:
                return self._file.seek(offset, origin)
            except OSError as error:
                self._error = error
        return 0

    def tell(self) -> int:
        return self._file.tell() if self._error is None else 0

    def abandon(self) -> None:
        self._error = self._error or OSError("abandoned")

    def check(self) -> None:
        if self._error is not None:
            raise self._error


class _Coding(NamedTuple):
    """A coding of videos: FFmpeg's names, and options for the container and the encoder."""

    container: str
    codec: str
    pixels: str
    container_options: dict[str, str]
    options: Mapping[str, str]
    threads: int = 1


class _Encoder:
    """Encodes the frames of one video into a part file; the caller commits or discards the file.

    All frames have the same `size` (width, height). Presentation times are in units of `tick`
    seconds.
    """

    def __init__(
        self, file: PartFile, coding: _Coding, size: tuple[int, int], rate: Fraction, tick: Fraction
    ) -> None:
        self.frames = 0
        self._tick = tick
        self._sink = _Sink(file.raw)
        try:
            self._container: Any = av.open(
                self._sink, "w", format=coding.container, options=coding.container_options
            )
            options = dict(coding.options)
            stream: Any = self._container.add_stream(coding.codec, rate=rate, options=options)
        except BaseException as error:
            self._sink.abandon()
            if isinstance(error, av.codec.codec.UnknownCodecError):
                name = "H.264" if coding.codec == "libx264" else coding.codec.upper()
                raise OutputError(
                    f"{file.path}: this PyAV has no {name} encoder; install PyAV from PyPI"
                ) from error
            raise
        self._stream, context = stream, stream.codec_context
        (stream.width, stream.height), stream.pix_fmt = size, coding.pixels
        stream.time_base = context.time_base = tick
        context.thread_count, context.bit_rate = coding.threads, 0
        # Players expect H.264 with a limited range, in which (Y - 16) / 219 is the luminance.
        limited = coding.pixels == "yuv420p"
        context.color_range = ColorRange.MPEG if limited else ColorRange.JPEG

    def encode(self, frame: av.VideoFrame, ticks: int) -> None:
        """Write the next frame, whose presentation time is `ticks`."""
        frame.pts, frame.time_base = ticks, self._tick
        with self._errors():
            self._container.mux(self._stream.encode(frame))
        self.frames += 1

    def finish(self) -> None:
        """Write the frames that the encoder still holds, and the index."""
        with self._errors():
            if self.frames:
                self._container.mux(self._stream.encode())
            self._container.close()

    def abandon(self) -> None:
        """Stop writing; the file cannot be played."""
        self._sink.abandon()
        # Closing may raise the error of the disk once more.
        with suppress(OSError, av.error.FFmpegError):
            self._container.close()

    @contextmanager
    def _errors(self) -> Iterator[None]:
        """Raise the error of the disk, if any, or else an error of FFmpeg as an OSError."""
        try:
            yield
        except av.error.FFmpegError as error:
            self._sink.check()
            number, reason = error.errno, error.strerror
            if isinstance(error, av.error.ExternalError):  # of x264: no memory, or no thread
                number, reason = errno.EAGAIN, os.strerror(errno.EAGAIN)
            raise OSError(number, reason) from error
        self._sink.check()


# ---- In colour -----------------------------------------------------------------------------

_TICKS_HZ = 90_000  # exact for the frame times of 24, 25, 30, 50, 60 and 1000 frames/s
_MOST_TICKS_HZ = 1_000_000  # FFmpeg has 31 bits for the time between two frames
_CLOCK_BACK_S, _CLOCK_ON_S = 1.0, 900.0  # a larger step means that the source's clock was reset
# Two threads on every machine, because another number of threads gives other bytes.
_THREADS = 2
# "bf: 0": no frame is predicted from a later frame, so that the encoder keeps the order of frames.
_CODEC = {"preset": "superfast", "crf": "22", "bf": "0", **ON_ANY_PROCESSOR}
# With its index at the beginning the video plays while it loads.
_INDEX_FIRST = {**_EXACT, "movflags": "+faststart"}


def _ticks_hz(rate: Fraction | None) -> int:
    """Return the ticks per second: the least multiple of 90000 with exact times at this rate.

    The result is 90000 if that multiple is above 10^6, or if the rate is not known.
    """
    exact = math.lcm(_TICKS_HZ, rate.numerator) if rate else _TICKS_HZ
    return exact if exact <= _MOST_TICKS_HZ else _TICKS_HZ


class Recording(_Encoder):
    """Writes an MP4 of 8-bit H.264 (yuv420p, BT.709, limited range) with any frame times.

    The width and height in pixels must be even; `rate` is that of the source in frames/s, if known;
    `codec` has options of the encoder, with ``bf: 0``. Raises OSError, also in other methods, if
    the file cannot be written, and OutputError if PyAV has no H.264 encoder.
    """

    def __init__(
        self,
        part: PartFile,
        width: int,
        height: int,
        rate: Fraction | None,
        codec: Mapping[str, str] = _CODEC,
    ) -> None:
        coding = _Coding("mp4", "libx264", "yuv420p", _INDEX_FIRST, codec, _THREADS)
        self._hz = _ticks_hz(rate)
        super().__init__(part, coding, (width, height), rate or USUAL_RATE, Fraction(1, self._hz))
        context = self._stream.codec_context
        context.colorspace = Colorspace.ITU709
        context.color_primaries, context.color_trc = ColorPrimaries.BT709, ColorTrc.BT709
        self._frame_s = float(1 / (rate or USUAL_RATE))
        self._origin_s = 0.0
        self._last = -1
        self._converter = VideoReformatter()

    def write(self, picture: NDArray[np.uint8] | av.VideoFrame, time_s: float) -> float:
        """Write the next frame; return its presentation time in the file, in seconds.

        `picture` has blue, green and red, uint8 of shape (height, width, 3), or is the frame of
        :meth:`Colour.planes`. The first frame's time becomes 0. A frame whose time is not later
        than that of the frame before follows one tick after the frame before. If the clock jumps
        (back by a second, or on by a quarter of an hour), the frame follows one frame duration
        after the frame before.
        """
        frame = picture
        if not isinstance(frame, av.VideoFrame):
            frame = _as_yuv420p(av.VideoFrame.from_ndarray(frame, "bgr24"), self._converter)
        last_s = self._last / self._hz
        if self.frames == 0:
            self._origin_s = time_s
        elif not -_CLOCK_BACK_S < time_s - self._origin_s - last_s < _CLOCK_ON_S:
            self._origin_s = time_s - last_s - self._frame_s
        self._last = max(self._last + 1, round((time_s - self._origin_s) * self._hz))
        self.encode(frame, self._last)
        return self._last / self._hz


# ---- In grey -------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Format:
    """A format of grey videos, and its limits."""

    suffix: str  # empty for a folder
    even: bool = False  # whether width and height must be even
    fastest_hz: float | None = None  # highest frame rate


FORMATS = {
    "ffv1": _Format(".avi", fastest_hz=1000.0),  # FFmpeg writes no AVI of a higher rate
    "mkv": _Format(".mkv", fastest_hz=1000.0),  # FFV1 too; frame times rounded to 1 ms
    "mp4": _Format(".mp4", even=True),  # lossy: up to 6 grey levels, 0.3 on average
    "png": _Format(""),  # one image per frame in a folder, no frame times
    "npz": _Format(".npz"),
    "gif": _Format(".gif", fastest_hz=50.0),  # frame times rounded to 10 ms
}
IMAGE = "frame_{:05d}.png"  # name of an image in a folder of the format png
_FFV1 = {"level": "3", "coder": "1", "context": "0", "g": "1", "slices": "4", "slicecrc": "1"}
_X264 = {"crf": "1", "preset": "medium", "tune": "psnr", **ON_ANY_PROCESSOR}
_CODINGS = {
    "ffv1": _Coding("avi", "ffv1", "gray", _EXACT, _FFV1),
    "mkv": _Coding("matroska", "ffv1", "gray", _EXACT, _FFV1),
    "mp4": _Coding("mp4", "libx264", "yuv420p", _EXACT, _X264),
    "gif": _Coding("gif", "gif", "gray", _EXACT, {}),
}
_LIMITED = np.rint(16 + np.arange(256) * (219 / 255)).astype(np.uint8)


@contextmanager
def open_writer(
    path: Path, form: str, shape: tuple[int, int, int], frame_rate: Fraction, *, new: bool
) -> Iterator[Callable[[Grey], object]]:
    """Write a grey video: it gets its name after the last frame; after an error it is removed.

    Yields a function that writes the next frame, uint8 of shape (height, width): luminance times
    255. Raises OutputError if the video cannot be written.

    Parameters
    ----------
    path : Path
        The video: a file, or for ``png`` a folder.
    form : str
        A key of :data:`FORMATS`; the format's limits must allow these frames.
    shape : tuple of int
        Number of frames, and height and width of all frames in pixels.
    frame_rate : Fraction
        Frames per second.
    new : bool
        Whether it is an error if a file or folder of this name exists.
    """
    if form == "png":
        with PartFolder(path, new=new) as folder:
            names = (folder.part / IMAGE.format(index) for index in range(shape[0]))
            yield lambda grey: next(names).write_bytes(png_bytes(grey))
        return
    with PartFile(path, new=new) as file:
        if form == "npz":
            writer = _archive(file, shape, frame_rate)
        else:
            writer = _encoded(file, form, (shape[2], shape[1]), frame_rate)
        with writer as write:
            yield write


@contextmanager
def _archive(
    file: PartFile, shape: tuple[int, int, int], frame_rate: Fraction
) -> Iterator[Callable[[Grey], object]]:
    """Write ``grey`` (uint8, frames x h x w), ``time_s`` and ``frame_rate`` into one archive.

    Each frame is written when it comes, so that the memory never holds the complete video.
    """
    times_s = np.array([float(index / frame_rate) for index in range(shape[0])])
    ratio = np.array([frame_rate.numerator, frame_rate.denominator])
    archive = zipfile.ZipFile(file.binary, "w", zipfile.ZIP_DEFLATED, compresslevel=4)
    stream = archive.open(_entry("grey"), "w", force_zip64=True)
    try:
        description = {"descr": "|u1", "fortran_order": False, "shape": shape}
        np.lib.format.write_array_header_1_0(stream, description)
        yield lambda grey: stream.write(grey.tobytes())
        stream.close()
        for name, values in (("time_s", times_s), ("frame_rate", ratio)):
            data = io.BytesIO()
            np.lib.format.write_array(data, values)
            archive.writestr(_entry(name), data.getvalue())
        archive.close()
    except BaseException:
        for opened in (stream, archive):
            with suppress(OSError, ValueError):
                opened.close()
        raise


def _entry(name: str) -> zipfile.ZipInfo:
    """Return an entry with a fixed date, so that the same frames give the same bytes."""
    entry = zipfile.ZipInfo(f"{name}.npy")
    entry.compress_type = zipfile.ZIP_DEFLATED
    return entry


@contextmanager
def _encoded(
    file: PartFile, form: str, size: tuple[int, int], frame_rate: Fraction
) -> Iterator[Callable[[Grey], object]]:
    """Write FFV1, H.264 or GIF."""
    rate = Fraction(100) if form == "gif" else frame_rate
    encoder = _Encoder(file, _CODINGS[form], size, rate, 1 / rate)

    def write(grey: Grey) -> None:
        if form == "mp4":
            colourless = np.full((size[1] // 2, size[0]), 128, dtype=np.uint8)
            planes = np.concatenate([_LIMITED[grey], colourless])
            frame = av.VideoFrame.from_ndarray(planes, format="yuv420p")
            frame.color_range = ColorRange.MPEG
        else:
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(grey), format="gray")
            frame.color_range = ColorRange.JPEG
        encoder.encode(frame, round(encoder.frames * rate / frame_rate))

    try:
        yield write
        encoder.finish()
    except BaseException:
        encoder.abandon()
        raise


def png_bytes(grey: Grey) -> bytes:
    """Return a grey picture, shape (height, width), as the bytes of a PNG file."""
    data = io.BytesIO()
    Image.fromarray(grey).save(data, "PNG")
    return data.getvalue()
