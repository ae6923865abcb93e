"""What both arithmetics must do: a fixture for the packages that have two."""

from __future__ import annotations

import pytest

from oppload_cli.native import library


@pytest.fixture(autouse=True, params=["compiled", "portable"])
def each_arithmetic(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Hold both to the same numbers."""
    monkeypatch.setattr(library, "portable", request.param == "portable")
    if request.param == "compiled" and library.library() is None:
        pytest.skip("the compiled loops were not built")
