"""The videos and frames of the benchmarks; they follow from a seed."""

from __future__ import annotations

from fractions import Fraction
from typing import TYPE_CHECKING, Any

import av
import cv2
import numpy as np

from oppload_cli.video.writers import ON_ANY_PROCESSOR

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from numpy.typing import NDArray


def _scene(width: int, height: int, frames: int) -> Iterator[NDArray[np.uint8]]:
    """Yield colour pictures: a drifting texture, and a disk that looms again and again."""
    rng = np.random.default_rng(1)
    coarse = rng.integers(0, 256, (height // 8, (width + 2 * frames) // 8 + 2, 3), np.uint8)
    ground = cv2.resize(coarse, (width + 2 * frames + 16, height), interpolation=cv2.INTER_CUBIC)
    for t in range(frames):
        image = np.array(ground[:, 2 * t : 2 * t + width], np.uint8)
        radius = int(height * 0.02 / max(0.02, 1 - (t % 90) / 90))
        cv2.circle(image, (width // 2, height // 2), min(radius, height), (20, 20, 20), -1)
        yield image


def h264(folder: Path, width: int, height: int, frames: int) -> Path:
    """Return an H.264 file of the scene; make it if it does not exist."""
    path = folder / f"scene-{width}x{height}-{frames}.mp4"
    if path.exists():
        return path
    folder.mkdir(parents=True, exist_ok=True)
    part = path.with_suffix(".part.mp4")
    with av.open(str(part), "w") as container:
        options = {"preset": "veryfast", "crf": "23", **ON_ANY_PROCESSOR}
        stream: Any = container.add_stream("libx264", rate=Fraction(30), options=options)
        stream.codec_context.thread_count = 1  # another number gives other bytes
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        for image in _scene(width, height, frames):
            frame = av.VideoFrame.from_ndarray(image, format="bgr24")
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    part.rename(path)
    return path


def luminance(width: int, height: int, frames: int) -> list[NDArray[np.float32]]:
    """Return the luminance of the scene, frame by frame."""
    return [
        cv2.cvtColor(image, cv2.COLOR_BGR2GRAY).astype(np.float32) / np.float32(255)
        for image in _scene(width, height, frames)
    ]
