from __future__ import annotations

import json
from typing import TYPE_CHECKING

from tests.cli.process import oppload

if TYPE_CHECKING:
    from pathlib import Path


def test_the_demo_shows_the_peaks_of_the_paper(tmp_path: Path) -> None:
    done = oppload("demo", "-o", tmp_path)
    assert done.returncode == 0
    lines = [line.split() for line in done.stdout.splitlines()]
    assert lines[1] == ["opplod", "frame", "3", "frame", "8", "frame", "23"]
    assert lines[2] == ["dlgmd", "frame", "3", "frame", "3", "frame", "44"]
    sidecar = json.loads(next(tmp_path.glob("*.oppload.json")).read_text())
    assert sidecar["summary"]["opplod"]["peak_frame"] == 23
    assert sidecar["stimulus"]["name"] == "opplod2023/looming-disk-centre"
    assert sidecar["stimulus"]["looming"] is True
    assert next(tmp_path.glob("*.frames.png")).stat().st_size > 10_000
    again = oppload("demo", "-o", tmp_path)
    assert (again.returncode, "exists already" in again.stderr) == (2, True)
