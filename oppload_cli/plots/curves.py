"""Response curves over time."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import matplotlib as mpl
import numpy as np

from oppload_cli.errors import ResultError
from oppload_cli.plots.style import (
    COLOURS,
    COLUMN,
    CYCLE,
    DASHES,
    INK,
    NAMES,
    STYLE,
    UNITS,
    new_figure,
)
from oppload_cli.plots.threshold import alarm_params, alarm_threshold
from oppload_cli.plots.truth import contact_of, draw_truth, find_truth

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from oppload_cli.plots.truth import Truth
    from oppload_cli.results.reading import Result

ALARM_TOP, ALARM_STEP = 1.16, 0.07
HEADROOM = 1.42  # over the peak, for alarms and labels


@dataclass(frozen=True)
class CurveOptions:
    """How curves are drawn.

    Attributes
    ----------
    models : tuple of str
        The models to draw; empty for all that a result holds.
    raw : bool
        Responses in their own unit, a panel per model, instead of each over its peak.
    threshold : bool
        Whether the alarm's threshold is drawn.
    marks : dict of str to list of float or None
        Labelled times in seconds, one for each result, e.g. ``onset``.
    any_length : bool
        Whether results of different lengths may stand in one figure.
    """

    models: tuple[str, ...] = ()
    raw: bool = False
    threshold: bool = True
    marks: dict[str, list[float | None]] = field(default_factory=dict)
    any_length: bool = False


@dataclass(frozen=True)
class _Curve:
    """One line: a model's responses in a result, and how it is told from the others."""

    result: Result
    model: str
    name: str
    colour: str
    dash: object = "-"


def plot_curves(results: Sequence[Result], options: CurveOptions | None = None) -> Figure:
    """Draw responses over time.

    Several models over one input share a panel; one model over several inputs shares
    one too. Several models over several inputs get a panel per input.

    Parameters
    ----------
    results : sequence of Result
        At least one.
    options : CurveOptions, optional
        How they are drawn.

    Returns
    -------
    matplotlib.figure.Figure
        Each curve is divided by its own peak, which the legend states, unless raw.

    Raises
    ------
    ResultError
        If a result lacks a model that is asked for, or lengths differ.
    """
    options = options or CurveOptions()
    _check_lengths(results, options)
    truths = [find_truth(result) for result in results]
    panels = _panels(results, options)
    strips = {number: _shared_truth(curves, results, truths) for number, curves in panels.items()}
    if options.raw:  # one strip under the last panel of each result is enough
        strips = _last_of_each(panels, strips)
    with mpl.rc_context(STYLE):
        heights = [size for number in panels for size in _heights(panels[number], strips[number])]
        figure = new_figure(COLUMN, 0.25 + sum(heights))
        axes = figure.subplots(len(heights), 1, squeeze=False, height_ratios=heights)[:, 0]
        used = iter(axes)
        for number, curves in panels.items():
            own = [next(used)]
            draw_panel(own[0], curves, options)
            truth = strips[number]
            if truth is not None:
                own.append(next(used))
                own[1].sharex(own[0])
                draw_truth(own[1], truth)
                own[0].tick_params(labelbottom=False)
            number_of = [each.path for each in results].index(curves[0].result.path)
            marks = {label: times[number_of] for label, times in options.marks.items()}
            truth = _shared_truth(curves, results, truths)
            _mark(own, {**marks, "contact": marks.get("contact") or contact_of(truth)})
        axes[-1].set_xlabel("time (s)")
    return figure


def draw_panel(axes: Axes, curves: Sequence[_Curve], options: CurveOptions) -> None:
    """Draw the curves of one panel with their peaks, thresholds and alarms."""
    for order, curve in enumerate(curves):
        _draw_curve(axes, curve, options, order)
        if not options.raw:
            _draw_alarms(axes, curve, ALARM_TOP - order % 3 * ALARM_STEP)
    _explain(axes)
    one_input = len({curve.result.path for curve in curves}) == 1
    titles = curves[0].result.title if one_input else NAMES[curves[0].model]
    axes.set_title(titles, pad=4 + 9 * len(axes.get_legend_handles_labels()[1]))
    unit = UNITS[curves[0].model]
    axes.set_ylabel(f"response ({unit})" if options.raw else "response / peak")
    if not options.raw:
        axes.set_ylim(-0.03, HEADROOM)
        axes.set_yticks([0, 0.5, 1])
    else:
        axes.set_ylim(top=axes.get_ylim()[1] * 1.1)
    axes.margins(x=0.01)
    legend = axes.legend(
        loc="lower left", bbox_to_anchor=(0, 1), borderaxespad=0.1, borderpad=0.1,
        labelspacing=0.25, handlelength=1.8,
    )  # fmt: skip
    legend.set_in_layout(False)  # a long name must not squeeze the curves


def _panels(results: Sequence[Result], options: CurveOptions) -> dict[int, list[_Curve]]:
    """Sort the curves into panels."""
    for result in results:
        result.need([f"{model}_response" for model in options.models])
    models = {result.path: options.models or result.models for result in results}
    overlaid = len(results) > 1 and {len(each) for each in models.values()} == {1}
    if overlaid and len(set(models.values())) == 1:
        model = next(iter(models.values()))[0]
        lines = [
            _Curve(result, model, _short(result.title), CYCLE[order % 7], DASHES[order // 7 % 4])
            for order, result in enumerate(results)
        ]
        return {0: lines}
    groups = [
        [_Curve(result, model, NAMES[model], COLOURS[model]) for model in models[result.path]]
        for result in results
    ]
    if options.raw:
        groups = [[curve] for group in groups for curve in group]
    return dict(enumerate(groups))


def _last_of_each(
    panels: dict[int, list[_Curve]], strips: dict[int, Truth | None]
) -> dict[int, Truth | None]:
    last = {curves[-1].result.path: number for number, curves in panels.items()}
    return {number: truth if number in last.values() else None for number, truth in strips.items()}


def _heights(curves: Sequence[_Curve], truth: Truth | None) -> list[float]:
    panel = 1.6 + 0.12 * len(curves)
    return [panel] if truth is None else [panel, 0.62]


def _draw_curve(axes: Axes, curve: _Curve, options: CurveOptions, order: int) -> None:
    time = curve.result.frames["time_s"].to_numpy(float)
    response = curve.result.frames[f"{curve.model}_response"].to_numpy(float)
    look = {"color": curve.colour, "linestyle": curve.dash}
    best = int(np.nanargmax(response))
    peak = float(response[best])
    if peak <= 0:
        axes.plot(time, response, **look, label=f"{curve.name}, no response")  # type: ignore[arg-type]
        return
    over = 1.0 if options.raw else peak
    frame = int(curve.result.frames["frame"].iloc[best])
    when = f"{time[best]:.3g} s"
    when = when if len(curve.name) > 12 else f"frame {frame} ({when})"
    label = f"{curve.name}, peak {peak:.3g} at {when}"
    axes.plot(time, response / over, **look, label=label)  # type: ignore[arg-type]
    # Hollow, so that two peaks in one place are both seen.
    size = 6 - 2 * (order % 2)
    axes.plot(time[best], peak / over, "o", markersize=size, mfc="none", mec=curve.colour)
    if options.threshold and f"{curve.model}_alarm" in curve.result.frames.columns:
        _draw_threshold(axes, curve, time, response, over)


def _draw_threshold(
    axes: Axes,
    curve: _Curve,
    time: NDArray[np.float64],
    response: NDArray[np.float64],
    over: float,
) -> None:
    threshold = alarm_threshold(time, response, alarm_params(curve.result), curve.model) / over
    # Far above the curve it tells nothing, and would squeeze the curve.
    threshold[threshold > 1.08 * np.nanmax(response) / over] = np.nan
    if np.isfinite(threshold).any():
        axes.plot(
            time, threshold, color=curve.colour, lw=0.8, linestyle=(0, (1, 1)),
            drawstyle="steps-mid",
        )  # fmt: skip


def _draw_alarms(axes: Axes, curve: _Curve, height: float) -> None:
    """Draw a bar over the frames with the alarm on."""
    column = f"{curve.model}_alarm"
    if column not in curve.result.frames.columns:
        return
    time = curve.result.frames["time_s"].to_numpy(float)
    on = curve.result.frames[column].to_numpy(float) == 1
    if not on.any():
        return
    step = float(np.median(np.diff(time)))
    edges = np.flatnonzero(np.diff(np.concatenate(([False], on, [False])).astype(int)))
    spans = [(time[a], time[b - 1] - time[a] + step) for a, b in edges.reshape(-1, 2)]
    axes.broken_barh(spans, (height - 0.02, 0.04), facecolors=curve.colour)


def _explain(axes: Axes) -> None:
    """Say once, in ink, what the dots and bars of all colours are."""
    notes = []
    if any(line.get_drawstyle() == "steps-mid" for line in axes.lines):
        notes.append("dotted: threshold of the alarm")
    if axes.collections:
        notes.append("bar: alarm on")
    if notes:
        axes.plot([], [], linestyle="none", label="; ".join(notes))


def _mark(axes: Sequence[Axes], marks: dict[str, float | None]) -> None:
    """Draw labelled times as vertical lines."""
    first, last = axes[0].get_xlim()
    known = [(label, time) for label, time in marks.items() if time is not None]
    for row, (label, time) in enumerate(known):
        inside = first <= time <= last
        if inside:
            for each in axes:
                each.axvline(time, color=INK, lw=0.7, linestyle=(0, (4, 2)))
        near_left = time < first + 0.2 * (last - first)
        axes[0].annotate(
            label if inside else f"{label} at {time:.3g} s",
            (min(max(time, first), last), 1), xycoords=("data", "axes fraction"),
            xytext=(2 if near_left else -2, -6.5 * row), textcoords="offset points",
            ha="left" if near_left else "right", va="top", fontsize=6, color=INK,
        )  # fmt: skip


def _shared_truth(
    curves: Sequence[_Curve], results: Sequence[Result], truths: Sequence[Truth | None]
) -> Truth | None:
    """Return the ground truth of a panel, if all its inputs have one and the same."""
    paths = {curve.result.path for curve in curves}
    own = [truth for result, truth in zip(results, truths, strict=True) if result.path in paths]
    return own[0] if all(truth == own[0] for truth in own) else None


def _short(name: str, most: int = 26) -> str:
    return name if len(name) <= most else f"{name[: most // 2 - 1]}…{name[-most // 2 :]}"


def _check_lengths(results: Sequence[Result], options: CurveOptions) -> None:
    first = results[0]
    for result in results[1:]:
        if len(result.frames) != len(first.frames) and not options.any_length:
            raise ResultError(
                f"{result.path}: column 'frame' has {len(result.frames)} rows, that of "
                f"{first.path} {len(first.frames)}; give results of one length, or --any-length"
            )
