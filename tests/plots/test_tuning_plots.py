from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from oppload_cli.errors import ResultError
from oppload_cli.plots.figures import draw_tuning
from oppload_cli.plots.polar import direction_tunings
from oppload_cli.reference.lplc2 import bar_tuning, peaks
from oppload_cli.results.tuning import is_tuning, read_tuning
from tests.results.make import write_tuning

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.lines import Line2D
    from numpy.typing import NDArray

AXES = {"bar.axis_deg": [0.0, 45, 90, 135]}
PEAKS = {"opplod": [1.0, 4, 1, 4], "dlgmd": [0.0, 0, 0, 0]}


def y_of(line: Line2D) -> NDArray[np.float64]:
    return np.asarray(line.get_ydata(), float)


def test_a_symmetric_axis_is_drawn_all_round_beside_lplc2(tmp_path: Path) -> None:
    tuning = read_tuning(write_tuning(tmp_path / "a.tuning.csv", AXES, PEAKS, symmetric=True))
    drawn = draw_tuning([tuning])
    opplod, dlgmd, lplc2 = drawn.figure.axes[0].lines
    np.testing.assert_allclose(np.rad2deg(np.asarray(opplod.get_xdata()))[:3], [0, 45, 90])
    np.testing.assert_allclose(y_of(opplod), [0.25, 1] * 4 + [0.25])
    np.testing.assert_allclose(y_of(dlgmd), 0)
    assert y_of(lplc2).max() == 1
    assert drawn.lines[0].startswith("OppLoD: peak 4 (arbitrary unit) at 45 deg, direction")
    assert "direction selectivity index 0.000" in drawn.lines[0]
    assert drawn.lines[1] == "D-LGMD: no response"
    assert drawn.lines[2].startswith("LPLC2, 10 deg bar: peak 0.41 (of the loom) at 165 deg")


def test_without_symmetry_a_half_circle_stays_open(tmp_path: Path) -> None:
    tuning = read_tuning(write_tuning(tmp_path / "a.tuning.csv", AXES, PEAKS))
    (curve,) = direction_tunings([tuning], ["opplod"], "none")
    np.testing.assert_array_equal(curve.angles_deg, [0, 45, 90, 135])
    line = draw_tuning([tuning], models=["opplod"], lplc2="none").figure.axes[0].lines[0]
    assert len(np.asarray(line.get_xdata())) == 4
    assert "direction selectivity index not shown" in curve.line()


def test_the_reference_holds_the_published_numbers() -> None:
    assert bar_tuning(10) == {15: 0.33, 45: 0.34, 75: 0.32, 105: 0.38, 135: 0.39, 165: 0.41}
    assert bar_tuning(60) == {15: 0.19, 45: 0.05, 75: 0.15, 105: 0.18, 135: 0.07, 165: 0.23}
    assert bar_tuning(20) == {}
    assert len(peaks()) == 21
    assert {p.stimulus: p.relative for p in peaks()}["cross_outward"] == 0.46


def test_two_parameters_make_a_heat_map(tmp_path: Path) -> None:
    values = {"disk.growth.speed_deg_s": [10.0, 10, 20, 20], "disk.size_deg": [5.0, 9, 5, 9]}
    peaks_of = {"opplod": [1.0, 2, 4, 8], "dlgmd": [1.0, 1, 1, 1]}
    tuning = read_tuning(write_tuning(tmp_path / "a.tuning.csv", values, peaks_of))
    panel = draw_tuning([tuning], models=["opplod"]).figure.axes[0]
    np.testing.assert_allclose(
        np.asarray(panel.images[0].get_array(), float), [[0.125, 0.5], [0.25, 1]]
    )
    assert [tick.get_text() for tick in panel.get_xticklabels()] == ["10", "20"]
    assert (panel.get_xlabel(), panel.get_ylabel()) == ("speed (deg/s)", "size (deg)")


def test_one_number_makes_a_line(tmp_path: Path) -> None:
    values = {"disk.growth.l_over_v_ms": [10.0, 20, 40]}
    tuning = read_tuning(write_tuning(tmp_path / "a.tuning.csv", values, {"opplod": [4.0, 2, 1]}))
    panel = draw_tuning([tuning]).figure.axes[0]
    np.testing.assert_allclose(y_of(panel.lines[0]), [1, 0.5, 0.25])
    assert panel.get_xlabel() == "l/v (ms)"


def test_kinds_that_do_not_suit_name_the_column(tmp_path: Path) -> None:
    values = {"disk.size_deg": [5.0, 9]}
    tuning = read_tuning(write_tuning(tmp_path / "a.tuning.csv", values, {"opplod": [1.0, 2]}))
    with pytest.raises(ResultError, match=r"no column of a direction.*--kind line"):
        draw_tuning([tuning], "polar")
    with pytest.raises(ResultError, match=r"disk\.size_deg swept; a heat map needs two"):
        draw_tuning([tuning], "heat")
    with pytest.raises(ResultError, match="column 'model' never holds 'dlgmd'"):
        draw_tuning(
            [read_tuning(write_tuning(tmp_path / "b.tuning.csv", AXES, {"opplod": [1.0] * 4}))],
            models=["dlgmd"],
        )


def test_a_tuning_table_is_told_by_its_header(tmp_path: Path) -> None:
    assert is_tuning(write_tuning(tmp_path / "a.tuning.csv", AXES, PEAKS))
    other = tmp_path / "b.csv"
    other.write_text("frame,time_s\n0,0\n")
    assert not is_tuning(other)
    assert not is_tuning(tmp_path / "none.csv")
