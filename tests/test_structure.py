"""The rooms of the package import in one direction, and the picture shows their imports."""

from __future__ import annotations

import pytest

from tools import picture, structure

MODULES = structure.modules_of(structure.ROOT)


@pytest.fixture(scope="module")
def imports() -> structure.Graph:
    return structure.import_graph(MODULES)


def _layer(module: str) -> int:
    return structure.layer_of(structure.room_of(module))


def test_no_module_imports_from_a_layer_above(imports: structure.Graph) -> None:
    upward = [
        (module, other)
        for module, imported in imports.items()
        for other in imported
        if _layer(other) < _layer(module)
    ]
    assert upward == []


def test_no_circle_of_rooms() -> None:
    assert structure.circles(structure.room_graph(structure.ROOT)) == set()


def test_no_circle_of_modules_when_they_are_imported() -> None:
    assert structure.circles(structure.import_graph(MODULES, types=False)) == set()


def test_the_picture_shows_the_imports() -> None:
    drawn = picture.svg(structure.ROOT)
    kept = picture.PICTURE.read_text(encoding="utf-8")
    assert drawn == kept, "docs/architecture.svg is stale: run 'make docs'"


def test_a_circle_is_found_with_all_its_members() -> None:
    graph = {"a": {"b"}, "b": {"c"}, "c": {"a"}, "d": {"a"}, "e": {"e"}, "f": set()}
    assert structure.circles(graph) == {frozenset("abc"), frozenset("e")}


def test_a_detector_that_is_loaded_by_its_name_counts_as_imported(imports: structure.Graph) -> None:
    registry = imports["oppload_cli.models.registry"]
    assert {"oppload_cli.models.opplod", "oppload_cli.models.published.lgmd2"} < registry
