"""What both arithmetics must do: a fixture for the packages that have two."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from oppload_cli.native import library

if TYPE_CHECKING:
    from collections.abc import Iterator


@pytest.fixture(autouse=True, scope="module", params=["compiled", "portable"])
def each_arithmetic(request: pytest.FixtureRequest) -> Iterator[None]:
    """Hold both to the same numbers."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(library, "portable", request.param == "portable")
        if request.param == "compiled" and library.library() is None:
            pytest.skip("the compiled loops were not built")
        yield
