"""Classic figures of looming neuroscience: position, ends of a bar, contrast, habituation."""

from __future__ import annotations

import math
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from oppload_cli.errors import ResultError
from oppload_cli.models.registry import detector_named
from oppload_cli.plots.style import (
    COLUMN,
    FAINT,
    FEW,
    INK,
    LEGEND_WIDTH,
    MOST_HEIGHT,
    PAGE,
    SHADES,
    TITLE_WIDTH,
    begin_at_zero,
    colour_bar,
    described,
    doubts_of,
    edges_of,
    looks_of,
    panel_grid,
    styled_figure,
    wrapped,
    write_title,
)
from oppload_cli.reference import BOTH_ENDS_OVER_ONE

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from oppload_cli.models.detector import Detector
    from oppload_cli.results.reading import Tuning

    Series = NDArray[np.float64]

_NARROW = 28  # characters in a line above one of two panels
_HALF = 0.5
_MOST_RATIO = 1000


class TuningCurve(NamedTuple):
    """The peaks of one detector in a table: a curve of a figure, or a panel."""

    tuning: Tuning
    detector: type[Detector]
    name: str  # of the detector, after that of the table if there are several
    look: dict[str, Any]  # line properties of matplotlib

    @property
    def rows(self) -> pd.DataFrame:
        """The rows of the detector."""
        return self.tuning.of(self.detector.name)

    @property
    def peaks(self) -> Series:
        """The peak in each row."""
        return self.rows["peak"].to_numpy(float)

    @property
    def largest(self) -> float:
        """The largest peak."""
        return float(self.peaks.max())

    @property
    def doubts(self) -> str:
        """Why the curve means little, each reason after a line break."""
        return doubts_of(self.tuning, self.detector.name)

    @property
    def label(self) -> str:
        """The name with the largest peak, for a legend."""
        text = f"{self.name}, largest peak {self.largest:.3g} ({self.detector.unit}){self.doubts}"
        return wrapped(text, LEGEND_WIDTH)


class Request(NamedTuple):
    """Tables to draw, at least one."""

    tunings: Sequence[Tuning]
    models: Sequence[str]  # the detectors to draw; none for all
    names: Sequence[str]  # a name for each table
    title: str = ""
    published: bool = False  # whether published neurons are drawn too
    raw: bool = False  # whether peaks are drawn in their unit, not over the largest

    def curves(self) -> list[TuningCurve]:
        """Return the curves, table by table; raise ResultError if a detector is in none."""
        for model in self.models:
            if all(tuning.of(model).empty for tuning in self.tunings):
                raise ResultError(
                    f"{self.tunings[0].path}: column 'model' never holds '{model}'; leave it out"
                )
        shown = [
            (tuning, detector_named(model), table)
            for tuning, table in zip(self.tunings, self.names, strict=True)
            for model in self.models or tuning.models
            if len(tuning.of(model))
        ]
        looks = looks_of([detector.name for _, detector, _ in shown])
        several = len(self.tunings) > 1
        return [
            TuningCurve(tuning, detector, f"{table}: " * several + detector.label, look)
            for (tuning, detector, table), look in zip(shown, looks, strict=True)
        ]

    def of_one_table(self, figure: str) -> list[TuningCurve]:
        """Return the curves in the table's order; raise ResultError if there are more tables."""
        tuning, *others = self.tunings
        if others:
            raise ResultError(f"{others[0].path}: {figure} shows one table; plot them separately")
        held = [name for name in tuning.models if name in self.models]
        absent = [name for name in self.models if name not in held]  # the first one is an error
        return self._replace(models=[*held, *absent]).curves()


def column_of(tuning: Tuning, ending: str, wanted: str, *, of: int = 1) -> str:
    """Return the swept column with an ending, in a table with so many swept columns.

    Raises
    ------
    ResultError
        If there is not one such column, or others are swept too; it names what was `wanted`.
    """
    found = [name for name in tuning.parameters if name.endswith(ending)]
    if len(found) != 1 or len(tuning.parameters) != of:
        swept = " and ".join(tuning.parameters)
        raise ResultError(f"{tuning.path}: sweeps '{swept}', not {wanted}")
    return found[0]


@contextmanager
def _panels(
    count: int, labels: tuple[str, str], shape: float, above: float
) -> Iterator[tuple[Figure, list[Axes]]]:
    """Open a figure with a panel for each of some detectors, whose titles the caller writes.

    The labels are those of the two axes, `shape` is the height of a panel over its width, and
    `above` the height of the legend in inches.
    """
    columns = min(count, 2 if count <= FEW else 4)
    width = COLUMN if count <= FEW else PAGE
    with styled_figure(width, MOST_HEIGHT) as figure:
        axes = panel_grid(figure, count, columns, sharex=True, sharey=True)
        for panel in axes[-columns:]:
            panel.set_xlabel(labels[0])
        for panel in axes[::columns]:
            panel.set_ylabel(labels[1])
        yield figure, axes
        lines = max(panel.get_title("left").count("\n") for panel in axes)
        rows = -(-count // columns)
        height = above + rows * (0.4 + 0.11 * lines + shape * (width - 0.5) / columns)
        figure.set_figheight(min(MOST_HEIGHT, height))


@contextmanager
def _single(request: Request, curves: Sequence[TuningCurve]) -> Iterator[tuple[Figure, Axes]]:
    """Open a figure with one panel for some curves; their legend is drawn at the end."""
    few = len(curves) <= FEW
    lines = sum(1 + curve.doubts.count("\n") for curve in curves)
    height = 2.2 + 0.14 * lines / (1 if few else 2)
    with styled_figure(COLUMN if few else PAGE, min(MOST_HEIGHT, height)) as figure:
        panel = figure.subplots()
        yield figure, panel
        legend_above(figure, panel, request.title, 1 if few else 2)


def legend_above(figure: Figure, axes: Axes, title: str, columns: int = 1) -> None:
    """Write title and legend above the panels, where they cover no point."""
    figure.legend(
        *axes.get_legend_handles_labels(), loc="outside upper left", ncols=columns,
        title=wrapped(title, TITLE_WIDTH) or None, title_fontsize=8, alignment="left",
        borderaxespad=0.1, handlelength=2.6,
    )  # fmt: skip


# ---- Position -------------------------------------------------------------------------------


def _plot_position(request: Request) -> tuple[Figure, list[Axes]]:
    """Draw a map of the peak over the object's position, with the line of half the largest."""
    curves = request.of_one_table("a map of positions")
    tuning = curves[0].tuning
    wanted = "a position; run 'oppload tune --figure position'"
    right, up = (column_of(tuning, end, wanted, of=2) for end in (".right", ".up"))
    across = _NARROW if len(curves) > 1 else TITLE_WIDTH
    labels = (described(right), described(up))
    with _panels(len(curves), labels, 0.85, 0.25) as (figure, axes):
        for panel, curve in zip(axes, curves, strict=True):
            cells = curve.rows.pivot_table(index=up, columns=right, values="peak")
            share = cells.to_numpy(float)
            if np.isnan(share).any() or min(share.shape) < 2:
                raise ResultError(f"{tuning.path}: its positions are no grid; draw --kind heat")
            share = share / (float(share.max()) or 1.0)
            x, y = cells.columns.to_numpy(float), cells.index.to_numpy(float)
            image = panel.pcolormesh(
                edges_of(x), edges_of(y), share, cmap=SHADES, vmin=0, vmax=1, rasterized=True
            )
            panel.set_aspect("equal")
            if share.min() < _HALF <= share.max():
                panel.contour(x, y, share, levels=[_HALF], colors="white", linewidths=0.9)
            label = f"{curve.name}{curve.doubts}\n{_half(x, y, share)}"
            panel.set_title(wrapped(label, across), fontsize=7)
        write_title(figure, request.title)
        colour_bar(figure, image, axes, "peak / largest peak", shrink=0.7, pad=0.02)
    return figure, axes


def _half_distance(x: Series, y: Series, share: NDArray[np.float64]) -> float | None:
    """Return the mean distance from its peak at which a map has fallen to half.

    Along each of the directions right, up, left and down the first crossing of half is taken,
    between two places linearly; None if there is none in some direction. `share` is the map over
    its largest value, with a row for each `y` and a column for each `x`.
    """
    row, column = np.unravel_index(int(share.argmax()), share.shape)
    found = []
    for places, values in (
        (x[column:], share[row, column:]), (x[column::-1], share[row, column::-1]),
        (y[row:], share[row:, column]), (y[row::-1], share[row::-1, column]),
    ):  # fmt: skip
        below = np.flatnonzero(values < _HALF)
        if not below.size:
            return None
        at = int(below[0])
        part = (values[at - 1] - _HALF) / (values[at - 1] - values[at])
        found.append(abs(places[at - 1] + part * (places[at] - places[at - 1]) - places[0]))
    return float(np.mean(found))


def _half(x: Series, y: Series, share: NDArray[np.float64]) -> str:
    if not share.max() > 0:
        return "no response"
    distance = _half_distance(x, y, share)
    if distance is None:
        return "never falls to half" if share.min() >= _HALF else "half on some sides only"
    return f"half at {distance:.0f} deg"


# ---- One end and both -----------------------------------------------------------------------


def _plot_ends(request: Request) -> tuple[Figure, list[Axes]]:
    """Draw the peak for a bar that grows at both ends, at one, and the sum of two single ends."""
    curves = request.of_one_table("one end and both")
    tuning = curves[0].tuning
    wanted = "the sides and the axis of a bar; run 'oppload tune --figure bar-ends'"
    sides, axis = (column_of(tuning, end, wanted, of=2) for end in (".sides", "axis_deg"))
    missing = {"both", "forward"}.difference(tuning.rows[sides])
    if missing:
        raise ResultError(f"{tuning.path}: column '{sides}' never holds '{min(missing)}'")
    low, high = BOTH_ENDS_OVER_ONE
    note = f"\nboth / one in LPLC2 neurons: {low:.1f} to {high:.1f}" * request.published
    across = _NARROW if len(curves) > 1 else TITLE_WIDTH
    labels = (described(axis), "peak / largest peak")
    with _panels(len(curves), labels, 0.6, 0.75 + 0.12 * request.published) as (figure, axes):
        for panel, curve in zip(axes, curves, strict=True):
            both, one = (
                dict(zip(some[axis].astype(float), some["peak"].astype(float), strict=True))
                for some in (curve.rows[curve.rows[sides] == side] for side in ("both", "forward"))
            )
            _draw_ends(panel, both, one, curve.detector.colour)
            largest = max(*both.values(), *one.values())
            label = f"{curve.name}, peak {largest:.2g}\n({curve.detector.unit})\n"
            label += f"both / one {_range(_both_over_one(both, one))}"
            panel.set_title(wrapped(label + curve.doubts, across), fontsize=7)
        # The highest comes last: they share the axis.
        for panel in sorted(axes, key=lambda panel: panel.dataLim.y1):
            begin_at_zero(panel)
        legend_above(figure, axes[0], wrapped(request.title, TITLE_WIDTH) + note)
        for handle in figure.legends[0].legend_handles:
            if isinstance(handle, Line2D) and len(axes) > 1:  # it is for all colours
                handle.set_color(INK)
    return figure, axes


def _draw_ends(
    axes: Axes, both: Mapping[float, float], one: Mapping[float, float], colour: str
) -> None:
    largest = max(*both.values(), *one.values()) or 1.0
    look: dict[str, Any] = {"color": colour, "marker": "o", "markersize": 2.5}
    open_look = look | {"linestyle": "--", "markerfacecolor": "white"}
    total = {axis: peak + one[_across(axis)] for axis, peak in one.items() if _across(axis) in one}
    for label, peaks, each in (
        ("both ends", both, look),
        ("the end in the direction of the axis", one, open_look),
        ("sum of the two single ends", total, {"color": INK, "lw": 0.9, "linestyle": ":"}),
    ):
        axes.plot(list(peaks), [peak / largest for peak in peaks.values()], label=label, **each)
    axes.set_xticks(range(0, 361, 90))


def _both_over_one(both: Mapping[float, float], one: Mapping[float, float]) -> list[float]:
    """Return the peak for both ends over that for the better single end, for each axis.

    The peaks are by axis in degrees; those of one end by the direction in which it grows. The
    ratio is infinite where only both ends give a response; axes without any are left out.
    """
    made = []
    for axis, peak in both.items():
        single = max((one[each] for each in (axis, _across(axis)) if each in one), default=0.0)
        if peak > 0 or single > 0:
            made.append(peak / single if single > 0 else math.inf)
    return made


def _across(axis: float) -> float:
    return (axis + 180) % 360


def _range(values: Sequence[float]) -> str:
    """Return a range of ratios in words; above `_MOST_RATIO` the number means little."""
    if not values:
        return "not known: no response"
    least, most = (_ratio(value) for value in (min(values), max(values)))
    return least if least == most else f"{least} to {most}"


def _ratio(value: float) -> str:
    """Return a ratio with two digits, and without an exponent where it is of three or four."""
    if value > _MOST_RATIO:
        return f"over {_MOST_RATIO}"
    return f"{value:.2g}" if value < 99.5 else f"{value:.0f}"


# ---- Contrast and habituation ---------------------------------------------------------------


def _plot_contrast(request: Request) -> tuple[Figure, list[Axes]]:
    """Draw the peak over the contrast of an object against the ground, as a share of the ground."""
    advice = "a luminance; run 'oppload tune --figure contrast'"
    curves = request.curves()
    columns = [column_of(curve.tuning, ".luminance", advice) for curve in curves]
    grounds = [_background(curve.tuning) for curve in curves]
    with _single(request, curves) as (figure, panel):
        for curve, column, ground in zip(curves, columns, grounds, strict=True):
            x, y = 100 * (curve.rows[column].to_numpy(float) - ground) / ground, curve.peaks
            if 0 not in x:  # no line over what was not measured
                x, y = np.append(x, 0), np.append(y, np.nan)
            order = np.argsort(x)
            share = y[order] / (curve.largest or 1.0)
            panel.plot(x[order], share, marker="o", markersize=3, **curve.look, label=curve.label)
        begin_at_zero(panel)
        panel.axvline(0, color=FAINT, lw=0.7)
        panel.set_xlabel("contrast to the ground (%), below 0: darker")
        panel.set_ylabel("peak / largest peak")
    return figure, [panel]


def _background(tuning: Tuning) -> float:
    first = tuning.sidecar.get("stimulus", {}).get("first")
    try:
        ground = float(first["display"]["background"])
    except (KeyError, TypeError, ValueError):
        ground = 0.0
    if not ground > 0:
        raise ResultError(
            f"{tuning.path}: contrast needs a ground that is not black in display.background of "
            f"{tuning.path.with_suffix('.json').name}; draw --kind line"
        )
    return ground


def _plot_habituation(request: Request) -> tuple[Figure, list[Axes]]:
    """Draw the peak of each presentation over that of the first."""
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
            # Curves that lie on one another are all seen: the first ones are drawn larger.
            size = 3.0 + 2.0 * (len(curves) - 1 - number) * (len(curves) <= FEW)
            label = f"{curve.name}: last / first {share[-1]:.3f}{curve.doubts}"
            panel.plot(
                rows[column], share, marker="o", markersize=size, **curve.look,
                label=wrapped(label, LEGEND_WIDTH),
            )  # fmt: skip
        panel.set_ylim(0, 1.1 * most)
        panel.xaxis.set_major_locator(MaxNLocator(integer=True))
        panel.set_xlabel("presentation")
        panel.set_ylabel("peak / peak of the first")
    return figure, [panel]


# By kind: the figures that are drawn here.
FIGURES = {
    "position": _plot_position,
    "ends": _plot_ends,
    "contrast": _plot_contrast,
    "habituation": _plot_habituation,
}
