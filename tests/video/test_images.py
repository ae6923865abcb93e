"""Images and cameras as inputs."""

from __future__ import annotations

import json
import os
import re
import sys
from datetime import UTC, datetime
from fractions import Fraction
from itertools import accumulate
from time import sleep
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import pytest
from PIL import Image

from oppload_cli.errors import SourceError
from oppload_cli.video import images
from oppload_cli.video.images import CameraSource
from oppload_cli.video.opening import Opening
from oppload_cli.video.source import Video, open_video
from oppload_cli.video.span import Span
from tests.cli.inside import oppload
from tests.media import grey_frames, write_video

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Twelve images whose order by letters differs from their order by numbers."""
    for index, image in enumerate(grey_frames(12)):
        cv2.imwrite(str(tmp_path / f"frame_{index}.png"), image)
    (tmp_path / "notes.txt").write_text("not an image")
    return tmp_path


@pytest.mark.parametrize("name", ["", "frame_%d.png", "frame_%01d.png"])
def test_a_folder_or_pattern_is_read_in_the_order_of_its_numbers(folder: Path, name: str) -> None:
    with open_video(folder / name, height=None, image_rate=Fraction(10)) as video:
        frames = list(video)
        assert video.facts.kind == "images"
        assert video.facts.frames_declared == 12
        assert video.decode.complete
    for index, (frame, image) in enumerate(zip(frames, grey_frames(12), strict=True)):
        assert frame.index == index
        assert frame.time_s == pytest.approx(index / 10)
        np.testing.assert_array_equal(frame.luma, image.astype(np.float32) / np.float32(255))


def test_a_pattern_takes_only_its_own(folder: Path) -> None:
    (folder / "frame_7.png").rename(folder / "other_7.png")
    for name, count in (("frame_%d.png", 11), ("frame_%02d.png", 2)):
        with open_video(folder / name) as video:
            assert len(list(video)) == count


@pytest.mark.parametrize(
    ("names", "pattern"),
    [
        (("left_{:03}.png", "right_{:03}.png"), "left_%03d.png"),
        (("{:04}_right.png", "{:04}_left.png", "cam2.png"), "%04d_left.png"),
        (("cam1_{}.png", "background.png", "mask_1.png"), ""),
        (("2026-01-02T12-{:02}-00.125.png", "a.png", "a.bmp", "b.png", "b.bmp"), ""),
    ],
)
def test_several_series_give_a_note_with_the_pattern_of_one(
    tmp_path: Path, names: tuple[str, ...], pattern: str
) -> None:
    for name in names:
        for number in range(4 if "{" in name else 1):
            cv2.imwrite(str(tmp_path / name.format(number)), grey_frames(1)[0])
    with open_video(tmp_path) as video:
        assert len(list(video)) == len(list(tmp_path.iterdir()))
        assert [each.partition("such as ")[2] for each in video.decode.messages] == (
            [pattern] if pattern else []
        )
    if pattern:
        with open_video(tmp_path / pattern) as video:
            assert [len(list(video)), video.decode.messages] == [4, []]


@pytest.mark.parametrize(
    ("stated", "rate"),
    [("50/1", 50), ("0", None), ("-25", None), ("1/0", None), ("100001", None), (None, None)],
)
def test_images_have_the_rate_of_the_ground_truth_beside_them(
    tmp_path: Path, stated: str | None, rate: int | None
) -> None:
    (tmp_path / "a").mkdir()
    for index, image in enumerate(grey_frames(2)):
        cv2.imwrite(str(tmp_path / "a" / f"f{index}.png"), image)
    truth = {"display": {"frame_rate": stated}}
    (tmp_path / "a.stimulus.json").write_text(json.dumps(truth))
    with open_video(tmp_path / "a", height=None) as video:
        assert video.facts.rate_assumed is (rate is None)
        assert [frame.time_s for frame in video] == [0, 1 / (rate or 30)]


def test_missing_numbers_give_a_note(folder: Path) -> None:
    where = "after frame_4.png"
    for removed, place in (("5", where), ("8", f"in 2 places, first {where}")):
        (folder / f"frame_{removed}.png").unlink()
        with open_video(folder) as video:
            assert len(list(video)) == video.facts.frames_declared
            assert [each.partition(";")[0] for each in video.decode.messages] == [
                f"numbers are missing {place}"
            ]
            assert video.decode.complete
    for odd in (1, 3, 7, 9, 11):  # every second one: a lower rate, and nothing is missing
        (folder / f"frame_{odd}.png").unlink()
    cv2.imwrite(str(folder / "frame_8.png"), grey_frames(1)[0])
    with open_video(folder) as video:
        assert [len(list(video)), video.decode.messages] == [6, []]


@pytest.mark.parametrize(
    ("steps_ns", "told"),
    [
        ([33333333, 33333333, 33333334] * 3, False),
        ([34100000, 33000000, 31000000, 38000000], False),
        ([33333333, 33333334, 66666667, 33333333], True),
        ([20000000, 20000000, 30000000], True),  # a step of 1.5 usual ones
    ],
)
def test_numbers_that_are_times_may_vary(tmp_path: Path, steps_ns: list[int], told: bool) -> None:
    for time_ns in accumulate(steps_ns, initial=1700000000123456789):
        cv2.imwrite(str(tmp_path / f"cam_{time_ns}.png"), grey_frames(1)[0])
    with open_video(tmp_path) as video:
        assert len(list(video)) == len(steps_ns) + 1
        assert bool(video.decode.messages) == told


def test_two_images_of_one_number_are_no_gap(tmp_path: Path) -> None:
    for number in range(3):
        for suffix in ("png", "bmp"):
            cv2.imwrite(str(tmp_path / f"f{number}.{suffix}"), grey_frames(1)[0])
    with open_video(tmp_path) as video:
        assert [len(list(video)), video.decode.messages] == [6, []]


def test_a_damaged_image_is_counted_and_the_others_are_read(folder: Path) -> None:
    (folder / "frame_5.png").write_bytes(b"\x89PNG but no more")
    with open_video(folder, height=None) as video:
        assert [frame.index for frame in video] == [0, 1, 2, 3, 4, 6, 7, 8, 9, 10, 11]
        assert video.decode.failures == 1
        assert not video.decode.complete
        assert "frame_5.png" in video.decode.messages[0]


SCENE = np.add.outer(np.arange(31), np.arange(43) * 3).astype(np.uint8)
RGB = np.dstack([SCENE, SCENE[::-1], SCENE[:, ::-1]])
GREY_OF_RGB = RGB @ [0.299, 0.587, 0.114]


@pytest.mark.parametrize("suffix", ["png", "bmp", "ppm", "tiff", "webp", "jpg"])
def test_every_format_gives_its_pixels(tmp_path: Path, suffix: str) -> None:
    for index in range(2):
        lossless: dict[str, Any] = {"lossless": True} if suffix == "webp" else {}
        Image.fromarray(RGB).save(tmp_path / f"{index}.{suffix}", **lossless)
    with open_video(tmp_path, height=None) as video:
        frames = list(video)
        assert video.decode.complete
    error = np.abs(frames[1].luma * 255 - GREY_OF_RGB)
    assert error.max() < (8 if suffix == "jpg" else 0.51)


@pytest.mark.parametrize("suffix", ["png", "pgm", "tiff"])
def test_all_sixteen_bits_are_kept(tmp_path: Path, suffix: str) -> None:
    """The second image has 8 bits; the picture in colour has 8 in both."""
    deep = SCENE.astype(np.uint16) * 256 + 77
    image: Any
    for index, image in enumerate((deep, SCENE)):
        cv2.imwrite(str(tmp_path / f"{index}.{suffix}"), image)
    with open_video(tmp_path, height=None, colour=True) as video:
        first, second = video
    np.testing.assert_array_equal(first.luma, (deep / 65535).astype(np.float32))
    np.testing.assert_array_equal(second.luma, (SCENE / 255).astype(np.float32))
    assert first.colour is not None
    np.testing.assert_array_equal(first.colour[..., 1], SCENE)
    with open_video(tmp_path, height=SCENE.shape[0] // 2) as video:
        small = next(iter(video)).luma
    expected = cv2.resize(deep / 65535, small.shape[::-1], interpolation=cv2.INTER_AREA)
    assert np.abs(small - expected).max() < 1e-4  # a step of 8 bits is 4e-3


@pytest.mark.parametrize(("brightest", "bits"), [(4095, 12), (16384, None)])
def test_images_that_use_few_of_their_bits_give_a_note(
    tmp_path: Path, brightest: int, bits: int | None
) -> None:
    for index in range(2):
        cv2.imwrite(
            str(tmp_path / f"{index}.png"), np.full((31, 43), brightest >> index, np.uint16)
        )
    with open_video(tmp_path) as video:
        assert len(list(video)) == 2
        found = [each for each in video.decode.messages if f"above {brightest} of 65535" in each]
        assert [f"have {bits} bits, scale" in each for each in found] == [True] * bool(bits)
        assert video.decode.complete


@pytest.mark.parametrize("opacity", [255, 254])
def test_images_with_transparency_give_a_note(tmp_path: Path, opacity: int) -> None:
    for index in range(3):
        alpha = np.full_like(SCENE, 255 if index == 1 else opacity)
        Image.fromarray(np.dstack([RGB, alpha])).save(tmp_path / f"{index}.png")
    with open_video(tmp_path) as video:
        assert len(list(video)) == 3
        said = ["transparency is left out; draw the images on an opaque background first"]
        assert video.decode.messages == (said if opacity < 255 else [])
        assert video.decode.complete


def test_transparency_is_left_out_and_samples_of_32_bits_are_refused(tmp_path: Path) -> None:
    Image.fromarray(np.dstack([RGB, SCENE])).save(tmp_path / "0.tiff")
    Image.fromarray(SCENE / np.float32(255)).save(tmp_path / "1.tiff")
    with open_video(tmp_path, height=None) as video:
        [frame] = list(video)
        said = "1.tiff is not an image that can be read (its samples have 32 bits"
        assert said in video.decode.messages[-1]
    assert np.abs(frame.luma * 255 - GREY_OF_RGB).max() < 0.51


@pytest.mark.parametrize("suffix", ["png", "webp", "tiff"])
def test_an_animation_or_a_stack_among_images_is_a_failure(tmp_path: Path, suffix: str) -> None:
    pictures = [Image.fromarray(np.roll(RGB, 5 * index, 1)) for index in range(4)]
    pictures[0].save(tmp_path / "0.png")
    pictures[0].save(
        tmp_path / f"1.{suffix}", save_all=True, append_images=pictures[1:], lossless=True
    )
    with open_video(tmp_path, height=None) as video:
        assert len(list(video)) == 2
        assert not video.decode.complete
        said = f"1.{suffix} holds several pictures, of which only the first is read"
        assert said in video.decode.messages[0]


def test_a_photograph_with_a_preview_is_a_single_image(tmp_path: Path) -> None:
    photograph, preview = Image.fromarray(RGB), Image.fromarray(RGB[::2, ::2])
    for index in range(2):
        path = tmp_path / f"{index}.jpg"
        photograph.save(path, "MPO", save_all=True, append_images=[preview])
    with open_video(tmp_path, height=None) as video:
        assert [frame.luma.shape for frame in video] == [RGB.shape[:2]] * 2
        assert video.decode.complete


def test_hidden_twins_of_images_are_ignored(folder: Path) -> None:
    for index in range(3):
        (folder / f"._frame_{index}.png").write_bytes(b"\0\5\x16\7 of another system")
    with open_video(folder, height=None) as video:
        assert len(list(video)) == 12
        assert video.decode.complete
    (folder / ".f_0.png").write_bytes((folder / "frame_0.png").read_bytes())
    with open_video(folder / ".f_%d.png") as video:
        assert len(list(video)) == 1


def test_names_with_digits_of_other_kinds_are_sorted(tmp_path: Path) -> None:
    greys = {"1²3.png": 10, "٣.png": 40, "1²10.png": 20, "2.png": 30}
    for name, grey in greys.items():
        cv2.imwrite(str(tmp_path / name), np.full((20, 20), grey, np.uint8))
    with open_video(tmp_path, height=None) as video:
        assert [round(255 * float(frame.luma.max())) for frame in video] == [10, 20, 30, 40]
    with pytest.raises(SourceError, match="no such file"):
        open_video(tmp_path / f"%0{10**12}d.png")


@pytest.mark.skipif(sys.platform == "win32", reason="no pipes with names")
def test_pipes_and_devices_are_not_waited_for(folder: Path) -> None:
    os.mkfifo(folder / "frame_12.png")
    with open_video(folder, height=None) as video:
        assert len(list(video)) == 12
        assert video.decode.messages == [
            "frame_12.png is not an image that can be read (not a regular file)"
        ]


@pytest.mark.parametrize(
    ("name", "message"),
    [("missing_%d.png", "no image there"), ("nowhere/f_%d.png", "no such folder")],
)
def test_a_pattern_without_images(folder: Path, name: str, message: str) -> None:
    with pytest.raises(SourceError, match=message):
        open_video(folder / name)


def test_a_single_image_shows_no_motion(folder: Path) -> None:
    with pytest.raises(SourceError, match="a single image shows no motion"):
        open_video(folder / "frame_1.png")


def test_images_that_cannot_be_read(tmp_path: Path) -> None:
    (tmp_path / "a.png").write_bytes(b"nothing")
    with pytest.raises(SourceError, match="none of these images"):
        open_video(tmp_path)


# The detectors then take several times as long for a frame as the cameras of these tests.
SLOW = ("--height", "480", "--repeats", "keep")


class FakeCamera:
    """Three pictures, then nothing."""

    count = 3

    def __init__(self, number: int) -> None:
        self.remaining = self.count if number == 0 else 0

    def read(self) -> tuple[bool, Any]:
        self.remaining -= 1
        return self.remaining >= 0, np.full((48, 64, 3), 255, np.uint8)

    def get(self, _property: int) -> float:
        return 30.0

    def release(self) -> None:
        pass


class Clock:
    """The clocks of Windows, which only `sleep` moves."""

    now_s = 0.0

    def monotonic(self) -> float:
        return self.now_s // 0.015625 * 0.015625

    def perf_counter(self) -> float:
        return self.now_s

    def sleep(self, seconds: float) -> None:
        self.now_s += seconds


def use(camera: type, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let OpenCV open a camera of our own, whose retries take no time."""
    monkeypatch.setattr(cv2, "VideoCapture", camera)
    monkeypatch.setattr(images, "time", Clock())


def test_a_camera_is_a_source_like_any_other(monkeypatch: pytest.MonkeyPatch) -> None:
    use(FakeCamera, monkeypatch)
    with open_video("camera:0", height=24) as video:
        frames = list(video)
        assert video.facts.frame_rate == 30
        assert not video.decode.complete
    assert [frame.index for frame in frames] == [0, 1, 2]
    assert (frames[0].luma.shape, frames[0].time_s) == ((24, 32), 0)


def test_the_times_of_a_camera_are_as_exact_as_a_clock_can_tell(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """At 120 frames/s several frames would have equal times by a clock with steps of 16 ms."""

    clock = Clock()

    class Fast(FakeCamera):
        def read(self) -> tuple[bool, Any]:
            clock.sleep(1 / 120)
            return super().read()

    use(Fast, monkeypatch)
    monkeypatch.setattr(images, "time", clock)
    with open_video("camera:0", height=24) as video:
        assert [frame.time_s for frame in video] == pytest.approx([0, 1 / 120, 2 / 120])


@pytest.mark.parametrize(
    ("taken_ms", "times"),
    [
        ([5000, 5040, 5080, 5120], [0, 0.04, 0.08, 0.12]),  # of a driver that keeps pictures
        ([5000, 5040, 5040, 5200], [0, 0.04, 0.11, 0.2]),  # the third has no time of its own
        ([0, 0, 0, 0], [0, 0.01, 0.11, 0.12]),  # of a driver without a clock
        ([0, 5040, 5080, 5120], [0, 0.01, 0.11, 0.12]),  # its clock begins with the second picture
    ],
)
def test_pictures_have_the_times_at_which_the_driver_took_them(
    taken_ms: list[int], times: list[float], monkeypatch: pytest.MonkeyPatch
) -> None:
    """They arrive in pairs; the driver has kept the second one for 0.3 s."""
    clock = Clock()

    class Late(FakeCamera):
        count = 4

        def read(self) -> tuple[bool, Any]:
            clock.sleep({4: 0, 2: 0.1}.get(self.remaining, 0.01))
            return super().read()

        def get(self, name: int) -> float:
            at = len(taken_ms) - 1 - max(self.remaining, 0)
            return taken_ms[at] if name == cv2.CAP_PROP_POS_MSEC else 30.0

    use(Late, monkeypatch)
    monkeypatch.setattr(images, "time", clock)
    with open_video("camera:0", height=24) as video:
        clock.sleep(0.3)
        assert [frame.time_s for frame in video] == pytest.approx(times)


def test_pictures_of_a_driver_without_a_clock_that_come_in_pairs_have_times_apart(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    clock = Clock()

    class Paired(FakeCamera):
        count = 60

        def read(self) -> tuple[bool, Any]:
            clock.sleep(0.06 if self.remaining % 2 else 0.002)
            return super().read()

    use(Paired, monkeypatch)
    monkeypatch.setattr(images, "time", clock)
    with Video(CameraSource("camera:0"), 24, Span(), ahead=False) as video:
        times = [frame.time_s for frame in video]
    assert np.diff(times)[30:] == pytest.approx(0.031, rel=0.25)
    assert 30 < video.decode.smoothed < 60


@pytest.mark.long
def test_frames_that_come_faster_than_they_are_analysed_are_dropped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Many(FakeCamera):
        count = 200

    use(Many, monkeypatch)
    with open_video("camera:0", height=24) as video:
        frames = video.begin()
        for _ in range(10_000):
            if video.decode.failures:  # the camera has stopped
                break
            sleep(0.001)
        assert [frame.index for frame in frames] == [196, 197, 198, 199]
        assert (video.decode.decoded, video.decode.dropped) == (200, 196)
    done = oppload("run", "camera:0", "-o", tmp_path, *SLOW)
    sidecar = json.loads((tmp_path / "camera-0.oppload.json").read_bytes())
    assert datetime.fromisoformat(sidecar["time"]["zero_utc"]) <= datetime.now(UTC)
    decode = sidecar["decode"]
    assert decode["decoded"] == decode["analysed"] + decode["dropped"] == 200
    assert f"{decode['dropped']} of 200 frames were dropped, because they came" in done.stderr


@pytest.mark.long
@pytest.mark.parametrize("start", ["f0", "f100"])
def test_a_camera_that_the_user_stops_is_reported(
    start: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Stopped(FakeCamera):
        count = 200

        def read(self) -> tuple[bool, Any]:
            if not self.remaining:
                raise KeyboardInterrupt
            return super().read()

    use(Stopped, monkeypatch)
    for place in (tmp_path, "-"):
        done = oppload("run", "camera:0", "-o", place, *SLOW, "--start", start)
        assert (done.returncode, "OppLoD no alarm" in done.stderr) == (130, True)
        wanted = 200 - int(start[1:])
        assert re.search(f"[0-9]+ of {wanted} frames were dropped", done.stderr)
    decode = json.loads((tmp_path / "camera-0.oppload.json").read_bytes())["decode"]
    assert decode["decoded"] == 200


def test_a_camera_that_goes_on_changes_no_count_after_the_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Endless(FakeCamera):
        def read(self) -> tuple[bool, Any]:
            sleep(1e-4)
            self.remaining = 2
            return super().read()

    def stop(*_: object) -> None:
        sleep(0.3)  # so that more than 30 frames are dropped
        raise KeyboardInterrupt

    use(Endless, monkeypatch)
    monkeypatch.setattr("oppload_cli.cli.progress.Progress.frame", stop)
    said = oppload("run", "camera:0", "-o", tmp_path, "--height", "24").stderr
    (remark,) = re.findall("[0-9]+ of [0-9]+ frames were dropped", said)
    assert remark in (tmp_path / "camera-0.oppload.json").read_text()


def test_a_camera_that_fails_once_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    class Hiccup(FakeCamera):
        """Fails for 0.9 s after its second picture."""

        failures = iter([False, False, *[True] * 90])

        def read(self) -> tuple[bool, Any]:
            return (False, None) if next(self.failures, False) else super().read()

    use(Hiccup, monkeypatch)
    with open_video("camera:0", height=24) as video:
        assert len(list(video)) == 3
        assert video.decode.messages == ["the camera failed, and went on", "the camera stopped"]
        assert video.decode.failures == 2


@pytest.mark.parametrize("stated", [0.0, -1.0, 1e-9, float("inf"), float("nan")])
def test_a_camera_that_states_no_rate(monkeypatch: pytest.MonkeyPatch, stated: float) -> None:
    use(FakeCamera, monkeypatch)
    monkeypatch.setattr(FakeCamera, "get", lambda _self, _property: stated)
    with open_video("camera:0", height=24) as video:
        assert video.facts.frame_rate is None
        assert len(list(video)) == 3


@pytest.mark.parametrize("own_process", [False, True])
def test_a_file_with_the_name_of_a_camera_is_given_with_its_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, *, own_process: bool
) -> None:
    write_video(tmp_path / "a.avi", grey_frames(5)).rename(tmp_path / "camera:0")
    monkeypatch.chdir(tmp_path)
    use(FakeCamera, monkeypatch)
    for name, kind, count in (("camera:0", "camera", 3), ("./camera:0", "container", 5)):
        opening = Opening(name, height=24, span=Span(), own_process=own_process)
        with opening.result() as video:
            assert video.facts.kind == kind
            assert len(list(video)) == count


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("camera:x", "not the name of a camera"),
        ("camera:²", "not the name of a camera"),
        ("camera:1", "gives no picture"),
        pytest.param(
            *("/dev/video2", "is the device of a camera; write camera:2"),
            marks=pytest.mark.skipif(sys.platform == "win32", reason="no devices as files"),
        ),
    ],
)
def test_a_camera_that_is_not_there(
    monkeypatch: pytest.MonkeyPatch, name: str, message: str
) -> None:
    use(FakeCamera, monkeypatch)
    with pytest.raises(SourceError, match=message):
        open_video(name)
