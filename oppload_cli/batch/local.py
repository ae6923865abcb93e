"""The tasks of a batch, done on this machine: one after the other, or in several processes."""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace
from typing import TYPE_CHECKING, Protocol

from oppload_cli.batch.plan import Failure
from oppload_cli.errors import ExitCode, OpploadError, shortage
from oppload_cli.pipeline.execute import run_task
from oppload_cli.processes import cores
from oppload_cli.processes.pool import TELL_EVERY_S, Kind, Seldom, ended_from_outside, events

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from oppload_cli.pipeline.task import Outcome, Task, Watcher
    from oppload_cli.results.table import FrameRecord
    from oppload_cli.video.source import Video


class Observer(Protocol):
    """An object that is told of the progress of a batch."""

    def started(self, name: str) -> None:
        """Take note that an input is begun."""

    def frames(self, count: int) -> None:
        """Take note that more frames are analysed."""

    def ended(self, task: Task, result: Outcome | Failure) -> None:
        """Take note that an input is done, or has failed."""


def jobs_for(wanted: int, inputs: int) -> int:
    """Return how many processes to start, from 1 to the number of inputs.

    Parameters
    ----------
    wanted : int
        The user's choice; 0 means the cores that the affinity mask allows.
    inputs : int
        How many inputs the batch has.
    """
    return max(1, min(wanted or cores(), inputs))


def run_here(tasks: Iterable[Task], observer: Observer) -> None:
    """Do one task after the other in this process.

    Raises
    ------
    Interrupted
        If the user stops it.
    """
    for task in tasks:
        observer.started(task.name)
        observer.ended(task, _counted(task, observer.frames))


def run_in_processes(tasks: Iterable[Task], jobs: int, observer: Observer) -> None:
    """Do several tasks at a time, each in a process.

    Parameters
    ----------
    tasks : iterable of Task
        Taken as they are needed.
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
    limited = (replace(task, threads=threads) for task in tasks)
    with closing(events(_counted, limited, jobs, threads=threads)) as happening:
        for kind, task, content in happening:
            if kind is Kind.BEGUN:
                observer.started(task.name)
            elif kind is Kind.TOLD:
                observer.frames(content)
            elif kind is Kind.DONE:
                observer.ended(task, content)
            elif kind is Kind.DIED:
                how = f"the process that analysed it was {ended_from_outside(content)}"
                observer.ended(task, failed(task, f"{task.name}: {how}"))
            else:
                raise content


def attempt(task: Task, watcher: Watcher | None = None) -> Outcome | Failure:
    """Do one task; an error of its input is returned, not raised."""
    try:
        return run_task(task, watcher)
    except OpploadError as error:
        return failed(task, str(error), error.exit_code)
    except Exception as error:  # a bug met in one input spares the others
        short = shortage(error)
        if short:
            return failed(task, f"{task.name}: {short}", ExitCode.NOTHING_READ)
        return failed(
            task,
            f"{task.name}: this is a bug ({type(error).__name__}: {error}); please report it "
            f"with the output of 'oppload run' on this input alone",
            ExitCode.BUG,
        )


def failed(task: Task, message: str, code: int = ExitCode.USAGE) -> Failure:
    """Return the failure of a task: one sentence, and the exit code that it has alone."""
    return Failure(task.name, task.stem, code, message)


class Counting:
    """A watcher of one task that passes on how many frames are analysed.

    Parameters
    ----------
    tell : callable
        Called with a number of frames; an error that it raises ends the task.
    every_s : float
        Seconds between two calls, at least.
    """

    def __init__(self, tell: Callable[[int], object], every_s: float = TELL_EVERY_S) -> None:
        self._count = Seldom(tell, every_s)

    def opened(self, video: Video) -> None:
        """Do nothing: a batch shows inputs, not their sizes."""

    def frame(self, _record: FrameRecord) -> None:
        """Count a frame."""
        self._count(1)

    def flush(self) -> None:
        """Pass on the frames that are not yet passed on."""
        self._count.flush()


def _counted(task: Task, tell: Callable[[int], object]) -> Outcome | Failure:
    watcher = Counting(tell)
    result = attempt(task, watcher)
    watcher.flush()
    return result
