from __future__ import annotations

import json
from typing import TYPE_CHECKING

import numpy as np
import pytest

from oppload_cli.errors import ResultError
from oppload_cli.plots.curves import CurveOptions, plot_curves
from oppload_cli.plots.style import CYCLE, METADATA, described, save
from oppload_cli.results.reading import read_result
from oppload_cli.stimulus import ground_truth, load
from tests.results.make import write_result

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.axes import Axes

    from oppload_cli.results.reading import Result


@pytest.fixture
def result(tmp_path: Path) -> Result:
    return read_result(write_result(tmp_path / "clip.frames.csv"))


def labels(axes: Axes) -> list[str]:
    return axes.get_legend_handles_labels()[1]


def curve(axes: Axes, number: int) -> np.ndarray:
    drawn = [line for line in axes.lines if len(np.atleast_1d(line.get_xdata())) > 5]
    return np.asarray(drawn[number].get_ydata(), float)


def test_models_share_a_panel_over_their_own_peaks(result: Result) -> None:
    (panel,) = plot_curves([result], CurveOptions(threshold=False)).axes
    assert labels(panel) == [
        "OppLoD, peak 1 at frame 30 (1.5 s)",
        "D-LGMD, peak 0.039 at frame 39 (1.95 s)",
        "bar: alarm on",
    ]
    for number in (0, 1):
        assert np.nanmax(curve(panel, number)) == 1
        assert np.isnan(curve(panel, number)[:3]).all()
    assert (panel.get_xlabel(), panel.get_ylabel()) == ("time (s)", "response / peak")


def test_raw_responses_get_a_panel_each_with_their_unit(result: Result) -> None:
    first, second = plot_curves([result], CurveOptions(raw=True, threshold=False)).axes
    assert first.get_ylabel() == "response (arbitrary unit)"
    assert second.get_ylabel() == "response (mean of G)"
    assert np.nanmax(curve(second, 0)) == pytest.approx(0.039)


def test_one_model_over_several_inputs_shares_a_panel(tmp_path: Path) -> None:
    results = [
        read_result(write_result(tmp_path / f"{name}.frames.csv", peak=peak))
        for name, peak in (("a", 20), ("b", 30))
    ]
    (panel,) = plot_curves(results, CurveOptions(("opplod",), threshold=False)).axes
    assert labels(panel)[:2] == ["a, peak 1 at frame 20 (1 s)", "b, peak 1 at frame 30 (1.5 s)"]
    assert [line.get_color() for line in panel.lines[:4:2]] == list(CYCLE[:2])
    assert len(plot_curves(results).axes) == 2


def test_lengths_must_agree_unless_told(tmp_path: Path) -> None:
    results = [
        read_result(write_result(tmp_path / f"{frames}.frames.csv", frames)) for frames in (40, 35)
    ]
    with pytest.raises(ResultError, match=r"35\.frames\.csv: column 'frame' has 35 rows"):
        plot_curves(results)
    assert len(plot_curves(results, CurveOptions(any_length=True)).axes) == 2


def test_marks_and_threshold_are_drawn(result: Result) -> None:
    options = CurveOptions(marks={"onset": [0.5], "contact": [7.0]})
    (panel,) = plot_curves([result], options).axes
    verticals = [
        line for line in panel.lines if np.asarray(line.get_xdata()).tolist() == [0.5, 0.5]
    ]
    assert len(verticals) == 1
    assert {text.get_text() for text in panel.texts} == {"onset", "contact at 7 s"}
    assert "dotted: threshold of the alarm; bar: alarm on" in labels(panel)
    dotted = [line for line in panel.lines if line.get_drawstyle() == "steps-mid"]
    # 4 times the background of D-LGMD, over its peak, never reaches the axes' top.
    assert 1 <= len(dotted) <= 2


def test_ground_truth_is_a_strip_with_its_contact(result: Result) -> None:
    truth = ground_truth(load("klapoetke2017/loom-l-over-v/l-over-v-40"))
    beside = result.path.with_name("clip.stimulus.json")
    beside.write_text(json.dumps(truth))
    panel, strip = plot_curves([result]).axes
    assert strip.get_ylabel() == "size (deg)"
    assert np.asarray(strip.lines[0].get_ydata(), float).max() == pytest.approx(60)
    assert {text.get_text() for text in panel.texts} == {"contact"}
    assert np.asarray(strip.lines[-1].get_xdata()) == pytest.approx([2.2, 2.2])


@pytest.mark.parametrize("suffix", sorted(METADATA))
def test_the_same_input_gives_the_same_bytes(suffix: str, result: Result, tmp_path: Path) -> None:
    made = []
    for name in ("one", "two"):
        path = tmp_path / f"{name}{suffix}"
        save(plot_curves([result], CurveOptions(marks={"onset": [1.0]})), path)
        made.append(path.read_bytes())
    assert made[0] == made[1]
    assert len(made[0]) > 5000


def test_no_response_is_a_line_of_zeros(tmp_path: Path) -> None:
    path = write_result(tmp_path / "flat.frames.csv")
    rows = path.read_text().splitlines()
    flat = [line.split(",") for line in rows]
    for cells in flat[4:]:
        cells[3] = cells[9] = "0"
    path.write_text("\n".join(",".join(cells) for cells in flat) + "\n")
    (panel,) = plot_curves([read_result(path)]).axes
    assert labels(panel)[:2] == ["OppLoD, no response", "D-LGMD, no response"]
    assert set(curve(panel, 0)[3:]) == {0}


@pytest.mark.parametrize(
    ("parameter", "label"),
    [
        ("bar.axis_deg", "axis (deg)"),
        ("disk.growth.speed_deg_s", "speed (deg/s)"),
        ("disk.growth.l_over_v_ms", "l/v (ms)"),
        ("disk.centre_deg.right", "right (deg)"),
        ("effects.noise", "effects noise"),
        ("seed", "seed"),
    ],
)
def test_swept_parameters_have_their_unit(parameter: str, label: str) -> None:
    assert described(parameter) == label
