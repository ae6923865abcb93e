"""Threads: one that works ahead of its caller, and one for a call that may block.

A caller that waits for them asks every tenth of a second whether a signal has come. Where the
system gives no further thread (``ulimit -u``) the caller's own does their work.
"""

from __future__ import annotations

import atexit
import math
import queue
import threading
import time
from typing import TYPE_CHECKING, Any, Generic, NamedTuple, TypeVar
from weakref import WeakSet

from oppload_cli.processes.signals import POLL_S, stop_if_asked

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator


Item = TypeVar("Item")
Value = TypeVar("Value")

_JOIN_WITHIN_S = 0.5  # so that Ctrl-C ends a run within one second

_running: WeakSet[Prefetch[Any]] = WeakSet()


@atexit.register
def _close_all() -> None:
    """End the threads that a caller did not close: they must not outlive the interpreter."""
    for each in list(_running):
        each.close()


def _started(thread: threading.Thread) -> bool:
    """Start a thread; tell whether the system gave one."""
    try:
        thread.start()
    except RuntimeError:
        return False
    return True


class Prefetch(Generic[Item]):
    """An iterator whose items are made in a thread, a few ahead.

    An error in the thread is raised in the caller, after the items that came
    before it. A signal raises KeyboardInterrupt in the caller.

    Parameters
    ----------
    items : iterator
        Advanced by the thread.
    ahead : int
        How many items may wait for the caller, at least 1.
    """

    def __init__(self, items: Iterator[Item], ahead: int = 4) -> None:
        self._items = items
        self._made: queue.SimpleQueue[Item | _End] = queue.SimpleQueue()
        self._free_places: queue.SimpleQueue[None] = queue.SimpleQueue()
        for _ in range(ahead):
            self._free_places.put(None)
        self._stop = threading.Event()
        self._ended = False
        self._thread = threading.Thread(target=self._run, name="oppload-ahead", daemon=True)
        self._alone = not _started(self._thread)
        if not self._alone:
            _running.add(self)

    def __iter__(self) -> Iterator[Item]:
        return self

    def __next__(self) -> Item:
        if self._ended:
            raise StopIteration
        stop_if_asked()
        if self._alone:
            return next(self._items)
        while True:
            try:
                item = self._made.get(timeout=POLL_S)
                break
            except queue.Empty:
                stop_if_asked()
        if isinstance(item, _End):
            self._ended = True
            raise item.error or StopIteration
        self._free_places.put(None)
        return item

    def close(self) -> bool:
        """Stop the thread and join it, and tell whether it ended; may be called twice.

        A thread that did not end waits for a device or a network, and the objects that it uses must
        not be closed.
        """
        self._ended = True
        if self._alone:
            return True
        self._stop.set()
        self._free_places.put(None)  # the thread may wait for one
        self._thread.join(_JOIN_WITHIN_S)
        return not self._thread.is_alive()

    def _run(self) -> None:
        try:
            for item in self._items:
                self._free_places.get()
                if self._stop.is_set():
                    break
                self._made.put(item)
        except BaseException as error:
            self._made.put(_End(error))
        else:
            self._made.put(_End(None))


class _End(NamedTuple):
    """The last item, with the error that ended the thread."""

    error: BaseException | None


class Call(Generic[Value]):
    """A call that may block in a library, in a thread of its own: meanwhile Ctrl-C is answered.

    Parameters
    ----------
    call : callable
        Takes nothing. It begins at once; a signal or a time limit leaves it behind.
    """

    def __init__(self, call: Callable[[], Value]) -> None:
        self._call = call
        self._values: list[Value] = []
        self._errors: list[BaseException] = []
        self._thread = threading.Thread(target=self._run, name="oppload-call", daemon=True)
        if not _started(self._thread):
            self._run()

    def result(self, within_s: float = math.inf) -> Value:
        """Wait for the call to end; return its value or raise its error.

        Raises TimeoutError if it has not ended within so many seconds, and KeyboardInterrupt if a
        signal has asked the program to stop.
        """
        deadline = time.monotonic() + within_s
        while self._thread.is_alive() and time.monotonic() < deadline:
            stop_if_asked()
            self._thread.join(POLL_S)
        if self._errors:
            raise self._errors[0]
        if not self._values:
            raise TimeoutError(f"no answer within {within_s:.0f} s")
        return self._values[0]

    def wait(self, within_s: float) -> bool:
        """Wait for the call to end, whatever signal has come; tell whether it did."""
        if self._thread.is_alive():
            self._thread.join(within_s)
        return not self._thread.is_alive()

    def _run(self) -> None:
        try:
            self._values.append(self._call())
        except BaseException as error:
            self._errors.append(error)
