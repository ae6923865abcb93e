"""The scripts of docs/examples: short, with public names only, and they run."""

from __future__ import annotations

import ast
import runpy
from pathlib import Path

import matplotlib as mpl
import pytest

EXAMPLES = sorted((Path(__file__).resolve().parents[1] / "docs" / "examples").glob("*.py"))
SAID = {
    "array_in": "alarm at ",
    "batch_to_table": "controls/looming-perspective",
    "maps_at_the_peak": "peak 0.3227",  # that of `oppload run --model opplod_reference`
    "own_axes": "",
    "response_over_l_over_v": "     200  ",
    "stimulus_in": "s before contact",
    "two_versions": "opplod_reference ",
    "unit_positions": "opplod_paper: 5 x 5 units",
}
FIGURES = {"own_axes": "own-axes.png", "two_versions": "two-versions.png"}
SLOW = {"batch_to_table", "response_over_l_over_v", "two_versions"}  # runs of several stimuli


@pytest.mark.long
@pytest.mark.parametrize(
    "path",
    [
        pytest.param(path, id=path.stem, marks=[pytest.mark.slow] if path.stem in SLOW else [])
        for path in EXAMPLES
    ],
)
def test_a_script_runs(
    path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    mpl.use("agg")
    runpy.run_path(str(path))
    assert SAID[path.stem] in capsys.readouterr().out
    made = [figure.name for figure in tmp_path.iterdir()]
    assert made == ([FIGURES[path.stem]] if path.stem in FIGURES else [])


def test_scripts_are_short_and_use_public_names_only() -> None:
    assert {path.stem for path in EXAMPLES} == SAID.keys()
    for path in EXAMPLES:
        text = path.read_text(encoding="utf-8")
        assert len(text.splitlines()) < 15
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.Import):
                package = [each.name for each in node.names if each.name.startswith("oppload")]
                assert package in ([], ["oppload_cli"])
            assert not (isinstance(node, ast.ImportFrom) and "oppload" in (node.module or ""))
            assert not (isinstance(node, ast.Attribute) and node.attr.startswith("_"))
