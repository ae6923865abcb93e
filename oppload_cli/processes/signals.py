"""Ctrl-C, SIGTERM and SIGHUP: a flag that every loop over frames checks.

A signal handler that raises an exception can interrupt anything. An extension module that is being
loaded may crash then, and a callback from C loses the exception. So the first signal only sets the
flag, and :func:`stop_if_asked` raises the exception where it is safe to stop. The second signal has
the system's default action: it ends the process. Only in the moment after the first signal it has
no effect, as ``timeout`` and others send each signal twice: to the process, and to its group.
"""

from __future__ import annotations

import select
import signal
import sys
import time
from contextlib import suppress
from typing import IO, TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable
    from types import FrameType


_SIGNALS = ("SIGINT", "SIGTERM", "SIGHUP")  # Windows has no SIGHUP
POLL_S = 0.1  # longest time for which a thread waits for something else before it checks the flag
_TWICE_S = 0.05  # time after the first signal in which a second one has no effect
_received: list[int] = []


def handle(*names: str, again: signal.Handlers = signal.SIG_DFL) -> None:
    """Let the first of some signals ask the program to stop; `again` is the action after that.

    Without names, the signals are SIGINT, SIGTERM and SIGHUP. A signal that the program ignores, as
    after ``nohup``, is still ignored.
    """
    numbers = [
        number for number in _numbers(names) if signal.getsignal(number) is not signal.SIG_IGN
    ]

    def let_all(action: Callable[[int, FrameType | None], object] | signal.Handlers) -> None:
        for number in numbers:
            signal.signal(number, action)

    def ask(number: int, _frame: FrameType | None) -> None:
        _received.append(number)
        let_all(signal.SIG_IGN)
        time.sleep(_TWICE_S)
        let_all(again)

    let_all(ask)


def ignore(*names: str) -> None:
    """Ignore some signals from now on; without names SIGINT, SIGTERM and SIGHUP."""
    for number in _numbers(names):
        signal.signal(number, signal.SIG_IGN)


def received() -> bool:
    """Tell whether a signal has asked the program to stop."""
    return bool(_received)


def stop_if_asked() -> None:
    """Raise KeyboardInterrupt if a signal has asked the program to stop."""
    if _received:
        raise KeyboardInterrupt


def takes_a_line(stream: IO[str]) -> bool:
    """Wait a moment for the program that reads a stream; return whether a line can be written.

    A write to a full pipe would wait for ever, and no signal would end it. The result is True where
    the system cannot tell.
    """
    if sys.platform == "win32":
        return True
    try:
        return bool(select.select((), (stream,), (), POLL_S)[1])
    except (OSError, ValueError):  # not a file of the system, or closed: writing tells
        return True


def ending(code: int | None) -> str:
    """Return the cause of a process's end, such as ``SIGKILL`` or ``exit code 1``."""
    if code is None or code >= 0:
        return f"exit code {code}"
    with suppress(ValueError):
        return signal.Signals(-code).name
    return f"signal {-code}"


def _numbers(names: tuple[str, ...]) -> list[signal.Signals]:
    return [getattr(signal, name) for name in names or _SIGNALS if hasattr(signal, name)]
