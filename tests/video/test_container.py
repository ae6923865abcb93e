from __future__ import annotations

import inspect
import struct
import sys
from fractions import Fraction
from itertools import accumulate, cycle, islice
from typing import TYPE_CHECKING, Any

import av
import cv2
import numpy as np
import pytest
from av.bitstream import BitStreamFilterContext
from PIL import Image

from oppload_cli.errors import ParameterError, SourceError, shortage
from oppload_cli.frame_times import seconds_of
from oppload_cli.models.registry import default_names, detector_named
from oppload_cli.video import container
from oppload_cli.video.container import ContainerSource
from oppload_cli.video.frames import MAX_PIXELS
from oppload_cli.video.source import open_video
from oppload_cli.video.span import Position, Span, parse_position
from tests.media import grey_frames, write_video

if TYPE_CHECKING:
    from pathlib import Path

    from oppload_cli.video.frames import Frame


def frames_of(path: Path, **options: Any) -> list[Frame]:
    with open_video(path, **options) as video:
        return list(video)


def test_grey_ffv1_gives_exactly_the_written_pixels(tmp_path: Path) -> None:
    images = grey_frames(7)
    frames = frames_of(write_video(tmp_path / "a.mkv", images), height=None)
    assert [frame.index for frame in frames] == list(range(7))
    for frame, image in zip(frames, images, strict=True):
        np.testing.assert_array_equal(frame.luma, image.astype(np.float32) / np.float32(255))
        assert frame.luma.dtype == np.float32


def test_limited_range_is_expanded(tmp_path: Path) -> None:
    image = np.zeros((48, 64), np.uint8)
    image[:, :16], image[:, 16:32], image[:, 32:48], image[:, 48:] = 16, 235, 0, 126
    yuv = np.full((72, 64), 128, np.uint8)
    yuv[:48] = image
    path = write_video(tmp_path / "a.mkv", [yuv], pixel_format="yuv420p", source_format="yuv420p")
    [frame] = frames_of(path, height=None)
    row = frame.luma[0]
    assert [row[0], row[20], row[40], row[60]] == pytest.approx([0, 1, 0, 110 / 219], abs=1e-7)


@pytest.mark.parametrize("codec", ["h264", "hevc"])
def test_columns_that_a_stream_crops_are_left_out(tmp_path: Path, codec: str) -> None:
    """The left edge of the crop may lie at any even column."""
    image = np.tile(np.linspace(16, 235, 128).round().astype(np.uint8), (64, 1))
    complete, path = tmp_path / f"complete.{codec}", tmp_path / f"a.{codec}"
    options = {"qp": "1"} if codec == "h264" else {"x265-params": "log-level=none:qp=1"}
    encoder = {"h264": "libx264", "hevc": "libx265"}[codec]
    write_video(complete, [image] * 3, codec=encoder, pixel_format="yuv420p", options=options)
    with av.open(str(complete)) as whole, av.open(str(path), "w") as written:
        stream = written.add_stream_from_template(whole.streams.video[0])
        crop = f"{codec}_metadata=crop_left=18:crop_right=6:crop_top=4"
        cropping = BitStreamFilterContext(crop, whole.streams.video[0], stream)
        for packet in whole.demux(video=0):
            for cropped in cropping.filter(packet if packet.size else None):
                cropped.stream = stream
                written.mux(cropped)
    for frame in frames_of(path, height=None):
        assert frame.luma.shape == (60, 104)
        # The gray of the source has a full range, and becomes limited when it is encoded.
        np.testing.assert_allclose(frame.luma[20], image[0, 18:122] / 255, atol=0.03)


def test_rgb_becomes_grey_by_rec_601(tmp_path: Path) -> None:
    colour = np.zeros((48, 64, 3), np.uint8)
    colour[..., 0], colour[..., 1], colour[..., 2] = 200, 100, 50
    path = write_video(tmp_path / "a.mkv", [colour], pixel_format="bgr0", source_format="rgb24")
    [frame] = frames_of(path, height=None)
    grey = round(0.299 * 200 + 0.587 * 100 + 0.114 * 50)
    np.testing.assert_allclose(frame.luma, grey / 255, atol=1e-7)


def test_a_shortage_of_memory_is_no_damage_of_a_frame(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise cv2.error("OpenCV: error: (-4:Insufficient memory) Failed to allocate 9 bytes")

    colour = np.zeros((48, 64, 3), np.uint8)
    path = write_video(tmp_path / "a.mkv", [colour], pixel_format="bgr0", source_format="rgb24")
    monkeypatch.setattr(cv2, "cvtColor", refuse)
    with pytest.raises(cv2.error) as raised:
        frames_of(path)
    assert "memory is short" in shortage(raised.value)


@pytest.mark.parametrize("opacity", [255, 250])
@pytest.mark.parametrize(
    ("suffix", "codec", "pixel_format"),
    [("mov", "qtrle", "argb"), ("mov", "prores_ks", "yuva444p10le"), ("apng", "apng", "rgba")],
)
def test_a_video_with_transparency_gives_a_note(
    tmp_path: Path, suffix: str, codec: str, pixel_format: str, opacity: int
) -> None:
    image = np.full((32, 32, 4), 255, np.uint8)
    image[:16, :, 3] = opacity
    path = write_video(
        tmp_path / f"a.{suffix}",
        [image] * 2,
        codec=codec,
        pixel_format=pixel_format,
        source_format="rgba",
    )
    with open_video(path) as video:
        assert len(list(video)) == 2
        said = ["transparency is left out; draw the pictures on an opaque background first"]
        assert video.decode.messages == (said if opacity < 255 else [])
        assert video.decode.complete


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({}, ""),
        ({"x264-params": "tff=1"}, "the pictures are interlaced: moving edges look like combs"),
        ({"x264-params": "transfer=smpte2084"}, "the pictures are HDR (PQ), whose contrast"),
        ({"x264-params": "transfer=arib-std-b67"}, "the pictures are HDR (HLG), whose contrast"),
    ],
)
def test_interlaced_and_hdr_pictures_give_a_note(
    tmp_path: Path, options: dict[str, str], said: str
) -> None:
    frames, pixels = grey_frames(3), "yuv420p"
    path = write_video(
        tmp_path / "a.mp4", frames, codec="libx264", pixel_format=pixels, options=options
    )
    with open_video(path) as video:
        assert len(list(video)) == 3
        assert len(video.decode.messages) == bool(said)
        assert all(each.startswith(said) for each in video.decode.messages)
        assert video.decode.complete


@pytest.mark.parametrize(
    ("name", "steps", "rate"),
    [
        ("a.gif", [2], 50),  # FFmpeg's average: 100
        ("a.gif", [3, 4, 3], 30),  # 100/3
        ("a.gif", [5, 7, 3, 11], 50 / 3),  # uneven: FFmpeg guesses the ticks, 100
        ("a.apng", [5, 7, 3, 11], 97 / 6),
    ],
)
def test_an_animation_has_the_rate_of_its_times_and_declares_none(
    name: str, steps: list[int], rate: float, tmp_path: Path
) -> None:
    times = list(accumulate(islice(cycle(steps), 23), initial=0))
    path, hundredth = tmp_path / name, Fraction(1, 100)
    write_video(path, grey_frames(24), codec=name[2:], times=times, time_base=hundredth, rate=100)
    with open_video(path) as opened:
        seconds = [frame.time_s for frame in opened]
        assert float(opened.facts.frame_rate or 0) == pytest.approx(rate, rel=2e-3)
        assert opened.times.remarks() == []
    np.testing.assert_allclose(seconds, np.array(times) / 100, atol=1e-5)


def test_raw_dv_has_the_rate_of_its_frames(tmp_path: Path) -> None:
    """FFmpeg's average is 60000, the ticks per second."""
    images = grey_frames(3, 720, 576)
    path = write_video(
        tmp_path / "a.dv", images, codec="dvvideo", pixel_format="yuv420p", rate=Fraction(25)
    )
    with open_video(path) as video:
        assert [frame.time_s for frame in video] == pytest.approx([0, 0.04, 0.08])
        assert (video.facts.frame_rate, video.times.remarks()) == (Fraction(25), [])


def test_a_raw_stream_has_the_rate_that_its_encoder_states(tmp_path: Path) -> None:
    """The file states no times, and FFmpeg assumes 25 frames/s for all such files."""
    path = write_video(tmp_path / "a.h264", grey_frames(6), rate=Fraction(60), codec="libx264")
    with open_video(path) as video:
        assert (video.facts.frame_rate, video.facts.rate_assumed) == (Fraction(60), False)
        assert [frame.time_s for frame in video] == pytest.approx(np.arange(6) / 60)


def test_the_rate_of_a_raw_stream_that_states_none_is_assumed(tmp_path: Path) -> None:
    path = write_video(tmp_path / "a.mjpeg", grey_frames(3), codec="mjpeg", pixel_format="yuvj420p")
    with open_video(path) as video:
        assert (video.facts.frame_rate, video.facts.rate_assumed) == (Fraction(25), True)
    with open_video(path, true_rate=Fraction(50)) as video:
        assert [frame.time_s for frame in video] == pytest.approx([0, 0.02, 0.04])
        assert (video.facts.frame_rate, video.facts.rate_assumed) == (Fraction(50), False)


def test_slow_motion_has_the_times_of_its_true_rate(tmp_path: Path) -> None:
    """Also at uneven times; the end that the file declares is still that of its own clock.

    The usual step is 0.1 s, although 30 frames/s are declared.
    """
    times = [10, 20, 50, 60, 100]
    path = write_video(tmp_path / "a.mkv", grey_frames(5), times=times, time_base=Fraction(1, 100))
    span = Span(start=Position(seconds=0.05))
    with open_video(path) as video:
        own = [frame.time_s for frame in video]
        assert video.facts.frame_rate == 30
    for part, indices in ((None, [0, 1, 2, 3, 4]), (span, [3, 4])):
        with open_video(path, span=part, true_rate=100) as video:
            found = [(frame.index, frame.time_s) for frame in video]
        assert [index for index, _ in found] == indices
        assert [time_s for _, time_s in found] == pytest.approx([own[n] / 10 for n in indices])
        assert (video.facts.frame_rate, video.facts.rate_in_file) == (Fraction(100), Fraction(10))
        assert video.facts.tick_s == Fraction(1, 10_000)
        assert video.decode.complete


def test_presentation_times_are_those_of_the_file(tmp_path: Path) -> None:
    times = [10, 20, 50, 60, 100]
    path = write_video(tmp_path / "a.mkv", grey_frames(5), times=times, time_base=Fraction(1, 100))
    assert [f.time_s for f in frames_of(path)] == pytest.approx([0, 0.1, 0.4, 0.5, 0.9], abs=1e-3)


CODED = {
    "mpeg4": ("mpeg4", {}),
    "mpeg4 with B-frames": ("mpeg4", {"bf": "2"}),
    "mpeg2 with B-frames": ("mpeg2video", {"bf": "2"}),
    "h264 without B-frames": ("libx264", {"bf": "0"}),
    "h264 with one B-frame": ("libx264", {"bf": "1"}),
    "h264 with B-frames": ("libx264", {"bf": "3", "b-adapt": "0"}),
}
TICKS = {
    "even": (list(range(40)), 30),
    "gap": ([t + 7 * (t > 20) for t in range(40)], 30),  # of empty packets
    "fine": ([20 * t for t in range(40)], 600),
}


@pytest.mark.parametrize("threads", [pytest.param(1, marks=pytest.mark.slow), 3])
@pytest.mark.parametrize(
    ("suffix", "coded", "ticks"),
    [
        *(("avi", coded, ticks) for coded in CODED for ticks in ("even", "gap")),
        *(("avi", coded, "fine") for coded in CODED if "mpeg2" not in coded),
        *(("mxf", coded, "even") for coded in CODED if "mpeg4" not in coded),
        *(("wmv", coded, "even") for coded in CODED),
    ],
)
def test_times_of_files_that_carry_decode_times_alone(
    tmp_path: Path, suffix: str, coded: str, ticks: str, threads: int
) -> None:
    """FFmpeg's presentation times of H.264 with B-frames in AVI are 0, 3, 2, 4, 1, 7 and so on."""
    codec, options = CODED[coded]
    times, rate = TICKS[ticks]
    path = write_video(
        tmp_path / f"a.{suffix}",
        grey_frames(40),
        codec=codec,
        pixel_format="yuv420p",
        rate=rate,
        times=times,
        time_base=Fraction(1, rate),
        options=options,
    )
    with open_video(path, threads=threads) as video:
        rounding = 0.04 if suffix == "wmv" else 1e-6  # WMV has times in milliseconds
        assert [frame.time_s * rate for frame in video] == pytest.approx(times, abs=rounding)
        assert video.decode.complete
        assert video.facts.frame_rate == pytest.approx(30, rel=rounding)
        assert video.times.remarks() == []


def test_frames_of_an_avi_of_fine_ticks_are_counted_as_frames(tmp_path: Path) -> None:
    path = write_video(
        tmp_path / "a.avi",
        grey_frames(40),
        codec="mpeg4",
        pixel_format="yuv420p",
        rate=600,
        times=[20 * t for t in range(40)],
        time_base=Fraction(1, 600),
    )
    cut = tmp_path / "cut.avi"
    data = path.read_bytes()
    cut.write_bytes(data[: data.rindex(b"idx1") * 3 // 4])  # without its index
    with open_video(path) as video:
        assert len(list(video)) == video.facts.frames_declared == 40
        assert video.decode.complete
    with open_video(cut) as video:
        count = len(list(video))
        assert 20 < count < 40
        assert video.facts.frames_declared == 40
        assert video.decode.missing == 40 - count


def turned(path: Path, matrix: tuple[int, ...]) -> Path:
    """Write a display matrix into the track header of an MP4 file."""
    data = bytearray(path.read_bytes())
    # Size and kind, version, two times, track, duration, layer and volume come first.
    start = data.index(b"tkhd") + 4 + 4 + 4 * 5 + 8 + 8
    data[start : start + 36] = struct.pack(">9i", *matrix)
    path.write_bytes(data)
    return path


ONE = 1 << 16
# Cameras write the angle by which a player turns the picture clockwise.
MATRICES = {
    0: (ONE, 0, 0, 0, ONE, 0, 0, 0, 1 << 30),
    90: (0, ONE, 0, -ONE, 0, 0, 0, 0, 1 << 30),
    180: (-ONE, 0, 0, 0, -ONE, 0, 0, 0, 1 << 30),
    270: (0, -ONE, 0, ONE, 0, 0, 0, 0, 1 << 30),
}


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("clockwise", MATRICES)
def test_the_orientation_is_that_of_the_display(
    tmp_path: Path, clockwise: int, mirrored: bool
) -> None:
    image = np.full((48, 64), 40, np.uint8)
    image[:16, :16] = 220  # a bright corner, left and top as coded
    path = write_video(tmp_path / "a.mp4", [image] * 3, codec="libx264", pixel_format="yuv420p")
    terms = MATRICES[clockwise]
    if mirrored:  # the first axis of the coded picture points the other way
        terms = (-terms[0], -terms[1], *terms[2:])
    with open_video(turned(path, terms), height=None, colour=True) as video:
        frame = next(iter(video))
        assert (video.facts.rotation, video.facts.mirrored) == (-clockwise % 360, mirrored)
        assert (video.facts.width, video.facts.height) == (frame.luma.shape[1], frame.luma.shape[0])
    bright = np.rot90(image[:, ::-1] if mirrored else image, -clockwise // 90) > 128
    np.testing.assert_array_equal(frame.luma > 0.5, bright)
    assert frame.colour is not None
    np.testing.assert_array_equal(frame.colour[:, :, 1] > 128, bright)


def test_a_turn_by_another_angle_is_left_out_with_a_remark(tmp_path: Path) -> None:
    path = write_video(tmp_path / "a.mp4", grey_frames(3), codec="libx264", pixel_format="yuv420p")
    half = round(ONE / 2**0.5)
    with open_video(turned(path, (half, half, 0, -half, half, 0, 0, 0, 1 << 30))) as video:
        assert len(list(video)) == 3
        assert video.facts.rotation == 0
        assert "a turn by -45 degrees, which is left out" in video.decode.messages[0]


def test_jpeg_with_exif_is_turned_as_it_says(tmp_path: Path) -> None:
    """PyAV does not know this kind of data, and fails on all data of such a frame."""
    image = np.full((48, 64), 40, np.uint8)
    image[:16, :16] = 220  # a bright corner
    exif = Image.Exif()
    exif[0x0112] = 6  # turn it clockwise
    with (tmp_path / "a.mjpeg").open("wb") as file:
        for _ in range(3):
            Image.fromarray(image).save(file, "jpeg", exif=exif.tobytes())
    frames = frames_of(tmp_path / "a.mjpeg", height=None)
    assert len(frames) == 3
    np.testing.assert_array_equal(frames[0].luma > 0.5, np.rot90(image, -1) > 128)


def test_a_turn_is_rounded_to_quarters(tmp_path: Path) -> None:
    """Rounded terms of the matrix give 89.999 degrees, of which PyAV says 89."""
    path = write_video(tmp_path / "a.mp4", grey_frames(2), codec="mpeg4", pixel_format="yuv420p")
    turned(path, (1, ONE, 0, -ONE, 1, 0, 0, 0, 1 << 30))
    with open_video(path) as video:
        assert (video.facts.rotation, video.facts.mirrored) == (270, False)


def test_the_width_follows_the_height(tmp_path: Path) -> None:
    path = write_video(tmp_path / "a.mkv", grey_frames(2, width=128, height=72))
    with open_video(path, height=36) as video:
        frame = next(iter(video))
        assert frame.luma.shape == (36, 64)
        assert (video.working.scale_x, video.working.scale_y) == (2, 2)
    image = grey_frames(2, width=128, height=72)[0].astype(np.float64)
    blocks = image.reshape(36, 2, 64, 2).mean(axis=(1, 3)) / 255
    assert np.abs(frame.luma - blocks).max() <= 0.51 / 255


def test_the_usual_working_height_is_that_of_the_default_detectors() -> None:
    height = inspect.signature(open_video).parameters["height"].default
    assert {detector_named(name).height for name in default_names()} == {height}


@pytest.mark.parametrize("height", [0, -1, "240", 24.5])
def test_a_height_that_is_none(tmp_path: Path, height: Any) -> None:
    path = write_video(tmp_path / "a.mkv", grey_frames(2))
    with pytest.raises(ParameterError, match=f"whole number of at least 1, not {height!r}"):
        open_video(path, height=height)


def test_a_span_keeps_the_ordinals_and_times_of_the_file(tmp_path: Path) -> None:
    path = write_video(tmp_path / "a.mkv", grey_frames(30))
    span = Span(start=parse_position("f10"), duration=parse_position("0.2"))
    frames = frames_of(path, span=span)
    assert [frame.index for frame in frames] == list(range(10, 16))
    assert frames[0].time_s == pytest.approx(1 / 3, abs=1e-3)
    ended = frames_of(path, span=Span(end=parse_position("f3")))
    assert [frame.index for frame in ended] == [0, 1, 2]


@pytest.mark.parametrize("count", range(12, 15))
def test_joined_transport_streams_are_complete(tmp_path: Path, count: int) -> None:
    """The count of the packets jumps, for which FFmpeg marks a packet before as damaged."""
    paths = [tmp_path / f"{name}.ts" for name in ("a", "b")]
    for path, frames in zip(paths, (count, 9), strict=True):
        write_video(path, grey_frames(frames), codec="libx264", pixel_format="yuv420p")
    data = b"".join(path.read_bytes() for path in paths)
    joined, lacking = tmp_path / "joined.ts", tmp_path / "lacking.ts"
    joined.write_bytes(data)
    lacking.write_bytes(data[: 188 * 8] + data[188 * 9 :])
    with open_video(joined) as video:
        assert len(list(video)) == count + 9
        assert video.decode.complete
    with open_video(lacking) as video:
        list(video)
        assert not video.decode.complete


def test_further_streams_that_begin_later_are_left_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At the end of such a file PyAV looks for streams that it does not know."""
    path = write_video(
        tmp_path / "a.ts", grey_frames(5), codec="mpeg2video", pixel_format="yuv420p"
    )

    class Opened:
        def __init__(self, *arguments: Any, **options: Any) -> None:
            self._opened = opened(*arguments, **options)

        def __getattr__(self, name: str) -> Any:
            return getattr(self._opened, name)

        def demux(self, stream: Any) -> Any:
            yield from self._opened.demux(stream)
            raise IndexError

    opened = av.open
    monkeypatch.setattr(av, "open", Opened)
    source = ContainerSource(str(path))
    assert len(list(source.pictures())) == 5
    source.finish()
    assert source.decode.complete


def test_a_truncated_file_is_incomplete(tmp_path: Path) -> None:
    images = grey_frames(40, width=320, height=240)
    complete = write_video(tmp_path / "a.avi", images, codec="mpeg4", pixel_format="yuv420p")
    cut = tmp_path / "cut.avi"
    cut.write_bytes(complete.read_bytes()[: complete.stat().st_size // 2])
    with open_video(cut, height=None) as video:
        frames = list(video)
        assert 0 < len(frames) < 40
        assert video.decode.missing == 40 - len(frames)
        assert not video.decode.complete


@pytest.mark.parametrize(
    ("kept", "note"), [(7, "1 declared frame never came"), (6, "2 declared frames never came")]
)
def test_frames_that_never_came_are_counted(tmp_path: Path, kept: int, note: str) -> None:
    path = write_video(tmp_path / "a.ivf", grey_frames(8), codec="libvpx", pixel_format="yuv420p")
    data = path.read_bytes()
    end = 32  # bytes of the head
    for _ in range(kept):
        end += 12 + int.from_bytes(data[end : end + 4], "little")
    path.write_bytes(data[:end])
    with open_video(path) as video:
        assert len(list(video)) == kept
        assert video.decode.messages == [note]


@pytest.mark.parametrize(
    ("rate", "times_ms", "last_ms", "messages"),
    [
        (30, [0, 33, 67, 100, 433], 450, []),  # steps vary: the last frame may last as long
        (30, [0, 33, 67, 100, 133], 133, ["3 declared frames never came"]),
        (1000, [0, 33, 67, 100, 133], 133, ["3 declared frames never came"]),
    ],
)
def test_frames_before_a_declared_end_are_counted_by_the_times_of_the_others(
    tmp_path: Path, rate: int, times_ms: list[int], last_ms: int, messages: list[str]
) -> None:
    path, step = tmp_path / "a.mkv", Fraction(1, 1000)
    with av.open(path, "w") as target:
        stream: Any = target.add_stream("ffv1", rate=rate)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "gray"
        stream.codec_context.time_base = step
        for image, time_ms in zip(grey_frames(5), times_ms, strict=True):
            frame = av.VideoFrame.from_ndarray(image, "gray")
            frame.pts, frame.time_base = time_ms, step
            for packet in stream.encode(frame):
                packet.duration = last_ms if time_ms == times_ms[-1] else 1
                target.mux(packet)
    with open_video(path) as video:
        declared = Fraction(30) if rate == 30 else None  # 1000 ticks per second are no rate
        assert (len(list(video)), video.facts.frame_rate) == (5, declared)
        assert video.decode.messages == messages


@pytest.mark.parametrize("threads", [1, 4])
def test_decode_times_that_are_written_as_presentation_times(tmp_path: Path, threads: int) -> None:
    right = write_video(
        tmp_path / "right.mp4", grey_frames(30), codec="libx264", pixel_format="yuv420p"
    )
    wrong = tmp_path / "wrong.mp4"
    with av.open(right) as source, av.open(wrong, "w") as target:
        stream = target.add_stream_from_template(source.streams.video[0])
        packets = [packet for packet in source.demux(video=0) if packet.size]
        ticks = packets[-1].duration or 1
        for index, packet in enumerate(packets):
            packet.pts = packet.dts = index * ticks
            packet.stream = stream
            target.mux(packet)
    expected = ContainerSource(str(right), threads)
    found = ContainerSource(str(wrong), threads)
    assert found._stream.codec_context.has_b_frames
    for one, other in zip(expected.pictures(), found.pictures(), strict=True):
        assert seconds_of(other.time) == pytest.approx(seconds_of(one.time), abs=1e-4)
        np.testing.assert_array_equal(one.plane, other.plane)


def test_pictures_that_mpeg4_does_not_code_are_not_missing(tmp_path: Path) -> None:
    coded = write_video(
        tmp_path / "coded.mp4", grey_frames(8), codec="mpeg4", pixel_format="yuv420p"
    )
    path = tmp_path / "a.mp4"
    with av.open(coded) as source, av.open(path, "w") as target:
        stream = target.add_stream_from_template(source.streams.video[0])
        for index, packet in enumerate(source.demux(video=0)):
            if not packet.size:
                continue
            short: Any = packet
            if index in {2, 3, 6}:
                # Predicted (01), the same second (0), 1, frame of the second, 1, not coded (0).
                bits = f"0101{index:05b}10".ljust(16, "1")
                short = av.Packet(b"\0\0\1\xb6" + int(bits, 2).to_bytes(2))
                short.pts, short.dts, short.time_base = packet.pts, packet.dts, packet.time_base
            short.stream = stream
            target.mux(short)
    with open_video(path) as video:
        assert [round(30 * frame.time_s) for frame in video] == [0, 1, 4, 5, 7]
        assert video.facts.frames_declared == 8
        assert video.decode.complete
    several = ContainerSource(str(path), threads=4)
    assert len(list(several.pictures())) == 5
    several.finish()
    assert several.decode.complete


@pytest.mark.parametrize(
    ("codec", "size", "cores", "threads", "expected"),
    [
        ("libx264", (48, 64), 2, 0, 1),
        ("mpeg4", (48, 64), 1, 0, 1),
        ("libx264", (48, 64), 8, 0, 0),  # more threads help on eight cores
        ("libx264", (1088, 1024), 2, 0, 4),  # too large for one thread
        ("libvpx-vp9", (48, 64), 2, 0, 4),  # a codec too slow for one thread
        ("libvpx-vp9", (48, 64), 1, 0, 0),
        ("libx264", (48, 64), 2, 3, 3),  # the caller has chosen
    ],
)
def test_decoder_threads_follow_the_codec_the_size_and_the_cores(  # noqa: PLR0917
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    codec: str, size: tuple[int, int], cores: int, threads: int, expected: int,
) -> None:  # fmt: skip
    monkeypatch.setattr(container, "cores", lambda: cores)
    frames = [np.zeros(size, np.uint8)] * 3
    path = write_video(tmp_path / "a.mkv", frames, codec=codec, pixel_format="yuv420p")
    source = ContainerSource(str(path), threads)
    asked = source._threads or source._decoder_threads()
    source.close()
    assert asked == expected
    if asked:
        assert source.decode.threads == asked


@pytest.mark.parametrize(
    ("codec", "size", "expected"),
    [("libvpx", (48, 64), 1), ("libx265", (48, 64), 1), ("libx265", (1088, 1024), 3)],
)
def test_silent_decoders_get_one_thread_even_if_more_are_asked_for(
    tmp_path: Path, codec: str, size: tuple[int, int], expected: int
) -> None:
    frames = [np.zeros(size, np.uint8)] * 3
    options = {"x265-params": "log-level=none"} if codec == "libx265" else {}
    path = write_video(
        tmp_path / "a.mkv", frames, codec=codec, pixel_format="yuv420p", options=options
    )
    with open_video(path, threads=3) as video:
        assert len(list(video)) == 3
        assert video.decode.threads == expected


def damaged(path: Path, place: float) -> Path:
    """Write 60 frames with checksums; damage 300 bytes at a place from 0 to 1."""
    write_video(path, grey_frames(60, seed=4), codec="ffv1", options={"slicecrc": "1"})
    data = bytearray(path.read_bytes())
    start = int(place * len(data))
    data[start : start + 300] = b"\x5a" * 300
    path.write_bytes(data)
    return path


def test_a_damaged_packet_loses_only_its_own_frames(tmp_path: Path) -> None:
    path = damaged(tmp_path / "a.avi", 0.5)
    with open_video(path, height=None) as video:
        frames = list(video)
        assert len(frames) + video.decode.failures >= 58
        assert len(frames) >= 57
        assert not video.decode.complete


@pytest.mark.skipif(sys.platform == "win32", reason="an open file cannot be removed there")
@pytest.mark.parametrize("then", ["gone", "text", "other"])
def test_a_damaged_file_that_is_replaced_while_it_is_read(tmp_path: Path, then: str) -> None:
    """A second pass cannot open the damaged file again; the rows so far are a result."""
    path = damaged(tmp_path / "a.avi", 0.9)
    with open_video(path, height=None) as video:
        frames = iter(video)
        next(frames)
        path.unlink()
        if then == "text":
            path.write_text("a shopping list\n" * 50)
        elif then == "other":
            write_video(path, grey_frames(60, seed=5), codec="mpeg4", pixel_format="yuv420p")
        assert 40 < 1 + len(list(frames)) <= 60
        assert not video.decode.complete or then == "other"


def test_a_picture_of_many_bits_counts_as_more_pixels(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_video(
        tmp_path / "a.mkv", [np.zeros((48, 64), np.uint8)] * 2, pixel_format="yuv444p10le"
    )
    monkeypatch.setenv(MAX_PIXELS, str(48 * 64 * 4))  # 48 bits are four times 12
    with open_video(path) as video:
        assert len(list(video)) == 2
    monkeypatch.setenv(MAX_PIXELS, str(48 * 64 * 4 - 1))
    with pytest.raises(
        SourceError, match=r"declares 64 x 48 pixels of 48 bits, more than 12287 of"
    ):
        open_video(path)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.mp4", None, "no such file"),
        ("a.npz", None, "no such file"),
        ("a.mp4", b"", "the file is empty"),
        (
            "a.mp4",
            b"version https://git-lfs.github.com/spec/v1\noid sha256:1\n",
            "is a pointer of Git LFS",
        ),
        ("a.mp4", b"this is a shopping list\n" * 50, "not a video that can be read"),
        ("a.CSV", b"frame,time_s\n0,0\n", "it is a table.; 'oppload plot' draws a result"),
        ("a.MAT", b"MATLAB 5.0", "holds arrays of MATLAB; save the pictures as .npy, or"),
        ("a.nd2", b"nd2", "is a file of a microscope; export its pictures as TIFF"),
    ],
)
def test_the_error_names_a_file_that_is_no_video(
    tmp_path: Path, name: str, content: bytes | None, message: str
) -> None:
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(SourceError, match=message) as caught:
        open_video(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("bytes_of_index", "message"),
    [
        (0, r"lacks the index of an MP4, as after an unfinished recording"),
        (200, r"a.mp4: holds no video stream; give a file with pictures, or a complete copy"),
    ],
)
def test_a_recording_without_its_index(tmp_path: Path, bytes_of_index: int, message: str) -> None:
    path = write_video(tmp_path / "a.mp4", grey_frames(5), codec="mpeg4", pixel_format="yuv420p")
    data = path.read_bytes()
    path.write_bytes(data[: data.index(b"moov") - 4 + bytes_of_index])
    with pytest.raises(SourceError, match=message):
        open_video(path)


def test_a_video_that_is_closed_in_the_middle_does_not_look_complete(tmp_path: Path) -> None:
    path = write_video(tmp_path / "a.avi", grey_frames(40))
    video = open_video(path)
    video.close()
    with pytest.raises(SourceError, match=r"a.avi: was closed before its last frame"):
        next(iter(video))
    video = open_video(path)
    frames = iter(video)
    next(frames)
    video.close()
    for again in (frames, frames, video):
        with pytest.raises(SourceError, match=r"a.avi: was closed before its last frame"):
            next(iter(again))
    with open_video(path) as video:
        assert len(list(video)) == 40
    with pytest.raises(SourceError, match=r"a.avi: has no frame left.*; open it again"):
        list(video)
