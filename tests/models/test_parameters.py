from __future__ import annotations

from typing import Any

import pytest

from oppload_cli.errors import ParameterError
from oppload_cli.models.parameters import DlgmdParams, DpcParams, OpplodParams
from oppload_cli.models.presets import PRESETS, preset_named


def test_presets_by_name() -> None:
    assert preset_named("default").height == 240
    assert preset_named("paper").opplod.grid() == (5, 5)
    with pytest.raises(ParameterError, match="no preset 'papr'; did you mean 'paper'"):
        preset_named("papr")


def test_both_models_stand_on_the_same_dpc_constants() -> None:
    assert OpplodParams().dpc() == DlgmdParams().dpc() == DpcParams()


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"receptive_feild": 3}, "did you mean 'receptive_field'"),
        ({"cell": 0}, "'cell' of opplod must be at least 1, not 0"),
        ({"axes": 30}, "must be 0 or 45, not 30"),
        ({"pool_sigma": float("nan")}, "must be a finite number"),
        ({"gain": "much"}, "takes a number, not 'much'"),
        ({"cell": 2.5}, "takes a whole number or none, not 2.5"),
        ({"cell": True}, "takes a whole number or none, not True"),
        ({"units": "5 by 5"}, "'every' or columns x rows"),
        ({"judgement": "pixelwise"}, "'cell' of opplod must be 1 with judgement=pixelwise"),
    ],
)
def test_wrong_values_say_what_is_right(values: dict[str, Any], message: str) -> None:
    with pytest.raises(ParameterError, match=message):
        OpplodParams().replaced(**values)


def test_pixelwise_needs_a_grid() -> None:
    with pytest.raises(ParameterError, match="must be a grid such as 5x5"):
        PRESETS["paper"].opplod.replaced(units="every")


@pytest.mark.parametrize(
    ("name", "text", "value"),
    [
        ("receptive_field", "200", 200),
        ("receptive_field", "auto", None),
        ("pool_sigma", "1", 1.0),
        ("units", "5x5", "5x5"),
        ("axes", "45", 45),
    ],
)
def test_text_becomes_a_value(name: str, text: str, value: object) -> None:
    assert OpplodParams().parsed(name, text) == value


def test_text_of_the_wrong_kind() -> None:
    with pytest.raises(ParameterError, match="takes a whole number or none, not 'wide'"):
        OpplodParams().parsed("cell", "wide")
