"""Fixtures, and where the measuring material lies."""

from __future__ import annotations

import signal
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from collections.abc import Iterator

SHARED = Path(__file__).resolve().parents[2] / "shared"


@pytest.fixture(scope="session")
def shared() -> Path:
    """The measuring material beside the project; it has no licence, so it is not part of it."""
    if not SHARED.is_dir():
        pytest.skip(f"NOT MEASURED: {SHARED} is missing")
    return SHARED


@pytest.fixture(autouse=True, scope="session")
def _answered() -> None:
    """A command that a test starts inherits what is ignored, as under nohup: here nothing is."""
    for name in ("SIGINT", "SIGTERM", "SIGHUP"):
        number = getattr(signal, name, None)
        if number is not None and signal.getsignal(number) is signal.SIG_IGN:
            signal.signal(
                number, signal.default_int_handler if name == "SIGINT" else signal.SIG_DFL
            )


@pytest.fixture(autouse=True)
def _signals() -> Iterator[None]:
    """The command ignores signals as it ends; run in this process, that would last."""
    numbers = [getattr(signal, name, None) for name in ("SIGINT", "SIGTERM", "SIGHUP")]
    before = {number: signal.getsignal(number) for number in numbers if number is not None}
    yield
    for number, handler in before.items():
        if signal.getsignal(number) is not handler:
            signal.signal(number, handler)
