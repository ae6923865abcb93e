"""A process that does the tasks it is sent, one after the other."""

from __future__ import annotations

import signal
from contextlib import suppress
from typing import TYPE_CHECKING, NoReturn

import cv2

from oppload_cli.batch.attempt import attempt
from oppload_cli.batch.counting import Counting

if TYPE_CHECKING:
    from multiprocessing.connection import Connection
    from types import FrameType


def serve(connection: Connection, threads: int) -> None:
    """Do tasks until there are no more.

    Parameters
    ----------
    connection : Connection
        Gives a Task each; takes numbers of frames, and the Outcome or Failure of
        each task. Its end is the end of the work.
    threads : int
        Of OpenCV in this process, at least 1.
    """
    # Ctrl-C goes to every process of a terminal; who started this one decides.
    for name in ("SIGINT", "SIGHUP"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    signal.signal(signal.SIGTERM, _stop)
    cv2.setNumThreads(threads)
    with suppress(EOFError, KeyboardInterrupt, OSError):
        while True:
            task = connection.recv()
            watcher = Counting(connection.send)
            result = attempt(task, watcher)
            watcher.flush()
            connection.send(result)
    connection.close()


def _stop(_signal: int, _frame: FrameType | None) -> NoReturn:
    """Take the end of a process as Ctrl-C, so that it keeps the rows that it has written."""
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    raise KeyboardInterrupt
