from __future__ import annotations

import json
import re
from typing import TYPE_CHECKING

import click
import pytest
from pandas import read_csv

from oppload_cli.cli.tune import tune
from oppload_cli.stimulus.protocol_tables import WORDS
from oppload_cli.tuning.sweeps import FIGURES
from tests.cli.inside import Done, oppload
from tests.results.make import rows_of
from tests.tuning.test_tuning import DISK

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture
def stimulus(tmp_path: Path) -> Path:
    path = tmp_path / "disk.toml"
    path.write_text(DISK.format(before=0))
    return path


def faint(done: Done) -> list[str]:
    """The detectors that hardly respond, according to the messages of the command."""
    return re.findall(
        r"^oppload: ([^:]+) (?:hardly responds|does not respond)", done.stderr, re.MULTILINE
    )


def test_the_help_names_every_figure_and_every_word() -> None:
    """The help has copies, because the modules with the lists would slow it down."""
    helps = {each.name: each.help or "" for each in tune.params if isinstance(each, click.Option)}
    assert f": {', '.join(FIGURES)}, or all " in helps["figures"]
    assert f": {', '.join(WORDS)}, seed or " in helps["over"]


@pytest.mark.long
def test_a_table_its_settings_and_the_plot(stimulus: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    done = oppload(
        "tune", stimulus, "-o", out, "--height", "native", "--jobs", "1", "--model",
        "opplod_reference,dlgmd", "--set", "opplod_reference.receptive_field=24",
        "--change", "timing.motion_s=0.5",
    )  # fmt: skip
    names = ["disk.tuning.csv", "disk.tuning.json", "disk.tuning.png"]
    assert (done.returncode, faint(done)) == (0, ["D-LGMD"])
    assert done.stdout.split() == [str(out / name) for name in names]
    assert sorted(path.name for path in out.iterdir()) == names
    rows = rows_of(out / names[0])
    assert len(rows) == 6
    assert list(rows[0])[:4] == ["stimulus", "disk.growth.speed_deg_s", "model", "peak"]
    content = json.loads((out / names[1]).read_text())
    assert content["stimulus"]["first"]["timing"]["motion_s"] == 0.5
    assert content["stimulus"]["changes"] == {"timing.motion_s": 0.5}
    assert content["parameters"]["opplod_reference"]["receptive_field"] == 24
    assert content["doubts"] == [{"model": "dlgmd", "note": "below a millionth of its floor"}]
    assert (out / names[2]).read_bytes().startswith(b"\x89PNG")


@pytest.mark.long
@pytest.mark.usefixtures("undrawn")
def test_a_classic_figure_is_drawn_as_its_kind(tmp_path: Path) -> None:
    arguments = ("tune", "--figure", "peak-time", "--over", "l/v=10,30,50", "-o", tmp_path,
                 "--change", "display.frame_rate=30", "--change", "timing.motion_s=0.6",
                 "--model", "dlgmd", "--jobs", "1", "--indicator", "0.02")  # fmt: skip
    done = oppload(*arguments)
    assert done.returncode == 0
    names = [f"peak-time.tuning.{end}" for end in ("csv", "json", "png")]
    assert done.stdout.split() == [str(tmp_path / name) for name in names]
    assert re.search(r"^D-LGMD: slope .* ± .* deg, .*, delay .* ms$", done.stderr, re.MULTILINE)
    content = json.loads((tmp_path / names[1]).read_text())
    assert (content["figure"]["kind"], content["indicator_s"]) == ("contact", 0.02)
    fit = content["summary"]["dlgmd"]
    assert f"slope {fit['slope']:.2f} ± {fit['slope_error']:.2f} " in done.stderr
    assert f", delay {1000 * fit['delay_s']:.0f} ± " in done.stderr
    before = (tmp_path / names[0]).read_bytes()
    more = "--plot", "none", "--if-exists", "overwrite"
    assert oppload(*arguments, *more).stderr.splitlines()[-1] in done.stderr
    assert (tmp_path / names[0]).read_bytes() == before
    drawn = oppload("plot", tmp_path / names[0], "-o", tmp_path / "a.svg", "--no-published")
    assert drawn.stderr.splitlines()[0] in done.stderr
    assert drawn.returncode == 0


def test_the_indices_of_a_direction_stand_in_the_sidecar(tmp_path: Path) -> None:
    done = oppload(
        "tune", "klapoetke2017/bar-sweep", "--over", "direction=0,90,180,270",
        "--model", "frame_difference", "--height", "60", "--change", "timing.motion_s=0.3",
        "--plot", "none", "-o", tmp_path, "--jobs", "1",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    content = json.loads((tmp_path / "klapoetke2017_bar-sweep.tuning.json").read_text())
    numbers = content["summary"]["frame_difference"]
    assert f"selectivity index {numbers['direction_selectivity_index']:.3f}" in done.stderr
    assert f"least response {numbers['least_over_largest']:.3g} of the peak" in done.stderr


def test_a_detector_that_hardly_responds_is_named(stimulus: Path, tmp_path: Path) -> None:
    arguments = ("tune", stimulus, "-o", tmp_path, "--height", "native", "--plot", "none",
                 "--jobs", "1", "--over", "speed=15", "--if-exists", "overwrite")  # fmt: skip
    assert faint(oppload(*arguments)) == ["D-LGMD"]
    done = oppload(*arguments, "--change", "disk.luminance=0.49")
    assert (done.returncode, faint(done)) == (0, ["OppLoD reference", "D-LGMD"])
    assert "is below a tenth of the floor of its alarm, 0.0008," in done.stderr


@pytest.mark.long
def test_a_sweep_that_no_plot_shows_leaves_its_table(stimulus: Path, tmp_path: Path) -> None:
    done = oppload(
        "tune", stimulus, "-o", tmp_path / "out", "--jobs", "1", "--model", "opplod",
        "--over", 'disk.appears=["start","onset"]', "--over", "disk.luminance=0,0.1",
        "--over", 'display.frame_rate=["30000/1001",25]', "--height", "60",
    )  # fmt: skip
    names = ["disk.tuning.csv", "disk.tuning.json"]
    assert (done.returncode, done.stdout.split()) == (0, [str(tmp_path / "out" / n) for n in names])
    assert "no plot: " in done.stderr
    assert "are swept; a plot shows two at most" in done.stderr
    rates = read_csv(tmp_path / "out" / names[0])["display.frame_rate"]
    assert rates.tolist() == [29.97003, 25] * 4  # numbers for other programs
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == names
    assert "oppload: disk.growth.speed_deg_s stays at 25; to sweep it as well" in done.stderr


def test_an_existing_result_is_not_touched(stimulus: Path, tmp_path: Path) -> None:
    arguments = ("tune", stimulus, "-o", tmp_path, "--height", "native", "--plot", "none",
                 "--jobs", "1", "--over", "speed=15", "--model", "opplod")  # fmt: skip
    assert oppload(*arguments).returncode == 0
    before = (tmp_path / "disk.tuning.csv").read_bytes()
    (tmp_path / "disk.tuning.csv").write_text("mine")
    done = oppload(*arguments)
    assert (done.returncode, "exists already" in done.stderr) == (2, True)
    assert (tmp_path / "disk.tuning.csv").read_text() == "mine"
    assert oppload(*arguments, "--if-exists", "overwrite").returncode == 0
    assert (tmp_path / "disk.tuning.csv").read_bytes() == before


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["klapoetke2017/lom"], "no stimulus 'klapoetke2017/lom' in the catalogue; did you mean"),
        (["none.toml"], "none.toml: cannot be read"),
        ([], "give a STIMULUS or --figure NAME, one of the two"),
        (["DISK", "--figure", "contrast"], "give a STIMULUS or --figure NAME, one of the two"),
        (["--figure", "contrst"], "no such figure; did you mean 'contrast'"),
        (["--figure", "all", "--over", "l/v=10"], "--over needs exactly one --figure"),
        (["--figure", "contrast", "--change", "disk.luminance=0"], "figure contrast sweeps it"),
        (["DISK", "--indicator", "-1"], "--indicator"),
        (["DISK", "--indicator", "nan"], "--indicator must be 0 to 60 seconds, not nan"),
        (["DISK", "--set", "rmo.grid=8"], "setting rmo.grid=8 has no effect"),
        (["klapoetke2017/loom"], "has no sweep of its own"),
        (["DISK", "--over", "sped=1"], "did you mean 'speed'"),
        (["DISK", "--over", "speed="], "its values cannot be read"),
        (["DISK", "--over", "speed=-5"], "speed_deg_s"),
        (["DISK", "--change", "disk.sise_deg=3"], "sise_deg"),
        (["DISK", "--set", "opplod.gian=3"], "did you mean 'gain'"),
        (["DISK", "--set", "opplod.gain=3", "--model", "dlgmd"], "has no effect, as 'opplod' does"),
        (["DISK", "--model", "dlgdm"], "did you mean 'dlgmd'"),
        (["DISK", "--no-rmo"], "No such option"),
        (["DISK", "--jobs", "-1"], "--jobs"),
    ],
)
def test_wrong_use(arguments: list[str], sentence: str, stimulus: Path, tmp_path: Path) -> None:
    named = [str(stimulus) if word == "DISK" else word for word in arguments]
    done = oppload("tune", *named, "-o", tmp_path / "out")
    assert done.returncode == 2
    assert sentence in done.stderr
    assert "Traceback" not in done.stderr
    assert not (tmp_path / "out").exists()
