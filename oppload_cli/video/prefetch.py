"""A thread that decodes ahead, so that decoding and the models overlap."""

from __future__ import annotations

import queue
import threading
from typing import TYPE_CHECKING, Generic, TypeVar

if TYPE_CHECKING:
    from collections.abc import Iterator

Item = TypeVar("Item")


class Prefetch(Generic[Item]):
    """An iterator whose items are made in a thread, a few ahead.

    The thread is joined by `close`, whatever happened; an error in it is raised
    in the caller, after the items that came before it.

    Parameters
    ----------
    items : iterator
        What the thread runs.
    ahead : int
        Most items that wait, at least 1.
    """

    def __init__(self, items: Iterator[Item], ahead: int = 4) -> None:
        self._items = items
        self._queue: queue.Queue[Item | _End] = queue.Queue(ahead)
        self._stop = threading.Event()
        self._ended = False
        self._thread = threading.Thread(target=self._run, name="oppload-decode", daemon=True)
        self._thread.start()

    def __iter__(self) -> Iterator[Item]:
        return self

    def __next__(self) -> Item:
        if self._ended:
            raise StopIteration
        item = self._queue.get()
        if isinstance(item, _End):
            self._ended = True
            if item.error is not None:
                raise item.error
            raise StopIteration
        return item

    def close(self) -> None:
        """Stop the thread and join it; may be called twice."""
        self._stop.set()
        while not self._ended:
            self._ended = isinstance(self._queue.get(), _End)
        self._thread.join()

    def _run(self) -> None:
        error: BaseException | None = None
        try:
            for item in self._items:
                self._queue.put(item)
                if self._stop.is_set():
                    break
        except BaseException as raised:
            error = raised
        finally:
            self._queue.put(_End(error))


class _End:
    """The last item, and what ended the thread."""

    def __init__(self, error: BaseException | None) -> None:
        self.error = error
