"""What the tests show to the models: images, and videos made on the spot."""

from __future__ import annotations

from fractions import Fraction
from typing import TYPE_CHECKING, Any

import av
import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from pathlib import Path

    from numpy.typing import NDArray

    Luma = NDArray[np.float32]


def disk(size: int, x: float, y: float, radius: float) -> Luma:
    """A black disk on white, antialiased; pixel i covers [i, i + 1)."""
    across = np.arange(size) + 0.5
    distance = np.hypot(across[None, :] - x, across[:, None] - y)
    return np.asarray(1 - np.clip(radius - distance + 0.5, 0, 1), np.float32)


def looming(size: int, x: float, y: float, frames: int) -> list[Luma]:
    """A disk of radius 5 + 4 t."""
    return [disk(size, x, y, 5 + 4 * t) for t in range(frames)]


def edge(speed: float, frames: int, width: int = 200, height: int = 40) -> Iterator[Luma]:
    """A straight vertical edge of contrast 1 that moves right."""
    x = np.arange(width)
    for t in range(frames):
        row = np.clip(30 + speed * t - x, 0, 1)
        yield np.tile(row, (height, 1)).astype(np.float32)


def texture(height: int, width: int, seed: int) -> Luma:
    """Smooth random luminance, 0 to 1."""
    from scipy.ndimage import gaussian_filter

    values = gaussian_filter(np.random.default_rng(seed).random((height, width)), 3, mode="wrap")
    low, high = values.min(), values.max()
    return np.asarray((values - low) / (high - low), np.float32)


def grey_frames(count: int, width: int = 64, height: int = 48, seed: int = 0) -> list[Any]:
    """Moving grey images of 8 bits, each different."""
    base = (texture(height, width + count, seed) * 255).round().astype(np.uint8)
    return [np.ascontiguousarray(base[:, t : t + width]) for t in range(count)]


def write_video(
    path: Path,
    frames: Iterable[NDArray[Any]],
    *,
    codec: str = "ffv1",
    pixel_format: str = "gray",
    source_format: str = "gray",
    rate: Fraction | int = 30,
    times: list[int] | None = None,
    time_base: Fraction | None = None,
    full_range: bool = False,
    options: dict[str, str] | None = None,
    container: dict[str, str] | None = None,
) -> Path:
    """Encode images as a video; `times` are presentation times in units of `time_base`."""
    pictures = [av.VideoFrame.from_ndarray(image, format=source_format) for image in frames]
    with av.open(str(path), "w", options=container or {}) as written:
        stream: Any = written.add_stream(codec, rate=Fraction(rate), options=options or {})
        stream.height, stream.width = pictures[0].height, pictures[0].width
        stream.pix_fmt = pixel_format
        if codec.startswith(("libvpx", "libx264")):
            # libvpx's threads wait for each other in a loop; libx264's number changes the bytes.
            stream.codec_context.thread_count = 1
        if full_range:
            stream.codec_context.color_range = 2
        if time_base:
            stream.codec_context.time_base = time_base
        for index, frame in enumerate(pictures):
            if times is not None:
                frame.pts, frame.time_base = times[index], time_base or Fraction(1, rate)
            for packet in stream.encode(frame):
                written.mux(packet)
        for packet in stream.encode():
            written.mux(packet)
    return path


def write_film(path: Path, width: int = 64, height: int = 48, times: int = 60) -> Path:
    """Write 60 pictures many times: a video longer than any test waits, encoded in no time."""
    with av.open(str(path), "w") as written:
        stream: Any = written.add_stream("mpeg4", rate=30, options={"g": "1"})
        stream.height, stream.width, stream.pix_fmt = height, width, "yuv420p"
        pictures = [
            av.VideoFrame.from_ndarray(grey, "gray") for grey in grey_frames(60, width, height)
        ]
        packets = [packet for picture in [*pictures, None] for packet in stream.encode(picture)]
        contents = [bytes(packet) for packet in packets]
        for at, content in enumerate(contents * times):
            packet = av.Packet(content)
            packet.stream, packet.pts, packet.dts = stream, at, at
            packet.time_base, packet.is_keyframe = Fraction(1, 30), True
            written.mux(packet)
    return path
