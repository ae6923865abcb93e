"""Tables of a protocol: keys with a type, a range and a meaning, declared once.

One declaration feeds the Python objects, the reading of TOML, the messages, the
JSON Schema and the reference in ``docs/stimuli.md``.
"""

from __future__ import annotations

import math
import typing
from dataclasses import MISSING, Field, dataclass, field, fields
from fractions import Fraction
from types import NoneType
from typing import Any, Self

from oppload_cli.errors import StimulusError, suggestion


def key(
    meaning: str,
    *,
    default: Any = MISSING,
    unit: str = "",
    low: float | None = None,
    above: float | None = None,
    high: float | None = None,
    choices: tuple[str, ...] = (),
    kinds: tuple[str, ...] = (),
    needed_by: tuple[str, ...] = (),
) -> Any:
    """Declare one key of a :class:`Table`.

    Parameters
    ----------
    meaning : str
        One line for the user.
    default : object
        Its default; without one the key must be given.
    unit : str
        Unit of the value, empty for a pure number.
    low, above, high : float or None
        Closed lower, open lower and closed upper bound, of each number in the value.
    choices : tuple of str
        The only words allowed, where there are only some.
    kinds : tuple of str
        The kinds of the table that take this key; empty for all of them.
    needed_by : tuple of str
        The kinds that cannot do without it.

    Returns
    -------
    object
        A dataclass field that carries all this as metadata.
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
    if default is MISSING:
        return field(metadata=metadata)
    return field(default=default, metadata=metadata)


# resolved once: evaluating the annotations takes longer than checking the values
_HINTS: dict[type[Any], dict[str, Any]] = {}


def hints(cls: type[Any]) -> dict[str, Any]:
    """Return the resolved types of a table's keys.

    Parameters
    ----------
    cls : type
        A :class:`Table` class.

    Returns
    -------
    dict of str to type
    """
    if cls not in _HINTS:
        _HINTS[cls] = typing.get_type_hints(cls)
    return _HINTS[cls]


def members(hint: Any) -> tuple[Any, bool]:
    """Split an optional type.

    Parameters
    ----------
    hint : type
        A type such as ``float`` or ``float | None``.

    Returns
    -------
    type
        The type without None.
    bool
        Whether None was among it.
    """
    arguments = typing.get_args(hint)
    if NoneType not in arguments:
        return hint, False
    return next(one for one in arguments if one is not NoneType), True


@dataclass(frozen=True, kw_only=True)
class Table:
    """Base of all tables of a protocol: converts and checks each value when it is made."""

    def __post_init__(self) -> None:
        for declared in fields(self):
            value = _converted(
                hints(type(self))[declared.name], getattr(self, declared.name), declared.name
            )
            _check(declared, value)
            object.__setattr__(self, declared.name, value)
        self._check_kind()

    def _check_kind(self) -> None:
        kind = getattr(self, "kind", None)
        for declared in fields(self) if kind else ():
            value = getattr(self, declared.name)
            takers = declared.metadata["kinds"]
            if takers and kind not in takers and value != declared.default:
                raise StimulusError(
                    f"{declared.name} is not a key of kind '{kind}' but of {', '.join(takers)}; "
                    "remove it or change the kind"
                )
            if kind in declared.metadata["needed_by"] and value is None:
                raise StimulusError(f"kind '{kind}' needs {declared.name}; add it")

    @classmethod
    def from_table(cls, table: object, where: str) -> Self:
        """Build from what a TOML file holds.

        Parameters
        ----------
        table : object
            Should be a dict, keys as declared.
        where : str
            The file and the table, for the messages.

        Returns
        -------
        Table
            Of this class.

        Raises
        ------
        StimulusError
            If a key is unknown (the nearest one is suggested), missing, of the wrong
            type or out of its range.
        """
        if not isinstance(table, dict):
            raise StimulusError(f"{where} must be a table of keys, not {table!r}")
        known = [declared.name for declared in fields(cls)]
        for name in table:
            if name not in known:
                raise StimulusError(f"{where}: unknown key '{name}'{suggestion(str(name), known)}")
        for declared in fields(cls):
            if declared.name not in table and declared.default is MISSING:
                raise StimulusError(f"{where}: {declared.name} is missing; add it")
        values = {name: _nested(cls, name, value, where) for name, value in table.items()}
        try:
            return cls(**values)
        except StimulusError as problem:
            raise StimulusError(f"{where}: {problem}") from None

    def as_table(self) -> dict[str, Any]:
        """Return the values by key, defaults included, ready for JSON or TOML.

        Returns
        -------
        dict
            Keys that have no value are left out.
        """
        plain = {declared.name: _plain(getattr(self, declared.name)) for declared in fields(self)}
        return {name: value for name, value in plain.items() if value is not None}


def _nested(cls: type[Table], name: str, value: object, where: str) -> object:
    hint, _ = members(hints(cls)[name])
    if isinstance(hint, type) and issubclass(hint, Table):
        return hint.from_table(value, f"{where}: {name}")
    return value


def _plain(value: object) -> object:
    if isinstance(value, Table):
        return value.as_table()
    if isinstance(value, tuple):
        return [_plain(one) for one in value]
    if isinstance(value, Fraction):
        return f"{value.numerator}/{value.denominator}"
    return value


def _converted(hint: Any, value: Any, label: str) -> Any:
    hint, optional = members(hint)
    if value is None and optional:
        return None
    if typing.get_origin(hint) is tuple:
        return _converted_list(hint, value, label)
    if hint is Fraction:
        return _fraction(value, label)
    if hint is float and isinstance(value, int) and not isinstance(value, bool):
        value = float(value)
    if not isinstance(value, hint) or (isinstance(value, bool) and hint is not bool):
        raise StimulusError(f"{label} takes {_WORDS.get(hint, hint.__name__)}, not {value!r}")
    return value


def _converted_list(hint: Any, value: Any, label: str) -> tuple[Any, ...]:
    arguments = typing.get_args(hint)
    if not isinstance(value, list | tuple):
        raise StimulusError(f"{label} takes a list, not {value!r}")
    if arguments[-1] is not Ellipsis and len(value) != len(arguments):
        raise StimulusError(f"{label} takes a list of {len(arguments)} values, not {len(value)}")
    return tuple(_converted(arguments[0], one, label) for one in value)


def _fraction(value: Any, label: str) -> Fraction:
    if isinstance(value, Fraction):
        return value
    try:
        if isinstance(value, bool):
            raise TypeError
        # repr, so that 29.97 is 2997/100 and not the binary number next to it
        return Fraction(value if isinstance(value, str) else repr(value))
    except (ValueError, TypeError, ZeroDivisionError):
        raise StimulusError(
            f"{label} takes a number or a fraction such as '30000/1001', not {value!r}"
        ) from None


_WORDS = {int: "a whole number", float: "a number", str: "a text", bool: "true or false"}


def _check(declared: Field[Any], value: object) -> None:
    choices = declared.metadata["choices"]
    if choices and value is not None and value not in choices:
        raise StimulusError(
            f"{declared.name} = '{value}' is not known{suggestion(str(value), choices)}"
        )
    for number in _numbers(value):
        _check_range(declared, number)


def _numbers(value: object) -> list[float | Fraction]:
    if isinstance(value, tuple):
        return [number for one in value for number in _numbers(one)]
    if isinstance(value, int | float | Fraction) and not isinstance(value, bool):
        return [value]
    return []


def _check_range(declared: Field[Any], number: float | Fraction) -> None:
    metadata = declared.metadata
    unit = f" {metadata['unit']}" if metadata["unit"] else ""
    if not math.isfinite(number):
        raise StimulusError(f"{declared.name} must be a finite number, not {number}")
    low, above, high = metadata["low"], metadata["above"], metadata["high"]
    wanted = ""
    if low is not None and number < low:
        wanted = f"at least {low:g}{unit}"
    elif above is not None and number <= above:
        wanted = f"above {above:g}{unit}"
    elif high is not None and number > high:
        wanted = f"at most {high:g}{unit}"
    if wanted:
        raise StimulusError(f"{declared.name} must be {wanted}, not {float(number):g}")
