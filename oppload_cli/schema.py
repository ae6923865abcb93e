"""Frozen tables of declared values; a table converts and checks each value that it gets.

A value is declared once, with its type, default, unit, range and meaning. The Python API, TOML
files, ``--set``, ``oppload models``, the JSON Schema of protocols, the documentation and the
sidecar all use this declaration. This module does not need NumPy.
"""

from __future__ import annotations

import inspect
import math
import numbers
import re
import tomllib
import typing
from dataclasses import MISSING, dataclass, field, fields, replace
from fractions import Fraction
from functools import cache
from types import NoneType
from typing import TYPE_CHECKING, Any, ClassVar, Self

from oppload_cli.errors import OpploadError, ParameterError, StimulusError, faults_at, suggestion

if TYPE_CHECKING:
    from collections.abc import Iterator

REQUIRED: Any = MISSING  # in place of a default: the user must give the value
AUTO = "auto"  # files and the command line have no None; there, this word means None
_WORDS = {
    int: "whole number",
    float: "number",
    str: "text",
    bool: "true or false",
    Fraction: "number or fraction",
}
# Units by the end of a value's name; the first end that fits counts.
_UNITS = {
    "_deg_s": "deg/s",
    "_m_s2": "m/s2",
    "_m_s": "m/s",
    "_per_s": "1/s",
    "_deg": "deg",
    "_hz": "Hz",
    "_ms": "ms",
    "_m": "m",
    "_s": "s",
}


def parameter(
    default: Any,
    meaning: str,
    *,
    unit: str | None = None,
    low: float | None = None,
    above: float | None = None,
    high: float | None = None,
    choices: tuple[object, ...] = (),
    kinds: tuple[str, ...] = (),
    needed_by: tuple[str, ...] = (),
) -> Any:
    """Declare one value of a :class:`DeclaredTable`, in place of a dataclass field.

    Its type is float, int, bool, str, Fraction, a tuple of one of these, such as
    ``tuple[float, ...]``, or one of these or None.

    Parameters
    ----------
    default : object
        The default; :data:`REQUIRED` if there is none. None means that the value follows from
        another quantity, such as the working size.
    meaning : str
        One line for the user.
    unit : str or None
        Unit of the value, empty for a pure number; None for the unit at the end of the name, such
        as s in ``hold_s``, or else none.
    low, above, high : float or None
        Bounds of each number in the value: at least `low`, more than `above`, at most `high`.
    choices : tuple
        The allowed values; empty if all are allowed.
    kinds : tuple of str
        The kinds of the table that take this value; by default `needed_by`, or else all kinds.
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
        "kinds": kinds or needed_by,
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
    def allowed(self) -> str:
        """The choices or the range in words, such as ``0 to 1``; empty if there are none."""
        if self.choices:
            return ", ".join(map(str, self.choices))
        ends = {"at least": self.low, "above": self.above, "at most": self.high}
        exact = {word: _exact(end) for word, end in ends.items() if end is not None}
        if self.low is not None and self.high is not None:
            return f"{exact['at least']} to {exact['at most']}"
        return ", ".join(f"{word} {end}" for word, end in exact.items())

    @property
    def table(self) -> type[DeclaredTable] | None:
        """The type if the value is itself a table, else None."""
        return self.type if _is_table(self.type) else None


def _written(value: object) -> str:
    """Return a value as the user writes it in TOML, for messages."""
    return str(value).lower() if isinstance(value, bool) else repr(value)


def is_integer(value: Any, least: int) -> bool:
    """Return whether a value is a whole number (also one of NumPy) of at least `least`."""
    return isinstance(value, numbers.Integral) and int(value) >= least


def _exact(bound: float) -> str:
    """Return a bound as a text: short if this loses no digit, else with all digits."""
    short = f"{bound:g}"
    return short if float(short) == bound else f"{bound:.17g}"


class _Docstring:
    """The docstring of a table, with a section on its declared values, for `help` and the site."""

    def __init__(self, text: str) -> None:
        self._lines = inspect.cleandoc(text).splitlines()

    def __get__(self, table: object, kind: type[DeclaredTable]) -> str:
        lines = self._lines
        # `dataclass` reads the docstring before it sets `__match_args__`. At that time a type of a
        # value may be a class that is defined further down.
        if "__match_args__" in vars(kind) and kind.declared():
            first = (n - 1 for n, line in enumerate(lines) if line and set(line) == {"-"})
            end = next(first, len(lines))
            section = ["", "Parameters", "----------", *kind._parameter_lines(), ""]
            lines = ["\n".join(lines[:end]).rstrip(), *section, *lines[end:]]
        return "\n".join(lines)


@dataclass(frozen=True, kw_only=True)
class DeclaredTable:
    """Base of all tables: converts and checks each value when the table is made."""

    _error: ClassVar[type[OpploadError]] = StimulusError
    _units: ClassVar[bool] = True  # whether messages name the unit of a bound
    _none: ClassVar[str] = ""  # the end of a message on the type of an optional value

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        if cls.__doc__:
            cls.__doc__ = _Docstring(cls.__doc__)  # type: ignore[assignment]

    def __post_init__(self) -> None:
        for key in self.declared():
            value = self._checked(key, getattr(self, key.name))
            object.__setattr__(self, key.name, value)
        self._check_kind()

    @classmethod
    @cache
    def declared(cls) -> tuple[Parameter, ...]:
        """Return the descriptions of all values, in the order of their declaration."""
        hints = typing.get_type_hints(cls)
        declared = []
        for key in fields(cls):
            if not key.metadata:
                raise cls._error(
                    f"{cls.__name__}.{key.name} is declared without a meaning; write "
                    f"{key.name}: ... = parameter(default, meaning)"
                )
            facts = dict(key.metadata)
            if facts["unit"] is None:
                ends = (unit for end, unit in _UNITS.items() if key.name.endswith(end))
                facts["unit"] = next(ends, "")
            kind = _without_none(hints[key.name])
            if hasattr(Parameters, key.name):
                raise cls._error(
                    f"{cls.__name__}.{key.name} has the name of a method of its class; choose "
                    "another name"
                )
            if not _is_supported(kind[0]):
                raise cls._error(
                    f"{cls.__name__}.{key.name} cannot be of the type {_in_words(kind[0])}; "
                    "declare it as float, int, bool, str (with choices, if it is one of a few "
                    "words), Fraction, or a tuple of one of these"
                )
            declared.append(Parameter(key.name, *kind, key.default, **facts))
        return tuple(declared)

    @classmethod
    def _parameter_lines(cls) -> Iterator[str]:
        for key in cls.declared():
            plain = key.default is not REQUIRED and not isinstance(
                key.default, DeclaredTable | None
            )
            kind = f"{key.words} or None" if key.optional else key.words
            yield f"{key.name} : {kind}{f', default {key.default!r}' if plain else ''}"
            facts = ", ".join(filter(None, (key.allowed, key.unit)))
            yield f"    {key.meaning}{f' ({facts})' if facts else ''}."

    @classmethod
    @cache
    def names(cls) -> tuple[str, ...]:
        """Return the names of all values, in the order of their declaration."""
        return tuple(key.name for key in fields(cls))

    @classmethod
    def from_table(cls, table: object, where: str) -> Self:
        """Build a table from the contents of a TOML file.

        Parameters
        ----------
        table : object
            The contents, which should be a dict with declared keys.
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
        known = {key.name: key for key in cls.declared()}
        for name in table:
            if name not in known:
                hint = suggestion(str(name), cls._keys_of(table.get("kind")))
                raise cls._error(f"{where}: unknown key '{name}'{hint}")
        for name, key in known.items():
            if name not in table and key.default is REQUIRED:
                raise cls._error(f"{where}: {name} is missing; add it")
        values = {}
        for name, value in table.items():
            inner = known[name].table
            values[name] = inner.from_table(value, f"{where}: {name}") if inner else value
        with faults_at(where):
            return cls(**values)

    @classmethod
    def _keys_of(cls, kind: object) -> list[str]:
        """Return the keys that a kind of the table takes; all keys if there is no such kind."""
        keys = cls.declared()
        if not any(key.name == "kind" and kind in key.choices for key in keys):
            return [key.name for key in keys]
        return [key.name for key in keys if not key.kinds or kind in key.kinds]

    def as_dict(self) -> dict[str, Any]:
        """Return the values by name, for JSON."""
        return {name: _plain(getattr(self, name)) for name in self.names()}

    def as_table(self) -> dict[str, Any]:
        """Return the values by name, for :meth:`from_table`: with defaults, but without None."""
        return {name: value for name, value in self.as_dict().items() if value is not None}

    @classmethod
    def _label(cls, name: str) -> str:
        return name

    @classmethod
    def _checked(cls, declared: Parameter, value: object) -> Any:
        if value is None and declared.optional:
            return None
        value = cls._converted(declared, declared.type, value)
        if declared.choices and value not in declared.choices:
            raise cls._error(cls._refused_choice(declared, value))
        for number in _numbers(value):
            cls._check_bounds(declared, number)
        return value

    @classmethod
    def _converted(cls, declared: Parameter, kind: Any, value: Any) -> Any:
        label = cls._label(declared.name)
        if typing.get_origin(kind) is tuple:
            kinds = typing.get_args(kind)
            if not isinstance(value, list | tuple):
                raise cls._error(f"{label} takes a list, not {_written(value)}")
            if kinds[-1] is not Ellipsis and len(value) != len(kinds):
                raise cls._error(f"{label} takes a list of {len(kinds)} values, not {len(value)}")
            return tuple(cls._converted(declared, kinds[0], item) for item in value)
        if kind is Fraction and not isinstance(value, Fraction):
            return cls._fraction(label, value)
        if not isinstance(value, bool):  # NumPy's numbers are of the classes of `numbers` too
            if kind is float and isinstance(value, numbers.Real):
                return _float(value)
            if kind is int and isinstance(value, numbers.Integral):
                return int(value)
        if not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool):
            raise cls._mistyped(declared, kind, value)
        return value

    @classmethod
    def _mistyped(cls, declared: Parameter, kind: Any, value: object) -> OpploadError:
        wanted = _in_words(kind) if kind is bool else f"a {_in_words(kind)}"
        none = cls._none if declared.optional else ""
        return cls._error(
            f"{cls._label(declared.name)} takes {wanted}{none}, not {_written(value)}"
        )

    @classmethod
    def _fraction(cls, label: str, value: Any) -> Fraction:
        try:
            if isinstance(value, bool):
                raise TypeError
            # The text of 29.97 gives 2997/100; Fraction(29.97) is the nearest binary number.
            return parsed_fraction(str(value))
        except (ValueError, TypeError, ZeroDivisionError):
            raise cls._error(
                f"{label} takes a number or a fraction such as '30000/1001', not {_written(value)}"
            ) from None

    @classmethod
    def _refused_choice(cls, declared: Parameter, value: object) -> str:
        near = suggestion(str(value), [str(choice) for choice in declared.choices])
        return f"{cls._label(declared.name)} = '{value}' is not known{near}"

    @classmethod
    def _check_bounds(cls, declared: Parameter, number: float | Fraction) -> None:
        label = cls._label(declared.name)
        if not math.isfinite(_float(number)):
            raise cls._error(f"{label} must be a finite number, not {_float(number)}")
        wanted = ""
        if declared.low is not None and number < declared.low:
            wanted = f"at least {_exact(declared.low)}"
        elif declared.above is not None and number <= declared.above:
            wanted = f"above {_exact(declared.above)}"
        elif declared.high is not None and number > declared.high:
            wanted = f"at most {_exact(declared.high)}"
        if wanted:
            unit = f" {declared.unit}" if declared.unit and cls._units else ""
            # With all digits: 1.0000001 must not read as 1.
            number_text = str(float(number)).removesuffix(".0")
            raise cls._error(f"{label} must be {wanted}{unit}, not {number_text}")

    def _check_kind(self) -> None:
        kind = getattr(self, "kind", None)
        for key in self.declared():
            value = getattr(self, key.name)
            if key.kinds and kind not in key.kinds and value != key.default:
                raise self._error(
                    f"{key.name} is not a key of kind '{kind}' but of {', '.join(key.kinds)}; "
                    "remove it or change the kind"
                )
            if kind in key.needed_by and value is None:
                raise self._error(f"kind '{kind}' needs {key.name}; add it")


@dataclass(frozen=True, kw_only=True)
class Parameters(DeclaredTable):
    """Base of the parameter sets of detectors, alarms and others; every value has a default.

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
    _none: ClassVar[str] = f" or '{AUTO}'"
    _set: ClassVar[str] = ""  # name of the set in settings, if it differs from that of the class

    def resolved(self, height: int) -> Self:  # noqa: ARG002
        """Return these parameters with the values that depend on the video filled in.

        Parameters
        ----------
        height : int
            Working height in pixels: the shorter side of the frame.
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
            self._declared_as(name)
        return replace(self, **values)

    @classmethod
    def _checked(cls, declared: Parameter, value: object) -> Any:
        automatic = declared.optional and isinstance(value, str) and value == AUTO
        return super()._checked(declared, None if automatic else value)

    def parsed(self, name: str, value: object) -> object:
        """Convert a text such as ``"200"``, ``"0.5,0.3"`` or ``"auto"`` for a parameter.

        A value of another type stays as it is, but a number for a text becomes one.
        :meth:`replaced` checks type and range. Raises ParameterError if the name is unknown, or the
        text cannot be converted.
        """
        declared = self._declared_as(name)
        if not isinstance(value, str):
            is_number = isinstance(value, numbers.Real) and not isinstance(value, bool)
            return str(value) if declared.type is str and is_number else value
        text = value
        if declared.optional and text.lower() in {"none", AUTO}:
            return None
        if declared.type in {str, Fraction}:
            return text
        try:
            if declared.type is bool:  # bool("false") would be True
                return {"false": False, "true": True}[text.lower()]
            if typing.get_origin(declared.type) is tuple:
                listed = text if text.startswith("[") else f"[{text}]"
                return tomllib.loads(f"values = {listed}")["values"]
            return declared.type(text)
        except (KeyError, ValueError, TypeError):
            raise self._mistyped(declared, declared.type, text) from None

    def angle(self, name: str, value: object) -> float | None:
        """Return the degrees of a size that is given as a text such as ``"60deg"``.

        Returns None for a value without ``deg``, and for parameters that are not sizes in pixels.
        Raises ParameterError if the name is unknown, or the angle is not above 0 and below 180.
        """
        declared = self._declared_as(name)
        is_size = declared.unit == "px" and declared.type in {int, float}
        if not is_size or not isinstance(value, str) or not value.strip().endswith("deg"):
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
    @cache
    def _label(cls, name: str) -> str:
        words = re.sub(r"(?<=.)(?=[A-Z])", "_", cls.__name__.removesuffix("Params"))
        return f"parameter '{name}' of {cls._set or words.lower()}"

    @classmethod
    def _declared_as(cls, name: str) -> Parameter:
        known = {key.name: key for key in cls.declared()}
        if name not in known:
            raise ParameterError(f"no {cls._label(name)}{suggestion(name, known)}")
        return known[name]

    @classmethod
    def _refused_choice(cls, declared: Parameter, value: object) -> str:
        allowed = " or ".join(str(choice) for choice in declared.choices)
        return f"{cls._label(declared.name)} must be {allowed}, not {value}"


def parsed_fraction(text: str) -> Fraction:
    """Return the value of a number or fraction, such as ``29.97`` or ``30000/1001``.

    Raises
    ------
    ValueError, ZeroDivisionError
        If the text is neither, has more than 60 characters, or an exponent of more than two
        digits. The exact fraction of 1e-999999999 would fill the memory.
    """
    if len(text) > 60 or re.search(r"[eE][+-]?[0-9_]{3}", text):
        raise ValueError("too long")
    return Fraction(text)


def _without_none(hint: Any) -> tuple[Any, bool]:
    """Split a hint such as ``float | None`` into the type and whether None is allowed."""
    members = typing.get_args(hint)
    if NoneType not in members:
        return hint, False
    return next(member for member in members if member is not NoneType), True


def _is_supported(kind: Any) -> bool:
    if typing.get_origin(kind) is tuple:
        members = {member for member in typing.get_args(kind) if member is not Ellipsis}
        return len(members) == 1 and _is_supported(*members)
    return kind in _WORDS or _is_table(kind)


def _is_table(kind: Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, DeclaredTable)


def _in_words(kind: Any) -> str:
    if typing.get_origin(kind) is tuple:
        members = typing.get_args(kind)
        if members[-1] is Ellipsis:
            return f"list of {_in_words(members[0])}s"
        return f"[{', '.join(_in_words(member) for member in members)}]"
    return "table" if _is_table(kind) else _WORDS.get(kind, str(kind))


def _plain(value: object) -> object:
    if isinstance(value, DeclaredTable):
        return value.as_table()
    if isinstance(value, tuple):
        return [_plain(item) for item in value]
    if isinstance(value, Fraction):
        return f"{value.numerator}/{value.denominator}"
    return value


def _numbers(value: object) -> list[float | Fraction]:
    if isinstance(value, tuple):
        return [number for item in value for number in _numbers(item)]
    if isinstance(value, int | float | Fraction) and not isinstance(value, bool):
        return [value]
    return []


def _float(number: Any) -> float:
    try:
        return float(number)
    except OverflowError:
        return math.inf if number > 0 else -math.inf
