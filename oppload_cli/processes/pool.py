"""Processes that call a function for many items, each for one item after the other.

If a process dies, only its item is lost, unlike in an executor of ``concurrent.futures``: each
process has its own pipe, and shares no lock with the others. The processes are spawned, since a
forked copy of a process with decoder threads may hang.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import time
import traceback
from contextlib import closing, contextmanager, suppress
from enum import Enum
from functools import partial
from itertools import islice
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from threading import Thread
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

_STOP_WITHIN_S = 1.5  # time that a process has to clean up after Ctrl-C before it is killed
TELL_EVERY_S = 0.25  # time between two messages of a `Seldom`


class Kind(Enum):
    """A kind of event."""

    BEGUN = "begun"
    MESSAGE = "message"
    DONE = "done"
    RAISED = "raised"
    DIED = "died"


class Event(NamedTuple):
    """An event of an item.

    The content is, by kind, the message (`MESSAGE`), the result (`DONE`), the error (`RAISED`),
    or the cause of the process's death with a remedy, as the end of a sentence (`DIED`).
    """

    kind: Kind
    item: Any
    content: Any = None


def events(
    function: Callable[[Item, Tell], object], items: Iterable[Item], jobs: int, *, threads: int = 1
) -> Generator[Event, None, None]:
    """Call a function for items in processes; closing the generator stops the processes.

    Parameters
    ----------
    function : callable
        A function of a module. It takes an item and a callable that sends messages, and returns a
        result. When the processes are stopped, its next call of
        :func:`oppload_cli.processes.signals.stop_if_asked` raises KeyboardInterrupt.
    items : iterable
        The items; one is taken when a process is free.
    jobs : int
        Number of processes, at least 1.
    threads : int
        Threads of OpenCV in each process, at least 1.

    Yields
    ------
    Event
        For every item first `BEGUN`, then any number of `MESSAGE`, at last one of the other kinds.

    Raises
    ------
    KeyboardInterrupt
        If a signal has asked the program to stop. Results that the processes still send come first.
    """
    workers = _Workers(function, iter(items), threads)
    try:
        yield from workers.run(jobs)
    except KeyboardInterrupt:
        workers.terminate()
        yield from workers.last_results()
        raise
    except BaseException:
        workers.terminate()
        raise
    finally:
        workers.join()


class _Workers:
    """The processes of :func:`events`."""

    def __init__(
        self, function: Callable[[Item, Tell], object], items: Iterator[Item], threads: int
    ) -> None:
        self._function, self._items, self._threads = function, items, threads
        self._busy: dict[Connection, tuple[SpawnProcess, Any]] = {}  # process and item by pipe
        self._processes: list[SpawnProcess] = []

    def run(self, jobs: int) -> Iterator[Event]:
        """Keep `jobs` processes busy until every item is done."""
        for _ in range(jobs):
            yield from self._give(None)
        while self._busy:
            stop_if_asked()
            for ready in wait(list(self._busy), timeout=POLL_S):
                yield from self._events_from(cast("Connection", ready))

    def terminate(self) -> None:
        for process in self._processes:
            process.terminate()

    def last_results(self) -> Iterator[Event]:
        """Yield results of processes that were asked to stop: a live input ends well by it."""
        self._items = iter(())
        deadline = time.monotonic() + _STOP_WITHIN_S
        while self._busy and (remaining_s := deadline - time.monotonic()) > 0:
            for ready in wait(list(self._busy), remaining_s):
                its_events = self._events_from(cast("Connection", ready))
                yield from (event for event in its_events if event.kind is Kind.DONE)

    def join(self) -> None:
        """Wait for the end of the processes; kill those that are too slow."""
        for connection in self._busy:
            connection.close()
        deadline = time.monotonic() + _STOP_WITHIN_S
        for process in self._processes:
            process.join(max(0.0, deadline - time.monotonic()))
            if process.is_alive():
                process.kill()
                process.join()

    def _give(self, idle: tuple[SpawnProcess, Connection] | None) -> Iterator[Event]:
        """Give the next item, if any, to an idle process, or to a new one if `idle` is None."""
        for item in islice(self._items, 1):
            process, connection = idle or self._started()
            self._busy[connection] = process, item
            yield Event(Kind.BEGUN, item)
            with suppress(OSError):  # the process has died, which `_events_from` finds out
                connection.send(item)
            return
        if idle:
            idle[1].close()  # which ends the process

    def _started(self) -> tuple[SpawnProcess, Connection]:
        context = multiprocessing.get_context("spawn")
        ours, theirs = context.Pipe()
        arguments = (theirs, self._function, self._threads)
        process = context.Process(target=_serve, args=arguments, daemon=True)
        with _ctrl_c_held_back():
            process.start()
        self._processes.append(process)
        theirs.close()  # only the process holds this end then: the pipe closes when it ends
        return process, ours

    def _events_from(self, connection: Connection) -> Iterator[Event]:
        process, item = self._busy[connection]
        try:
            kind, content = connection.recv()
        except (EOFError, OSError):
            del self._busy[connection]
            connection.close()
            process.join(_STOP_WITHIN_S)
            self._processes.remove(process)
            cause = f"({ending(process.exitcode)}); check the memory, or use fewer --jobs"
            yield Event(Kind.DIED, item, f"ended from outside {cause}")
            yield from self._give(None)
            return
        yield Event(kind, item, content)
        if kind is not Kind.MESSAGE:
            del self._busy[connection]
            yield from self._give((process, connection))


@contextmanager
def _ctrl_c_held_back() -> Iterator[None]:
    """Block Ctrl-C, which a terminal sends to all processes, in a process that starts within.

    A process that is interrupted at its start prints a traceback. The main process stops it anyway.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    former_mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGHUP})
    try:
        # Otherwise Python's tracker of resources starts with the first process, and unblocks the
        # signals. If SIGHUP kills the tracker, Python prints a warning.
        resource_tracker.getfd()
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, former_mask)


def _serve(connection: Connection, function: Callable[[Any, Tell], object], threads: int) -> None:
    """Receive items and send their results until the pipe is closed: the main function."""
    signals.ignore("SIGINT", "SIGHUP")
    signals.handle("SIGTERM", again=signal.SIG_IGN)  # `join` kills a process that stops too slowly
    with suppress(RuntimeError):  # the system allows no further thread
        Thread(target=_end_with_parent, name="oppload-parent", daemon=True).start()
    cv2.setNumThreads(threads)
    with suppress(EOFError, KeyboardInterrupt, OSError):
        while not signals.received():
            item = connection.recv()
            try:
                result = function(item, lambda data: connection.send((Kind.MESSAGE, data)))
                event = Kind.DONE, result
            except Exception as error:  # the main process raises it
                error.add_note("".join(traceback.format_exception(error)))
                event = Kind.RAISED, error
            connection.send(event)


def _end_with_parent() -> None:
    """End this process if the main process is killed: it may wait for a pipe for ever."""
    if parent := multiprocessing.parent_process():
        parent.join()
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(_STOP_WITHIN_S)
        os._exit(1)


def outcomes(
    function: Callable[[Item, Tell], Result],
    items: Sequence[Item],
    jobs: int,
    *,
    named: Callable[[Item], str],
    on_message: Tell | None = None,
) -> Generator[tuple[int, Result | OpploadError], None, None]:
    """Call a function for items in processes; an OpploadError of an item does not stop the others.

    Parameters
    ----------
    function, items, jobs
        As for :func:`events`. With one job or one item, this process calls the function.
    named : callable
        Returns an item's name, for errors.
    on_message : callable, optional
        Receives the messages that the function sends.

    Yields
    ------
    tuple of int and Result or OpploadError
        The position of an item, and its result or error, when the item is done.
    """
    on_message = on_message or (lambda _: None)
    jobs = min(jobs, len(items))
    if jobs <= 1:
        for position, item in enumerate(items):
            stop_if_asked()
            try:
                yield position, function(item, on_message)
            except OpploadError as error:
                yield position, error
        return
    with closing(events(partial(_numbered, function), enumerate(items), jobs)) as happening:
        for kind, (position, item), content in happening:
            if kind is Kind.MESSAGE:
                on_message(content)
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
    """Return the results of items in their order, as :func:`outcomes`, or raise the first error.

    The function takes only an item. `progress` receives each result when it is done.
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
    """A counter that sends its count now and then, since each message costs time.

    Its calls add to the count, and raise KeyboardInterrupt if a signal has asked the program to
    stop. At most once in `every_s` seconds, `tell` receives the count since its last call.
    """

    def __init__(self, tell: Callable[[int], object], every_s: float = TELL_EVERY_S) -> None:
        self._tell, self._every_s = tell, every_s
        self._count = 0
        self._next = time.monotonic() + every_s

    def __call__(self, count: int) -> None:
        """Add to the count."""
        stop_if_asked()
        self._count += count
        if time.monotonic() >= self._next:
            self.flush()

    def flush(self) -> None:
        """Send the rest of the count."""
        if self._count:
            self._tell(self._count)
        self._count = 0
        self._next = time.monotonic() + self._every_s
