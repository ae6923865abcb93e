from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from matplotlib.artist import getp
from matplotlib.collections import LineCollection
from matplotlib.colors import LogNorm
from matplotlib.projections.polar import PolarAxes
from scipy.special import stdtrit

from oppload_cli.errors import ParameterError, ResultError
from oppload_cli.models.registry import detector_named, detectors
from oppload_cli.plots.curves import plot_curves
from oppload_cli.plots.peak_times import PeakTimes
from oppload_cli.plots.polar import DirectionTuning, direction_tunings
from oppload_cli.plots.rmo_curves import plot_rmo
from oppload_cli.plots.style import CYCLE, FAINT, GREY, MARKERS, MOST_HEIGHT, looks_of
from oppload_cli.plots.tuning_curves import Request, described
from oppload_cli.plots.tuning_plots import plot_tuning
from oppload_cli.reference import bar_tuning, lplc2_peaks
from oppload_cli.results.tuning import is_tuning, read_tuning
from oppload_cli.stimulus.catalogue import find
from tests.results.make import write_tuning

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from matplotlib.lines import Line2D
    from numpy.typing import NDArray

    from oppload_cli.results.tuning import Tuning

AXES = {"bar.axis_deg": [0.0, 45, 90, 135]}
PEAKS = {"opplod": [1.0, 4, 1, 4], "dlgmd": [0.0, 0, 0, 0]}
L_OVER_V = {"disk.growth.l_over_v_ms": [10.0, 20, 40]}
AT_240: dict[str, Any] = {"models": ["opplod"], "height": 240}


def made(
    folder: Path,
    values: Mapping[str, Sequence[float | str]],
    peaks: dict[str, list[float]],
    **more: Any,
) -> Tuning:
    return read_tuning(write_tuning(folder / "a.tuning.csv", values, peaks, **more))


def y_of(line: Line2D) -> NDArray[np.float64]:
    return np.asarray(line.get_ydata(), float)


def polar_curves(
    tuning: Tuning, models: Sequence[str] = (), lplc2: str = "auto"
) -> list[DirectionTuning]:
    return direction_tunings(Request([tuning], models, [tuning.name], lplc2=lplc2))


def test_a_symmetric_axis_is_drawn_all_round_beside_lplc2(tmp_path: Path) -> None:
    tuning = made(tmp_path, AXES, PEAKS, symmetric=True)
    figure, _ = plot_tuning([tuning])
    opplod, dlgmd, lplc2 = figure.axes[0].lines
    lines = [curve.line() for curve in polar_curves(tuning)]
    np.testing.assert_allclose(np.rad2deg(np.asarray(opplod.get_xdata()))[:3], [0, 45, 90])
    np.testing.assert_allclose(y_of(opplod), [0.25, 1] * 4 + [0.25])
    np.testing.assert_allclose(y_of(dlgmd), 0)
    assert y_of(lplc2).max() == 1
    assert lines[0].startswith("OppLoD: peak 4 (arbitrary unit) at 45 deg, direction")
    assert (
        "direction selectivity index does not apply (opposite directions are the same)" in lines[0]
    )
    assert lines[1] == "D-LGMD: no response"
    assert lines[2].startswith("LPLC2, 10 deg bar: peak 0.41 (of the loom) at 165 deg")


def test_rounding_errors_are_no_response(tmp_path: Path) -> None:
    """Pathways that cancel leave 1e-14 of a response, which depends on the direction."""
    tuning = made(tmp_path, AXES, {"opplod": [1e-14, 2e-14, 0, 1e-14]})
    (curve,) = polar_curves(tuning, lplc2="none")
    assert curve.line() == "OppLoD: no response"


def test_lplc2_stands_beside_its_own_bar_only(tmp_path: Path) -> None:
    tuning = made(tmp_path, AXES, PEAKS, symmetric=True)
    entry = find("klapoetke2017/bar-expand-10")[0]
    for changes, overlaid in (
        ({}, True),
        ({"bar.axis_deg": 30, "timing.before_s": 0}, True),
        ({"bar.width_deg": 60}, False),
        ({"bar.growth.speed_deg_s": 100}, False),
        ({"bar.growth.sides": "forward"}, False),
        ({"bar.growth.end_deg": 15}, False),
        ({"bar.luminance": 0.9}, False),
        ({"display.background": 0.5}, False),
        ({"scene.rotation_deg": 45}, False),
        ({"effects.invert": True}, False),
    ):
        first = entry.with_settings(changes).protocols()[0].as_table()
        tuning.sidecar["stimulus"]["first"] = first
        names = [curve.name for curve in polar_curves(tuning)]
        assert any(name.startswith("LPLC2") for name in names) == overlaid, changes
    path = write_tuning(tmp_path / "b.tuning.csv", AXES, PEAKS, name="klapoetke2017/bar-expand-60")
    both = Request([made(tmp_path, AXES, PEAKS), read_tuning(path)], ["opplod"], ["10", "60"])
    assert [curve.name for curve in direction_tunings(both)] == ["OppLoD, 10", "OppLoD, 60"]


@pytest.mark.parametrize(
    ("first", "reason"),
    [
        ("a.x", r"a\.x, a\.y and a\.z are swept; a plot shows two"),
        ("a.axis_deg", r"column 'a\.y' is swept too; a plot shows two"),
    ],
)
def test_more_than_a_plot_can_show_is_refused(first: str, reason: str, tmp_path: Path) -> None:
    three = {first: [1.0, 2], "a.y": [1.0, 2], "a.z": [1.0, 2]}
    table = made(tmp_path, three, {"opplod": [1.0, 2]})
    with pytest.raises(ResultError, match=reason):
        plot_tuning(table)


def test_a_polar_plot_shows_one_swept_parameter(tmp_path: Path) -> None:
    table = made(tmp_path, {"a.axis_deg": [1.0, 2], "a.y": [1.0, 2]}, {"opplod": [1.0, 2]})
    with pytest.raises(ResultError, match=r"column 'a\.y' is swept too; draw kind 'heat'"):
        plot_tuning(table, "polar")


def test_without_symmetry_a_half_circle_stays_open(tmp_path: Path) -> None:
    tuning = made(tmp_path, AXES, PEAKS)
    (curve,) = polar_curves(tuning, ["opplod"], "none")
    np.testing.assert_array_equal(curve.angles_deg, [0, 45, 90, 135])
    line = plot_tuning([tuning], models=["opplod"], lplc2="none")[1][0].lines[0]
    assert len(np.asarray(line.get_xdata())) == 4
    assert "direction selectivity index unknown (opposite not shown)" in curve.line()


@pytest.mark.parametrize("begin", [0, -180])
def test_a_direction_that_was_shown_twice_is_drawn_once(begin: int, tmp_path: Path) -> None:
    circle = {"bar.axis_deg": [float(angle) for angle in range(begin, begin + 361, 45)]}
    peaks = {"opplod": [1.0, 2, 1, 2, 1, 2, 1, 2, 1]}
    tuning = made(tmp_path, circle, peaks)
    (curve,) = polar_curves(tuning, lplc2="none")
    np.testing.assert_array_equal(curve.angles_deg, range(0, 360, 45))
    assert "axis selectivity index 0.000" in curve.line()


def test_an_index_that_rounds_to_zero_has_no_sign(tmp_path: Path) -> None:
    circle = {"bar.axis_deg": [0.0, 90, 180, 270]}
    tuning = made(tmp_path, circle, {"opplod": [1.0, 0.5, 1.00000001, 0.5]})
    (curve,) = polar_curves(tuning, lplc2="none")
    assert "at 0 deg, direction selectivity index 0.000, axis" in curve.line()


def test_the_reference_has_the_published_numbers() -> None:
    assert bar_tuning(10) == {15: 0.33, 45: 0.34, 75: 0.32, 105: 0.38, 135: 0.39, 165: 0.41}
    assert bar_tuning(60) == {15: 0.19, 45: 0.05, 75: 0.15, 105: 0.18, 135: 0.07, 165: 0.23}
    assert bar_tuning(20) == {}
    assert len(lplc2_peaks()) == 21
    assert {p.stimulus: p.relative for p in lplc2_peaks()}["cross_outward"] == 0.46


def test_two_parameters_make_a_heat_map(tmp_path: Path) -> None:
    values = {"disk.growth.speed_deg_s": [10.0, 10, 20, 20], "disk.size_deg": [5.0, 9, 5, 9]}
    peaks_of = {"opplod": [1.0, 2, 4, 8], "dlgmd": [1.0, 1, 1, 1]}
    tuning = made(tmp_path, values, peaks_of)
    panel = plot_tuning(tuning, models=["opplod"])[1][0]
    np.testing.assert_allclose(
        np.asarray(panel.images[0].get_array(), float), [[0.125, 0.5], [0.25, 1]]
    )
    assert [tick.get_text() for tick in panel.get_xticklabels()] == ["10", "20"]
    assert (panel.get_xlabel(), panel.get_ylabel()) == ("speed (deg/s)", "size (deg)")


def test_one_number_makes_a_line(tmp_path: Path) -> None:
    tuning = made(tmp_path, L_OVER_V, {"opplod": [4.0, 2, 1]})
    panel = plot_tuning(tuning)[1][0]
    np.testing.assert_allclose(y_of(panel.lines[0]), [1, 0.5, 0.25])
    assert panel.get_xlabel() == "l/v (ms)"
    tuning.path.with_suffix(".json").unlink()  # then the rows name the stimulus
    assert read_tuning(tuning.path).name == tuning.name == "klapoetke2017/bar-expand-10"


@pytest.mark.long
def test_raw_peaks_have_complete_numbers_along_their_axis(tmp_path: Path) -> None:
    """The legend lies where matplotlib writes a common factor such as 1e-7."""
    names = list(detectors())[:5]  # too many for panels one above another
    for count in (1, 5):
        peaks = {name: [4e-7, 2e-7, 1e-7] for name in names[:count]}
        figure, panels = plot_tuning(made(tmp_path, L_OVER_V, peaks), scale="raw")
        figure.draw_without_rendering()
        assert len(panels) == count
        for panel in panels:
            np.testing.assert_allclose(y_of(panel.lines[0]), [4e-7, 2e-7, 1e-7])
            assert "4e\N{MINUS SIGN}07" in [label.get_text() for label in panel.get_yticklabels()]
    boxes = [panel.get_window_extent() for panel in panels]
    assert min(box.height for box in boxes) / figure.dpi > 0.5  # inches
    assert figure.get_supylabel() == "peak response"


@pytest.mark.parametrize(("kind", "key"), [("line", "effects.noise"), ("polar", "bar.axis_deg")])
def test_seeds_are_averaged_with_bars_of_their_deviation(
    kind: str, key: str, tmp_path: Path
) -> None:
    peaks = [1.0, 3, 10, 4, 2, 2]
    swept = {key: [0.0, 0, 30, 30, 60, 60], "seed": [1.0, 2, 1, 2, 1, 2]}
    table = made(tmp_path, swept, {"opplod": peaks}, **AT_240)
    figure, (panel,) = plot_tuning(table, scale="raw", lplc2="none")
    np.testing.assert_allclose(y_of(panel.lines[0]), [2, 7, 2])
    (bars,) = (drawn for drawn in panel.collections if isinstance(drawn, LineCollection))
    ends = np.array([[low[1], high[1]] for low, high in bars.get_segments()])
    np.testing.assert_allclose(ends.mean(axis=1), [2, 7, 2])
    np.testing.assert_allclose(np.ptp(ends, axis=1) / 2, [2**0.5, 18**0.5, 0])
    assert panel.get_ylim()[1] > ends.max()
    assert figure.texts[-1].get_text().endswith("; mean and standard deviation of 2 seeds")
    figure, (panel,) = plot_tuning(table, "heat")
    assert np.asarray(panel.images[0].get_array()).shape == (2, 3)
    assert "seeds" not in figure.texts[-1].get_text()


@pytest.mark.parametrize(("kind", "size"), [("line", 1), ("heat", 2)])
def test_a_condition_that_ends_during_the_warm_up_is_left_out(
    kind: str, size: int, tmp_path: Path
) -> None:
    swept: dict[str, list[float]] = {
        "timing.motion_s": [0.05, 0.5, 1, 2],
        "disk.size_deg": [5.0, 5, 9, 9],
    }
    table = made(tmp_path, dict(list(swept.items())[:size]), {"opplod": [np.nan, 2, 1, 0]})
    (panel,) = plot_tuning(table, kind)[1]
    if kind == "line":
        points = np.asarray(panel.lines[0].get_xydata(), float)
        np.testing.assert_allclose(points, [[0.5, 1.0], [1.0, 0.5], [2.0, 0.0]])
    else:
        shown = np.ma.MaskedArray(panel.images[0].get_array()).filled(np.nan)
        np.testing.assert_allclose(shown, [[1, np.nan, np.nan], [np.nan, 0.5, 0]])


def test_a_line_goes_from_left_to_right_whatever_the_order_of_the_sweep(tmp_path: Path) -> None:
    values = {"disk.growth.l_over_v_ms": [40.0, 10, 20]}
    tuning = made(tmp_path, values, {"opplod": [1.0, 4, 2]})
    (line,) = plot_tuning(tuning)[1][0].lines
    np.testing.assert_allclose(np.asarray(line.get_xdata()), [10, 20, 40])
    np.testing.assert_allclose(y_of(line), [1, 0.5, 0.25])


# Detectors in a figure: the least that are too many for one panel, and many.
SEVEN_AND_MANY = pytest.mark.parametrize("count", [7, pytest.param(19, marks=pytest.mark.slow)])


@pytest.mark.long
@SEVEN_AND_MANY
def test_more_than_six_lines_have_a_small_panel_each(count: int, tmp_path: Path) -> None:
    peaks = {name: [4.0, 2, 1] for name in list(detectors())[:count]}
    doubts = [{"model": name, "note": "12 of 12 peaks"} for name in peaks]
    tuning = made(tmp_path, L_OVER_V, peaks, doubts=doubts)
    figure, panels = plot_tuning(tuning)
    assert [len(panel.lines) for panel in panels] == [1] * count
    figure.draw_without_rendering()
    for panel in panels:
        assert panel.get_window_extent().height / figure.dpi > 0.5  # inches
        assert "12 of 12 peaks" in panel.get_title("left")
        assert panel.lines[0].get_color() == FAINT


def test_a_line_that_means_little_is_thin_and_grey(tmp_path: Path) -> None:
    doubts = [{"model": "dlgmd", "note": "below it"}]
    tuning = made(tmp_path, {"disk.size_deg": [1.0, 2, 3, 4]}, PEAKS, doubts=doubts)
    opplod, dlgmd = plot_tuning(tuning)[1][0].lines
    assert opplod.get_color() == detector_named("opplod").colour
    assert (dlgmd.get_color(), dlgmd.get_linewidth()) == (FAINT, 0.7)


def test_a_polar_curve_that_means_little_is_thin_and_grey(tmp_path: Path) -> None:
    peaks = {"opplod": [1.0, 4, 1, 4], "dlgmd": [1.0, 4, 1, 4]}
    doubts = [{"model": "dlgmd", "note": "below it"}]
    tuning = made(tmp_path, AXES, peaks, symmetric=True, doubts=doubts)
    opplod, dlgmd = plot_tuning(tuning, lplc2="none")[1][0].lines[:2]
    assert opplod.get_color() == detector_named("opplod").colour
    assert (dlgmd.get_color(), dlgmd.get_linewidth()) == (GREY, 0.7)


def test_several_lines_that_mean_little_are_told_apart(tmp_path: Path) -> None:
    names = ["opplod", "dlgmd", "lgmd1_group", "lgmd2", "ci_lmd", "mlplc2"]
    peaks = {name: [4.0, 2, 1] for name in names}
    doubts = [{"model": name, "note": "below it"} for name in names]
    tuning = made(tmp_path, {"disk.size_deg": [1.0, 2, 3]}, peaks, doubts=doubts)
    lines = plot_tuning(tuning)[1][0].lines
    assert {line.get_color() for line in lines} == {FAINT}
    looks = {(vars(line)["_unscaled_dash_pattern"], line.get_fillstyle()) for line in lines}
    assert len(looks) == len(names)


@pytest.mark.parametrize("kind", ["polar", "line"])
def test_the_foot_of_a_figure_says_how_it_was_measured(kind: str, tmp_path: Path) -> None:
    before = plot_tuning(made(tmp_path, AXES, PEAKS), kind)[0]
    assert not any("px" in text.get_text() for text in before.texts)
    changed = {"opplod.units": "1x1"}
    tuning = made(tmp_path, AXES, PEAKS, models=[*PEAKS], height=600, changed=changed)
    figure, (panel,) = plot_tuning(tuning, kind)
    line = figure.texts[-1]
    assert line.get_text() == "600 px; opplod.units=1x1"
    figure.draw_without_rendering()
    box, tight = line.get_window_extent(), panel.get_tightbbox()
    assert tight is not None
    assert figure.bbox.y0 <= box.y0 < box.y1 <= tight.y0
    assert figure.get_figheight() > before.get_figheight()


@pytest.mark.parametrize(
    ("height", "models", "said"),
    [
        ("auto", ["opplod", "dlgmd"], "240 px"),
        ("auto", ["opplod_paper"], "600 px"),
        ("auto", ["opplod", "opplod_paper"], "OppLoD 240 px, OppLoD paper 600 px"),
        ("native", ["opplod", "opplod_paper"], "360 px"),
        (90, ["opplod", "opplod_paper"], "90 px"),
    ],
)
def test_the_foot_states_the_working_height_of_each_detector(
    height: str | int, models: list[str], said: str, tmp_path: Path
) -> None:
    stimulus = {"name": "bar", "first": {"display": {"height": 360}}}
    peaks = dict.fromkeys(models, PEAKS["opplod"])
    tuning = made(tmp_path, AXES, peaks, models=models, height=height, stimulus=stimulus)
    assert plot_tuning(tuning)[0].texts[-1].get_text() == said


@pytest.mark.parametrize(
    "first",
    ["damaged", {"display": "damaged"}, {"object": "damaged"}, {"object": [1], "display": 3}],
)
@pytest.mark.parametrize("kind", ["polar", "line"])
def test_a_damaged_protocol_in_the_sidecar_is_left_out(
    kind: str, first: object, tmp_path: Path
) -> None:
    stimulus = {"name": "klapoetke2017/bar-expand-10", "first": first}
    figure, _ = plot_tuning(made(tmp_path, AXES, PEAKS, stimulus=stimulus, **AT_240), kind)
    assert figure.texts[-1].get_text() == "240 px"


def test_the_foot_names_the_changes_of_the_stimulus(tmp_path: Path) -> None:
    changes = {"bar.growth.speed_deg_s": 40, "bar.centre_deg": [0, 5], "bar.growth.sides": "both"}
    stimulus = {"name": "bar", "changes": changes}
    stated = "bar.growth.speed_deg_s=40; bar.centre_deg=[0, 5]; bar.growth.sides=both"
    tuning = made(tmp_path, AXES, PEAKS, stimulus=stimulus, **AT_240)
    foot = plot_tuning(tuning)[0].texts[-1].get_text()
    assert " ".join(foot.split()) == f"240 px; {stated}"


def test_a_sweep_of_one_row_is_a_line(tmp_path: Path) -> None:
    """The value that stays is told at the foot."""
    values = {"disk.speed_deg_s": [14.4] * 4, "disk.luminance": [0.0, 0.3, 0.6, 0.9]}
    peaks = {"opplod": [4.0, 3, 2, 1]}
    figure, (panel,) = plot_tuning(made(tmp_path, values, peaks, **AT_240))
    np.testing.assert_allclose(np.asarray(panel.lines[0].get_xdata(), float), [0, 0.3, 0.6, 0.9])
    assert figure.texts[-1].get_text() == "240 px; disk.speed_deg_s=14.4"
    places = {"d.centre_deg.right": [0.0, 5, 10, 15], "d.centre_deg.up": [0.0] * 4}
    tuning = made(tmp_path, places, peaks, figure={"kind": "position"})
    assert plot_tuning(tuning)[1][0].get_xlabel() == "right (deg)"
    turned = {"bar.axis_deg": AXES["bar.axis_deg"], "bar.width_deg": [10.0] * 4}
    tuning = made(tmp_path, turned, PEAKS, symmetric=True)
    assert isinstance(plot_tuning(tuning)[1][0], PolarAxes)


def test_the_line_through_the_times_of_peaks() -> None:
    l_over_v, before = [0.01, 0.02, 0.04, 0.08], [0.01, 0.05, 0.07, 0.21]
    fit = PeakTimes.through(l_over_v, before)
    (slope, intercept), covariance = np.polyfit(l_over_v, before, 1, cov=True)
    assert (fit.slope, fit.delay_s) == pytest.approx((slope, -intercept))
    errors = stdtrit(2, 0.975) * np.sqrt(np.diag(covariance))
    assert [fit.slope_error, fit.delay_error_s] == pytest.approx(errors, rel=1e-3)
    assert PeakTimes(-1e-9, 0, 0, 0).text.startswith("slope 0.00 ± 0.00 (180 deg")
    assert PeakTimes(1.0, 0, 0, 0).angle_deg == pytest.approx(90)
    assert PeakTimes(np.sqrt(3), 0, 0, 0).angle_deg == pytest.approx(60)


def test_the_limits_are_those_of_student() -> None:
    for free in range(1, 60):
        l_over_v = np.linspace(0.01, 0.1, free + 2)
        before = 3 * l_over_v + 0.01 * (-1.0) ** np.arange(free + 2)
        covariance = np.polyfit(l_over_v, before, 1, cov=True)[1]
        error = stdtrit(free, 0.975) * np.sqrt(covariance[0, 0])
        assert PeakTimes.through(l_over_v, before).slope_error == pytest.approx(error, rel=1e-3)


def test_peaks_before_contact_over_l_over_v(tmp_path: Path) -> None:
    tuning = made(tmp_path, L_OVER_V, {"opplod": [4.0, 2, 1]})
    with pytest.raises(ResultError, match="has no column 'peak_before_contact_s'; run oppload tu"):
        plot_tuning(tuning, "contact")
    tuning.rows["peak_before_contact_s"] = [0.01, 0.03, 0.07]
    panel = plot_tuning(tuning, "contact")[1][0]
    np.testing.assert_allclose(y_of(panel.lines[0]), [-10, 70], atol=1e-9)
    np.testing.assert_allclose(y_of(panel.lines[1]), [10, 30, 70])
    label = "OppLoD\nslope 2.00 ± 0.00 (53 deg, 53 to 53), delay 10 ± 0 ms"
    assert panel.get_legend_handles_labels()[1][0] == label
    with pytest.raises(ResultError, match="not l/v; for kind 'contact' run 'oppload tune --fig"):
        plot_tuning(made(tmp_path, AXES, {"opplod": [1.0] * 4}), "contact")
    rates = L_OVER_V | {"display.frame_rate": [60.0, 60, 144]}
    with pytest.raises(ResultError, match=r"frame_rate', not only l/v; for kind"):
        plot_tuning(made(tmp_path, rates, {"opplod": [4.0, 2, 1]}), "contact")


def test_a_kind_that_does_not_suit_is_an_error_that_names_the_column(tmp_path: Path) -> None:
    values = {"disk.size_deg": [5.0, 9]}
    tuning = made(tmp_path, values, {"opplod": [1.0, 2]})
    with pytest.raises(ResultError, match=r"no column of a direction.*draw kind 'line'"):
        plot_tuning([tuning], "polar")
    with pytest.raises(ResultError, match=r"sweeps disk\.size_deg; a heat map needs two"):
        plot_tuning([tuning], "heat")
    damaged = made(tmp_path, {"disk.size_deg": ["5", "many"]}, {"opplod": [1.0, 2]})
    with pytest.raises(ResultError, match=r"holds 'many' in line 3, which is not a finite number"):
        plot_tuning(damaged, "line")
    values = {"disk.growth.speed_deg_s": [10.0, 20], "disk.size_deg": [5.0, 9]}
    with pytest.raises(ResultError, match=r"no column of a direction.*draw kind 'heat'"):
        plot_tuning(made(tmp_path, values, {"opplod": [1.0, 2]}), "polar")
    axes = made(tmp_path, AXES, {"opplod": [1.0] * 4})
    for table in (tuning, axes):  # as a line, and as a polar plot
        with pytest.raises(ResultError, match="column 'model' never holds 'dlgmd'; leave it out"):
            plot_tuning(table, models=["dlgmd"])


@pytest.mark.parametrize("words", [["True", "False"], ["both", "forward"]])
def test_words_stand_side_by_side_without_a_line(words: list[str], tmp_path: Path) -> None:
    table = made(tmp_path, {"bar.growth.sides": words}, {"opplod": [1.0, 2], "dlgmd": [4.0, 3]})
    _, (panel,) = plot_tuning(table)
    assert [label.get_text() for label in panel.get_xticklabels()] == words
    assert {line.get_linestyle() for line in panel.lines} == {"None"}
    np.testing.assert_allclose([y_of(line) for line in panel.lines], [[0.5, 1], [1, 0.75]])


def test_a_classic_figure_of_another_kind_has_the_title_of_its_stimulus(tmp_path: Path) -> None:
    figure = {"title": "Size at the peak", "kind": "contact"}
    tuning = made(tmp_path, L_OVER_V, {"opplod": [4.0, 2, 1]}, figure=figure)
    (panel,) = plot_tuning(tuning, "line")[1]
    assert panel.get_title("left") == "klapoetke2017/bar-expand-10"


def test_a_tuning_table_is_recognised_by_its_header(tmp_path: Path) -> None:
    table = write_tuning(tmp_path / "a.tuning.csv", AXES, PEAKS)
    assert is_tuning(table)
    table.write_text(table.read_text(), encoding="utf-8-sig")  # as spreadsheets save it
    assert is_tuning(table)
    assert read_tuning(table).parameters == tuple(AXES)
    other = tmp_path / "b.csv"
    other.write_text("frame,time_s\n0,0\n")
    assert not is_tuning(other)
    assert not is_tuning(tmp_path / "none.csv")


def test_a_third_parameter_of_a_single_value_leaves_a_heat_map(tmp_path: Path) -> None:
    swept = {"a.speed_deg_s": [10.0, 20] * 2, "a.size_deg": [5.0, 5, 9, 9], "scene.seed": [7.0] * 4}
    tuning = made(tmp_path, swept, {"opplod": [1.0, 2, 3, 4]}, **AT_240)
    for kind in (None, "heat"):
        figure, (panel, *_) = plot_tuning(tuning, kind)
        shares = np.asarray(panel.images[0].get_array(), float)
        np.testing.assert_allclose(shares, [[0.25, 0.5], [0.75, 1]])
        assert (panel.get_xlabel(), panel.get_ylabel()) == ("speed (deg/s)", "size (deg)")
        assert any("seed=7" in text.get_text() for text in figure.texts)


def test_a_heat_map_over_several_decades_is_logarithmic(tmp_path: Path) -> None:
    values = {"disk.growth.speed_deg_s": [10.0, 10, 20, 20], "disk.size_deg": [5.0, 9, 5, 9]}
    peaks_of = {"opplod": [1e-9, 2e-3, 4e-2, 1.0], "dlgmd": [0.2, 0.5, 0.8, 1]}
    tuning = made(tmp_path, values, peaks_of)
    _, (opplod, dlgmd) = plot_tuning(tuning)
    for panel in (opplod, dlgmd):  # both on one scale
        norm = panel.images[0].norm
        assert isinstance(norm, LogNorm)
        assert (norm.vmin, norm.vmax) == pytest.approx((1e-4, 1))
    _, (alone,) = plot_tuning(tuning, models=["dlgmd"])
    assert not isinstance(alone.images[0].norm, LogNorm)
    assert alone.images[0].get_clim() == (0, 1)
    assert {text.get_text() for text in opplod.texts} == {"<0.0001", "0.002", "0.04", "1"}


@pytest.mark.long
@SEVEN_AND_MANY
@pytest.mark.filterwarnings("error")  # of a layout that found no room
def test_heat_maps_of_many_detectors_are_small_and_on_one_scale(count: int, tmp_path: Path) -> None:
    values = {"disk.speed_deg_s": [10.0, 10, 20, 20], "disk.size_deg": [5.0, 9, 5, 9]}
    peaks_of = {name: [1e-9, 0.5, 4.0, 1e4] for name in list(detectors())[:count]}
    tuning = made(tmp_path, values, peaks_of)
    figure, axes = plot_tuning(tuning)
    figure.draw_without_rendering()
    assert len(axes) == count
    assert figure.get_figheight() <= MOST_HEIGHT
    assert {(panel.images[0].norm.vmin, panel.images[0].norm.vmax) for panel in axes} == {(1e-4, 1)}
    boxes = [panel.get_window_extent() for panel in axes]
    assert min(box.height for box in boxes) / figure.dpi > 0.9  # inches
    for above, below in zip(axes[:-4], axes[4:], strict=True):
        extent, box = below.get_tightbbox(), above.get_window_extent()
        assert extent is not None
        assert extent.y1 < box.y0  # the title of one is below the map above it
    np.testing.assert_allclose(np.asarray(axes[0].images[0].get_array()).max(), 1)


@pytest.mark.long
@SEVEN_AND_MANY
def test_more_than_six_curves_have_a_polar_plot_each(count: int, tmp_path: Path) -> None:
    directions = {"bar.rotation_deg": [float(angle) for angle in range(0, 360, 45)]}
    peaks_of = {name: [0.5, 1, 0, 1, 1, 1, 1, 1] for name in list(detectors())[:count]}
    tuning = made(tmp_path, directions, peaks_of)
    figure, axes = plot_tuning(tuning, lplc2="none")
    assert len(axes) == count
    figure.draw_without_rendering()
    assert figure.get_figheight() <= MOST_HEIGHT
    extents = [panel.get_tightbbox() for panel in axes]
    assert all(extent is not None and extent.y0 > 0 for extent in extents)  # nothing is cut
    names = [panel.get_title("left").split("\n")[0] for panel in axes]
    assert names == [detector_named(name).label for name in peaks_of]
    np.testing.assert_allclose(np.asarray(axes[3].lines[0].get_ydata())[:8], peaks_of["opplod"])


def test_the_numbers_of_the_radius_are_where_no_curve_is(tmp_path: Path) -> None:
    directions = {"bar.rotation_deg": [float(angle) for angle in range(0, 360, 45)]}
    peaks_of = {"opplod": [3.0, 3, 3, 3, 0, 0, 3, 3]}
    tuning = made(tmp_path, directions, peaks_of)
    _, (panel,) = plot_tuning(tuning, lplc2="none")
    assert isinstance(panel, PolarAxes)
    assert panel.get_rlabel_position() == pytest.approx(202.5)  # between 180 and 225 degrees
    _, (raw,) = plot_tuning(tuning, lplc2="none", scale="raw")
    assert raw.get_ylim()[1] > 3  # the outermost mark is not cut
    assert raw.get_xlabel() == "radius: response (arbitrary unit); angle: direction of motion"
    np.testing.assert_array_equal(y_of(raw.lines[0])[:8], peaks_of["opplod"])
    with pytest.raises(ParameterError, match="not 'threshold'"):
        plot_tuning(tuning, scale="threshold")


def test_a_kind_that_is_not_known_is_refused(tmp_path: Path) -> None:
    tuning = made(tmp_path, AXES, PEAKS)
    with pytest.raises(ParameterError, match="no kind 'lines' of a tuning plot; choose polar, "):
        plot_tuning(tuning, "lines")


def test_nothing_to_draw_is_refused() -> None:
    for draw in (plot_tuning, plot_curves, plot_rmo):
        with pytest.raises(ParameterError, match="there is no result to draw; give at least one"):
            draw([])


def test_tables_are_named_by_what_differs(tmp_path: Path) -> None:
    peaks_of = {"opplod": [4.0, 2, 1]}
    tables: list[Tuning] = []
    for name in ("x/loom-bright", "x/loom-dark"):
        path = tmp_path / f"{len(tables)}.tuning.csv"
        tables.append(read_tuning(write_tuning(path, L_OVER_V, peaks_of, name=name)))
    assert read_tuning(str(tables[0].path)).path == tables[0].path  # a text is a path too
    _, (panel,) = plot_tuning(tables)
    names = [text.partition(":")[0] for text in panel.get_legend_handles_labels()[1]]
    assert names == ["bright", "dark"]
    with pytest.raises(ParameterError, match="1 label for 2 tables;"):
        plot_tuning(tables, labels=["one"])


@pytest.mark.long
def test_an_indicator_is_part_of_the_name(tmp_path: Path) -> None:
    """In the names of tables where it differs, else in the title."""
    tables: list[Tuning] = []
    for number, seconds in enumerate((0.0, 1.0)):
        folder = tmp_path / str(number)
        folder.mkdir()
        tables.append(made(folder, AXES, {"opplod": [1.0, 4, 1, 4]}, indicator_s=seconds))
    _, (panel,) = plot_tuning(tables, lplc2="none")
    labels = [text.partition(", peak")[0] for text in panel.get_legend_handles_labels()[1]]
    assert labels == ["OppLoD, no indicator", "OppLoD, indicator of 1 s"]
    figure, _ = plot_tuning(tables[1])
    assert figure.get_suptitle().split("\n") == [
        "klapoetke2017/bar-expand-10, through an", "indicator of 1 s",
    ]  # fmt: skip
    figure, _ = plot_tuning([tables[1], tables[1]], labels=["a", "b"])
    assert figure.get_suptitle() == "through an indicator of 1 s"
    figure, _ = plot_tuning(tables[0])
    assert "indicator" not in figure.get_suptitle()
    # below the figure, where title and names are the user's
    figure, _ = plot_tuning(tables[1], title="mine")
    assert figure.texts[-1].get_text() == "indicator of 1 s"
    figure, _ = plot_tuning(tables, labels=["a", "b"])
    assert figure.texts[-1].get_text() == "b: indicator of 1 s"


@pytest.mark.parametrize(
    ("parameter", "label"),
    [
        ("bar.axis_deg", "axis (deg)"),
        ("disk.growth.speed_deg_s", "speed (deg/s)"),
        ("disk.growth.l_over_v_ms", "l/v (ms)"),
        ("disk.centre_deg.right", "right (deg)"),
        ("effects.noise", "effects noise"),
        ("display.frame_rate", "display frame rate (Hz)"),
        ("display.width", "display width (px)"),
        ("disk.motion.zoom_per_s", "zoom (1/s)"),
        ("thing.course.speed_m_s", "speed (m/s)"),
        ("seed", "seed"),
    ],
)
def test_swept_parameters_have_their_unit(parameter: str, label: str) -> None:
    assert described(parameter) == label


@pytest.mark.parametrize(
    "values", [{"bar.axis_deg": [45.0]}, {"disk.size_deg": [4.0]},
               {"disk.size_deg": [4.0], "disk.growth.speed_deg_s": [10.0]}],
)  # fmt: skip
def test_one_condition_is_no_curve(values: dict[str, list[float]], tmp_path: Path) -> None:
    tuning = made(tmp_path, values, {"opplod": [1.0], "dlgmd": [2.0]})
    with pytest.raises(ResultError, match="holds one condition, so that there is nothing to draw"):
        plot_tuning(tuning)


def two_gains(folder: Path, values: dict[str, list[float]]) -> list[Tuning]:
    """Two tables of OppLoD over the same values, of two gains."""
    tables = []
    for gain in (1, 2):
        stimulus = {"name": "x", "first": {"display": {"background": 0.5}}}
        peaks = {"opplod": [1.0, 2, 4, 4]}
        tables.append(
            made(folder, values, peaks, stimulus=stimulus, parameters={"opplod": {"gain": gain}})
        )
        tables[-1].rows["peak_before_contact_s"] = [0.03, 0.05, 0.09, 0.11]
        tables[-1].rows["size_at_peak_deg"] = [40.0, 40, 40, 180]
    return tables


@pytest.mark.parametrize(
    ("kind", "key"),
    [
        ("contact", "disk.growth.l_over_v_ms"),
        ("contrast", "disk.luminance"),
        ("habituation", "presentation"),
        ("line", "disk.size_deg"),
        ("polar", "bar.axis_deg"),
    ],
)
def test_two_tables_of_one_detector_have_two_colours(tmp_path: Path, kind: str, key: str) -> None:
    tables = two_gains(tmp_path, {key: [0.2, 0.4, 0.8, 1.0]})
    _, axes = plot_tuning(tables, kind, published=False, lplc2="none")
    for panel in axes:
        marked = [line for line in panel.lines if line.get_marker() in MARKERS]
        colours = {line.get_color(): line for line in marked}
        assert list(colours) == list(CYCLE[:2])
    handles, labels = axes[0].get_legend_handles_labels()
    assert [getp(handle, "color") for handle in handles[:2]] == list(CYCLE[:2])
    assert ["opplod.gain 1" in label for label in labels[:2]] == [True, False]
    _, axes = plot_tuning(tables[0], kind, published=False, lplc2="none")
    assert axes[0].lines[0].get_color() == detector_named("opplod").colour


def test_a_detector_in_one_of_two_tables_keeps_its_colour() -> None:
    assert [look["color"] for look in looks_of(["dlgmd", "opplod"])] == [
        detector_named(name).colour for name in ("dlgmd", "opplod")
    ]
    many = looks_of(["opplod"] * 28)
    assert len({(look["color"], look["linestyle"]) for look in many}) == 28


def test_the_axis_begins_at_zero_and_cuts_no_marker(tmp_path: Path) -> None:
    tables = two_gains(tmp_path, {"disk.luminance": [0.2, 0.4, 0.8, 1.0]})
    tables[0].rows["peak"] = [0.8, 0.9, 0.9, 1.0]
    for kind in ("contrast", "line"):
        _, (panel,) = plot_tuning(tables[0], kind)
        assert panel.get_ylim() == pytest.approx((0, 1.06))
    l_over_v = two_gains(tmp_path, {"disk.growth.l_over_v_ms": [10.0, 20, 40, 50]})
    assert plot_tuning(l_over_v[0], "contact")[1][1].get_ylim() == (0, 190)


def test_a_rotated_scene_is_no_direction_of_motion(tmp_path: Path) -> None:
    for key, angle in (
        ("scene.rotation_deg", "rotation of the scene"),
        ("bar.axis_deg", "direction of motion"),
    ):
        tuning = made(tmp_path, {key: AXES["bar.axis_deg"]}, PEAKS)
        _, (panel,) = plot_tuning(tuning)
        assert panel.get_xlabel() == f"radius: response / peak; angle: {angle}"
        names = [curve.name for curve in polar_curves(tuning)]
        assert any(name.startswith("LPLC2") for name in names) == (key == "bar.axis_deg")
