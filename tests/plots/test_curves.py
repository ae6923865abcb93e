from __future__ import annotations

import json
import math
import pickle
from dataclasses import replace
from itertools import combinations, pairwise
from typing import TYPE_CHECKING

import matplotlib.colors
import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.text import Text

from oppload_cli.errors import ParameterError, ResultError
from oppload_cli.models.registry import detector_named, detectors
from oppload_cli.plots.curves import _binned, plot_curves
from oppload_cli.plots.rmo_curves import plot_rmo
from oppload_cli.plots.style import COLUMN, CYCLE, METADATA, MOST_HEIGHT, PAGE, save
from oppload_cli.results.result_files import read_result
from oppload_cli.stimulus import ground_truth, load
from tests.results.make import frame_rows, write_result, write_rows

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from matplotlib.axes import Axes

    from oppload_cli.results.result_files import BaseResult

FLOOR = 0.25  # OppLoD's threshold in every row of `frame_rows`


@pytest.fixture
def result(tmp_path: Path) -> BaseResult:
    """OppLoD peaks at 4 times its threshold, D-LGMD stays at 0.039 of its own."""
    return result_in(tmp_path)


def result_in(folder: Path, name: str = "clip", frames: int = 40, peak: int = 30) -> BaseResult:
    return read_result(write_result(folder / f"{name}.frames.csv", frames, peak))


def several(folder: Path, count: int) -> list[BaseResult]:
    return [result_in(folder, f"clip-{number}", peak=10 + number % 29) for number in range(count)]


def labels(axes: Axes) -> list[str]:
    return axes.get_legend_handles_labels()[1]


def curve(axes: Axes, number: int) -> np.ndarray:
    drawn = [line for line in axes.lines if len(np.atleast_1d(line.get_xdata())) > 5]
    return np.asarray(drawn[number].get_ydata(), float)


def test_responses_are_drawn_over_the_threshold_and_clipped_at_its_hundredth(
    result: BaseResult,
) -> None:
    _, (panel,) = plot_curves(result)
    assert labels(panel) == [
        "OppLoD, 4 times threshold at 1.5 s (frame 30)",
        "D-LGMD, 0.039 times threshold at 1.95 s (frame 39)",
        "shaded: alarm on",
    ]
    assert (panel.get_yscale(), panel.get_ylabel()) == ("log", "response / alarm threshold")
    assert panel.get_xlabel() == "time (s)"
    assert panel.get_ylim()[1] == pytest.approx(12)  # three times the peak
    # Frames 3 to 19 are below 0.01 of the threshold: not a spike, whatever the peak.
    assert set(curve(panel, 0)[3:19]) == {0.01}
    assert np.nanmax(curve(panel, 0)) == pytest.approx(4)
    assert np.nanmax(curve(panel, 1)) == pytest.approx(0.039)
    assert np.isnan(curve(panel, 0)[:3]).all()
    assert [tick.get_text() for tick in panel.get_yticklabels()] == ["≤0.01", "0.1", "1", "10"]
    thresholds = [line for line in panel.lines if np.asarray(line.get_ydata()).tolist() == [1, 1]]
    assert len(thresholds) == 1
    _, (without,) = plot_curves(result, threshold=False)
    assert len(without.lines) == len(panel.lines) - 1


def test_alarms_are_shaded_in_the_colour_of_their_detector(result: BaseResult) -> None:
    _, (panel,) = plot_curves(result)
    (shade,) = panel.patches
    on = np.flatnonzero(result.frames["opplod_alarm"] == 1) / 20
    box = shade.get_extents().transformed(panel.transData.inverted())
    assert (box.x0, box.x1) == pytest.approx((on[0], on[-1] + 0.05))
    assert matplotlib.colors.to_hex(shade.get_facecolor()) == CYCLE[0].lower()


def test_a_threshold_that_moves_and_uneven_times(tmp_path: Path) -> None:
    """The largest multiple of the threshold is not at the largest response."""
    rows = frame_rows()
    for at, row in enumerate(rows):
        row["time_s"] = f"{at / 20 + (at > 35):.9g}"  # a gap of a second
        row["opplod_response"] = {10: "0.4", 30: "0.8"}.get(at, "0.1") if at >= 3 else ""
        row["opplod_threshold"] = "0.2" if at < 20 else "0.5"
    path = write_rows(tmp_path / "a.frames.csv", rows)
    _, (panel,) = plot_curves(read_result(path), models=["opplod"])
    assert labels(panel)[0] == "OppLoD, 2 times threshold at 0.5 s (frame 10)"
    on = [int(row["frame"]) / 20 for row in rows if row["opplod_alarm"] == "1"]
    box = panel.patches[0].get_extents().transformed(panel.transData.inverted())
    assert (box.x0, box.x1) == pytest.approx((on[0], on[-1] + 0.05))
    _, (panel,) = plot_curves(read_result(path), models=["opplod"], scale="peak")
    assert labels(panel)[0] == "OppLoD, peak 0.8 at 1.5 s (frame 30)"
    assert curve(panel, 1)[3:] == pytest.approx([0.25] * 17 + [0.625] * 20)  # the dotted line
    for row in rows:
        row["opplod_threshold"] = str(10 * float(row["opplod_threshold"]))
    write_rows(path, rows)
    _, (panel,) = plot_curves(read_result(path), models=["opplod"], scale="peak")
    assert "threshold of OppLoD above the panel: 2.5 times the\npeak or more" in labels(panel)


def test_alarms_of_two_detectors_are_bars_whose_colours_do_not_mix(tmp_path: Path) -> None:
    rows = frame_rows()
    for row in rows[25:]:
        row["dlgmd_alarm"] = "1"
    both = read_result(write_rows(tmp_path / "both.frames.csv", rows))
    _, (panel,) = plot_curves(both)
    upper, lower = panel.patches
    colours = [matplotlib.colors.to_hex(bar.get_facecolor()) for bar in (upper, lower)]
    assert colours == [detector_named(name).colour.lower() for name in ("opplod", "dlgmd")]
    spans = [bar.get_extents().transformed(panel.transAxes.inverted()) for bar in (upper, lower)]
    assert 0.9 < spans[1].y0 < spans[1].y1 < spans[0].y0 < spans[0].y1 <= 1
    assert "bar at the top: alarm on" in labels(panel)


@pytest.mark.parametrize(
    ("peak_blind", "reason"),
    [
        ({"opplod": "start"}, "it came at the start"),
        ({"opplod": "start", "dlgmd": "start"}, "it came at the start"),
        ({"opplod": ""}, "it was too short"),
        (
            {"opplod": "start", "dlgmd": "cut"},
            "it came at the start, a cut, a flash, the end of a rest or after a gap, or was too "
            "short",
        ),
    ],
)
def test_a_peak_that_did_not_count_is_explained(
    peak_blind: dict[str, str], reason: str, tmp_path: Path
) -> None:
    names = ("opplod", "dlgmd")
    silent = {f"{name}_alarm": "0" for name in names}
    low = {f"{name}_threshold": "1e-6" for name in names}
    rows = [row | silent | low for row in frame_rows()]
    path = write_rows(tmp_path / "cut.frames.csv", rows)
    sidecar = {"alarms": {name: {"peak_blind": blind} for name, blind in peak_blind.items()}}
    path.with_name("cut.oppload.json").write_text(json.dumps(sidecar))
    _, (panel,) = plot_curves(read_result(path), models=list(peak_blind))
    note = labels(panel)[len(peak_blind)].replace("\n", " ")
    assert note == f"peak above the threshold, which did not count: {reason}"


def test_noise_is_no_peak(tmp_path: Path) -> None:
    rows = frame_rows()
    for row in rows[3:]:
        row["opplod_response"] = f"{1e-7 * (1 + int(row['frame']) % 5)}"
    noise = read_result(write_rows(tmp_path / "noise.frames.csv", rows))
    _, (panel,) = plot_curves(noise, models=["opplod"])
    assert labels(panel)[0] == "OppLoD, below 0.01 of the threshold"
    assert set(curve(panel, 0)[3:]) == {0.01}
    assert all(np.size(line.get_xdata()) != 1 for line in panel.lines)  # no ring of a peak


@pytest.mark.parametrize(("multiple", "said"), [(0.9997, "0.999"), (1.0003, "1")])
def test_a_peak_below_the_threshold_is_not_rounded_to_it(
    multiple: float, said: str, tmp_path: Path
) -> None:
    rows = frame_rows()
    for row in rows[3:]:
        row["opplod_response"] = str(FLOOR * multiple * float(row["opplod_response"]))
    path = write_rows(tmp_path / "near.frames.csv", rows)
    _, (panel,) = plot_curves(read_result(path), models=["opplod"])
    assert labels(panel)[0] == f"OppLoD, {said} times threshold at 1.5 s (frame 30)"


def test_models_share_a_panel_over_their_own_peaks(result: BaseResult) -> None:
    _, (panel,) = plot_curves(result, scale="peak")
    assert labels(panel) == [
        "OppLoD, peak 1 at 1.5 s (frame 30)",
        "D-LGMD, peak 0.039 at 1.95 s (frame 39)",
        "dotted: threshold of the alarm",
        "threshold of D-LGMD above the panel: 25.6 times\nthe peak or more",
        "shaded: alarm on",
    ]
    for number in (0, 2):
        assert np.nanmax(curve(panel, number)) == 1
    assert panel.get_ylabel() == "response / peak"


def test_raw_responses_get_a_panel_each_with_their_unit(result: BaseResult) -> None:
    _, (first, second) = plot_curves(result, scale="raw", threshold=False)
    assert first.get_ylabel() == "response (arbitrary unit)"
    assert second.get_ylabel() == "response (mean of G)"
    assert np.nanmax(curve(second, 0)) == pytest.approx(0.039)


@pytest.mark.long
def test_small_panels_of_several_units_have_them_in_their_titles(tmp_path: Path) -> None:
    figure, axes = plot_curves(several(tmp_path, 4), scale="raw", threshold=False)
    assert figure.get_supylabel() == "response"
    titles = [panel.get_title("left").replace("\n", " ") for panel in axes]
    assert titles[0].endswith(": OppLoD (arbitrary unit)")
    assert titles[1].endswith(": D-LGMD (mean of G)")
    figure, _ = plot_curves(several(tmp_path, 7), models=["opplod"], scale="raw", any_length=True)
    assert figure.get_supylabel() == "response (arbitrary unit)"


def test_one_model_over_several_inputs_shares_a_panel_in_number_order(tmp_path: Path) -> None:
    results = [result_in(tmp_path, f"l-over-v-{n}", peak=n) for n in (20, 30, 9)]
    _, (panel,) = plot_curves(results, models=["opplod"])
    assert [text.partition(",")[0] for text in labels(panel)[:3]] == ["l/v 9", "l/v 20", "l/v 30"]
    assert [line.get_color() for line in panel.lines[:5:2]] == list(CYCLE[:3])
    assert labels(panel)[3] == "bar at the top: alarm on"
    assert len(plot_curves(results)[1]) == 3
    named = labels(plot_curves(results, models=["opplod"], labels=["c", "b", "a"])[1][0])
    assert [text.partition(",")[0] for text in named[:3]] == ["c", "b", "a"]


def test_more_than_six_curves_are_small_multiples_on_one_scale(tmp_path: Path) -> None:
    figure, axes = plot_curves(several(tmp_path, 7), models=["opplod"])
    assert len(axes) == 7
    assert axes[0].get_title("left") == "clip-0"
    assert len({panel.get_ylim() for panel in axes}) == 1
    assert all(panel.get_legend() is None for panel in axes)
    assert [text.get_text() for text in figure.legends[0].get_texts()] == [
        "OppLoD", "shaded: alarm on",
    ]  # fmt: skip
    assert figure.get_figwidth() == pytest.approx(PAGE)


EIGHT = list(detectors())[:8]


def rows_of_eight() -> list[dict[str, str]]:
    """Rows in which eight detectors respond as OppLoD does."""
    rows = frame_rows()
    for row in rows:
        for name in EIGHT:
            row[f"{name}_response"], row[f"{name}_alarm"] = row["opplod_response"], "0"
            row[f"{name}_threshold"] = str(FLOOR)
    return rows


@pytest.mark.long
def test_many_detectors_of_one_input_have_a_panel_each(tmp_path: Path) -> None:
    result = read_result(write_rows(tmp_path / "clip.frames.csv", rows_of_eight()))
    figure, axes = plot_curves(result, models=EIGHT)
    labels_of_detectors = [detector_named(name).label for name in EIGHT]
    assert [panel.get_title("left") for panel in axes] == labels_of_detectors
    assert figure.legends[0].get_title().get_text() == "clip"
    assert all(np.nanmax(curve(panel, 0)) >= 0.01 for panel in axes)


def test_a_detector_without_a_threshold_has_a_panel_over_its_peak(tmp_path: Path) -> None:
    rows = rows_of_eight()
    for row in rows:
        del row[f"{EIGHT[-1]}_alarm"], row[f"{EIGHT[-1]}_threshold"]
    result = read_result(write_rows(tmp_path / "clip.frames.csv", rows))
    figure, axes = plot_curves(result, models=EIGHT)
    assert [panel.get_yscale() for panel in axes] == ["log"] * 7 + ["linear"]
    title = axes[-1].get_title("left").replace("\n", " ")
    assert title.endswith(", divided by its peak: no threshold")
    assert np.nanmax(curve(axes[-1], 0)) == 1
    assert figure.get_supylabel() == "response / alarm threshold"


@pytest.mark.long
def test_more_than_24_results_are_a_heat_map_of_bounded_size(tmp_path: Path) -> None:
    results = several(tmp_path, 70)
    figure, (opplod, dlgmd) = plot_curves(results, xlim=(0, 2))
    assert (opplod.get_title("left"), dlgmd.get_title("left")) == ("OppLoD", "D-LGMD")
    values = np.asarray(opplod.images[0].get_array(), float)
    assert values.shape == (70, 40)
    assert np.nanmax(values, axis=1) == pytest.approx([4] * 70)
    assert np.nanargmax(values, axis=1).tolist() == [10 + number % 29 for number in range(70)]
    assert isinstance(opplod.images[0].norm, matplotlib.colors.LogNorm)
    assert figure.get_figheight() <= MOST_HEIGHT
    names = [tick.get_text() for tick in opplod.get_yticklabels()]
    assert names[:2] == ["clip-0", "clip-2"]  # so many names would lie over each other
    # The alarm of each is in its own row; the first row is the uppermost.
    heights = np.array([line.get_ydata() for line in opplod.lines], float)
    np.testing.assert_allclose(heights.T, [0.36 + np.arange(70)] * 2)
    image = opplod.images[0]
    assert tuple(image.get_extent()) == (0, 2, 69.5, -0.5)
    assert (image.norm.vmin, image.norm.vmax) == (0.01, 100)


@pytest.mark.long
def test_each_row_of_a_heat_map_has_its_own_marks(tmp_path: Path) -> None:
    results = several(tmp_path, 25)
    onsets = [0.1 + 0.02 * number for number in range(25)]
    contacts = [None, *(1.5 + 0.01 * number for number in range(1, 25))]
    marks: dict[str, Sequence[float | None]] = {"onset": onsets, "contact": contacts}
    figure, (panel,) = plot_curves(results, models=["opplod"], marks=marks)
    expected = [
        [[time, row - 0.5], [time, row + 0.5]]
        for row, times in enumerate(zip(onsets, contacts, strict=True))
        for time in times
        if time is not None
    ]
    np.testing.assert_allclose(white_lines(panel), expected)
    assert figure.axes[-1].get_xlabel().endswith("alarm on\nwhite: onset and contact")
    marks["contact"] = [1.5] * 25
    _, (panel,) = plot_curves(results, models=["opplod"], marks=marks, align="contact")
    np.testing.assert_allclose(white_lines(panel)[0], [[-1.4, -0.5], [-1.4, 0.5]])


def white_lines(axes: Axes) -> list[np.ndarray]:
    return [np.asarray(line.get_xydata()) for line in axes.lines if line.get_color() == "white"]


def test_a_bin_of_time_shows_its_largest_value() -> None:
    time, value = np.array([0.0, 0.2, 0.5, 0.9, 1.0]), np.array([3.0, 1.0, 2.0, np.nan, 5.0])
    assert _binned(time, value, 0.0, 1.0, 2).tolist() == [3, 5]  # the end is in the last bin
    assert _binned(time, value, 0.0, 1.0, 5).tolist() == [3, 1, 2, 2, 5]
    assert _binned(time, value, 0.4, 0.6, 1).tolist() == [2]
    # Also where the axis begins and ends between frames.
    assert _binned(time, value, 0.3, 0.6, 3).tolist() == [1, 1, 2]
    assert _binned(time, value, 0.6, 0.8, 2).tolist() == [2, 2]


@pytest.mark.parametrize("count", [1, 4, 25])  # a panel, small panels and a heat map
def test_dollar_signs_in_the_words_of_a_detector_are_no_formula(
    tmp_path: Path, count: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    for words in ("label", "unit"):
        monkeypatch.setattr(detector_named("dlgmd"), words, r"$\frac{1}$")
    figure, _ = plot_curves(several(tmp_path, count), models=["dlgmd"], scale="raw")
    figure.draw_without_rendering()  # which would refuse the formula
    texts = [text.get_text() for text in figure.findobj(Text)]
    named = [text for text in texts if "frac" in text]
    assert named
    assert all(text.count(r"\$") == text.count("$") == 2 for text in named)


@pytest.mark.long
@pytest.mark.parametrize("scale", ["threshold", "raw"])
def test_heat_maps_of_many_detectors_lie_apart_with_their_words(tmp_path: Path, scale: str) -> None:
    rows = rows_of_eight()
    for at, row in enumerate(rows[3:]):
        row |= {f"{name}_response": f"{0.0031 * 1.1**at:.9g}" for name in EIGHT}  # to 0.096
    result = read_result(write_rows(tmp_path / "clip.frames.csv", rows))
    results = [replace(result, path=tmp_path / f"clip-{number}.frames.csv") for number in range(25)]
    figure, axes = plot_curves(results, models=EIGHT[:6], scale=scale)
    figure.draw_without_rendering()
    bars = figure.axes[len(axes) :]
    assert len(bars) == (1 if scale == "threshold" else 6)  # one unit, or that of each detector
    texts = [panel.title for panel in axes] + [bar.xaxis.label for bar in bars]
    boxes = [panel.get_window_extent() for panel in axes]
    boxes += [text.get_window_extent() for text in texts if text.get_text()]
    assert not [1 for one, other in combinations(boxes, 2) if one.overlaps(other)]
    assert min(panel.get_position().width for panel in axes) > 0.1
    for axis in [bar.xaxis for bar in bars] * (scale == "raw"):  # the numbers do not overlap
        shown = [tick.label1 for tick in [*axis.get_major_ticks(), *axis.get_minor_ticks()]]
        assert [label.get_text() for label in shown if label.get_text()] == ["0.01", "0.03"]


def test_lengths_must_agree_in_a_panel_unless_told(tmp_path: Path) -> None:
    results = [result_in(tmp_path, str(frames), frames) for frames in (40, 35)]
    with pytest.raises(ResultError, match=r"40\.frames\.csv: column 'frame' has 40 rows"):
        plot_curves(results, models=["opplod"])
    assert len(plot_curves(results, models=["opplod"], any_length=True)[1]) == 1
    assert len(plot_curves(results)[1]) == 2


def test_marks_are_drawn(result: BaseResult) -> None:
    _, (panel,) = plot_curves(result, marks={"onset": [0.5], "contact": [7.0]})
    verticals = [
        line for line in panel.lines if np.asarray(line.get_xdata()).tolist() == [0.5, 0.5]
    ]
    assert len(verticals) == 1
    assert {text.get_text() for text in panel.texts} == {"onset", "contact at 7 s"}


def test_numbers_of_four_digits_have_no_exponent(tmp_path: Path) -> None:
    rows = [row | {"time_s": f"{float(row['time_s']) + 1234:.9g}"} for row in frame_rows()]
    late = read_result(write_rows(tmp_path / "late.frames.csv", rows))
    _, (panel,) = plot_curves(late, models=["opplod"], scale="peak", marks={"contact": [2345.6]})
    assert labels(panel)[0] == "OppLoD, peak 1 at 1,236 s (frame 30)"
    assert [text.get_text() for text in panel.texts] == ["contact at 2,346 s"]
    with pytest.raises(ParameterError, match="the frames are between 1,234 and 1,236 s"):
        plot_curves(late, xlim=(0, 1))


def test_time_counts_from_contact(tmp_path: Path) -> None:
    results = [result_in(tmp_path, f"c-{n}", peak=n) for n in (20, 30)]
    _, (panel,) = plot_curves(
        results, models=["opplod"], align="contact", marks={"contact": [1.1, 1.6]}, xlim=(-1, 0.2)
    )
    assert (panel.get_xlabel(), panel.get_xlim()) == ("time from contact (s)", (-1, 0.2))
    assert not panel.texts  # the axis says where the contact is
    assert labels(panel)[:2] == [f"c-{n}, 4 times threshold at -0.10 s" for n in (20, 30)]
    with pytest.raises(ResultError, match=r"c-20\.frames\.csv: its time of contact is not known"):
        plot_curves(results, align="contact")


@pytest.mark.parametrize(("inches", "several"), [(3, False), (9, True)])
def test_the_legend_in_narrow_axes_of_ones_own_has_only_names(
    result: BaseResult, inches: float, several: bool
) -> None:
    _, (panel,) = plot_curves(result, axes=Figure((inches, 3)).subplots())
    legend = panel.get_legend()
    assert legend is not None
    texts = [text.get_text() for text in legend.get_texts()]
    assert (texts[0] == "OppLoD") is not several
    assert (len(texts) > 2) is several


def test_own_axes_and_title(result: BaseResult) -> None:
    own = Figure().subplots()
    figure, (panel,) = plot_curves(result, axes=own, xlim=(0.5, 1.9))
    assert (figure, panel) == (own.figure, own)
    assert panel.get_xlim() == (0.5, 1.9)
    with pytest.raises(ParameterError, match="have 2 panels"):
        plot_curves(result, scale="raw", axes=own)
    _, (panel,) = plot_curves(result, title="A title")
    assert panel.get_title("left") == "A title"


@pytest.mark.parametrize(
    ("xlim", "said"),
    [
        ((6, 5), "from 6 to 5 s has no length"),
        ((0, math.nan), "from 0 to nan s has no length"),
        ((0, math.inf), "from 0 to inf s has no length"),
        ((20, 30), "between 20 and 30 s; the frames are between 0 and 1.95 s"),
    ],
)
def test_an_axis_without_a_frame_is_an_error(
    result: BaseResult, xlim: tuple[float, float], said: str
) -> None:
    for plot in (plot_curves, plot_rmo):
        with pytest.raises(ParameterError, match=said):
            plot(result, xlim=xlim)


def test_each_result_has_its_marks(result: BaseResult) -> None:
    with pytest.raises(ParameterError, match=r"'onset' has 2 times; give a list .* \(1\)"):
        plot_curves(result, marks={"contact": [1.0], "onset": [0.5, 1.0]})
    with pytest.raises(ParameterError, match="'contact' has 0 times; give a list of one, or None"):
        plot_curves(result, marks={"contact": 1.0})  # type: ignore[dict-item]


@pytest.mark.parametrize("options", [{"scale": "log"}, {"align": "onset"}])
def test_a_wrong_option_is_named(result: BaseResult, options: dict[str, str]) -> None:
    with pytest.raises(ParameterError, match=next(iter(options.values()))):
        plot_curves(result, **options)  # type: ignore[arg-type]


def test_a_texture_that_fills_the_field_has_no_strip_of_its_size(result: BaseResult) -> None:
    truth = ground_truth(load("controls/texture-pan/direction-0"))
    result.path.with_name("clip.stimulus.json").write_text(json.dumps(truth))
    assert len(plot_curves(result)[1]) == 1


def test_ground_truth_is_a_strip_with_its_contact(result: BaseResult) -> None:
    truth = ground_truth(load("klapoetke2017/loom-l-over-v/l-over-v-40"))
    beside = result.path.with_name("clip.stimulus.json")
    beside.write_text(json.dumps(truth))
    figure, (panel, strip) = plot_curves(result)
    assert strip.get_ylabel() == "size (deg)"
    assert np.asarray(strip.lines[0].get_ydata(), float).max() == pytest.approx(60)
    assert {text.get_text() for text in panel.texts} == {"contact"}
    assert figure.get_figwidth() == pytest.approx(COLUMN)
    looming = [frame["time_s"] for frame in truth["frames"] if frame["looming"]]
    grey = strip.collections[0].get_paths()[0].get_extents()
    assert (grey.x0, grey.x1) == pytest.approx((looming[0], looming[-1]), abs=0.02)
    _, (_, strip) = plot_curves(result, align="contact")
    assert np.asarray(strip.lines[0].get_xdata(), float)[0] == pytest.approx(-2.2)


def upright_lines(axes: Axes) -> list[float]:
    marks = [np.asarray(line.get_xdata(), float) for line in axes.lines]
    return sorted(float(x[0]) for x in marks if len(x) == 2 and x[0] == x[1])


def test_each_object_and_each_contact_is_told(result: BaseResult) -> None:
    truth = ground_truth(load("controls/two-looming-disks"))
    result.path.with_name("clip.stimulus.json").write_text(json.dumps(truth))
    _, (aligned, _) = plot_curves(result, align="contact")
    assert upright_lines(aligned) == pytest.approx([0, 0.6])
    _, (panel, strip) = plot_curves(result, xlim=(0, 2.4))
    sizes = [line for line in strip.lines if len(np.asarray(line.get_xdata())) > 2]
    assert [line.get_label() for line in sizes] == ["first", "second"]
    assert sizes[0].get_linestyle() != sizes[1].get_linestyle()
    for axes in (panel, strip):
        assert upright_lines(axes) == pytest.approx([1.6, 2.2])
    assert [text.get_text() for text in panel.texts] == ["contacts"]


@pytest.mark.parametrize(
    "contact",
    [
        *(0.9, 1.8, 1.95),
        *(
            pytest.param(seconds, marks=pytest.mark.slow)
            for seconds in (1.45, 1.7, 1.85, 1.9, 1.92)
        ),
    ],
)
def test_the_label_of_a_mark_lies_on_no_curve(contact: float, tmp_path: Path) -> None:
    rows = frame_rows()
    for row in rows[3:]:  # rising to a peak at 1.8 s, with bars of alarms above it
        at = int(row["frame"])
        for name in ("opplod", "dlgmd"):
            row[f"{name}_response"] = f"{10 ** ((at - 36) / 6) if at <= 36 else 0:.9g}"
            row[f"{name}_alarm"] = str(int(at > 25))
    result = read_result(write_rows(tmp_path / "clip.frames.csv", rows))
    for scale in ("threshold", "peak"):
        figure, (panel,) = plot_curves(result, scale=scale, marks={"contact": [contact]})
        figure.draw_without_rendering()
        (text,) = panel.texts
        box = text.get_window_extent()
        for line in panel.lines:
            points = panel.transData.transform(np.asarray(line.get_xydata(), float))
            if len(points) > 2:
                x = np.linspace(box.x0, box.x1, 200)
                y = np.interp(x, points[:, 0], points[:, 1])
                assert not np.any((y > box.y0) & (y < box.y1)), (scale, line.get_label())


@pytest.mark.long
@pytest.mark.parametrize("suffix", sorted(METADATA))
def test_the_same_input_gives_the_same_bytes(
    suffix: str, result: BaseResult, tmp_path: Path
) -> None:
    made = []
    for name in ("one", "two"):
        path = tmp_path / f"{name}{suffix}"
        save(plot_curves(result, models=["opplod"], marks={"onset": [1.0]})[0], path)
        made.append(path.read_bytes())
    assert made[0] == made[1]
    assert len(made[0]) > 5000


@pytest.mark.long
def test_panels_do_not_move_by_an_error_of_rounding(tmp_path: Path) -> None:
    """The solver of the layout errs by 1e-16 or so, and not always alike."""
    results = [read_result(write_result(tmp_path / f"{name}.frames.csv")) for name in "ab"]
    figure, panels = plot_curves(results, scale="raw", labels=["first", "second"])
    figure.draw_without_rendering()
    for panel in panels:
        x, y, *size = panel.get_position().bounds
        assert (x, y) == (round(x, 9), round(y, 9))
        assert size == pytest.approx([round(side, 9) for side in size], abs=1e-15)


@pytest.mark.parametrize(("scale", "level"), [("threshold", 0.01), ("peak", 0)])
def test_no_response_is_a_flat_line(tmp_path: Path, scale: str, level: float) -> None:
    rows = frame_rows()
    for row in rows[3:]:
        row["opplod_response"] = row["dlgmd_response"] = "0"
    flat = read_result(write_rows(tmp_path / "flat.frames.csv", rows))
    _, (panel,) = plot_curves(flat, scale=scale)
    assert labels(panel)[:2] == ["OppLoD, no response", "D-LGMD, no response"]
    assert set(curve(panel, 0)[3:]) == {level}


def test_without_an_alarm_there_is_no_threshold(tmp_path: Path) -> None:
    judged = ("_threshold", "_alarm")
    rows = [{k: v for k, v in row.items() if not k.endswith(judged)} for row in frame_rows()]
    _, (panel,) = plot_curves(read_result(write_rows(tmp_path / "a.frames.csv", rows)))
    assert panel.get_ylabel() == "response / peak"
    assert labels(panel)[-1] == "divided by the peak: no alarm threshold"
    rows = [{k: v for k, v in row.items() if k != "dlgmd_threshold"} for row in frame_rows()]
    _, (panel,) = plot_curves(read_result(write_rows(tmp_path / "b.frames.csv", rows)))
    said = labels(panel)[-1].replace("\n", " ")
    assert said == "divided by the peak: no alarm threshold of D-LGMD"


def test_the_threshold_is_that_of_the_table(tmp_path: Path) -> None:
    for floor in (0.25, 0.5):
        rows = [row | {"opplod_threshold": str(floor)} for row in frame_rows()]
        path = write_rows(tmp_path / "clip.frames.csv", rows)
        _, (panel,) = plot_curves(read_result(path), models=["opplod"])
        assert np.nanmax(curve(panel, 0)) == pytest.approx(1 / floor)


@pytest.mark.long
def test_panels_have_one_time_axis(tmp_path: Path) -> None:
    """Warm-ups differ, so that the curves of a result begin at different times."""
    rows = frame_rows()
    for late, name in enumerate(EIGHT):
        for at, row in enumerate(rows):
            row[f"{name}_response"] = "" if at < 3 * late else "0.5"
    result = read_result(write_rows(tmp_path / "a.frames.csv", rows))
    _, many = plot_curves(result)
    assert len(many) == 8
    _, two = plot_curves(result, models=["opplod", "dlgmd"], scale="raw")
    assert len(two) == 2
    for axes in (many, two):
        assert len({panel.get_xlim() for panel in axes}) == 1
        assert axes[0].get_xlim()[0] <= 0


def test_inputs_of_very_different_lengths_have_a_time_axis_each(tmp_path: Path) -> None:
    for frames, count in ((80, 1), (400, 2)):
        pair = [result_in(tmp_path, "a", 40), result_in(tmp_path, f"b-{frames}", frames)]
        _, axes = plot_curves(pair)
        assert len({panel.get_xlim() for panel in axes}) == count


def test_the_legend_says_where_a_dotted_line_is_above_the_panel(tmp_path: Path) -> None:
    rows = frame_rows()
    for at, row in enumerate(rows):
        row["opplod_response"] = "0.1" if at < 20 else "0.9"
        # The threshold rises to 3 times the earlier responses, above the panel.
        row["opplod_threshold"] = "0.3" if at < 32 else "2.7"
    path = write_rows(tmp_path / "a.frames.csv", rows)
    _, (panel,) = plot_curves(read_result(path), models=["opplod"], scale="raw")
    assert "dotted: threshold of the alarm" in labels(panel)
    assert "no dotted line: threshold above the panel" in labels(panel)
    for row in rows:
        row["opplod_response"] = "0"
    write_rows(path, rows)
    _, (panel,) = plot_curves(read_result(path), models=["opplod"], scale="raw")
    assert "threshold of OppLoD above the panel: no response" in labels(panel)


def test_a_threshold_below_the_largest_curve_of_the_panel_is_drawn(tmp_path: Path) -> None:
    results = []
    for name, share in (("strong", 1.0), ("weak", 1e-3), ("silent", 0.0)):
        rows = frame_rows()
        for row in rows[3:]:
            row["opplod_response"] = f"{float(row['opplod_response']) * share:.9g}"
        results.append(read_result(write_rows(tmp_path / f"{name}.frames.csv", rows)))
    _, (panel,) = plot_curves(results, scale="raw", models=["opplod"])
    dotted = [line for line in panel.lines if line.get_drawstyle() == "steps-mid"]
    assert [np.nanmin(line.get_ydata()) for line in dotted] == pytest.approx([FLOOR] * 3)
    assert not [label for label in labels(panel) if "above the panel" in label]
    _, (panel,) = plot_curves(results[1:], scale="raw", models=["opplod"])
    over = f"{FLOOR / 1e-3:.4g}"
    notes = [label.replace("\n", " ") for label in labels(panel) if "above" in label]
    assert notes == [
        f"threshold of weak above the panel: {over} times the peak or more",
        "threshold of silent above the panel: no response",
    ]


@pytest.mark.long
def test_the_notes_of_small_multiples_are_inside_the_figure(tmp_path: Path) -> None:
    rows = frame_rows()
    for row in rows:
        for number, name in enumerate(EIGHT):
            row[f"{name}_response"], row[f"{name}_alarm"] = f"{1e6 * (number > 3)}", "0"
            row[f"{name}_threshold"] = str(FLOOR)
    rows[20]["opplod_alarm"] = "1"
    result = read_result(write_rows(tmp_path / "a.frames.csv", rows))
    figure, panels = plot_curves(result, scale="raw")
    figure.draw_without_rendering()
    # Not "1", with a factor of a million where the title of the panel is.
    assert "1e+06" in [label.get_text() for label in panels[4].get_yticklabels()]
    (legend,) = figure.legends
    assert {"dotted: threshold of the alarm", "shaded: alarm on"} <= {
        text.get_text() for text in legend.get_texts()
    }
    assert len(legend.get_texts()) == 4
    assert legend.get_window_extent().x1 <= figure.bbox.x1


def test_a_figure_can_be_pickled(tmp_path: Path) -> None:
    """Another process may draw it and hand it over."""
    result = read_result(write_rows(tmp_path / "one.frames.csv", frame_rows()))
    figure, (panel,) = plot_curves(result)
    assert pickle.dumps(figure)
    assert panel.yaxis.get_major_formatter()(0.01, None) == "≤0.01"


@pytest.mark.long
@pytest.mark.parametrize(("contact", "count"), [(1000.0, 1), (50000.0, 7)])
def test_times_far_from_zero_do_not_overlap(tmp_path: Path, contact: float, count: int) -> None:
    results = [read_result(write_result(tmp_path / f"{n}.frames.csv")) for n in range(count)]
    figure, axes = plot_curves(
        results,
        marks={"contact": [contact] * count},
        align="contact",
        xlim=(-contact, 1.68 - contact),
    )
    figure.set_dpi(300)  # of the file, so that all lengths are in its pixels
    save(figure, tmp_path / "figure.png")
    axis = axes[-1].xaxis
    first, last = axes[-1].get_xlim()
    labels = [tick.label1 for tick in axis.get_major_ticks() if first <= tick.get_loc() <= last]
    assert len(labels) >= 2
    boxes = [label.get_window_extent() for label in labels]
    assert all(left.x1 < right.x0 for left, right in pairwise(boxes))
    assert axis.get_offset_text().get_text() == ""
    assert float(labels[0].get_text().replace("\N{MINUS SIGN}", "-")) < 3 - contact
