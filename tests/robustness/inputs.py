"""One maker for every kind of input that the tests show to the program."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import av
import numpy as np

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

QUIET_265 = "log-level=none"


@dataclass(frozen=True)
class Kind:
    """How a test file is encoded, and what must come out of it."""

    suffix: str
    codec: str
    pixel_format: str = "yuv420p"
    width: int = 96
    height: int = 64
    frames: int = 12
    rate: Fraction = Fraction(30)
    options: dict[str, str] = field(default_factory=dict)
    full: bool = False
    times: tuple[int, ...] | None = None  # in units of 1/1000 s
    error: float = 0.01  # of luminance, mean over a patch
    tick: float = 1e-9  # of the container's clock, s

    @property
    def seconds(self) -> list[float]:
        if self.times is not None:
            return [(time - self.times[0]) / 1000 for time in self.times]
        return [float(index / self.rate) for index in range(self.frames)]


def level(index: int) -> float:
    """Luminance of the left half in frame `index`; the right half is 0.5."""
    return 0.1 + 0.8 * (index * 5 % 12) / 11


def shown(kind: Kind, index: int) -> float:
    """Luminance of the left half, rounded to the codes that carry it."""
    most = 255 if kind.full else 219
    return round(level(index) * most) / most


def picture(kind: Kind, index: int) -> NDArray[Any]:
    """Codes of one frame: each has a luminance of its own, so that order shows."""
    luminance = np.full((kind.height, kind.width), 0.5)
    luminance[:, : max(1, kind.width // 2)] = level(index)
    if kind.full:
        return np.asarray(np.rint(luminance * 255), np.uint8)
    return np.asarray(np.rint(16 + luminance * 219), np.uint8)


def frame_of(kind: Kind, index: int) -> av.VideoFrame:
    """Put the codes into the luma plane of a frame; colour is neutral."""
    codes = picture(kind, index)
    frame = av.VideoFrame(kind.width, kind.height, kind.pixel_format)
    deep = frame.format.components[0].bits > 8
    for number, plane in enumerate(frame.planes):
        rows = np.full((plane.height, plane.line_size), 128, np.uint8)
        if number == 3:
            rows[:] = 255  # alpha
        if number == 0:
            rows[:, : kind.width] = codes[: plane.height]
        if deep:  # ten bits in two bytes
            wide = np.full((plane.height, plane.line_size // 2), 512, np.uint16)
            if number == 0:
                wide[:, : kind.width] = codes.astype(np.uint16) * 4
            rows = wide.view(np.uint8)
        plane.update(rows.tobytes())
    return frame


class Pipe:
    """A file that can be written but not gone back in."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("wb")
        self.write = self._file.write
        self.close = self._file.close


def make(
    path: Path,
    kind: Kind,
    container_options: dict[str, str] | None = None,
    *,
    to_pipe: bool = False,
) -> Path:
    """Encode a file of that kind, where asked for as if it were written to a pipe.

    For root, SVT-AV1 gives the thread that calls it real-time priority, for good, and every
    process that this thread starts has it too. So the thread is one that ends with the file.
    """
    with ThreadPoolExecutor(1) as pool:
        pool.submit(_encode, path, kind, container_options or {}, to_pipe=to_pipe).result()
    return path


def _encode(path: Path, kind: Kind, container_options: dict[str, str], *, to_pipe: bool) -> None:
    target: Any = Pipe(path) if to_pipe else str(path)
    form = {"mkv": "matroska", "ts": "mpegts"}.get(kind.suffix, kind.suffix) if to_pipe else None
    with av.open(target, "w", format=form, options=container_options) as container:
        stream: Any = container.add_stream(kind.codec, rate=kind.rate, options=kind.options)
        stream.width, stream.height, stream.pix_fmt = kind.width, kind.height, kind.pixel_format
        if kind.codec.startswith("libvpx"):  # its threads wait for each other in a loop
            stream.codec_context.thread_count = 1
        if kind.full:
            stream.codec_context.color_range = 2
        if kind.times is not None:
            stream.codec_context.time_base = Fraction(1, 1000)
        for index in range(kind.frames):
            frame = frame_of(kind, index)
            if kind.times is not None:
                frame.pts, frame.time_base = kind.times[index], Fraction(1, 1000)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    if to_pipe:
        target.close()


X264 = {"preset": "ultrafast", "g": "6", "bf": "2"}
X265 = {"preset": "ultrafast", "x265-params": f"{QUIET_265}:keyint=6"}
VP9 = {"deadline": "realtime", "cpu-used": "8"}
AV1 = {"preset": "12", "crf": "20", "svtav1-params": "lp=1"}  # its threads sometimes swap pictures
IRREGULAR = (0, 33, 67, 200, 233, 500, 533, 567, 600, 900, 933, 967)
MS = 6e-4  # Matroska and WebM round times to 1 ms

KINDS = {
    "h264-mp4": Kind("mp4", "libx264", options=X264),
    "h264-mkv": Kind("mkv", "libx264", options=X264, tick=MS),
    "h264-mov": Kind("mov", "libx264", options=X264),
    "h264-ts": Kind("ts", "libx264", options=X264, tick=2e-5),
    "h264-avi": Kind("avi", "libx264", options={**X264, "bf": "0"}),
    "h264-fragments": Kind("mp4", "libx264", options=X264),
    "h264-444": Kind("mp4", "libx264", "yuv444p", options=X264),
    "h264-full-range": Kind("mp4", "libx264", "yuvj420p", options=X264, full=True),
    "h264-full-range-flag": Kind("mp4", "libx264", options=X264, full=True),
    "h264-ten-bits": Kind("mkv", "libx264", "yuv420p10le", options=X264, tick=MS),
    "h264-interlaced": Kind("mp4", "libx264", options={**X264, "x264-params": "tff=1"}),
    "h264-open-gop": Kind(
        "ts", "libx264", options={**X264, "preset": "fast", "x264-params": "open-gop=1"}, tick=2e-5
    ),
    "hevc-mp4": Kind("mp4", "libx265", options=X265),
    "hevc-ten-bits": Kind("mp4", "libx265", "yuv420p10le", options=X265),
    "hevc-mkv": Kind("mkv", "libx265", options=X265, tick=MS),
    "hevc-open-gop": Kind(
        "mp4",
        "libx265",
        options={"preset": "fast", "x265-params": f"{QUIET_265}:keyint=6:open-gop=1"},
    ),
    "vp8-webm": Kind("webm", "libvpx", options=VP9, tick=MS),
    "vp9-webm": Kind("webm", "libvpx-vp9", options=VP9, tick=MS),
    "vp9-alpha": Kind("webm", "libvpx-vp9", "yuva420p", options=VP9, tick=MS),
    "av1-mp4": Kind("mp4", "libsvtav1", options=AV1),
    "av1-mkv": Kind("mkv", "libsvtav1", options=AV1, tick=MS),
    "av1-ivf": Kind("ivf", "libsvtav1", options=AV1, tick=MS),
    "mpeg4-avi": Kind("avi", "mpeg4"),
    "mpeg4-b-frames": Kind("mp4", "mpeg4", options={"bf": "2"}),
    "mpeg2-ts": Kind("ts", "mpeg2video", tick=2e-5),
    "mjpeg-mov": Kind("mov", "mjpeg", "yuvj420p", full=True),
    "mjpeg-avi": Kind("avi", "mjpeg", "yuvj422p", full=True),
    "ffv1-avi": Kind("avi", "ffv1", "gray", full=True, error=1e-3),
    "ffv1-mkv": Kind("mkv", "ffv1", error=1e-3, tick=MS),
    "ffv1-alpha": Kind("mkv", "ffv1", "yuva420p", error=1e-3, tick=MS),
    "prores-mov": Kind("mov", "prores_ks", "yuv422p10le"),
    "gif": Kind("gif", "gif", "gray", full=True, rate=Fraction(25), error=1e-3),
    "rate-29.97": Kind("mp4", "libx264", options=X264, rate=Fraction(30000, 1001)),
    "rate-12.5": Kind("mp4", "libx264", options=X264, rate=Fraction(25, 2)),
    "rate-120": Kind("mkv", "libx264", options=X264, rate=Fraction(120), tick=MS),
    "variable-mp4": Kind("mp4", "libx264", options=X264, times=IRREGULAR),
    "variable-mkv": Kind("mkv", "libx264", options=X264, times=IRREGULAR, tick=MS),
    "variable-webm": Kind("webm", "libvpx-vp9", options=VP9, times=IRREGULAR, tick=MS),
    "delayed-mp4": Kind(
        "mp4", "libx264", options=X264, times=tuple(5000 + 40 * t for t in range(12))
    ),
    "delayed-mkv": Kind(
        "mkv", "libx264", options=X264, times=tuple(5000 + 40 * t for t in range(12)), tick=MS
    ),
    "delayed-ts": Kind(
        "ts", "libx264", options=X264, times=tuple(5000 + 40 * t for t in range(12)), tick=2e-5
    ),
    "odd-size": Kind("mkv", "ffv1", "gray", 97, 63, full=True, error=1e-3, tick=MS),
    "odd-size-h264": Kind("mp4", "libx264", "yuv444p", 97, 63, options=X264),
    "one-pixel": Kind("mkv", "ffv1", "gray", 1, 1, full=True, error=1e-3, tick=MS),
    "very-wide": Kind("mp4", "libx264", width=256, height=32, options=X264),
    "very-tall": Kind("mp4", "libx264", width=32, height=256, options=X264),
    "4096x2160": Kind("mp4", "libx264", width=4096, height=2160, frames=1, options=X264),
    "one-frame": Kind("mp4", "libx264", frames=1, options=X264),
    "two-frames": Kind("mkv", "libx264", frames=2, options=X264, tick=MS),
    "one-frame-gif": Kind("gif", "gif", "gray", frames=1, full=True, error=1e-3),
}
