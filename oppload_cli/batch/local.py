"""A batch on this machine: one input after the other, or several processes.

Each process is started afresh (spawn: a copy of one that runs decoder threads may
hang) and does one input after the other. One that dies takes only its input along.
"""

from __future__ import annotations

import multiprocessing
import signal
import time
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from multiprocessing.connection import wait
from typing import TYPE_CHECKING

from oppload_cli.batch.attempt import attempt, failed
from oppload_cli.batch.counting import Counting
from oppload_cli.batch.worker import serve
from oppload_cli.environment import cores

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from multiprocessing.connection import Connection
    from multiprocessing.context import SpawnProcess

    from oppload_cli.batch.attempt import Observer
    from oppload_cli.task import Task

STOP_WITHIN_S = 1.5  # what is left of a worker after Ctrl-C then is killed


def jobs_for(wanted: int, inputs: int) -> int:
    """Return how many processes to start.

    Parameters
    ----------
    wanted : int
        What the user asks for; 0 means the cores that the affinity mask allows.
    inputs : int
        How many inputs there are.

    Returns
    -------
    int
        At least 1, at most `inputs`.
    """
    return max(1, min(wanted or cores(), inputs))


def run_here(tasks: Iterable[Task], observer: Observer) -> None:
    """Do one task after the other in this process.

    Parameters
    ----------
    tasks : iterable of Task
        What to do.
    observer : Observer
        Told of everything.

    Raises
    ------
    Interrupted
        If the user stops it.
    """
    for task in tasks:
        observer.started(task.name)
        watcher = Counting(observer.frames)
        result = attempt(task, watcher)
        watcher.flush()
        observer.ended(task, result)


def run_in_processes(tasks: Iterable[Task], jobs: int, observer: Observer) -> None:
    """Do several tasks at a time, each in a process.

    Parameters
    ----------
    tasks : iterable of Task
        What to do; taken as they are needed.
    jobs : int
        How many at a time, at least 1.
    observer : Observer
        Told of everything.

    Raises
    ------
    KeyboardInterrupt
        If the user stops it; the processes are ended and joined first.
    """
    threads = max(1, cores() // jobs)
    crew = _Crew(iter(tasks), threads, observer)
    try:
        crew.run(jobs)
    except BaseException:
        crew.terminate()
        raise
    finally:
        crew.join()


@dataclass
class _Worker:
    """A process, the way to it, and what it does."""

    process: SpawnProcess
    connection: Connection
    task: Task


class _Crew:
    """The processes of a batch."""

    def __init__(self, tasks: Iterator[Task], threads: int, observer: Observer) -> None:
        self._tasks = tasks
        self._threads = threads
        self._observer = observer
        self._busy: dict[Connection, _Worker] = {}
        self._processes: list[SpawnProcess] = []

    def run(self, jobs: int) -> None:
        """Keep as many processes busy until every task is done."""
        for _ in range(jobs):
            self._hire()
        while self._busy:
            for connection in wait(list(self._busy), timeout=0.5):
                self._answer(self._busy[connection])  # type: ignore[index]  # they are ours

    def terminate(self) -> None:
        """Tell every process to stop; each keeps the rows that it has written."""
        for process in self._processes:
            process.terminate()

    def join(self) -> None:
        """Wait for the processes to end; what does not is killed."""
        for worker in self._busy.values():
            worker.connection.close()
        deadline = time.monotonic() + STOP_WITHIN_S
        for process in self._processes:
            process.join(max(0.0, deadline - time.monotonic()))
            if process.is_alive():
                process.kill()
                process.join()

    def _hire(self) -> None:
        task = next(self._tasks, None)
        if task is None:
            return
        context = multiprocessing.get_context("spawn")
        ours, theirs = context.Pipe()
        process = context.Process(target=serve, args=(theirs, self._threads), daemon=True)
        with interrupts_held():
            process.start()
            self._processes.append(process)
        theirs.close()  # so that its end is seen here
        self._busy[ours] = _Worker(process, ours, task)
        self._give(self._busy[ours], task)

    def _give(self, worker: _Worker, task: Task) -> None:
        worker.task = task
        self._observer.started(task.name)
        with suppress(OSError):  # it has died: its end of the pipe tells
            worker.connection.send(replace(task, threads=self._threads))

    def _answer(self, worker: _Worker) -> None:
        try:
            message = worker.connection.recv()
        except (EOFError, OSError):
            self._bury(worker)
            return
        if isinstance(message, int):
            self._observer.frames(message)
            return
        self._observer.ended(worker.task, message)
        task = next(self._tasks, None)
        if task is None:
            self._dismiss(worker)
        else:
            self._give(worker, task)

    def _dismiss(self, worker: _Worker) -> None:
        del self._busy[worker.connection]
        worker.connection.close()  # on which it ends

    def _bury(self, worker: _Worker) -> None:
        self._dismiss(worker)
        worker.process.join(STOP_WITHIN_S)
        self._processes.remove(worker.process)
        message = (
            f"{worker.task.name}: the process that analysed it was ended from outside "
            f"({_ending(worker.process.exitcode)}); check the memory, or use fewer --jobs"
        )
        self._observer.ended(worker.task, failed(worker.task, message))
        self._hire()


def _ending(code: int | None) -> str:
    if code is None or code >= 0:
        return f"exit code {code}"
    with suppress(ValueError):
        return signal.Signals(-code).name
    return f"signal {-code}"


@contextmanager
def interrupts_held() -> Iterator[None]:
    """Hold Ctrl-C back, for good in the processes started meanwhile: their starter ends them.

    Yields
    ------
    None
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGHUP})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
