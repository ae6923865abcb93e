"""Plots of an evaluation, which compare the performances of all detectors."""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.transforms import blended_transform_factory

from oppload_cli.errors import counted
from oppload_cli.evaluation.battery import TABLES
from oppload_cli.evaluation.detectors import full_label
from oppload_cli.evaluation.metrics.alarms import AT_ONE, RATES
from oppload_cli.evaluation.metrics.clips import AHEAD
from oppload_cli.evaluation.metrics.measures import KIND
from oppload_cli.models.registry import detector_named
from oppload_cli.plots.style import (
    DASHES,
    FAINT,
    INK,
    SHADES,
    plain,
    styled_figure,
    width_em,
    wrapped,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.image import AxesImage

    from oppload_cli.evaluation.battery import BatteryResponses
    from oppload_cli.evaluation.metrics.clips import Flags, Numbers
    from oppload_cli.evaluation.metrics.intervals import Measurement
    from oppload_cli.evaluation.metrics.measures import Performance

    Performances = Mapping[str, Performance]


_HATCHES = ("", "////", "....", "xxxx", "\\\\\\\\", "----")  # of bars
_HIGHEST_RATE = 6.0  # false alarms per minute at the end of the axis
_LEAST, _MOST = 1e-3, 10.0  # widest range of shades, in responses to the looming disk
_SHARES: dict[str, Any] = {"xlim": (-0.01, 1.01), "ylim": (0, 1.02)}  # limits for two shares


def _detection(axes: Axes, performances: Performances) -> None:
    for rate in RATES:
        axes.axvline(rate, color=FAINT, lw=0.7, linestyle=":")
    for performance, look in _looks(performances):
        rates, detected = _detection_curve(performance)
        if len(rates):
            axes.step(rates, detected, where="post", **look)
    axes.set(xlim=(0, _HIGHEST_RATE), ylim=(-0.02, 1.02), title="detection by one fixed threshold")
    axes.set_xlabel("false alarms per minute of footage without an approach")
    axes.set_ylabel("share of approaches detected")
    _legend(axes)


def _detection_curve(performance: Performance) -> tuple[Numbers, Numbers]:
    """Return rates of false alarms per minute, which rise, and the detection rate at each.

    The last rate is beyond the axis. Both are empty if there is no approach, or no footage without
    an approach.
    """
    thresholds = performance.thresholds
    once = np.ones(len(thresholds.minutes), np.int64)
    rates = np.maximum.accumulate(thresholds.rates(once))
    # Several thresholds may give the same rate: the lowest one detects most.
    last = np.append(np.diff(rates) > 0, True)[: len(rates)] & (rates <= _HIGHEST_RATE)
    detected = [thresholds.outcomes(level).detected for level in thresholds.levels[last]]
    if np.isnan(detected).all():  # also without a rate
        return np.empty(0), np.empty(0)
    shares = np.nanmean(detected, axis=1)
    return np.append(rates[last], 2 * _HIGHEST_RATE), np.append(shares, shares[-1])


def _roc(axes: Axes, performances: Performances) -> None:
    axes.set(xlabel="false positive rate", ylabel="true positive rate", title="ROC", **_SHARES)
    axes.plot([0, 1], [0, 1], color=FAINT, lw=0.7, linestyle=":")
    for performance, look in _looks(performances):
        if (curves := performance.curves) is not None:
            look["label"] += f" ({curves.auc:.3f})"
            axes.plot(curves.false_rate, curves.true_rate, **look)
    _legend(axes)


def _precision_recall(axes: Axes, performances: Performances) -> None:
    axes.set(xlabel="recall", ylabel="precision", title="precision and recall", **_SHARES)
    for performance, look in _looks(performances):
        if (curves := performance.curves) is not None:
            look["label"] += f" ({curves.average_precision:.3f})"
            rises = np.append(True, np.diff(curves.true_rate) > 0)
            axes.step(curves.true_rate[rises], curves.precision[rises], where="pre", **look)
    _legend(axes)


def _order(axes: Axes, performances: Performances) -> None:
    for index, (performance, look) in enumerate(_looks(performances)):
        pairs = {
            one.condition: one for one in performance.measurements if one.measure == "ordered_pairs"
        }
        rows = [pairs[f"{frames} frames before contact"] for frames in AHEAD]
        x, width = _beside(len(rows), index, len(performances))
        values = np.array([row.value for row in rows])
        spread = np.array([[row.value - row.low, row.high - row.value] for row in rows]).T
        bars: dict[str, Any] = {"ecolor": INK, "elinewidth": 0.7, "capsize": 1.5}
        axes.bar(x, values, width * 0.9, **_bar_look(look, index))
        axes.errorbar(x, values, np.maximum(spread, 0), fmt="none", **bars)
    axes.axhline(0.5, color=FAINT, lw=0.7, linestyle=":")
    axes.set_xticks(range(len(AHEAD)), [str(frames) for frames in AHEAD])
    axes.set(ylim=(0, 1.05), title="within clips: correctly ordered pairs of windows")
    axes.set_yticks(np.arange(0, 1.01, 0.2))
    axes.set_xlabel("frames from the window's end to contact")
    axes.set_ylabel("share of pairs")
    _say_if_empty(axes, "no pair of windows")
    _legend(axes)


def _leads(axes: Axes, performances: Performances) -> None:
    labels = []
    for row, (performance, look) in enumerate(_looks(performances)):
        outcomes = performance.decisions[AT_ONE].outcomes
        leads = np.sort(outcomes.lead_s[~np.isnan(outcomes.lead_s)])
        approaches = int((~np.isnan(outcomes.detected)).sum())
        labels.append(f"{look['label']}\n{len(leads)} of {approaches}")
        # Points with equal lead times are drawn above and below each other, so that all are seen.
        ranks = _rank_among_equal(leads)
        highest = np.abs(ranks).max(initial=1)
        y = row + min(0.09, 0.42 / highest) * ranks  # in rows
        axes.plot(leads, y, "o", color=look["color"], markersize=3.5, alpha=0.8, clip_on=False)
        if len(leads):
            axes.plot([np.median(leads)] * 2, [row - 0.3, row + 0.3], color=INK, lw=1.2)
    axes.set_yticks(range(len(labels)), labels)
    axes.set(ylim=(len(labels) - 0.5, -0.5), xlabel="time before contact (s)")
    axes.margins(x=0.03)
    axes.set_xlim(left=-0.02)
    if not any(len(line.get_xdata()) for line in axes.lines):  # type: ignore[arg-type]
        _say(axes, "no approach detected")
    axes.set_title("lead at 1 false alarm per minute (bar: median)")


def _rank_among_equal(values: Numbers) -> Numbers:
    """Return 0, 1, -1, 2, -2, ... for the values that are equal."""
    rounded = np.round(values, 3)
    ranks = np.array(
        [(rounded[:index] == value).sum() for index, value in enumerate(rounded)], float
    )
    return np.where(ranks % 2, 1, -1) * np.ceil(ranks / 2)


def _false_alarms(axes: Axes, performances: Performances) -> None:
    prefix = f"{AT_ONE}, "
    kinds: dict[str, Measurement] = {}
    highest = 1.0
    for index, (performance, look) in enumerate(_looks(performances)):
        kinds = {
            one.condition.removeprefix(prefix): one
            for one in performance.measurements
            if one.measure == "false_alarms_per_minute" and one.condition.startswith(prefix)
        }
        y, height = _beside(len(kinds), index, len(performances))
        values = np.array([one.value for one in kinds.values()])
        bounds = np.array([[one.low, one.high] for one in kinds.values()]).reshape(-1, 2)
        spread = np.abs(bounds.T - values)
        axes.barh(y, values, height * 0.9, **_bar_look(look, index))
        axes.errorbar(values, y, xerr=spread, fmt="none", ecolor=look["color"], elinewidth=0.9)
        highest = max(highest, values.max(initial=0))
    labels = [f"{plain(kind)}\n{counted(one.n, 'clip')}" for kind, one in kinds.items()]
    axes.set_yticks(range(len(kinds)), labels)
    axes.figure.figure.set_figheight(_height(max(len(kinds), len(performances))))
    axes.invert_yaxis()
    axes.set_xlim(0, 1.6 * highest)  # intervals of few clips are too long to show completely
    axes.set_title("false alarms by kind of motion, at 1 per minute in all")
    axes.set_xlabel("false alarms per minute")
    _say_if_empty(axes, "no false alarm")
    _legend(axes)


def _height(rows: int) -> float:
    """Return the height of a figure in inches, so that the labels of its rows are apart."""
    return 3.5 + 0.3 * max(0, rows - 8)


def _beside(count: int, index: int, of: int) -> tuple[Numbers, float]:
    """Return positions and width of the bars of detector `index` out of `of`, side by side."""
    width = 0.8 / of
    return np.arange(count, dtype=np.float64) + (index - (of - 1) / 2) * width, width


def _looks(performances: Performances) -> Iterator[tuple[Performance, dict[str, Any]]]:
    """Yield each performance with the label, colour and dashes of its line."""
    for index, (name, performance) in enumerate(performances.items()):
        label = wrapped(full_label(name), 26)  # three columns of such lines fit below a plot
        look = {"label": label, "color": detector_named(name).colour}
        # Each line is thinner than the one before, so that lines that coincide are all seen.
        width = max(1.0, 2.6 - 0.4 * index)
        yield performance, {**look, "lw": width, "ls": DASHES[index % len(DASHES)]}


def _bar_look(look: Mapping[str, Any], index: int) -> dict[str, Any]:
    """Return the look of the bars of detector `index`, which differ in grey print too."""
    hatch = _HATCHES[index % len(_HATCHES)]
    return {"color": look["color"], "label": look["label"], "hatch": hatch, "edgecolor": "white"}


def _legend(axes: Axes) -> None:
    """Draw the legend below the axes, where it covers nothing; axes without a curve say why."""
    labels = axes.get_legend_handles_labels()[1]
    if labels:
        # In the middle of the figure, so that it may be as wide.
        across = blended_transform_factory(axes.figure.transFigure, axes.transAxes)
        axes.legend(
            loc="upper center", bbox_to_anchor=(0.5, -0.2), bbox_transform=across,
            ncols=_columns(labels),
        )  # fmt: skip
    else:
        _say(axes, "no approach, or no footage without one")


def _columns(labels: Sequence[str]) -> int:
    """Return in how many columns, at most three, a legend is not wider than the figure."""
    handle_em, figure_em = 4.8, 52  # a line beside its label, and the figure, in the legend's font
    widths = [max(map(width_em, label.splitlines())) + handle_em for label in labels]

    def width(columns: int) -> float:
        return sum(max(column, default=0.0) for column in np.array_split(widths, columns))

    return next((columns for columns in (3, 2) if width(columns) <= figure_em), 1)


def _say(axes: Axes, words: str) -> None:
    # The white ground parts the words from lines.
    ground = {"facecolor": "white", "edgecolor": "none", "pad": 2}
    axes.text(0.5, 0.5, words, transform=axes.transAxes, ha="center", color=INK, bbox=ground)


def _say_if_empty(axes: Axes, words: str) -> None:
    """Write words into axes whose bars all have no length, or an unknown one."""
    if not any(np.nan_to_num(bar.get_bbox().size).all() for bar in axes.patches):  # type: ignore[attr-defined]
        _say(axes, words)


# By file name, the caption of each plot and the function that draws it.
PLOTS: dict[str, tuple[str, Callable[[Axes, Performances], None]]] = {
    "detection.png": (
        "Detection rate over false alarms per minute, for every fixed threshold; dotted: the rates "
        "of the tables.",
        _detection,
    ),
    "roc.png": ("ROC curve of one-second windows; area in brackets.", _roc),
    "precision-recall.png": (
        "Precision over recall, of the same windows; average precision in brackets.",
        _precision_recall,
    ),
    "within-clip.png": (
        "Correctly ordered pairs of windows within clips; lines: 95 % intervals, dotted: chance.",
        _order,
    ),
    "lead-time.png": ("Lead time of each detected approach.", _leads),
    "false-alarms.png": (
        "False alarms per minute by kind of motion, at 1 per minute over all kinds; lines: 95 % "
        "intervals, which may be longer than the plot shows.",
        _false_alarms,
    ),
}


def figure_of(plot: str, performances: Performances) -> Figure:
    """Return one of the `PLOTS`; `performances` has the order of the legend."""
    with styled_figure(4.8, _height(len(performances))) as figure:
        _, draw = PLOTS[plot]
        draw(figure.subplots(), performances)
    return figure


def battery_figure(responses: BatteryResponses) -> Figure:
    """Return the matrix of selectivity: detectors over the columns of the battery.

    The shades are responses divided by that to the looming disk; the dots are alarms.
    """
    left = (KIND, "polarity", "contrast")
    sides = [_matrix_rows(responses, tables) for tables in (left, [*TABLES][len(left) :])]
    height = max(map(len, sides))
    least, most = _limits(np.concatenate([*responses.over_loom.values()]))
    norm = LogNorm(least, most)
    # In inches: the labels of the rows, the colour bar, and the names of the detectors above.
    labels, bar_width, names, shade = 1.5, 0.9, 1.1, 0.17
    width = 2 * (labels + shade * len(responses.names)) + bar_width
    with styled_figure(width, names + shade * height) as figure:
        panels = figure.subplots(1, 2)
        for axes, rows in zip(panels, sides, strict=True):
            image = _matrix(axes, responses, rows, norm)
            axes.set_ylim(height - 0.5, -0.5)  # the rows of both sides are equally high
        bar = figure.colorbar(image, ax=panels, pad=0.02, extend="both", aspect=40)
        steps = (1,) if most > 100 * least else (1, 2, 5)
        ticks = [step * 10.0**decade for decade in range(-3, 2) for step in steps]
        ticks = [tick for tick in ticks if 0.999 * least <= tick <= 1.001 * most]
        bar.set_ticks(ticks, labels=[f"{tick:g}" for tick in ticks])
        bar.ax.minorticks_off()
        bar.set_label("largest response / that to the looming disk")
    return figure


def _matrix_rows(
    responses: BatteryResponses, tables: Sequence[str]
) -> list[tuple[str, Flags | None]]:
    """Return the label of each row with its clips; None for a row with the title of a table."""
    rows: list[tuple[str, Flags | None]] = []
    for table in tables:
        rows += [(TABLES[table], None), *responses.columns(table).items()]
    return rows


def _matrix(
    axes: Axes, responses: BatteryResponses, rows: Sequence[tuple[str, Flags | None]], norm: LogNorm
) -> AxesImage:
    """Draw rows of shades with dots for alarms: a full dot if every clip has one, else a half."""
    names = responses.names
    shades = np.full((len(rows), len(names)), np.nan)
    for (y, (_, clips)), (x, name) in product(enumerate(rows), enumerate(names)):
        if clips is None:
            continue
        largest = np.nan_to_num(responses.over_loom[name][clips].max(), posinf=np.inf)
        shades[y, x] = np.clip(largest, norm.vmin, norm.vmax)
        alarmed = responses.alarmed[name][clips]
        if np.nansum(alarmed):
            colour = INK if norm(shades[y, x]) > 0.5 else "white"
            fill = "full" if alarmed.all() else "left"
            axes.plot(x, y, "o", ms=4, mew=0.5, color=colour, fillstyle=fill)
    image = axes.imshow(shades, norm=norm, cmap=SHADES, aspect="auto")
    labels = [plain(full_label(name)) for name in names]
    axes.set_xticks(range(len(names)), labels, rotation=60, ha="left", rotation_mode="anchor")
    axes.xaxis.tick_top()
    axes.set_yticks(range(len(rows)), [label for label, _ in rows])
    for tick, (_, clips) in zip(axes.get_yticklabels(), rows, strict=True):
        tick.set_fontweight("bold" if clips is None else "normal")
    axes.tick_params(length=0)
    axes.spines[:].set_visible(False)
    return image


def _limits(values: Numbers) -> tuple[float, float]:
    """Return the ends of the shades: the least and largest response, within `_LEAST` and `_MOST`.

    Their ratio is at least 2, so that nearly equal responses have similar shades.
    """
    known = values[np.isfinite(values) & (values > 0)]
    most = float(np.clip(known.max(initial=0), 2 * _LEAST, _MOST))
    least = float(np.clip(known.min(initial=most), _LEAST, most / 2))
    return least, most
