"""Video files and network streams, decoded by PyAV."""

from __future__ import annotations

import re
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

import av
import cv2
import numpy as np

from oppload_cli.errors import SourceError
from oppload_cli.video.frames import DecodeFacts, InputFacts, Picture

if TYPE_CHECKING:
    from collections.abc import Iterator

    from av.container import InputContainer
    from av.video.frame import VideoFrame
    from av.video.stream import VideoStream
    from numpy.typing import NDArray

OPEN_TIMEOUT_S, READ_TIMEOUT_S = 10.0, 10.0
MOST_DEMUX_ERRORS = 100  # in a row, without a packet between them
LIMITED, FULL = 1, 2  # AVCOL_RANGE_MPEG, AVCOL_RANGE_JPEG
# Grey without a stated range: what a video codec codes is limited, all else is full.
LIMITED_GREY = {"h264", "hevc", "vp8", "vp9", "av1", "mpeg4", "mpeg2video", "prores"}
PACKED_YUV = {"yuyv422", "uyvy422", "yvyu422"}
PACKED_RGB = {
    "bgr24": cv2.COLOR_BGR2GRAY,
    "rgb24": cv2.COLOR_RGB2GRAY,
    "bgra": cv2.COLOR_BGRA2GRAY,
    "rgba": cv2.COLOR_RGBA2GRAY,
}


class ContainerSource:
    """A video file, or a stream's address, as a source of pictures.

    Parameters
    ----------
    name : str
        A path or an address such as ``rtsp://host/stream``.
    threads : int
        Decoder threads; 0 leaves the choice to the decoder.

    Raises
    ------
    SourceError
        If it cannot be opened, or holds no video, or no frame can be decoded.
    """

    def __init__(self, name: str, threads: int = 0) -> None:
        self.name = name
        self.decode = DecodeFacts()
        self._remote = "://" in name
        self._container = self._opened()
        self._stream = self._video_stream()
        self._stream.thread_type = "AUTO"
        self._stream.codec_context.thread_count = threads
        self._frames = self._decoded()
        self._first = self._first_frame()
        self._last_time = 0.0
        self.facts = self._facts()

    def pictures(self) -> Iterator[Picture]:
        """Yield the decoded pictures; a damaged packet loses only its own frames.

        Yields
        ------
        Picture
            Its plane is a view that lives as long as the picture.
        """
        frame: VideoFrame | None = self._first
        while frame is not None:
            index = self.decode.decoded
            self.decode.decoded += 1
            self.decode.corrupt += frame.is_corrupt
            self._last_time = self._time(frame, index)
            plane, bits = luma_plane(frame)
            full = is_full_range(frame, self._stream.codec_context.name)
            yield Picture(index, self._last_time, plane, bits, full)
            frame = next(self._frames, None)

    def finish(self) -> None:
        """Count the frames that the container declared and that never came."""
        declared = self.facts.frames_declared
        if declared is not None:
            self.decode.missing = max(0, declared - self.decode.decoded)
        elif self.facts.frame_rate:
            duration = self._declared_duration()
            if duration is not None:
                # Durations are rounded, and some writers count the last frame's and some do not.
                lost = (duration - self._last_time) * float(self.facts.frame_rate) - 1
                self.decode.missing = max(0, round(lost)) if lost > 1.5 else 0
        if self.decode.missing:
            self.decode.note(f"{self.decode.missing} declared frames never came")

    def close(self) -> None:
        """Close the container; may be called twice."""
        self._container.close()

    def _opened(self) -> InputContainer:
        if not self._remote:
            self._check_file()
        try:
            return av.open(
                self.name,
                timeout=(OPEN_TIMEOUT_S, READ_TIMEOUT_S) if self._remote else None,
                metadata_errors="replace",
            )
        except (av.error.FFmpegError, OSError, ValueError) as error:
            raise SourceError(
                f"{self.name}: not a video that can be read ({_reason(error)}); "
                f"check the file, or convert it"
            ) from error

    def _check_file(self) -> None:
        path = Path(self.name)
        try:
            size = path.stat().st_size
        except FileNotFoundError as error:
            raise SourceError(f"{self.name}: no such file; check the path") from error
        except OSError as error:
            raise SourceError(
                f"{self.name}: cannot be read ({_reason(error)}); check the path"
            ) from error
        if path.is_file() and size == 0:
            raise SourceError(f"{self.name}: the file is empty; copy or record it again")

    def _video_stream(self) -> VideoStream:
        # A cover picture is a video stream to the container, and not to anybody else.
        streams = [s for s in self._container.streams.video if not s.disposition.value & 0x400]
        if not streams:
            self._container.close()
            raise SourceError(f"{self.name}: holds no video stream; give a file with pictures")
        # The stubs promise a codec; a stream of an unknown one has none.
        codec: Any = streams[0].codec_context
        if codec is None:
            self._container.close()
            raise SourceError(f"{self.name}: its codec is unknown here; convert it, e.g. to H.264")
        return streams[0]

    def _first_frame(self) -> VideoFrame:
        first = next(self._frames, None)
        if first is None:
            self.close()
            reasons = "; ".join(self.decode.messages) or "it holds no frame"
            raise SourceError(
                f"{self.name}: no frame could be decoded ({reasons}); check or convert the file"
            )
        return first

    def _decoded(self) -> Iterator[VideoFrame]:
        for packet in self._packets():
            try:
                yield from packet.decode()
            except (av.error.FFmpegError, ValueError) as error:
                self.decode.failed(_reason(error))

    def _packets(self) -> Iterator[Any]:
        packets = self._container.demux(self._stream)
        errors = 0
        while True:
            try:
                packet = next(packets)
            except StopIteration:
                return
            except (av.error.FFmpegError, OSError) as error:
                self.decode.failed(_reason(error))
                errors += 1
                if errors > MOST_DEMUX_ERRORS or self._remote:
                    return
                packets = self._container.demux(self._stream)
            else:
                errors = 0
                yield packet

    def _time(self, frame: VideoFrame, index: int) -> float:
        if frame.pts is not None and self._first.pts is not None:
            return frame.time - self._first.time
        rate = self.facts.frame_rate
        return index / float(rate) if rate else float(index)

    def _declared_duration(self) -> float | None:
        """Return the stream's duration in seconds, as far as it is its own."""
        stream = self._stream
        if stream.duration is not None and stream.time_base is not None:
            return float(stream.duration * stream.time_base)
        tag = re.match(r"(\d+):(\d+):(\d+(?:\.\d+)?)", stream.metadata.get("DURATION", ""))
        if tag:
            hours, minutes, seconds = tag.groups()
            return int(hours) * 3600 + int(minutes) * 60 + float(seconds)
        if len(self._container.streams) == 1 and self._container.duration is not None:
            return self._container.duration / av.time_base
        return None

    def _facts(self) -> InputFacts:
        frame, stream = self._first, self._stream
        rotation = int(frame.rotation) % 360
        sideways = rotation in (90, 270)
        codec = stream.codec_context.name
        aspect = stream.sample_aspect_ratio
        path = Path(self.name)
        return InputFacts(
            name=self.name,
            kind="stream" if self._remote else "container",
            width=frame.height if sideways else frame.width,
            height=frame.width if sideways else frame.height,
            frame_rate=_rate(stream),
            frames_declared=stream.frames or None,
            rotation=rotation,
            codec=codec,
            pixel_format=frame.format.name,
            colour_range="full" if is_full_range(frame, codec) else "limited",
            pixel_aspect=Fraction(aspect) if aspect else None,
            bytes=path.stat().st_size if path.is_file() else None,
        )


def luma_plane(frame: VideoFrame) -> tuple[NDArray[Any], int]:
    """Return the luma of a decoded frame, without a copy where it has a plane of its own.

    Parameters
    ----------
    frame : av.VideoFrame
        Any pixel format.

    Returns
    -------
    plane : ndarray of uint8 or uint16, shape (height, width)
        The Y plane; what has none (RGB, palettes) is converted to grey by the
        Rec. 601 weights.
    bits : int
        Bits that a sample uses.
    """
    name = frame.format.name
    if name in PACKED_RGB:
        return cv2.cvtColor(frame.to_ndarray(), PACKED_RGB[name]), 8
    if name in PACKED_YUV:
        frame, name = frame.reformat(format="yuv422p"), "yuv422p"
    has_plane = name.startswith(("yuv", "gray", "nv", "p0", "p2", "p4"))
    if not has_plane:
        return cv2.cvtColor(frame.to_ndarray(format="bgr24"), cv2.COLOR_BGR2GRAY), 8
    # P010 and its kin hold their bits at the top of 16.
    bits = 16 if name.startswith("p") else frame.format.components[0].bits
    return _view(frame, bits, big_endian=name.endswith("be")), bits


def is_full_range(frame: VideoFrame, codec: str) -> bool:
    """Tell whether a frame's luma uses all of its range.

    Parameters
    ----------
    frame : av.VideoFrame
        A decoded frame.
    codec : str
        Name of its decoder, which settles grey frames that state no range.

    Returns
    -------
    bool
    """
    name = frame.format.name
    if name.startswith("yuvj") or not name.startswith(("yuv", "gray", "nv", "p0", "p2", "p4")):
        return name not in PACKED_YUV or frame.color_range == FULL
    if name.startswith("gray") and frame.color_range != LIMITED:
        return frame.color_range == FULL or codec not in LIMITED_GREY
    return bool(frame.color_range == FULL)


def _view(frame: VideoFrame, bits: int, *, big_endian: bool) -> NDArray[Any]:
    plane = frame.planes[0]
    kind = np.dtype(np.uint8) if bits == 8 else np.dtype(">u2" if big_endian else "<u2")
    rows = np.frombuffer(memoryview(plane), kind).reshape(-1, plane.line_size // kind.itemsize)
    view: NDArray[Any] = rows[: frame.height, : frame.width]
    return view.astype(np.uint16) if big_endian and bits > 8 else view


def _rate(stream: VideoStream) -> Fraction | None:
    for rate in (stream.average_rate, stream.guessed_rate, stream.base_rate):
        if rate:
            return Fraction(rate)
    return None


def _reason(error: BaseException) -> str:
    return str(getattr(error, "strerror", None) or error).strip().rstrip(".").lower() or "unknown"
