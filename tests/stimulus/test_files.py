"""Files: exact in each lossless format, read back to the last bit, and never half-written."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
import signal
import subprocess
import sys
import time
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import av
import cv2
import numpy as np
import pytest

from oppload_cli import Dlgmd, open_video, stimulus
from oppload_cli.errors import OutputError, StimulusError
from oppload_cli.stimulus import Display, Effects, Growth, Object, Protocol, Renderer, Timing, files
from oppload_cli.stimulus.files import contact_sheet, sheet_frames, write_all
from oppload_cli.video import writers
from oppload_cli.video.writers import FORMATS

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from numpy.typing import NDArray

SHORT = {"timing.before_s": 0.1, "timing.motion_s": 0.3, "timing.after_s": 0.0}
SMALL = {"display.width": 160, "display.height": 120}
READ_BACK = (
    "klapoetke2017/bar-expand-10/axis-75",
    "controls/looming-on-moving-texture/direction-90",
    "controls/looming-noise/noise-0.1",
)
LOSSLESS = ("ffv1", "mkv", "png", "npz", "gif")


def clip(
    width: int = 96, height: int = 64, rate: str = "30", motion_s: float = 0.5, **tables: Any
) -> Protocol:
    display = Display(
        width=width, height=height, pixels_per_degree=2, frame_rate=Fraction(rate), background=0.8
    )
    objects = (
        Object(id="ground", kind="texture", contrast=0.4),
        Object(id="disk", kind="disk", growth=Growth(kind="approach", l_over_v_ms=40, most_deg=24)),
    )
    return Protocol(
        name="a/clip", display=display, timing=Timing(motion_s=motion_s), objects=objects, **tables
    )


def decoded(path: Path, form: str) -> tuple[NDArray[np.float64], list[float | None]]:
    """Grey levels, 0 to 255, and times; decoded without any of our own code."""
    if form == "png":
        names = sorted(path.iterdir())
        pictures = [cv2.imread(str(name), cv2.IMREAD_UNCHANGED) for name in names]
        return np.array(pictures, dtype=np.float64), []
    if form == "npz":
        with np.load(path) as archive:
            return archive["grey"].astype(np.float64), list(archive["time_s"])
    frames: list[NDArray[np.float64]] = []
    times: list[float | None] = []
    with av.open(str(path)) as container:
        for frame in container.decode(video=0):
            if form == "mp4":
                limited = frame.to_ndarray()[: frame.height].astype(np.float64)
                frames.append(np.clip((limited - 16) * 255 / 219, 0, 255))
            else:
                grey = frame.to_ndarray() if form != "gif" else frame.to_ndarray(format="gray")
                frames.append(grey.astype(np.float64))
            times.append(frame.time)
    return np.array(frames), times


@pytest.mark.parametrize("form", FORMATS)
def test_error_of_each_format(form: str, tmp_path: Path) -> None:
    """The errors that the documentation states."""
    protocol = clip()
    written = stimulus.write(protocol, tmp_path, form=form)
    frames, times = decoded(written.video, form)
    rendered = np.array([frame.grey for frame in stimulus.frames(protocol)], dtype=np.float64)
    assert frames.shape == rendered.shape
    error = np.abs(frames - rendered)
    if form in LOSSLESS:
        assert error.max() == 0
    else:
        assert 0 < error.max() <= 8
        assert error.mean() < 0.4
    late = {"mkv": 0.0005, "gif": 0.005}.get(form, 1e-9)
    for index, shown in enumerate(times):
        assert shown == pytest.approx(index / 30, abs=late + 1e-12)


@pytest.mark.parametrize("form", ["ffv1", "mkv"])
@pytest.mark.parametrize("rate", ["30000/1001", "60", "144", "1000"])
def test_frame_rate_is_kept_as_a_fraction(form: str, rate: str, tmp_path: Path) -> None:
    written = stimulus.write(clip(rate=rate, motion_s=0.1), tmp_path, form=form)
    with av.open(str(written.video)) as container:
        stream = container.streams.video[0]
        assert stream.average_rate == Fraction(rate)
        assert stream.codec_context.pix_fmt == "gray"


@pytest.mark.parametrize("form", ["ffv1", "mkv"])
def test_a_rate_above_that_of_a_container_is_refused(form: str, tmp_path: Path) -> None:
    with pytest.raises(StimulusError, match=rf"1440 is more than the 1000 Hz that {form} holds; "
                       "lower it or use format png or npz"):  # fmt: skip
        stimulus.write(clip(rate="1440"), tmp_path, form=form)


@pytest.mark.parametrize("form", ["mp4", "npz"])
def test_other_containers_hold_any_rate(form: str, tmp_path: Path) -> None:
    video = stimulus.write(clip(rate="1440", motion_s=0.1), tmp_path, form=form).video
    assert decoded(video, form)[1] == pytest.approx([at / 1440 for at in range(144)])


@pytest.mark.parametrize("form", FORMATS)
def test_same_bytes_again(form: str, tmp_path: Path) -> None:
    digests = []
    for folder in ("first", "second"):
        written = stimulus.write(clip(), tmp_path / folder, form=form, preview=True)
        assert written.preview is not None
        files = [written.truth, written.preview]
        files += sorted(written.video.iterdir()) if form == "png" else [written.video]
        digests.append({path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in files})
    assert digests[0] == digests[1]


def test_the_bytes_of_a_video_do_not_depend_on_the_processor(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    coding = writers._CODINGS["mp4"]
    options = coding.options
    assert options["x264-params"] == "cpu-independent=1"
    seen = set()
    for more in ("", ":asm=0", ":asm=SSE2"):
        other = {**options, "x264-params": options["x264-params"] + more}
        monkeypatch.setitem(writers._CODINGS, "mp4", coding._replace(options=other))
        video = stimulus.write(clip(), tmp_path, form="mp4").video
        with av.open(str(video)) as opened:
            # The packets, but for the text of the options in the first one.
            packets = [bytes(packet) for packet in opened.demux(video=0)]
        seen.add(hashlib.sha256(b"".join(packets[1:])).hexdigest())
    assert len(seen) == 1


def test_truth_and_preview_lie_beside_the_video(tmp_path: Path) -> None:
    written = stimulus.write(clip(), str(tmp_path / "new" / "folder"), preview=True)
    assert sorted(path.name for path in written.video.parent.iterdir()) == [
        "a_clip.avi",
        "a_clip.preview.png",
        "a_clip.stimulus.json",
    ]
    truth = stimulus.read_ground_truth(str(written.truth))
    assert truth == stimulus.ground_truth(clip())
    assert len(truth["frames"]) == written.frames == 15
    assert json.loads(written.truth.read_text())["name"] == "a/clip"


def test_odd_sizes_and_fast_rates_are_refused_before_anything_is_written(tmp_path: Path) -> None:
    odd = clip(width=97)
    with pytest.raises(StimulusError, match=r"a/clip: display\.width = 97 is odd"):
        stimulus.write(odd, tmp_path, form="mp4")
    with pytest.raises(StimulusError, match=r"display\.frame_rate = 60 is more than the 50 Hz"):
        stimulus.write(clip(rate="60"), tmp_path, form="gif")
    with pytest.raises(StimulusError, match="did you mean 'ffv1'"):
        stimulus.write(odd, tmp_path, form="ffv")
    assert list(tmp_path.iterdir()) == []
    for form in LOSSLESS:
        frames, _ = decoded(stimulus.write(odd, tmp_path / form, form=form).video, form)
        assert frames.shape == (15, 64, 97)


@pytest.fixture
def small_disk() -> Iterator[None]:
    """Let no file grow beyond 50 kB, as on a disk that is full."""
    resource = pytest.importorskip("resource")  # Windows has no such limit
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_FSIZE, before)
    signal.signal(signal.SIGXFSZ, handler)


@pytest.mark.usefixtures("small_disk")
@pytest.mark.parametrize("form", FORMATS)
def test_a_full_disk_leaves_nothing_half_written(form: str, tmp_path: Path) -> None:
    noisy = clip(width=300, height=300, effects=Effects(noise=0.3))
    done: list[int] = []
    with pytest.raises(OutputError, match=r"cannot be written \(file too large") as caught:
        stimulus.write(noisy, tmp_path, form=form, progress=done.append)
    # noticed at once, not after the last frame is drawn; H.264 holds 40 frames back
    assert len(done) < noisy.frame_count or form == "mp4"
    assert "a_clip" in str(caught.value)
    assert "\n" not in str(caught.value)
    assert list(tmp_path.iterdir()) == []


def test_a_preview_that_cannot_be_written_leaves_no_file_of_its_stimulus(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(_: object) -> bytes:
        raise OutputError("the disk is full")

    monkeypatch.setattr(files, "png_bytes", full)
    with pytest.raises(OutputError, match="full"):
        stimulus.write(clip(), tmp_path, preview=True)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("form", FORMATS)
def test_an_interrupt_keeps_the_files_of_before(form: str, tmp_path: Path) -> None:
    before = stimulus.write(clip(), tmp_path, form=form)
    kept = sorted(path.name for path in tmp_path.rglob("*"))

    def interrupted(_: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        stimulus.write(clip(seed=5), tmp_path, form=form, progress=interrupted)
    assert sorted(path.name for path in tmp_path.rglob("*")) == kept
    frames, _ = decoded(before.video, form)
    assert len(frames) == 15


def test_an_encoder_that_is_missing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    coding = writers._CODINGS["ffv1"]
    monkeypatch.setitem(writers._CODINGS, "ffv1", coding._replace(codec="ffv9"))
    with pytest.raises(OutputError, match="this PyAV has no FFV9 encoder; install PyAV"):
        stimulus.write(clip(), tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_cannot_be_made(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="cannot be written"):
        stimulus.write(clip(), tmp_path / "file" / "folder")


@pytest.mark.long
def test_several_at_a_time_are_the_same_files(tmp_path: Path) -> None:
    protocols = [dataclasses.replace(clip(seed=seed), name=f"clip-{seed}") for seed in range(3)]
    odd = dataclasses.replace(clip(width=97), name="odd")
    counted: list[int] = []
    results = write_all(
        [*protocols, odd], tmp_path / "a", form="mp4", jobs=2, progress=counted.append
    )
    assert sum(counted) == 45  # the odd one is refused before its first frame
    assert isinstance(results[3], StimulusError)
    write_all(protocols, tmp_path / "b", form="mp4", jobs=1)
    names = [path.name for path in sorted((tmp_path / "a").iterdir())]
    assert names == [path.name for path in sorted((tmp_path / "b").iterdir())]
    for name in names:
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


def test_memory_does_not_grow_with_length(tmp_path: Path) -> None:
    """Sixty frames leave less in memory than three take. (The first frame takes more than all.)"""
    import tracemalloc

    protocol = dataclasses.replace(clip(), timing=Timing(motion_s=2.0), effects=Effects(noise=0.1))
    held: list[int] = []
    tracemalloc.start()
    stimulus.write(
        protocol,
        tmp_path,
        form="npz",
        progress=lambda _: held.append(tracemalloc.get_traced_memory()[0]),
    )
    tracemalloc.stop()
    assert len(held) == 60
    assert held[-1] - held[0] < 3 * 96 * 64


def test_contact_sheet() -> None:
    assert sheet_frames(1) == [0]
    assert sheet_frames(3) == [0, 1, 2]
    assert sheet_frames(100, 4) == [0, 33, 66, 99]
    pictures = [np.full((90, 120), level, dtype=np.uint8) for level in (0, 100, 200)]
    sheet = contact_sheet(pictures, side=40, columns=2)
    assert sheet.shape == (2 * 36 + 6, 2 * 46 + 6)
    assert (sheet[10, 10], sheet[10, 60], sheet[45, 10], sheet[45, 60]) == (0, 100, 200, 255)


@pytest.mark.parametrize("level", [0, 128, 255])
def test_pictures_of_a_contact_sheet_do_not_merge(level: int) -> None:
    sheet = contact_sheet([np.full((40, 40), level, np.uint8)] * 2, side=40, columns=2)
    between = sheet[20, 46:52].tolist()
    assert between == [0, 255, 255, 255, 255, 0]
    assert max(between) - level >= 127 or level - min(between) >= 127


def test_the_time_stands_under_each_picture() -> None:
    pictures = [np.full((30, 40), 128, np.uint8)] * 2
    plain = contact_sheet(pictures, side=40, columns=2)
    timed = contact_sheet(pictures, side=40, columns=2, times_s=[0.0, 1.25])
    assert timed.shape == (plain.shape[0] + 14, plain.shape[1])
    captions = timed[38:50]
    assert np.all(captions.min(axis=0)[[10, 60]] < 255)
    assert (captions[:, 52:] < 128).sum() > (captions[:, :46] < 128).sum() > 10


def test_contact_sheet_keeps_the_mean() -> None:
    picture = Renderer(stimulus.load("klapoetke2017/loom")).grey(20)
    sheet = contact_sheet([picture], side=100)
    assert sheet[6:106, 6:106].mean() == pytest.approx(picture.mean(), abs=0.1)


@pytest.mark.parametrize(
    ("name", "form"),
    [
        *((name, "ffv1") for name in READ_BACK),
        *((READ_BACK[-1], form) for form in ("mkv", "png", "gif")),
        *((name, "mp4") for name in READ_BACK[:2]),
    ],
)
def test_a_video_gives_the_rendered_luminance(name: str, form: str, tmp_path: Path) -> None:
    """Exactly, and in an MP4 within eight grey levels."""
    protocol = stimulus.load(name, SHORT | SMALL)
    written = stimulus.write(protocol, tmp_path, form=form)
    with open_video(written.video, height=None) as video:
        for rendered, read in zip(stimulus.frames(protocol), video, strict=True):
            assert read.index == rendered.index
            assert read.luma.dtype == rendered.luma.dtype == np.float32
            off = np.abs(read.luma - rendered.luma).max()
            assert off < 8 / 255 if form == "mp4" else off == 0


def test_models_respond_the_same_with_and_without_a_file(tmp_path: Path) -> None:
    protocol = stimulus.load("opplod2023/looming-disk-centre", {"timing.motion_s": 0.5})
    written = stimulus.write(protocol, tmp_path)
    model = Dlgmd((600, 600))
    with open_video(written.video, height=None) as video:
        from_file = [model.step(frame.luma) for frame in video]
    model.reset()
    assert [model.step(frame.luma) for frame in stimulus.frames(protocol)] == from_file
    assert from_file[2] is None
    assert from_file[-1] is not None
    assert from_file[-1].s > 0


@pytest.mark.long
@pytest.mark.skipif(sys.platform == "win32", reason="process groups are of POSIX")
@pytest.mark.parametrize(
    "stop", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)]
)
def test_an_interrupt_leaves_complete_files_only(stop: signal.Signals, tmp_path: Path) -> None:
    words = ("stimuli", "generate", "controls/[st]*", "-o", str(tmp_path), "--jobs", "2")
    running = subprocess.Popen(
        [sys.executable, "-m", "oppload_cli", *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    for _ in range(3000):
        # The ground truth is written last; each process may delete its latest one again.
        if len(list(tmp_path.glob("*.stimulus.json"))) > 2:
            break
        time.sleep(0.01)
    # Ctrl-C reaches all processes of the group, SIGTERM only the parent
    (os.killpg if stop == signal.SIGINT else os.kill)(running.pid, stop)
    _, said = running.communicate(timeout=60)
    assert running.returncode == 130
    assert said.strip() == "oppload: interrupted"
    names = sorted(path.name for path in tmp_path.iterdir())
    assert not [name for name in names if name.endswith(".part")]
    videos = {name.removesuffix(".avi") for name in names if name.endswith(".avi")}
    assert 0 < len(videos) < 49
    assert videos == {
        name.removesuffix(".stimulus.json") for name in names if name.endswith(".json")
    }
