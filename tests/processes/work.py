"""Work for processes, apart from the tests: a process that loads it need not load pytest."""

from __future__ import annotations

import os
import signal
import time
from typing import TYPE_CHECKING

from oppload_cli.errors import ParameterError
from oppload_cli.processes.signals import stop_if_asked

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path


def squared(number: int) -> int:
    return number * number


def halved(number: int, tell: Callable[[int], object]) -> int:
    """Send a message for each step; refuse odd numbers."""
    for half in range(number // 2):
        tell(half)
    if number % 2:
        raise ParameterError(f"{number} is odd")
    return number // 2


def wrong(number: int) -> int:
    return number // 0


def ends_itself(number: int, _tell: Callable[[int], object]) -> int:
    if number == 2:
        os.kill(os.getpid(), signal.SIGKILL)
    return number


def work_until_stopped() -> None:
    for _ in range(6000):
        stop_if_asked()
        time.sleep(0.01)


def waits(folder: Path, number: int, tell: Callable[[int], object]) -> None:
    """Work until a signal stops the process."""
    try:
        tell(os.getpid())
        work_until_stopped()
    finally:
        (folder / str(number)).touch()  # the process had time to clean up


def ends_well(number: int, tell: Callable[[int], object]) -> int:
    """Return a result when a signal stops the process, as a live input does."""
    tell(number)
    try:
        work_until_stopped()
    except KeyboardInterrupt:
        tell(number)
        return number
    return -1


def stopped_twice(folder: Path, number: int, _tell: Callable[[int], object]) -> None:
    """Get a signal, and a second signal while cleaning up."""
    try:
        os.kill(os.getpid(), signal.SIGTERM)
        work_until_stopped()
    finally:
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(0.01)
        (folder / str(number)).touch()


def never_asks(folder: Path, number: int, tell: Callable[[int], object]) -> None:
    tell(os.getpid())
    time.sleep(60)
    (folder / str(number)).touch()
