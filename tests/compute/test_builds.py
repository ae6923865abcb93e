"""The builds of the compiled loops and the plain functions give the same results."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from oppload_cli.compute import loops
from oppload_cli.pipeline.execute import run_task
from oppload_cli.pipeline.settings import resolve
from oppload_cli.pipeline.task import Outputs, Task
from tests.media import disk, texture, write_video
from tests.results.make import rows_of

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from numpy.typing import NDArray


def approaching(textured: bool) -> Iterator[NDArray[np.uint8]]:
    """A disk that grows in the middle: units on both sides of it have equal responses."""
    ground = texture(96, 96, 1) * 0.3 + 0.6 if textured else 0.9
    for t in range(16):
        yield np.rint(255 * ground * disk(96, 48, 48, 4 + 1.1**t * 3)).astype(np.uint8)


@pytest.fixture(params=[False, True], ids=["symmetric", "textured"])
def tables(
    request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> dict[str, list[dict[str, str]]]:
    """The rows of each arithmetic that this processor has; only x86-64 has a wide one."""
    baseline = loops._opened("baseline")
    if isinstance(baseline, str):
        pytest.skip("NOT COMPARED: there are no compiled loops")
    wide = loops._opened("wide") if baseline.runs_wide() else ""
    libraries = {"portable": baseline, "baseline": baseline}
    if not isinstance(wide, str):
        libraries["wide"] = wide
    video = write_video(tmp_path / "a.avi", approaching(request.param))
    rows = {}
    for name, library in libraries.items():
        monkeypatch.setattr(loops, "_loaded", lambda library=library: ("", library))
        monkeypatch.setattr(loops, "portable", name == "portable")
        table = tmp_path / f"{name}.csv"
        run_task(Task(str(video), resolve(height="96"), Outputs(table, table.with_suffix(".json"))))
        rows[name] = rows_of(table)
    return rows


def test_responses_boxes_and_alarms_agree(tables: dict[str, list[dict[str, str]]]) -> None:
    def column(name: str, arithmetic: str) -> NDArray[np.float64]:
        return np.array([float(row[name] or "nan") for row in tables[arithmetic]])

    for other in tables.keys() - {"portable"}:
        for name in ("opplod_response", "dlgmd_response"):
            response = column(name, "portable")
            peak = np.nanmax(response)
            np.testing.assert_allclose(column(name, other), response, rtol=0, atol=1e-5 * peak)
        for side in ("x", "y", "width", "height"):
            name = f"opplod_{side}"
            np.testing.assert_allclose(column(name, other), column(name, "portable"), atol=1e-3)
        for name in ("opplod_alarm", "dlgmd_alarm"):
            np.testing.assert_array_equal(column(name, other), column(name, "portable"))
    assert np.nanmax(column("opplod_response", "portable")) > 0.01
