"""Fixtures for the tests of everything that runs both compiled and plain."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import pytest

from oppload_cli.compute import loops

if TYPE_CHECKING:
    from collections.abc import Iterator


@pytest.fixture(autouse=True, scope="module", params=["compiled", "portable"])
def each_arithmetic(request: pytest.FixtureRequest) -> Iterator[None]:
    """Run each test of a module twice: with the compiled loops and without."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(loops, "portable", request.param == "portable")
        if request.param == "compiled" and loops.arithmetic() == "portable":
            pytest.skip("the compiled loops were not built")
        yield


@pytest.fixture
def many_bands(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Split small frames into bands for several threads too, and restore OpenCV's threads."""
    monkeypatch.setattr(loops, "_LARGE", 1)
    monkeypatch.setattr(loops, "_BAND", 7)
    threads = cv2.getNumThreads()
    yield
    cv2.setNumThreads(threads)
