"""Files that claim too much are refused before memory is taken; the limit can be raised."""

from __future__ import annotations

import os
import struct
import subprocess
import sys
import zlib
from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest

from oppload_cli.errors import ParameterError, SourceError
from oppload_cli.video.image_size import declared_size
from oppload_cli.video.limits import DEFAULT_MOST_PIXELS, VARIABLE, most_pixels
from oppload_cli.video.source import open_video
from tests.cli.process import oppload
from tests.robustness.inputs import KINDS, make

if TYPE_CHECKING:
    from pathlib import Path

MOST_MEMORY = 1 << 30


def png(width: int, height: int) -> bytes:
    """A grey image of that size, all black, as small as it can be: one row is all there is."""

    def chunk(kind: bytes, content: bytes) -> bytes:
        return (
            struct.pack(">I", len(content))
            + kind
            + content
            + struct.pack(">I", zlib.crc32(kind + content))
        )

    head = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    rows = zlib.compress(bytes(width + 1), 9)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", rows) + chunk(b"IEND", b"")


def bomb(folder: Path, name: str) -> Path:
    """Write a small file that declares 65,535 x 65,535 pixels, or as many as it can."""
    if name == "images":
        folder = folder / "images"
        folder.mkdir()
        for index in range(3):
            (folder / f"{index}.png").write_bytes(png(65535, 65535))
        return folder
    path = make(folder / f"{name}.{KINDS[name].suffix}", KINDS[name])
    data = bytearray(path.read_bytes())
    if path.suffix == ".avi":  # both headers
        data[data.index(b"avih") + 40 : data.index(b"avih") + 48] = struct.pack("<II", 65535, 65535)
        start = data.index(b"strf") + 8
        data[start + 4 : start + 12] = struct.pack("<ii", 65535, 65535)
    elif path.suffix == ".gif":
        data[6:10] = struct.pack("<HH", 65535, 65535)
    else:  # the track's header, and the entry of the sample table
        place = data.index(b"tkhd") + 4 + 76
        data[place : place + 8] = struct.pack(">II", 65535 << 16, 65535 << 16)
        place = data.index(b"stsd") + 4 + 8 + 8 + 24
        data[place : place + 4] = struct.pack(">HH", 65535, 65535)
    path.write_bytes(data)
    return path


@pytest.mark.parametrize("name", ["images", "ffv1-avi", "gif", "h264-mp4"])
def test_a_decompression_bomb_is_refused_in_little_memory(tmp_path: Path, name: str) -> None:
    path = bomb(tmp_path, name)
    code = (
        "import resource, sys\n"
        f"resource.setrlimit(resource.RLIMIT_AS, ({MOST_MEMORY}, {MOST_MEMORY}))\n"
        "from oppload_cli.cli import main\n"
        "main(['run', sys.argv[1], '-o', sys.argv[2], '-q', '--no-rmo'])\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(path), str(tmp_path / "out")],
        capture_output=True,
        text=True,
        check=False,
        env={"OPENBLAS_NUM_THREADS": "1", "OPENCV_FOR_THREADS_NUM": "1", **os.environ},
    )
    # H.264 knows its size better than the container does, and is read.
    knows = name == "h264-mp4"
    assert done.returncode in ({0, 3, 4} if knows else {3}), done.stderr
    assert "bug" not in done.stderr
    assert "MemoryError" not in done.stderr
    if done.returncode == 3:
        assert VARIABLE in done.stderr


def test_the_limit_can_be_moved(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = make(tmp_path / "a.avi", KINDS["mpeg4-avi"])  # 96 x 64
    monkeypatch.setenv(VARIABLE, str(96 * 64))
    with open_video(path) as video:
        assert len(list(video)) == 12
    monkeypatch.setenv(VARIABLE, str(96 * 64 - 1))
    with pytest.raises(
        SourceError, match=f"declares 96 x 64 pixels, more than 6143; set {VARIABLE}"
    ):
        open_video(path)
    cv2.imwrite(str(tmp_path / "0.png"), np.zeros((64, 96), np.uint8))
    with pytest.raises(SourceError, match="declares 96 x 64 pixels"):
        open_video(tmp_path)


@pytest.mark.parametrize("value", ["", "0", "-5", "many", "1e6", "99999999999", "٣"])
def test_a_wrong_limit(monkeypatch: pytest.MonkeyPatch, value: str) -> None:
    monkeypatch.setenv(VARIABLE, value)
    with pytest.raises(ParameterError, match=VARIABLE):
        most_pixels()


def test_the_limit_by_default(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(VARIABLE, raising=False)
    assert most_pixels() == DEFAULT_MOST_PIXELS == 8192 * 8192


@pytest.mark.parametrize("suffix", ["png", "jpg", "bmp", "tiff", "webp", "pgm", "ppm", "pbm"])
def test_the_size_that_an_image_declares(suffix: str) -> None:
    for width, height in ((1, 1), (7, 300), (641, 2)):
        image = np.full((height, width, 3), 200, np.uint8)
        grey = image[..., 0] if suffix in {"pgm", "pbm"} else image
        encoded = cv2.imencode(f".{suffix}", grey)[1].tobytes()
        assert declared_size(encoded) == (width, height)
        for length in range(0, min(len(encoded), 200), 3):  # a cut header is no size, and no error
            assert declared_size(encoded[:length]) in {None, (width, height)}


def test_lossless_and_extended_webp() -> None:
    image = np.full((30, 40, 4), 90, np.uint8)
    lossless = cv2.imencode(".webp", image, [cv2.IMWRITE_WEBP_QUALITY, 101])[1].tobytes()
    assert declared_size(lossless) == (40, 30)
    extended = b"RIFF\0\0\0\0WEBPVP8X\x0a\0\0\0\0\0\0\0" + (16383).to_bytes(3, "little") * 2
    assert declared_size(extended) == (16384, 16384)


def test_every_exit_code_from_a_real_process(tmp_path: Path) -> None:
    """0, 2, 3 and 4 here; 130 in test_interruption, 1 by an error put in on purpose."""
    whole = make(tmp_path / "whole.avi", KINDS["mpeg4-avi"])
    cut = tmp_path / "cut.avi"
    data = whole.read_bytes()
    cut.write_bytes(data[: (data.index(b"movi") + data.index(b"idx1")) // 2])
    quick = ("--height", "24", "-q", "-o", tmp_path / "out")
    assert oppload("run", whole, *quick).returncode == 0
    assert oppload("run", whole, *quick).returncode == 2
    assert oppload("run", tmp_path / "none.avi", *quick).returncode == 3
    assert oppload("run", cut, *quick).returncode == 4
    code = (
        "import oppload_cli.task as task, sys\n"
        "def broken(*_): raise ZeroDivisionError('on purpose')\n"
        "task.run_task = broken\n"
        "from oppload_cli.cli import main\n"
        "main(['run', sys.argv[1], '-o', sys.argv[2]])\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(whole), str(tmp_path / "bug")],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 1
    assert done.stderr.startswith("oppload: this is a bug (ZeroDivisionError: on purpose)")
