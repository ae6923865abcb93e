"""Classic figures of looming neuroscience: position, ends of a bar, contrast, habituation."""

from __future__ import annotations

import math
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from oppload_cli.errors import ResultError
from oppload_cli.plots import style
from oppload_cli.plots.tuning_curves import column_of, described, first_stimulus
from oppload_cli.reference import BOTH_ENDS_OVER_ONE

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from oppload_cli.plots.tuning_curves import Request, TuningCurve
    from oppload_cli.results.result_files import Series
    from oppload_cli.results.tuning import Tuning

    Peaks = Mapping[Any, float]  # by axis in degrees


@contextmanager
def _panels(
    count: int, labels: tuple[str, str], shape: float, above: float
) -> Iterator[tuple[Figure, list[Axes]]]:
    """Make a figure with `count` panels, and set its height after the caller has drawn it.

    The labels are those of the two axes, `shape` is the height of a panel over its width, and
    `above` is the height of the legend in inches.
    """
    columns = min(count, 2 if count <= style.FEW else 4)
    width = style.COLUMN if count <= style.FEW else style.PAGE
    with style.styled_figure(width, style.MOST_HEIGHT) as figure:
        axes = style.panel_grid(figure, count, columns, sharex=True, sharey=True)
        for panel in axes[-columns:]:
            panel.set_xlabel(labels[0])
        for panel in axes[::columns]:
            panel.set_ylabel(labels[1])
        yield figure, axes
        lines = max(panel.get_title("left").count("\n") for panel in axes)
        rows = -(-count // columns)
        height = above + rows * (0.4 + 0.11 * lines + shape * (width - 0.5) / columns)
        figure.set_figheight(min(style.MOST_HEIGHT, height))


@contextmanager
def _single(request: Request, curves: Sequence[TuningCurve]) -> Iterator[tuple[Figure, Axes]]:
    """Make a figure with one panel; the legend is added after the caller has drawn the curves."""
    few = len(curves) <= style.FEW
    lines = sum(1 + curve.label.count("\n") for curve in curves)
    height = 2.2 + 0.14 * lines / (1 if few else 2)
    with style.styled_figure(style.COLUMN if few else style.PAGE, height) as figure:
        panel = figure.subplots()
        yield figure, panel
        style.legend_over_figure(figure, panel, request.title, 1 if few else 2)


# ---- Position -------------------------------------------------------------------------------


def _plot_position(request: Request) -> tuple[Figure, list[Axes]]:
    """Draw a map of the peak over the object's position, with a contour at half the largest."""
    curves = request.of_one_table("a map of positions")
    tuning = curves[0].tuning
    wanted = "a position; run 'oppload tune --figure position'"
    right, up = (column_of(tuning, end, wanted, count=2) for end in (".right", ".up"))
    title_width = 20 if len(curves) > 1 else style.TITLE_WIDTH  # beside a colour bar
    labels = (described(right), described(up))
    # Without the room for each line of the title, the panel would be drawn over the foot.
    above = 0.25 + 0.14 * style.wrapped(request.title, style.TITLE_WIDTH).count("\n")
    places = (np.unique(tuning.rows[name].to_numpy(float)) for name in (right, up))
    wide, high = (float(np.ptp(style.edges_of(positions))) for positions in places)
    with _panels(len(curves), labels, 0.85 * max(1.0, high / wide), above) as (figure, axes):
        for panel, curve in zip(axes, curves, strict=True):
            cells, _ = curve.over_largest(right, up)
            x, y, share = (part.to_numpy(float) for part in (cells.columns, cells.index, cells))
            if np.isnan(share).any() or min(share.shape) < 2:
                raise ResultError(f"{tuning.path}: its positions are no grid; draw kind 'heat'")
            edges = style.edges_of(x), style.edges_of(y)
            image = panel.pcolormesh(
                *edges, share, cmap=style.SHADES, vmin=0, vmax=1, rasterized=True
            )
            panel.set_aspect("equal")
            if share.min() < 0.5 <= share.max():
                panel.contour(x, y, share, levels=[0.5], colors="white", linewidths=0.9)
            label = f"{curve.name}{curve.doubts}\n{_half_distance(x, y, share)}"
            panel.set_title(style.wrapped(label, title_width), fontsize=7)
        style.write_title(figure, request.title)
        style.colour_bar(figure, image, axes, "peak / largest peak", shrink=0.7, pad=0.02)
    return figure, axes


def _half_distance(x: Series, y: Series, share: Series) -> str:
    """Return in words the mean distance from its peak at which a map has fallen to half.

    The distance is the mean over the directions right, left, up and down. In each of them, a line
    between two places gives the first crossing of half. `share` is the map over its largest value,
    with a row for each `y` and a column for each `x`.
    """
    if not share.max() > 0:
        return "no response"
    if share.min() >= 0.5:
        return "never falls to half"
    row, column = np.unravel_index(int(share.argmax()), share.shape)
    distances = []
    for places, values in (
        (x[column:], share[row, column:]), (x[column::-1], share[row, column::-1]),
        (y[row:], share[row:, column]), (y[row::-1], share[row::-1, column]),
    ):  # fmt: skip
        below = np.flatnonzero(values < 0.5)
        if not below.size:
            return "half on some sides only"
        end = int(below[0])
        part = (values[end - 1] - 0.5) / (values[end - 1] - values[end])
        crossing = places[end - 1] + part * (places[end] - places[end - 1])
        distances.append(abs(crossing - places[0]))
    return f"half at {np.mean(distances):.0f} deg"


# ---- One end and both -----------------------------------------------------------------------


def _plot_ends(request: Request) -> tuple[Figure, list[Axes]]:
    """Draw the peak for a bar that grows at both ends, at one, and the sum of both single ends."""
    curves = request.of_one_table("a figure of one end and both")
    tuning = curves[0].tuning
    wanted = "the sides and the axis of a bar; run 'oppload tune --figure bar-ends'"
    sides, axis = (column_of(tuning, end, wanted, count=2) for end in (".sides", "axis_deg"))
    missing = {"both", "forward"}.difference(tuning.rows[sides])
    if missing:
        raise ResultError(f"{tuning.path}: column '{sides}' never holds '{min(missing)}'")
    low, high = BOTH_ENDS_OVER_ONE
    note = f"\nboth / one in LPLC2 neurons: {low:.1f} to {high:.1f}" * request.published
    title_width = 28 if len(curves) > 1 else style.TITLE_WIDTH
    labels = (described(axis), "peak / largest peak")
    with _panels(len(curves), labels, 0.6, 0.75 + 0.12 * request.published) as (figure, axes):
        for panel, curve in zip(axes, curves, strict=True):
            # From 0 to 360 and rounded, so that the opposite axis is found.
            axes_deg = curve.rows[axis].astype(float).round(6) % 360
            both, one = (
                curve.rows[curve.rows[sides] == side].groupby(axes_deg)["peak"].max().to_dict()
                for side in ("both", "forward")
            )
            largest = max(*both.values(), *one.values())
            _draw_ends(panel, both, one, largest, curve.detector.colour)
            label = f"{curve.name}, peak {largest:.2g}\n({curve.detector.unit})\n"
            label += f"both / one {_both_over_one(both, one)}"
            panel.set_title(style.wrapped(label + curve.doubts, title_width), fontsize=7)
        # The panels share an axis, whose range is that of the last call: for the highest panel.
        for panel in sorted(axes, key=lambda panel: panel.dataLim.y1):
            style.begin_at_zero(panel)
        style.legend_over_figure(figure, axes[0], request.title + note)
        for handle in figure.legends[0].legend_handles:
            if isinstance(handle, Line2D) and len(axes) > 1:  # for all colours
                handle.set_color(style.INK)
    return figure, axes


def _draw_ends(axes: Axes, both: Peaks, one: Peaks, largest: float, colour: str) -> None:
    look: dict[str, Any] = {"color": colour, "marker": "o", "markersize": 2.5}
    open_look = look | {"linestyle": "--", "markerfacecolor": "white"}
    total = {
        axis: peak + one[_opposite(axis)] for axis, peak in one.items() if _opposite(axis) in one
    }
    for label, peaks, own_look in (
        ("both ends", both, look),
        ("the end in the direction of the axis", one, open_look),
        ("sum of the two single ends", total, {"color": style.INK, "lw": 0.9, "linestyle": ":"}),
    ):
        shares = [peak / (largest or 1.0) for peak in peaks.values()]
        axes.plot(list(peaks), shares, label=label, **own_look)
    axes.set_xticks(range(0, 361, 90))


def _both_over_one(both: Peaks, one: Peaks) -> str:
    """Return the range over axes of the peak for both ends / the larger peak for one end.

    The peaks are given by axis in degrees; for one end, this is the direction of its growth. The
    ratio is infinite if only both ends together give a response. An axis without any response does
    not count.
    """
    ratios = []
    for axis, peak in both.items():
        single = max(one.get(axis, 0.0), one.get(_opposite(axis), 0.0))
        if peak > 0 or single > 0:
            ratios.append(peak / single if single > 0 else math.inf)
    if not ratios:
        return "not known: no response"
    least, most = _ratio(min(ratios)), _ratio(max(ratios))
    return least if least == most else f"{least} to {most}"


def _opposite(axis: float) -> float:
    return (axis + 180) % 360


def _ratio(value: float) -> str:
    """Return a ratio with two digits below 100, without an exponent, and as ``over 1000`` above."""
    if value > 1000:  # the number means little
        return "over 1000"
    return f"{value:.2g}" if value < 99.5 else f"{value:.0f}"


# ---- Contrast and habituation ---------------------------------------------------------------


def _plot_contrast(request: Request) -> tuple[Figure, list[Axes]]:
    """Draw the peak over the contrast of an object, as a share of the luminance of the ground."""
    advice = "a luminance; run 'oppload tune --figure contrast'"
    curves = request.curves()
    columns = [column_of(curve.tuning, ".luminance", advice) for curve in curves]
    contrasts = [
        _contrast(curve.tuning, curve.rows[column].to_numpy(float))
        for curve, column in zip(curves, columns, strict=True)
    ]
    with _single(request, curves) as (figure, panel):
        for curve, contrast in zip(curves, contrasts, strict=True):
            x, y = contrast, curve.peaks
            if 0 not in x:  # a gap, so that no line crosses a contrast that was not measured
                x, y = np.append(x, 0), np.append(y, np.nan)
            order = np.argsort(x)
            share = y[order] / (curve.largest or 1.0)
            panel.plot(x[order], share, markersize=3, **curve.look, label=curve.label)
        style.begin_at_zero(panel)
        panel.axvline(0, color=style.FAINT, lw=0.7)
        panel.set_xlabel("contrast to the ground (%), below 0: darker")
        panel.set_ylabel("peak / largest peak")
    return figure, [panel]


def _contrast(tuning: Tuning, luminance: Series) -> Series:
    """Return the contrast of an object's luminance to the ground in %, as the frames show it.

    Raises ResultError if the luminance of the ground is not known, or the ground is black.
    """
    first = first_stimulus(tuning)
    try:
        ground = float(first["display"]["background"])
        if first.get("effects", {}).get("invert"):
            ground, luminance = 1 - ground, 1 - luminance
    except (KeyError, TypeError, ValueError, AttributeError):
        ground = 0.0
    if not ground > 0:
        raise ResultError(
            f"{tuning.path}: contrast needs a ground that is not black in display.background of "
            f"{tuning.path.with_suffix('.json').name}; draw kind 'line'"
        )
    return 100 * (luminance - ground) / ground


def _plot_habituation(request: Request) -> tuple[Figure, list[Axes]]:
    """Draw the peak of each presentation divided by that of the first."""
    advice = "presentations in a row; run 'oppload tune --figure habituation'"
    curves = request.curves()
    columns = [column_of(curve.tuning, "presentation", advice) for curve in curves]
    with _single(request, curves) as (figure, panel):
        most = 1.0
        for number, (curve, column) in enumerate(zip(curves, columns, strict=True)):
            rows = curve.rows.sort_values(column)
            peaks = rows["peak"].to_numpy(float)
            if not peaks[0] > 0:
                panel.plot([], [], **curve.look, label=f"{curve.name}: no response to the first")
                continue
            share = peaks / peaks[0]
            most = max(most, float(share.max()))
            # Markers of earlier curves are larger, so that curves in one place are all visible.
            size = 3.0 + 2.0 * (len(curves) - 1 - number) * (len(curves) <= style.FEW)
            label = f"{curve.name}: last / first {share[-1]:.3f}{curve.doubts}"
            panel.plot(
                rows[column], share, markersize=size, **curve.look,
                label=style.wrapped(label, style.LEGEND_WIDTH),
            )  # fmt: skip
        panel.set_ylim(0, 1.1 * most)
        panel.xaxis.set_major_locator(MaxNLocator(integer=True))
        panel.set_xlabel("presentation")
        panel.set_ylabel("peak / peak of the first")
    return figure, [panel]


# By the kind of the plot.
FIGURES = {
    "position": _plot_position,
    "ends": _plot_ends,
    "contrast": _plot_contrast,
    "habituation": _plot_habituation,
}
