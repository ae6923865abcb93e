"""Fixtures, and where the measuring material lies."""

from __future__ import annotations

from pathlib import Path

import pytest

SHARED = Path(__file__).resolve().parents[2] / "shared"


@pytest.fixture(scope="session")
def shared() -> Path:
    """The measuring material beside the project; it has no licence, so it is not part of it."""
    if not SHARED.is_dir():
        pytest.skip(f"NOT MEASURED: {SHARED} is missing")
    return SHARED
