"""Ctrl-C, SIGTERM and kill -9: a valid prefix, the right code, nothing left behind."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections import Counter
from contextlib import contextmanager, suppress
from random import Random
from typing import TYPE_CHECKING

import pytest

from oppload_cli.errors import OpploadError, ResultError
from oppload_cli.results.result_files import read_result
from tests.cli.inside import oppload
from tests.cli.process import ENTRY, at_terminal, shown_at, start, wait_for_rows
from tests.media import grey_frames, write_film, write_video
from tools.attack.judge import adopt_orphans, faults, prepared

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="POSIX signals")
SIZE = ("--height", "64")  # of the film
HANG_S = 120  # no run may outlive a signal by this


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A video that is longer than any test waits."""
    folder = tmp_path_factory.mktemp("film")
    return write_film(folder / "film.avi", 96, 64)


@pytest.fixture(scope="module")
def table(film: Path) -> bytes:
    """The table of an uninterrupted run on the first 100 frames."""
    done = oppload("run", film, "-o", "-", "-q", "--end", "f100", *SIZE)
    return done.stdout.encode()


@contextmanager
def started(name: str | Path, folder: Path, *more: str) -> Iterator[subprocess.Popen[str]]:
    with start("run", name, "-o", folder, *SIZE, *more) as run:
        try:
            yield run
        finally:
            run.kill()  # after success it has ended already


def rows_written(folder: Path, run: subprocess.Popen[str]) -> Path:
    """Wait until some rows are on the disk."""
    part = folder / "film.frames.csv.part"
    wait_for_rows(run, part)
    assert run.poll() is None, run.communicate()[1]
    return part


def check_prefix(part: Path, table: bytes) -> int:
    """Check that the part is the beginning of the table; return the number of its complete rows."""
    data = part.read_bytes()
    shared = min(len(data), len(table))
    assert data[:shared] == table[:shared]
    return data.count(b"\n") - 1


@pytest.mark.long
@pytest.mark.parametrize(
    "name",
    ["SIGINT", *(pytest.param(each, marks=pytest.mark.slow) for each in ("SIGTERM", "SIGKILL"))],
)
def test_the_written_rows_are_a_valid_prefix(
    film: Path, table: bytes, tmp_path: Path, name: str
) -> None:
    with started(film, tmp_path) as run:
        part = rows_written(tmp_path, run)
        time.sleep(0.05)
        run.send_signal(getattr(signal, name))
        said = run.communicate(timeout=HANG_S)[1]
    assert part.exists(), (run.returncode, said)
    rows = check_prefix(part, table)
    assert not (tmp_path / "film.frames.csv").exists()
    assert not (tmp_path / "film.oppload.json").exists()
    if name == "SIGKILL":
        assert run.returncode == -signal.SIGKILL
    else:
        assert run.returncode == 130
        assert said.strip() == f"oppload: interrupted: the first {rows} rows are in {part}"
    assert len(read_result(part).frames) == rows


CAMERA = """
import time
import cv2
import numpy as np

class Camera:
    def __init__(self, number): self.count = 0
    def read(self):
        time.sleep(0.01)
        self.count += 1
        return True, np.full((48, 64, 3), self.count % 250, np.uint8)
    def get(self, key): return 100.0
    def release(self): pass

cv2.VideoCapture = Camera
"""


@pytest.mark.long
@pytest.mark.parametrize("more", [pytest.param((), marks=pytest.mark.slow), ("--annotate",)])
def test_a_camera_ends_with_finished_files_where_it_is_stopped(
    tmp_path: Path, more: tuple[str, ...]
) -> None:
    words = ("run", "camera:0", "-o", str(tmp_path), "-q", "--height", "48", *more)
    with start(*words, code=f"{CAMERA}\n{ENTRY}") as run:
        wait_for_rows(run, tmp_path / "camera-0.frames.csv.part")
        run.send_signal(signal.SIGINT)
        said = run.communicate(timeout=HANG_S)[1]
    table = tmp_path / "camera-0.frames.csv"
    rows = table.read_text().count("\n") - 1
    assert run.returncode == 130
    assert said.strip() == f"oppload: interrupted: all {rows} rows are in {table}"
    sidecar = json.loads((tmp_path / "camera-0.oppload.json").read_text())
    assert (sidecar["decode"]["analysed"], sidecar["decode"]["complete"]) == (rows, True)
    assert len(list(tmp_path.iterdir())) == 3 + len(more)
    assert not list(tmp_path.glob("*.part"))


@pytest.mark.long
@pytest.mark.usefixtures("undrawn")
def test_a_part_is_plotted_and_a_rerun_completes_it(film: Path, tmp_path: Path) -> None:
    with started(film, tmp_path) as run:
        part = rows_written(tmp_path, run)
    assert oppload("plot", part).returncode == 0
    assert (tmp_path / "film.frames.png").exists()
    # Without --if-exists, a second run does not overwrite the part file.
    before = part.read_bytes()
    refused = oppload("run", film, "-o", tmp_path, "--end", "f30")
    assert (refused.returncode, part.read_bytes()) == (2, before)
    assert "film.frames.csv.part: exists already" in refused.stderr
    again = oppload("run", film, "-o", tmp_path, "--end", "f30", "--if-exists", "skip")
    assert again.returncode == 0
    assert "skipped" not in again.stderr
    assert json.loads((tmp_path / "film.oppload.json").read_text())["decode"]["analysed"] == 30
    assert not part.exists()
    # A result without its sidecar, as after a kill, is computed again.
    (tmp_path / "film.oppload.json").unlink()
    third = oppload("run", film, "-o", tmp_path, "--end", "f20", "--if-exists", "skip")
    assert (third.returncode, "skipped" in third.stderr) == (0, False)
    assert (tmp_path / "film.frames.csv").read_text().count("\n") == 21


@pytest.mark.slow
def test_two_runs_do_not_write_one_result(film: Path, tmp_path: Path) -> None:
    with started(film, tmp_path, "--if-exists", "overwrite") as run:
        part = rows_written(tmp_path, run)
        other = oppload("run", film, "-o", tmp_path, "--if-exists", "overwrite")
        assert other.returncode == 2
        assert "another run is writing it" in other.stderr
        assert part.exists()
        assert run.poll() is None


@pytest.mark.long
def test_an_input_that_never_answers_is_interrupted(tmp_path: Path) -> None:
    fifo = tmp_path / "never.mkv"
    os.mkfifo(fifo)
    with socket.create_server(("127.0.0.1", 0)) as server:
        address = f"http://127.0.0.1:{server.getsockname()[1]}/a.mp4"
        for name in (str(fifo), address):
            with started(name, tmp_path) as run:
                time.sleep(1)
                run.send_signal(signal.SIGINT)
                said = run.communicate(timeout=9)[1]  # the network alone would take 10 s
            assert (run.returncode, said.strip()) == (130, "oppload: interrupted")
    assert [path.name for path in tmp_path.iterdir()] == ["never.mkv"]


@pytest.mark.long
@pytest.mark.skipif(sys.platform == "win32", reason="no pseudo-terminals")
def test_the_terminal_is_left_as_it_was(film: Path, tmp_path: Path) -> None:
    import termios

    with at_terminal("run", film, "-o", tmp_path, *SIZE) as (child, terminal):
        before = termios.tcgetattr(terminal)
        part = tmp_path / "film.frames.csv.part"
        while not part.exists() or part.stat().st_size < 400:
            time.sleep(0.01)
        os.write(terminal, b"\x03")  # as the key itself does
        shown = shown_at(terminal)
        _, status = os.waitpid(child, 0)
        assert os.waitstatus_to_exitcode(status) == 130
        assert termios.tcgetattr(terminal) == before
    assert shown.endswith("\r\n")
    last = shown.rstrip().splitlines()[-1]
    assert last.startswith("oppload: interrupted: the first")
    assert "\x1b[?25l" not in shown or "\x1b[?25h" in shown  # a cursor that was hidden is back


@pytest.mark.slow
@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP", "SIGKILL"])
def test_random_moments(film: Path, table: bytes, tmp_path: Path, name: str) -> None:
    random = Random(7)  # noqa: S311
    longest, early, parts = 0.0, 0, 0
    for number in range(30):
        folder = tmp_path / str(number)
        with started(film, folder) as run:
            # Half of the signals come while the decoding process starts.
            time.sleep(random.uniform(0.05, 0.4) if number % 2 else random.uniform(0, 2.5))
            run.send_signal(getattr(signal, name))
            sent = time.monotonic()
            said = run.communicate(timeout=HANG_S)[1]
        longest = max(longest, time.monotonic() - sent)
        part = folder / "film.frames.csv.part"
        if part.exists():
            check_prefix(part, table)
            parts += 1
            try:
                read_result(part)
            except OpploadError as error:
                known = ("holds no row", "holds one row", "empty in every row", "not a CSV")
                assert any(each in str(error) for each in known), str(error)  # noqa: PT017
        if name != "SIGKILL" and run.returncode != 130:
            # Before the program's first line, Python itself handles the signal.
            assert not folder.exists(), said
            assert run.returncode in {-getattr(signal, name), 1}
            early += 1
            sys.stdout.write(f"{run.returncode}: {said[-300:]}\n")
        elif name != "SIGKILL":
            assert said.strip().count("\n") == 0, said
    sys.stdout.write(
        f"{name}: longest {longest:.2f} s, {parts} parts, {early} before the program began\n"
    )


KILLS = int(os.environ.get("KILLS", "40"))


@pytest.fixture(scope="module")
def killed_commands(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[str]]:
    """Commands that take a second or two."""
    folder = tmp_path_factory.mktemp("killed")
    frames = grey_frames(60, width=96, height=64)
    for number in range(3):
        path = folder / f"clip{number}.avi"
        write_video(path, frames * 3, codec="mpeg4", pixel_format="yuv420p")
    clips = [str(path) for path in sorted(folder.glob("*.avi"))]
    quick = ["--height", "24", "--no-rmo", "-o"]
    done = oppload("run", *clips, *quick, folder / "results")
    assert done.returncode == 0, done.stderr
    table = str(folder / "results" / "clip0.frames.csv")
    return {
        "run": ["run", clips[0], *quick, "../out"],
        "annotate": ["run", clips[0], "--annotate", *quick, "../out"],
        "batch": ["run", *clips, "--jobs", "2", *quick, "../out"],
        "plot": ["plot", table, "-o", "../out/a.png"],
        "collect": ["collect", str(folder / "results"), "--frames", "-o", "../out/all.csv"],
        "report": ["report", table, "-o", "../out"],
    }


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_kills_at_random_moments(killed_commands: dict[str, list[str]], tmp_path: Path) -> None:
    """After a kill of one process or all, a result is complete, a readable part, or absent."""
    adopt_orphans()
    random = Random(KILLS)  # noqa: S311
    states: Counter[str] = Counter()
    takes_s = dict.fromkeys(killed_commands, 0.0)
    for number in range(-len(killed_commands), KILLS):
        name = list(killed_commands)[number % len(killed_commands)]
        case = prepared("kills", number, tmp_path / str(number))
        case.words = killed_commands[name]
        if number < 0:  # undisturbed
            began = time.monotonic()
            assert faults(case)[0] == []
            takes_s[name] = time.monotonic() - began
            continue
        case.signals = [(random.uniform(0, takes_s[name]), "SIGKILL", random.random() < 0.5)]
        wrong, ended = faults(case)
        assert wrong == [], (name, case.signals, ended.stderr)
        parts = [*case.out.rglob("*.part")]
        for part in case.out.rglob("*.frames.csv.part"):
            with suppress(ResultError):  # no rows yet
                read_result(part)
        whole = len([*case.out.iterdir()]) > len(parts)
        state = (
            "ended" if ended.code == 0 else "complete" if whole else "part" if parts else "absent"
        )
        states[f"{name}: {state}"] += 1
        if parts and number % 10 == 0:  # what is left is in nobody's way
            case.signals = []
            if name not in {"plot", "report"}:
                case.words = [*case.words, "--if-exists", "overwrite"]
            assert faults(case)[0] == []
    sys.stdout.write(f"{KILLS} kills: {dict(sorted(states.items()))}\n")


@pytest.mark.slow
@pytest.mark.parametrize(
    "words",
    [
        ["stimuli", "generate", "controls/*"],
        ["tune", "klapoetke2017/bar-expand-10"],
        ["reproduce", "--only", "up-down", "--only", "diagonals"],
    ],
)
def test_random_moments_of_several_processes(tmp_path: Path, words: list[str]) -> None:
    random = Random(8)  # noqa: S311
    for number in range(40):
        folder = tmp_path / str(number)
        with subprocess.Popen(
            [sys.executable, "-c", ENTRY, *words, "--jobs", "2", "-o", str(folder)],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        ) as run:
            time.sleep(random.uniform(0.2, 2.0))
            # A terminal sends Ctrl-C to the group, another program only to the parent.
            end = random.choice([os.killpg, os.kill])
            with suppress(ProcessLookupError):
                end(run.pid, signal.SIGINT if end is os.killpg else signal.SIGTERM)
            said = run.communicate(timeout=HANG_S)[1]
        assert not list(folder.glob("**/*.part"))
        if run.returncode != 0:  # words about a result come before it where the signal is late
            assert run.returncode == 130, said
            assert said.splitlines()[-1] == "oppload: interrupted"
            assert said.count("interrupted") == 1
            assert "Traceback" not in said
