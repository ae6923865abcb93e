"""``oppload run --annotate`` and ``detections.jsonl`` through the real command."""

from __future__ import annotations

import json
import signal
import sys
import time
from typing import TYPE_CHECKING

import av
import pytest

from tests.cli.inside import oppload
from tests.cli.process import start, wait_for_rows
from tests.media import grey_frames, write_film, write_video

if TYPE_CHECKING:
    from pathlib import Path

FAST = ("--height", "48", "--no-rmo")


def frames_of(path: Path) -> int:
    with av.open(str(path)) as container:
        return sum(1 for _ in container.decode(video=0))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three clips of different lengths."""
    folder = tmp_path_factory.mktemp("clips")
    for number in range(3):
        write_video(folder / f"clip{number}.avi", grey_frames(6 + number, seed=number))
    return folder


@pytest.mark.long
def test_the_files_of_a_run(clip: Path, tmp_path: Path) -> None:
    done = oppload("run", clip, "-o", tmp_path, "--annotate")
    assert done.returncode == 0, done.stderr
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "loom.annotated.mp4",
        "loom.detections.jsonl",
        "loom.frames.csv",
        "loom.oppload.json",
    ]
    assert frames_of(tmp_path / "loom.annotated.mp4") == 24
    lines = (tmp_path / "loom.detections.jsonl").read_text().splitlines()
    assert all({"frame", "time_s", "id", "time_to_contact_s"} <= set(json.loads(x)) for x in lines)
    # A second run gives the same video. A run without --annotate gives the same table.
    again = tmp_path / "again"
    assert oppload("run", clip, "-o", again, "--annotate").returncode == 0
    assert oppload("run", clip, "-o", tmp_path / "plain").returncode == 0
    for name in ("loom.annotated.mp4", "loom.detections.jsonl", "loom.frames.csv"):
        assert (again / name).read_bytes() == (tmp_path / name).read_bytes()
    plain = {path.name: path.read_bytes() for path in (tmp_path / "plain").iterdir()}
    assert plain["loom.frames.csv"] == (tmp_path / "loom.frames.csv").read_bytes()
    assert sorted(plain) == ["loom.detections.jsonl", "loom.frames.csv", "loom.oppload.json"]


def test_without_opplod_there_are_no_detections(clip: Path, tmp_path: Path) -> None:
    (tmp_path / "loom.detections.jsonl.part").touch()  # of an interrupted run with OppLoD
    done = oppload("run", clip, "-o", tmp_path, "--model", "dlgmd", "--annotate", *FAST)
    assert done.returncode == 0, done.stderr
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        *("loom.annotated.mp4", "loom.frames.csv", "loom.oppload.json")
    ]


@pytest.mark.long
def test_detections_of_a_replaced_result_are_removed(clip: Path, tmp_path: Path) -> None:
    assert oppload("run", clip, "-o", tmp_path, *FAST).returncode == 0
    words = ("run", clip, "-o", tmp_path, "--model", "frame_difference", *FAST)
    assert oppload(*words, "--if-exists", "overwrite").returncode == 0
    assert not (tmp_path / "loom.detections.jsonl").exists()  # they were of OppLoD


def test_standard_output_holds_no_video(clip: Path) -> None:
    done = oppload("run", clip, "-o", "-", "--annotate")
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == (
        "oppload: --annotate writes a file; give a folder with --output, not '-'\n"
    )


@pytest.mark.long
def test_a_result_is_complete_with_every_file_that_is_asked_for(clip: Path, tmp_path: Path) -> None:
    arguments = ("run", clip, "-o", tmp_path, *FAST)
    assert oppload(*arguments).returncode == 0
    # The first run wrote no annotated video, so --if-exists skip does not skip the input.
    done = oppload(*arguments, "--annotate", "--if-exists", "skip")
    assert "skipped" not in done.stderr
    assert (tmp_path / "loom.annotated.mp4").exists()
    for more in ((), ("--annotate",)):
        assert "skipped" in oppload(*arguments, *more, "--if-exists", "skip").stderr
    (tmp_path / "loom.detections.jsonl").unlink()
    assert "skipped" not in oppload(*arguments, "--if-exists", "skip").stderr
    for name in ("loom.frames.csv", "loom.oppload.json", "loom.detections.jsonl"):
        (tmp_path / name).unlink()
    refused = oppload(*arguments, "--annotate")
    assert refused.returncode == 2
    assert "loom.annotated.mp4: exists already" in refused.stderr


def test_a_span_without_a_frame_gives_nothing(clip: Path, tmp_path: Path) -> None:
    done = oppload("run", clip, "-o", tmp_path, "--annotate", "--start", "f900", *FAST)
    assert done.returncode == 2, done.stderr
    said = "no frame in the part that --start, --end and --duration leave; it has 0.80 s, 24 frames"
    assert said in done.stderr
    assert not list(tmp_path.iterdir())


@pytest.mark.long
def test_an_annotated_video_of_a_batch_is_no_input(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    done = oppload("run", folder, "-o", out, "--annotate", "--jobs", "1", *FAST)
    assert done.returncode == 0, done.stderr
    assert [frames_of(path) for path in sorted(out.glob("*.annotated.mp4"))] == [6, 7, 8]
    for more in ((), ("-r",)):
        done = oppload("run", out, "-o", tmp_path / "again", *more)
        assert done.returncode == 3
        assert "annotated.mp4" not in done.stderr


@pytest.mark.long
@pytest.mark.skipif(sys.platform == "win32", reason="POSIX signals")
def test_an_interrupted_run_leaves_a_video_that_plays(tmp_path: Path) -> None:
    film = write_film(tmp_path / "film.avi", times=20)
    out = tmp_path / "out"
    part = out / "film.frames.csv.part"
    with start("run", film, "-o", out, "--annotate", *FAST) as run:
        wait_for_rows(run, part)
        time.sleep(0.2)
        run.send_signal(signal.SIGINT)
        said = run.communicate(timeout=120)[1]
    assert run.returncode == 130, said
    assert said.strip().count("\n") == 0
    rows = part.read_text().count("\n") - 1
    assert sorted(path.name for path in out.iterdir()) == [
        "film.annotated.mp4.part",
        "film.detections.jsonl.part",
        "film.frames.csv.part",
    ]
    # Frames that the encoder still held may be missing.
    assert rows - 8 <= frames_of(out / "film.annotated.mp4.part") <= rows
