"""The detectors by name, and how a wrong detector is refused."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import pytest

from oppload_cli.errors import ParameterError
from oppload_cli.models import registry
from oppload_cli.models.columns import COMMON, RMO, columns_of
from oppload_cli.models.detector import AlarmRule, Column, Detector, Response, inner
from oppload_cli.models.dlgmd import Dlgmd, DlgmdParams
from oppload_cli.models.dpc import DpcParams
from oppload_cli.models.opplod import Opplod, OpplodParams
from oppload_cli.models.opplod_reference import OpplodReference
from oppload_cli.pipeline.settings import _TOP_READERS, parameter_sets
from oppload_cli.schema import Parameters, parameter

if TYPE_CHECKING:
    from oppload_cli.models.dpc import Map

pytestmark = pytest.mark.usefixtures("same_detectors_after")

NAMES = [
    *("opplod", "dlgmd", "opplod_reference", "opplod_paper", "opplod_lplc2"),
    *("frame_difference", "flow_divergence", "ttc_gradient", "area_growth"),
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
    assert len({kind.colour for kind in registry.detectors().values()}) == len(NAMES)


def test_a_detector_that_is_loaded_when_it_is_asked_for_is_valid() -> None:
    for name, kind in registry.detectors().items():
        assert kind.name == name
        assert registry.register(kind) is kind
        assert kind.by_default == (name in {"opplod", "dlgmd"})


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
    assert ([column.name for column in Chosen.details], Other.details) == (["left"], ())


def test_an_unknown_name_is_refused_with_the_nearest_one() -> None:
    with pytest.raises(ParameterError, match="no model 'dlgdm'; did you mean 'dlgmd'"):
        registry.detector_named("dlgdm")


def test_the_names_that_a_user_may_write() -> None:
    assert registry.names_of("lgmd2, opplod,lgmd2") == ("lgmd2", "opplod")
    assert registry.names_of("all") == tuple(NAMES)
    assert registry.names_of("opplod_paper,all")[:2] == ("opplod_paper", "opplod")
    with pytest.raises(ParameterError, match="no model 'lgmd3'; did you mean"):
        registry.names_of("lgmd2,lgmd3")


@pytest.mark.parametrize(
    ("name", "instead"),
    [
        ("opplod:default", "opplod"),
        ("opplod:reference", "opplod_reference"),
        ("opplod:paper", "opplod_paper"),
        ("opplod:lplc2", "opplod_lplc2"),
        ("lgmd1_group:paper", "lgmd1_group_paper"),
        ("lgmd1_single:paper", "lgmd1_single_paper"),
        ("dlgmd:reference", "dlgmd"),
    ],
)
def test_a_preset_is_refused_with_the_detector_that_took_its_place(name: str, instead: str) -> None:
    preset = name.partition(":")[2]
    said = (
        f"presets are detectors of their own since 1.0: in place of '{preset}' write --model "
        rf"{instead} \(in Python models=\['{instead}'\]\)$"
    )
    for text in (name, f"lgmd2, {name}"):
        with pytest.raises(ParameterError, match=said):
            registry.names_of(text)


def test_a_preset_that_never_was_is_no_detector() -> None:
    with pytest.raises(ParameterError, match="no model 'opplod:papr'; did you mean 'opplod_paper"):
        registry.names_of("opplod:papr")
    with pytest.raises(ParameterError, match="no model 'lgmd3:paper'"):
        registry.names_of("lgmd3:paper")


def test_the_rules_and_heights_of_the_versions_of_opplod() -> None:
    kinds = [registry.detector_named(name) for name in NAMES if name.startswith("opplod")]
    assert {kind.name: (kind.height, kind.interval, kind.alarm[:4]) for kind in kinds} == {
        "opplod": (240, "1/30", (0.09, 0.0, 0.0, 0.0)),
        "opplod_reference": (240, "1/30", (8e-4, 30.0, 0.03, 0.09)),
        "opplod_paper": (600, "frame", (None, 8.0, 0.0, 0.0)),
        "opplod_lplc2": (240, "1/30", (None, 8.0, 0.0, 0.0)),
    }
    assert {kind.name: kind.least_object for kind in kinds} == {
        "opplod": (0.02, 0.2),
        "opplod_reference": (1e-6, 0.01),
        "opplod_paper": (1e-6, 0.01),
        "opplod_lplc2": (1e-3, 0.01),
    }
    assert [bool(kind.alarm.why_none) for kind in kinds] == [False, False, True, True]
    assert registry.other_heights(NAMES) == (600,)
    assert registry.other_heights(["opplod", "dlgmd"]) == ()


def test_the_least_response_that_means_something() -> None:
    assert registry.least_response_of("opplod") == 0.09
    assert registry.least_response_of("opplod_lplc2") == 1e-3  # without an alarm: of an object


def test_the_detector_of_some_parameters() -> None:
    for name, detector in registry.detectors().items():
        assert registry.detector_of(registry.parameters_of(name)) is detector
    with pytest.raises(ParameterError, match="no detector has parameters of the class DpcParams"):
        registry.detector_of(DpcParams())


def test_the_first_detector_with_places() -> None:
    assert registry.placing_detector(["dlgmd", "opplod"]) is Opplod
    assert registry.placing_detector(["dlgmd"]) is None


def test_a_registered_detector_is_known_everywhere() -> None:
    assert registry.register(Other) is Other
    assert list(registry.detectors()) == [*NAMES, "other"]
    assert registry.default_names() == ("opplod", "dlgmd")
    assert registry.detector_of(OtherParams()) is Other
    assert registry.detector_named("other").alarm.floor == 0
    names = [column.name for column in columns_of(registry.detector_named("other"))]
    assert names == [
        f"other_{name}" for name in ("response", "threshold", "alarm", "left", "y_left")
    ]
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


def test_a_detector_that_extends_another_has_its_rules_and_does_not_run_by_default() -> None:
    @dataclass(frozen=True, kw_only=True)
    class TwiceParams(OpplodParams):
        times: float = parameter(2.0, "factor", low=0)

    class Twice(Opplod):
        name, label, colour, parameters = "twice", "Twice", "#123456", TwiceParams

    registry.register(Twice)
    assert registry.default_names() == ("opplod", "dlgmd")
    params = registry.parameters_of("twice")
    assert registry.detector_of(params) is Twice
    assert params.as_dict() == {**OpplodParams().as_dict(), "times": 2.0}
    assert (Twice.alarm, Twice.height, Twice.interpolates) == (Opplod.alarm, 240, True)
    assert issubclass(Opplod, OpplodReference)
    assert not OpplodReference.by_default


@pytest.mark.parametrize(
    "column", [column.name for column in (*COMMON, *RMO) if "_" in column.name]
)
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
        ({"alarm": 0.5}, "its alarm must be an AlarmRule, not 0.5"),
        ({"alarm": AlarmRule(-1)}, "its alarm must have numbers of at least 0, not AlarmRule(fl"),
        ({"alarm": AlarmRule(1, factor=-1)}, "its alarm must have numbers of at least 0"),
        ({"alarm": AlarmRule(None)}, "its alarm has no floor; say why in why_none"),
        ({"height": 0}, "its working height must be a whole number of 1 to 8192 pixels, not 0"),
        ({"height": 8193}, "must be a whole number of 1 to 8192 pixels, not 8193"),
        ({"height": 120.5}, "must be a whole number of 1 to 8192 pixels, not 120.5"),
        ({"interval": 0.04}, "its interval must be a text, not 0.04"),
        ({"interval": "soon"}, "parameter 'interval' of time must be 'frame', or"),
        ({"interpolates": "yes"}, "its interpolates must be True or False, not 'yes'"),
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
