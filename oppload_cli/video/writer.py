"""Writers of grey videos: FFV1, H.264, GIF, PNG folders and NumPy archives.

Each writes to a ``.part`` beside its target and renames it when all is well, so that
nothing half-written carries the target's name.
"""

from __future__ import annotations

import io
import shutil
import struct
import zipfile
import zlib
from contextlib import contextmanager
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from oppload_cli.errors import OutputError, suggestion

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path
    from types import TracebackType

    from numpy.typing import NDArray

    Grey = NDArray[np.uint8]

# Limited range, as players expect of H.264: (Y - 16) / 219 is the luminance.
LIMITED = np.rint(16 + np.arange(256) * (219 / 255)).astype(np.uint8)


@dataclass(frozen=True)
class Format:
    """What a file format can hold.

    Attributes
    ----------
    name : str
        As on the command line.
    suffix : str
        Of the file; empty for a folder.
    even : bool
        Whether it needs an even width and height.
    fastest_hz : float or None
        Highest frame rate, where there is one.
    error : str
        What a frame read back differs by, in words.
    """

    name: str
    suffix: str
    error: str
    even: bool = False
    fastest_hz: float | None = None


FORMATS = {
    one.name: one
    for one in (
        Format("ffv1", ".mkv", "lossless; the container rounds frame times to 1 ms"),
        Format("avi", ".avi", "lossless FFV1; frame times exact"),
        Format("mp4", ".mp4", "lossy H.264: a few grey levels at edges", even=True),
        Format("png", "", "lossless; one image per frame in a folder, no frame times"),
        Format("npz", ".npz", "lossless; frame times exact, not a video"),
        Format("gif", ".gif", "lossless; frame times rounded to 10 ms", fastest_hz=50.0),
    )
}


# container, codec, pixel format and options by suffix
_FFV1 = {"level": "3", "coder": "1", "context": "0", "g": "1", "slices": "4", "slicecrc": "1"}
_CODECS: dict[str, tuple[str, str, str, dict[str, str]]] = {
    ".mkv": ("matroska", "ffv1", "gray", _FFV1),
    ".avi": ("avi", "ffv1", "gray", _FFV1),
    ".mp4": ("mp4", "libx264", "yuv420p", {"crf": "8", "preset": "medium", "tune": "animation"}),
    ".gif": ("gif", "gif", "gray", {}),
}


class Writer:
    """Base of the writers: a context that renames its ``.part`` at the end, or removes it.

    Parameters
    ----------
    path : Path
        Where the result shall be.
    width, height : int
        Of every frame, in pixels.
    frame_rate : Fraction
        Frames per second.
    count : int
        Number of frames that will be written.
    """

    def __init__(
        self, path: Path, width: int, height: int, frame_rate: Fraction, count: int
    ) -> None:
        self.path, self.part = path, part_of(path)
        self.width, self.height, self.frame_rate = width, height, frame_rate
        self.count, self.frames = count, 0

    def __enter__(self) -> Self:
        with disk_errors(self.path):
            self.path.parent.mkdir(parents=True, exist_ok=True)
        try:
            with disk_errors(self.path):
                self._open()
        except BaseException:
            remove(self.part)
            raise
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        problem: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        try:
            if kind is None:
                if self.frames != self.count:
                    raise OutputError(
                        f"{self.path}: {self.frames} frames were written, not {self.count}; "
                        "nothing is kept"
                    )
                with disk_errors(self.path):
                    self._close()
                    remove(self.path)
                    self.part.rename(self.path)
            else:
                self._abandon()
        except BaseException:
            self._abandon()
            raise

    def write(self, grey: Grey) -> None:
        """Write the next frame.

        Parameters
        ----------
        grey : ndarray
            uint8 (h, w), luminance times 255.

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
        with disk_errors(self.path):
            self._write(np.ascontiguousarray(grey))
        self.frames += 1

    def _open(self) -> None:
        raise NotImplementedError

    def _write(self, grey: Grey) -> None:
        raise NotImplementedError

    def _close(self) -> None:
        raise NotImplementedError

    def _abandon(self) -> None:
        remove(self.part)


class VideoWriter(Writer):
    """Writes FFV1 (``.mkv``, ``.avi``), H.264 (``.mp4``) and GIF files."""

    def _open(self) -> None:
        import av  # noqa: PLC0415 - 70 ms that the other formats need not wait for

        container, codec, pixels, options = _CODECS[self.path.suffix.lower()]
        # bitexact: no dates and no random identifiers, the same frames give the same bytes
        target = io.FileIO(self.part, "w+")
        self._file = io.BufferedRandom(target, 1 << 20)
        self._container: Any = av.open(
            self._file, "w", format=container, options={"fflags": "+bitexact"}
        )
        self._gif = codec == "gif"
        rate = Fraction(100) if self._gif else self.frame_rate
        self._stream: Any = self._container.add_stream(codec, rate=rate, options=options)
        self._stream.width, self._stream.height = self.width, self.height
        self._stream.pix_fmt = pixels
        self._stream.time_base = self._time_base = 1 / rate
        context = self._stream.codec_context
        context.time_base, context.thread_count = 1 / rate, 1
        context.bit_rate = 0
        context.color_range = 1 if pixels == "yuv420p" else 2
        self._limited = pixels == "yuv420p"

    def _write(self, grey: Grey) -> None:
        import av  # noqa: PLC0415

        if self._limited:
            colourless = np.full((self.height // 2, self.width), 128, dtype=np.uint8)
            planes = np.concatenate([LIMITED[grey], colourless])
            frame = av.VideoFrame.from_ndarray(planes, format="yuv420p")
        else:
            frame = av.VideoFrame.from_ndarray(grey, format="gray")
        frame.pts = round(self.frames * 100 / self.frame_rate) if self._gif else self.frames
        frame.time_base = self._time_base
        frame.color_range = 1 if self._limited else 2
        self._container.mux(self._stream.encode(frame))

    def _close(self) -> None:
        self._container.mux(self._stream.encode())
        self._container.close()
        self._file.close()

    def _abandon(self) -> None:
        for thing in (getattr(self, "_container", None), getattr(self, "_file", None)):
            # the disk is full already: what closing says has been said
            try:
                if thing is not None:
                    thing.close()
            except (OSError, ValueError):
                continue
        remove(self.part)


class PngWriter(Writer):
    """Writes a folder of ``frame_00000.png``, ..."""

    def _open(self) -> None:
        remove(self.part)
        self.part.mkdir()

    def _write(self, grey: Grey) -> None:
        (self.part / f"frame_{self.frames:05d}.png").write_bytes(png_bytes(grey))

    def _close(self) -> None:
        """Do nothing: every frame is on the disk already."""


class NpzWriter(Writer):
    """Writes ``grey`` (uint8, frames x h x w), ``time_s`` and ``frame_rate`` as one archive.

    The frames are streamed, so that the clip is never in memory as a whole.
    """

    def _open(self) -> None:
        self._archive = zipfile.ZipFile(self.part, "w", zipfile.ZIP_DEFLATED, compresslevel=4)
        # the default date, not today's: the same frames give the same bytes
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
        for name in ("_stream", "_archive"):
            try:
                if hasattr(self, name):
                    getattr(self, name).close()
            except (OSError, ValueError):
                continue
        super()._abandon()


def open_writer(
    path: Path, form: str, *, width: int, height: int, frame_rate: Fraction, count: int
) -> Writer:
    """Return the writer of a format, to be used as a context.

    Parameters
    ----------
    path : Path
        Where the result shall be; see :func:`target_of`.
    form : str
        A key of :data:`FORMATS`.
    width, height : int
        Of every frame, in pixels.
    frame_rate : Fraction
        Frames per second.
    count : int
        Number of frames that will be written.

    Returns
    -------
    Writer

    Raises
    ------
    OutputError
        If the format is unknown, or cannot hold such frames.
    """
    check_format(form, width, height, frame_rate)
    writers = {"png": PngWriter, "npz": NpzWriter}
    writer = writers.get(form, VideoWriter)
    return writer(path, width, height, frame_rate, count)


def check_format(form: str, width: int, height: int, frame_rate: Fraction) -> None:
    """Check that a format can hold a video.

    Parameters
    ----------
    form : str
        A key of :data:`FORMATS`.
    width, height : int
        In pixels.
    frame_rate : Fraction
        Frames per second.

    Raises
    ------
    OutputError
        If it cannot; the message says what to change.
    """
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
    """Return where a video goes.

    Parameters
    ----------
    directory : Path
        The folder for results.
    stem : str
        Name without suffix.
    form : str
        A key of :data:`FORMATS`.

    Returns
    -------
    Path
        A file, or for ``png`` a folder.
    """
    return directory / f"{stem}{FORMATS[form].suffix}"


def part_of(path: Path) -> Path:
    """Return the name that a result has while it is written.

    Parameters
    ----------
    path : Path
        The result's own name.

    Returns
    -------
    Path
        Beside it.
    """
    return path.with_name(f"{path.name}.part")


def remove(path: Path) -> None:
    """Remove a file or a folder, if it is there.

    Parameters
    ----------
    path : Path
        What to remove.
    """
    if path.is_dir():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def write_atomic(path: Path, data: bytes) -> None:
    """Write a small file as a whole or not at all.

    Parameters
    ----------
    path : Path
        Where it shall be.
    data : bytes
        What it shall hold.

    Raises
    ------
    OutputError
        If it cannot be written.
    """
    part = part_of(path)
    with disk_errors(path):
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            part.write_bytes(data)
            part.replace(path)
        except BaseException:
            remove(part)
            raise


@contextmanager
def disk_errors(path: Path) -> Iterator[None]:
    """Turn what the system says about a disk into an OutputError.

    Parameters
    ----------
    path : Path
        The result, for the message.

    Raises
    ------
    OutputError
        Instead of any OSError within.
    """
    try:
        yield
    except OSError as problem:
        reason = problem.strerror or str(problem)
        raise OutputError(
            f"{path}: cannot write: {reason}; nothing half-written is left, free the disk or "
            "choose another folder"
        ) from problem


def _entry(name: str) -> zipfile.ZipInfo:
    entry = zipfile.ZipInfo(name)
    entry.compress_type = zipfile.ZIP_DEFLATED
    return entry


def png_bytes(grey: Grey) -> bytes:
    """Return a grey picture as a PNG file.

    Parameters
    ----------
    grey : ndarray
        uint8 (h, w).

    Returns
    -------
    bytes
        The same for the same picture.
    """
    height, width = grey.shape
    # each row differs from the one above by little: filter 2 stores the difference
    above = np.vstack([np.zeros((1, width), np.uint8), grey[:-1]])
    rows = np.hstack([np.full((height, 1), 2, np.uint8), grey - above])
    header = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    chunks = ((b"IHDR", header), (b"IDAT", zlib.compress(rows.tobytes(), 6)), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + tag + data + struct.pack(">I", zlib.crc32(tag + data))
        for tag, data in chunks
    )
