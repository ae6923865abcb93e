"""Files that claim too much are refused before memory is taken; the limit can be raised."""

from __future__ import annotations

import struct
import sys
import zlib
from functools import cache
from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest
from PIL import Image

from oppload_cli.errors import ParameterError, SourceError
from oppload_cli.video.frames import (
    DEFAULT_MAX_PIXELS,
    MAX_PIXELS,
    InputFacts,
    WorkingSize,
    max_pixels,
    too_large,
)
from oppload_cli.video.source import open_video
from tests.cli import inside
from tests.cli.process import in_turn, python
from tests.robustness.inputs import KINDS, Kind, make

if TYPE_CHECKING:
    from pathlib import Path

MOST_MEMORY = 1 << 30


def png(width: int, height: int) -> bytes:
    """A black image that declares a size, but has the data of only one row."""

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
    """Write a small file that declares 65,535 x 65,535 pixels, or the most of its format."""
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


@pytest.mark.long
@pytest.mark.skipif(sys.platform == "win32", reason="limits of memory are of POSIX")
def test_decompression_bombs_are_refused_in_little_memory(tmp_path: Path) -> None:
    # The size in the data of the last one, H.264, counts, not the container's: the video is read.
    paths = [bomb(tmp_path, name) for name in ("images", "ffv1-avi", "gif", "h264-mp4")]
    code = (
        "import resource, sys\n"
        f"resource.setrlimit(resource.RLIMIT_AS, ({MOST_MEMORY}, {MOST_MEMORY}))\n"
        "from oppload_cli.cli import main\n"
        "for path in sys.argv[2:]:\n"
        "    try:\n"
        "        main(['run', path, '-o', sys.argv[1], '-q', '--no-rmo'])\n"
        "    except SystemExit as ended:\n"
        "        print(int(ended.code))\n"
    )
    out = tmp_path / "out"
    done = python(code, out, *paths, OPENBLAS_NUM_THREADS="1", OPENCV_FOR_THREADS_NUM="1")
    *refused, read = done.stdout.split()
    assert (refused, read in {"0", "3", "4"}) == (["3"] * 3, True), done.stderr
    assert "bug" not in done.stderr
    assert "MemoryError" not in done.stderr
    assert done.stderr.count(MAX_PIXELS) == 3 + (read == "3")


def test_the_limit_can_be_moved(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = make(tmp_path / "a.avi", KINDS["mpeg4-avi"])  # 96 x 64
    monkeypatch.setenv(MAX_PIXELS, str(96 * 64))
    with open_video(path) as video:
        assert len(list(video)) == 12
    assert not too_large(96, 64, 8)
    monkeypatch.setenv(MAX_PIXELS, str(96 * 64 - 1))
    assert too_large(96, 64, 8)  # a picture of few bits counts as one of the usual 12
    with pytest.raises(
        SourceError, match=f"declares 96 x 64 pixels, more than 6143; set {MAX_PIXELS}"
    ):
        open_video(path)
    cv2.imwrite(str(tmp_path / "0.png"), np.zeros((64, 96), np.uint8))
    with pytest.raises(SourceError, match="declares 96 x 64 pixels"):
        open_video(tmp_path)


@pytest.mark.parametrize("value", ["", "0", "-5", "many", "1e6", "99999999999", "٣"])
def test_a_wrong_limit(monkeypatch: pytest.MonkeyPatch, value: str) -> None:
    monkeypatch.setenv(MAX_PIXELS, value)
    with pytest.raises(ParameterError, match=MAX_PIXELS):
        max_pixels()


def test_a_wrong_limit_is_no_fault_of_the_input(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    video = make(tmp_path / "a.avi", KINDS["mpeg4-avi"])
    folder = tmp_path / "frames"
    folder.mkdir()
    cv2.imwrite(str(folder / "0.png"), np.zeros((64, 96), np.uint8))
    monkeypatch.setenv(MAX_PIXELS, "abc")
    for path in (video, folder):
        done = inside.oppload("run", path, "-o", tmp_path / "out")
        assert done.returncode == 2
        sentence = "OPPLOAD_MAX_PIXELS must be a whole number from 1 to 2147483647, not 'abc'"
        assert done.stderr == f"oppload: {sentence}\n"


def test_the_limit_by_default(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(MAX_PIXELS, raising=False)
    assert max_pixels() == DEFAULT_MAX_PIXELS == 8192 * 8192


def tiff_of_two_sizes(first: tuple[int, int], second: tuple[int, int]) -> bytes:
    """A grey, compressed image whose header states width and height twice."""
    strip = zlib.compress(bytes(30000), 9)
    start = 8 + 2 + 12 * 11 + 4
    sizes = [
        (tag, 4, size)
        for both in (first, second)
        for tag, size in zip((256, 257), both, strict=True)
    ]
    others = [(258, 3, 8), (259, 3, 8), (262, 3, 1), (273, 4, start)]
    others += [(277, 3, 1), (278, 4, 30000), (279, 4, len(strip))]
    entries = b"".join(
        struct.pack("<HHII", tag, kind, 1, value) for tag, kind, value in [*sizes, *others]
    )
    return b"II*\0" + struct.pack("<IH", 8, 11) + entries + bytes(4) + strip


def jpeg_with_a_hidden_head() -> bytes:
    """30000 x 30000 pixels, according to a header that some readers ignore."""
    data = bytearray(cv2.imencode(".jpg", np.full((16, 16), 128, np.uint8))[1].tobytes())
    head = data.index(b"\xff\xc0")
    length = 2 + int.from_bytes(data[head + 2 : head + 4])
    hidden = b"\xff\x00" + struct.pack(">H", 2 + length)
    large = bytearray(data[head : head + length])
    large[5:9] = struct.pack(">HH", 30000, 30000)
    return bytes(data[:2] + hidden + large + data[2:])


def sparse_png(path: Path) -> None:
    with path.open("wb") as file:
        file.write(png(64, 48))
        file.truncate(6 << 30)


LYING = {
    "jpeg-hidden-head": jpeg_with_a_hidden_head(),
    "tiff-large-last": tiff_of_two_sizes((16, 16), (30000, 30000)),
    "tiff-large-first": tiff_of_two_sizes((30000, 30000), (16, 16)),
    "png-text": None,
    "png-sparse": None,
}


@pytest.mark.long
@pytest.mark.skipif(sys.platform == "win32", reason="limits of memory are of POSIX")
def test_images_that_lie_about_their_size_take_little_memory(tmp_path: Path) -> None:
    for name, data in LYING.items():
        (tmp_path / name).mkdir()
        path = tmp_path / name / "0.png"
        if name == "png-sparse":
            sparse_png(path)
        else:
            path.write_bytes(data or png_with_much_text())
        for index in (1, 2):
            path.with_name(f"{index}.png").hardlink_to(path)
    code = (
        "import resource, sys\n"
        "from fractions import Fraction\n"
        "from oppload_cli.errors import SourceError\n"
        "from oppload_cli.video.images import ImageSource\n"
        f"resource.setrlimit(resource.RLIMIT_AS, ({MOST_MEMORY}, {MOST_MEMORY}))\n"
        "for folder in sys.argv[1:]:\n"
        "    try:\n"
        "        shapes = [p.plane.shape for p in ImageSource(folder, Fraction(30)).pictures()]\n"
        "        assert set(shapes) <= {(16, 16), (48, 64)}, (folder, shapes)\n"
        "    except SourceError as error:\n"
        "        assert 'none of these images can be read' in str(error), (folder, error)\n"
    )
    folders = [tmp_path / name for name in LYING]
    done = python(code, *folders, OPENBLAS_NUM_THREADS="1", OPENCV_FOR_THREADS_NUM="1")
    assert done.returncode == 0, done.stderr


@cache
def png_with_much_text() -> bytes:
    """A compressed text of 300 MB before the pixels."""
    data = png(64, 48)
    packer = zlib.compressobj(wbits=-15)
    million = packer.compress(bytes(1_000_000)) + packer.flush(zlib.Z_FULL_FLUSH)
    checksum = struct.pack(">I", (300_000_000 % 65521 << 16) + 1)  # of as many zeros
    text = b"zTXta\0\0" + b"\x78\x9c" + million * 300 + b"\x03\0" + checksum
    place = data.index(b"IDAT") - 4
    chunk = struct.pack(">I", len(text) - 4) + text + struct.pack(">I", zlib.crc32(text))
    return data[:place] + chunk + data[place:]


def test_a_later_frame_that_is_too_large_is_a_failure(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    parts = [
        make(tmp_path / f"{width}.ts", Kind("ts", "mpeg2video", width=width)) for width in (96, 128)
    ]
    path = tmp_path / "both.ts"
    path.write_bytes(b"".join(part.read_bytes() for part in parts))
    monkeypatch.setenv(MAX_PIXELS, str(96 * 64))
    with open_video(path, height=16) as video:
        assert 10 <= len(list(video)) <= 13
        assert video.decode.failures >= 10
        assert any("a frame of 128 x 64 pixels" in each for each in video.decode.messages)


@pytest.mark.parametrize(("width", "height", "working"), [(580, 1, 240), (1, 9000, None)])
def test_a_thin_video_is_not_enlarged_without_end(
    width: int, height: int, working: int | None
) -> None:
    facts = InputFacts("thin.mkv", "container", width, height, None, None)
    if working:
        with pytest.raises(ParameterError, match="a working size of 139200 x 240 is too large"):
            WorkingSize.of(facts, working)
    else:
        assert WorkingSize.of(facts, working).shape == (height, width)


def test_the_limit_of_pillow_does_not_count(tmp_path: Path) -> None:
    before = Image.MAX_IMAGE_PIXELS
    (tmp_path / "0.png").write_bytes(png(65535, 65535))
    with pytest.raises(SourceError, match="declares 65535 x 65535 pixels"):
        open_video(tmp_path)
    assert before == Image.MAX_IMAGE_PIXELS


@pytest.mark.long
def test_every_exit_code_from_a_real_process(tmp_path: Path) -> None:
    """The exit codes 0, 2, 3 and 4, and 1 after a bug; test_interruption has 130."""
    intact = make(tmp_path / "intact.avi", KINDS["mpeg4-avi"])
    cut = tmp_path / "cut.avi"
    data = intact.read_bytes()
    cut.write_bytes(data[: (data.index(b"movi") + data.index(b"idx1")) // 2])
    quick = ("--height", "24", "-q", "-o", tmp_path / "out")
    paths = (intact, intact, tmp_path / "none.avi", cut)
    assert in_turn(*(("run", path, *quick) for path in paths)).returncodes == [0, 2, 3, 4]
    code = (
        "import oppload_cli.pipeline.execute as task, sys\n"
        "def broken(*_, **__): raise ZeroDivisionError('on purpose')\n"
        "task.run_task = broken\n"
        "from oppload_cli.cli import main\n"
        "main(['run', sys.argv[1], '-o', sys.argv[2]])\n"
    )
    done = python(code, intact, tmp_path / "bug")
    assert done.returncode == 1
    assert done.stderr.startswith("oppload: this is a bug (ZeroDivisionError: on purpose)")
