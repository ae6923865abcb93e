"""The rooms of the package import in one direction, and the picture shows their imports."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from tools import picture, structure

if TYPE_CHECKING:
    from pathlib import Path

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


def test_an_unknown_room_is_an_error() -> None:
    with pytest.raises(ValueError, match="cellar has no layer: add it to LAYERS"):
        structure.layer_of("cellar")


def test_a_detector_that_is_loaded_by_its_name_counts_as_imported(imports: structure.Graph) -> None:
    registry = imports["oppload_cli.models.registry"]
    assert {"oppload_cli.models.opplod", "oppload_cli.models.published.lgmd2"} < registry


def test_the_figures_of_a_small_package(tmp_path: Path) -> None:
    (tmp_path / "oppload_cli" / "models").mkdir(parents=True)
    (tmp_path / "oppload_cli" / "plots").mkdir()
    for name, text in {
        "models/bee.py": 'class Bee:\n    name = "bee"\n\n\ndef _own() -> None:\n    """Do."""\n',
        "models/list.py": 'ALL = {"bee": "models.bee:Bee"}\n',
        "plots/one.py": 'def one() -> str:\n    import json  # noqa\n\n    return "bee"\n',
    }.items():
        (tmp_path / "oppload_cli" / name).write_text(text)
    figures = structure.figures_of_source(tmp_path)
    expected = {
        "files that name a detector, outside `models` and `reproduction`": 1,
        "modules": 3,
        "modules with one importer": 1,
        "modules with one public name": 2,
        "imports inside `models`": 1,
        "lines of Python": 11,
        "`noqa`": 1,
        "imports in functions": 1,
        "imports in functions, outside `cli`": 1,
        "public names per 1,000 lines of code": 285.7,  # 2 in 7
    }
    assert {title: figures[title] for title in expected} == expected


def test_a_folder_without_the_package_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.argv", ["structure.py", str(tmp_path)])
    with pytest.raises(SystemExit) as ended:
        structure.main()
    assert ended.value.code == 2
    assert capsys.readouterr().err.endswith(
        f"{tmp_path}: is no checkout: it has no folder oppload_cli\n"
    )


@pytest.mark.slow
def test_a_run_is_traced_through_its_rooms() -> None:
    figures = structure.figures_of_run(structure.ROOT)
    assert 10 < figures["files entered by a run"] < len(MODULES)
    assert figures.keys() | structure.figures_of_source(structure.ROOT).keys() == (
        structure.BEFORE_AND_AIM.keys()
    )
