"""Which parameter of a stimulus is swept, and over which values."""

from __future__ import annotations

import math
import tomllib
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from oppload_cli.errors import ParameterError, StimulusError, suggestion
from oppload_cli.stimulus.catalogue import find

if TYPE_CHECKING:
    from collections.abc import Sequence

    from oppload_cli.stimulus.catalogue import Entry

# What a user may say instead of a key, and the keys that it may mean, with {id} for an object.
WORDS = {
    "axis": ("{id}.axis_deg", "scene.rotation_deg"),
    "direction": ("scene.rotation_deg",),
    "speed": ("{id}.growth.speed_deg_s", "{id}.motion.speed_deg_s"),
    "width": ("{id}.width_deg",),
    "size": ("{id}.size_deg",),
    "l/v": ("{id}.growth.l_over_v_ms",),
    "position": ("{id}.centre_deg", "scene.centre_deg"),
}
MOST_VALUES = 1000


def entry_named(name: str) -> Entry:
    """Find the one stimulus to tune over.

    Parameters
    ----------
    name : str
        Of the catalogue, or a TOML file.

    Returns
    -------
    Entry

    Raises
    ------
    StimulusError
        If there is none, or if the name is a pattern for several.
    """
    found = find(name)
    if len(found) > 1:
        raise StimulusError(
            f"'{name}' stands for {len(found)} stimuli; name one, such as '{found[0].name}'"
        )
    return found[0]


def swept(entry: Entry, over: Sequence[str]) -> Entry:
    """Choose what a stimulus is swept over.

    Parameters
    ----------
    entry : Entry
        The stimulus with its own sweep, if it has one.
    over : sequence of str
        ``PARAMETER`` of its own sweep, or ``PARAMETER=VALUES``; nothing keeps its
        own sweep. A parameter is a key such as ``bar.axis_deg`` or one of `WORDS`.

    Returns
    -------
    Entry

    Raises
    ------
    ParameterError
        If a parameter or its values cannot be understood.
    StimulusError
        If nothing is swept.
    """
    if not over:
        if not entry.sweep:
            raise StimulusError(
                f"{entry.name}: has no sweep of its own; name one, e.g. --over speed=10,20,40"
            )
        return entry
    chosen: dict[str, list[Any]] = {}
    for text in over:
        word, equals, values = text.partition("=")
        key = key_of(entry, word.strip())
        if not equals and key not in entry.sweep:
            raise ParameterError(
                f"--over {text}: {entry.name} has no values of its own for '{key}'; "
                f"give some, e.g. --over {text}=10,20,40 or {text}=0:330:30"
            )
        chosen[key] = values_of(text, values) if equals else entry.sweep[key]
    # Settings are checked as the protocols are made; one that names no table fails here.
    return replace(entry.with_settings({key: chosen[key][0] for key in chosen}), sweep=chosen)


def key_of(entry: Entry, word: str) -> str:
    """Return the dotted key that a word means in a stimulus.

    Parameters
    ----------
    entry : Entry
        The stimulus.
    word : str
        One of `WORDS`, or a dotted key, which is returned as it is.

    Returns
    -------
    str

    Raises
    ------
    ParameterError
        If the word is unknown, or means nothing or several things here.
    """
    if "." in word:
        return word
    if word not in WORDS:
        hint = suggestion(word, WORDS)
        raise ParameterError(f"--over {word}: no parameter '{word}'{hint}; or a key as ID.size_deg")
    objects = [one for one in entry.table.get("object", []) if isinstance(one, dict)]
    meant = [pattern.format(id=one.get("id")) for one in objects for pattern in WORDS[word]]
    own = [key for key in dict.fromkeys(meant) if key in entry.sweep]
    if len(own) == 1:
        return own[0]
    if word in {"axis", "direction"}:
        return "scene.rotation_deg"
    if len(objects) > 1 and word == "position":
        return "scene.centre_deg"
    keys = list(dict.fromkeys(key for key in meant if _stated(objects, key)))
    if len(keys) != 1:
        found = f"is {' or '.join(keys)}" if keys else "is not among its keys"
        raise ParameterError(f"--over {word}: in {entry.name} that {found}; write a key in full")
    return keys[0]


def values_of(text: str, values: str) -> list[Any]:
    """Read the values of a sweep.

    Parameters
    ----------
    text : str
        The whole option, for the message.
    values : str
        ``10,20,40``, ``0:330:30`` (from, to, step; both ends included), or a list as
        in TOML, such as ``[[0,0],[10,0]]``.

    Returns
    -------
    list
        At least one value.

    Raises
    ------
    ParameterError
        If they cannot be read.
    """
    try:
        if values.count(":") == 2:
            listed = _range(*(float(end) for end in values.split(":")))
        else:
            stated = values if values.strip().startswith("[") else f"[{values}]"
            listed = tomllib.loads(f"values = {stated}")["values"]
    except ValueError:
        listed = []
    if not listed:
        raise ParameterError(
            f"--over {text}: its values cannot be read; "
            f"write 10,20,40 or 0:330:30 (from, to, step) or [[0,0],[10,0]]"
        )
    return listed


def _range(first: float, last: float, step: float) -> list[Any]:
    count = math.floor((last - first) / step + 1e-9) + 1 if step else 0
    if not 1 <= count <= MOST_VALUES:
        return []
    values = [first + index * step for index in range(count)]
    return [int(value) if value.is_integer() else value for value in values]


def _stated(objects: Sequence[dict[str, Any]], key: str) -> bool:
    """Tell whether the file states a value for a key of one of its objects."""
    first, *rest = key.split(".")
    value: Any = next((one for one in objects if one.get("id") == first), None)
    for word in rest:
        value = value.get(word) if isinstance(value, dict) else None
    # An object that says nothing of its place is in the middle.
    return value is not None or (rest == ["centre_deg"] and first != "scene")
