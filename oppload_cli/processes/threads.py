"""Threads: one that works ahead of its caller, and one for a call that may block.

While the caller waits for the thread, it checks every tenth of a second whether a signal has come.
If the system refuses a further thread (``ulimit -u``), the caller's thread does the work.
"""

from __future__ import annotations

import atexit
import math
import queue
import threading
import time
from contextlib import suppress
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
    """End the threads that no caller has closed, before the interpreter ends.

    Their callers are daemon threads, as Python has waited for all others. A caller gets SystemExit,
    because after StopIteration it would take the items so far for all of them. If it still called a
    library in C++ while the interpreter ends, Python would abort the process.
    """
    running = list(_running)
    for prefetch in running:
        prefetch.close(SystemExit())
    for prefetch in running:
        prefetch.join_caller()


def _could_start(thread: threading.Thread) -> bool:
    """Start a thread; return whether the system allows it."""
    try:
        thread.start()
    except RuntimeError:
        return False
    return True


class Prefetch(Generic[Item]):
    """An iterator whose items a thread makes, a few ahead of the caller.

    The caller gets an error of the thread after the items before the error. A signal raises
    KeyboardInterrupt in the caller.

    `ahead` is the number of items that may wait for the caller, at least 1. If so many wait, the
    thread makes no further item. But with `on_drop` it goes on, drops the oldest waiting item, and
    calls this function. If the caller stays too slow, fewer items may wait, at last one, so that it
    gets recent ones; `ahead` items may wait again as soon as none waits.
    """

    def __init__(
        self,
        items: Iterator[Item],
        ahead: int = 4,
        on_drop: Callable[[], object] | None = None,
    ) -> None:
        self._items, self._ahead, self._on_drop = items, ahead, on_drop
        self._may_wait = ahead  # number of items, while the caller is fast enough
        self._dropped = False  # whether an item was dropped since the caller took the latest
        self._made: queue.SimpleQueue[Item | _End] = queue.SimpleQueue()
        self._free_places: queue.SimpleQueue[None] = queue.SimpleQueue()
        for _ in range(ahead):
            self._free_places.put(None)
        self._stop = threading.Event()
        self._end: BaseException | None = None  # which the caller gets from now on
        self._caller: threading.Thread | None = None
        self._thread = threading.Thread(target=self._run, name="oppload-ahead", daemon=True)
        self._lacks_thread = not _could_start(self._thread)
        if not self._lacks_thread:
            _running.add(self)

    def __iter__(self) -> Iterator[Item]:
        return self

    def __next__(self) -> Item:
        if self._end:
            raise self._end
        self._caller = threading.current_thread()
        stop_if_asked()
        if self._lacks_thread:
            return next(self._items)
        # One burst of items counts once: it does not show that the caller is too slow.
        if self._made.empty():
            self._may_wait = self._ahead
        elif self._dropped:
            self._may_wait = max(1, self._may_wait - 1)
        self._dropped = False
        while True:
            try:
                item = self._made.get(timeout=POLL_S)
                break
            except queue.Empty:
                if self._end:  # closed meanwhile by another thread
                    raise self._end from None
                stop_if_asked()
        if isinstance(item, _End):
            self._end = self._end or StopIteration()
            raise item.error
        if not self._on_drop:  # else nobody takes the places, which would fill the memory
            self._free_places.put(None)
        return item

    @property
    def used_up(self) -> bool:
        """Whether the caller has had the last item, or the error that ended the items."""
        return isinstance(self._end, StopIteration)

    def close(self, end: BaseException | None = None) -> bool:
        """Stop the thread and join it; return whether it has ended. May be called twice.

        A thread that has not ended waits for a device or a network. The caller must not close the
        objects that the thread uses. A caller that wants a further item gets `end`, by default
        StopIteration.
        """
        self._end = self._end or end or StopIteration()
        if self._lacks_thread:
            return True
        self._stop.set()
        self._free_places.put(None)  # the thread may wait for a free place
        self._thread.join(_JOIN_WITHIN_S)
        return not self._thread.is_alive()

    def join_caller(self) -> None:
        """Wait a moment for the end of the caller, if it is a daemon thread."""
        if self._caller and self._caller.daemon:
            with suppress(RuntimeError, AssertionError):  # this thread, or one of another library
                self._caller.join(_JOIN_WITHIN_S)

    def _run(self) -> None:
        end: BaseException = StopIteration()
        try:
            while True:
                if not self._on_drop:
                    self._free_places.get()
                if self._stop.is_set():
                    end = self._end or end
                    break
                self._made.put(next(self._items))
                while self._on_drop and self._made.qsize() > self._may_wait:
                    with suppress(queue.Empty):  # the caller may have taken the items meanwhile
                        self._made.get_nowait()
                        self._dropped = True
                        self._on_drop()
        except BaseException as error:
            end = error
        self._made.put(_End(end))


class _End(NamedTuple):
    """The last entry of the queue: the exception that the caller gets."""

    error: BaseException


class Call(Generic[Value]):
    """A call in a thread of its own, so that Ctrl-C works while the call blocks in a library.

    The call begins at once. After a signal or a time limit, the caller goes on, and the thread with
    the call remains.
    """

    def __init__(self, call: Callable[[], Value]) -> None:
        self._call = call
        self._values: list[Value] = []
        self._errors: list[BaseException] = []
        self._thread = threading.Thread(target=self._run, name="oppload-call", daemon=True)
        if not _could_start(self._thread):
            self._run()

    def result(self, within_s: float = math.inf) -> Value:
        """Wait for the end of the call; return its value or raise its error.

        Raises TimeoutError if the call has not ended after `within_s` seconds, and
        KeyboardInterrupt if a signal has asked the program to stop.
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

    def wait(self, within_s: float) -> None:
        """Wait for the end of the call, also after a signal."""
        if self._thread.is_alive():
            self._thread.join(within_s)

    def _run(self) -> None:
        try:
            self._values.append(self._call())
        except BaseException as error:
            self._errors.append(error)
