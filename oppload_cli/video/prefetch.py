"""Threads: one that decodes ahead, and one for calls that may block."""

from __future__ import annotations

import atexit
import math
import queue
import threading
import time
from typing import TYPE_CHECKING, Any, Generic, TypeVar
from weakref import WeakSet

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from oppload_cli.video.frames import InputFacts
    from oppload_cli.video.working import WorkingSize

Item = TypeVar("Item")
Value = TypeVar("Value")

LEAST_AHEAD, MOST_AHEAD = 2, 16  # frames that wait for the next thread
WAITING_BYTES = 1 << 23  # of luminance that waits, above the least
JOIN_WITHIN_S = 0.5  # so that Ctrl-C ends a run within one second


_running: WeakSet[Prefetch[Any]] = WeakSet()


def frames_ahead(facts: InputFacts, working: WorkingSize) -> int:
    """Return how many frames may wait between two threads.

    Many even out what single frames cost; but they take memory, and where frames are
    live each that waits is late.

    Parameters
    ----------
    facts : InputFacts
        What kind of input it is.
    working : WorkingSize
        Size of the frames.

    Returns
    -------
    int
    """
    if facts.kind in ("camera", "stream"):
        return LEAST_AHEAD
    fit = WAITING_BYTES // (4 * working.width * working.height)
    return max(LEAST_AHEAD, min(MOST_AHEAD, fit))


@atexit.register
def _close_all() -> None:
    """End the threads that a caller has left behind: they must not outlive the interpreter."""
    for each in list(_running):
        each.close()


class Prefetch(Generic[Item]):
    """An iterator whose items are made in a thread, a few ahead.

    An error in the thread is raised in the caller, after the items that came
    before it.

    Parameters
    ----------
    items : iterator
        What the thread runs.
    ahead : int
        Most items that wait, at least 1.
    """

    def __init__(self, items: Iterator[Item], ahead: int = 4) -> None:
        self._items = items
        self._made: queue.SimpleQueue[Item | _End] = queue.SimpleQueue()
        self._places: queue.SimpleQueue[None] = queue.SimpleQueue()  # that are free
        for _ in range(ahead):
            self._places.put(None)
        self._stop = threading.Event()
        self._ended = False
        self._thread = threading.Thread(target=self._run, name="oppload-decode", daemon=True)
        self._thread.start()
        _running.add(self)

    def __iter__(self) -> Iterator[Item]:
        return self

    def __next__(self) -> Item:
        if self._ended:
            raise StopIteration
        item = self._made.get()
        if isinstance(item, _End):
            self._ended = True
            if item.error is not None:
                raise item.error
            raise StopIteration
        self._places.put(None)
        return item

    def close(self) -> bool:
        """Stop the thread and join it; may be called twice.

        Returns
        -------
        bool
            False if it did not end in time: it waits for a device or a network, and
            what it uses must be left alone.
        """
        self._stop.set()
        self._places.put(None)  # the thread may wait for one
        self._thread.join(JOIN_WITHIN_S)
        self._ended = True
        return not self._thread.is_alive()

    def _run(self) -> None:
        error: BaseException | None = None
        try:
            for item in self._items:
                self._places.get()
                if self._stop.is_set():
                    break
                self._made.put(item)
        except BaseException as raised:
            error = raised
        finally:
            self._made.put(_End(error))


class _End:
    """The last item, and what ended the thread."""

    def __init__(self, error: BaseException | None) -> None:
        self.error = error


class Call(Generic[Value]):
    """A call that may block in a library, in a thread: meanwhile Ctrl-C is answered.

    Parameters
    ----------
    call : callable
        Takes nothing; it begins at once, and an interruption leaves it behind.
    """

    def __init__(self, call: Callable[[], Value]) -> None:
        self._call = call
        self._values: list[Value] = []
        self._errors: list[BaseException] = []
        self._thread = threading.Thread(target=self._run, name="oppload-open", daemon=True)
        self._thread.start()

    def result(self, within_s: float = math.inf) -> Value:
        """Wait for the call to end.

        Parameters
        ----------
        within_s : float
            Seconds after which it is left behind.

        Returns
        -------
        object
            What the call returns; what it raises is raised.

        Raises
        ------
        TimeoutError
            If it has not ended in time.
        """
        deadline = time.monotonic() + within_s
        while self._thread.is_alive() and time.monotonic() < deadline:
            self._thread.join(0.1)  # without a limit it could not be interrupted on every system
        if self._errors:
            raise self._errors[0]
        if not self._values:
            raise TimeoutError(f"no word within {within_s:.0f} s")
        return self._values[0]

    def _run(self) -> None:
        try:
            self._values.append(self._call())
        except BaseException as error:
            self._errors.append(error)
