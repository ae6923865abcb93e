from __future__ import annotations

import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

from oppload_cli import reproduction
from oppload_cli.reproduction.claims import (
    FIGURES,
    Built,
    Claim,
    ClaimVerdict,
    Finding,
    described_settings,
    faint_note,
    settings_of,
    short,
    stated,
    tally,
)
from oppload_cli.tuning.present import Responses

HOLDS, IN_PART, DOES_NOT = ClaimVerdict
NAN = float("nan")


@pytest.mark.parametrize(
    ("value", "verdict"),
    [
        (0.0, HOLDS),
        (0.1, HOLDS),
        (0.11, IN_PART),
        (0.5, IN_PART),
        (0.51, DOES_NOT),
        (NAN, DOES_NOT),
    ],
)
def test_a_value_that_should_be_small(value: float, verdict: ClaimVerdict) -> None:
    assert ClaimVerdict.at_most(value, 0.1, 0.5) is verdict


@pytest.mark.parametrize(
    ("value", "verdict"),
    [(2.0, HOLDS), (0.9, HOLDS), (0.89, IN_PART), (0.5, IN_PART), (0.4, DOES_NOT), (NAN, DOES_NOT)],
)
def test_a_value_that_should_be_large(value: float, verdict: ClaimVerdict) -> None:
    assert ClaimVerdict.at_least(value, 0.9, 0.5) is verdict


@pytest.mark.parametrize(
    ("verdicts", "sum_", "counts"),
    [
        ((HOLDS, HOLDS), HOLDS, "2 hold"),
        ((DOES_NOT,), DOES_NOT, "0 hold, 1 not"),
        ((HOLDS, DOES_NOT), IN_PART, "1 hold, 1 not"),
        ((HOLDS, IN_PART, DOES_NOT), IN_PART, "1 hold, 1 in part, 1 not"),
    ],
)
def test_verdicts_sum_up(
    verdicts: tuple[ClaimVerdict, ...], sum_: ClaimVerdict, counts: str
) -> None:
    claims = tuple(Claim("s", "r", {"one": Finding("x", verdict)}) for verdict in verdicts)
    figure = Built("name", "title", "shows", claims, None, ()).as_dict()
    assert figure["verdicts"] == {"one": sum_}
    assert tally(figure, "one") == counts


def test_numbers_have_an_exponent_only_where_they_are_very_small() -> None:
    values = (1e-6, 0.123, 99.4, 99.7, 1234.5)
    assert [short(value) for value in values] == ["1e-06", "0.12", "99", "100", "1,234"]


def test_a_figure_is_judged_per_detector() -> None:
    def claim(**verdicts: ClaimVerdict) -> Claim:
        found = {name: Finding("x", verdict, {"v": 1.0}) for name, verdict in verdicts.items()}
        return Claim("s", "r", found)

    claims = (claim(one=HOLDS, other=DOES_NOT), claim(one=HOLDS))
    built = Built("name", "title", "shows", claims, None, ())
    content = built.as_dict()
    assert content["verdicts"] == {"one": HOLDS, "other": DOES_NOT}
    assert content["command"] == "oppload reproduce --only name"
    assert content["claims"][0]["measured"]["other"] == {
        "text": "x",
        "verdict": "does not hold",
        "hardly_responds": False,
        "numbers": {"v": 1.0},
    }
    assert tally(content, "one") == "2 hold"


def test_a_verdict_on_a_faint_response_says_so() -> None:
    settings = settings_of("opplod_reference", height="native", beside="dlgmd")
    time = np.arange(3.0)
    shown = {
        peak: [Responses(time, time, np.array([NAN, 0, peak]), np.full((3, 4), NAN))]
        for peak in (1e-4, 1.0)
    }
    faint = faint_note("dlgmd", shown[1e-4], settings, "to the disk")
    assert faint.startswith("D-LGMD hardly responds to the disk (largest response 0.0001, below a")
    assert faint_note("dlgmd", shown[1.0], settings, "to the disk") == ""
    assert faint_note("dlgmd", shown[1e-4] + shown[1.0], settings, "to the disk") == ""
    found = Finding("Peak at 44.", HOLDS, {}, faint).as_dict()
    assert found["text"] == f"Peak at 44. {faint}"
    assert stated(found) == "holds, hardly responds"
    assert stated(Finding("x", HOLDS).as_dict()) == "holds"


def test_a_detector_takes_only_its_own_changes_of_parameters() -> None:
    change = {"opplod_reference.receptive_field": 192}
    for detector, field, text in (
        ("opplod_reference", 192, "240 px, opplod_reference.receptive_field=192"),
        ("opplod_paper", 200, "600 px"),
    ):
        settings = settings_of(detector, change)
        assert settings.models == (detector,)
        assert settings.groups[detector].as_dict()["receptive_field"] == field
        assert described_settings(settings) == text


def test_the_detector_beside_another_has_its_height_and_time_base() -> None:
    for detector, height, interval, text in (
        ("opplod_reference", 240, None, "240 px"),
        ("opplod_paper", 600, "frame", "600 px, time.interval=frame"),
    ):
        settings = settings_of(detector, beside="dlgmd")
        assert settings.models == (detector, "dlgmd")
        assert (settings.pixels, settings.other_heights) == (height, ())
        assert settings.time.interval == interval
        assert described_settings(settings) == text


def test_a_number_that_json_cannot_hold_is_null() -> None:
    numbers = {"nan": NAN, "infinite": float("inf"), "one": 1.0}
    found = Finding("x", HOLDS, numbers).as_dict()["numbers"]
    assert found == {"nan": None, "infinite": None, "one": 1.0}


def test_each_figure_and_claim_has_its_texts() -> None:
    folder = Path(reproduction.__file__).parent
    texts = tomllib.loads((folder / "statements.toml").read_text(encoding="utf-8"))
    code = "".join(path.read_text(encoding="utf-8") for path in folder.glob("*.py"))
    shared = set(re.findall(r'shared="([^"]+)"', code))
    assert set(texts["figures"]) == {*FIGURES, *shared}
    assert set(texts["claims"]) == set(re.findall(r'\b(?:Claim\.of|claim)\(\s*"([^"]+)"', code))
    assert all(claim["statement"] and claim["rule"] for claim in texts["claims"].values())
