"""Pictures as files store them: from the lowest row, or with fewer bits than a sample has."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, Any

import av
import numpy as np
import pytest

from oppload_cli.video.source import open_video

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

HEIGHT, WIDTH = 48, 64


def pictures(count: int = 3) -> list[NDArray[np.uint8]]:
    """Grey pictures whose top is dark, and in which a bright square at the right falls."""
    shown = []
    for index in range(count):
        grey = np.full((HEIGHT, WIDTH), 100, np.uint8)
        grey[:10] = 20
        grey[14 + 4 * index : 22 + 4 * index, 40:56] = 200
        shown.append(grey)
    return shown


def write_cine(path: Path, bits: int, *, in_setup: bool = True) -> Path:
    """Write the file of a Phantom camera at 1000 frames/s: head, setup, offsets, pictures.

    The bits of a sample stand in the setup, or as a number of grey levels in the pictures' head.
    """
    shown = pictures()
    kind, largest = (np.uint8, 255) if bits == 8 else (np.dtype("<u2"), 2**bits - 1)
    stored = [(grey[::-1] / 255 * largest).round().astype(kind).tobytes() for grey in shown]
    setup = bytearray(6000)
    setup[140:142] = b"ST"
    struct.pack_into("<H", setup, 142, len(setup))
    struct.pack_into("<I", setup, 768, 1000)
    struct.pack_into("<I", setup, 896, bits if in_setup else 0)
    levels = 0 if in_setup else 2**bits
    sample = 8 if bits == 8 else 16
    of_setup, of_offsets = 44 + 40, 44 + 40 + len(setup)
    head = struct.pack("<2sHHHiIiI", b"CI", 44, 0, 1, 0, len(shown), 0, len(shown))
    head += struct.pack("<III8x", 44, of_setup, of_offsets)
    head += struct.pack(
        "<IiiHHIIiiII", 40, WIDTH, HEIGHT, 1, sample, 0, len(stored[0]), 0, 0, levels, 0
    )
    first, size = of_offsets + 8 * len(shown), 8 + len(stored[0])
    offsets = b"".join(struct.pack("<q", first + place * size) for place in range(len(shown)))
    samples = b"".join(struct.pack("<II", 8, len(picture)) + picture for picture in stored)
    path.write_bytes(head + bytes(setup) + offsets + samples)
    return path


def write_avi(path: Path, codec: str, pixel_format: str) -> Path:
    with av.open(str(path), "w", format="avi") as written:
        stream: Any = written.add_stream(codec, rate=30)
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, pixel_format
        if codec == "amv":
            stream.codec_context.options = {"qscale": "1", "strict": "-1"}
        for grey in [*pictures(), None]:
            frame = None if grey is None else av.VideoFrame.from_ndarray(grey, "gray")
            if frame is not None and codec == "rawvideo":
                frame = frame.reformat(format=pixel_format)
            written.mux(stream.encode(frame))
    return path


@pytest.mark.parametrize("colour", [False, True])
@pytest.mark.parametrize("kind", ["8", "12 in the setup", "12 by levels", "16", "amv", "bgr24"])
def test_pictures_have_the_values_and_the_order_of_rows_that_the_file_means(
    kind: str, colour: bool, tmp_path: Path
) -> None:
    path = tmp_path / ("a.avi" if kind in {"amv", "bgr24"} else "a.cine")
    if kind == "amv":
        write_avi(path, "amv", "yuvj420p")
    elif kind == "bgr24":
        write_avi(path, "rawvideo", "bgr24")
    else:
        write_cine(path, int(kind.split(maxsplit=1)[0]), in_setup="levels" not in kind)
    with open_video(path, height=None, colour=colour) as video:
        frames = list(video)
    assert len(frames) == 3
    tolerance = 0.03 if kind == "amv" else 0.005  # AMV is lossy
    for frame, grey in zip(frames, pictures(), strict=True):
        assert np.abs(frame.luma - grey / 255).mean() < tolerance
        if colour and frame.colour is not None:
            shown = frame.colour[..., 1] / 255
            assert np.abs(shown - grey / 255).mean() < max(tolerance, 0.02)
    if path.suffix == ".cine":
        assert [frame.time_s for frame in frames] == [0, 0.001, 0.002]
