"""A copy of this process that makes items beside it, a few ahead."""

from __future__ import annotations

import gc
import os
import pickle
import signal
import sys
import threading
import traceback
from contextlib import suppress
from typing import TYPE_CHECKING, Any, NoReturn

from oppload_cli import interruption
from oppload_cli.interruption import undisturbed
from oppload_cli.processes.endings import ending

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

MANY = 4096  # items that are out of use, a byte for each


def can_fork() -> bool:
    """Tell whether this process can be copied: a copy of one that has threads may hang.

    Returns
    -------
    bool
        Only on Linux, which counts the threads of libraries too. False also where a
        standard stream is closed: a pipe gets its number, and what libraries print.
    """
    if None in (sys.stdin, sys.stdout, sys.stderr):
        return False
    try:
        return sys.platform == "linux" and len(os.listdir("/proc/self/task")) == 1  # noqa: PTH208
    except OSError:
        return False


class DiedError(Exception):
    """The copy ended without a word; the message says how, for instance ``SIGSEGV``."""


class GoneError(Exception):
    """Whoever had the copy made is not there any more. No EOFError: decoders raise those, too."""


class Outlet:
    """The copy's side: hears what to do, passes on items, and waits while too many are in use.

    Parameters
    ----------
    items, words : int
        Ends of two pipes: one to write to, one to read from.
    """

    def __init__(self, items: int, words: int) -> None:
        self._items, self._words = items, os.fdopen(words, "rb")
        self._in_use = 0

    def hear(self) -> Any:
        """Wait for what :meth:`Forked.tell` tells, before any item is passed on.

        Returns
        -------
        object

        Raises
        ------
        GoneError
            If there is nobody left to tell anything.
        """
        try:
            return pickle.load(self._words)  # noqa: S301 - of what this is a copy of
        except EOFError:
            raise GoneError from None

    def send(self, item: object) -> None:
        """Pass on an item.

        Parameters
        ----------
        item : object
            Anything that can be pickled.

        Raises
        ------
        GoneError
            If there is nobody left to take it.
        """
        content = pickle.dumps(item)
        try:
            _write(self._items, content)
        except BrokenPipeError:
            raise GoneError from None
        self._in_use += 1

    def wait(self, most: int) -> None:
        """Wait until no more than `most` items are on their way or in use.

        Parameters
        ----------
        most : int
            At least 0.

        Raises
        ------
        GoneError
            If there is nobody left to use them.
        """
        while self._in_use > most:
            used = len(self._words.read1(MANY))
            if not used:
                raise GoneError
            self._in_use -= used


class Forked:
    """An iterator whose items are made in a copy of this process.

    An item is in use until the next one is asked for. What the copy raises is raised
    here, after the items that came before it; :class:`DiedError` if it ends without a word.
    When this process ends the copy ends too, at its next item.

    Parameters
    ----------
    make : callable
        What the copy does, with its :class:`Outlet`.

    Raises
    ------
    OSError
        If no process or pipe is to be had.
    """

    def __init__(self, make: Callable[[Outlet], object]) -> None:
        items, items_in = os.pipe()
        words, words_in = os.pipe()
        self._items, self._words = os.fdopen(items, "rb"), os.fdopen(words_in, "wb", buffering=0)
        self._in_use = False
        self._ended = False
        self._reading, self._waiting = threading.Lock(), threading.Lock()
        self._process, self._code = 0, 0
        try:
            self._process = self._fork(make, (items_in, words))
        finally:
            os.close(items_in)
            os.close(words)

    def __iter__(self) -> Iterator[Any]:
        return self

    def __next__(self) -> Any:
        with self._reading:
            if self._ended:
                raise StopIteration
            if self._in_use:
                with suppress(BrokenPipeError):  # what it said last may be waiting
                    self._words.write(b"\0")
            try:
                item = pickle.load(self._items)  # noqa: S301 - of our own copy
            except (EOFError, pickle.UnpicklingError):
                self._ended = True
                raise DiedError(self._wait()) from None
            if isinstance(item, _End):
                self._ended = True
                if item.error is not None:
                    raise item.error
                raise StopIteration
            self._in_use = True
            return item

    def tell(self, word: object) -> None:
        """Tell the copy something, before any item is asked for.

        Parameters
        ----------
        word : object
            Anything that can be pickled.
        """
        with suppress(BrokenPipeError):  # that it has died will be found out
            _write(self._words.fileno(), pickle.dumps(word))

    def close(self) -> None:
        """End the copy, at once; may be called twice, also while another thread waits for items."""
        self._wait(kill=True)
        with self._reading:  # the end of the copy ends that
            self._ended = True
            self._items.close()
            self._words.close()

    def _wait(self, *, kill: bool = False) -> str:
        """Wait for the copy to end; say how it did. Only once is there anything to wait for."""
        with self._waiting:
            if self._process:
                if kill:
                    os.kill(self._process, signal.SIGKILL)
                self._code = os.waitstatus_to_exitcode(os.waitpid(self._process, 0)[1])
                self._process = 0
        return ending(self._code)

    @undisturbed
    def _fork(self, make: Callable[[Outlet], object], theirs: tuple[int, int]) -> int:
        held = signal.pthread_sigmask(
            signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM, signal.SIGHUP}
        )
        try:
            process = os.fork()
            if process == 0:
                # Nothing of ours stays open in it, so that it sees when this process ends.
                ours = (self._items.fileno(), self._words.fileno())
                _be_the_copy(make, theirs, ours, held)
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, held)
        return process


class _End:
    """The last item, and what ended the copy."""

    def __init__(self, error: BaseException | None) -> None:
        self.error = error


def _be_the_copy(
    make: Callable[[Outlet], object],
    theirs: tuple[int, int],
    ours: tuple[int, int],
    held: set[int | signal.Signals],
) -> NoReturn:
    """Do what the copy is for, and end: nothing of what it was copied from is done again."""
    try:
        gc.freeze()  # nothing that was copied along is taken apart: it may belong to threads
        # Ctrl-C goes to all of a terminal; whoever started the copy decides what becomes of it.
        interruption.ignore()
        signal.pthread_sigmask(signal.SIG_SETMASK, held)
        for each in ours:
            os.close(each)
        outlet = Outlet(*theirs)
        try:
            make(outlet)
            end = _End(None)
        except GoneError:
            os._exit(0)
        except BaseException as error:
            end = _End(_portable(error))
        outlet.send(end)
    finally:
        os._exit(0)


def _write(pipe: int, content: bytes) -> None:
    rest = memoryview(content)
    while rest:
        rest = rest[os.write(pipe, rest) :]


def _portable(error: BaseException) -> BaseException:
    """Return an error as it can be passed on, with its traceback as a note."""
    story = "".join(traceback.format_exception(error))
    try:
        pickle.loads(pickle.dumps(error))  # noqa: S301 - of our own
    except Exception:
        error = RuntimeError(f"{type(error).__name__}: {error}")
    error.add_note(story)
    return error
