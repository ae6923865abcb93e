"""Frozen tables of declared values; a table converts and checks each value that it gets.

A value is declared once, with its type, default, unit, range and meaning. This declaration serves
the Python API, TOML files, ``--set``, ``oppload models``, the JSON Schema of protocols, the
documentation and the sidecar. This module does not need NumPy.
"""

from __future__ import annotations

import math
import numbers
import re
import typing
from dataclasses import MISSING, dataclass, field, fields, replace
from fractions import Fraction
from functools import cache
from types import NoneType
from typing import Any, ClassVar, Self

from oppload_cli.errors import OpploadError, ParameterError, StimulusError, suggestion

REQUIRED: Any = MISSING
_WORDS = {
    int: "whole number",
    float: "number",
    str: "text",
    bool: "true or false",
    Fraction: "number or fraction",
}


def parameter(
    default: Any,
    meaning: str,
    *,
    unit: str = "",
    low: float | None = None,
    above: float | None = None,
    high: float | None = None,
    choices: tuple[object, ...] = (),
    kinds: tuple[str, ...] = (),
    needed_by: tuple[str, ...] = (),
) -> Any:
    """Declare one value of a :class:`Table`, in place of a dataclass field.

    Parameters
    ----------
    default : object
        The default; :data:`REQUIRED` if the value must be given. None means that the value follows
        from something else, such as the working size.
    meaning : str
        One line for the user.
    unit : str
        Unit of the value, empty for a pure number.
    low, above, high : float or None
        Bounds of each number in the value: at least `low`, more than `above`, at most `high`.
    choices : tuple
        The allowed values; empty if all are allowed.
    kinds : tuple of str
        The kinds of the table that take this value; empty for all kinds.
    needed_by : tuple of str
        The kinds of the table that need this value.

    Examples
    --------
    >>> from dataclasses import dataclass
    >>> import oppload_cli as oppload
    >>> @dataclass(frozen=True, kw_only=True)
    ... class EdgeParams(oppload.Parameters):
    ...     least: float = oppload.parameter(0.02, "least change of a pixel", low=0, high=1)
    >>> EdgeParams().least
    0.02
    """
    metadata = {
        "meaning": meaning,
        "unit": unit,
        "low": low,
        "above": above,
        "high": high,
        "choices": choices,
        "kinds": kinds,
        "needed_by": needed_by,
    }
    return field(default=default, metadata=metadata)


@dataclass(frozen=True)
class Parameter:
    """The description of one declared value; see :func:`parameter`.

    Attributes
    ----------
    type : type
        The type of the value, without None.
    optional : bool
        Whether None is allowed.
    """

    name: str
    type: Any
    optional: bool
    default: Any
    meaning: str
    unit: str
    low: float | None
    above: float | None
    high: float | None
    choices: tuple[object, ...]
    kinds: tuple[str, ...]
    needed_by: tuple[str, ...]

    @property
    def words(self) -> str:
        """The type in words, such as ``list of numbers``."""
        return _in_words(self.type)

    @property
    def table(self) -> type[Table] | None:
        """The type if the value is itself a table, else None."""
        return self.type if _is_table(self.type) else None


@dataclass(frozen=True, kw_only=True)
class Table:
    """Base of all tables: converts and checks each value when the table is made."""

    _error: ClassVar[type[OpploadError]] = StimulusError
    _units: ClassVar[bool] = True  # whether messages name the unit of a bound
    _none: ClassVar[str] = ""

    def __post_init__(self) -> None:
        for each in self.declared():
            value = self._checked(each, getattr(self, each.name))
            object.__setattr__(self, each.name, value)
        self._check_kind()

    @classmethod
    @cache
    def declared(cls) -> tuple[Parameter, ...]:
        """Return the descriptions of all values, in the order of their declaration."""
        hints = typing.get_type_hints(cls)
        for each in fields(cls):
            if not each.metadata:
                raise cls._error(
                    f"{cls.__name__}.{each.name} is declared without a meaning; write "
                    f"{each.name}: ... = parameter(default, meaning)"
                )
        return tuple(
            Parameter(each.name, *_without_none(hints[each.name]), each.default, **each.metadata)
            for each in fields(cls)
        )

    @classmethod
    @cache
    def names(cls) -> tuple[str, ...]:
        """Return the names of all values, in the order of their declaration."""
        return tuple(each.name for each in fields(cls))

    @classmethod
    def from_table(cls, table: object, where: str) -> Self:
        """Build a table from the contents of a TOML file.

        Parameters
        ----------
        table : object
            The contents; it should be a dict with declared keys.
        where : str
            Names of the file and of the table, for messages.

        Raises
        ------
        OpploadError
            If a key is unknown (the message suggests the nearest one) or missing, or if a value
            has a wrong type or is out of its range.
        """
        if not isinstance(table, dict):
            raise cls._error(f"{where} must be a table of keys, not {table!r}")
        known = {each.name: each for each in cls.declared()}
        for name in table:
            if name not in known:
                raise cls._error(f"{where}: unknown key '{name}'{suggestion(str(name), known)}")
        for name, each in known.items():
            if name not in table and each.default is REQUIRED:
                raise cls._error(f"{where}: {name} is missing; add it")
        nested = {name: known[name].table for name in table}
        values = {
            name: inner.from_table(table[name], f"{where}: {name}") if inner else table[name]
            for name, inner in nested.items()
        }
        try:
            return cls(**values)
        except OpploadError as problem:
            raise cls._error(f"{where}: {problem}") from None

    def as_dict(self) -> dict[str, Any]:
        """Return the values by name, for JSON."""
        return {name: _plain(getattr(self, name)) for name in self.names()}

    def as_table(self) -> dict[str, Any]:
        """Return the values by name, including defaults, without values that are None.

        :meth:`from_table` makes the same table from them.
        """
        return {name: value for name, value in self.as_dict().items() if value is not None}

    @classmethod
    def _label(cls, name: str) -> str:
        return name

    @classmethod
    def _checked(cls, each: Parameter, value: object) -> Any:
        if value is None and each.optional:
            return None
        value = cls._converted(each, each.type, value)
        if each.choices and value not in each.choices:
            raise cls._error(cls._refused_choice(each, value))
        for number in _numbers(value):
            cls._check_bounds(each, number)
        return value

    @classmethod
    def _converted(cls, each: Parameter, kind: Any, value: Any) -> Any:
        label = cls._label(each.name)
        if typing.get_origin(kind) is tuple:
            kinds = typing.get_args(kind)
            if not isinstance(value, list | tuple):
                raise cls._error(f"{label} takes a list, not {value!r}")
            if kinds[-1] is not Ellipsis and len(value) != len(kinds):
                raise cls._error(f"{label} takes a list of {len(kinds)} values, not {len(value)}")
            return tuple(cls._converted(each, kinds[0], one) for one in value)
        if kind is Fraction and not isinstance(value, Fraction):
            return cls._fraction(label, value)
        if not isinstance(value, bool):  # the classes of `numbers` include NumPy's numbers
            if kind is float and isinstance(value, numbers.Real):
                return _float(value)
            if kind is int and isinstance(value, numbers.Integral):
                return int(value)
        if not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool):
            raise cls._mistyped(each, kind, value)
        return value

    @classmethod
    def _mistyped(cls, each: Parameter, kind: Any, value: object) -> OpploadError:
        wanted = _in_words(kind) if kind is bool else f"a {_in_words(kind)}"
        none = cls._none if each.optional else ""
        return cls._error(f"{cls._label(each.name)} takes {wanted}{none}, not {value!r}")

    @classmethod
    def _fraction(cls, label: str, value: Any) -> Fraction:
        try:
            if isinstance(value, bool):
                raise TypeError
            # From `repr`, 29.97 becomes 2997/100, and not the nearest binary number.
            return parsed_fraction(value if isinstance(value, str) else repr(value))
        except (ValueError, TypeError, ZeroDivisionError):
            raise cls._error(
                f"{label} takes a number or a fraction such as '30000/1001', not {value!r}"
            ) from None

    @classmethod
    def _refused_choice(cls, each: Parameter, value: object) -> str:
        near = suggestion(str(value), [str(choice) for choice in each.choices])
        return f"{cls._label(each.name)} = '{value}' is not known{near}"

    @classmethod
    def _check_bounds(cls, each: Parameter, number: float | Fraction) -> None:
        label = cls._label(each.name)
        if not math.isfinite(_float(number)):
            raise cls._error(f"{label} must be a finite number, not {_float(number)}")
        wanted = ""
        if each.low is not None and number < each.low:
            wanted = f"at least {each.low:g}"
        elif each.above is not None and number <= each.above:
            wanted = f"above {each.above:g}"
        elif each.high is not None and number > each.high:
            wanted = f"at most {each.high:g}"
        if wanted:
            unit = f" {each.unit}" if each.unit and cls._units else ""
            raise cls._error(f"{label} must be {wanted}{unit}, not {float(number):g}")

    def _check_kind(self) -> None:
        kind = getattr(self, "kind", None)
        for each in self.declared():
            value = getattr(self, each.name)
            if each.kinds and kind not in each.kinds and value != each.default:
                raise self._error(
                    f"{each.name} is not a key of kind '{kind}' but of {', '.join(each.kinds)}; "
                    "remove it or change the kind"
                )
            if kind in each.needed_by and value is None:
                raise self._error(f"kind '{kind}' needs {each.name}; add it")


@dataclass(frozen=True, kw_only=True)
class Parameters(Table):
    """Base of the parameter sets, as of detectors or alarms; every value has a default.

    Examples
    --------
    >>> import oppload_cli as oppload
    >>> isinstance(oppload.DlgmdParams(), oppload.Parameters)
    True
    >>> oppload.DlgmdParams().replaced(threshold_limit=0.2).threshold_limit
    0.2
    """

    _error: ClassVar[type[OpploadError]] = ParameterError
    _units: ClassVar[bool] = False
    _none: ClassVar[str] = " or none"

    def resolved(self, height: int) -> Self:  # noqa: ARG002
        """Return these parameters with the values that depend on the video filled in.

        Parameters
        ----------
        height : int
            Working height in pixels: the shorter side of the frame.

        Returns
        -------
        Self
            The same object if no parameter depends on the video.
        """
        return self

    def replaced(self, **values: object) -> Self:
        """Return a copy with some values changed.

        Raises
        ------
        ParameterError
            If a name is unknown (the message suggests the nearest one) or a value is out of range.
        """
        for name in values:
            self._known(name)
        return replace(self, **values)

    def parsed(self, name: str, text: str) -> object:
        """Convert a text such as ``"200"`` or ``"none"`` to the type of a parameter.

        The range is not checked here, but when the value is set.

        Raises
        ------
        ParameterError
            If the name is unknown, or the text cannot be converted.
        """
        each = self._known(name)
        if each.optional and text.lower() in {"none", "auto"}:
            return None
        if each.type is str:
            return text
        try:
            # bool("false") would be True.
            return (
                ["false", "true"].index(text.lower()) == 1 if each.type is bool else each.type(text)
            )
        except ValueError:
            raise self._mistyped(each, each.type, text) from None

    def angle(self, name: str, value: object) -> float | None:
        """Return the angle in degrees if a size is given as a text such as ``"60deg"``.

        Returns
        -------
        float or None
            None for a value without ``deg``, and for parameters that are not sizes in pixels.

        Raises
        ------
        ParameterError
            If the name is unknown, or the angle is not above 0 and below 180 degrees.
        """
        unit = self._known(name).unit
        if unit != "px" or not isinstance(value, str) or not value.strip().endswith("deg"):
            return None
        try:
            degrees = float(value.strip().removesuffix("deg"))
        except ValueError:
            degrees = math.nan
        if not 0 < degrees < 180:
            raise ParameterError(
                f"{self._label(name)} must be above 0deg and below 180deg, not '{value}'"
            )
        return degrees

    @classmethod
    def _label(cls, name: str) -> str:
        words = re.sub(r"(?<=.)(?=[A-Z])", "_", cls.__name__.removesuffix("Params"))
        return f"parameter '{name}' of {words.lower()}"

    @classmethod
    def _known(cls, name: str) -> Parameter:
        known = {each.name: each for each in cls.declared()}
        if name not in known:
            raise ParameterError(f"no {cls._label(name)}{suggestion(name, known)}")
        return known[name]

    @classmethod
    def _refused_choice(cls, each: Parameter, value: object) -> str:
        allowed = " or ".join(str(choice) for choice in each.choices)
        return f"{cls._label(each.name)} must be {allowed}, not {value}"


def parsed_fraction(text: str) -> Fraction:
    """Return the value of a number or fraction, such as ``29.97`` or ``30000/1001``.

    Raises
    ------
    ValueError, ZeroDivisionError
        If the text is neither, or has more than 60 characters or an exponent of more than two
        digits: the exact fraction of 1e-999999999 would fill the memory.
    """
    if len(text) > 60 or re.search(r"[eE][+-]?[0-9_]{3}", text):
        raise ValueError("too long")
    return Fraction(text)


def _without_none(hint: Any) -> tuple[Any, bool]:
    """Split a hint such as ``float | None`` into the type and whether None is allowed."""
    members = typing.get_args(hint)
    if NoneType not in members:
        return hint, False
    return next(one for one in members if one is not NoneType), True


def _is_table(kind: Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, Table)


def _in_words(kind: Any) -> str:
    if typing.get_origin(kind) is tuple:
        members = typing.get_args(kind)
        if members[-1] is Ellipsis:
            return f"list of {_in_words(members[0])}s"
        return f"[{', '.join(_in_words(one) for one in members)}]"
    return "table" if _is_table(kind) else _WORDS.get(kind, str(kind))


def _plain(value: object) -> object:
    if isinstance(value, Table):
        return value.as_table()
    if isinstance(value, tuple):
        return [_plain(one) for one in value]
    if isinstance(value, Fraction):
        return f"{value.numerator}/{value.denominator}"
    return value


def _numbers(value: object) -> list[float | Fraction]:
    if isinstance(value, tuple):
        return [number for one in value for number in _numbers(one)]
    if isinstance(value, int | float | Fraction) and not isinstance(value, bool):
        return [value]
    return []


def _float(number: Any) -> float:
    try:
        return float(number)
    except OverflowError:
        return math.inf if number > 0 else -math.inf
