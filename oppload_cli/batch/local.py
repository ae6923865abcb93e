"""A batch on this machine: one input after the other, or several processes."""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace
from typing import TYPE_CHECKING

from oppload_cli.batch.attempt import attempt, failed
from oppload_cli.batch.counting import Counting
from oppload_cli.environment import cores
from oppload_cli.processes.events import Kind, ended_from_outside, events

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from oppload_cli.batch.attempt import Observer
    from oppload_cli.batch.plan import Failure
    from oppload_cli.task import Outcome, Task


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
        observer.ended(task, _counted(task, observer.frames))


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


def _counted(task: Task, tell: Callable[[int], object]) -> Outcome | Failure:
    watcher = Counting(tell)
    result = attempt(task, watcher)
    watcher.flush()
    return result
