"""The JSON Schema, the reference of keys and the gallery agree with the code."""

from __future__ import annotations

import json
import re
import tomllib
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import pytest

from docs.generate_gallery import SECTIONS, gallery_page, page_of_keys
from oppload_cli import stimulus
from oppload_cli.schema import parsed_fraction
from oppload_cli.stimulus import Growth, Object, json_schema, load_all
from oppload_cli.stimulus.catalogue import catalogue_directory
from oppload_cli.stimulus.objects import KINDS

DOCS = Path(__file__).parents[2] / "docs"


def test_the_shipped_schema_is_that_of_the_code() -> None:
    path = catalogue_directory() / "stimulus.schema.json"
    shipped = json.loads(path.read_text(encoding="utf-8"))
    assert shipped == json_schema(), "run: python docs/generate_gallery.py"


def test_the_documented_keys_are_those_of_the_code() -> None:
    page = (DOCS / "stimulus-keys.md").read_text(encoding="utf-8")
    assert page == page_of_keys(), "run: python docs/generate_gallery.py"
    for table in SECTIONS.values():
        for name in table.names():
            assert f"| `{name}` |" in page


def test_the_gallery_shows_the_catalogue() -> None:
    page = (DOCS / "gallery.md").read_text(encoding="utf-8")
    assert page == gallery_page(), "run: python docs/generate_gallery.py"
    pictures = list((DOCS / "gallery").glob("*.png"))
    names = {stimulus.file_stem(entry.name) for entry in stimulus.entries()}
    assert {path.stem for path in pictures} == names
    assert sum(path.stat().st_size for path in pictures) < 1_500_000


@pytest.mark.parametrize(
    ("page", "members"),
    [
        ("stimuli.md", ["l-over-v-10", "l-over-v-40", "l-over-v-160"]),
        ("staged.md", ["miss-sizes-0.25", "miss-sizes-1.5"]),
    ],
)
def test_the_examples_of_the_documentation_are_valid(
    page: str, members: list[str], tmp_path: Path
) -> None:
    example = (DOCS / page).read_text(encoding="utf-8").split("```toml\n")[1].split("```")[0]
    path = tmp_path / "example.toml"
    path.write_text(example)
    assert [protocol.name for protocol in load_all(path)] == [
        f"example/{member}" for member in members
    ]


def test_every_file_of_the_catalogue_is_valid_by_the_schema() -> None:
    schema = json_schema()
    for path in catalogue_directory().rglob("*.toml"):
        table = tomllib.loads(path.read_text(encoding="utf-8"))
        assert problems(table, schema, schema) == [], path.name


def test_the_schema_refuses_the_mistakes_that_the_code_refuses() -> None:
    schema = json_schema()
    path = catalogue_directory() / "klapoetke2017" / "loom.toml"
    text = path.read_text(encoding="utf-8")
    for old, new in (
        ("size_deg = 20", "size_deg = -20"),
        ("size_deg = 20", "period_deg = 20"),
        ("width = 360", "width = 36.5"),
        ("width = 360", "widht = 360"),
        ("motion_s = 2.0", ""),
        ('kind = "disk"', 'kind = "dsik"'),
        ('kind = "edge-speed"', 'kind = "approach"'),
    ):
        assert old in text
        assert problems(tomllib.loads(text.replace(old, new)), schema, schema) != []


@pytest.mark.parametrize(
    ("rate", "valid"),
    [("30", True), ("29.97", True), ("30000/1001", True), ("30 Hz", False), ("1/2/3", False)],
)
def test_the_schema_and_the_code_allow_the_same_rates(rate: str, valid: bool) -> None:
    [pattern] = [
        option["pattern"]
        for option in json_schema()["properties"]["display"]["properties"]["frame_rate"]["anyOf"]
        if option["type"] == "string"
    ]
    assert bool(re.search(pattern, rate)) == valid
    with nullcontext() if valid else pytest.raises(ValueError, match=rate):
        parsed_fraction(rate)


def test_kinds_have_their_own_keys() -> None:
    objects = json_schema()["properties"]["object"]["items"]["oneOf"]
    assert [one["properties"]["kind"]["const"] for one in objects] == list(KINDS)
    disk = objects[0]["properties"]
    assert "period_deg" not in disk
    assert disk["growth"]["oneOf"][0]["required"] == ["kind", "speed_deg_s"]
    assert {name for one in objects for name in one["properties"]} == set(Object.names())
    steps = disk["growth"]["oneOf"]
    assert {name for one in steps for name in one["properties"]} == set(Growth.names())


def problems(value: Any, schema: dict[str, Any], root: dict[str, Any]) -> list[str]:
    """Check a value by the part of JSON Schema that is used here."""
    if "$ref" in schema:
        schema = root["$defs"][schema["$ref"].rsplit("/", 1)[1]]
    found: list[str] = []
    options = schema.get("oneOf") or schema.get("anyOf")
    fits = sum(not problems(value, option, root) for option in options) if options else 1
    if fits != 1 and (fits == 0 or "oneOf" in schema):
        found.append(f"{value} fits {fits} of the options")
    if value not in schema.get("enum", [schema.get("const", value)]):
        found.append(f"{value} is not allowed")
    if not isinstance(value, TYPES.get(schema.get("type", ""), object)):
        return [*found, f"{value} is not of type {schema['type']}"]
    if isinstance(value, list):
        if not schema.get("minItems", 0) <= len(value) <= schema.get("maxItems", len(value)):
            found.append(f"{value} has the wrong length")
        found += [p for one in value for p in problems(one, schema.get("items", {}), root)]
    if isinstance(value, dict):
        found += problems_of_keys(value, schema, root)
    return found + problems_of_number(value, schema)


TYPES: dict[str, Any] = {
    "object": dict,
    "array": list,
    "string": str,
    "boolean": bool,
    "integer": int,
    "number": (int, float),
}


def problems_of_number(value: Any, schema: dict[str, Any]) -> list[str]:
    if not isinstance(value, int | float):
        return []
    low, above = schema.get("minimum", value), schema.get("exclusiveMinimum", value - 1)
    inside = low <= value <= schema.get("maximum", value) and value > above
    return [] if inside else [f"{value} is out of range"]


def problems_of_keys(
    table: dict[str, Any], schema: dict[str, Any], root: dict[str, Any]
) -> list[str]:
    known, others = schema.get("properties", {}), schema.get("additionalProperties", {})
    found = [f"{name} is missing" for name in schema.get("required", []) if name not in table]
    for name, one in table.items():
        if name not in known and others is False:
            found.append(f"{name} is unknown")
        else:
            found += problems(one, known.get(name, others or {}), root)
    return found
