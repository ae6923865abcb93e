"""Declared values: one conversion and one check, for parameters and for tables of protocols."""

from __future__ import annotations

from dataclasses import dataclass, make_dataclass
from fractions import Fraction
from typing import Any, Literal

import numpy as np
import pytest

from oppload_cli.errors import ParameterError, StimulusError
from oppload_cli.schema import REQUIRED, DeclaredTable, Parameters, parameter
from oppload_cli.stimulus.objects import Motion
from tests.cli.process import loaded


@dataclass(frozen=True, kw_only=True)
class Inner(DeclaredTable):
    size: float = parameter(REQUIRED, "size", unit="px", above=0)


@dataclass(frozen=True, kw_only=True)
class Outer(DeclaredTable):
    kind: str = parameter("disk", "shape", choices=("disk", "bar"))
    count: int = parameter(1, "number", low=1, high=9)
    rate: Fraction = parameter(Fraction(30), "rate")
    place: tuple[float, float] = parameter((0.0, 0.0), "place", low=-1, high=1)
    width: float | None = parameter(None, "width", needed_by=("bar",))
    inner: Inner | None = parameter(None, "a table")


@dataclass(frozen=True, kw_only=True)
class SomeParams(Parameters):
    gain: float = parameter(1.0, "gain", unit="px", low=0)
    cell: int | None = parameter(None, "cell", high=10)


@dataclass(frozen=True, kw_only=True)
class Early(DeclaredTable):
    """A table whose value is of a class that is defined below."""

    later: Later | None = parameter(None, "another table")


@dataclass(frozen=True, kw_only=True)
class Later(DeclaredTable):
    size: float = parameter(1.0, "size")


def test_values_are_converted() -> None:
    outer = Outer.from_table(
        {"rate": 29.97, "place": [0, 1], "inner": {"size": 3}, "kind": "bar", "width": 2}, "a.toml"
    )
    assert outer == Outer(
        kind="bar", rate=Fraction(2997, 100), place=(0.0, 1.0), width=2.0, inner=Inner(size=3.0)
    )
    assert isinstance(outer.place[1], float)
    assert isinstance(SomeParams(gain=3).gain, float)
    assert Outer.from_table(outer.as_table(), "again") == outer
    assert outer.as_table()["rate"] == "2997/100"
    assert "width" not in Outer().as_table()


@pytest.mark.parametrize("number", [np.float32(2), np.float64(2), np.int64(2), Fraction(2)])
def test_numbers_of_numpy_are_plain_numbers(number: Any) -> None:
    params = SomeParams()
    gain = params.replaced(gain=number).gain
    assert (type(gain), gain) == (float, 2)
    cell = params.replaced(cell=np.int64(2)).cell
    assert (type(cell), cell) == (int, 2)
    assert Outer(rate=number).rate == 2
    for wrong in (np.True_, "2"):
        with pytest.raises(ParameterError, match="gain' of some takes a number, not"):
            params.replaced(gain=wrong)
    with pytest.raises(ParameterError, match="cell' of some takes a whole number or 'auto', not"):
        params.replaced(cell=np.float32(2))
    with pytest.raises(StimulusError, match="rate takes a number or a fraction such as"):
        Outer(rate=np.True_)  # type: ignore[arg-type]


@pytest.mark.parametrize("rate", [29.97, np.float32(29.97), np.float64(29.97)])
def test_a_fraction_has_the_decimals_that_are_written(rate: Any) -> None:
    assert Outer(rate=rate).rate == Fraction(2997, 100)


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({"inner": {}}, "a.toml: inner: size is missing; add it"),
        ({"inner": {"size": 0}}, "a.toml: inner: size must be above 0 px, not 0"),
        ({"inner": 3}, "a.toml: inner must be a table of keys, not 3"),
        ({"conut": 3}, "a.toml: unknown key 'conut'; did you mean 'count'?"),
        ({"count": True}, "a.toml: count takes a whole number, not true"),
        ({"count": 10**400}, "a.toml: count must be a finite number, not inf"),
        ({"place": [0, 2]}, "a.toml: place must be at most 1, not 2"),
        ({"place": [0]}, "a.toml: place takes a list of 2 values, not 1"),
        ({"kind": "dsik"}, "a.toml: kind = 'dsik' is not known; did you mean 'disk'?"),
        ({"kind": "bar"}, "a.toml: kind 'bar' needs width; add it"),
        ({"width": 2}, "a.toml: width is not a key of kind 'disk' but of bar; remove it"),
        ({"rate": "fast"}, "a.toml: rate takes a number or a fraction such as '30000/1001'"),
    ],
)
def test_mistakes_name_the_file_the_key_and_the_remedy(table: dict[str, Any], message: str) -> None:
    with pytest.raises(StimulusError) as caught:
        Outer.from_table(table, "a.toml")
    assert str(caught.value).startswith(message)


def test_parameters_name_themselves_and_their_set() -> None:
    for values, message in (
        ({"gain": -1}, "parameter 'gain' of some must be at least 0, not -1"),
        ({"gain": -1.0000001}, "parameter 'gain' of some must be at least 0, not -1.0000001"),
        ({"gain": None}, "parameter 'gain' of some takes a number, not None"),
        ({"cell": "x"}, "parameter 'cell' of some takes a whole number or 'auto', not 'x'"),
        ({"cel": 1}, "no parameter 'cel' of some; did you mean 'cell'?"),
    ):
        with pytest.raises(ParameterError) as caught:
            SomeParams().replaced(**values)
        assert str(caught.value) == message
    assert SomeParams().as_dict() == {"gain": 1.0, "cell": None}
    assert SomeParams().resolved(240) == SomeParams()


def test_texts_become_lists_and_wrong_texts_are_named() -> None:
    @dataclass(frozen=True, kw_only=True)
    class Listed(Parameters):
        band: tuple[float, float] = parameter((0.0, 1.0), "band", unit="px")
        words: tuple[str, ...] = parameter((), "words")
        rate: Fraction = parameter(Fraction(30), "rate")

    for name, text, value in (
        ("band", "0.5,2", (0.5, 2.0)),
        ("band", "[1, 2]", (1.0, 2.0)),
        ("words", "['a', \"b\"]", ("a", "b")),
        ("words", "", ()),
        ("rate", "30000/1001", Fraction(30000, 1001)),
    ):
        changed = Listed().replaced(**{name: Listed().parsed(name, text)})
        assert getattr(changed, name) == value
    for name, text, message in (
        ("band", "wide", "takes a [number, number], not 'wide'"),
        ("band", "1,2,3", "takes a list of 2 values, not 3"),
        ("band", "60deg", "takes a [number, number], not '60deg'"),  # no size in px
        ("rate", "1/0", "takes a number or a fraction such as '30000/1001', not '1/0'"),
    ):
        assert Listed().angle(name, text) is None
        with pytest.raises(ParameterError) as caught:
            Listed().replaced(**{name: Listed().parsed(name, text)})
        assert str(caught.value) == f"parameter '{name}' of listed {message}"


def odd(name: str, kind: Any) -> type:
    fields = [(name, kind, parameter(1, "meaning"))]
    return make_dataclass("Odd", fields, bases=(Parameters,), frozen=True, kw_only=True)


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        (Literal["dark", "bright"], "typing.Literal['dark', 'bright']"),
        (int | float, "int | float"),
        (list[float], "list[float]"),
        (tuple[int, float], "[whole number, number]"),
        (np.ndarray, "<class 'numpy.ndarray'>"),
    ],
)
def test_a_type_that_no_setting_can_have_is_refused(kind: Any, words: str) -> None:
    with pytest.raises(ParameterError) as caught:
        odd("a", kind)()
    assert str(caught.value) == (
        f"Odd.a cannot be of the type {words}; declare it as float, int, bool, str (with "
        "choices, if it is one of a few words), Fraction, or a tuple of one of these"
    )


def test_a_name_that_a_method_has_is_refused() -> None:
    with pytest.raises(ParameterError, match=r"Odd\.names has the name of a method"):
        odd("names", int)()


def test_what_a_value_may_be_in_words() -> None:
    @dataclass(frozen=True, kw_only=True)
    class Bounded(Parameters):
        seed: int = parameter(0, "seed", low=0, high=2**32 - 1)
        share: float = parameter(0.5, "share", above=0, high=1e6)
        name: str = parameter("", "name")

    words = [declared.allowed for declared in (*Bounded.declared(), Outer.declared()[0])]
    assert words == ["0 to 4294967295", "above 0, at most 1e+06", "", "disk, bar"]
    with pytest.raises(ParameterError, match="at most 4294967295, not 4294967296"):
        Bounded(seed=2**32)


def test_the_unit_of_a_value_is_that_at_the_end_of_its_name() -> None:
    @dataclass(frozen=True, kw_only=True)
    class Units(DeclaredTable):
        speed_deg_s: float = parameter(0.0, "longest end first")
        speed_m_s: float = parameter(0.0, "not s, nor m")
        zoom_per_s: float = parameter(0.0, "a rate")
        sigma_s: float = parameter(1.0, "a pure number by its own declaration", unit="")
        sigma_m: float = parameter(1.0, "another unit", unit="px")
        gain: float = parameter(1.0, "no unit")

    units = [declared.unit for declared in Units.declared()]
    assert units == ["deg/s", "m/s", "1/s", "", "px", ""]


def test_the_docstring_of_a_table_describes_its_values() -> None:
    @dataclass(frozen=True, kw_only=True)
    class Described(Parameters):
        """A set.

        Examples
        --------
        >>> 1
        1
        """

        size_m: float = parameter(1.5, "the size", above=0)
        cell: int | None = parameter(None, "a cell")

    described = [
        *("A set.", "", "Parameters", "----------"),
        *("size_m : number, default 1.5", "    the size (above 0, m)."),
        *("cell : whole number or None", "    a cell.", ""),
        *("Examples", "--------", ">>> 1", "1"),
    ]
    assert (Described.__doc__ or "").splitlines() == described
    assert Described().__doc__ == Described.__doc__
    assert "later : table or None\n    another table." in (Early.__doc__ or "")
    assert (Motion.__doc__ or "").startswith(
        "How a shape, a pattern or the complete scene moves.\n"
    )
    assert (Parameters.__doc__ or "").count("Parameters\n") == 0


def test_every_declaration_is_described() -> None:
    gain, cell = SomeParams.declared()
    assert (gain.name, gain.words, gain.optional, gain.unit, gain.low) == (
        *("gain", "number", False, "px"),
        0,
    )
    assert (cell.words, cell.optional, cell.default, cell.high) == ("whole number", True, None, 10)
    assert [declared.words for declared in Outer.declared()] == [
        *("text", "whole number", "number or fraction", "[number, number]", "number", "table")
    ]


def test_declarations_need_no_numpy() -> None:
    assert loaded("import oppload_cli.schema", "numpy") == []
