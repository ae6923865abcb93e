"""Videos over HTTP, from a server on this machine that states a length, or none; RTP."""

from __future__ import annotations

import json
import re
import socket
import sys
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from itertools import pairwise
from threading import Event, Thread
from typing import TYPE_CHECKING

import cv2
import pytest

from oppload_cli.errors import SourceError
from oppload_cli.video import container
from oppload_cli.video.source import open_video
from tests.cli.inside import oppload
from tests.media import grey_frames, write_video

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from oppload_cli.video.frames import DecodeFacts

FRAMES = 20
# The format, its encoder, and whether the container says how long it is.
KINDS = [
    ("mkv", "ffv1", "gray", True),
    ("mp4", "libx264", "yuv420p", True),
    ("y4m", "rawvideo", "yuv420p", False),
    ("ts", "mpeg2video", "yuv420p", False),
]


@contextmanager
def served(
    content: bytes, stated: int | None, kind: str = "application/octet-stream"
) -> Iterator[str]:
    """Give the address of a file that is sent once per request, and then the connection closes."""

    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def do_GET(self) -> None:
            self.send_response(200)
            if stated is not None:
                self.send_header("Content-Length", str(stated))
            self.send_header("Content-Type", kind)
            self.send_header("Connection", "close")
            self.end_headers()
            self.wfile.write(content)

        def log_message(self, *_: object) -> None:
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        thread = Thread(target=server.serve_forever, args=(0.01,))
        thread.start()
        try:
            yield f"http://127.0.0.1:{server.server_address[1]}/a"
        finally:
            server.shutdown()
            thread.join()


def decoded(content: bytes, stated: int | None) -> DecodeFacts:
    with served(content, stated) as address, open_video(address) as video:
        assert all(frame.luma.shape == (240, 320) for frame in video)
        return video.decode


@pytest.mark.parametrize(("suffix", "codec", "pixels", "declares"), KINDS)
def test_an_answer_without_a_length(
    tmp_path: Path, suffix: str, codec: str, pixels: str, declares: bool
) -> None:
    """The video is complete at the end of the answer, unless the container declares more."""
    frames = grey_frames(FRAMES)
    content = write_video(
        tmp_path / f"a.{suffix}",
        frames,
        codec=codec,
        pixel_format=pixels,
        options={"g": "1"},  # frames of equal size, so that the cut is between frames
        container={"movflags": "+faststart"} if suffix == "mp4" else {},
    ).read_bytes()
    whole = decoded(content, None)
    assert (whole.decoded, whole.complete, whole.messages) == (FRAMES, True, [])
    cut = decoded(content[: len(content) * 7 // 10], None)
    assert 4 < cut.decoded < FRAMES
    assert (cut.missing > 0) is declares
    assert not (declares and cut.complete)


def test_an_answer_that_is_shorter_than_stated_broke_off(tmp_path: Path) -> None:
    content = write_video(tmp_path / "a.mkv", grey_frames(FRAMES)).read_bytes()
    cut = decoded(content[: len(content) * 7 // 10], len(content))
    assert (cut.complete, cut.failures) == (False, 1)
    # FFmpeg says it in other words on Windows.
    broke_off = {
        f"the stream broke off ({reason})" for reason in ("input/output error", "I/O error")
    }
    assert broke_off & set(cut.messages)
    assert decoded(content, len(content)).complete


def jpegs(count: int) -> bytes:
    """Return what a network camera sends: images without times."""
    images = [cv2.imencode(".jpg", image)[1].tobytes() for image in grey_frames(count)]
    head = b"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: %d\r\n\r\n"
    return b"".join(head % len(image) + image + b"\r\n" for image in images)


OF_A_CAMERA = "multipart/x-mixed-replace; boundary=frame"


def test_images_of_a_network_camera_have_the_times_of_their_arrival(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """They carry no times, and FFmpeg assumes 25 frames/s."""
    clock = iter([100.0, 100.08, 100.2, 100.25])
    monkeypatch.setattr(container, "perf_counter", lambda: next(clock, 101.0))
    with served(jpegs(4), None, OF_A_CAMERA) as address, open_video(address) as video:
        assert [frame.time_s for frame in video] == pytest.approx([0, 0.08, 0.2, 0.25])
        assert (video.facts.frame_rate, video.facts.rate_assumed) == (None, False)


def test_images_of_a_network_camera_that_come_in_pairs_have_times_apart(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def use_clock() -> None:
        clock = iter([100 + number // 2 / 15 + number % 2 * 0.002 for number in range(40)])
        monkeypatch.setattr(container, "perf_counter", lambda: next(clock, 110.0))

    use_clock()
    with served(jpegs(40), None, OF_A_CAMERA) as address:
        with open_video(address) as video:
            frames = list(video)
        use_clock()
        options = ("--height", "48", "--no-rmo", "-o", tmp_path)
        assert oppload("run", address, *options).returncode == 0
    for before, after in pairwise(frames):
        if before.index > 20:  # frames that came too fast for this machine were dropped
            step_s = (after.time_s - before.time_s) / (after.index - before.index)
            assert step_s == pytest.approx(1 / 30, rel=0.25)
    (sidecar,) = tmp_path.glob("*.oppload.json")
    assert json.loads(sidecar.read_bytes())["time"]["smoothed_arrivals"] > 20


def test_no_result_and_no_message_holds_a_login(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    content = write_video(tmp_path / "a.mkv", grey_frames(1)).read_bytes()
    options = ("--height", "48", "--no-rmo", "-o", tmp_path / "results")
    with served(content, len(content)) as address:
        host = address.removeprefix("http://")
        named = f"http://me:s3cr@t9@{host}"
        words = ("run", named, *options, "--if-exists", "skip")
        monkeypatch.setattr(sys, "argv", ["oppload", *map(str, words)])
        done, again = oppload(*words), oppload(*words)
    assert (done.returncode, again.returncode) == (0, 0)
    assert f"{address}: OppLoD no alarm" in done.stderr
    assert re.search(r"1 frame in [0-9.]+ s -> ", done.stderr)
    assert f"{address}: skipped" in again.stderr
    written = sorted((tmp_path / "results").iterdir())
    stem = "http-" + host.replace(":", "-").replace("/", "-")
    assert {each.name.partition(".frames")[0] for each in written} >= {stem}
    texts = [done.stderr, again.stderr, *(f"{each} {each.read_text()}" for each in written)]
    assert not any("s3cr" in text or "t9" in text for text in texts)


def test_rtp_that_needs_a_description_is_explained(tmp_path: Path) -> None:
    """FFmpeg says only "invalid data" of an SDP file, and of packets that one has to describe."""
    description = tmp_path / "a.sdp"
    description.write_text(
        "v=0\no=- 0 0 IN IP4 127.0.0.1\ns=a\nc=IN IP4 127.0.0.1\nt=0 0\n"
        "m=video 9 RTP/AVP 96\na=rtpmap:96 H264/90000\n"
    )
    packet = bytes([0x80, 96, *range(10)]) + bytes(100)  # 96: a type that a description explains
    done = Event()
    with socket.socket(type=socket.SOCK_DGRAM) as sender, socket.socket(type=2) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
        free.close()

        def send() -> None:
            while not done.wait(0.01):
                sender.sendto(packet, ("127.0.0.1", port))

        sending = Thread(target=send)
        sending.start()
        try:
            for name in (str(description), f"rtp://127.0.0.1:{port}"):
                with pytest.raises(SourceError, match=r"RTP needs an SDP file .* -c copy -f matr"):
                    open_video(name)
        finally:
            done.set()
            sending.join()
