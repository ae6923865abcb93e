from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
import pytest

import oppload_cli as oppload
from oppload_cli.errors import ParameterError
from oppload_cli.plots.curves import plot_curves
from oppload_cli.plots.naming import differences, in_number_order, labels_of
from oppload_cli.plots.style import wrapped
from oppload_cli.results.result_files import read_result
from oppload_cli.results.tuning import Tuning
from tests.results.make import write_result

if TYPE_CHECKING:
    from oppload_cli.results.result_files import BaseResult


@pytest.mark.parametrize(
    ("names", "labels"),
    [
        (["loom_l-over-v-10.avi", "loom_l-over-v-100.avi"], ["l/v 10", "l/v 100"]),
        (["c02.mp4", "c12.mp4"], ["c02", "c12"]),
        (["c02.mp4", "bird_attack.avi"], ["c02.mp4", "bird_attack.avi"]),
        (["a.mp4", "a.avi"], ["a.mp4", "a.avi"]),
        (["a", "a-2"], ["a", "a-2"]),
        (["x/speed-20", "x/speed-40"], ["speed-20", "speed-40"]),
        (["12.mp4", "9.mp4"], ["12", "9"]),
        (["same", "same"], ["same", "same"]),
        (["one"], ["one"]),
    ],
)
def test_names_are_what_differs(names: list[str], labels: list[str]) -> None:
    assert differences(names) == labels


def test_numbers_are_in_their_order_and_other_names_stay() -> None:
    assert in_number_order(["l/v 100", "l/v 20", "l/v 9"]) == [2, 1, 0]
    assert in_number_order(["x 1.5, y 20", "x 1.5, y 3"]) == [1, 0]
    assert in_number_order(["b", "a", "c 1"]) == [0, 1, 2]
    # Of two stimuli, each in its own order, as a folder has them in the order of texts.
    names = ["lum-0.2", "lum-0", "lum-1", "turn-0", "turn-135", "turn-45"]
    assert [names[at] for at in in_number_order(names)] == [
        "lum-0", "lum-0.2", "lum-1", "turn-0", "turn-45", "turn-135",
    ]  # fmt: skip


def test_a_number_and_its_unit_stay_in_one_line() -> None:
    assert wrapped("a peak at 0.633 s", 15) == "a peak at\n0.633 s"


@pytest.mark.parametrize(
    ("name", "lines"),
    [
        ("clip_12_of_the_northern_field", ["clip_12_of_the_", "northern_field"]),
        ("2023-11-12_over-field", ["2023-11-12_over-", "field"]),
        ("an index of -0.25", ["an index of", "-0.25"]),
    ],
)
def test_lines_end_between_words_also_of_file_names(name: str, lines: list[str]) -> None:
    assert wrapped(name, 16).splitlines() == lines


def test_long_names_are_wrapped_and_never_cut() -> None:
    name = "a_name_without_any_space_" * 4 + " and some words"
    lines = wrapped(name, 30).splitlines()
    assert max(map(len, lines)) <= 30
    assert "".join(lines).replace(" ", "") == name.replace(" ", "")


def result_of(folder: Path, sidecar: dict[str, object]) -> BaseResult:
    folder.mkdir()
    path = write_result(folder / "clip.frames.csv")
    path.with_name("clip.oppload.json").write_text(json.dumps(sidecar))
    return read_result(path)


def test_results_of_one_input_are_named_by_their_settings(tmp_path: Path) -> None:
    about: dict[str, object] = {"input": {"name": "clip.avi"}}
    gains = [
        result_of(
            tmp_path / f"g{gain}", {**about, "parameters": {"opplod": {"gain": gain, "x": 1}}}
        )
        for gain in (1, 2)
    ]
    assert labels_of(gains) == ["opplod.gain 1", "opplod.gain 2"]
    titles = [axes.get_title("left") for axes in plot_curves(gains)[1]]
    assert [title.replace("\n", " ") for title in titles if title] == [
        "clip.avi: opplod.gain 1",
        "clip.avi: opplod.gain 2",
    ]
    alike = [result_of(tmp_path / f"day-{day}", about) for day in (1, 2)]
    assert labels_of(alike) == ["day-1", "day-2"]
    # The last folder alone would not tell these three apart.
    (tmp_path / "mouse-1").mkdir()
    (tmp_path / "mouse-2").mkdir()
    places = ("mouse-1/day-1", "mouse-2/day-1", "mouse-2/day-2")
    deeper = [result_of(tmp_path / place, about) for place in places]
    assert labels_of(deeper) == ["mouse-1/day-1", "mouse-2/day-1", "mouse-2/day-2"]


def test_results_of_one_stimulus_that_were_not_saved_are_named_by_its_changed_values() -> None:
    name, key = "controls/appearing-disk", "disk.luminance"
    stimuli = [oppload.stimulus.load(name, {key: value}) for value in (0.1, 0.2)]
    results = [
        oppload.run(protocol, models=["frame_difference"], rmo=False) for protocol in stimuli
    ]
    assert labels_of(results) == ["disk.luminance 0.1", "disk.luminance 0.2"]


def test_results_of_one_input_are_named_by_their_detectors_if_these_differ(tmp_path: Path) -> None:
    about: dict[str, object] = {"input": {"name": "clip.avi"}, "parameters": {"opplod": {"x": 1}}}
    both = result_of(tmp_path / "both", about)
    one = replace(both, frames=both.frames.drop(columns="dlgmd_response"))
    other = replace(both, sidecar={**about, "parameters": {"dlgmd": {"x": 2}}})
    assert both.models == ("opplod", "dlgmd")
    assert labels_of([one, other]) == ["opplod", "opplod, dlgmd"]


def test_results_of_arrays_are_numbered() -> None:
    frames = np.zeros((3, 24, 32), np.uint8)
    results = [oppload.run(frames, models=["frame_difference"], rate=30, rmo=False)] * 2
    assert labels_of(results) == ["result 1", "result 2"]


def test_tuning_tables_of_one_stimulus_are_named_by_their_settings() -> None:
    rows = pd.DataFrame({"stimulus": ["bar/a"], "disk.direction_deg": [0], "model": ["opplod"]})
    tables = [
        Tuning(
            Path(folder) / "bar.tuning.csv",
            rows,
            ("disk.direction_deg",),
            {"parameters": {"opplod": {"gain": gain}}},
        )
        for folder, gain in (("one", 1.0), ("two", 2.0), ("three", 2.0))
    ]
    assert labels_of(tables[:2]) == ["opplod.gain 1.0", "opplod.gain 2.0"]
    assert labels_of(tables[1:]) == ["two", "three"]
    assert labels_of(tables[:2], ["a", "b"]) == ["a", "b"]


def test_given_names_are_one_for_each(tmp_path: Path) -> None:
    result = result_of(tmp_path / "a", {})
    assert labels_of([result], ["mine"]) == ["mine"]
    assert labels_of([result], "mine") == ["mine"]  # not a name for each letter
    assert labels_of([result]) == ["clip"]
    with pytest.raises(ParameterError, match="2 labels for 1 result;"):
        labels_of([result], ["a", "b"])
