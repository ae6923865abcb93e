"""Frozen parameter sets that check themselves.

One definition of a parameter (name, default, range, unit, meaning) feeds the
Python API, the TOML configuration, ``--set``, ``oppload models`` and the sidecar.
"""

from __future__ import annotations

import math
import typing
from dataclasses import dataclass, field, fields, replace
from functools import cache
from types import NoneType, UnionType
from typing import Any, Self

from oppload_cli.errors import ParameterError, suggestion


def parameter(
    default: Any,
    meaning: str,
    *,
    unit: str = "",
    low: float | None = None,
    high: float | None = None,
    choices: tuple[object, ...] = (),
) -> Any:
    """Declare one parameter of a :class:`Parameters` class.

    Parameters
    ----------
    default : object
        Its default value; None stands for "follows from the working size".
    meaning : str
        One line for the user.
    unit : str
        Unit of the value, empty for a pure number.
    low, high : float or None
        Closed range of a number.
    choices : tuple
        The only values allowed, where there are only some.

    Returns
    -------
    object
        A dataclass field that carries all this as metadata.
    """
    metadata = {"meaning": meaning, "unit": unit, "low": low, "high": high, "choices": choices}
    return field(default=default, metadata=metadata)


@dataclass(frozen=True, kw_only=True)
class Parameters:
    """Base of all parameter sets: checks every value when it is made."""

    def __post_init__(self) -> None:
        for declared in fields(self):
            self._check(declared.name, getattr(self, declared.name))

    @classmethod
    def names(cls) -> tuple[str, ...]:
        """Return the names of the parameters, in the order of their definition.

        Returns
        -------
        tuple of str
            As the fields are called.
        """
        return tuple(declared.name for declared in fields(cls))

    @classmethod
    @cache
    def kinds(cls) -> dict[str, tuple[type, ...]]:
        """Return the Python types that each parameter takes.

        Returns
        -------
        dict of str to tuple of type
            ``NoneType`` among them where None is a value.
        """
        hints = typing.get_type_hints(cls)
        return {name: _members(hints[name]) for name in cls.names()}

    def replaced(self, **values: object) -> Self:
        """Return a copy with some values changed.

        Parameters
        ----------
        **values
            New values by parameter name.

        Returns
        -------
        Self
            The copy.

        Raises
        ------
        ParameterError
            If a name is unknown (the nearest one is suggested) or a value is
            out of range.
        """
        for name in values:
            self._known(name)
        return replace(self, **values)

    def parsed(self, name: str, text: str) -> object:
        """Turn the text of a command line into a value of parameter `name`.

        Parameters
        ----------
        name : str
            The parameter.
        text : str
            The value as written, e.g. ``"200"``, ``"5x5"`` or ``"none"``.

        Returns
        -------
        object
            The value; its range is checked when it is set.

        Raises
        ------
        ParameterError
            If the name is unknown or the text is not of the parameter's type.
        """
        self._known(name)
        kinds = self.kinds()[name]
        if NoneType in kinds and text.lower() in {"none", "auto"}:
            return None
        for kind in (int, float):
            if kind in kinds:
                try:
                    return kind(text)
                except ValueError:
                    continue
        if str in kinds:
            return text
        wanted = _described(kinds)
        raise ParameterError(f"{self._label(name)} takes {wanted}, not '{text}'")

    def as_dict(self) -> dict[str, object]:
        """Return the values by name, ready for JSON or TOML.

        Returns
        -------
        dict
        """
        return {name: getattr(self, name) for name in self.names()}

    @classmethod
    def _label(cls, name: str) -> str:
        return f"parameter '{name}' of {cls.__name__.removesuffix('Params').lower()}"

    @classmethod
    def _known(cls, name: str) -> None:
        if name not in cls.names():
            raise ParameterError(f"no {cls._label(name)}{suggestion(name, cls.names())}")

    @classmethod
    def _check(cls, name: str, value: object) -> None:
        kinds = cls.kinds()[name]
        accepted = (*kinds, int) if float in kinds else kinds
        if isinstance(value, bool) != (bool in kinds) or not isinstance(value, accepted):
            wanted = _described(kinds)
            raise ParameterError(f"{cls._label(name)} takes {wanted}, not {value!r}")
        metadata = next(declared.metadata for declared in fields(cls) if declared.name == name)
        if metadata["choices"] and value not in metadata["choices"]:
            allowed = " or ".join(str(choice) for choice in metadata["choices"])
            raise ParameterError(f"{cls._label(name)} must be {allowed}, not {value}")
        if isinstance(value, int | float):
            _check_range(cls._label(name), value, metadata["low"], metadata["high"])


def _check_range(label: str, value: float, low: float | None, high: float | None) -> None:
    if not math.isfinite(value):
        raise ParameterError(f"{label} must be a finite number, not {value}")
    if low is not None and value < low:
        raise ParameterError(f"{label} must be at least {low:g}, not {value:g}")
    if high is not None and value > high:
        raise ParameterError(f"{label} must be at most {high:g}, not {value:g}")


def _members(hint: Any) -> tuple[type, ...]:
    return typing.get_args(hint) if isinstance(hint, UnionType) else (hint,)


def _described(kinds: tuple[type, ...]) -> str:
    words = {int: "a whole number", float: "a number", str: "a word", NoneType: "none"}
    return " or ".join(words.get(kind, kind.__name__) for kind in kinds)
