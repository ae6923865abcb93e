"""What tells of damage: declared frames that never came, and errors that decoders only log."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from random import Random
from typing import TYPE_CHECKING

import pytest

from oppload_cli.errors import SourceError
from oppload_cli.video.source import open_video
from tests.robustness.inputs import KINDS, QUIET_265, X264, Kind, make

if TYPE_CHECKING:
    from pathlib import Path

FRAGMENTS = {"movflags": "frag_keyframe+empty_moov"}
# Declared frames, declared ends, or the decoder tell that these files were cut.
CUTS = {
    "ffv1-mkv": KINDS["ffv1-mkv"],
    "gif": KINDS["gif"],
    "fragments": Kind("mp4", "libx264", options=X264),
    "nut": Kind("nut", "ffv1"),
    "mjpeg": Kind("mjpeg", "mjpeg", "yuvj420p"),
    "ivf": Kind("ivf", "libvpx"),
    "mxf": Kind("mxf", "mpeg2video", rate=Fraction(25)),
    "apng": Kind("apng", "apng", "rgb24"),
}
# Of 12 cuts: those between two pictures or fragments.
MOST_UNNOTICED = {"gif": 2, "fragments": 1}


@pytest.mark.parametrize("name", CUTS)
def test_a_cut_file_is_incomplete_and_a_complete_one_is_not(tmp_path: Path, name: str) -> None:
    kind = replace(CUTS[name], width=160, height=96, frames=24)
    options = FRAGMENTS if name == "fragments" else {}
    path = make(tmp_path / f"a.{kind.suffix}", kind, options)
    data, unnoticed, random = path.read_bytes(), 0, Random(5)  # noqa: S311
    with open_video(path, height=16) as video:
        assert len(list(video)) == 24
        assert video.decode.messages == []
    for _ in range(12):
        path.write_bytes(data[: random.randrange(len(data) // 20, len(data))])
        try:
            with open_video(path, height=16) as video:
                unnoticed += len(list(video)) < 24 and video.decode.complete
        except SourceError:
            continue
    assert unnoticed <= MOST_UNNOTICED.get(name, 0)


def test_frames_that_an_mxf_file_has_lost_are_missed(tmp_path: Path) -> None:
    path = make(tmp_path / "a.mxf", Kind("mxf", "mpeg2video", rate=Fraction(25)))
    data = bytearray(path.read_bytes())
    picture = bytes.fromhex("060e2b34010201010d01030115010500")  # the key of a coded picture
    places = [at for at in range(len(data)) if data.startswith(picture, at)]
    assert len(places) == 12
    data[places[5] : places[8]] = bytes(places[8] - places[5])
    path.write_bytes(data)
    with open_video(path, height=16) as video:
        count = len(list(video))
        assert video.facts.frames_declared == 12
        assert video.decode.missing == 12 - count > 0


HASHED = f"{QUIET_265}:keyint=6:hash=1"
SUMS = {
    "ffv1-avi": (Kind("avi", "ffv1", width=160, height=96, options={"slicecrc": "1"}), 1),
    "ffv1-nut": (Kind("nut", "ffv1", width=160, height=96, options={"slicecrc": "1"}), 3),
    "gif": (Kind("gif", "gif", "gray", 160, 96, rate=Fraction(25)), 3),
    "png-mov": (Kind("mov", "png", "rgb24", 160, 96), 1),
    "hevc-hash": (Kind("mp4", "libx265", options={"x265-params": HASHED}), 3),
}


@pytest.mark.parametrize("name", SUMS)
def test_concealed_errors_are_counted_with_any_number_of_threads(tmp_path: Path, name: str) -> None:
    kind, threads = SUMS[name]
    path = make(tmp_path / f"a.{kind.suffix}", replace(kind, frames=24))
    data, random = path.read_bytes(), Random(2)  # noqa: S311

    def seen(count: int) -> tuple[bytes, bool]:
        try:
            with open_video(path, height=16, threads=count) as video:
                pixels = b"".join(frame.luma.tobytes() for frame in video)
                return pixels, video.decode.complete
        except SourceError:
            return b"", False

    intact, complete = seen(threads)
    assert complete
    silent = changed = 0
    for _ in range(10):
        damaged = bytearray(data)
        for _ in range(6):
            place = random.randrange(len(data) // 4, len(data) * 3 // 4)
            damaged[place] ^= 1 << random.randrange(8)
        path.write_bytes(damaged)
        first = seen(1)
        assert seen(3) == first
        changed += first[0] != intact
        silent += first[0] != intact and first[1]
    assert changed > 2
    assert silent <= (2 if name == "gif" else 0)  # other indices of colours are valid ones


def test_errors_that_a_decoder_logs_for_intact_files_are_no_damage(tmp_path: Path) -> None:
    """Cameras write data beside a JPEG picture that FFmpeg does not know."""
    path = make(tmp_path / "a.mjpeg", Kind("mjpeg", "mjpeg", "yuvj420p"))
    data = path.read_bytes()
    strange = b"\xff\xe1\x00\x0aExif\x00\x00zz"
    path.write_bytes(data.replace(b"\xff\xd8", b"\xff\xd8" + strange))
    with open_video(path, height=16) as video:
        assert len(list(video)) == 12
        assert video.decode.messages == []
