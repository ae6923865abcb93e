"""A real scheduler and real workers, on loopback only."""

from __future__ import annotations

import importlib.util
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest

from oppload_cli.batch import tasks
from oppload_cli.errors import ParameterError
from oppload_cli.pipeline.settings import resolve
from oppload_cli.pipeline.task import Outcome, Outputs, Task
from oppload_cli.processes import threads
from oppload_cli.version import __version__
from tests.cli.process import oppload, start, wait_for_rows
from tests.cli.test_batch import FAST, sidecars, tables
from tests.cli.test_load import DETECTOR
from tests.media import grey_frames, write_film, write_video

if TYPE_CHECKING:
    from collections.abc import Iterator

if importlib.util.find_spec("distributed") is None:
    pytest.skip(
        "NOT TESTED: dask.distributed is missing; pip install 'oppload[distributed]'",
        allow_module_level=True,
    )

LOOPBACK = ("--host", "127.0.0.1", "--no-dashboard")


@contextmanager
def process(module: str, *words: str | Path, path: Path | None = None) -> Iterator[Any]:
    """Run a program of dask, which looks for modules in `path` first."""
    places = [str(path)] if path else []
    places += [os.environ.get("PYTHONPATH", ""), str(Path(__file__).parents[2])]
    run = subprocess.Popen(
        [sys.executable, "-m", f"distributed.cli.{module}", *map(str, words)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, places))},
        cwd=path,  # Python looks for modules there first
    )
    try:
        yield run
    finally:
        run.kill()
        run.wait()


@contextmanager
def scheduler(folder: Path) -> Iterator[Path]:
    """Start a scheduler; yield its scheduler file."""
    file = folder / "scheduler.json"
    with process("dask_scheduler", *LOOPBACK, "--port", "0", "--scheduler-file", file):
        for _ in range(600):
            if file.exists() and file.stat().st_size:
                break
            time.sleep(0.05)
        yield file


@pytest.fixture(scope="module")
def shared_scheduler(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """For tests that take their workers away with them."""
    with scheduler(tmp_path_factory.mktemp("scheduler")) as file:
        yield file


def worker(file: Path, folder: Path, path: Path | None = None) -> Any:
    words = ("--scheduler-file", file, *LOOPBACK, "--nthreads", "1", "--no-nanny")
    return process("dask_worker", *words, "--local-directory", folder, path=path)


@pytest.fixture(scope="module")
def ten(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Ten videos, and a file that is no video."""
    folder = tmp_path_factory.mktemp("ten")
    for number in range(10):
        write_video(folder / f"clip{number:02d}.avi", grey_frames(10, seed=number))
    (folder / "text.avi").write_text("not a video")
    return folder


@pytest.mark.long
def test_a_worker_that_is_killed_costs_no_result(
    ten: Path, shared_scheduler: Path, tmp_path: Path
) -> None:
    """With a detector of the user's own, which the workers load when they get a task."""
    alone, out, own = tmp_path / "alone", tmp_path / "out", tmp_path / "own.py"
    own.write_text(DETECTOR)
    named = ("--load", own, "run", ten, "--model", "opplod,darkening", *FAST, "-o")
    assert oppload(*named, alone).returncode == 4
    with ExitStack() as stack:
        workers = [stack.enter_context(worker(shared_scheduler, tmp_path)) for _ in range(2)]
        run = start(*named, out, "--scheduler", shared_scheduler)
        while run.poll() is None and len(list(out.glob("*.oppload.json"))) < 2:
            time.sleep(0.01)
        workers[0].kill()
        said = run.communicate(timeout=100)[1]
    assert run.returncode == 4, said
    assert said.count("text.avi: not a video that can be read") == 1
    notes = [line for line in said.splitlines() if "frames/s;" not in line]
    assert "failed               1" in said, notes
    assert len(tables(out)) == 10
    assert tables(out) == tables(alone)
    assert sidecars(out) == sidecars(alone)
    assert not list(out.glob("*.part"))


def test_waiting_for_workers_answers_an_interruption(monkeypatch: pytest.MonkeyPatch) -> None:
    came = threading.Event()

    class Client:
        def wait_for_workers(self, _count: int, timeout: float) -> None:
            came.wait(timeout)

    def interrupt() -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(threads, "stop_if_asked", interrupt)
    with pytest.raises(KeyboardInterrupt):
        tasks._check_workers(Client(), "tcp://127.0.0.1:1")
    came.set()


@dataclass
class Answering:
    """A client whose scheduler and worker answer so when they are asked for their version."""

    scheduler: str | Exception = __version__
    worker: str | Exception = __version__

    def wait_for_workers(self, _count: int, timeout: float) -> None:
        pass

    def run(self, *_asked: object, **_options: object) -> dict[str, str | Exception]:
        return {"tcp://b:2": self.worker}

    def run_on_scheduler(self, *_asked: object) -> str:
        if isinstance(self.scheduler, Exception):
            raise self.scheduler
        return self.scheduler


@pytest.mark.parametrize(
    ("client", "sentence"),
    [
        (
            Answering(scheduler=ModuleNotFoundError("oppload_cli")),
            "--scheduler tcp://a:1: has no oppload; install ",
        ),
        (Answering(worker="9.9.9"), "worker tcp://b:2: has oppload 9.9.9, not "),
        (Answering(worker=ModuleNotFoundError("oppload_cli")), "worker tcp://b:2: has no oppload;"),
        (Answering(worker=OSError(5, "Broken")), "worker tcp://b:2: does not answer (broken); "),
    ],
)
def test_a_cluster_with_another_version_or_none(client: Answering, sentence: str) -> None:
    tasks._check_workers(Answering(), "tcp://a:1")
    with pytest.raises(ParameterError, match="^" + re.escape(sentence)):
        tasks._check_workers(client, "tcp://a:1")


def test_more_existing_results_than_the_scheduler_takes_tasks_end_no_batch(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Before, the inputs after them were neither run nor counted."""
    monkeypatch.setattr(tasks, "_MOST_SUBMITTED", 1)
    (tmp_path / "b.frames.csv").touch()
    settings = resolve(models=["dlgmd"])
    listed = [
        Task(name, settings, Outputs.of(tmp_path, name, ["dlgmd"])) for name in ("a", "b", "c")
    ]
    ended: list[str] = []
    observer: Any = SimpleNamespace(ended=lambda task, _result: ended.append(task.name))

    def submit(*_arguments: object, key: str, **_options: object) -> SimpleNamespace:
        future = SimpleNamespace(key=key, status="finished", result=Outcome)
        future.add_done_callback = lambda call: call(future)
        return future

    client = SimpleNamespace(
        submit=submit, subscribe_topic=lambda *_: None, unsubscribe_topic=lambda *_: None
    )
    tasks._ClusterRun(client, iter(listed), observer).run()
    assert ended == ["a", "b", "c"]


@pytest.mark.slow
def test_an_interrupt_stops_the_tasks_on_the_workers(tmp_path: Path) -> None:
    film, out = tmp_path / "film.avi", tmp_path / "out"
    write_film(film)
    part = out / "film.frames.csv.part"
    with ExitStack() as stack:
        file = stack.enter_context(scheduler(tmp_path))
        stack.enter_context(worker(file, tmp_path))
        run = start("run", film, "-o", out, "--scheduler", file)
        wait_for_rows(run, part)
        run.send_signal(signal.SIGINT)
        said = run.communicate(timeout=120)[1]
        rows = part.stat().st_size
        time.sleep(1.5)
        assert part.stat().st_size == rows
    assert run.returncode == 130
    assert said.count("Traceback") == 0
    assert "interrupted: 0 of 1 inputs are finished; go on with --if-exists skip" in said
    assert rows > 400


@pytest.mark.slow
@pytest.mark.parametrize("how", ["stopped", "killed"])
def test_a_scheduler_that_ends_under_way(tmp_path: Path, how: str) -> None:
    film, out = tmp_path / "film.avi", tmp_path / "out"
    write_film(film)
    part, file = out / "film.frames.csv.part", tmp_path / "scheduler.json"
    with (
        process("dask_scheduler", *LOOPBACK, "--port", "0", "--scheduler-file", file) as chief,
        worker(file, tmp_path),
    ):
        while not (file.exists() and file.stat().st_size):
            time.sleep(0.05)
        run = start("run", film, "-o", out, "--scheduler", file)
        wait_for_rows(run, part)
        if how == "killed":
            chief.kill()
        else:  # a stopped scheduler keeps its connections and does not answer
            chief.send_signal(signal.SIGSTOP)
            run.send_signal(signal.SIGINT)
        said = run.communicate(timeout=60)[1]
    assert "Traceback" not in said
    assert "Error" not in said
    if how == "killed":
        assert (run.returncode, "film.avi: was cancelled on the cluster" in said) == (2, True), said
    else:
        assert run.returncode == 130
        assert "interrupted: 0 of 1 inputs are finished; go on with --if-exists skip" in said


@pytest.mark.slow
@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        ("__version__ = '9.9.9'", "has oppload 9.9.9, not "),
        ("raise ModuleNotFoundError(__name__)", "has no oppload; install oppload "),
    ],
)
def test_a_worker_with_another_version_or_none(
    ten: Path, shared_scheduler: Path, tmp_path: Path, content: str, sentence: str
) -> None:
    package = tmp_path / "other" / "oppload_cli"
    package.mkdir(parents=True)
    (package / "__init__.py").touch()
    (package / "version.py").write_text(content)
    with worker(shared_scheduler, tmp_path, path=package.parent):
        done = oppload("run", ten, "-o", tmp_path / "out", "--scheduler", shared_scheduler)
    assert done.returncode == 2
    assert done.stderr.startswith("oppload: worker tcp://127.0.0.1:")
    assert sentence in done.stderr
    assert done.stderr.count("\n") == 1
    assert not list((tmp_path / "out").glob("*"))


@pytest.mark.slow
def test_a_scheduler_that_does_not_answer(ten: Path, tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as silent:
        address = f"tcp://127.0.0.1:{silent.getsockname()[1]}"
        done = oppload("run", ten, "-o", tmp_path, "--scheduler", address)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1), done.stderr
    assert f"--scheduler {address}: does not answer" in done.stderr
    done = oppload("run", ten, "-o", tmp_path, "--scheduler", tmp_path / "none.json")
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert "none.json: no such file; give tcp://host:port or a scheduler file" in done.stderr
    assert not list(tmp_path.iterdir())
    assert tasks.ANSWER_WITHIN_S <= 10
