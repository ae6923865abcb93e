"""Several processes, each of which does one item after the other.

Unlike in an executor of ``concurrent.futures``, a process that dies takes only its item along:
each has a pipe of its own, and nothing is shared that it could leave locked. Each is started
from scratch (spawned): a forked copy of a process that has decoder threads may hang.
"""

from __future__ import annotations

import multiprocessing
import signal
import time
import traceback
from contextlib import closing, contextmanager, suppress
from enum import Enum
from functools import partial
from itertools import islice
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar, cast

import cv2

from oppload_cli.errors import OpploadError, OutputError
from oppload_cli.processes import signals
from oppload_cli.processes.signals import POLL_S, ending, stop_if_asked

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
    from multiprocessing.context import SpawnProcess

    Tell = Callable[[Any], object]


Item = TypeVar("Item")
Result = TypeVar("Result")

_STOP_WITHIN_S = 1.5  # for so long a process may clean up after Ctrl-C; then it is killed
TELL_EVERY_S = 0.25


class Kind(Enum):
    """A kind of event."""

    BEGUN = "begun"
    TOLD = "told"
    DONE = "done"
    RAISED = "raised"
    DIED = "died"


class Event(NamedTuple):
    """An event in the life of an item.

    The content is the message told, the result, the error raised, or how the process of the item
    died and what to do about it, as the end of a sentence; None for an item that is begun.
    """

    kind: Kind
    item: Any
    content: Any = None


def events(
    function: Callable[[Item, Tell], object], items: Iterable[Item], jobs: int, *, threads: int = 1
) -> Generator[Event, None, None]:
    """Do items in processes, and yield the events; closing the generator stops the processes.

    A signal that has asked the program to stop raises KeyboardInterrupt.

    Parameters
    ----------
    function : callable
        Of a module. It takes an item and a callable that passes messages on, and returns a
        result. When the processes are stopped, its next call of
        :func:`oppload_cli.processes.signals.stop_if_asked` raises KeyboardInterrupt.
    items : iterable
        Taken as they are needed.
    jobs : int
        Number of processes, at least 1.
    threads : int
        Threads of OpenCV in each process, at least 1.

    Yields
    ------
    Event
        Of every item first `BEGUN`, then any number of `TOLD`, at last one of the others.
    """
    workers = _Workers(function, iter(items), threads)
    try:
        yield from workers.run(jobs)
    except BaseException:
        workers.terminate()
        raise
    finally:
        workers.join()


class _Workers:
    """The processes; those that are busy by their connections, each with its item."""

    def __init__(
        self, function: Callable[[Item, Tell], object], items: Iterator[Item], threads: int
    ) -> None:
        self._function, self._items, self._threads = function, items, threads
        self._busy: dict[Connection, tuple[SpawnProcess, Any]] = {}
        self._processes: list[SpawnProcess] = []

    def run(self, jobs: int) -> Iterator[Event]:
        """Keep as many processes busy until every item is done."""
        for _ in range(jobs):
            yield from self._give(None)
        while self._busy:
            stop_if_asked()
            for ready in wait(list(self._busy), timeout=POLL_S):
                yield from self._heard(cast("Connection", ready))

    def terminate(self) -> None:
        """Ask every process to stop; each keeps the rows that it has written."""
        for process in self._processes:
            process.terminate()

    def join(self) -> None:
        """Wait for the processes to end; kill those that do not."""
        for connection in self._busy:
            connection.close()
        deadline = time.monotonic() + _STOP_WITHIN_S
        for process in self._processes:
            process.join(max(0.0, deadline - time.monotonic()))
            if process.is_alive():
                process.kill()
                process.join()

    def _give(self, idle: tuple[SpawnProcess, Connection] | None) -> Iterator[Event]:
        """Give the next item, if any, to an idle process or to a new one."""
        for item in islice(self._items, 1):
            process, connection = idle or self._started()
            self._busy[connection] = process, item
            yield Event(Kind.BEGUN, item)
            with suppress(OSError):  # the process has died: its end of the pipe tells
                connection.send(item)
            return
        if idle:
            idle[1].close()  # on which the process ends

    def _started(self) -> tuple[SpawnProcess, Connection]:
        context = multiprocessing.get_context("spawn")
        ours, theirs = context.Pipe()
        arguments = (theirs, self._function, self._threads)
        process = context.Process(target=_serve, args=arguments, daemon=True)
        with _ctrl_c_held_back():
            process.start()
        self._processes.append(process)
        theirs.close()  # so that the end of the process closes the pipe
        return process, ours

    def _heard(self, connection: Connection) -> Iterator[Event]:
        process, item = self._busy[connection]
        try:
            kind, content = connection.recv()
        except (EOFError, OSError):
            del self._busy[connection]
            connection.close()
            process.join(_STOP_WITHIN_S)
            self._processes.remove(process)
            how = f"({ending(process.exitcode)}); check the memory, or use fewer --jobs"
            yield Event(Kind.DIED, item, f"ended from outside {how}")
            yield from self._give(None)
            return
        yield Event(kind, item, content)
        if kind is not Kind.TOLD:
            del self._busy[connection]
            yield from self._give((process, connection))


@contextmanager
def _ctrl_c_held_back() -> Iterator[None]:
    """Start a process in which Ctrl-C, which goes to all of a terminal, is blocked.

    A process interrupted at its start would print a traceback; the first process ends it anyway.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    held = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGHUP})
    try:
        # The tracker would start with the first process and lift the mask; Python warns if it is
        # killed.
        resource_tracker.getfd()
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, held)


def _serve(connection: Connection, function: Callable[[Any, Tell], object], threads: int) -> None:
    """Do items until the pipe is closed; runs in a process of its own."""
    signals.ignore("SIGINT", "SIGHUP")
    signals.answer("SIGTERM", again=signal.SIG_IGN)  # it is killed if it takes too long to stop
    cv2.setNumThreads(threads)
    with suppress(EOFError, KeyboardInterrupt, OSError):
        while not signals.received():
            item = connection.recv()
            try:
                answer = Kind.DONE, function(item, lambda told: connection.send((Kind.TOLD, told)))
            except Exception as error:  # raised again in the process that gave the item
                error.add_note("".join(traceback.format_exception(error)))
                answer = Kind.RAISED, error
            connection.send(answer)


def outcomes(
    function: Callable[[Item, Tell], Result],
    items: Sequence[Item],
    jobs: int,
    *,
    named: Callable[[Item], str],
    told: Tell | None = None,
) -> Generator[tuple[int, Result | OpploadError], None, None]:
    """Do items; an OpploadError of one does not stop the others, any other error does.

    Parameters
    ----------
    function, items, jobs
        As for :func:`events`; with one job, or for one item, this process does all.
    named : callable
        Returns an item's name, for errors.
    told : callable, optional
        Takes the messages that the function passes on.

    Yields
    ------
    tuple of int and Result or OpploadError
        The item's position, and its result or error; as they are done.
    """
    told = told or (lambda _message: None)
    jobs = min(jobs, len(items))
    if jobs <= 1:
        for position, item in enumerate(items):
            stop_if_asked()
            try:
                yield position, function(item, told)
            except OpploadError as error:
                yield position, error
        return
    with closing(events(partial(_numbered, function), enumerate(items), jobs)) as happening:
        for kind, (position, item), content in happening:
            if kind is Kind.TOLD:
                told(content)
            elif kind is Kind.DIED:
                yield position, OutputError(f"{named(item)}: its process was {content}")
            elif kind is Kind.DONE or isinstance(content, OpploadError):
                yield position, content
            elif kind is Kind.RAISED:
                raise content


def results(
    function: Callable[[Item], Result],
    items: Sequence[Item],
    jobs: int,
    *,
    named: Callable[[Item], str],
    progress: Callable[[Result], object] | None = None,
) -> list[Result]:
    """Return the results of items, in their order, or raise the first error.

    Parameters
    ----------
    function : callable
        Of a module; takes an item, returns a result.
    items, jobs, named
        As for :func:`outcomes`.
    progress : callable, optional
        Takes each result as it comes.
    """
    done: dict[int, Result] = {}
    with closing(outcomes(partial(_silent, function), items, jobs, named=named)) as coming:
        for position, outcome in coming:
            if isinstance(outcome, OpploadError):
                raise outcome
            done[position] = outcome
            if progress:
                progress(outcome)
    return [done[position] for position in range(len(items))]


def _numbered(
    function: Callable[[Item, Tell], Result], numbered: tuple[int, Item], tell: Tell
) -> Result:
    return function(numbered[1], tell)


def _silent(function: Callable[[Item], Result], item: Item, _tell: Tell) -> Result:
    return function(item)


class Seldom:
    """A count that is passed on now and then: each message costs both processes time.

    `tell` takes the count since its last call, at most once in `every_s` seconds. Each call also
    asks whether a signal has come, and raises KeyboardInterrupt then.
    """

    def __init__(self, tell: Callable[[int], object], every_s: float = TELL_EVERY_S) -> None:
        self._tell, self._every_s = tell, every_s
        self._count = 0
        self._next = time.monotonic() + every_s

    def __call__(self, count: int) -> None:
        """Add to the count, and pass it on if it is time to."""
        stop_if_asked()
        self._count += count
        if time.monotonic() >= self._next:
            self.flush()

    def flush(self) -> None:
        """Pass on the rest of the count."""
        if self._count:
            self._tell(self._count)
        self._count = 0
        self._next = time.monotonic() + self._every_s
