"""The detectors and presets by name, and how a wrong detector is refused."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import pytest

from oppload_cli.errors import ParameterError
from oppload_cli.models import registry
from oppload_cli.models.columns import COMMON, RMO, columns_of
from oppload_cli.models.detector import Column, Detector, Response, inner
from oppload_cli.models.dlgmd import Dlgmd, DlgmdParams
from oppload_cli.models.dpc import DpcParams
from oppload_cli.models.opplod import Opplod
from oppload_cli.models.opplod_parameters import OpplodParams
from oppload_cli.models.presets import PRESETS, VARIANTS, preset_in, preset_named
from oppload_cli.models.published.lgmd1_group import Lgmd1GroupPaperParams
from oppload_cli.pipeline.settings import _TOP_READERS, parameter_sets
from oppload_cli.schema import Parameters, parameter

if TYPE_CHECKING:
    from oppload_cli.models.dpc import Map

pytestmark = pytest.mark.usefixtures("same_detectors_after")

NAMES = [
    *("opplod", "dlgmd", "frame_difference", "flow_divergence", "ttc_gradient", "area_growth"),
    *("lgmd1_group", "lgmd1_group_paper", "lgmd1_single", "lgmd1_single_paper", "lgmd1_onoff"),
    *("lgmd2", "lgmd_plus", "plgmd", "lgmd_contrast", "ci_lmd"),
    *("emd_lplc2_gf", "zhou_lrf", "mlplc2", "hua_fixed", "hua_literal"),
]


@dataclass(frozen=True, kw_only=True)
class OtherParams(Parameters):
    pass


class NoDataclass(Parameters):
    least: float = parameter(0.5, "least change")


@dataclass(frozen=True)
class OtherResponse(Response):
    left: float = 0.0
    y_left: float = 0.0


class Other(Detector):
    name, label, colour, meaning = "other", "Other", "#123456", "for this test"
    columns = (Column("left", "px", "a column"), Column("y_left", "px", "another column"))
    responses = OtherResponse
    parameters = OtherParams

    def step(self, _: Map) -> Response:
        return OtherResponse(1.0)

    def reset(self) -> None:
        pass


def test_the_detectors_in_their_order() -> None:
    assert list(registry.detectors()) == NAMES
    assert registry.default_names() == ("opplod", "dlgmd")
    assert registry.detector_named("dlgmd") is Dlgmd
    assert len({each.colour for each in registry.detectors().values()}) == len(NAMES)


def test_a_detector_that_is_loaded_when_it_is_asked_for_is_valid() -> None:
    for name, each in registry.detectors().items():
        assert each.name == name
        assert registry.register(each) is each
        assert each.by_default == (name in {"opplod", "dlgmd"})


def test_inner_values_are_columns_unless_a_detector_gives_others() -> None:
    @dataclass(frozen=True)
    class Inner(OtherResponse):
        up: float = inner(0.5, "px", "a value inside")

    class Default(Other):
        responses = Inner

    class Variant(Default):
        pass

    class Chosen(Other):
        responses, details = Inner, (Column("left", "px", "a column"),)

    assert Inner(1.0).up == 0.5
    assert Default.details == Variant.details == (Column("up", "px", "a value inside"),)
    assert ([each.name for each in Chosen.details], Other.details) == (["left"], ())


def test_an_unknown_name_is_refused_with_the_nearest_one() -> None:
    with pytest.raises(ParameterError, match="no model 'dlgdm'; did you mean 'dlgmd'"):
        registry.detector_named("dlgdm")


def test_the_names_that_a_user_may_write() -> None:
    assert registry.names_of("lgmd2, opplod,lgmd2") == ("lgmd2", "opplod")
    clashing = [
        f"{each.variant_of}:{name.removeprefix(f'{each.variant_of}_')}"
        for name, each in registry.detectors().items()
        if each.variant_of
    ]
    assert sorted(VARIANTS) == sorted(one for one in clashing if one.partition(":")[2] in PRESETS)
    assert preset_in(["opplod, lgmd1_group:paper"]) == ""
    assert preset_in(["opplod:reference,lgmd1_group:paper"]) == "reference"
    both = registry.names_of("lgmd1_group:literal,lgmd1_group:paper")
    assert both == ("lgmd1_group", "lgmd1_group_paper")
    assert registry.parameters_of("lgmd1_group_paper") == Lgmd1GroupPaperParams()
    assert registry.names_of("lgmd1_single_paper") == ("lgmd1_single_paper",)
    variants = {"lgmd1_group_paper", "lgmd1_single_paper"}
    assert registry.names_of("all") == tuple(name for name in NAMES if name not in variants)
    with pytest.raises(ParameterError, match="has no variant 'old': it has literal and paper"):
        registry.names_of("lgmd1_group:old")
    for name in ("opplod:defualt", "all:defualt"):
        with pytest.raises(ParameterError, match="no preset 'defualt'; did you mean 'default'"):
            registry.names_of(name)
    assert registry.names_of("opplod:paper") == ("opplod",)  # a preset
    assert registry.names_of("all:paper") == registry.names_of("all")
    assert preset_in(["all:paper"]) == "paper"
    with pytest.raises(ParameterError, match="no model 'lgmd3'; did you mean"):
        registry.names_of("lgmd2,lgmd3:paper")


def test_the_detector_of_some_parameters() -> None:
    for name, detector in registry.detectors().items():
        assert registry.detector_of(registry.parameters_of(name)) is detector
    with pytest.raises(ParameterError, match="no detector has parameters of the class DpcParams"):
        registry.detector_of(DpcParams())


def test_the_first_detector_with_places() -> None:
    assert registry.placing_detector(["dlgmd", "opplod"]) is Opplod
    assert registry.placing_detector(["dlgmd"]) is None


def test_presets_by_name() -> None:
    assert list(PRESETS) == ["default", "reference", "paper", "lplc2"]
    assert preset_named("default").height == 240
    with pytest.raises(ParameterError, match=r"'robust' is called 'default' since 1\.0"):
        preset_named("robust")
    with pytest.raises(ParameterError, match="no preset 'papr'; did you mean 'paper'"):
        preset_named("papr")


def test_the_parameters_and_floors_of_a_preset() -> None:
    assert registry.parameters_of("opplod") == OpplodParams()
    assert registry.parameters_of("opplod", "reference") == Opplod.presets["reference"]
    assert registry.parameters_of("dlgmd", "reference") == DlgmdParams()
    assert registry.alarm_floor_of("opplod") == registry.alarm_floor_of("opplod", "paper") == 0.09
    assert registry.alarm_floor_of("opplod", "reference") == 8e-4
    with pytest.raises(ParameterError, match="no preset 'papr'"):
        registry.parameters_of("dlgmd", "papr")


def test_a_registered_detector_is_known_everywhere() -> None:
    assert registry.register(Other) is Other
    assert list(registry.detectors()) == [*NAMES, "other"]
    assert registry.default_names() == ("opplod", "dlgmd")
    assert registry.detector_of(OtherParams()) is Other
    assert registry.alarm_floor_of("other", "reference") == 0
    names = [column.name for column in columns_of(registry.detector_named("other"))]
    assert names == ["other_response", "other_alarm", "other_left", "other_y_left"]
    registry.register(Other)  # once more, as when a module is loaded twice
    assert list(registry.detectors()) == [*NAMES, "other"]
    registry.forget("other")
    assert list(registry.detectors()) == NAMES


def test_a_subclass_of_a_detector_without_parameters_has_its_own() -> None:
    class Plain(Detector):
        name, label, colour, meaning = "plain", "Plain", "#123456", "for this test"

        def step(self, luma: Map) -> Response:
            return Response(float(luma[0, 0]))

        def reset(self) -> None:
            pass

    class Second(Plain):
        name = "second"

    try:
        for kind in (Plain, Second, Second):
            registry.register(kind)
        for kind in (Plain, Second):
            assert registry.detector_of(registry.parameters_of(kind.name)) is kind
    finally:
        for name in ("plain", "second"):
            registry.forget(name)


def test_a_detector_that_extends_another_has_its_presets_and_does_not_run_by_default() -> None:
    @dataclass(frozen=True, kw_only=True)
    class TwiceParams(OpplodParams):
        times: float = parameter(2.0, "factor", low=0)

    class Twice(Opplod):
        name, label, colour, parameters = "twice", "Twice", "#123456", TwiceParams

    registry.register(Twice)
    try:
        assert registry.default_names() == ("opplod", "dlgmd")
        for preset in PRESETS:
            params = registry.parameters_of("twice", preset)
            assert registry.detector_of(params) is Twice
            of_opplod = registry.parameters_of("opplod", preset).as_dict()
            assert params.as_dict() == {**of_opplod, "times": 2.0}
    finally:
        registry.forget("twice")


@pytest.mark.parametrize("column", [each.name for each in (*COMMON, *RMO) if "_" in each.name])
def test_no_detector_may_have_a_column_that_every_result_has(column: str) -> None:
    name, own = column.split("_", 1)
    odd = type("Odd", (Other,), {"name": name, "columns": (Column(own, "", "taken"),)})
    with pytest.raises(ParameterError, match=f"its (column '{column}'|name) is taken"):
        registry.register(odd)


@pytest.mark.parametrize(
    ("values", "reason"),
    [
        ({"name": "Other"}, "its name must begin with a lower-case letter, and have only"),
        ({"name": "2nd"}, "its name must begin with a lower-case letter"),
        ({"name": ""}, "its name must begin with a lower-case letter"),
        ({"name": "a-b"}, "its name must begin with a lower-case letter"),
        ({"name": None}, "its name must begin with a lower-case letter"),
        (
            {"name": "dlgmd"},
            "its name is taken by oppload_cli.models.dlgmd.Dlgmd; choose another one",
        ),
        ({"name": "alarm"}, "its name is taken"),
        ({"name": "rmo"}, "its name is taken"),
        ({"colour": "red"}, "its colour must be written as #RRGGBB"),
        ({"label": 5}, "its label must be a text, not 5"),
        ({"unit": None}, "its unit must be a text, not None"),
        ({"cost_ms": "fast"}, "its cost_ms must be a number or None, not 'fast'"),
        ({"warm_up": 1.5}, "its warm_up must be a whole number, not 1.5"),
        ({"alarm_floors": 0.5}, "its alarm_floors must be floors by the names of presets, not 0.5"),
        ({"alarm_floors": {"default": "1"}}, "its alarm_floors must be numbers of at least 0"),
        ({"colour": "#12345"}, "its colour must be written as #RRGGBB"),
        ({"label": ""}, "it needs a label and a meaning"),
        ({"meaning": ""}, "it needs a label and a meaning"),
        ({"columns": (Column("x", "", "a"),), "places": True}, "its column 'other_x' is taken"),
        ({"columns": (Column("azimuth_deg", "", "a"),), "places": True}, "azimuth_deg' is taken"),
        ({"details": (Column("left", "", "a"),)}, "its column 'other_left' is taken; choose"),
        ({"details": (Column("right", "", "a"),)}, "its column 'right' must be a field"),
        ({"columns": (Column("response", "", "a"),)}, "its column 'other_response' is taken"),
        ({"columns": 2 * (Column("a", "", "a"),)}, "its column 'other_a' is taken"),
        ({"name": "luma", "columns": (Column("change", "", "a"),)}, "'luma_change' is taken"),
        ({"name": "frame", "columns": (Column("difference_alarm", "", "a"),)}, "_alarm' is taken"),
        ({"name": "flow", "columns": (Column("vectors", "", "a"),)}, "'flow_vectors' is taken"),
        (
            {"columns": (Column("A b", "", "a"),)},
            "its column 'A b' must be a field of its responses",
        ),
        (
            {"columns": (Column("right", "", "a"),)},
            "'right' must be a field of its responses, Other",
        ),
        ({"responses": Response}, "its column 'left' must be a field of its responses, Response"),
        (
            {"parameters": NoDataclass},
            "NoDataclass, are no dataclass; write @dataclass(frozen=True",
        ),
        ({"parameters": DlgmdParams}, "set 'parameters' to a class that extends DlgmdParams"),
        ({"places": "yes"}, "its places must be True or False, not 'yes'"),
        ({"alarm_floors": {"default": 1, "papr": 1}}, "no preset 'papr'; did you mean 'paper'?"),
        ({"presets": {"papr": OtherParams()}}, "no preset 'papr'; did you mean 'paper'?"),
        ({"presets": {"paper": DlgmdParams()}}, "its presets must be of the class of its parame"),
    ],
)
def test_a_wrong_detector_is_refused_with_its_name_and_the_reason(
    values: dict[str, Any], reason: str
) -> None:
    odd = type("Odd", (Other,), {"__module__": __name__, **values})
    with pytest.raises(ParameterError) as caught:
        registry.register(odd)
    message = str(caught.value)
    assert reason in message
    name = values.get("name", "other")
    assert message.startswith(f"detector '{name}' ({__name__}.Odd): ")
    assert list(registry.detectors()) == NAMES


@pytest.mark.parametrize(
    "name",
    sorted({*parameter_sets(), "preset", *_TOP_READERS, registry.ALL} - {*registry.known_names()}),
)
def test_a_name_with_a_meaning_in_settings_is_taken(name: str) -> None:
    with pytest.raises(ParameterError, match=f"detector '{name}' .*: its name is taken"):
        registry.register(type("Odd", (Other,), {"name": name}))


def test_a_second_detector_of_one_name_is_refused() -> None:
    registry.register(Other)
    with pytest.raises(ParameterError, match=r"detector 'other' .*: its name is taken"):
        registry.register(type("Odd", (Other,), {}))
    assert registry.detector_named("other") is Other
