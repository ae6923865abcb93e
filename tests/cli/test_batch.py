"""Many inputs through the real command."""

from __future__ import annotations

import json
import os
import shlex
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from oppload_cli.batch import tasks
from oppload_cli.cli import progress
from oppload_cli.cli.progress import AlarmTable, BatchProgress
from oppload_cli.errors import printable
from oppload_cli.files import atomic
from oppload_cli.files.atomic import PartFile
from oppload_cli.pipeline.task import Interrupted, Outcome
from oppload_cli.results.alarm_log import ALARM_COLUMNS, verdicts_in
from tests.cli import process
from tests.cli.inside import oppload
from tests.media import grey_frames, write_film, write_video
from tests.results.make import rows_of

FAST = ("--height", "48", "--no-rmo")


@pytest.fixture(scope="module")
def clips(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Twelve short clips, one of them damaged."""
    folder = tmp_path_factory.mktemp("many")
    for number in range(12):
        frames = grey_frames(8 + number, seed=number)
        path = folder / f"clip{number}.avi"
        write_video(path, frames, codec="mpeg4", pixel_format="yuv420p")
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2] + bytes(60) + data[len(data) // 2 + 60 :])
    return folder


@pytest.fixture(scope="module")
def one_by_one(clips: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same clips in one process, one after the other."""
    folder = tmp_path_factory.mktemp("single")
    done = oppload("run", clips, "-o", folder, "--jobs", "1", *FAST)
    assert done.returncode in {0, 4}, done.stderr
    return folder


def failed(folder: Path) -> list[dict[str, str]]:
    return rows_of(folder / "failures.csv")


def written(folder: Path) -> dict[str, int]:
    """The times at which the files of results were written, without the list of alarms."""
    return {
        path.name: path.stat().st_mtime_ns
        for path in folder.iterdir()
        if not path.name.startswith("alarms")
    }


def tables(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.glob("*.frames.csv")}


def sidecars(folder: Path) -> dict[str, Any]:
    """The sidecars without the values that depend on the clock, the command line and the cores."""
    own = ("command", "threads", "wall_s", "frames_per_s")
    content = {path.name: json.loads(path.read_text()) for path in folder.glob("*.oppload.json")}
    return {
        name: {key: value for key, value in each.items() if key not in own}
        for name, each in content.items()
    }


def same_results(folder: Path, other: Path) -> None:
    assert len(tables(folder)) == 12
    assert tables(folder) == tables(other)
    assert sidecars(folder) == sidecars(other)
    assert not list(folder.glob("*.part"))


@pytest.mark.long
def test_a_batch_gives_the_bytes_of_a_run(clips: Path, one_by_one: Path, tmp_path: Path) -> None:
    alone = oppload("run", clips / "clip3.avi", "-o", tmp_path, *FAST)
    assert alone.returncode == 0
    assert len(tables(tmp_path)) == 1
    assert tables(tmp_path).items() <= tables(one_by_one).items()


@pytest.mark.long
def test_two_processes_give_the_bytes_of_one_and_a_bar_that_names_their_inputs(
    clips: Path, one_by_one: Path, tmp_path: Path
) -> None:
    words = ("run", str(clips), "-o", str(tmp_path), "--jobs", "2", *FAST)
    if sys.platform == "win32":  # no pseudo-terminals
        said = process.oppload(*words).stderr
    else:
        with process.at_terminal(*words) as (child, terminal):
            said = process.shown_at(terminal)
            os.waitpid(child, 0)
        assert "/12 [" in said
        assert " frames/s, clip" in said
    same_results(tmp_path, one_by_one)
    assert "all                 12" in said


@pytest.mark.long
def test_failures_spare_the_others_and_are_tried_again(clips: Path, tmp_path: Path) -> None:
    bad, out = tmp_path / "it's bad.mp4", tmp_path / "out"
    bad.write_text("not a video\n" * 100)
    two = clips / "clip[01].avi"
    named = ("run", two, bad, tmp_path / "*.mkv", "-j", "1", "-o", out, *FAST)
    done = oppload(*named)
    assert done.returncode == 4
    assert len(tables(out)) == 2
    rows = failed(out)
    assert [(row["input"], row["exit_code"]) for row in rows] == [
        (str(tmp_path / "*.mkv"), "3"),
        (str(bad), "3"),
    ]
    assert done.stderr.count("not a video that can be read") == 1
    assert done.stderr.endswith(f"oppload: the failed inputs are in {out / 'failures.csv'}\n")
    bad.write_bytes((clips / "clip2.avi").read_bytes())
    (tmp_path / "x.mkv").write_bytes((clips / "clip2.avi").read_bytes())
    retried = oppload(*named, "--if-exists", "skip")
    assert retried.returncode == 0, retried.stderr
    assert set(tables(out)) == {
        *("clip0.frames.csv", "clip1.frames.csv", "it's bad.frames.csv", "x.frames.csv")
    }
    assert not (out / "failures.csv").exists()


@pytest.mark.long
def test_each_shard_has_lists_of_its_own(clips: Path, tmp_path: Path) -> None:
    bad, out = tmp_path / "bad.mp4", tmp_path / "out"
    bad.write_text("not a video\n" * 100)
    named = ("run", bad, clips / "clip[01].avi", "-o", out, "--shard", "1/2", "-j", "1", *FAST)
    assert oppload(*named).returncode == 4
    lists = [out / "alarms-1-of-2.csv", out / "failures-1-of-2.csv"]
    assert [path.exists() for path in lists] == [True, True]
    bad.write_bytes((clips / "clip2.avi").read_bytes())
    assert oppload(*named, "--if-exists", "skip").returncode == 0
    assert [path.exists() for path in lists] == [True, False]
    assert not (out / "alarms.csv").exists()


def test_a_list_that_cannot_be_written_is_no_success(clips: Path, tmp_path: Path) -> None:
    for name in ("alarms.csv", "failures.csv"):
        (tmp_path / name).mkdir()
    done = oppload("run", clips / "clip[01].avi", "-j", "1", "-o", tmp_path, *FAST)
    assert done.returncode == 4
    assert len(tables(tmp_path)) == 2
    for name in ("alarms.csv", "failures.csv"):
        assert f"{name}: cannot be written (" in done.stderr


@pytest.mark.parametrize("name", ["alarms.csv", "failures.csv"])
def test_a_file_of_the_user_with_the_name_of_a_list_stays(
    clips: Path, tmp_path: Path, name: str
) -> None:
    mine = tmp_path / name
    mine.write_text("mine\n1\n")
    words = ("run", clips / "clip[01].avi", "-j", "1", "-o", tmp_path, *FAST, "--if-exists")
    for choice in ("error", "skip"):
        refused = oppload(*words, choice)
        assert refused.returncode == 2
        assert f"{name}: exists already and is no list of this version" in refused.stderr
        assert (list(tmp_path.iterdir()), mine.read_text()) == ([mine], "mine\n1\n")
    assert oppload(*words, "overwrite").returncode == 0
    assert oppload(*words, "skip").returncode == 0


def test_a_run_of_one_input_brings_the_alarms_of_a_batch_up_to_date(
    clips: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    alarms = tmp_path / "alarms.csv"
    header = ",".join(ALARM_COLUMNS)
    rows = [f"{name},{name}.avi,opplod,1,0,1,2,,,,," for name in ("clip0", "clip1")]
    alarms.write_text("\n".join([header, *rows]) + "\n")
    assert oppload("run", clips / "clip0.avi", "-o", tmp_path, *FAST).returncode == 0
    assert alarms.read_text().splitlines() == [header, rows[1]]  # without an alarm of clip0
    monkeypatch.setattr(atomic, "_DYING_S", 0)
    with PartFile(alarms):  # of a batch that ends at this moment
        done = oppload("run", clips / "clip1.avi", "-o", tmp_path, *FAST)
    assert done.returncode == 4
    assert "alarms.csv: another run is writing it" in done.stderr
    assert (tmp_path / "clip1.frames.csv").exists()


def test_an_input_that_does_not_suit_the_settings_is_named(tmp_path: Path) -> None:
    """Also once only, where the message has the name already."""
    for name in ("a.avi", "b.avi"):
        write_video(tmp_path / name, grey_frames(3))
    words = ("run", "a.avi", "b.avi", "-j", "1", "--no-rmo", "--if-exists", "overwrite")
    for options, fault in (
        (("--height", "12", "--model", "mlplc2"), "model 'mlplc2' needs frames of at least 15"),
        (("--start", "f90"), "has no frame in the part that --start, --end and"),
    ):
        done = oppload(*words, *options, cwd=tmp_path)
        assert done.returncode == 2
        for name in ("a.avi", "b.avi"):
            assert f"oppload: {name}: {fault}" in done.stderr


def test_every_input_failing_is_no_success(tmp_path: Path) -> None:
    for name in ("a.mp4", "b.mp4"):
        (tmp_path / name).write_text("no video")
    done = oppload("run", tmp_path, "-o", tmp_path / "out", "-j", "1", "-q")
    assert done.returncode == 3
    assert len((tmp_path / "out" / "failures.csv").read_text().splitlines()) == 3


def test_a_dry_run_says_which_inputs_do_not_exist(clips: Path, tmp_path: Path) -> None:
    names = (next(clips.glob("*.avi")), "away.mp4", "frames_%04d.png")
    plan = oppload("run", *names, "-o", tmp_path / "out", "--dry-run")
    assert plan.returncode == 4
    assert plan.stdout.count("\n") == 1
    assert "away.mp4: no such file; check the path" in plan.stderr
    assert "3 inputs: 1 to run, 0 to skip, 2 not possible, 0 to refuse" in plan.stderr
    assert oppload("run", "away.mp4", "--dry-run").returncode == 3


def test_a_dry_run_prints_the_plan_and_makes_nothing(clips: Path, tmp_path: Path) -> None:
    names = "\0".join(str(clips / f"clip{number}.avi") for number in (2, 1, 2))
    (tmp_path / "list").write_text(names + "\0")
    out = tmp_path / "out"
    words = ("run", "--files-from", tmp_path / "list", "-0", "-o", out, "-j", "1", *FAST)
    plan = oppload(*words, "--dry-run")
    assert plan.returncode == 0
    assert plan.stdout.splitlines() == [
        f"run\t{clips / f'clip{number}.avi'}\t{out / f'clip{number}.frames.csv'}"
        for number in (1, 2)
    ]
    assert not out.exists()
    assert oppload(*words).returncode == 0
    for existing, state in (("skip", "skip"), ("overwrite", "run"), ("error", "refuse")):
        plan = oppload(*words, "--dry-run", "--if-exists", existing)
        assert [line.split("\t")[0] for line in plan.stdout.splitlines()] == [state] * 2


@pytest.mark.slow
def test_shards_in_parallel_by_plain_shell_then_again(
    clips: Path, one_by_one: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    run = shlex.join([sys.executable, "-m", "oppload_cli", "run", str(clips), "-o", str(out)])
    options = shlex.join([*FAST, "--if-exists", "skip"])
    script = f'for i in 1 2 3 4 5 6 7 8; do {run} {options} --shard "$i/8" & done; wait'
    subprocess.run(["sh", "-c", script], check=True, capture_output=True, timeout=120)
    same_results(out, one_by_one)
    before = written(out)
    again = [oppload("run", clips, "-o", out, *FAST, "--if-exists", "skip", "--shard", "3/8")]
    again += [oppload("run", clips, "-o", out, *FAST, "--if-exists", "skip", "-j", "2")]
    assert [done.returncode for done in again] == [0, 0]
    kept = [
        [line for line in done.stderr.splitlines() if line.endswith(" skipped")] for done in again
    ]
    assert [len(lines) for lines in kept] == [2, 12]
    assert written(out) == before


@pytest.mark.slow
def test_many_workers_on_the_same_inputs_do_no_harm(
    clips: Path, one_by_one: Path, tmp_path: Path
) -> None:
    command = [sys.executable, "-m", "oppload_cli", "run", str(clips), "-o", str(tmp_path / "out")]
    runs = [
        subprocess.Popen(
            [*command, *FAST, "--if-exists", "skip"], stderr=subprocess.PIPE, text=True
        )
        for _ in range(3)
    ]
    said = [run.communicate(timeout=120)[1] for run in runs]
    assert [run.returncode in {0, 4} for run in runs] == [True] * 3, said
    same_results(tmp_path / "out", one_by_one)


@pytest.fixture(scope="module")
def films(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two videos that are longer than any test waits, between two short videos."""
    folder = tmp_path_factory.mktemp("films")
    short = grey_frames(5)
    for name in ("a.avi", "d.avi"):
        write_video(folder / name, short, codec="mpeg4", pixel_format="yuv420p")
    for name in ("b.avi", "c.avi"):
        write_film(folder / name)
    return folder


def started(films: Path, out: Path) -> subprocess.Popen[str]:
    """Start a batch, and wait until both of its processes analyse a long video."""
    run = subprocess.Popen(
        [sys.executable, "-m", "oppload_cli", "run", str(films), "-o", str(out), "-j", "2"],
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    parts = [out / f"{stem}.frames.csv.part" for stem in "bc"]
    for _ in range(6000):
        if all(part.exists() and part.read_bytes().count(b"\n") > 1 for part in parts):  # a row
            break
        time.sleep(0.01)
    assert run.poll() is None, run.communicate()[1]
    return run


def children(run: subprocess.Popen[str]) -> list[int]:
    """The processes that a run has started for its tasks."""
    lists = Path("/proc", str(run.pid), "task").glob("*/children")  # one per thread
    pids = [pid for listed in lists for pid in listed.read_text().split()]
    return [int(pid) for pid in pids if b"spawn_main" in Path("/proc", pid, "cmdline").read_bytes()]


@pytest.mark.long
@pytest.mark.skipif(sys.platform != "linux", reason="lists processes as Linux does")
@pytest.mark.parametrize("whole_group", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_an_interrupt_ends_every_process_and_keeps_finished_results(
    films: Path, tmp_path: Path, whole_group: bool
) -> None:
    run = started(films, tmp_path)
    workers = children(run)
    # A terminal sends Ctrl-C to every process of the group, another program only to the first.
    (os.killpg if whole_group else os.kill)(run.pid, signal.SIGINT)
    said = run.communicate(timeout=120)[1]
    assert run.returncode == 130
    assert "oppload: interrupted: 1 of 4 inputs are finished; go on with --if-exists skip" in said
    assert "Traceback" not in said
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        *("a.detections.jsonl", "a.frames.csv", "a.oppload.json", "alarms.csv"),
        *("b.detections.jsonl.part", "b.frames.csv.part"),
        *("c.detections.jsonl.part", "c.frames.csv.part"),
    ]
    assert len(workers) == 2
    for pid in workers:
        with pytest.raises(ProcessLookupError):
            os.kill(pid, 0)


@pytest.mark.long
@pytest.mark.skipif(sys.platform != "linux", reason="lists processes as Linux does")
def test_a_process_that_dies_takes_one_input_along(films: Path, tmp_path: Path) -> None:
    run = started(films, tmp_path)
    for pid in children(run):
        os.kill(pid, signal.SIGKILL)
    said = run.communicate(timeout=60)[1]
    assert run.returncode == 4
    assert said.count("was ended from outside (SIGKILL); check the memory") == 2
    assert "done                 2" in said  # by new processes
    rows = failed(tmp_path)
    assert [row["stem"] for row in rows] == ["b", "c"]


def test_a_folder_that_is_running_is_named_without_its_slash(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(progress, "_LINE_EVERY_S", 0)
    BatchProgress(2, 0).started("clips/approach/")
    assert capsys.readouterr().err == "0 of 2 inputs, 0 frames/s, approach\n"


def test_a_result_is_skipped_only_if_it_is_the_same(clips: Path, tmp_path: Path) -> None:
    words = ("run", clips / "clip3.avi", "-o", tmp_path, "--if-exists", "skip", *FAST)
    assert oppload(*words).returncode == 0
    assert "skipped" in oppload(*words).stderr
    assert "skipped" in oppload(*words, "--set", "alarm.factor=8").stderr  # as by default
    for more in (
        ("--set", "opplod.gain=2"),
        ("--start", "f1"),
        ("--model", "dlgmd"),
        ("--fov", "90"),
        ("--set", "time.interval=frame"),
    ):
        refused = oppload(*words, *more)
        assert refused.returncode == 2
        assert "is a result with other settings or of another input; choose" in refused.stderr
    (tmp_path / "other").mkdir()
    other = tmp_path / "other" / "clip3.avi"
    other.write_bytes((clips / "clip4.avi").read_bytes())
    refused = oppload(words[0], other, *words[2:])
    assert (refused.returncode, "or of another input" in refused.stderr) == (2, True)


def test_a_batch_says_who_alarmed_and_lists_the_alarms(clips: Path, tmp_path: Path) -> None:
    two = (clips / "clip3.avi", clips / "clip4.avi")
    floor = ("--model", "dlgmd", "--set", "alarm.dlgmd_floor=0", "--set", "alarm.blind_s=0")
    words = ("run", *two, "-o", tmp_path, "-j", "1", *FAST, *floor, "--set", "alarm.factor=0.5")
    done = oppload(*words)
    assert done.returncode == 0, done.stderr
    rows = rows_of(tmp_path / "alarms.csv")
    alarmed = {row["video"] for row in rows}
    assert f"{len(alarmed)} of 2 inputs had an alarm" in done.stderr
    assert {row["model"] for row in rows} <= {"dlgmd"}
    kept = oppload(*words, "--if-exists", "skip")
    assert f"{len(alarmed)} of 2 inputs had an alarm" in kept.stderr
    assert rows_of(tmp_path / "alarms.csv") == rows


def test_the_table_marks_peaks_that_did_not_count() -> None:
    weak, strong = (
        {"start_frame": 3, "start_s": 0.1, "end_s": 0.2, "peak_over_threshold": peak}
        for peak in (2.0, 50.0)
    )
    rows: dict[str, tuple[list[Any], float | None, str]] = {
        "none": ([], 0.5, "- 0.5 x"),
        "silent": ([], 50.0, "- 50 x*"),
        "within": ([weak, strong], 50.0, "0.10 s 50 x"),
        "before": ([weak], 2444.0, "0.10 s 2444 x*"),
        "off": ([], None, "- -"),
    }
    table = AlarmTable(rows, ["opplod"])
    assert list(table.legend()) == []
    for name, (alarms, peak, cells) in rows.items():
        verdicts = verdicts_in({"alarms": {"opplod": {"alarms": alarms, "peak": peak}}})
        row = list(table.lines(name, Outcome(frames=10, wall_s=1.0, verdicts=verdicts)))[-1]
        assert " ".join(row.split()) == f"{name} {cells} 10"
        assert len(list(table.legend())) == (1 if name == "none" else 2)
    meaning, star = table.legend()
    assert meaning == "peak: largest response of the input, as a multiple of its threshold (x)"
    assert star.startswith("*: a peak which did not count: it came at the start, a cut, a flash")


def test_the_header_stands_above_short_names_too() -> None:
    _, header, row = AlarmTable(["a"], ["opplod"]).lines("a", Outcome(frames=10, wall_s=1.0))
    assert (row[0], row[header.index("frames/s") :]) == ("a", "10")


def test_a_name_that_is_escaped_keeps_its_row_in_line() -> None:
    table = AlarmTable(["plain", "\udcff"], ["opplod"])
    rows = [list(table.lines(name, Outcome(frames=10)))[-1] for name in ("plain", "\udcff")]
    assert [printable(row) for row in rows] == rows
    assert len(set(map(len, rows))) == 1


@pytest.mark.parametrize(
    ("if_exists", "advice"),
    [
        ("error", "go on with --if-exists skip"),
        ("overwrite", "the same command begins again; --if-exists skip keeps older results too"),
    ],
)
def test_the_advice_after_an_interruption_suits_the_command(
    if_exists: str, advice: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*_arguments: object, **_options: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("oppload_cli.cli.running.run_tasks", interrupted)
    for name in ("a.avi", "b.avi"):
        (tmp_path / name).touch()
    done = oppload("run", tmp_path, "-o", tmp_path, "--if-exists", if_exists)
    assert done.returncode == 130
    assert f"interrupted: 0 of 2 inputs are finished; {advice}\n" in done.stderr


@pytest.mark.parametrize("live", [1, 2])
def test_live_inputs_are_finished_when_the_user_stops_them(
    live: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All their files are written then; so they count, and have a row like other inputs."""
    stopped: list[object] = []

    def run_task(task: object, **_options: object) -> None:
        stopped.append(task)
        raise Interrupted("", Outcome(frames=7))

    def stop_if_asked() -> None:
        if len(stopped) == live:
            raise KeyboardInterrupt

    monkeypatch.setattr(tasks, "run_task", run_task)
    monkeypatch.setattr(tasks, "stop_if_asked", stop_if_asked)
    for name in ("a.avi", "b.avi"):
        (tmp_path / name).touch()
    done = oppload("run", tmp_path, "-o", tmp_path, "-j", "1")
    advice = "" if live == 2 else "; go on with --if-exists skip"
    assert done.returncode == 130
    assert f"done {live:>17} {live * 7:>13}\n" in done.stderr
    assert f"interrupted: {live} of 2 inputs are finished{advice}\n" in done.stderr


def test_live_inputs_that_would_wait_for_ever_are_announced(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr("oppload_cli.cli.running.run_tasks", lambda *_tasks, **_options: None)
    live = ("camera:0", "udp://127.0.0.1:1")
    for names, jobs, waits in ((live, 1, True), (live, 2, False), (("a.avi", "b.avi"), 1, False)):
        done = oppload("run", *names, "-o", tmp_path, "-j", str(jobs))
        advice = "1 of 2 inputs run at once, and a camera or a stream may never end; give --jobs 2"
        assert (advice in done.stderr) == waits


@pytest.mark.long
def test_of_many_detectors_each_has_a_row(tmp_path: Path) -> None:
    for name in ("a.avi", "b.avi"):
        write_video(tmp_path / name, grey_frames(6))
    four = ["opplod", "dlgmd", "frame_difference", "area_growth"]
    words = ("run", tmp_path, "-o", tmp_path, "-j", "1", "--model", ",".join(four), *FAST)
    floor = ("--set", "alarm.frame_difference_floor=1e-9", "--set", "alarm.blind_s=0")
    lines = oppload(*words, *floor).stderr.splitlines()
    labels = ["OppLoD", "D-LGMD", "frame difference", "area growth"]
    assert lines[0].split() == ["input", "detector", "first", "alarm", "peak", "frames/s"]
    for first, name in ((1, "a"), (5, "b")):
        rows = lines[first : first + 4]
        assert [row[7:33].strip() for row in rows] == labels
        assert [row[:7].strip() for row in rows] == [name, "", "", ""]
        assert [row[56:].isdigit() for row in rows] == [True, False, False, False]  # frames/s
    counted = f"2 of 2 inputs had an alarm; all alarms: {tmp_path / 'alarms.csv'}"
    assert lines[lines.index(counted) + 1] == f"  {'frame difference':<26}2"
    off = oppload(*words, "--set", "alarm.on=false", "--if-exists", "overwrite").stderr
    said = "oppload: no alarm of opplod, dlgmd, frame_difference, area_growth: alarm.on is false\n"
    assert off.startswith(said)
    assert off.splitlines()[1].split() == ["input", "frames/s"]
    assert not any(word in off for word in ("had an alarm", "peak", "OppLoD"))


@pytest.mark.long
def test_remarks_on_frame_rates_belong_to_every_batch(tmp_path: Path) -> None:
    slow = write_video(tmp_path / "slow0.avi", grey_frames(8), rate=5)
    for number in range(1, 12):
        shutil.copy(slow, tmp_path / f"slow{number}.avi")
    write_video(tmp_path / "usual.avi", grey_frames(40))
    words = ("run", tmp_path, "-o", tmp_path / "out", "-j", "1", "--if-exists", "overwrite", *FAST)
    remark = "oppload: {}: 5 frames/s are too few for the models"
    for more, told, others in (((), 10, 1), (("-v",), 12, 0), (("-q",), 0, 0)):
        said = oppload(*words, "--model", "dlgmd", *more).stderr
        assert said.count("5 frames/s are too few") == told
        assert said.count("2 more inputs have remarks such as those above") == others
        assert (remark.format(slow) in said) == bool(told)
        assert "usual.avi: " not in said


def test_an_end_before_the_start_is_refused_before_anything_is_read(tmp_path: Path) -> None:
    for start, end in (("5", "4"), ("f5", "f5"), ("00:00:05", "0")):
        done = oppload("run", tmp_path / "any.mp4", "--start", start, "--end", end)
        assert done.returncode == 2
        assert f"--end {end} is not after --start {start}; give a later end" in done.stderr
    done = oppload("run", tmp_path / "any.mp4", "--start", "f5", "--end", "4")
    assert done.returncode == 3  # of the missing file: --start and --end were not refused
