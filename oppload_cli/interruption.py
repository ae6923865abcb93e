"""Ctrl-C and its like: an exception where Python can bear one, a moment later elsewhere."""

from __future__ import annotations

import _frozen_importlib
import math
import signal
import time
from importlib.machinery import ExtensionFileLoader
from types import CodeType
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable
    from types import FrameType

    Function = TypeVar("Function", bound=Callable[..., object])

SIGNALS = ("SIGINT", "SIGTERM", "SIGHUP")  # Windows has no SIGHUP
ASK_AGAIN_S = 0.01
PATIENCE_S = 5.0  # to clean up in; then whoever asks again is answered again

# An extension that is cut short while it is loaded may crash, there and then or at the end.
_undisturbed = {
    ExtensionFileLoader.create_module.__code__,
    ExtensionFileLoader.exec_module.__code__,
}
# What Python calls when a lock of an import is gone: an exception there is printed, and lost.
_locking = getattr(_frozen_importlib, "_get_module_lock", None)
if _locking is not None:
    _undisturbed.update(each for each in _locking.__code__.co_consts if isinstance(each, CodeType))
_received: list[int] = []
_raised_s = -math.inf


class Signalled(KeyboardInterrupt):
    """A signal asked the program to stop.

    A class of its own: where a plain KeyboardInterrupt passes through an ``exec``, as
    of a dataclass while modules are loaded, Python ends the process by SIGINT even if
    the exception was caught.
    """


def undisturbed(function: Function) -> Function:
    """Let no signal interrupt a function, as one that is called from C and cannot raise.

    Parameters
    ----------
    function : callable
        Written in Python; it shall not take long.

    Returns
    -------
    callable
        The function itself.
    """
    _undisturbed.add(function.__code__)
    return function


def answer(*names: str) -> None:
    """Let signals raise :class:`Signalled` from now on.

    What comes within `PATIENCE_S` of one that did changes nothing: it may come from
    several sides, and shall not disturb what the first one has begun to clean up.

    Parameters
    ----------
    *names : str
        Such as ``SIGTERM``; without any those that end a program. One that is ignored
        stays so: nohup means it.
    """
    for number in _numbers(names):
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _interrupt)


def ignore(*names: str) -> None:
    """Let signals pass from now on.

    Parameters
    ----------
    *names : str
        Such as ``SIGINT``; without any those that end a program.
    """
    for number in _numbers(names):
        signal.signal(number, signal.SIG_IGN)


def received() -> bool:
    """Tell whether a signal has asked the program to stop.

    Returns
    -------
    bool
    """
    return bool(_received)


def stop_if_asked() -> None:
    """Raise an interruption that came before and was swallowed, as by a destructor.

    Raises
    ------
    Signalled
        If a signal has come.
    """
    if _received:
        raise Signalled


def _numbers(names: tuple[str, ...]) -> list[signal.Signals]:
    return [getattr(signal, name) for name in names or SIGNALS if hasattr(signal, name)]


def _interrupt(number: int, frame: FrameType | None) -> None:
    global _raised_s  # noqa: PLW0603 - a process has one answer to signals
    _received.append(number)
    now_s = time.monotonic()
    if now_s < _raised_s + PATIENCE_S:
        return
    while frame is not None and frame.f_code not in _undisturbed:
        frame = frame.f_back
    if frame is None or not hasattr(signal, "setitimer"):
        _raised_s = now_s
        raise Signalled
    signal.signal(signal.SIGALRM, _interrupt)
    signal.setitimer(signal.ITIMER_REAL, ASK_AGAIN_S)
