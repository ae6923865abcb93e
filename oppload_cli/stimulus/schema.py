"""The JSON Schema of protocol files, and their reference page, from the declarations."""

from __future__ import annotations

import typing
from dataclasses import MISSING, Field, fields
from fractions import Fraction
from typing import Any

from oppload_cli.stimulus.changes import Brightness, Growth
from oppload_cli.stimulus.declare import Table, hints, members
from oppload_cli.stimulus.objects import KINDS, Object
from oppload_cli.stimulus.protocol import Protocol
from oppload_cli.stimulus.tables import Display, Effects, Motion, Scene, Timing

DIALECT = "https://json-schema.org/draft/2020-12/schema"
KINDS_OF: dict[type[Table], tuple[str, ...]] = {
    Object: KINDS,
    Growth: ("edge-speed", "approach", "steps"),
    Brightness: ("step", "ramp", "flicker"),
}
SECTIONS: dict[str, type[Table]] = {
    "[display]": Display,
    "[timing]": Timing,
    "[[object]]": Object,
    "[object.growth]": Growth,
    "[object.motion] and [scene.motion]": Motion,
    "[object.brightness]": Brightness,
    "[scene]": Scene,
    "[effects]": Effects,
}


def json_schema() -> dict[str, Any]:
    """Return the JSON Schema of a protocol file.

    Returns
    -------
    dict
        For editors that complete and check TOML by a schema.
    """
    schema = _table_schema(Protocol)
    properties = schema["properties"]
    properties.pop("name")
    properties["object"] = {**properties.pop("objects"), "minItems": 1}
    values = {
        "description": "lists of values by dotted key, e.g. bar.axis_deg = [0, 45, 90]",
        "type": "object",
        "additionalProperties": {
            "anyOf": [{"type": "array", "minItems": 1}, {"$ref": "#/$defs/nested"}]
        },
    }
    properties["sweep"] = values
    return {
        "$schema": DIALECT,
        "title": "oppload stimulus protocol",
        **schema,
        "required": [*schema["required"], "object"],
        "$defs": {"nested": {k: v for k, v in values.items() if k != "description"}},
    }


def reference() -> str:
    """Return the reference of all keys as Markdown tables.

    Returns
    -------
    str
        One table for each TOML table, for ``docs/stimuli.md``.
    """
    parts = []
    for title, table in SECTIONS.items():
        rows = [_reference_row(declared, table) for declared in fields(table)]
        head = f"#### `{title}`" if " and " not in title else f"#### {title}"
        parts.append("\n".join([head, "", *_REFERENCE_HEAD, *rows]))
    return "\n\n".join(parts) + "\n"


_REFERENCE_HEAD = ("| key | value | default | meaning |", "|---|---|---|---|")


def _reference_row(declared: Field[Any], table: type[Table]) -> str:
    hint, _ = members(hints(table)[declared.name])
    metadata = declared.metadata
    unit = f", {metadata['unit']}" if metadata["unit"] else ""
    limits = "".join(
        f", {sign} {metadata[bound]:g}"
        for bound, sign in (("low", "≥"), ("above", ">"), ("high", "≤"))
        if metadata[bound] is not None
    )
    value = " / ".join(f"`{one}`" for one in metadata["choices"]) or _in_words(hint)
    default = "**required**" if declared.default is MISSING else _default(declared.default)
    only = f" ({', '.join(metadata['kinds'])} only)" if metadata["kinds"] else ""
    return (
        f"| `{declared.name}` | {value}{unit}{limits} | {default} | {metadata['meaning']}{only} |"
    )


def _default(value: object) -> str:
    if value is None or value == ():
        return ""
    if isinstance(value, bool):
        return f"`{str(value).lower()}`"
    if isinstance(value, tuple):
        return f"`{list(value)}`"
    return f"`{value:g}`" if isinstance(value, float) else f"`{value}`"


def _in_words(hint: Any) -> str:
    if typing.get_origin(hint) is tuple:
        arguments = typing.get_args(hint)
        if arguments[-1] is Ellipsis:
            return f"list of {_in_words(arguments[0])}s"
        return f"[{', '.join(_in_words(one) for one in arguments)}]"
    if isinstance(hint, type) and issubclass(hint, Table):
        return "table"
    words = {int: "whole number", float: "number", str: "text", bool: "true or false"}
    return words.get(hint, "number or fraction")


def _table_schema(table: type[Table], kind: str | None = None) -> dict[str, Any]:
    taken = [
        declared
        for declared in fields(table)
        if kind is None or not declared.metadata["kinds"] or kind in declared.metadata["kinds"]
    ]
    properties = {declared.name: _key_schema(declared, table) for declared in taken}
    required = [
        declared.name
        for declared in taken
        if declared.default is MISSING or kind in declared.metadata["needed_by"]
    ]
    if kind is not None:
        properties["kind"] = {"const": kind}
    return {
        "type": "object",
        "properties": properties,
        "required": [name for name in required if name != "objects"],
        "additionalProperties": False,
    }


def _key_schema(declared: Field[Any], table: type[Table]) -> dict[str, Any]:
    metadata = declared.metadata
    hint, _ = members(hints(table)[declared.name])
    schema = _type_schema(hint, metadata)
    unit = f" [{metadata['unit']}]" if metadata["unit"] else ""
    schema["description"] = f"{metadata['meaning']}{unit}"
    if declared.default is not MISSING and isinstance(declared.default, bool | int | float | str):
        schema["default"] = declared.default
    return schema


def _type_schema(hint: Any, metadata: Any) -> dict[str, Any]:
    if typing.get_origin(hint) is tuple:
        arguments = typing.get_args(hint)
        listed: dict[str, Any] = {"type": "array", "items": _type_schema(arguments[0], metadata)}
        if arguments[-1] is not Ellipsis:
            listed |= {"minItems": len(arguments), "maxItems": len(arguments)}
        return listed
    if isinstance(hint, type) and issubclass(hint, Table):
        kinds = KINDS_OF.get(hint)
        if kinds is None:
            return _table_schema(hint)
        return {"oneOf": [_table_schema(hint, kind) for kind in kinds]}
    if hint in {str, bool}:
        plain = {"type": "string" if hint is str else "boolean"}
        return plain | ({"enum": list(metadata["choices"])} if metadata["choices"] else {})
    return _number_schema(hint, metadata)


def _number_schema(hint: Any, metadata: Any) -> dict[str, Any]:
    bounds = {"low": "minimum", "above": "exclusiveMinimum", "high": "maximum"}
    number: dict[str, Any] = {"type": "integer" if hint is int else "number"}
    number |= {bounds[name]: metadata[name] for name in bounds if metadata[name] is not None}
    if hint is Fraction:
        return {"anyOf": [number, {"type": "string", "pattern": "^[0-9]+(/[0-9]+)?$"}]}
    return number
