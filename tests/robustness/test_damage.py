"""Damaged files: no traceback, no hang, no crash, nothing lost that can be had, no lie."""

from __future__ import annotations

import json
import os
import re
import shutil
import socket
import subprocess
import sys
from collections import Counter
from itertools import chain, count
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from oppload_cli.errors import SourceError
from oppload_cli.video import container, demuxer
from oppload_cli.video.declared import declared_end
from oppload_cli.video.source import open_video
from tests.cli.inside import oppload
from tests.media import grey_frames, write_video
from tests.robustness.damage import VICTIMS, intact
from tests.robustness.inputs import AV1, KINDS, X264, Kind, make, shown
from tools.attack.server import Server

if TYPE_CHECKING:
    from collections.abc import Iterable

SECONDS_PER_FILE = 20  # a hang, not slowness: a file takes some hundredths


def outcomes(seed: int, count: int, ffmpeg: str = "") -> list[dict[str, Any]]:
    """Read damaged files in another process; what it does not survive is named."""
    done = subprocess.run(
        [
            *(sys.executable, "-X", "faulthandler", "-m", "tests.robustness.damage"),
            *(str(seed), str(count), ffmpeg),
        ],
        capture_output=True,
        text=True,
        check=False,
        timeout=60 + SECONDS_PER_FILE * count,
        cwd=Path(__file__).parents[2],
        env={**os.environ, "SVT_LOG": "0"},
    )
    lines = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]
    assert done.returncode == 0, f"{lines[-1:]} ended with {done.returncode}: {done.stderr[-2000:]}"
    results = [line for line in lines if "frames" in line]
    assert len(results) == count
    return results


def check(results: list[dict[str, Any]]) -> None:
    less = [each for each in results if each["frames"] < each["reference"]]
    silent = [
        each for each in results if each["complete"] and each["frames"] < each["intact_frames"]
    ]
    changed = [each for each in results if each["frames"] and not each["same"]]
    quiet = [each for each in changed if each["complete"]]
    shifting = [each for each in results if not each["steady"]]
    report: dict[str, Any] = {
        "files": len(results),
        "frames": sum(each["frames"] for each in results),
        "frames of the reference": sum(each["reference"] for each in results),
        "less than the reference": less,
        "frames lost in silence": Counter(each["name"] for each in silent),
        "other with another number of threads": Counter(each["name"] for each in shifting),
        "other pixels": len(changed),
        "other pixels in silence": Counter(each["name"] for each in quiet),
    }
    sys.stdout.write("".join(f"{name}: {value}\n" for name, value in report.items()))
    # One of several threads of H.264 may lose the mark of a concealed frame: then the file is not
    # decoded again by one thread.
    assert len(shifting) <= 0.005 * len(results)
    assert all(each["name"].startswith("h264") for each in shifting)
    # Bits that leave a valid stream of VP8, VP9, HEVC or GIF show nowhere, and a transport stream
    # does not say what it should hold.
    assert len(quiet) <= 0.18 * len(changed)
    assert all(each["message"] for each in results if not each["complete"])
    # MP4, MOV and AVI say how many frames they hold; damage may leave a valid edit list that
    # hides some. Elsewhere the file may close over the hole.
    counted = [each for each in silent if KINDS[each["name"]].suffix in {"mp4", "mov", "avi"}]
    assert len(counted) <= 0.01 * len(results)
    assert len(silent) <= 0.05 * len(results)
    # With frame threads ffmpeg shows what VP8 predicts from a key frame that failed. And
    # versions of the libraries differ a little in what they make of damage.
    assert len([each for each in less if each["name"] != "vp8-webm"]) <= 0.02 * len(results)
    assert report["frames"] >= 0.99 * report["frames of the reference"]


@pytest.mark.long
def test_damaged_files() -> None:
    check(outcomes(1, len(VICTIMS) * 3))


@pytest.mark.slow
def test_a_thousand_damaged_files() -> None:
    ffmpeg = os.environ.get("REFERENCE_FFMPEG") or shutil.which("ffmpeg") or ""
    check(outcomes(2, len(VICTIMS) * 5 * 14, ffmpeg))
    if not ffmpeg:
        pytest.skip("NOT COMPARED with ffmpeg: there is none; PyAV was the reference")


def cuts(data: bytes, count: int) -> Iterable[bytes]:
    return (data[: len(data) * place // (count + 1)] for place in range(1, count + 1))


FEWER = ("h264-mp4", "gif")  # no transport stream: a cut one looks complete
SLOWER = ("h264-mkv", "mjpeg-mov", "av1-mkv", "vp9-webm", "mpeg4-avi")
MORE = [pytest.param(name, marks=pytest.mark.slow) for name in SLOWER]


@pytest.mark.long
@pytest.mark.parametrize("name", [*FEWER, *MORE])
def test_truncations_are_never_taken_for_the_end(tmp_path: Path, name: str) -> None:
    data = intact(tmp_path, name)
    frames, unnoticed = [], 0
    path = tmp_path / f"cut.{KINDS[name].suffix}"
    for part in cuts(data, 50):
        path.write_bytes(part)
        try:
            with open_video(path, height=16) as video:
                frames.append(len(list(video)))
                unnoticed += video.decode.complete and frames[-1] < 24
        except SourceError:
            frames.append(0)
    assert frames == sorted(frames)
    assert frames[-1] >= 22
    # A GIF that happens to be cut at its own end mark looks complete. Matroska allows for the time
    # of a last frame of unknown duration.
    assert unnoticed <= {".gif": 3, ".mkv": 4}.get(path.suffix, 0)


def test_damage_has_the_same_effect_at_every_run(tmp_path: Path) -> None:
    """With frame threads, concealment was a race: this file differed between runs."""
    data = bytearray(intact(tmp_path, "prores-mov"))
    rng = np.random.default_rng(5)
    for place in rng.integers(1000, len(data) - 2000, 30):
        data[place] ^= 0x40
    path = tmp_path / "x.mov"
    path.write_bytes(data)
    seen = set()
    for _ in range(5):
        with open_video(path, height=None) as video:
            seen.add(b"".join(frame.luma.tobytes() for frame in video))
    assert len(seen) == 1


def test_a_container_that_declares_too_many_frames(tmp_path: Path) -> None:
    path = make(tmp_path / "a.avi", KINDS["mpeg4-avi"])
    data = bytearray(path.read_bytes())
    del data[data.index(b"idx1") :]  # with its index it would be believed
    for head in (data.index(b"avih") + 8 + 16, data.index(b"strh") + 8 + 32):
        data[head : head + 4] = (5000).to_bytes(4, "little")
    path.write_bytes(data)
    done = oppload("run", path, "-o", tmp_path)
    assert done.returncode == 4
    decode = json.loads((tmp_path / "a.oppload.json").read_text())["decode"]
    assert (decode["declared"], decode["decoded"], decode["missing"]) == (5000, 12, 4988)


@pytest.mark.skipif(sys.platform == "win32", reason="links need a right there")
def test_an_image_that_vanishes_and_one_that_is_a_link_to_nothing(tmp_path: Path) -> None:
    import cv2

    for index, image in enumerate(grey_frames(6)):
        cv2.imwrite(str(tmp_path / f"{index}.png"), image)
    (tmp_path / "2.png").unlink()
    (tmp_path / "2.png").symlink_to(tmp_path / "nowhere.png")
    with open_video(tmp_path, height=16) as video:
        iterator = iter(video)
        assert next(iterator).index == 0
        assert [frame.index for frame in iterator] == [1, 3, 4, 5]
        assert not video.decode.complete


@pytest.mark.long
@pytest.mark.skipif(sys.platform == "win32", reason="an open file cannot be removed there")
def test_a_file_that_vanishes_or_shrinks_while_it_is_read(tmp_path: Path) -> None:
    images = grey_frames(200, width=160, height=96)
    complete = write_video(tmp_path / "complete.avi", images, codec="ffv1")
    for name in ("gone.avi", "short.avi"):
        path = tmp_path / name
        path.write_bytes(complete.read_bytes())
        with open_video(path, height=16) as video:
            frames = iter(video)
            next(frames)
            if name == "gone.avi":
                path.unlink()  # what is open stays readable
            else:
                with path.open("r+b") as file:
                    file.truncate(path.stat().st_size // 2)
            count = 1 + len(list(frames))
        assert count == 200 if name == "gone.avi" else 20 < count < 200
        assert video.decode.complete is (name == "gone.avi")


def test_a_file_that_grows_while_it_is_read(tmp_path: Path) -> None:
    """What it holds by the time it is read to the end is read; nothing else goes wrong."""
    complete = write_video(tmp_path / "a.avi", grey_frames(100, width=160, height=96), codec="ffv1")
    data = complete.read_bytes()
    path = tmp_path / "growing.avi"
    path.write_bytes(data[: len(data) // 2])
    with open_video(path, height=16) as video:
        frames = iter(video)
        next(frames)
        with path.open("ab") as file:
            file.write(data[len(data) // 2 :])
        count = 1 + len(list(frames))
        assert 48 <= count <= 100
        assert video.decode.missing == 100 - count


def test_a_size_that_changes_midway(tmp_path: Path) -> None:
    small, large = (
        make(tmp_path / f"{width}.ts", Kind("ts", "mpeg2video", width=width)) for width in (96, 192)
    )
    path = tmp_path / "both.ts"
    path.write_bytes(small.read_bytes() + large.read_bytes())
    with open_video(path, height=32) as video:
        frames = list(video)
        assert (video.facts.width, video.working.shape) == (96, (32, 48))
        # The join is a fault of the stream, and may cost a frame.
        assert any("the size becomes 192 x 64" in message for message in video.decode.messages)
    assert {frame.luma.shape for frame in frames} == {(32, 48)}
    assert len(frames) >= 22


def test_a_capture_that_begins_between_key_frames(tmp_path: Path) -> None:
    """Its first frames are damaged; the others are complete, and their times begin at the first."""
    kind = Kind("ts", "libx264", frames=40, options={"preset": "ultrafast", "g": "20"})
    data = make(tmp_path / "complete.ts", kind).read_bytes()
    path = tmp_path / "late.ts"
    path.write_bytes(data[len(data) // 4 // 188 * 188 :])
    with open_video(path, height=None) as video:
        frames = list(video)
        assert not video.decode.complete
    assert 19 <= len(frames) < 40
    assert frames[0].time_s == 0
    last = frames[-1]
    assert float(last.luma[:, :24].mean()) == pytest.approx(shown(kind, 39), abs=0.01)


@pytest.mark.long
def test_a_stream_of_a_server_is_read_to_its_end(tmp_path: Path) -> None:
    path = make(tmp_path / "a.mkv", KINDS["ffv1-mkv"])
    with Server(path, 1) as server, open_video(server.url) as video:
        assert len(list(video)) == 12
        assert video.decode.complete
        assert video.facts.kind == "stream"


STREAMED = {
    "ts": ("libx264", X264),
    "mkv": ("ffv1", {}),
    "avi": ("mpeg4", {}),
    "flv": ("flv1", {}),
    "nut": ("mpeg4", {}),
    "ivf": ("libsvtav1", AV1),
    "y4m": ("wrapped_avframe", {}),
}


@pytest.mark.long
@pytest.mark.parametrize("suffix", STREAMED)
def test_a_stream_that_breaks_off_gives_its_rows_and_the_reason(
    tmp_path: Path, suffix: str
) -> None:
    codec, options = STREAMED[suffix]
    path = make(tmp_path / f"a.{suffix}", Kind(suffix, codec, frames=60, options=options))
    with Server(path, 0.6) as server, open_video(server.url, height=16) as video:
        # As many as of a local file that is cut at the same place.
        assert 20 <= len(list(video)) <= 40
        assert any("the stream broke off" in each for each in video.decode.messages)


@pytest.mark.long
def test_a_stream_that_breaks_off_in_its_first_frames(tmp_path: Path) -> None:
    """The frame that the decoder still holds then has a time stamp, but no time base of its own."""
    path = make(tmp_path / "a.mkv", Kind("mkv", "mpeg1video", frames=10))
    with Server(path, 0.3) as server, open_video(server.url, height=16) as video:
        assert len(list(video)) == 1
        assert video.decode.missing == 9


@pytest.mark.long
def test_a_run_on_a_stream_that_breaks_off(tmp_path: Path) -> None:
    path = make(tmp_path / "a.y4m", Kind("y4m", "wrapped_avframe", frames=60))
    with Server(path, 0.6) as server:
        done = oppload("run", server.url, "-o", tmp_path, "--height", "16", "-q")
    assert done.returncode == 4
    (sidecar,) = tmp_path.glob("*.oppload.json")
    decode = json.loads(sidecar.read_text())["decode"]
    assert decode["decoded"] == 35
    (message,) = decode["messages"]
    assert message in {
        "the stream broke off (input/output error)",
        "the stream broke off (I/O error)",  # of FFmpeg on Windows
    }


@pytest.mark.long
def test_a_stream_that_stalls(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(container, "READ_TIMEOUT_S", 0.5)
    path = make(tmp_path / "a.ts", Kind("ts", "libx264", frames=60, options=X264))
    with Server(path, 0.6, stalls=True) as server, open_video(server.url, height=16) as video:
        assert len(list(video)) > 20
        assert video.decode.messages == ["the stream broke off (no picture came for 0.5 s)"]


@pytest.mark.long
def test_a_packet_that_comes_after_the_time_limit_is_the_last(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of RTSP, FFmpeg still has a packet at the time limit, and would then wait once more."""
    path = make(tmp_path / "a.ts", Kind("ts", "mpeg2video", frames=20))
    clock = chain([0.0] * 20, count(0.0, 12.0))
    monkeypatch.setattr(container, "monotonic", lambda: next(clock))
    with Server(path, 1) as server, open_video(server.url, height=16) as video:
        assert 0 < len(list(video)) < 20
        assert video.decode.messages == ["the stream broke off (no picture came for 10 s)"]


@pytest.mark.parametrize("scheme", ["tcp", "rtsp"])
def test_an_address_from_which_nothing_comes(monkeypatch: pytest.MonkeyPatch, scheme: str) -> None:
    monkeypatch.setattr(demuxer, "_OPEN_TIMEOUT_S", 0.05)
    with socket.create_server(("127.0.0.1", 0)) as silent:
        address = f"{scheme}://127.0.0.1:{silent.getsockname()[1]}"
        with pytest.raises(SourceError, match=r"no video came within 0.05 s\); check the address"):
            open_video(address)


def test_more_demux_errors_than_are_borne(tmp_path: Path) -> None:
    """A head of a frame that is damaged: the demuxer never finds its way again."""
    path = make(tmp_path / "a.y4m", Kind("y4m", "wrapped_avframe", frames=24))
    data = path.read_bytes()
    places = [match.start() for match in re.finditer(rb"FRAME\n", data)]
    path.write_bytes(data[: places[20]] + b"fRAME" + data[places[20] + 5 :])
    with open_video(path, height=16) as video:
        assert len(list(video)) == 20
        assert video.decode.failures > 0


@pytest.mark.parametrize(
    ("tag", "end"),
    [
        ("00:01:02.500000000", 62.5),
        ("9" * 400 + ":00:00.0", None),
        ("9" * 5000 + ":1:1", None),
        ("1:1:" + "9" * 5000, None),
        ("0:0:0." + "9" * 5000, 1.0),
        ("", None),
    ],
)
def test_a_declared_duration_of_any_length(tag: str, end: float | None) -> None:
    muxed: Any = SimpleNamespace(
        format=SimpleNamespace(name="matroska,webm"), streams=[1], duration=None
    )
    stream: Any = SimpleNamespace(metadata={"DURATION": tag}, duration=None)
    assert declared_end(muxed, stream) == end


@pytest.mark.parametrize("name", ["mpeg4-avi", "ffv1-avi", "av1-ivf", "h264-mkv", "vp9-webm"])
def test_files_that_were_written_to_a_pipe_are_complete(tmp_path: Path, name: str) -> None:
    path = make(tmp_path / f"a.{KINDS[name].suffix}", KINDS[name], to_pipe=True)
    with open_video(path, height=16) as video:
        assert len(list(video)) == 12
        assert video.decode.complete
        assert video.decode.messages == []
