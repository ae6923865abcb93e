from __future__ import annotations

import json
from typing import TYPE_CHECKING

import pytest

from tests.cli.inside import oppload, words_of

if TYPE_CHECKING:
    from pathlib import Path


@pytest.mark.long
def test_the_demo_alarms_before_contact_and_its_lines_give_the_same(tmp_path: Path) -> None:
    done = oppload("demo", "-o", "demo", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert lines[0].endswith("contact at 2.00 s")
    shown = next(words_of(line) for line in lines if line.startswith("$ oppload run"))
    folder = tmp_path / "demo"
    sidecar = json.loads(next(folder.glob("*.oppload.json")).read_text())
    [alarm] = sidecar["alarms"]["opplod"]["alarms"]
    assert 0.2 < 2.0 - alarm["start_s"] < 1
    assert sidecar["stimulus"]["name"] == "controls/looming-and-translating"
    assert next(folder.glob("*.frames.png")).stat().st_size > 10_000
    assert next(folder.glob("*.report.html")).stat().st_size > 10_000
    again = oppload(*shown[2:-1], "again", "-q", cwd=tmp_path)
    assert again.returncode == 0, again.stderr
    for path in folder.glob("*.frames.csv"):
        assert path.read_bytes() == (tmp_path / "again" / path.name).read_bytes()
    refused = oppload("demo", "-o", "demo", cwd=tmp_path)
    assert (refused.returncode, "exists already" in refused.stderr) == (2, True)
    next(folder.glob("*.frames.png")).unlink()
    for said in ("skipped", "nothing to do"):
        kept = oppload("demo", "-o", "demo", "--if-exists", "skip", cwd=tmp_path)
        assert (kept.returncode, said in kept.stdout) == (0, True)
        assert len(list(folder.glob("*.frames.png"))) == 1


def test_the_demo_replaces_no_file_unasked(tmp_path: Path) -> None:
    for end in (".avi", ".stimulus.json", ".frames.png", ".report.html"):
        mine = tmp_path / f"controls_looming-and-translating{end}"
        mine.write_text("mine")
        refused = oppload("demo", "-o", tmp_path)
        assert (refused.returncode, f"{end}: exists already" in refused.stderr) == (2, True)
        assert (list(tmp_path.iterdir()), mine.read_text()) == ([mine], "mine")
        mine.unlink()
