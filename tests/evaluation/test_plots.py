from __future__ import annotations

import itertools
from typing import TYPE_CHECKING

import numpy as np
import pytest
from matplotlib.collections import LineCollection
from matplotlib.container import BarContainer

from oppload_cli.evaluation.metrics.intervals import draws_of
from oppload_cli.evaluation.metrics.measures import measured
from oppload_cli.evaluation.plots import PLOTS, figure_of
from oppload_cli.models.registry import detectors
from tests.evaluation.make import NAME, clip, peaks

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from oppload_cli.evaluation.metrics.clips import Clip

CLIPS = [
    clip(peaks(100, {85: 1.0, 90: 2.0}), 80, 90),
    clip(peaks(100, {84: 4.0}), 80, 90),
    clip(peaks(603, {100: 3.0, 200: 1.5}), motion="still"),
    clip(peaks(603, {100: 0.5}), motion="walking"),
]
NO_CURVE = "no approach, or no footage without one"
MEASURED = {NAME: measured(CLIPS, NAME, draws_of([True, True, False, False], 100))}


def line_of(axes: Axes, number: int) -> tuple[list[float], list[float]]:
    """The x and the y of the points of a line."""
    line = axes.get_lines()[number]
    x, y = (np.asarray(values, float) for values in (line.get_xdata(), line.get_ydata()))
    return x.tolist(), y.tolist()


def test_detection_over_false_alarms() -> None:
    rates, detected = line_of(figure_of("detection.png", MEASURED).axes[0], -1)
    minutes = 2 + 2 * 7.7 / 60
    # Above 3: none false, one approach of two; above 1.5: one false; then both.
    assert rates[:3] == pytest.approx(np.array([0, 1, 2]) / minutes)
    assert detected[:3] == [0.5, 1, 1]


def test_detectors_differ_also_where_they_coincide_and_without_colours() -> None:
    both = {"opplod_reference": MEASURED[NAME], "dlgmd": MEASURED[NAME]}
    first, second = figure_of("roc.png", both).axes[0].get_lines()[1:]
    assert first.get_linewidth() > second.get_linewidth() >= 1
    assert first.get_linestyle() != second.get_linestyle()
    for name in ("within-clip.png", "false-alarms.png"):
        bars = figure_of(name, both).axes[0].containers
        hatches = {bar.patches[0].get_hatch() for bar in bars if isinstance(bar, BarContainer)}
        assert len(hatches) == 2, name


def test_leads_and_kinds_are_those_of_the_figures() -> None:
    (axes,) = figure_of("lead-time.png", MEASURED).axes
    # At one false alarm per minute two of them: the threshold is 0.5.
    assert np.asarray(axes.get_lines()[0].get_xdata()).tolist() == pytest.approx([0.5, 0.6])
    assert not axes.get_lines()[0].get_clip_on()  # the largest lead is at the end of the axis
    assert [label.get_text() for label in axes.get_yticklabels()] == ["OppLoD\n2 of 2"]
    (axes,) = figure_of("false-alarms.png", MEASURED).axes
    kinds = [label.get_text() for label in axes.get_yticklabels()]
    assert kinds == ["before an approach\n2 clips", "still\n1 clip", "walking\n1 clip"]
    assert [bar.get_width() for bar in axes.patches] == pytest.approx([0, 2, 0])  # type: ignore[attr-defined]


def test_every_plot_has_the_numbers_of_its_definition() -> None:
    clips = [
        clip(peaks(100, {80: 2.5, 85: 5.0}), 80, 90),
        clip(peaks(100, {85: 4.0}), 80, 90),
        clip(peaks(100, {87: 3.5}), 80, 90),
        clip(peaks(100, {90: 1.0}), 80, 90),
        # Two false alarms above 1 or 2, one above 0.
        clip(peaks(603, dict.fromkeys(range(100, 130), 1.0) | {100: 3.0, 130: 3.0})),
        clip(peaks(603, {100: 2.0})),
    ]
    found = measured(clips, NAME, draws_of([clip.label.looming for clip in clips], 100))
    panels = {plot: figure_of(plot, {NAME: found, "dlgmd": found}).axes[0] for plot in PLOTS}
    minutes = 2 + 4 * 7.7 / 60
    rates, detected = line_of(panels["detection.png"], -1)
    assert rates == pytest.approx([0, 2 / minutes, 3 / minutes, 12])  # the axis ends at 6
    assert detected == pytest.approx([0.75, 0.75, 1, 1])  # above 3, above 2, above 0
    # Of the negative windows two have the score 3, one has 2, two have 1.
    recall, precision = line_of(panels["precision-recall.png"], -1)
    assert recall == pytest.approx([0, 0.25, 0.5, 0.75, 1])
    assert precision == pytest.approx([1, 1, 1, 1, 4 / 9])
    assert line_of(panels["lead-time.png"], 0)[0] == pytest.approx([0.3, 0.5, 1.0])
    assert line_of(panels["lead-time.png"], 1)[0] == pytest.approx([0.5, 0.5])  # the median
    labels = [label.get_text() for label in panels["lead-time.png"].get_yticklabels()]
    assert labels == ["OppLoD\n3 of 4", "D-LGMD\n3 of 4"]
    pairs = [
        measurement for measurement in found.measurements if measurement.measure == "ordered_pairs"
    ]
    spread, *_ = panels["within-clip.png"].collections
    assert isinstance(spread, LineCollection)
    ends = [segment[:, 1].tolist() for segment in spread.get_segments()]
    assert ends == [pytest.approx([pair.low, pair.high]) for pair in pairs]
    lower = [bar.get_y() for bar in panels["false-alarms.png"].patches]  # type: ignore[attr-defined]
    assert len(set(lower)) == len(lower) == 2 * 2  # no bar covers another one


def test_dollar_signs_in_a_kind_of_motion_are_no_formula() -> None:
    clips = [clip(peaks(100, {50: 1.0}), motion=r"$\frac{1}$")]
    found = measured(clips, NAME, draws_of([False], 100))
    figure = figure_of("false-alarms.png", {NAME: found})
    figure.draw_without_rendering()  # which would refuse the formula
    assert figure.axes[0].get_yticklabels()[0].get_text() == "\\$\\frac{1}\\$\n1 clip"


def test_many_equal_leads_stay_in_the_row_of_their_detector() -> None:
    clips = [*[clip(peaks(100, {85: 1.0}), 80, 90)] * 20, clip(peaks(603, {100: 0.5}))]
    found = measured(clips, NAME, draws_of([clip.label.looming for clip in clips], 100))
    (axes,) = figure_of("lead-time.png", {NAME: found}).axes
    rows = np.sort(np.asarray(axes.get_lines()[0].get_ydata()))
    assert len(np.unique(rows)) == 20
    assert np.abs(rows).max() == pytest.approx(0.42)


@pytest.mark.long
@pytest.mark.parametrize(
    ("clips", "words"),
    [
        (
            [clip([0.0] * 100)],
            [*[NO_CURVE] * 3, "no pair of windows", "no approach detected", "no false alarm"],
        ),
        ([clip([0.0] * 100, 0, 90)], [*[NO_CURVE] * 3, "no approach detected", "no false alarm"]),
    ],
)
def test_plots_without_approaches_or_false_alarms_say_so(
    clips: list[Clip], words: list[str]
) -> None:
    found = measured(clips, NAME, draws_of([clip.label.looming for clip in clips], 100))
    said = []
    for plot in PLOTS:
        figure = figure_of(plot, {NAME: found})
        figure.draw_without_rendering()
        said += [text.get_text() for axes in figure.axes for text in axes.texts]
    assert said == words


@pytest.mark.long
@pytest.mark.parametrize("plot", PLOTS)
def test_many_detectors_and_a_long_name_fit_into_a_plot(
    plot: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    names = list(detectors())[:23]
    long_label = "a detector with a name of many words that would push the others out"
    monkeypatch.setattr(detectors()[names[-1]], "label", long_label)
    figure = figure_of(plot, dict.fromkeys(names, MEASURED[NAME]))
    figure.draw_without_rendering()
    (axes,) = figure.axes
    legend, edge = axes.get_legend(), figure.bbox
    if legend is not None:
        box = legend.get_window_extent()
        assert edge.x0 <= box.x0
        assert box.x1 <= edge.x1
    labels = [label.get_window_extent() for label in axes.get_yticklabels()][: len(names) - 1]
    assert not any(first.overlaps(second) for first, second in itertools.pairwise(labels))
