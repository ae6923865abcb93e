"""Sweeps and settings: values put into a protocol's table by dotted keys."""

from __future__ import annotations

import itertools
import re
import tomllib
from typing import Any

from oppload_cli.errors import StimulusError, suggestion

TABLES = ("display", "timing", "scene", "effects")
MOST_MEMBERS = 10_000


def sweep_of(table: object, where: str, prefix: str = "") -> dict[str, list[Any]]:
    """Read a ``[sweep]`` table.

    Parameters
    ----------
    table : object
        Lists by dotted key; dots may also nest tables.
    where : str
        The file, for the messages.
    prefix : str
        What the keys are nested in.

    Returns
    -------
    dict of str to list
        Values by dotted key.

    Raises
    ------
    StimulusError
        If a value is not a list, or has nothing in it.
    """
    if not isinstance(table, dict):
        raise StimulusError(f"{where}: sweep must be a table of lists, not {table!r}")
    flat: dict[str, list[Any]] = {}
    for key, value in table.items():
        name = f"{prefix}{key}"
        if isinstance(value, dict):
            flat.update(sweep_of(value, where, f"{name}."))
        elif not isinstance(value, list):
            raise StimulusError(f"{where}: sweep: {name} takes a list of values, not {value!r}")
        elif not value:
            raise StimulusError(f"{where}: sweep: {name} has no values; add some or remove it")
        else:
            flat[name] = value
    members = 1
    for values in flat.values():
        members *= len(values)
    if members > MOST_MEMBERS:
        raise StimulusError(f"{where}: sweep makes {members} stimuli; the most is {MOST_MEMBERS}")
    return flat


def expanded(sweep: dict[str, list[Any]]) -> list[dict[str, Any]]:
    """Return every combination of a sweep's values.

    Parameters
    ----------
    sweep : dict of str to list
        Values by dotted key.

    Returns
    -------
    list of dict
        One value for each key; one empty dict where there is no sweep.
    """
    return [dict(zip(sweep, chosen, strict=True)) for chosen in itertools.product(*sweep.values())]


def label_of(values: dict[str, Any]) -> str:
    """Return the part of a member's name that tells it from the others.

    Parameters
    ----------
    values : dict
        Values by dotted key.

    Returns
    -------
    str
        E.g. ``axis-45`` or ``speed-20_width-10``; fit for a file name.
    """
    leaves = [dotted.rpartition(".")[2] for dotted in values]
    names = leaves if len(set(leaves)) == len(leaves) else list(values)
    parts = [
        f"{_word(name)}-{_text(value)}" for name, value in zip(names, values.values(), strict=True)
    ]
    return "_".join(parts)


def with_value(table: dict[str, Any], dotted: str, value: object, where: str) -> dict[str, Any]:
    """Return a copy of a protocol's table with one value put in.

    Parameters
    ----------
    table : dict
        What a TOML file holds.
    dotted : str
        ``seed``, ``display.frame_rate``, ``ID.axis_deg``, ``ID.growth.speed_deg_s``, ...
        with ID that of an object.
    value : object
        The new value.
    where : str
        For the messages.

    Returns
    -------
    dict

    Raises
    ------
    StimulusError
        If the key's first word is neither a table nor an object.
    """
    first, _, rest = dotted.partition(".")
    if first in TABLES and rest:
        return {**table, first: _put(table.get(first, {}), rest, value, where)}
    if dotted in {"seed", "description", "source", "tags"}:
        return {**table, dotted: value}
    listed = table.get("object", [])
    objects = listed if isinstance(listed, list) else []
    ids = [str(one.get("id")) for one in objects if isinstance(one, dict)]
    if first not in ids or not rest:
        known = [*(f"{name}.KEY" for name in (*TABLES, *ids)), "seed"]
        hint = suggestion(first, (*TABLES, *ids, "seed")) if rest else ""
        hint = hint if "did you mean" in hint else f"; a key starts with {', '.join(known)}"
        raise StimulusError(f"{where}: no key '{dotted}'{hint}")
    changed = [
        _put(one, rest, value, where) if isinstance(one, dict) and one.get("id") == first else one
        for one in objects
    ]
    return {**table, "object": changed}


def parsed_setting(text: str) -> tuple[str, Any]:
    """Read ``key=value`` from a command line.

    Parameters
    ----------
    text : str
        The value as in TOML; what is not TOML is taken as a text.

    Returns
    -------
    str
        The key.
    object
        The value.

    Raises
    ------
    StimulusError
        If there is no ``=``.
    """
    name, equals, value = text.partition("=")
    if not equals or not name.strip():
        raise StimulusError(f"--set takes key=value, not '{text}'; e.g. display.frame_rate=60")
    try:
        return name.strip(), tomllib.loads(f"value = {value}")["value"]
    except tomllib.TOMLDecodeError:
        return name.strip(), value.strip()


def _put(table: object, dotted: str, value: object, where: str) -> dict[str, Any]:
    if not isinstance(table, dict):
        raise StimulusError(f"{where}: '{dotted}' is within {table!r}, which is not a table")
    first, _, rest = dotted.partition(".")
    return {**table, first: _put(table.get(first, {}), rest, value, where) if rest else value}


def _word(name: str) -> str:
    """Take the unit off a key: ``speed_deg_s`` becomes ``speed``."""
    plain = re.sub(r"(_px)?(_deg_s|_deg|_ms|_s|_hz|_per_s)$", "", name)
    return re.sub(r"[._]+", "-", plain)


def _text(value: object) -> str:
    if isinstance(value, list):
        return "x".join(_text(one) for one in value)
    if isinstance(value, float):
        return f"{value:g}"
    return re.sub(r"[^A-Za-z0-9.+-]+", "-", str(value).lower())
