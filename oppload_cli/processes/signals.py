"""Ctrl-C, SIGTERM and SIGHUP: a flag that every loop over frames looks at.

A handler that raised an exception could interrupt anything: an extension module that is being
loaded, which may crash, or a callback from C, where the exception is lost. So the first signal
only sets the flag, and :func:`stop_if_asked` raises where it is safe to stop. The second signal
acts as the system has it: it ends the process.
"""

from __future__ import annotations

import signal
from contextlib import suppress
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from types import FrameType

    Handler = signal.Handlers  # SIG_DFL or SIG_IGN


_SIGNALS = ("SIGINT", "SIGTERM", "SIGHUP")  # Windows has no SIGHUP
POLL_S = 0.1  # how long a thread may wait for something else before it asks again
_received: list[int] = []


def answer(*names: str, again: Handler = signal.SIG_DFL) -> None:
    """Let the first of these signals, or of those that end a program, ask the program to stop.

    A signal that is ignored stays so: nohup means it. `again` is the action of all of the signals
    after the first.
    """
    numbers = [each for each in _numbers(names) if signal.getsignal(each) is not signal.SIG_IGN]

    def ask(number: int, _frame: FrameType | None) -> None:
        _received.append(number)
        for each in numbers:
            signal.signal(each, again)

    for number in numbers:
        signal.signal(number, ask)


def ignore(*names: str) -> None:
    """Ignore these signals from now on; without names, those that end a program."""
    for number in _numbers(names):
        signal.signal(number, signal.SIG_IGN)


def received() -> bool:
    """Tell whether a signal has asked the program to stop."""
    return bool(_received)


def stop_if_asked() -> None:
    """Raise KeyboardInterrupt if a signal has asked the program to stop."""
    if _received:
        raise KeyboardInterrupt


def ending(code: int | None) -> str:
    """Return how a process ended, such as ``SIGKILL`` or ``exit code 1``, from its exit code."""
    if code is None or code >= 0:
        return f"exit code {code}"
    with suppress(ValueError):
        return signal.Signals(-code).name
    return f"signal {-code}"


def _numbers(names: tuple[str, ...]) -> list[signal.Signals]:
    return [getattr(signal, name) for name in names or _SIGNALS if hasattr(signal, name)]
