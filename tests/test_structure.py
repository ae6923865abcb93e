"""The rooms of the package import in one direction, and the picture shows their imports."""

from __future__ import annotations

import pytest

from tools import picture, structure

MODULES = structure.modules_of(structure.ROOT)
IMPORTS = [
    (module, other)
    for module, imported in structure.import_graph(MODULES).items()
    for other in sorted(imported)
]


def _layer(module: str) -> int:
    return structure.layer_of(structure.room_of(module))


def test_no_module_imports_from_a_layer_above() -> None:
    upward = [(module, other) for module, other in IMPORTS if _layer(other) < _layer(module)]
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


def test_an_unknown_room_is_an_error() -> None:
    with pytest.raises(ValueError, match="cellar has no layer: add it to LAYERS"):
        structure.layer_of("cellar")


@pytest.mark.slow
def test_a_run_is_traced_through_its_rooms() -> None:
    figures = structure.figures_of_run(structure.ROOT)
    assert 10 < figures["files entered by a run"] < len(MODULES)
    assert figures.keys() | structure.figures_of_source(structure.ROOT).keys() == (
        structure.BEFORE_AND_AIM.keys()
    )
