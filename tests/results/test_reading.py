"""Results as they are read back."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from oppload_cli.errors import ResultError
from oppload_cli.results.reading import read_result
from tests.results.make import frame_rows, write_rows

if TYPE_CHECKING:
    from pathlib import Path


def test_a_detector_that_a_result_lacks_is_answered_with_those_it_has(tmp_path: Path) -> None:
    result = read_result(write_rows(tmp_path / "a.frames.csv", frame_rows()))
    held = "has no column 'lgmd2_response'; its detectors are opplod, dlgmd; choose among them"
    with pytest.raises(ResultError, match=held):
        result.need(["opplod_response", "lgmd2_response"])
    with pytest.raises(ResultError, match=r"no column 'x'; give a frames\.csv of 'oppload run'"):
        result.need(["x"])
