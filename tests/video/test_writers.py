from __future__ import annotations

from fractions import Fraction
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import av
import numpy as np
import pytest

from oppload_cli.errors import ShortageError
from oppload_cli.files.atomic import PartFile
from oppload_cli.video.writers import Recording

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray


def pictures(count: int, width: int = 64, height: int = 48) -> list[NDArray[np.uint8]]:
    values = np.random.default_rng(3).integers(0, 256, (3, 3, 3)).astype(np.float64)
    across = np.linspace(0, 1, width)[None, :, None]
    down = np.linspace(0, 1, height)[:, None, None]
    base = values[0, 0] * (1 - across) + values[1, 1] * across * down
    return [np.clip(base + 2 * t, 0, 255).astype(np.uint8) for t in range(count)]


def record(path: Path, times: list[float], rate: Fraction | None = None) -> Path:
    with PartFile(path) as file:
        recording = Recording(file, 64, 48, rate)
        for picture, time_s in zip(pictures(len(times)), times, strict=True):
            recording.write(picture, time_s)
        recording.finish()
    assert recording.frames == len(times)
    return path


def times_of(path: Path) -> list[Fraction]:
    with av.open(str(path)) as container:
        return [
            frame.pts * frame.time_base
            for frame in container.decode(video=0)
            if frame.pts is not None and frame.time_base is not None
        ]


def test_browsers_can_play_it(tmp_path: Path) -> None:
    path = record(tmp_path / "a.mp4", [t / 30 for t in range(40)], Fraction(30))
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        context = stream.codec_context
        assert (context.name, context.pix_fmt, context.profile) == ("h264", "yuv420p", "High")
        assert (context.colorspace, context.color_range) == (1, 1)
        assert container.duration == pytest.approx(40 / 30 * 1e6, abs=2)
        assert len(container.streams) == 1
    data = path.read_bytes()
    assert 0 < data.index(b"moov") < data.index(b"mdat")
    assert b"Lavf" not in data  # its version would change the bytes


@pytest.mark.parametrize(
    "rate", [Fraction(24000, 1001), Fraction(30000, 1001), Fraction(25), Fraction(1000)]
)
def test_times_of_usual_rates_are_exact(tmp_path: Path, rate: Fraction) -> None:
    times = [t / rate for t in range(50)]
    assert times_of(record(tmp_path / "a.mp4", [float(t) for t in times], rate)) == times


def test_times_of_unusual_rates_are_those_of_the_nearest_tick(tmp_path: Path) -> None:
    times = [0.0, 1 / 1009, 2 / 1009, 60.0]  # exact ticks would be too short for a minute
    found = times_of(record(tmp_path / "a.mp4", times, Fraction(1009)))
    assert [float(time_s) for time_s in found] == pytest.approx(times, abs=0.5 / 90_000)


def test_variable_times_are_kept_from_the_first_on(tmp_path: Path) -> None:
    milliseconds = [5000, 5040, 5050, 5400, 5410, 5415, 6000, 6001, 6100, 14000]
    path = record(tmp_path / "a.mp4", [t / 1000 for t in milliseconds])
    assert times_of(path) == [Fraction(t - 5000, 1000) for t in milliseconds]
    with av.open(str(path)) as container:
        assert container.duration == pytest.approx(9e6 + 1e6 / 30, abs=20)


def test_times_that_stand_still_or_jump(tmp_path: Path) -> None:
    tick = Fraction(1, 90_000)
    assert times_of(record(tmp_path / "a.mp4", [0, 0.1, 0.1, 0.05, 0.2])) == [
        0,
        Fraction(1, 10),
        Fraction(1, 10) + tick,
        Fraction(1, 10) + 2 * tick,
        Fraction(1, 5),
    ]
    # The clock jumps a day ahead, and back to its beginning.
    jumps = times_of(record(tmp_path / "b.mp4", [0, 1, 86401, 86402, 0, 1]))
    frame = 1 / 30
    expected = [0, 1, 1 + frame, 2 + frame, 2 + 2 * frame, 3 + 2 * frame]
    assert [float(t) for t in jumps] == pytest.approx(expected, abs=2e-5)


def test_one_frame_and_none(tmp_path: Path) -> None:
    assert times_of(record(tmp_path / "a.mp4", [7.0])) == [0]
    record(tmp_path / "b.mp4", [])


def test_colours_survive_within_a_few_levels(tmp_path: Path) -> None:
    path = record(tmp_path / "a.mp4", [t / 30 for t in range(10)])
    with av.open(str(path)) as container:
        decoded = [f.to_ndarray(format="bgr24") for f in container.decode(video=0)]
    for seen, picture in zip(decoded, pictures(10), strict=True):
        assert np.abs(seen.astype(int) - picture).mean() < 3


def test_the_same_frames_give_the_same_bytes(tmp_path: Path) -> None:
    times = [t / 30 for t in range(60)]
    one, other = (record(tmp_path / name, times) for name in ("a.mp4", "b.mp4"))
    assert one.read_bytes() == other.read_bytes()


def test_an_encoder_without_memory_or_threads_is_a_shortage(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(_frame: object) -> None:
        raise av.error.ExternalError(1, "Generic error in an external library")

    def encode(recording: Any, frame: av.VideoFrame, ticks: int) -> None:
        recording._stream = SimpleNamespace(encode=refuse)
        plain(recording, frame, ticks)

    plain = Recording.encode
    monkeypatch.setattr(Recording, "encode", encode)
    short = "a.mp4: cannot be written, because no further process or thread can be started"
    with pytest.raises(ShortageError, match=short):
        record(tmp_path / "a.mp4", [0.0])
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("end", "message"), [("finish", "End of file"), ("abandon", "abandoned")])
def test_a_recording_that_has_ended_writes_nothing_more(
    tmp_path: Path, end: str, message: str
) -> None:
    with PartFile(tmp_path / "a.mp4") as file:
        recording = Recording(file, 64, 48, None)
        recording.write(pictures(1)[0], 0.0)
        getattr(recording, end)()
        with pytest.raises(OSError, match=message):
            recording.finish()
