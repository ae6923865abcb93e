"""Writers of grey videos: FFV1, H.264, GIF, PNG folders and NumPy archives.

Each writes to a ``.part`` beside its target and renames it when all is well, so that
nothing half-written carries the target's name.
"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np

from oppload_cli.errors import OutputError, suggestion
from oppload_cli.video.archive import NpzWriter, PngWriter
from oppload_cli.video.atomic import remove
from oppload_cli.video.sink import Sink
from oppload_cli.video.writer_base import Writer

if TYPE_CHECKING:
    from pathlib import Path

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
        Format("ffv1", ".avi", "lossless; frame times exact"),
        Format("mkv", ".mkv", "lossless FFV1; the container rounds frame times to 1 ms"),
        Format("mp4", ".mp4", "lossy H.264: up to 6 grey levels, 0.3 on average", even=True),
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
    ".mp4": ("mp4", "libx264", "yuv420p", {"crf": "1", "preset": "medium", "tune": "psnr"}),
    ".gif": ("gif", "gif", "gray", {}),
}


class VideoWriter(Writer):
    """Writes FFV1 (``.avi``, ``.mkv``), H.264 (``.mp4``) and GIF files."""

    def _open(self) -> None:
        import av  # noqa: PLC0415 - 70 ms that the other formats need not wait for

        container, codec, pixels, options = _CODECS[self.path.suffix.lower()]
        # bitexact: no dates and no random identifiers, the same frames give the same bytes
        self._sink = Sink(self.part)
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
        context.color_range = 1 if pixels == "yuv420p" else 2
        self._limited = pixels == "yuv420p"
        self._stream = stream

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
        self._sink.check()

    def _close(self) -> None:
        self._container.mux(self._stream.encode())
        self._container.close()
        self._sink.close()

    def _abandon(self) -> None:
        if hasattr(self, "_sink"):
            self._sink.fail(OSError("abandoned"))
        if hasattr(self, "_container"):
            self._container.close()
        if hasattr(self, "_sink"):
            with contextlib.suppress(OSError):
                self._sink.close()
        remove(self.part)


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
    writers: dict[str, type[Writer]] = {"png": PngWriter, "npz": NpzWriter}
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
