"""The classic figures, from tables made by hand."""

from __future__ import annotations

import json
import math
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from matplotlib.collections import QuadMesh
from matplotlib.contour import ContourSet
from matplotlib.lines import Line2D

from oppload_cli.errors import ResultError
from oppload_cli.plots.classic import _half_distance
from oppload_cli.plots.peak_times import PeakTimes
from oppload_cli.plots.style import INK
from oppload_cli.plots.tuning_plots import lines_of, plot_tuning, summary_of
from oppload_cli.reference import angular_thresholds
from oppload_cli.results.tuning import read_tuning
from tests.results.make import write_tuning

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    from oppload_cli.results.tuning import Tuning


def y_of(line: Line2D) -> NDArray[np.float64]:
    return np.asarray(line.get_ydata(), float)


def made(
    path: Path, values: dict[str, list[Any]], peaks: dict[str, list[float]], **more: Any
) -> Tuning:
    """A table with a sidecar of some display and object."""
    first = {
        "display": {
            "width": 360, "height": 360, "background": 0.5, "projection": "flat",
            **more.pop("scale", {"pixels_per_degree": 5}),
            "frame_rate": more.pop("rate", "10000"),
        },
        "object": [{"growth": {"most_deg": more.pop("most_deg", 180)}}],
    }  # fmt: skip
    stimulus = {"name": "x", "first": first}
    return read_tuning(write_tuning(path, values, peaks, stimulus=stimulus, **more))


def ends(*axes: float) -> dict[str, list[Any]]:
    """Each axis of a bar that grows at both ends, then of one that grows at one end."""
    sides = ["both"] * len(axes) + ["forward"] * len(axes)
    return {"bar.axis_deg": [*axes, *axes], "bar.growth.sides": sides}


L_OVER_V = [10.0, 20, 40, 80]


def contact(path: Path, **more: Any) -> Tuning:
    tuning = made(path, {"disk.growth.l_over_v_ms": L_OVER_V}, {"opplod": [4.0, 3, 2, 1]}, **more)
    tuning.rows["peak_before_contact_s"] = [
        3 * l_over_v_ms / 1000 - 0.02 for l_over_v_ms in L_OVER_V
    ]
    tuning.rows["size_at_peak_deg"] = [40.0, 38, 37, 37]
    return tuning


def test_a_straight_line_is_found_exactly() -> None:
    x = np.array(L_OVER_V) / 1000
    fit = PeakTimes.through(x, 4.7 * x - 0.027)
    assert (fit.slope, fit.delay_s) == pytest.approx((4.7, 0.027), abs=1e-12)
    assert (fit.slope_error, fit.delay_error_s) == pytest.approx((0, 0), abs=1e-12)
    assert fit.angle_deg == pytest.approx(24, abs=0.1)
    assert fit.error_s(x) == pytest.approx(np.zeros(4), abs=1e-8)


def test_the_limits_hold_in_95_of_100_experiments() -> None:
    x = np.array([0.01, 0.02, 0.03, 0.05, 0.08])
    random = np.random.default_rng(1)
    held = np.zeros(4)
    for _ in range(2000):
        fit = PeakTimes.through(x, 3 * x - 0.02 + random.normal(0, 0.01, 5))
        low, high = fit.angle_limits_deg
        held += (
            abs(fit.slope - 3) <= fit.slope_error,
            abs(fit.delay_s - 0.02) <= fit.delay_error_s,
            low <= math.degrees(2 * math.atan(1 / 3)) <= high,
            abs(fit.slope * 0.04 - fit.delay_s - 0.1) <= fit.error_s(np.array([0.04]))[0],
        )
    assert held / 2000 == pytest.approx([0.95] * 4, abs=0.015)


def test_a_line_that_falls_has_no_threshold(tmp_path: Path) -> None:
    """Such as of peaks in the last frame of clips that end too early."""
    tuning = contact(tmp_path / "a.tuning.csv", figure={"kind": "contact"})
    tuning.rows["peak_before_contact_s"] = before = [1.166667, 0.9, 0.216667, 0.216667]
    slope = np.polyfit(np.array(L_OVER_V) / 1000, before, 1)[0]
    label = plot_tuning(tuning, "contact")[1][0].get_legend_handles_labels()[1][0]
    assert label.startswith(f"OppLoD\nslope {slope:.2f} ± ")
    assert "(no threshold), delay" in label
    summary = summary_of(tuning)["opplod"]
    assert summary["slope"] < 0
    assert summary["threshold_deg"] is summary["threshold_limits_deg"] is None


def test_a_long_fit_takes_two_lines_of_the_legend(tmp_path: Path) -> None:
    tuning = contact(tmp_path / "a.tuning.csv")
    tuning.rows["peak_before_contact_s"] = [-11, 6.7, 0.9, 12.2]
    label = plot_tuning(tuning, "contact")[1][0].get_legend_handles_labels()[1][0]
    _, fit, delay = label.splitlines()
    assert f"{fit} {delay}" in lines_of([tuning], "contact")[0]
    assert delay.startswith("delay ")


def test_a_wide_interval_makes_the_axis_at_most_twice_as_long(tmp_path: Path) -> None:
    tuning = contact(tmp_path / "a.tuning.csv")
    panel = plot_tuning(tuning, "contact", published=False)[1][0]
    narrow = np.diff(panel.get_ylim())[0]
    assert narrow < 300  # the points are from 10 to 220 ms
    tuning.rows["peak_before_contact_s"] = [0.1, 0.5, 0.2, 0.4]
    panel = plot_tuning(tuning, "contact", published=False)[1][0]
    low, high = panel.get_ylim()
    (band,) = panel.collections
    assert band.get_datalim(panel.transData).height > 1.5 * (high - low)
    assert high - low < 2 * 1.1 * 520  # points and line span 500 ms or a little more
    assert low < 100
    assert high > 500


def test_without_any_peak_the_axis_shows_the_l_over_v_that_were_measured(tmp_path: Path) -> None:
    values: dict[str, list[Any]] = {"disk.growth.l_over_v_ms": L_OVER_V}
    path = tmp_path / "a.tuning.csv"
    tuning = made(path, values, {"opplod": [0.0] * 4, "dlgmd": [0.0] * 4}, most_deg=60)
    tuning.rows["peak_before_contact_s"] = math.nan
    panel = plot_tuning(tuning, "contact", published=False)[1][0]
    assert panel.get_xlim() == pytest.approx((0, 84))
    texts = panel.get_legend_handles_labels()[1]
    assert texts[:2] == ["OppLoD, no response", "D-LGMD, no response"]
    tuning.rows.loc[tuning.rows["model"] == "dlgmd", "peak"] = 1.0  # and no contact
    with pytest.raises(ResultError, match="'peak_before_contact_s' is empty, as the stimulus has"):
        plot_tuning(tuning, "contact")


@pytest.mark.parametrize("kind", ["contact", "line", "polar", "heat"])
def test_a_table_without_any_peak_is_refused(tmp_path: Path, kind: str) -> None:
    tuning = contact(tmp_path / "a.tuning.csv")
    tuning.rows["peak"] = math.nan
    with pytest.raises(ResultError, match="column 'peak' is empty; nothing is drawn"):
        plot_tuning(tuning, kind)


def test_times_in_whole_frames_are_no_better_known_than_to_a_frame() -> None:
    x, frame = np.array([0.02, 0.04, 0.06, 0.08]), 1 / 120
    random = np.random.default_rng(2)
    held = 0
    for _ in range(500):
        before = frame * np.round((3 * x - 0.03 * random.random()) / frame)
        fit = PeakTimes.through(x, before, frame)
        held += abs(fit.slope - 3) <= fit.slope_error
    assert held >= 475
    even = PeakTimes.through(x, 3 * x, frame)
    wide = 4.303 * frame / math.sqrt(12 * np.sum((x - 0.05) ** 2))
    assert even.slope_error == pytest.approx(wide)


def test_the_line_known_best_in_the_middle() -> None:
    x = np.array([0.01, 0.02, 0.06])
    fit = PeakTimes.through(x, [0.0, 0.05, 0.14])
    assert fit.error_s(np.zeros(1)) == pytest.approx([fit.delay_error_s])
    around = fit.error_s(np.array([0.02, 0.03, 0.04]))
    assert around[1] < around[0] == pytest.approx(around[2])


@pytest.mark.parametrize(
    "scale", [{"pixels_per_degree": 5}, {"field_of_view_deg": 60},
              {"pixels_per_degree": None, "field_of_view_deg": 60}],
)  # fmt: skip
def test_the_limit_is_drawn_for_either_way_to_give_the_scale(
    scale: dict[str, Any], tmp_path: Path
) -> None:
    """300 px across are 60 degrees; the shorter side of 250 px spans 50."""
    tuning = contact(tmp_path / "a.tuning.csv")
    display = {"width": 300, "height": 250, "projection": "flat", **scale}
    ground, disk = {"kind": "texture"}, {"growth": {"most_deg": 180}}
    for objects in ([disk], [ground, disk]):
        tuning.sidecar["stimulus"]["first"] = {"display": display, "object": objects}
        _, (times, _) = plot_tuning(tuning, "contact")
        labels = times.get_legend_handles_labels()[1]
        assert "object fills the display or stops growing: 50 deg" in labels


def test_the_limit_of_a_perspective_display_is_that_of_its_shorter_side(tmp_path: Path) -> None:
    """400 px across are 90 degrees: the eye is 200 px away, and 200 px are 2 atan(100 / 200)."""
    tuning = contact(tmp_path / "a.tuning.csv")
    display = {"width": 400, "height": 200, "projection": "perspective", "field_of_view_deg": 90}
    tuning.sidecar["stimulus"]["first"]["display"] = display
    _, (times, _) = plot_tuning(tuning, "contact")
    labels = times.get_legend_handles_labels()[1]
    assert "object fills the display or stops growing: 53 deg" in labels


def test_tables_of_several_displays_have_a_limit_each(tmp_path: Path) -> None:
    """The second and the third display share their limit, of 300 px at 5 px/deg."""
    tunings = [contact(tmp_path / f"{name}.tuning.csv", most_deg=180) for name in "abc"]
    for tuning, view in zip(tunings, (72, 60, 60), strict=True):
        display = {"width": 300, "height": 300, "projection": "flat", "field_of_view_deg": view}
        tuning.sidecar["stimulus"]["first"]["display"] = display
    _, (times, sizes) = plot_tuning(tunings, "contact", models=["opplod"], published=False)
    labels = times.get_legend_handles_labels()[1]
    assert labels[3:] == ["object fills the display or stops growing: 60 and 72 deg"]
    heights = [set(np.asarray(line.get_ydata()).tolist()) for line in sizes.lines]
    assert [height for height in heights if height in ({60}, {72})] == [{60}, {72}]


def test_times_and_sizes_of_peaks_beside_published_neurons(tmp_path: Path) -> None:
    tuning = contact(tmp_path / "a.tuning.csv", most_deg=60)
    _, (times, sizes) = plot_tuning(tuning, "contact")
    labels = times.get_legend_handles_labels()[1]
    assert labels[0] == "OppLoD\nslope 3.00 ± 0.00 (37 deg, 37 to 37), delay 20 ± 0 ms"
    assert labels[1] == "object fills the display or stops growing: 60 deg"
    study = "(Gabbiani et al. 1999)"
    assert labels[2:] == [
        f"locust DCMD, range over animals\n15 to 40 deg, 15 to 35 ms {study}",
        f"locust DCMD, example\n24 deg, 27 ms {study}",
        "fly giant fibre, excitation by size\n42 deg, 11.9 ms (von Reyn et al. 2017)",
    ]
    edge, example, fibre = times.lines[3:]
    right = times.get_xlim()[1]
    assert y_of(edge)[1] == pytest.approx(right / math.tan(math.radians(30)))
    assert y_of(example) == pytest.approx([-27, right / math.tan(math.radians(12)) - 27])
    assert y_of(fibre) == pytest.approx([-11.9, right / math.tan(math.radians(21)) - 11.9])
    np.testing.assert_allclose(y_of(sizes.lines[0]), [40, 38, 37, 37])
    # The range over the animals, at the right end and for the sizes.
    (animals,) = (drawn for drawn in times.collections if drawn.get_label() == labels[2])
    last = [y for x, y in np.asarray(animals.get_paths()[0].vertices, float) if x == right]
    ends = [right / math.tan(math.radians(20)) - 35, right / math.tan(math.radians(7.5)) - 15]
    assert sorted(set(last)) == pytest.approx(ends)
    band = sizes.patches[0].get_extents().transformed(sizes.transData.inverted())
    assert (band.y0, band.y1) == pytest.approx((15, 40))
    assert (sizes.get_xlabel(), sizes.get_ylabel()) == ("l/v (ms)", "size at peak (deg)")
    coarse = contact(tmp_path / "b.tuning.csv", rate="60000/1001")
    _, (times, _) = plot_tuning(coarse, "contact", published=False)
    assert "± 0.3" in times.get_legend_handles_labels()[1][0]
    fit = PeakTimes.through(np.array(L_OVER_V) / 1000, coarse.rows["peak_before_contact_s"],
                            1001 / 60000)  # fmt: skip
    limits = times.collections[0].get_paths()[0].get_extents()
    assert limits.y0 == pytest.approx(-20 - 1000 * fit.delay_error_s, abs=0.1)
    _, (alone, _) = plot_tuning(tuning, "contact", published=False)
    assert len(alone.get_legend_handles_labels()[1]) == 2
    assert lines_of([tuning], "contact") == [
        "OppLoD: slope 3.00 ± 0.00 (37 deg, 37 to 37), delay 20 ± 0 ms"
    ]


def test_the_display_ends_before_a_disk_of_180_degrees(tmp_path: Path) -> None:
    _, (times, _) = plot_tuning(contact(tmp_path / "a.tuning.csv"), "contact", published=False)
    assert times.get_legend_handles_labels()[1][1].endswith("72 deg")
    wide = contact(tmp_path / "b.tuning.csv", scale={"field_of_view_deg": 90})
    (label,) = plot_tuning(wide, "contact", published=False)[1][0].get_legend_handles_labels()[1][
        1:
    ]
    assert label.endswith("90 deg")
    for wrong in (0, "x"):
        tuning = contact(tmp_path / "c.tuning.csv", scale={"pixels_per_degree": wrong})
        _, (times, _) = plot_tuning(tuning, "contact", published=False)
        assert len(times.get_legend_handles_labels()[1]) == 1


def test_published_thresholds_have_source_and_slope() -> None:
    peaks = {(threshold.neuron, threshold.kind): threshold for threshold in angular_thresholds()}
    example = peaks["locust DCMD", "example"]
    assert (example.angle_deg, example.delay_ms) == (24, 27)
    assert example.slope == pytest.approx(4.70, abs=0.01)
    assert (peaks["locust DCMD", "lower limit"].angle_deg, len(peaks)) == (15, 4)
    assert all(threshold.source for threshold in peaks.values())


def grid(values: NDArray[np.float64], step: float) -> dict[str, list[float]]:
    side = (np.arange(len(values)) - len(values) // 2) * step
    up, right = (places.ravel().tolist() for places in np.meshgrid(side, side, indexing="ij"))
    return {"disk.centre_deg.right": right, "disk.centre_deg.up": up}


def cells_of(panel: Axes) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """The values of a map, and the edges of its columns and rows."""
    (mesh,) = panel.collections[:1]
    assert isinstance(mesh, QuadMesh)
    corners = np.asarray(mesh.get_coordinates())
    return np.asarray(mesh.get_array(), float), corners[0, :, 0], corners[:, 0, 1]


def test_positions_at_unequal_steps_have_their_true_distances(tmp_path: Path) -> None:
    places = [(right, up) for up in (-10.0, 0, 14) for right in (-10.0, 0, 10, 14, 20)]
    values = {f"disk.centre_deg.{side}": [place[at] for place in places]
              for at, side in enumerate(("right", "up"))}  # fmt: skip
    tuning = made(tmp_path / "a.tuning.csv", values, {"opplod": [float(at) for at in range(1, 16)]})
    for kind in ("position", "heat"):
        _, (panel, *_) = plot_tuning(tuning, kind)
        shown, x, y = cells_of(panel)
        assert x.tolist() == [-15, -5, 5, 12, 17, 23]
        assert y.tolist() == [-15, -5, 7, 21]
        assert shown[2, 4] == 1
    assert [label.get_text() for label in panel.get_xticklabels()] == ["-10", "0", "10", "14", "20"]
    assert panel.get_xticks().tolist() == [-10, 0, 10, 14, 20]


def test_a_map_of_positions_is_drawn_where_they_are(tmp_path: Path) -> None:
    side = np.array([-20.0, -15, -10, -5, 0, 5, 10, 15, 20])
    right, up = np.meshgrid(side - 5, side, indexing="xy")
    cone: NDArray[np.float64] = np.maximum(0.0, 1 - np.hypot(right, up) / 16)
    peaks = {"opplod": (7 * cone).ravel().tolist(), "dlgmd": [1.0] * 81}
    tuning = made(tmp_path / "a.tuning.csv", grid(cone, 5), peaks, figure={"kind": "position"})
    _, (panel, whole) = plot_tuning(tuning)
    shown, x, y = cells_of(panel)
    row, column = np.unravel_index(int(shown.argmax()), shown.shape)
    assert (x[column] + x[column + 1]) / 2 == pytest.approx(5)
    assert (y[row] + y[row + 1]) / 2 == pytest.approx(0)
    assert x == pytest.approx(np.arange(-22.5, 25, 5))
    assert panel.get_title(loc="left") == "OppLoD\nhalf at 8 deg"
    assert len(whole.collections) == 1
    line = panel.collections[1]  # at half: a circle of 8 degrees about the peak
    assert isinstance(line, ContourSet)
    x, y = np.asarray(line.get_paths()[0].vertices, float).T
    np.testing.assert_allclose(np.hypot(x - 5, y), 8, atol=1)
    assert whole.get_title(loc="left") == "D-LGMD\nnever falls to half"


def test_a_map_that_falls_to_half_on_one_side_only(tmp_path: Path) -> None:
    side = np.array([-20.0, -15, -10, -5, 0, 5, 10, 15, 20])
    right, _ = np.meshgrid(side, side, indexing="xy")
    edge: NDArray[np.float64] = np.where(right < 0, 0.2, 1.0)
    peaks = {"opplod": edge.ravel().tolist()}
    tuning = made(tmp_path / "a.tuning.csv", grid(edge, 6), peaks)
    _, (panel,) = plot_tuning(tuning, "position")
    assert panel.get_title(loc="left") == "OppLoD\nhalf on some sides only"


def test_the_distance_of_half_is_the_mean_over_four_sides() -> None:
    x, y = np.array([-20.0, 0, 10]), np.array([-40.0, 0, 36])
    share = np.zeros((3, 3))
    share[1, 1] = 1
    assert _half_distance(x, y, share) == "half at 13 deg"  # 10, 5, 20 and 18
    share[1, 2] = share[2, 1] = 0.4  # half is at 5 / 6 of the way there
    assert _half_distance(x, y, share) == "half at 17 deg"  # 10, 8.3, 20 and 30


@pytest.mark.parametrize("axes", [(0, 270, 180, 90), (360, -90, -180, 90)])
def test_both_ends_over_one(axes: tuple[float, ...], tmp_path: Path) -> None:
    peaks = {"opplod": [6.0] * 4 + [2.0, 1, 1, 0]}
    tuning = made(tmp_path / "a.tuning.csv", ends(*axes), peaks)
    figure, (panel,) = plot_tuning(tuning, "ends")
    total = y_of(panel.lines[2])
    for line in panel.lines:  # from left to right, whatever the order of the sweep
        np.testing.assert_array_equal(np.asarray(line.get_xdata()), [0, 90, 180, 270])
    np.testing.assert_allclose(total, np.array([3, 1, 3, 1]) / 6)
    assert panel.get_title(loc="left") == "OppLoD, peak 6\n(arbitrary unit)\nboth / one 3 to 6"
    assert "LPLC2 neurons: 2.9 to 4.6" in figure.legends[0].get_title().get_text()


def test_a_response_to_both_ends_alone_is_over_any_number(tmp_path: Path) -> None:
    peaks = {"opplod": [0.0, 2, 0, 0]}  # no response along the first axis
    tuning = made(tmp_path / "a.tuning.csv", ends(0, 90), peaks)
    _, (panel,) = plot_tuning(tuning, "ends")
    assert panel.get_title(loc="left") == "OppLoD, peak 2\n(arbitrary unit)\nboth / one over 1000"


def test_contrast_is_a_share_of_the_ground(tmp_path: Path) -> None:
    values = {"disk.luminance": [1.0, 0.0, 0.4]}
    tuning = made(tmp_path / "a.tuning.csv", values, {"opplod": [2.0, 4, 1]})
    _, (panel,) = plot_tuning(tuning, "contrast")
    contrast = np.asarray(panel.lines[0].get_xdata(), float)
    np.testing.assert_allclose(contrast, [-100, -20, 0, 100])
    np.testing.assert_allclose(y_of(panel.lines[0]), [1, 0.25, np.nan, 0.5])
    (tmp_path / "a.tuning.json").unlink()
    with pytest.raises(ResultError, match="contrast needs a ground that is not black"):
        plot_tuning(read_tuning(tmp_path / "a.tuning.csv"), "contrast")


def test_contrast_is_that_of_the_inverted_frames(tmp_path: Path) -> None:
    path = tmp_path / "a.tuning.csv"
    made(path, {"disk.luminance": [0.0, 0.4, 1.0]}, {"opplod": [1.0, 2, 3]})
    sidecar = json.loads(path.with_suffix(".json").read_text())
    sidecar["stimulus"]["first"] |= {"display": {"background": 0.6}, "effects": {"invert": True}}
    path.with_suffix(".json").write_text(json.dumps(sidecar))
    _, (panel,) = plot_tuning(read_tuning(path), "contrast")
    contrast = np.asarray(panel.lines[0].get_xdata(), float)
    np.testing.assert_allclose(contrast, [-100, 0, 50, 150])  # of 0, 0.6 and 1 to the ground 0.4


def test_a_contrast_of_0_that_was_measured_is_joined(tmp_path: Path) -> None:
    values = {"disk.luminance": [0.4, 0.5, 0.6]}
    tuning = made(tmp_path / "a.tuning.csv", values, {"opplod": [2.0, 0, 2]})
    np.testing.assert_allclose(y_of(plot_tuning(tuning, "contrast")[1][0].lines[0]), [1, 0, 1])


@pytest.mark.parametrize(
    ("kind", "values"),
    [
        ("polar", {"bar.axis_deg": [0.0, 90, 180, 270]}),
        ("line", {"disk.size_deg": [1.0, 2, 3, 4]}),
        ("heat", {"disk.size_deg": [1.0, 1, 2, 2], "disk.speed_deg_s": [1.0, 2, 1, 2]}),
        ("contrast", {"disk.luminance": [0.0, 0.2, 0.8, 1]}),
        ("habituation", {"presentation": [1.0, 2, 3, 4]}),
        ("contact", {"disk.growth.l_over_v_ms": [10.0, 20, 30, 40]}),
        ("position", {"d.centre_deg.right": [0.0, 1, 0, 1], "d.centre_deg.up": [0.0, 0, 1, 1]}),
    ],
)
def test_the_picture_says_whose_curve_means_little(
    kind: str, values: dict[str, list[Any]], tmp_path: Path
) -> None:
    doubts = [{"model": "dlgmd", "note": "below it"}]
    peaks = {"opplod": [1.0, 2, 3, 4], "dlgmd": [1.0, 2, 3, 4]}
    tuning = made(tmp_path / "a.tuning.csv", values, peaks, doubts=doubts)
    tuning.rows["peak_before_contact_s"] = 0.1
    axes = plot_tuning(tuning, kind, published=False)[1]
    said = [panel.get_title("left") for panel in axes]
    said += [label for panel in axes for label in panel.get_legend_handles_labels()[1]]
    (label,) = [text for text in said if "below it" in text]
    assert label.startswith("D-LGMD")


@pytest.mark.parametrize("doubts", ["damaged", ["damaged"], [{"note": "of no detector"}], None])
def test_damaged_notes_are_passed_over(doubts: object, tmp_path: Path) -> None:
    peaks = {"opplod": [1.0, 2, 3, 4], "dlgmd": [1.0, 2, 3, 4]}
    values = {"disk.size_deg": [1.0, 2, 3, 4]}
    tuning = made(tmp_path / "a.tuning.csv", values, peaks, doubts=doubts)
    (panel,) = plot_tuning(tuning, "line", published=False)[1]
    assert all("\n" not in label for label in panel.get_legend_handles_labels()[1])


def test_habituation_is_relative_to_the_first(tmp_path: Path) -> None:
    peaks = {"opplod": [4.0, 2, 6], "dlgmd": [1.0, 4, 2]}
    tuning = made(tmp_path / "a.tuning.csv", {"presentation": [3.0, 1, 2]}, peaks)
    _, (panel,) = plot_tuning(tuning, "habituation")
    np.testing.assert_allclose(y_of(panel.lines[0]), [1, 3, 2])
    np.testing.assert_allclose(y_of(panel.lines[1]), [1, 0.5, 0.25])
    assert panel.get_ylim() == pytest.approx((0, 3.3))
    assert panel.get_legend_handles_labels()[1] == [
        "OppLoD: last / first 2.000", "D-LGMD: last / first 0.250",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        ("contact", "not l/v; for kind 'contact' run 'oppload tune --figure peak-time'"),
        ("position", "not a position; run 'oppload tune --figure position'"),
        ("ends", "not the sides and the axis of a bar; run 'oppload tune --figure bar-ends'"),
        ("contrast", "not a luminance; run 'oppload tune --figure contrast'"),
        ("habituation", "not presentations in a row; run 'oppload tune --figure habituation'"),
    ],
)
def test_a_table_of_something_else(kind: str, message: str, tmp_path: Path) -> None:
    tuning = made(tmp_path / "a.tuning.csv", {"disk.size_deg": [5.0, 9]}, {"opplod": [1.0, 2]})
    with pytest.raises(ResultError, match=f"sweeps 'disk.size_deg', {message}"):
        plot_tuning(tuning, kind)


def test_positions_that_are_no_grid_and_two_tables(tmp_path: Path) -> None:
    values = {"disk.centre_deg.right": [0.0, 5, 9], "disk.centre_deg.up": [0.0, 0, 9]}
    tuning = made(tmp_path / "a.tuning.csv", values, {"opplod": [1.0, 2, 3]})
    with pytest.raises(ResultError, match="its positions are no grid; draw kind 'heat'"):
        plot_tuning(tuning, "position")
    with pytest.raises(ResultError, match="a map of positions shows one table"):
        plot_tuning([tuning, tuning], "position", labels=["a", "b"])


@pytest.mark.parametrize("kind", ["contact", "contrast", "habituation", "ends", "position"])
def test_detectors_without_a_response_and_many_of_them(kind: str, tmp_path: Path) -> None:
    models = ("opplod", "dlgmd", "lgmd2", "plgmd", "emd_lplc2_gf")
    every: dict[str, dict[str, list[Any]]] = {
        "contact": {"disk.growth.l_over_v_ms": [10.0, 20, 30, 40]},
        "contrast": {"disk.luminance": [0.0, 0.2, 0.8, 1]},
        "habituation": {"presentation": [1.0, 2, 3, 4]},
        "ends": ends(0, 180),
        "position": grid(np.zeros((2, 2)), 5),
    }
    values = every[kind]
    peaks = {name: [0.0] * 4 if at else [1.0, 2, 2, 1] for at, name in enumerate(models)}
    tuning = made(tmp_path / "a.tuning.csv", values, peaks)
    tuning.rows["peak_before_contact_s"] = 0.1
    figure, axes = plot_tuning(tuning, kind)
    assert len(axes) == (5 if kind in {"ends", "position"} else 1)
    assert figure.get_figwidth() == pytest.approx(17.8 / 2.54)
    with pytest.raises(ResultError, match="'model' never holds 'lgmd1_group'; leave it out"):
        plot_tuning(tuning, kind, models=[models[0], "lgmd1_group"])


def test_of_many_detectors_none_sets_the_axis_alone(tmp_path: Path) -> None:
    models = ("opplod", "dlgmd", "lgmd2", "plgmd", "area_growth")
    rising = {name: [1.0, 2, 3] for name in models}
    tuning = made(tmp_path / "a.tuning.csv", {"disk.growth.l_over_v_ms": [10.0, 20, 40]}, rising)
    early = tuning.rows["model"] == "area_growth"
    tuning.rows["peak_before_contact_s"] = np.where(early, 1.9, 0.1)
    (panel,) = plot_tuning(tuning, "contact")[1]
    labels = panel.get_legend_handles_labels()[1]
    assert panel.get_ylim()[1] == pytest.approx(40 / math.tan(math.radians(5)))
    assert [label for label in labels if "(above)" in label] == [
        "area growth: 180 deg, -1900 ms (above)"
    ]
    assert labels[0] == "OppLoD: 180 deg, -100 ms"


def test_two_l_over_v_make_no_line(tmp_path: Path) -> None:
    values = {"disk.growth.l_over_v_ms": [10.0, 20, 20]}
    tuning = made(tmp_path / "a.tuning.csv", values, {"opplod": [1.0, 2, 3]})
    tuning.rows["peak_before_contact_s"] = [0.01, 0.03, 0.03]
    assert lines_of([tuning], "contact") == ["OppLoD: fewer than three peaks, no line"]
    assert plot_tuning(tuning, "contact")[1][0].get_legend_handles_labels()[1][0] == "OppLoD"


def test_a_stimulus_without_contact_has_no_figure_over_l_over_v(tmp_path: Path) -> None:
    values = {"bar.growth.l_over_v_ms": [10.0, 20, 40]}
    tuning = made(tmp_path / "a.tuning.csv", values, {"opplod": [1.0, 2, 3], "dlgmd": [0.0, 0, 0]})
    tuning.rows["peak_before_contact_s"] = np.nan
    assert lines_of([tuning], "contact") == [
        "OppLoD: a stimulus without contact, no line",
        "D-LGMD: fewer than three peaks, no line",
    ]
    with pytest.raises(ResultError, match="is empty, as the stimulus has no contact"):
        plot_tuning(tuning, "contact", models=["opplod"])


def test_the_sum_of_single_ends_is_inside_the_axes(tmp_path: Path) -> None:
    peaks = {"opplod": [2.0, 2, 2, 2], "dlgmd": [2.0, 2, 1, 1]}
    tuning = made(tmp_path / "a.tuning.csv", ends(0, 180), peaks)
    figure, axes = plot_tuning(tuning, "ends")
    for panel in axes:
        assert panel.get_ylim()[0] == 0
        assert panel.get_ylim()[1] > 2
        assert not any(line.get_clip_on() for line in panel.lines)  # nor is a marker at 0 cut
    # Its panels have two colours.
    assert {handle.get_color() for handle in figure.legends[0].findobj(Line2D)} == {INK}


def test_ratios_of_three_digits_have_no_exponent(tmp_path: Path) -> None:
    peaks = {"opplod": [6.7, 12.3, 0.1, 0.1]}
    tuning = made(tmp_path / "a.tuning.csv", ends(0, 90), peaks)
    _, (panel,) = plot_tuning(tuning, "ends")
    assert panel.get_title(loc="left") == "OppLoD, peak 12\n(arbitrary unit)\nboth / one 67 to 123"
