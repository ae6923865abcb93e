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
    INK,
    LEGEND_WIDTH,
    MOST_HEIGHT,
    PAGE,
    SHADES,
    TITLE_WIDTH,
    begin_at_zero,
    described,
    edges_of,
    looks_of,
    styled_figure,
    with_doubts,
    wrapped,
)
from oppload_cli.reference import BOTH_ENDS_OVER_ONE

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from oppload_cli.results.reading import Tuning

    Series = NDArray[np.float64]

FEW = 4  # detectors that have room in one column
_NARROW = 28  # characters in a line above one of two panels
_HALF = 0.5
_MOST_RATIO = 1000


class Request(NamedTuple):
    """Tables to draw.

    Attributes
    ----------
    tunings : sequence of Tuning
        At least one.
    models : sequence of str
        The detectors to draw; none for all.
    names : sequence of str
        A name for each table.
    title : str
        Of the figure.
    published : bool
        Whether published neurons are drawn too.
    """

    tunings: Sequence[Tuning]
    models: Sequence[str]
    names: Sequence[str]
    title: str
    published: bool

    def curves(self) -> Iterator[tuple[Tuning, str, str, dict[str, Any]]]:
        """Yield table, detector, name of the curve and its look, for each curve."""
        shown = [
            (tuning, model, f"{table}: " * (len(self.tunings) > 1) + detector_named(model).label)
            for tuning, table in zip(self.tunings, self.names, strict=True)
            for model in self.models or tuning.models
            if len(tuning.of(model))
        ]
        looks = looks_of([model for _, model, _ in shown])
        for curve, look in zip(shown, looks, strict=True):
            yield *curve, look


def column_of(tuning: Tuning, ending: str, wanted: str, *, of: int = 1) -> str:
    """Return the swept column with an ending.

    Parameters
    ----------
    tuning : Tuning
        The table.
    ending : str
        Of the column's name.
    wanted : str
        The column's meaning, and the command that makes such a table, for the message.
    of : int
        How many columns are swept.

    Raises
    ------
    ResultError
        If there is none, or if more is swept.
    """
    found = [name for name in tuning.parameters if name.endswith(ending)]
    if len(found) != 1 or len(tuning.parameters) != of:
        swept = " and ".join(tuning.parameters)
        raise ResultError(f"{tuning.path}: sweeps '{swept}', not {wanted}")
    return found[0]


def _one(request: Request, thing: str) -> tuple[Tuning, list[str]]:
    """Return the only table and the detectors to draw of it."""
    if len(request.tunings) > 1:
        raise ResultError(
            f"{request.tunings[1].path}: {thing} shows one table; plot them separately"
        )
    tuning = request.tunings[0]
    models = [name for name in tuning.models if name in (request.models or tuning.models)]
    if not models:
        raise ResultError(
            f"{tuning.path}: column 'model' never holds '{request.models[0]}'; leave it out"
        )
    return tuning, models


@contextmanager
def _panels(count: int, shape: float, above: float) -> Iterator[tuple[Figure, list[Axes]]]:
    """Open a figure with a panel for each of some detectors, whose titles the caller writes.

    `shape` is the height of a panel over its width, `above` the height of the legend in inches.
    """
    columns = min(count, 2 if count <= FEW else 4)
    rows = -(-count // columns)
    width = COLUMN if count <= FEW else PAGE
    with styled_figure(width, MOST_HEIGHT) as figure:
        grid = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True).ravel()
        for free in grid[count:]:
            free.set_visible(False)
        axes = list(grid[:count])
        yield figure, axes
        for panel in axes[-columns:]:  # also above an empty place
            panel.tick_params(labelbottom=True)
            panel.set_xlabel(axes[-1].get_xlabel())
        lines = max(panel.get_title("left").count("\n") for panel in axes)
        height = above + rows * (0.4 + 0.11 * lines + shape * (width - 0.5) / columns)
        figure.set_figheight(min(MOST_HEIGHT, height))


@contextmanager
def _single(request: Request, count: int) -> Iterator[tuple[Figure, Axes]]:
    """Open a figure with one panel for some curves; their legend is drawn at the end."""
    few = count <= FEW
    lines = sum(
        with_doubts("", tuning, model).count("\n") for tuning, model, *_ in request.curves()
    )
    height = 2.2 + 0.14 * (count + lines) / (1 if few else 2)
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
    tuning, models = _one(request, "a map of positions")
    wanted = "a position; run 'oppload tune --figure position'"
    right, up = (column_of(tuning, end, wanted, of=2) for end in (".right", ".up"))
    across = _NARROW if len(models) > 1 else TITLE_WIDTH
    with _panels(len(models), 0.85, 0.25) as (figure, axes):
        for panel, name in zip(axes, models, strict=True):
            cells = tuning.of(name).pivot_table(index=up, columns=right, values="peak")
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
            panel.set_xlabel(described(right))
            panel.set_ylabel(described(up))
            label = with_doubts(detector_named(name).label, tuning, name)
            panel.set_title(wrapped(f"{label}\n{_half(x, y, share)}", across), fontsize=7)
            panel.label_outer()
        if request.title:
            figure.suptitle(wrapped(request.title, TITLE_WIDTH), fontsize=8, x=0.02, ha="left")
        bar = figure.colorbar(image, ax=axes, shrink=0.7, pad=0.02)
        bar.set_label("peak / largest peak")
        bar.outline.set_linewidth(0.5)
    return figure, axes


def _half_distance(x: Series, y: Series, share: NDArray[np.float64]) -> float | None:
    """Return the mean distance from its peak at which a map has fallen to half.

    Along each of the directions right, up, left and down the first crossing of half is taken,
    between two places linearly.

    Parameters
    ----------
    x, y : ndarray
        Positions of the columns and rows.
    share : ndarray, shape (len(y), len(x))
        The map over its largest value.

    Returns
    -------
    float or None
        None if it does not fall to half in some direction, inside the map.
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
    tuning, models = _one(request, "one end and both")
    wanted = "the sides and the axis of a bar; run 'oppload tune --figure bar-ends'"
    sides, axis = (column_of(tuning, end, wanted, of=2) for end in (".sides", "axis_deg"))
    missing = {"both", "forward"}.difference(tuning.rows[sides])
    if missing:
        raise ResultError(f"{tuning.path}: column '{sides}' never holds '{min(missing)}'")
    low, high = BOTH_ENDS_OVER_ONE
    note = f"\nboth / one in LPLC2 neurons: {low:.1f} to {high:.1f}" * request.published
    across = _NARROW if len(models) > 1 else TITLE_WIDTH
    with _panels(len(models), 0.6, 0.75 + 0.12 * request.published) as (figure, axes):
        for panel, name in zip(axes, models, strict=True):
            rows = tuning.of(name)
            both, one = (
                dict(zip(some[axis].astype(float), some["peak"].astype(float), strict=True))
                for some in (rows[rows[sides] == side] for side in ("both", "forward"))
            )
            _draw_ends(panel, both, one, detector_named(name).colour)
            largest = max(*both.values(), *one.values())
            detector = detector_named(name)
            label = f"{detector.label}, peak {largest:.2g}\n({detector.unit})\n"
            label += f"both / one {_range(_both_over_one(both, one))}"
            panel.set_title(wrapped(with_doubts(label, tuning, name), across), fontsize=7)
            panel.set_xlabel(described(axis))
            panel.set_ylabel("peak / largest peak")
            panel.label_outer()
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
    axes.plot(list(both), [each / largest for each in both.values()], **look, label="both ends")
    look |= {"linestyle": "--", "markerfacecolor": "white"}
    label = "the end in the direction of the axis"
    axes.plot(list(one), [each / largest for each in one.values()], **look, label=label)
    total = {axis: peak + one[_across(axis)] for axis, peak in one.items() if _across(axis) in one}
    axes.plot(
        list(total), [each / largest for each in total.values()],
        ":", color=INK, lw=0.9, label="sum of the two single ends",
    )  # fmt: skip
    axes.set_xticks(range(0, 361, 90))


def _both_over_one(both: Mapping[float, float], one: Mapping[float, float]) -> list[float]:
    """Return the peak for both ends over that for the better single end, for each axis.

    Parameters
    ----------
    both, one : mapping of float to float
        Peaks by axis in degrees; of one end, by the direction in which it grows.

    Returns
    -------
    list of float
        Infinite where only both ends give a response; axes without any response are left out.
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
    points = []
    for tuning, model, name, look in request.curves():
        luminance = tuning.of(model)[column_of(tuning, ".luminance", advice)].to_numpy(float)
        ground = _background(tuning)
        points.append((100 * (luminance - ground) / ground, tuning, model, name, look))
    with _single(request, len(points)) as (figure, panel):
        for contrast, tuning, model, name, look in points:
            peaks = tuning.of(model)["peak"].to_numpy(float)
            largest = float(peaks.max())
            label = f"{name}, largest peak {largest:.3g} ({detector_named(model).unit})"
            x, y = contrast, peaks / (largest or 1.0)
            if 0 not in x:  # no line over what was not measured
                x, y = np.append(x, 0), np.append(y, np.nan)
            order = np.argsort(x)
            panel.plot(
                x[order], y[order], marker="o", markersize=3, **look,
                label=wrapped(with_doubts(label, tuning, model), LEGEND_WIDTH),
            )  # fmt: skip
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
    curves = [(column_of(each[0], "presentation", advice), *each) for each in request.curves()]
    with _single(request, len(curves)) as (figure, panel):
        most = 1.0
        for number, (column, tuning, model, name, look) in enumerate(curves):
            rows = tuning.of(model).sort_values(column)
            peaks = rows["peak"].to_numpy(float)
            if not peaks[0] > 0:
                panel.plot([], [], **look, label=f"{name}: no response to the first")
                continue
            share = peaks / peaks[0]
            # Curves that lie on one another are all seen: the first ones are drawn larger.
            size = 3.0 + 2.0 * (len(curves) - 1 - number) * (len(curves) <= FEW)
            most = max(most, float(share.max()))
            label = with_doubts(f"{name}: last / first {share[-1]:.3f}", tuning, model)
            label = wrapped(label, LEGEND_WIDTH)
            panel.plot(rows[column], share, marker="o", markersize=size, **look, label=label)
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
