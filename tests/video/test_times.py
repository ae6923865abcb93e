"""Times of files: equal, backward and uneven ones, coarse clocks, joined streams, slow motion."""

from __future__ import annotations

import os
from fractions import Fraction
from functools import cache
from itertools import pairwise
from threading import Thread
from typing import TYPE_CHECKING, Any

import av
import numpy as np
import pytest

from oppload_cli import open_video, read_result
from oppload_cli.frame_times import TICKS_PER_S, ticks
from tests.cli.inside import oppload
from tests.media import grey_frames, write_video
from tests.results.make import rows_of

if TYPE_CHECKING:
    from pathlib import Path

MS = Fraction(1, 1000)
TS = Fraction(1, 90_000)
CODECS = {
    "mp4": ("libx264", "yuv420p", TS),
    "mov": ("mjpeg", "yuvj420p", TS),
    "mkv": ("ffv1", "gray", MS),
    "webm": ("libvpx", "yuv420p", MS),
    "ts": ("mpeg2video", "yuv420p", TS),
    "avi": ("ffv1", "gray", None),
    "nut": ("ffv1", "gray", TS),
    "flv": ("flv", "yuv420p", MS),
    "3gp": ("libx264", "yuv420p", TS),
    "mpg": ("mpeg2video", "yuv420p", TS),
}
FRAMES = 40


@cache
def coded(codec: str, pixel_format: str) -> list[bytes]:
    """Return 40 pictures, each coded without the others."""
    stream: Any = av.CodecContext.create(codec, "w")
    stream.width, stream.height, stream.pix_fmt = 32, 24, pixel_format
    stream.time_base, stream.framerate = Fraction(1, 30), Fraction(30)
    stream.thread_count, stream.options = 1, {"g": "1", "bf": "0"}
    images = grey_frames(FRAMES, 32, 24)
    frames = [av.VideoFrame.from_ndarray(image, "gray") for image in images]
    for index, frame in enumerate(frames):
        frame.pts, frame.time_base = index, Fraction(1, 30)
    return [bytes(packet) for frame in [*frames, None] for packet in stream.encode(frame)]


def write_times(path: Path, times: list[int], tick_s: Fraction) -> Path:
    """Write 40 pictures with any presentation times; those of AVI must increase."""
    codec, pixel_format, _ = CODECS[path.suffix[1:]]
    # Each decode time is below all later presentation times, and above the one before.
    latest = np.minimum.accumulate(times[::-1])[::-1] - np.arange(len(times), 0, -1)
    # An edit list would hide the pictures after the time of the last one.
    options = {"use_editlist": "0"} if path.suffix in {".mp4", ".mov", ".3gp"} else {}
    with av.open(str(path), "w", options=options) as target:
        stream: Any = target.add_stream(codec, rate=30, options={"g": "1", "bf": "0"})
        stream.width, stream.height, stream.pix_fmt = 32, 24, pixel_format
        stream.time_base = tick_s
        contents = zip(coded(codec, pixel_format), times, latest.tolist(), strict=True)
        for content, time, decoded_at in contents:
            packet = av.Packet(content)
            packet.stream, packet.time_base, packet.is_keyframe = stream, tick_s, True
            packet.pts, packet.dts = time, time if path.suffix == ".avi" else decoded_at
            packet.duration = 1
            target.mux(packet)
    return path


def times_in(path: Path) -> tuple[list[int], Fraction]:
    """Return the presentation times of a file in its own ticks, and the length of a tick."""
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        packets = [packet for packet in container.demux(stream) if packet.size]
        times = [packet.dts if path.suffix == ".avi" else packet.pts for packet in packets]
        assert stream.time_base
        return [time for time in times if time is not None], stream.time_base


def cells_of(path: Path) -> list[str]:
    """Return the cells of `time_s` of a run, and check that the result can be read."""
    done = oppload("run", path, "-o", path.parent, "--model", "frame_difference", "--quiet")
    assert done.returncode == 0, done.stderr
    table = path.parent / f"{path.stem}.frames.csv"
    assert len(read_result(table).frames) == len(rows_of(table))
    return [row["time_s"] for row in rows_of(table)]


def check_cells(path: Path) -> None:
    """Check that times increase, and stay within a tick of the file's until those go back."""
    cells, (own, tick_s) = cells_of(path), times_in(path)
    assert len(cells) == len(own) >= FRAMES // 2
    assert all(float(before) < float(after) for before, after in pairwise(cells))
    for cell, time, after in zip(cells, own, [*own[1:], own[-1]], strict=True):
        assert abs(Fraction(cell) - (time - own[0]) * tick_s) <= tick_s + Fraction(1, 10**9)
        if after < time:
            break


STEPS = {  # from frame to frame, in frames
    "even": (1,),
    "equal": (0, 1, 2),
    "often equal": (0, 0, 0, 1),
    "backward": (-3, 1, 1, 1, 2),
    "jitter": (0.5, 0.8, 1, 1.2, 1.5),
    "gaps": (1, 1, 1, 1, 50),
}


@pytest.mark.long
@pytest.mark.parametrize("kind", STEPS)
@pytest.mark.parametrize("suffix", CODECS)
def test_the_times_of_a_table_increase_and_are_those_of_the_file(
    tmp_path: Path, suffix: str, kind: str
) -> None:
    """At 0.1 to 20,000 frames/s, in files of ten kinds."""
    random = np.random.default_rng([list(CODECS).index(suffix), list(STEPS).index(kind)])
    rate = float(10 ** random.uniform(-1, np.log10(20_000)))
    # AVI has no equal times. It fills ticks without a frame, and has at most 600 ticks per second.
    rate = min(rate, 300) if suffix == "avi" else rate
    tick_s = CODECS[suffix][2] or Fraction(1 / rate).limit_denominator(10_000) / 2
    steps = random.choice(STEPS[kind], FRAMES - 1) / rate / float(tick_s)
    times = np.round(np.cumsum([0, *steps])).astype(int)
    if suffix == "avi":
        times = np.cumsum([0, *np.maximum(1, np.diff(times))])
    times += (0 if suffix == "avi" else 1000) - times.min()
    check_cells(write_times(tmp_path / f"a.{suffix}", times.tolist(), tick_s))


@pytest.mark.parametrize("suffix", ["mp4", "mkv", "ts"])
def test_a_table_of_repeated_times_can_be_read_and_drawn(tmp_path: Path, suffix: str) -> None:
    """Recorders of a screen write a time twice where the next picture comes late."""
    steps = np.random.default_rng(3).integers(0, 3, FRAMES - 1) * 33
    times = 1000 + np.cumsum([0, *steps])
    path = write_times(tmp_path / f"a.{suffix}", times.tolist(), MS)
    check_cells(path)
    drawn = oppload("plot", tmp_path / "a.frames.csv", "-o", tmp_path / "a.png")
    assert drawn.returncode == 0, drawn.stderr


@pytest.mark.parametrize("suffix", ["mp4", "ts", "mkv"])
def test_frames_that_are_an_hour_apart_keep_their_times(tmp_path: Path, suffix: str) -> None:
    times = (1000 + np.arange(FRAMES) * 3600 * 1000).tolist()
    if suffix == "ts":  # its clock starts anew after 26 hours
        times = [time // 100 for time in times]
    check_cells(write_times(tmp_path / f"a.{suffix}", times, MS))


@pytest.mark.parametrize("rate", [2000, pytest.param(10_000, marks=pytest.mark.long)])
def test_frames_faster_than_the_clock_of_matroska_keep_their_times(
    tmp_path: Path, rate: int
) -> None:
    count = rate * 2 // 5
    path = write_video(tmp_path / "a.mkv", grey_frames(count, 32, 24), rate=rate)
    with open_video(path) as video:
        times = np.array([frame.time_s for frame in video])
        assert video.times.rate == pytest.approx(rate, rel=0.01)
    assert np.abs(times - np.arange(count) / rate).max() < 0.001  # the last one: 0.4 s
    with open_video(path, true_rate=2 * rate) as video:
        assert [frame.time_s for frame in video][-1] == pytest.approx(0.2, abs=0.0005)
        assert video.facts.rate_in_file == rate


EVEN_MS = np.arange(90) * 100 / 3
PAUSE_MS = EVEN_MS + 10_000 * (np.arange(90) >= 45)
DROPPED_MS = np.delete(EVEN_MS, np.arange(4, 84, 3))
JITTER_MS = EVEN_MS + np.random.default_rng(1).uniform(-4, 4, 90)


@pytest.mark.parametrize(
    ("name", "times_ms", "declared"),
    [
        ("recorded.webm", EVEN_MS, False),
        ("recorded.webm", JITTER_MS, False),
        *((f"pause.{suffix}", PAUSE_MS, True) for suffix in ("mp4", "mkv", "ts", "avi")),
        *((f"dropped.{suffix}", DROPPED_MS, True) for suffix in ("mp4", "mkv", "ts", "avi")),
    ],
)
def test_the_true_rate_divides_by_the_usual_step(
    tmp_path: Path, name: str, times_ms: Any, declared: bool
) -> None:
    """Whatever FFmpeg's average is: 1000/s, 7/s and 20/s here instead of 30/s."""
    codec = {"webm": "libvpx", "avi": "mpeg4"}.get(name.rpartition(".")[2], "libx264")
    path = write_video(
        tmp_path / name,
        grey_frames(len(times_ms)),
        codec=codec,
        pixel_format="yuv420p",
        rate=30 if declared else 1000,
        times=[round(float(time)) for time in times_ms],
        time_base=MS,
        options={"lag-in-frames": "0"} if codec == "libvpx" else {"bf": "0"},
        container={} if declared else {"live": "1"},  # as a browser records
    )
    with open_video(path) as video:
        times = [frame.time_s for frame in video]
        assert video.facts.frame_rate is None or video.facts.frame_rate == pytest.approx(
            30, rel=0.01
        )
        assert not any("declared" in remark for remark in video.times.remarks())
    assert times == pytest.approx((times_ms - times_ms[0]) / 1000, abs=0.001)
    with open_video(path, true_rate=240) as video:
        scaled = [frame.time_s for frame in video]
        assert video.facts.rate_in_file == pytest.approx(30, rel=0.01)
        assert not any("declared" in remark for remark in video.times.remarks())
        assert not any("bursts" in remark for remark in video.times.remarks())
    assert scaled == pytest.approx([time / 8 for time in times], rel=0.01)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="named pipes are files on Unix only")
def test_the_ticks_of_a_pipe_are_no_rate(tmp_path: Path) -> None:
    """A pipe cannot be read twice, so that the usual step is not known when it is opened."""
    content = write_video(
        tmp_path / "a.webm",
        grey_frames(12),
        codec="libvpx",
        pixel_format="yuv420p",
        rate=1000,
        times=[33 * index for index in range(12)],
        time_base=MS,
        options={"lag-in-frames": "0"},
        container={"live": "1"},
    ).read_bytes()
    pipe = tmp_path / "pipe.webm"
    os.mkfifo(pipe)
    writer = Thread(target=pipe.write_bytes, args=[content])
    writer.start()
    with open_video(pipe) as video:
        assert [frame.time for frame in video] == [index * ticks(0.033) for index in range(12)]
        assert (video.facts.frame_rate, video.times.remarks()) == (None, [])
    writer.join()


@pytest.mark.parametrize("codec", ["libx264", "mpeg2video"])
def test_uneven_times_without_reordering_are_presentation_times(tmp_path: Path, codec: str) -> None:
    """The stream says that pictures might be reordered, and MP4 lists only one time of each."""
    random = np.random.default_rng(1)
    noise = [random.integers(0, 255, (48, 64), np.uint8) for _ in range(64)]
    never_b = "bframes=2:b-adapt=1:b-bias=-100:b-pyramid=none"
    options = {"x264-params": never_b} if codec == "libx264" else {"bf": "0"}
    even = write_video(
        tmp_path / "even.mp4", noise, codec=codec, pixel_format="yuv420p", options=options
    )
    times, path = np.cumsum(random.integers(1, 5, 64)).tolist(), tmp_path / "a.mp4"
    with av.open(even) as source, av.open(path, "w") as target:
        stream = target.add_stream_from_template(source.streams.video[0])
        packets = [packet for packet in source.demux(video=0) if packet.size]
        for packet, time in zip(packets, times, strict=True):
            packet.pts = packet.dts = time
            packet.time_base, packet.stream = Fraction(1, 30), stream
            target.mux(packet)
    with open_video(path) as video:
        found = [frame.time for frame in video]
        assert video.times.wrong == 0
    assert found == [(time - times[0]) * TICKS_PER_S // 30 for time in times]
    with av.open(path) as container:
        assert container.streams.video[0].codec_context.has_b_frames or codec == "mpeg2video"


@pytest.mark.parametrize(
    ("suffix", "codec"), [("ts", "libx264"), ("ts", "mpeg2video"), ("mpg", "mpeg1video")]
)
@pytest.mark.parametrize("earlier_s", [3, 3600])
def test_joined_streams_whose_clock_begins_earlier_go_on_one_step_later(
    tmp_path: Path, suffix: str, codec: str, earlier_s: int
) -> None:
    """FFmpeg takes the earlier time for a clock of 33 bits that began anew, and adds 2^33."""
    joined = tmp_path / f"joined.{suffix}"
    with joined.open("wb") as file:
        for start_s in (earlier_s, 0):
            part = write_video(
                tmp_path / f"part.{suffix}",
                grey_frames(30),
                codec=codec,
                pixel_format="yuv420p",
                rate=25,
                times=[25 * start_s + index for index in range(30)],
                time_base=Fraction(1, 25),
            )
            file.write(part.read_bytes())
    with open_video(joined) as video:
        assert [frame.time for frame in video] == [index * ticks(0.04) for index in range(60)]
        assert video.times.as_dict()["longest_step_s"] == pytest.approx(0.04)
        assert video.times.wrong == 2
        assert video.decode.complete, video.decode.messages
