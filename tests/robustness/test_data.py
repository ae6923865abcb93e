"""Tables, sidecars and numbers that no run of oppload writes: named and refused, never a bug."""

from __future__ import annotations

import csv
import json
import os
import sys
import threading
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import pytest
from PIL import Image

from oppload_cli.batch.plan import FAILURE_COLUMNS, failed_in
from oppload_cli.errors import (
    ParameterError,
    ResultError,
    ShortageError,
    SourceError,
    counted,
    shortage,
)
from oppload_cli.files.atomic import cannot_write
from oppload_cli.files.reading import content_of
from oppload_cli.plots.style import wrapped
from oppload_cli.results.alarm_log import ALARM_COLUMNS, write_alarms
from oppload_cli.results.result_files import read_result
from oppload_cli.results.tuning import is_tuning
from oppload_cli.schema import parsed_fraction
from oppload_cli.video.inputs import found_inputs
from oppload_cli.video.source import open_video
from tests.cli.inside import oppload
from tests.media import grey_frames, write_video
from tests.robustness.inputs import Kind, make

if TYPE_CHECKING:
    from collections.abc import Callable


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The table of a short clip, with its sidecar."""
    folder = tmp_path_factory.mktemp("data")
    clip = write_video(folder / "clip.avi", grey_frames(12), codec="ffv1")
    from tests.cli.inside import oppload

    done = oppload("run", clip, "-o", folder, "--height", "24", "-q")
    assert done.returncode == 0, done.stderr
    return folder / "clip.frames.csv"


BROKEN: dict[str, Callable[[dict[str, Any]], object]] = {
    "rate": lambda facts: facts["input"].update(frame_rate="1e99999999"),
    "rates": lambda facts: facts["input"].update(frame_rate=[1]),
    "input": lambda facts: facts.update(input=5),
    "inputs": lambda facts: facts.update(input=[]),
    "infinite": lambda facts: facts["decode"].update(decoded=float("inf")),
    "huge": lambda facts: facts["decode"].update(decoded=10**4000),
    "huge-time": lambda facts: facts.update(wall_s=10**400),
    "models": lambda facts: facts.update(models=5),
    "stimulus": lambda facts: facts.update(stimulus=[1]),
    "summary": lambda facts: facts.update(summary=[]),
    "working": lambda facts: facts.update(working=None),
}


@pytest.mark.parametrize("frames", [False, True])
@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_bad_sidecars_are_named_and_do_not_stop_the_others(
    result: Path, tmp_path: Path, suffix: str, *, frames: bool
) -> None:
    if suffix == "parquet":
        pytest.importorskip("pyarrow", reason="NOT TESTED: pip install 'oppload[parquet]'")
    sidecar = result.with_name("clip.oppload.json")
    folder = tmp_path / "results"
    folder.mkdir()

    def put(name: str, content: str) -> None:
        (folder / f"{name}.oppload.json").write_text(content)
        (folder / f"{name}.frames.csv").write_bytes(result.read_bytes())

    for name, change in BROKEN.items():
        facts = json.loads(sidecar.read_text())
        change(facts)
        put(name, json.dumps(facts))
    put("good", sidecar.read_text())
    put("surrogate", sidecar.read_text().replace("clip.avi", "\\udcff\\ud800.avi"))
    put("deep", "[" * 100_000)
    bad = {*BROKEN, "deep"}
    if sys.platform != "win32":
        os.mkfifo(folder / "pipe.oppload.json")
        bad.add("pipe")
    if frames:  # the tables themselves are good
        bad &= {"deep", "pipe"}
    table = tmp_path / f"all.{suffix}"
    done = oppload("collect", folder, "-o", table, *(["--frames"] if frames else []))
    assert done.returncode == 4, done.stderr
    named = {Path(line.split(": ")[1]).name for line in done.stderr.splitlines()[: len(bad)]}
    assert {name.partition(".")[0] for name in named} == bad
    assert f"{counted(len(bad), 'result')} could not be collected" in done.stderr
    if suffix == "csv":
        assert r"\udcff\ud800.avi" in table.read_text(encoding="utf-8")


@pytest.mark.skipif(sys.platform == "win32", reason="no POSIX pipes")
@pytest.mark.parametrize(
    ("name", "content", "read"),
    [
        ("a.csv", "stimulus,model\n", is_tuning),
        (
            "alarms.csv",
            f"{','.join(ALARM_COLUMNS)}\na,opplod\n",
            lambda path: write_alarms(path, {}, {}),
        ),
        (
            "failures.csv",
            f"{','.join(FAILURE_COLUMNS)}\na,a,2,b\n",
            lambda path: any(failed_in(path.parent)),
        ),
    ],
)
def test_tables_that_are_pipes_are_not_waited_for(
    tmp_path: Path, name: str, content: str, read: Callable[[Path], object]
) -> None:
    theirs, ours = os.pipe()
    os.write(ours, content.encode())
    end = threading.Timer(1, os.close, (ours,))  # else a reader would wait for ever
    end.start()
    try:
        (tmp_path / name).symlink_to(f"/dev/fd/{theirs}")
        assert not read(tmp_path / name)
        assert os.read(theirs, 1000) == content.encode()
    finally:
        end.cancel()
        end.join()
        with suppress(OSError):
            os.close(ours)
        os.close(theirs)


@pytest.mark.parametrize("value", ["1e308", "abc", "9" * 400, "inf"])
@pytest.mark.parametrize("column", ["frame", "time_s", "opplod_response", "opplod_alarm"])
def test_a_cell_that_no_curve_has(result: Path, tmp_path: Path, column: str, value: str) -> None:
    rows = list(csv.reader(result.read_text(encoding="utf-8").splitlines()))
    rows[8][rows[0].index(column)] = value
    path = tmp_path / "a.frames.csv"
    with path.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file).writerows(rows)
    with pytest.raises(ResultError, match=f"column '{column}' holds '.*' in line 9, which is no"):
        read_result(path)


def test_only_the_needed_columns_are_read(result: Path) -> None:
    whole = read_result(result).frames
    assert len(whole) == 12
    few = read_result(result, ["_alarm"]).frames
    assert {name.rpartition("_")[2] for name in few.columns} == {"frame", "s", "response", "alarm"}
    assert few.equals(whole[few.columns])


@pytest.mark.long
@pytest.mark.skipif(sys.platform == "win32", reason="no name has a backslash there")
def test_any_name_can_be_drawn(result: Path, tmp_path: Path) -> None:
    names = ["a$\\frac{b$", "_a$b$", "$", "a\\$b$", "\udcff", "x\ny", "影"]
    paths = [tmp_path / f"{name}.frames.csv" for name in names]
    for path in paths:
        path.write_bytes(result.read_bytes())
    words = ("--model", "opplod", "--title", " ".join(names), "-o", tmp_path / "a.png")
    done = oppload("plot", *paths, *words)
    assert done.returncode == 0, done.stderr
    for name in names:
        shown = wrapped(name, 1000)
        assert wrapped(shown, 1000) == shown


@pytest.mark.skipif(sys.platform == "win32", reason="no pipes with names")
def test_pipes_among_files_never_make_a_command_wait(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.mp4")
    (tmp_path / "a.mp4").touch()
    assert [each.name for each in found_inputs(str(tmp_path), recursive=True)] == [
        str(tmp_path / "a.mp4")
    ]
    with pytest.raises(OSError, match="a pipe or a device, not a file"):
        content_of(tmp_path / "pipe.mp4")
    manifest = tmp_path / "manifest.csv"
    manifest.write_text("file,label,onset_frame,contact_frame\npipe.mp4,none,,\n")
    done = oppload("evaluate", manifest, "-o", tmp_path / "out")
    assert "row 2: pipe.mp4: is a pipe or a device" in done.stderr
    read, write = os.pipe()
    os.write(write, b"text")
    os.close(write)
    assert content_of(f"/dev/fd/{read}", pipes=True) == b"text"
    os.close(read)


@pytest.mark.skipif(sys.platform == "win32", reason="no links and pipes")
def test_a_pipe_is_read_once(tmp_path: Path) -> None:
    """The check for a cut end, and decoding again with one thread, do not open the pipe again."""
    whole = make(tmp_path / "clip.mkv", Kind("mkv", "mpeg4")).read_bytes()
    for content, complete in ((whole, True), (whole[: len(whole) // 2], False)):
        pipe = tmp_path / f"{complete}.mkv"
        os.mkfifo(pipe)
        writer = threading.Thread(target=pipe.write_bytes, args=(content,))
        writer.start()
        with open_video(pipe) as video:
            count = len(list(video))
            assert (count == 12, video.decode.complete) == (complete, complete)
        writer.join()


@pytest.mark.skipif(sys.platform == "win32", reason="no links and pipes")
def test_an_mp4_in_a_pipe_needs_its_index_first(tmp_path: Path) -> None:
    noise = np.random.default_rng(0).integers(0, 256, (30, 240, 320), np.uint8)
    clip = write_video(tmp_path / "clip.mp4", noise, codec="mpeg4", pixel_format="yuv420p")
    content = clip.read_bytes()
    assert len(content) > 1 << 19  # a shorter one is held in memory, and read from there
    assert content.index(b"mdat") < content.index(b"moov")
    os.mkfifo(tmp_path / "pipe.mp4")
    writer = threading.Thread(target=_written, args=(tmp_path / "pipe.mp4", content))
    writer.start()
    with pytest.raises(SourceError, match="index at its end cannot be read from a pipe"):
        open_video(tmp_path / "pipe.mp4")
    writer.join()


def _written(pipe: Path, content: bytes) -> None:
    with suppress(BrokenPipeError):  # the reader may go before the end
        pipe.write_bytes(content)


@pytest.mark.long
@pytest.mark.skipif(sys.platform == "win32", reason="no links and pipes")
def test_broken_links_and_pipes_among_inputs(result: Path, tmp_path: Path) -> None:
    (tmp_path / "clip.avi").write_bytes((result.parent / "clip.avi").read_bytes())
    (tmp_path / "loop.avi").symlink_to("loop.avi")
    os.mkfifo(tmp_path / "pipe.avi")
    (tmp_path / "gone.avi").symlink_to("nowhere.avi")
    quick = ("--height", "24", "-q", "--no-rmo", "--jobs", "1", "-o")
    named = ([str(tmp_path / "*.avi")], [str(tmp_path)], ["-r", str(tmp_path)])
    for number, words in enumerate((*named, [str(tmp_path / "loop.avi")])):
        done = oppload("run", *words, *quick, tmp_path / f"out{number}")
        assert done.returncode == (4 if words in named else 3), done.stderr
        assert ("pipe.avi: is a pipe or a device" in done.stderr) == (number == 0)
        assert "loop.avi: cannot be read (too many levels of symbolic links)" in done.stderr
        gone = "gone.avi: is a link to a file that does not exist; fetch or restore that file"
        assert (gone in done.stderr) == (words in named)
    images = tmp_path / "images"
    images.mkdir()
    for number in range(3):
        Image.new("L", (24, 16)).save(images / f"{number}.png")
    os.mkfifo(images / "3.png")
    (images / "4.png").symlink_to("4.png")
    done = oppload("run", images, *quick, tmp_path / "out")
    assert done.returncode == 4
    assert "3.png is not an image that can be read (not a regular file)" in done.stderr
    assert "4.png is not an image that can be read (too many levels" in done.stderr


LONG = "9" * 5000
NUMBERS = [
    ("--height", LONG),
    ("--height", "²"),
    ("--start", f"f{LONG}"),
    ("--end", "f²"),
    ("--duration", f"{LONG}:00:00"),
    ("--image-rate", LONG),
    ("--image-rate", "1e-400"),
    ("--image-rate", "1e-999999999"),
    ("--image-rate", "1e999999999"),
    ("--image-rate", "1/1e-999999999"),
    ("--set", "time.interval=1e-300"),
    ("--set", "opplod.pool_sigma=1e-300"),
    ("--set", f"opplod.cell={LONG}"),
    ("--set", f"alarm.factor={LONG}"),
]


@pytest.mark.parametrize(("option", "value"), NUMBERS)
def test_numbers_beyond_all_bounds(option: str, value: str, tmp_path: Path) -> None:
    clip = write_video(tmp_path / "clip.avi", grey_frames(8), codec="ffv1")
    done = oppload("run", clip, "-o", tmp_path / "out", option, value)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1), done.stderr[:300]
    assert "bug" not in done.stderr


def test_exact_fractions_stay_small() -> None:
    assert parsed_fraction("29.97") == parsed_fraction("2997/100")
    for text in ("1e100", "1e-999999999", "1" * 61):
        with pytest.raises(ValueError, match="too long"):
            parsed_fraction(text)


@pytest.mark.parametrize("text", ["a=" + "[" * 900 + "]" * 900, f"[sweep.{'a.' * 3000}a]\nb=[1]"])
def test_deep_toml(text: str, tmp_path: Path) -> None:
    path = tmp_path / "deep.toml"
    path.write_text(text)
    done = oppload("stimuli", "show", path)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1), done.stderr[:300]
    assert "deep.toml: " in done.stderr


def test_a_shortage_is_no_bug() -> None:
    assert "memory is short" in shortage(MemoryError())
    assert "memory is short" in shortage(
        ImportError("x.so: failed to map segment from shared object")
    )
    assert "memory is short" in shortage(cv2.error("std::bad_alloc"))
    assert "process or thread" in shortage(RuntimeError("can't start new thread"))
    assert "process or thread" in shortage(BlockingIOError(11, "Resource temporarily unavailable"))
    assert "files are open" in shortage(OSError(24, "Too many open files"))
    assert shortage(ParameterError("wrong")) == ""
    assert shortage(FileNotFoundError(2, "No such file or directory", "out of memory/a.mp4")) == ""
    again, other = OSError(28, "No space left on device"), ParameterError("wrong")
    again.__context__, other.__cause__ = other, again
    assert shortage(again) == ""
    assert ShortageError.exit_code == 3
    short = cannot_write(Path("a.mp4"), BlockingIOError(11, "Resource temporarily unavailable"))
    assert isinstance(short, ShortageError)
    assert str(short).startswith("a.mp4: cannot be written, because no further process or thread")
