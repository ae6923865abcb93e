"""Writers of grey videos: FFV1, H.264, GIF, PNG folders and NumPy archives.

The same frames give the same bytes. Each writer is a context that gives its file or
folder a name only when all frames are written.
"""

from __future__ import annotations

import io
import zipfile
from abc import ABC, abstractmethod
from contextlib import suppress
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING, Any, Generic, Self, TypeVar

import av
import numpy as np
from av.video.reformatter import ColorRange
from PIL import Image

from oppload_cli.errors import OutputError, suggestion
from oppload_cli.files.atomic import PartFile, PartFolder, output_errors
from oppload_cli.video.recording import ON_ANY_PROCESSOR, Sink

if TYPE_CHECKING:
    from pathlib import Path
    from types import TracebackType

    from numpy.typing import NDArray

    Grey = NDArray[np.uint8]


Part = TypeVar("Part", PartFile, PartFolder)


class _Writer(ABC, Generic[Part]):
    """Base of the writers: a context that gives its result a name at the end, or removes it.

    Parameters
    ----------
    path : Path
        The result.
    width, height : int
        Of every frame, in pixels.
    frame_rate : Fraction
        Frames per second.
    count : int
        Number of frames that will be written.
    new : bool
        Whether a file or folder of this name is an error.
    """

    part_kind: type[Part]

    def __init__(
        self,
        path: Path,
        width: int,
        height: int,
        frame_rate: Fraction,
        count: int,
        *,
        new: bool = False,
    ) -> None:
        self.path, self._new = path, new
        self.width, self.height, self.frame_rate = width, height, frame_rate
        self.count, self.frames = count, 0

    def __enter__(self) -> Self:
        self._part: Part = self.part_kind(self.path, new=self._new)
        try:
            with output_errors(self.path):
                self._open()
        except BaseException:
            self._part.discard()
            raise
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        problem: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        try:
            if kind is not None:
                self._abandon()
                return
            if self.frames != self.count:
                raise OutputError(
                    f"{self.path}: {self.frames} frames were written, not {self.count}; "
                    "nothing is kept"
                )
            with output_errors(self.path):
                self._close()
            self._part.commit()
        except BaseException:
            self._abandon()
            raise
        finally:
            self._part.discard()

    def write(self, grey: Grey) -> None:
        """Write the next frame.

        Parameters
        ----------
        grey : ndarray of uint8, shape (height, width)
            Luminance times 255.

        Raises
        ------
        OutputError
            If the frame has another size, or the disk is full.
        """
        if grey.shape != (self.height, self.width) or grey.dtype != np.uint8:
            raise OutputError(
                f"{self.path}: frame {self.frames} is {grey.dtype} {grey.shape}, not uint8 "
                f"{(self.height, self.width)}; give every frame the same size"
            )
        with output_errors(self.path):
            self._write(np.ascontiguousarray(grey))
        self.frames += 1

    @abstractmethod
    def _open(self) -> None:
        """Begin the part."""

    @abstractmethod
    def _write(self, grey: Grey) -> None:
        """Write a frame to the part."""

    @abstractmethod
    def _close(self) -> None:
        """Finish the part."""

    @abstractmethod
    def _abandon(self) -> None:
        """Close the part after an error; may be called twice."""


class _PngWriter(_Writer[PartFolder]):
    """Writes a folder of ``frame_00000.png``, ..."""

    part_kind = PartFolder

    def _open(self) -> None:
        """Do nothing: the folder exists."""

    def _write(self, grey: Grey) -> None:
        (self._part.part / f"frame_{self.frames:05d}.png").write_bytes(png_bytes(grey))

    def _close(self) -> None:
        """Do nothing: every frame is on the disk."""

    def _abandon(self) -> None:
        """Do nothing: no file is open."""


class _NpzWriter(_Writer[PartFile]):
    """Writes ``grey`` (uint8, frames x h x w), ``time_s`` and ``frame_rate`` as one archive.

    The frames are streamed: the memory never holds the complete clip.
    """

    part_kind = PartFile

    def _open(self) -> None:
        self._archive = zipfile.ZipFile(
            self._part.binary, "w", zipfile.ZIP_DEFLATED, compresslevel=4
        )
        self._stream = self._archive.open(_entry("grey.npy"), "w", force_zip64=True)
        shape = (self.count, self.height, self.width)
        description = {"descr": "|u1", "fortran_order": False, "shape": shape}
        np.lib.format.write_array_header_1_0(self._stream, description)

    def _write(self, grey: Grey) -> None:
        self._stream.write(grey.tobytes())

    def _close(self) -> None:
        self._stream.close()
        times = np.array([float(index / self.frame_rate) for index in range(self.count)])
        ratio = np.array([self.frame_rate.numerator, self.frame_rate.denominator])
        for name, values in (("time_s", times), ("frame_rate", ratio)):
            data = io.BytesIO()
            np.lib.format.write_array(data, values)
            self._archive.writestr(_entry(f"{name}.npy"), data.getvalue())
        self._archive.close()

    def _abandon(self) -> None:
        for each in (self._stream, self._archive):
            with suppress(OSError, ValueError):
                each.close()


def _entry(name: str) -> zipfile.ZipInfo:
    """Return an entry with a fixed date: the same frames give the same bytes."""
    entry = zipfile.ZipInfo(name)
    entry.compress_type = zipfile.ZIP_DEFLATED
    return entry


def png_bytes(grey: Grey) -> bytes:
    """Return a grey picture, shape (height, width), as the bytes of a PNG file."""
    data = io.BytesIO()
    Image.fromarray(grey).save(data, "PNG")
    return data.getvalue()


@dataclass(frozen=True)
class _Format:
    """A file format and its limits."""

    name: str
    suffix: str  # empty for a folder
    error: str  # how a frame that is read back differs, in words
    even: bool = False  # whether width and height must be even
    fastest_hz: float | None = None  # the highest frame rate


FORMATS = {
    one.name: one
    for one in (
        _Format("ffv1", ".avi", "lossless; frame times exact"),
        _Format("mkv", ".mkv", "lossless FFV1; the container rounds frame times to 1 ms"),
        _Format("mp4", ".mp4", "lossy H.264: up to 6 grey levels, 0.3 on average", even=True),
        _Format("png", "", "lossless; one image per frame in a folder, no frame times"),
        _Format("npz", ".npz", "lossless; frame times exact, not a video"),
        _Format("gif", ".gif", "lossless; frame times rounded to 10 ms", fastest_hz=50.0),
    )
}


# Limited range, as players expect of H.264: (Y - 16) / 219 is the luminance.
_LIMITED = np.rint(16 + np.arange(256) * (219 / 255)).astype(np.uint8)
# container, codec, pixel format and options by suffix
_FFV1 = {"level": "3", "coder": "1", "context": "0", "g": "1", "slices": "4", "slicecrc": "1"}
_X264 = {"crf": "1", "preset": "medium", "tune": "psnr", **ON_ANY_PROCESSOR}
_CODECS: dict[str, tuple[str, str, str, dict[str, str]]] = {
    ".mkv": ("matroska", "ffv1", "gray", _FFV1),
    ".avi": ("avi", "ffv1", "gray", _FFV1),
    ".mp4": ("mp4", "libx264", "yuv420p", _X264),
    ".gif": ("gif", "gif", "gray", {}),
}


class _VideoWriter(_Writer[PartFile]):
    """Writes FFV1 (``.avi``, ``.mkv``), H.264 (``.mp4``) and GIF files."""

    part_kind = PartFile

    def _open(self) -> None:
        container, codec, pixels, options = _CODECS[self.path.suffix.lower()]
        # bitexact: no dates and no random identifiers, the same frames give the same bytes
        self._sink = Sink(self._part.raw)
        self._container: Any = av.open(
            self._sink, "w", format=container, options={"fflags": "+bitexact"}
        )
        self._gif = codec == "gif"
        rate = Fraction(100) if self._gif else self.frame_rate
        stream: Any = self._container.add_stream(codec, rate=rate, options=options)
        stream.width, stream.height, stream.pix_fmt = self.width, self.height, pixels
        stream.time_base = self._time_base = 1 / rate
        context = stream.codec_context
        context.time_base, context.thread_count = 1 / rate, 1
        context.bit_rate = 0
        self._limited = pixels == "yuv420p"
        context.color_range = self._range = ColorRange.MPEG if self._limited else ColorRange.JPEG
        self._stream = stream

    def _write(self, grey: Grey) -> None:
        if self._limited:
            colourless = np.full((self.height // 2, self.width), 128, dtype=np.uint8)
            planes = np.concatenate([_LIMITED[grey], colourless])
            frame = av.VideoFrame.from_ndarray(planes, format="yuv420p")
        else:
            frame = av.VideoFrame.from_ndarray(grey, format="gray")
        frame.pts = round(self.frames * 100 / self.frame_rate) if self._gif else self.frames
        frame.time_base = self._time_base
        frame.color_range = self._range
        self._container.mux(self._stream.encode(frame))
        self._sink.check()

    def _close(self) -> None:
        self._container.mux(self._stream.encode())
        self._container.close()
        self._sink.check()

    def _abandon(self) -> None:
        self._sink.fail(OSError("abandoned"))
        self._container.close()


def open_writer(
    path: Path,
    form: str,
    *,
    width: int,
    height: int,
    frame_rate: Fraction,
    count: int,
    new: bool = False,
) -> _Writer[Any]:
    """Return the writer of a format, to be used as a context.

    Parameters
    ----------
    path, width, height, frame_rate, count, new
        As for :class:`_Writer`; see also :func:`target_of`.
    form : str
        A key of :data:`FORMATS`.

    Raises
    ------
    OutputError
        If the format is unknown, or cannot hold such frames.
    """
    _check_format(form, width, height, frame_rate)
    writers: dict[str, type[_Writer[Any]]] = {"png": _PngWriter, "npz": _NpzWriter}
    writer = writers.get(form, _VideoWriter)
    return writer(path, width, height, frame_rate, count, new=new)


def _check_format(form: str, width: int, height: int, frame_rate: Fraction) -> None:
    """Raise OutputError, which says what to change, if a format cannot hold a video."""
    if form not in FORMATS:
        raise OutputError(f"no video format '{form}'{suggestion(form, FORMATS)}")
    known = FORMATS[form]
    if known.even and (width % 2 or height % 2):
        raise OutputError(
            f"format {form} needs an even width and height, not {width} x {height}; "
            "change the size or use format ffv1"
        )
    if known.fastest_hz is not None and frame_rate > known.fastest_hz:
        raise OutputError(
            f"format {form} holds at most {known.fastest_hz:g} frames per second, not "
            f"{float(frame_rate):g}; lower the frame rate or use format ffv1"
        )


def target_of(directory: Path, stem: str, form: str) -> Path:
    """Return the path of a video in a folder: a file, or for ``png`` a folder."""
    return directory / f"{stem}{FORMATS[form].suffix}"
