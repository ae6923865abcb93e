"""Fixtures, and where the measuring material lies."""

from __future__ import annotations

import gc
import os
import signal
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import pytest

# OpenBLAS starts its threads while NumPy is loaded; they would take up to half of the time, waiting
# for each other in a loop. Commands that tests start are not told.
with pytest.MonkeyPatch.context() as _patch:
    _patch.setenv("OPENBLAS_NUM_THREADS", "1")
    import cv2  # loads NumPy

from hypothesis import settings
from matplotlib.figure import Figure
from matplotlib.text import Text

from oppload_cli.compute import loops
from oppload_cli.models import registry
from tests.browser import browser

if TYPE_CHECKING:
    from collections.abc import Generator, Iterator

__all__ = ["browser"]  # for every test

# Containers often forbid Python to keep what it has compiled: each worker would rewrite every test,
# and each command of a test compile the whole package.
sys.dont_write_bytecode = False
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

# Hypothesis draws the same examples in every run, and keeps none.
settings.register_profile("same", derandomize=True, database=None, deadline=None)
settings.load_profile("same")

# For small frames one thread takes less time than several; tests of threads set their number.
cv2.setNumThreads(1)

SHARED = Path(__file__).resolve().parents[2] / "shared"


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Read the tests without the garbage collector, which would take two fifths of the time.

    Afterwards it leaves alone what has been read, which it would search again during every test.
    """
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


@pytest.hookimpl(tryfirst=True)  # before pytest leaves out what is slow
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the second runs of tests that are marked `once`, where there are compiled loops."""
    if loops.arithmetic() == "portable":
        return
    for item in items:
        of = getattr(item, "callspec", None)
        if item.get_closest_marker("once") and of and of.params["each_arithmetic"] == "portable":
            item.add_marker("slow")


@pytest.fixture(scope="session")
def shared() -> Path:
    """The measuring material beside the project; it has no licence, so it is not part of it."""
    if not SHARED.is_dir():
        pytest.skip(f"NOT MEASURED: {SHARED} is missing")
    return SHARED


@pytest.fixture(autouse=True, scope="session")
def _answered() -> dict[int, Any]:
    """A command that a test starts inherits what is ignored, as under nohup: here nothing is."""
    usual = {
        "SIGINT": signal.default_int_handler,
        "SIGTERM": signal.SIG_DFL,
        "SIGHUP": signal.SIG_DFL,
    }
    return {
        getattr(signal, name): handler for name, handler in usual.items() if hasattr(signal, name)
    }


@pytest.fixture(autouse=True)
def _signals(_answered: dict[int, Any]) -> Iterator[None]:
    """The command ignores signals as it ends; run in this process, that would last.

    Fixtures of a module run commands before this one is asked, so that it sets signals first.
    """
    for number, handler in _answered.items():
        signal.signal(number, handler)
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, list(_answered))
    yield
    for number, handler in _answered.items():
        signal.signal(number, handler)


@pytest.fixture
def same_detectors_after() -> Iterator[None]:
    """Forget the detectors that a test registers."""
    before = registry.known_names()
    yield
    for name in set(registry.known_names()).difference(before):
        registry.forget(name)


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Save the texts of a figure in place of its drawing, which would take longest by far.

    For tests of names, messages and texts; what a drawing looks like is tested with `plots`.
    """

    def save_texts(figure: Figure, file: BinaryIO, **_options: object) -> None:
        for text in figure.findobj(Text):
            file.write(f"<!-- {text.get_text()} -->\n".encode())

    monkeypatch.setattr(Figure, "savefig", save_texts)
