"""What the help costs, and the commands that only print."""

from __future__ import annotations

import json
import tomllib
from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest

from oppload_cli.pipeline.settings import resolve
from tests.cli.inside import oppload
from tests.cli.process import ENTRY, HEAVY, loaded, python

if TYPE_CHECKING:
    from pathlib import Path


def test_help_imports_nothing_heavy() -> None:
    code = (
        "import oppload_cli.cli as cli\n"
        "try: cli.main(['--help'])\n"
        "except SystemExit as end: assert end.code == 0\n"
    )
    assert loaded(code, *HEAVY) == []


def test_models_lists_every_parameter_once_defined() -> None:
    described = json.loads(oppload("models", "--json").stdout)
    names = {entry["name"] for entry in described["parameters"]["opplod"]}
    known = {"receptive_field", "cell", "pool_sigma", "axes", "periphery", "threshold", "gain"}
    assert known < names
    facts = described["models"]
    assert list(facts)[:2] == ["opplod", "dlgmd"]
    assert (facts["opplod"]["height"], facts["opplod"]["alarm"]["floor"]) == (240, 0.09)
    paper = facts["opplod_paper"]
    assert (paper["height"], paper["interval"], paper["alarm"]["floor"]) == (600, "frame", None)
    assert paper["alarm"]["why_none"].startswith("it responds to inward and outward motion alike")
    [field] = [one for one in described["parameters"]["opplod_paper"] if one["unit"] == "px"][-1:]
    assert (field["name"], field["default"]) == ("receptive_field", 200)
    grouping = described["parameters"]["lgmd1_group"][2]
    assert [grouping[end] for end in ("low", "above", "high")] == [None, 0, 1000]
    assert "source: after Hua et al. 2022\n" in oppload("models", "hua_literal").stdout
    assert oppload("models", "ttc_gradient", "dlgmd").stdout.count("places: a box") == 1
    text = oppload("models", "opplod_paper", "opplod_reference").stdout
    assert "  working height: 600 px; counts frames, not seconds\n" in text
    assert "  no alarm: it responds to inward and outward motion alike, so that no" in text
    assert "  working height: 240 px\n  alarm: above 0.0008, and 30 times the median of the" in text


def test_printed_settings_can_be_given_back(tmp_path: Path) -> None:
    words = ("--set", "opplod_paper.gain=2", "--set", "alarm.opplod_paper_floor=1e-5")
    printed = oppload("config", "--model", "opplod_paper,dlgmd", *words).stdout
    assert printed.startswith(
        'models = ["opplod_paper", "dlgmd"]  # command line\nheight = "auto"  # default\n'
    )
    assert "gain = 2.0  # command line" in printed
    assert "opplod_paper_floor = 1e-05  # command line" in printed
    assert 'opplod_lplc2_floor = "auto"  # default' in printed
    path = tmp_path / "s.toml"
    path.write_text(printed)
    again = oppload("config", "--config", path).stdout
    bare = [line.partition("  #")[0] for line in printed.splitlines()]
    assert [line.partition("  #")[0] for line in again.splitlines()] == bare


def test_printed_settings_name_a_file_in_one_line(tmp_path: Path) -> None:
    path = tmp_path / "two\nlines.toml"
    try:
        path.write_text("height = 60")
    except OSError:
        pytest.skip("NOT TESTED: this file system takes no such name")
    printed = oppload("config", "--config", path).stdout
    assert r"two\nlines.toml" in printed
    tomllib.loads(printed)


def test_printed_angles_keep_all_digits(tmp_path: Path) -> None:
    words = ("--fov", "63.4349488", "--set", "opplod.receptive_field=60.123456789deg")
    path = tmp_path / "s.toml"
    path.write_text(oppload("config", *words).stdout)
    settings = resolve(config=path)
    assert settings.fov == 63.4349488
    assert settings.angles == {"opplod.receptive_field": 60.123456789}


def test_info_names_the_versions(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # A package that was installed before another one of the same library.
    (tmp_path / "opencv_python_headless-4.9.0.80.dist-info").mkdir()
    monkeypatch.syspath_prepend(tmp_path)
    facts = json.loads(oppload("info", "--json").stdout)
    assert facts["cores"] >= 1
    assert set(facts["libraries"]) >= {"numpy", "av", "click"}
    assert facts["libraries"]["numpy"] == np.__version__
    assert facts["libraries"]["opencv-python-headless"].startswith(cv2.__version__)


@pytest.mark.long
def test_the_process_exits_with_everything_printed_and_registered_functions_called() -> None:
    first = "import atexit; atexit.register(print, 'at exit')"
    done = python(f"{first}\n{ENTRY}", "models", "--json")
    described, _, rest = done.stdout.rpartition("}")
    assert json.loads(described + "}") == json.loads(oppload("models", "--json").stdout)
    assert rest.strip() == "at exit"


@pytest.mark.long
def test_a_run_loads_its_detectors_alone() -> None:
    code = (
        "import sys\n"
        "from oppload_cli.pipeline.execute import analyse_source\n"
        "from oppload_cli.pipeline.settings import resolve\n"
        "rooms = 'oppload_cli.models.published.', 'importlib.metadata'\n"
        "for models, changes in ([], {'opplod.gain': 2}), (['lgmd2', 'opplod_paper'], {}):\n"
        "    resolve(models=models, assignments=changes)\n"
        "    print(sorted(name for name in sys.modules if name.startswith(rooms)))"
    )
    published = "oppload_cli.models.published"
    names = [f"{published}.lgmd2", f"{published}.parts"]
    assert python(code).stdout.splitlines() == ["[]", str(names)]


def test_a_run_loads_no_large_library_before_the_decoder_begins() -> None:
    modules = "oppload_cli.cli.run, oppload_cli.video.opening"
    assert loaded(f"import {modules}", *HEAVY[:5]) == []
