from __future__ import annotations

import csv
import json
import re
from typing import TYPE_CHECKING

import pytest

from tests.cli.inside import Done, oppload, run
from tests.tuning.test_tuning import DISK

if TYPE_CHECKING:
    from pathlib import Path

Capture = pytest.CaptureFixture[str]


@pytest.fixture
def stimulus(tmp_path: Path) -> Path:
    path = tmp_path / "disk.toml"
    path.write_text(DISK.format(before=0))
    return path


def faint(done: Done) -> list[str]:
    """The detectors of which the command says that they hardly respond."""
    return re.findall(r"^oppload: (\S+) hardly responds", done.stderr, re.MULTILINE)


def test_a_table_its_settings_and_the_plot(stimulus: Path, tmp_path: Path, capsys: Capture) -> None:
    out = tmp_path / "out"
    done = run(
        capsys, "tune", stimulus, "-o", out, "--height", "native", "--jobs", "1", "--preset",
        "reference", "--set", "opplod.receptive_field=24", "--change", "timing.motion_s=0.5",
    )  # fmt: skip
    names = ["disk.tuning.csv", "disk.tuning.json", "disk.tuning.png"]
    assert (done.returncode, faint(done)) == (0, ["D-LGMD"])
    assert done.stdout.split() == [str(out / name) for name in names]
    assert sorted(path.name for path in out.iterdir()) == names
    rows = list(csv.DictReader((out / names[0]).read_text().splitlines()))
    assert len(rows) == 6
    assert list(rows[0])[:4] == ["stimulus", "disk.growth.speed_deg_s", "model", "peak"]
    content = json.loads((out / names[1]).read_text())
    assert content["stimulus"]["first"]["timing"]["motion_s"] == 0.5
    assert content["parameters"]["opplod"]["receptive_field"] == 24
    assert (out / names[2]).read_bytes().startswith(b"\x89PNG")


def test_a_detector_that_hardly_responds_is_named(
    stimulus: Path, tmp_path: Path, capsys: Capture
) -> None:
    arguments = ("tune", stimulus, "-o", tmp_path, "--height", "native", "--plot", "none",
                 "--jobs", "1", "--over", "speed=15", "--if-exists", "overwrite")  # fmt: skip
    assert faint(run(capsys, *arguments)) == ["D-LGMD"]
    done = run(capsys, *arguments, "--change", "disk.luminance=0.49")
    assert (done.returncode, faint(done)) == (0, ["OppLoD", "D-LGMD"])
    assert "and no alarm is given below 0.0008;" in done.stderr


def test_an_existing_result_is_not_touched(stimulus: Path, tmp_path: Path, capsys: Capture) -> None:
    arguments = ("tune", stimulus, "-o", tmp_path, "--height", "native", "--plot", "none",
                 "--jobs", "1", "--over", "speed=15", "--model", "opplod")  # fmt: skip
    assert run(capsys, *arguments).returncode == 0
    before = (tmp_path / "disk.tuning.csv").read_bytes()
    (tmp_path / "disk.tuning.csv").write_text("mine")
    done = oppload(*arguments)
    assert (done.returncode, "exists already" in done.stderr) == (2, True)
    assert (tmp_path / "disk.tuning.csv").read_text() == "mine"
    assert run(capsys, *arguments, "--if-exists", "overwrite").returncode == 0
    assert (tmp_path / "disk.tuning.csv").read_bytes() == before


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["klapoetke2017/lom"], "no stimulus 'klapoetke2017/lom' in the catalogue; did you mean"),
        (["none.toml"], "none.toml: cannot be read"),
        (["klapoetke2017/loom"], "has no sweep of its own"),
        (["DISK", "--over", "sped=1"], "did you mean 'speed'"),
        (["DISK", "--over", "speed="], "its values cannot be read"),
        (["DISK", "--over", "speed=-5"], "speed_deg_s"),
        (["DISK", "--change", "disk.sise_deg=3"], "sise_deg"),
        (["DISK", "--set", "opplod.gian=3"], "did you mean 'gain'"),
        (["DISK", "--model", "dlgdm"], "did you mean 'dlgmd'"),
        (["DISK", "--no-rmo"], "No such option"),
        (["DISK", "--jobs", "-1"], "--jobs"),
    ],
)
def test_wrong_use(
    arguments: list[str], sentence: str, stimulus: Path, tmp_path: Path, capsys: Capture
) -> None:
    named = [str(stimulus) if word == "DISK" else word for word in arguments]
    done = run(capsys, "tune", *named, "-o", tmp_path / "out")
    assert done.returncode == 2
    assert sentence in done.stderr
    assert "Traceback" not in done.stderr
    assert not (tmp_path / "out").exists()
