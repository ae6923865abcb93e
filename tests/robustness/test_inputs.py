"""Every kind of input: exact count, exact times, the right luminance, the right exit code."""

from __future__ import annotations

import json
import os
import shutil
import sys
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import av
import cv2
import numpy as np
import pytest
from av.stream import Disposition

from oppload_cli.errors import SourceError
from oppload_cli.video.source import open_video
from tests.cli.inside import oppload
from tests.media import grey_frames, write_video
from tests.results.make import rows_of
from tests.robustness.inputs import KINDS, Kind, frame_of, level, make, shown

if TYPE_CHECKING:
    from pathlib import Path


def check(path: Path, kind: Kind) -> None:
    with open_video(path, height=None) as video:
        frames = list(video)
        assert video.decode.complete, video.decode.messages
        assert video.facts.frames_declared in {None, kind.frames}
        assert (video.facts.width, video.facts.height) == (kind.width, kind.height)
    assert [frame.index for frame in frames] == list(range(kind.frames))
    assert [frame.time_s for frame in frames] == pytest.approx(kind.seconds, abs=kind.tick)
    for frame in frames:
        left = frame.luma[:, : max(1, kind.width // 2)]
        inner = left[:, : max(1, left.shape[1] // 2)]  # away from the edge's ringing
        assert float(inner.mean()) == pytest.approx(shown(kind, frame.index), abs=kind.error)


@pytest.mark.parametrize("name", KINDS)
def test_every_kind_gives_the_encoded_frames(tmp_path: Path, name: str) -> None:
    kind = KINDS[name]
    fragments = {"movflags": "frag_keyframe+empty_moov"} if name == "h264-fragments" else {}
    check(make(tmp_path / f"a.{kind.suffix}", kind, fragments), kind)


@pytest.mark.skipif(not hasattr(os, "sched_getscheduler"), reason="not on this system")
def test_no_encoder_changes_the_priority_of_the_tests(tmp_path: Path) -> None:
    before = os.sched_getscheduler(0)
    make(tmp_path / "a.ivf", KINDS["av1-ivf"])
    assert os.sched_getscheduler(0) == before


@pytest.mark.parametrize("suffix", ["png", "jpg", "bmp", "tiff", "webp", "pgm", "ppm"])
def test_folders_of_images(tmp_path: Path, suffix: str) -> None:
    kind = Kind("", "", full=True)
    for index in range(kind.frames):
        image = np.full((kind.height, kind.width), round(level(index) * 255), np.uint8)
        shown_as = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR) if suffix == "ppm" else image
        assert cv2.imwrite(str(tmp_path / f"f{index}.{suffix}"), shown_as)
    check(tmp_path, kind)


def with_sound(path: Path, seconds: float, **video: Any) -> Path:
    """Write 12 frames of video beside a sound of that length."""
    with av.open(str(path), "w") as container:
        pictures: Any = container.add_stream("mpeg4", rate=30)
        pictures.width, pictures.height, pictures.pix_fmt = 96, 64, "yuv420p"
        sound: Any = container.add_stream("mp2", rate=44100)
        for index in range(12):
            container.mux(pictures.encode(frame_of(Kind("", ""), index)))
        container.mux(pictures.encode())
        for start in range(0, int(44100 * seconds), 1152):
            frame = av.AudioFrame.from_ndarray(np.zeros((1, 1152), np.int16), layout="mono")
            frame.sample_rate, frame.pts = 44100, start
            container.mux(sound.encode(frame))
        container.mux(sound.encode())
    return path


@pytest.mark.parametrize("suffix", ["mp4", "mkv", "avi", "mov", "ts", "nut"])
def test_a_sound_longer_than_the_pictures_is_no_loss(tmp_path: Path, suffix: str) -> None:
    path = with_sound(tmp_path / f"a.{suffix}", 3)
    tick = {"mkv": 6e-4, "ts": 2e-5}.get(suffix, 1e-9)
    check(path, Kind("", "", tick=tick))


def test_an_end_that_may_be_that_of_the_sound_says_nothing_of_the_pictures(tmp_path: Path) -> None:
    path = with_sound(tmp_path / "a.mkv", 3)
    # Without the tags of the streams, the only end is that of the complete file.
    path.write_bytes(path.read_bytes().replace(b"DURATION", b"DURATIOX"))
    with open_video(path) as video:
        assert len(list(video)) == 12
        assert video.decode.missing == 0


def test_frames_that_an_edit_list_hides_are_not_missed(tmp_path: Path) -> None:
    path = make(tmp_path / "a.mp4", KINDS["h264-mp4"])
    data = bytearray(path.read_bytes())
    entry = data.index(b"elst") + 12  # duration and start of the one edit
    clock = int.from_bytes(data[data.index(b"mdhd") + 16 :][:4])
    data[entry + 4 : entry + 8] = (
        int.from_bytes(data[entry + 4 : entry + 8]) + 4 * clock // 30
    ).to_bytes(4)
    path.write_bytes(data)
    with open_video(path, height=None) as video:
        frames = list(video)
        assert len(frames) == video.facts.frames_declared == 8
        assert video.decode.complete
    assert any("frames that an edit list of the file hides" in m for m in video.decode.messages)
    assert float(frames[0].luma[:, :24].mean()) == pytest.approx(level(4), abs=0.01)


def test_gaps_that_avi_fills_with_empty_chunks_are_not_missed(tmp_path: Path) -> None:
    times = [0, 1, 2, 3, 10, 11, 12]
    path = write_video(
        tmp_path / "a.avi",
        grey_frames(7),
        codec="mpeg4",
        pixel_format="yuv420p",
        times=times,
        time_base=Fraction(1, 30),
    )
    with open_video(path) as video:
        assert [frame.time_s * 30 for frame in video] == pytest.approx(times, abs=1e-6)
        assert video.decode.complete


def write_streams(
    path: Path,
    *streams: tuple[int, int],
    default: int | None = None,
    codec: str = "ffv1",
    pixels: str = "gray",
) -> None:
    """Write video streams of a height and a number of frames; those of stream k are k x 50 grey."""
    with av.open(str(path), "w") as container:
        written: list[Any] = [container.add_stream(codec, rate=30) for _ in streams]
        for stream, (height, _) in zip(written, streams, strict=True):
            stream.width, stream.height, stream.pix_fmt = 96, height, pixels
            stream.disposition = Disposition.default if stream.index == default else 0
        for index in range(max(count for _, count in streams)):
            for stream, (height, count) in zip(written, streams, strict=True):
                image = np.full((height, 96), 50 * (stream.index + 1), np.uint8)
                frame = av.VideoFrame.from_ndarray(image, format="gray")
                container.mux(stream.encode(frame) if index < count else [])
        for stream in written:
            container.mux(stream.encode())


@pytest.mark.parametrize(
    ("streams", "default", "read"),
    [
        ([(64, 5), (96, 5)], None, 2),  # the largest
        ([(64, 5), (64, 5)], None, 1),  # the first
        ([(64, 5), (96, 5)], 0, 1),  # the default one
        ([(96, 1), (64, 5)], 0, 2),  # not a still, even if it is large and the default one
    ],
)
def test_of_several_video_streams_the_one_that_programs_show_is_read(
    streams: list[tuple[int, int]], default: int | None, read: int, tmp_path: Path
) -> None:
    path = tmp_path / "a.mkv"
    write_streams(path, *streams, default=default)
    for number in (None, 1, 2):
        with open_video(path, height=None, stream=number) as video:
            facts, frames = video.facts, list(video)
        expected = number or read
        assert (facts.video_stream, facts.video_streams) == (expected, 2)
        assert len(frames) == streams[expected - 1][1]
        assert {round(float(frame.luma.mean()) * 255) for frame in frames} == {50 * expected}
        assert video.decode.complete


def test_of_two_videos_in_a_transport_stream_the_larger_is_read(tmp_path: Path) -> None:
    path = tmp_path / "a.ts"
    write_streams(path, (64, 9), (96, 9), codec="mpeg2video", pixels="yuv420p")
    with open_video(path, height=None) as video:
        frames = list(video)
    assert (video.facts.video_stream, video.facts.height, len(frames)) == (2, 96, 9)
    assert video.decode.complete


def test_a_cover_picture_is_no_video_stream(tmp_path: Path) -> None:
    path = tmp_path / "a.mp4"
    with av.open(str(path), "w") as container:
        film: Any = container.add_stream("libx264", rate=30)
        cover: Any = container.add_stream("mjpeg", rate=30)
        film.width, film.height, film.pix_fmt = 64, 48, "yuv420p"
        cover.width, cover.height, cover.pix_fmt = 128, 96, "yuvj420p"
        cover.disposition = Disposition.attached_pic
        for stream, count in ((cover, 1), (film, 9)):
            for index in range(count):
                grey = np.full((stream.height, stream.width), 50, np.uint8)
                frame = av.VideoFrame.from_ndarray(grey, "gray").reformat(format=stream.pix_fmt)
                frame.pts = index
                container.mux(stream.encode(frame))
            container.mux(stream.encode())
    with open_video(path, height=None) as video:
        assert len(list(video)) == 9
        assert (video.facts.width, video.facts.video_streams) == (64, 1)


def test_the_user_chooses_a_stream_and_the_results_say_which(tmp_path: Path) -> None:
    path = tmp_path / "a.mkv"
    write_streams(path, (64, 5), (96, 5))
    said = oppload("run", path, "-o", tmp_path).stderr
    assert "a.mkv: stream 2 of 2 video streams, 96 x 96, is analysed; --stream (in" in said
    first = ("run", path, "-o", tmp_path, "--stream", "1", "--if-exists")
    assert "is a result with other settings" in oppload(*first, "skip").stderr
    assert oppload(*first, "overwrite").returncode == 0
    sidecar = json.loads((tmp_path / "a.oppload.json").read_text())
    assert (sidecar["input"]["video_stream"], sidecar["input"]["height"]) == (1, 64)
    for name, number, sentence in (
        (path, "3", "a.mkv: holds 2 video streams; there is no stream 3"),
        ("camera:0", "1", "camera:0: is a camera, which has no streams; leave --stream out"),
    ):
        refused = oppload("run", name, "-o", tmp_path / "other", "--stream", number)
        assert refused.returncode == 3
        assert sentence in refused.stderr


def test_all_pictures_of_an_animated_avif_are_read(tmp_path: Path) -> None:
    """Its first stream is a still, the first picture alone."""
    path = tmp_path / "a.avif"
    shown = grey_frames(12, 64, 64)
    write_video(path, shown, codec="libsvtav1", pixel_format="yuv420p", options={"crf": "1"})
    with open_video(path, height=None) as video:
        frames = list(video)
    assert (video.facts.video_stream, video.facts.video_streams) == (2, 2)
    assert len(frames) == 12
    for frame, grey in zip(frames, shown, strict=True):
        assert np.abs(frame.luma - grey / 255).mean() < 0.02
    assert video.decode.complete


@pytest.mark.parametrize("bits", ["gray9le", "gray10le", "gray12le", "gray14le", "gray16le"])
def test_deep_grey_is_full_range(tmp_path: Path, bits: str) -> None:
    depth = int(bits[4:-2])
    image = np.tile(np.linspace(0, 2**depth - 1, 96).astype(np.uint16), (64, 1))
    path = write_video(tmp_path / "a.mkv", [image], pixel_format=bits, source_format=bits)
    with open_video(path, height=None) as video:
        [frame] = list(video)
    np.testing.assert_allclose(frame.luma, image / (2**depth - 1), atol=1e-6)


@pytest.mark.parametrize("name", ["yuv420p16le", "yuv422p12le", "yuv444p10le", "yuv411p"])
def test_the_luma_plane_of_other_formats(tmp_path: Path, name: str) -> None:
    depth = int(name[7:-2]) if name.endswith("le") else 8
    frame = av.VideoFrame(96, 64, name)
    code = 126 << (depth - 8)
    for plane in frame.planes:
        kind = np.uint16 if depth > 8 else np.uint8
        plane.update(np.full(plane.buffer_size // np.dtype(kind).itemsize, code, kind).tobytes())
    path = tmp_path / "a.mkv"
    with av.open(str(path), "w") as container:
        stream: Any = container.add_stream("ffv1", rate=30)
        stream.width, stream.height, stream.pix_fmt = 96, 64, name
        container.mux(stream.encode(frame))
        container.mux(stream.encode())
    with open_video(path, height=None) as video:
        [one] = list(video)
    np.testing.assert_allclose(one.luma, 110 / 219, atol=1e-6)


@pytest.mark.parametrize("name", ["rgb24", "rgba", "gbrp10le", "rgb48le", "pal8"])
def test_colours_become_grey(tmp_path: Path, name: str) -> None:
    colour = np.full((64, 96, 3), (200, 100, 50), np.uint8)
    codec = {"pal8": "gif", "gbrp10le": "ffv1", "rgb48le": "ffv1"}.get(name, "png")
    path = tmp_path / ("a.gif" if codec == "gif" else "a.mkv" if codec == "ffv1" else "a.mov")
    pixel_format = "rgb8" if codec == "gif" else name
    write_video(path, [colour] * 2, codec=codec, pixel_format=pixel_format, source_format="rgb24")
    with open_video(path, height=None) as video:
        frame = next(iter(video))
    error = 0.03 if codec == "gif" else 3e-3  # its palette is coarse
    assert float(frame.luma.mean()) == pytest.approx(124 / 255, abs=error)


def test_sound_alone_and_no_frame_at_all(tmp_path: Path) -> None:
    path = tmp_path / "a.mp4"
    with av.open(str(path), "w") as container:
        stream: Any = container.add_stream("aac", rate=8000)
        frame = av.AudioFrame.from_ndarray(np.zeros((1, 1024), np.float32), "fltp", "mono")
        frame.sample_rate = 8000
        container.mux([*stream.encode(frame), *stream.encode()])
    with pytest.raises(SourceError, match="holds no video stream"):
        open_video(path)
    empty = tmp_path / "b.mkv"
    with av.open(str(empty), "w") as container:
        stream = container.add_stream("ffv1", rate=30)
        stream.width, stream.height, stream.pix_fmt = 96, 64, "gray"
        container.start_encoding()
    with pytest.raises(SourceError, match=r"no frame could be decoded|not a video"):
        open_video(empty)
    for name, code in ((path, 3), (empty, 3)):
        done = oppload("run", name, "-o", tmp_path / "out", "-q")
        assert (done.returncode, len(done.stderr.splitlines())) == (code, 1)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("name", ["one-pixel", "one-frame", "gif"])
def test_the_command_on_unusual_inputs(tmp_path: Path, name: str) -> None:
    kind = KINDS[name]
    path = make(tmp_path / f"a.{kind.suffix}", kind)
    done = oppload("run", path, "-o", tmp_path)
    assert done.returncode == 0, done.stderr
    rows = rows_of(tmp_path / "a.frames.csv")
    assert len(rows) == kind.frames
    sidecar = json.loads((tmp_path / "a.oppload.json").read_text())
    assert sidecar["decode"]["complete"] is True


@pytest.mark.skipif(sys.platform == "win32", reason="no name has a colon there")
def test_a_name_is_a_name_and_no_address(tmp_path: Path) -> None:
    complete = make(tmp_path / "a.mkv", KINDS["ffv1-mkv"])
    for name in ("a:b.mkv", "http:c.mkv", "-v.mkv", "sp ace'\".mkv", "li\nne.mkv", "concat:x|y"):
        shutil.copy(complete, tmp_path / name)
        with open_video(tmp_path / name) as video:
            assert len(list(video)) == 12


def test_a_list_of_other_files_is_not_followed(tmp_path: Path) -> None:
    make(tmp_path / "a.mkv", KINDS["ffv1-mkv"])
    (tmp_path / "list.mkv").write_text("ffconcat version 1.0\nfile a.mkv\n")
    ts = make(tmp_path / "s.ts", KINDS["h264-ts"])
    (tmp_path / "play.m3u8").write_text(
        f"#EXTM3U\n#EXT-X-TARGETDURATION:9\n#EXTINF:9,\n{ts.name}\n#EXT-X-ENDLIST\n"
    )
    for name in ("list.mkv", "play.m3u8"):
        with pytest.raises(SourceError, match=r"only names other files|not a video"):
            open_video(tmp_path / name)
