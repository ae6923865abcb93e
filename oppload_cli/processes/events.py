"""What happens in several processes that do one item after the other.

Each is started afresh (spawn: a copy of one that runs decoder threads may hang), has a
pipe of its own and does one item after the other. One that dies takes only its item
along, and nothing is shared that it could leave locked or half-read.
"""

from __future__ import annotations

import multiprocessing
import signal
import time
import traceback
from contextlib import suppress
from enum import Enum
from multiprocessing import resource_tracker
from multiprocessing.connection import wait
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

from oppload_cli import interruption
from oppload_cli.interruption import undisturbed
from oppload_cli.processes.endings import ending

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterable, Iterator
    from multiprocessing.connection import Connection
    from multiprocessing.context import SpawnProcess

    Tell = Callable[[Any], object]

STOP_WITHIN_S = 1.5  # what is left of a process after Ctrl-C then is killed

Item = TypeVar("Item")


class Kind(Enum):
    """What can happen to an item."""

    BEGUN = "begun"
    TOLD = "told"
    DONE = "done"
    RAISED = "raised"
    DIED = "died"


class Event(NamedTuple):
    """What happened to an item.

    Attributes
    ----------
    kind : Kind
        What it was.
    item : object
        The item.
    content : object
        What was told, the result, the error raised, or how the process ended, for
        instance ``SIGKILL``; None for one that is begun.
    """

    kind: Kind
    item: Any
    content: Any = None


def events(
    function: Callable[[Item, Tell], object], items: Iterable[Item], jobs: int, *, threads: int = 1
) -> Generator[Event, None, None]:
    """Do items in processes, and yield what happens; closing it stops them.

    Parameters
    ----------
    function : callable
        Of a module; takes an item and a callable that passes on whatever it is given,
        returns a result. Stopped, it meets a KeyboardInterrupt.
    items : iterable
        What is to be done; taken as they are needed.
    jobs : int
        Processes, at least 1.
    threads : int
        Of OpenCV in each process, at least 1.

    Yields
    ------
    Event
        Of every item one that is begun, and at last one of another kind than told.
    """
    crew = _Crew(function, iter(items), threads)
    try:
        yield from crew.run(jobs)
    except BaseException:
        crew.terminate()
        raise
    finally:
        crew.join()


def ended_from_outside(ending: str) -> str:
    """Say that a process was ended, and what to do about it.

    Parameters
    ----------
    ending : str
        How: the content of the event.

    Returns
    -------
    str
        The end of a sentence.
    """
    return f"ended from outside ({ending}); check the memory, or use fewer --jobs"


class _Worker(NamedTuple):
    """A process, the way to it, and what it does."""

    process: SpawnProcess
    connection: Connection
    item: Any


class _Crew:
    """The processes, and what each of them does."""

    def __init__(
        self, function: Callable[[Item, Tell], object], items: Iterator[Item], threads: int
    ) -> None:
        self._function = function
        self._items = items
        self._threads = threads
        self._busy: dict[Connection, _Worker] = {}
        self._processes: list[SpawnProcess] = []

    def run(self, jobs: int) -> Iterator[Event]:
        """Keep as many processes busy until every item is done."""
        for _ in range(jobs):
            yield from self._hire()
        while self._busy:
            for connection in wait(list(self._busy), timeout=0.5):
                yield from self._answer(self._busy[connection])  # type: ignore[index]  # ours

    def terminate(self) -> None:
        """Tell every process to stop; each keeps the rows that it has written."""
        for process in self._processes:
            process.terminate()

    def join(self) -> None:
        """Wait for the processes to end; what does not is killed."""
        for connection in self._busy:
            connection.close()
        deadline = time.monotonic() + STOP_WITHIN_S
        for process in self._processes:
            process.join(max(0.0, deadline - time.monotonic()))
            if process.is_alive():
                process.kill()
                process.join()

    def _hire(self) -> Iterator[Event]:
        for item in self._items:
            context = multiprocessing.get_context("spawn")
            ours, theirs = context.Pipe()
            words = (theirs, self._function, self._threads)
            process = context.Process(target=_serve, args=words, daemon=True)
            self._start(process)
            theirs.close()  # so that its end is seen here
            yield from self._give(process, ours, item)
            return

    @undisturbed
    def _start(self, process: SpawnProcess) -> None:
        """Start a process; Ctrl-C, which goes to all of a terminal, is held back in it for good.

        One cut short at its start would print a traceback, and who started it ends it anyhow.
        """
        held = set()
        if hasattr(signal, "pthread_sigmask"):
            resource_tracker.getfd()  # its own start, by the first process, lets signals through
            held = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGHUP})
        try:
            process.start()
            self._processes.append(process)
        finally:
            if hasattr(signal, "pthread_sigmask"):
                signal.pthread_sigmask(signal.SIG_SETMASK, held)

    def _give(self, process: SpawnProcess, connection: Connection, item: object) -> Iterator[Event]:
        self._busy[connection] = _Worker(process, connection, item)
        yield Event(Kind.BEGUN, item)
        with suppress(OSError):  # it has died: its end of the pipe tells
            connection.send(item)

    def _answer(self, worker: _Worker) -> Iterator[Event]:
        process, connection, item = worker
        try:
            kind, content = connection.recv()
        except (EOFError, OSError):
            self._dismiss(connection)
            process.join(STOP_WITHIN_S)
            self._processes.remove(process)
            yield Event(Kind.DIED, item, ending(process.exitcode))
            yield from self._hire()
            return
        yield Event(kind, item, content)
        if kind is Kind.TOLD:
            return
        for following in self._items:
            yield from self._give(process, connection, following)
            return
        self._dismiss(connection)

    def _dismiss(self, connection: Connection) -> None:
        del self._busy[connection]
        connection.close()  # on which it ends


def _serve(connection: Connection, function: Callable[[Any, Tell], object], threads: int) -> None:
    """Do items until there are no more: what runs in a process."""
    import cv2  # noqa: PLC0415 - only in the processes

    interruption.ignore("SIGINT", "SIGHUP")
    cv2.setNumThreads(threads)
    with suppress(EOFError, KeyboardInterrupt, OSError):
        while True:
            item = connection.recv()
            # Told to stop, it does so as if by Ctrl-C within an item, and at once between them.
            interruption.answer("SIGTERM")
            try:
                answer = Kind.DONE, function(item, lambda told: connection.send((Kind.TOLD, told)))
            except Exception as error:  # raised again where it was asked for
                error.add_note("".join(traceback.format_exception(error)))
                answer = Kind.RAISED, error
            signal.signal(signal.SIGTERM, signal.SIG_DFL)
            connection.send(answer)
