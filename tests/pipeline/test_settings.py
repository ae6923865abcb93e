from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from oppload_cli import OpplodPaperParams
from oppload_cli.errors import ParameterError
from oppload_cli.models.registry import detectors
from oppload_cli.pipeline.settings import resolve
from tests.assigned import assigned


def write(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "settings.toml"
    path.write_text(text)
    return path


def test_later_settings_win_and_say_where_they_came_from(tmp_path: Path) -> None:
    path = write(
        tmp_path,
        'models = ["opplod_paper"]\nheight = 480\n[opplod_paper]\ngain = 2.0\nthreshold = 1',
    )
    settings = resolve(config=path, assignments={"opplod_paper.gain": "3"}, height="native")
    assert (settings.models, settings.height, settings.pixels) == (
        ("opplod_paper",),
        "native",
        None,
    )
    paper = settings.groups["opplod_paper"]
    assert isinstance(paper, OpplodPaperParams)
    assert (paper.gain, paper.threshold) == (3, 1)
    assert settings.origins["opplod_paper.gain"] == "command line"
    assert settings.origins["opplod_paper.threshold"] == str(path)
    assert settings.origins["opplod_paper.axes"] == "default"
    assert settings.origins["height"] == "command line"


def test_defaults() -> None:
    settings = resolve()
    assert (settings.models, settings.height, settings.pixels) == (("opplod", "dlgmd"), "auto", 240)
    assert (resolve(height="100").other_heights, settings.other_heights) == ((), ())
    paper = resolve(models=["opplod_paper", "dlgmd"])
    assert (paper.pixels, paper.other_heights, paper.with_alarm) == (240, (600,), ["dlgmd"])
    assert (paper.height_of("opplod_paper", 240), paper.height_of("dlgmd", 240)) == (600, 240)


def test_a_detector_brings_its_own_alarm() -> None:
    alarm = resolve(models=["opplod", "opplod_reference", "opplod_paper"]).alarm
    assert alarm.rule_of("opplod")[:4] == (0.09, 0, 0, 0)
    assert alarm.rule_of("opplod_reference")[:4] == (8e-4, 30, 0.03, 0.09)
    assert alarm.rule_of("opplod_paper").floor is None
    given = {"alarm.factor": 2, "alarm.opplod_paper_floor": 0.1}
    changed = resolve(models=["opplod_reference", "opplod_paper"], assignments=given).alarm
    assert changed.rule_of("opplod_reference")[:2] == (8e-4, 2)
    assert changed.rule_of("opplod_paper").floor == 0.1
    off = resolve(assignments={"alarm.on": False})
    assert (off.alarm.rule_of("opplod").floor, off.with_alarm) == (None, [])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[oplod]\ngain=1", "no setting 'oplod'; did you mean 'opplod'"),
        ("[opplod]\ngian=1", "no parameter 'gian' of opplod; did you mean 'gain'"),
        ("opplod = 3", "'opplod' is a table"),
        ('preset = "paper"', "in place of 'paper' write --model opplod_paper"),
        ('models = "opplod"', "models must be a list"),
        ('models = ["opplod:paper"]', "in place of 'paper' write --model opplod_paper"),
        ('models = ["dlgdm"]', "no model 'dlgdm'; did you mean 'dlgmd'"),
        ('columns = ["all"]', "columns must be 'usual' or 'all', not"),
        (
            "height = 0",
            "height must be 'auto', 'native' or a whole number of pixels from 1 to 8192",
        ),
        ("height = ", "is not valid TOML"),
    ],
)
def test_the_message_names_a_wrong_file_and_its_mistake(
    tmp_path: Path, text: str, message: str
) -> None:
    path = write(tmp_path, text)
    with pytest.raises(ParameterError, match=message) as caught:
        resolve(config=path)
    assert str(path) in str(caught.value)


def test_a_table_given_for_its_sidecar_gets_the_name_of_the_sidecar(tmp_path: Path) -> None:
    table = tmp_path / "a.frames.csv"
    table.write_text("frame,time_s\n0,0\n")
    with pytest.raises(ParameterError, match=r"or the sidecar of a result, NAME\.oppload\.json$"):
        resolve(config=table)


def test_the_bounds_of_the_interval_are_allowed() -> None:
    for text in ("0.0001", "10"):
        assert resolve(assignments={"time.interval": str(text)}).time.interval == text
    for text in ("0.00009", "10.1"):
        with pytest.raises(ParameterError, match=f"0.0001 to 10 seconds .* not '{text}'"):
            resolve(assignments={"time.interval": str(text)})


@pytest.mark.parametrize(
    ("assignment", "message"),
    [
        ("olod.gain=3", "no parameter set 'olod'; did you mean 'opplod'"),
        ("alarm.floor=3", "no parameter 'floor' of alarm; choose area_growth_floor, ci_lmd_floor,"),
        ("opplod.recepive_field=3", "did you mean 'receptive_field'"),
        ("opplod.receptive_field=0", "must be at least 2"),
        ("opplod.gain=nan", "finite"),
        ("places.most=0", "parameter 'most' of places must be at least 1"),
        ("repeats.share=2", "parameter 'share' of repeats must be at most 0.5"),
    ],
)
def test_a_wrong_assignment(assignment: str, message: str) -> None:
    with pytest.raises(ParameterError, match=message):
        resolve(assignments=assigned(assignment))


@pytest.mark.parametrize("text", ["0", "-3", "12.5", "tall", "9000"])
def test_a_wrong_height(text: str) -> None:
    with pytest.raises(ParameterError, match="height must be"):
        resolve(height=text)


def test_a_missing_file() -> None:
    with pytest.raises(ParameterError, match="cannot be read"):
        resolve(config=Path("nowhere.toml"))


def test_only_detectors_that_run_or_are_set_have_parameters(tmp_path: Path) -> None:
    common = ["alarm", "places", "rmo", "repeats", "time"]
    assert list(resolve(models=["lgmd2"]).groups) == ["lgmd2", *common]
    assert list(resolve(assignments={"opplod.gain": "2"}).groups) == ["opplod", "dlgmd", *common]
    assert resolve(models=["lgmd2"]).alarm.names()[-1] == "lgmd2_floor"
    other = resolve(models=["lgmd2"], assignments={"plgmd.seed": "2"})
    assert list(other.groups) == ["lgmd2", "plgmd", *common]
    floors = resolve(models=["lgmd2"], assignments={"alarm.factor": "5", "alarm.plgmd_floor": "2"})
    assert list(floors.groups) == ["lgmd2", "plgmd", *common]
    assert floors.alarm.names()[-2:] == ("lgmd2_floor", "plgmd_floor")
    assert (floors.alarm.factor, floors.alarm.rule_of("plgmd").floor) == (5, 2)
    filed = resolve(config=write(tmp_path, "[opplod]\ngain = 2"))
    assert list(filed.groups) == ["opplod", "dlgmd", *common]
    assert filed.alarm == resolve().alarm


def test_settings_of_all_detectors_keep_their_values() -> None:
    given = {"opplod.gain": 2, "rmo.sides": 2}
    few = resolve(assignments=given)
    every = few.with_all_detectors()
    assert list(every.groups) == [*detectors(), *list(few.groups)[2:]]
    assert all(every.groups[name] == group for name, group in few.groups.items() if name != "alarm")
    assert every.groups["opplod"].as_dict()["gain"] == 2
    assert every.groups["alarm"].as_dict()["plgmd_floor"] == 20
    assert every.with_all_detectors() is every
    other = replace(few, groups={**few.groups, "alarm": few.alarm.replaced(factor=5)})
    assert other.with_all_detectors().alarm.factor == 5
