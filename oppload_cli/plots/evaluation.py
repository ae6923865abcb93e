"""Figures of an evaluation on labelled clips."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import matplotlib as mpl
import numpy as np

from oppload_cli.detection.evaluation.alarms import condition_of
from oppload_cli.detection.evaluation.thresholds import RATES
from oppload_cli.detection.evaluation.windows import AHEAD
from oppload_cli.plots.style import CYCLE, DASHES, FAINT, INK, STYLE, new_figure

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from oppload_cli.detection.evaluation.measures import Measured

SIZE = 4.8, 3.2  # inches
COLOURS = {
    "opplod:default": CYCLE[0],
    "opplod:robust": CYCLE[2],
    "opplod:paper": CYCLE[3],
    "dlgmd": CYCLE[1],
    "flow_divergence": CYCLE[4],
    "mean_p": CYCLE[5],
}
MOST_RATE = 6.0
RATE = 1.0


@dataclass(frozen=True)
class Drawn:
    """One contender as the figures show it.

    Attributes
    ----------
    name, title : str
        Its name, and what the reader sees.
    measured : Measured
        What was measured of it.
    """

    name: str
    title: str
    measured: Measured


def plot_roc(contenders: Sequence[Drawn]) -> Figure:
    """Draw the ROC curves over one-second windows.

    Parameters
    ----------
    contenders : sequence of Drawn
        In the order of the legend.

    Returns
    -------
    matplotlib.figure.Figure
    """
    figure, axes = _rates("false positive rate", "true positive rate", "ROC")
    axes.plot([0, 1], [0, 1], color=FAINT, lw=0.7, linestyle=":")
    for each, look in _looks(contenders):
        curve = each.measured.curve
        if curve is not None:
            title = f"{each.title} ({curve.auc:.2f})"
            axes.plot(curve.false_rate, curve.true_rate, label=title, **look)
    _legend(axes, "lower right")
    return figure


def plot_precision_recall(contenders: Sequence[Drawn]) -> Figure:
    """Draw precision over recall of one-second windows.

    Parameters
    ----------
    contenders : sequence of Drawn
        In the order of the legend.

    Returns
    -------
    matplotlib.figure.Figure
    """
    figure, axes = _rates("recall", "precision", "precision and recall")
    for each, look in _looks(contenders):
        curve = each.measured.curve
        if curve is not None:
            title = f"{each.title} ({curve.average_precision:.2f})"
            rises = np.append(True, np.diff(curve.true_rate) > 0)
            recall, precision = curve.true_rate[rises], curve.precision[rises]
            axes.step(recall, precision, where="pre", label=title, **look)
    _legend(axes, "lower left")
    return figure


def plot_detection(contenders: Sequence[Drawn]) -> Figure:
    """Draw the detection rate over the false alarms per minute of every threshold.

    Parameters
    ----------
    contenders : sequence of Drawn
        In the order of the legend.

    Returns
    -------
    matplotlib.figure.Figure
    """
    with mpl.rc_context(STYLE):
        figure = new_figure(*SIZE)
        axes = figure.subplots()
        for rate in RATES:
            axes.axvline(rate, color=FAINT, lw=0.7, linestyle=":")
        for each, look in _looks(contenders):
            rates, detected = detection_curve(each.measured)
            axes.step(rates, detected, where="post", label=each.title, **look)
        axes.set(xlim=(0, MOST_RATE), ylim=(0, 1.02), title="detection by one fixed threshold")
        axes.set_xlabel("false alarms per minute of footage without an approach")
        axes.set_ylabel("share of approaches detected")
        _legend(axes, "lower right")
    return figure


def detection_curve(measured: Measured) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the detection rate for each number of false alarms per minute.

    Parameters
    ----------
    measured : Measured
        Of one contender.

    Returns
    -------
    rates, detected : ndarray, shape (m,)
        Both rise; empty without an approach or without other footage.
    """
    alarms = measured.false_alarms
    rates = np.maximum.accumulate(alarms.rates(np.ones(len(alarms.minutes), np.int64)))
    peaks = measured.approaches.peaks
    peaks = peaks[~np.isnan(peaks)]
    if not len(peaks) or not len(rates) or np.isnan(rates).any():
        return np.empty(0), np.empty(0)
    detected = (peaks[:, None] > alarms.thresholds).mean(axis=0)
    # Of the thresholds with as many false alarms the lowest counts.
    last = np.append(np.diff(rates) > 0, True)
    return np.append(rates[last], rates[-1] + MOST_RATE), np.append(detected[last], detected[-1])


def plot_order(contenders: Sequence[Drawn]) -> Figure:
    """Draw the share of ordered pairs within clips, by frames before contact.

    Parameters
    ----------
    contenders : sequence of Drawn
        In the order of the legend.

    Returns
    -------
    matplotlib.figure.Figure
    """
    with mpl.rc_context(STYLE):
        figure = new_figure(*SIZE)
        axes = figure.subplots()
        for index, (each, look) in enumerate(_looks(contenders)):
            found = {f.condition: f for f in each.measured.figures if f.measure == "ordered_pairs"}
            rows = [found[f"{frames} frames before contact"] for frames in AHEAD]
            x, width = _beside(len(rows), index, len(contenders))
            values = np.array([row.value for row in rows])
            spread = np.array([[row.value - row.low, row.high - row.value] for row in rows]).T
            axes.bar(x, values, width * 0.9, color=look["color"], label=each.title)
            axes.errorbar(
                x,
                values,
                np.maximum(spread, 0),
                fmt="none",
                ecolor=INK,
                elinewidth=0.7,
                capsize=1.5,
            )
        axes.axhline(0.5, color=FAINT, lw=0.7, linestyle=":")
        axes.set_xticks(range(len(AHEAD)), [str(frames) for frames in AHEAD])
        axes.set(ylim=(0, 1.3), title="within clips: correctly ordered pairs of windows")
        axes.set_yticks(np.arange(0, 1.01, 0.2))
        axes.set_xlabel("frames from the window's end to contact")
        axes.set_ylabel("share of pairs")
        axes.legend(loc="upper center", ncols=3)
    return figure


def plot_false_alarms(contenders: Sequence[Drawn]) -> Figure:
    """Draw the false alarms per minute by kind of motion, at one per minute in all.

    Parameters
    ----------
    contenders : sequence of Drawn
        In the order of the legend.

    Returns
    -------
    matplotlib.figure.Figure
    """
    prefix = f"{condition_of(RATE)}, "
    with mpl.rc_context(STYLE):
        figure = new_figure(*SIZE)
        axes = figure.subplots()
        kinds: dict[str, float] = {}
        for index, (each, look) in enumerate(_looks(contenders)):
            kinds = {
                f.condition.removeprefix(prefix): f.value
                for f in each.measured.figures
                if f.measure == "false_alarms_per_minute" and f.condition.startswith(prefix)
            }
            y, height = _beside(len(kinds), index, len(contenders))
            values = list(kinds.values())
            axes.barh(y, values, height * 0.9, color=look["color"], label=each.title)
        axes.set_yticks(range(len(kinds)), list(kinds))
        axes.invert_yaxis()
        axes.set_xlim(0, max(RATE, axes.get_xlim()[1]))
        axes.set_title("false alarms by kind of motion, at 1 per minute in all")
        axes.set_xlabel("false alarms per minute")
        axes.legend(loc="best")
    return figure


def plot_leads(contenders: Sequence[Drawn]) -> Figure:
    """Draw the lead of each detected approach at one false alarm per minute.

    Parameters
    ----------
    contenders : sequence of Drawn
        From top to bottom.

    Returns
    -------
    matplotlib.figure.Figure
    """
    with mpl.rc_context(STYLE):
        figure = new_figure(*SIZE)
        axes = figure.subplots()
        labels = []
        for row, (each, look) in enumerate(_looks(contenders)):
            leads, detected = _leads(each.measured)
            labels.append(f"{each.title}\n{len(leads)} of {len(detected)}")
            # Equal leads shall not hide each other.
            y = row + 0.09 * _rank_among_equal(leads)
            axes.plot(leads, y, "o", color=look["color"], markersize=3.5, alpha=0.8)
            if len(leads):
                axes.plot([np.median(leads)] * 2, [row - 0.3, row + 0.3], color=INK, lw=1.2)
        axes.set_yticks(range(len(labels)), labels)
        axes.set(ylim=(len(labels) - 0.5, -0.5), xlabel="time before contact (s)")
        axes.set_xlim(left=-0.02)
        axes.set_title("lead at 1 false alarm per minute (bar: median)")
    return figure


def _leads(measured: Measured) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    for each in measured.decisions:
        if each.condition == condition_of(RATE):
            leads, detected = each.outcomes.lead_s, each.outcomes.detected
            return np.sort(leads[~np.isnan(leads)]), detected[~np.isnan(detected)]
    return np.empty(0), np.empty(0)


def _rank_among_equal(values: NDArray[np.float64]) -> NDArray[np.float64]:
    rounded = np.round(values, 3)
    ranks = np.array([(rounded[:index] == each).sum() for index, each in enumerate(rounded)], float)
    return np.where(ranks % 2, 1, -1) * np.ceil(ranks / 2)


def _beside(count: int, index: int, of: int) -> tuple[NDArray[np.float64], float]:
    """Return where bars stand so that those of all contenders are side by side, and how wide."""
    width = 0.8 / of
    return np.arange(count, dtype=np.float64) + (index - (of - 1) / 2) * width, width


def _rates(x: str, y: str, title: str) -> tuple[Figure, Axes]:
    with mpl.rc_context(STYLE):
        figure = new_figure(*SIZE)
        axes = figure.subplots()
        axes.set(xlim=(-0.01, 1.01), ylim=(0, 1.02), xlabel=x, ylabel=y, title=title)
    return figure, axes


def _looks(contenders: Sequence[Drawn]) -> list[tuple[Drawn, dict[str, Any]]]:
    return [
        (each, {"color": COLOURS.get(each.name, INK), "ls": DASHES[index % len(DASHES)], "lw": 1.2})
        for index, each in enumerate(contenders)
    ]


def _legend(axes: Axes, place: Literal["lower left", "lower right"]) -> None:
    with mpl.rc_context(STYLE):
        if axes.get_legend_handles_labels()[0]:
            axes.legend(loc=place)
