"""Polar plots of tuning over direction."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.ticker import MaxNLocator
from matplotlib.transforms import ScaledTranslation

from oppload_cli.errors import ResultError
from oppload_cli.models.registry import is_rounding_error, least_response_of
from oppload_cli.plots import style
from oppload_cli.plots.tuning_curves import Request, TuningCurve, first_stimulus
from oppload_cli.reference import BAR_WIDTHS, bar_tuning
from oppload_cli.stimulus.catalogue import entries

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.projections.polar import PolarAxes

    from oppload_cli.results.result_files import Series
    from oppload_cli.results.tuning import Tuning

_NARROW = 30  # characters in a line above a small plot
_SCENE = "scene.rotation_deg"
_POLAR = {"projection": "polar"}


@dataclass(frozen=True)
class _Selectivity:
    """How strongly responses depend on direction (``docs/plots.md``)."""

    peak: float  # the largest response
    preferred_deg: float  # the direction of the peak
    # (peak - R) / (peak + R) with the response R to the opposite direction; None if that direction
    # was not shown, or if no response is above 0.
    direction_index: float | None
    # |sum R exp(2 i theta)| / sum R: 1 for one axis, 0 for none; None if no response is above 0, or
    # if the axes are not spread evenly.
    axis_index: float | None
    least: float  # smallest response over the peak


def selectivity(angles_deg: Series, responses: Series) -> _Selectivity:
    """Measure directional tuning, from n directions and n responses of at least 0."""
    # Of peaks that are equal but for rounding, the first one counts.
    best = int(np.argmax(responses >= (1 - 1e-6) * responses.max()))
    peak, preferred = float(responses[best]), float(angles_deg[best])
    if peak <= 0:
        return _Selectivity(peak, preferred, None, None, 0.0)
    opposite = np.flatnonzero(np.abs((angles_deg - preferred) % 360 - 180) < 1e-6)
    index = None
    if opposite.size:
        null = float(responses[opposite[0]])  # in the null direction
        index = (peak - null) / (peak + null)
    least = float(responses.min()) / peak
    axes = np.unique(np.round(angles_deg % 180, 6))
    gaps = np.diff(np.append(axes, axes[0] + 180))
    axis_index = None
    if len(axes) > 1 and np.ptp(gaps) < 1e-3 and len(angles_deg) % len(axes) == 0:
        vector = np.sum(responses * np.exp(2j * np.deg2rad(angles_deg)))
        axis_index = float(abs(vector) / responses.sum())
    return _Selectivity(peak, preferred, index, axis_index, least)


def full_circle(angles_deg: Series, responses: Series) -> tuple[Series, Series]:
    """Complete the tuning to a stimulus that looks the same after half a turn.

    The responses to the directions of a half circle are repeated for the opposite directions. Each
    returned direction occurs once, in rising order from 0 to 360.
    """
    angles = np.concatenate([angles_deg, angles_deg + 180])
    return _in_order(angles, np.concatenate([responses, responses]))


def _in_order(angles_deg: Series, responses: Series) -> tuple[Series, Series]:
    """Return each direction once, in rising order from 0; 360 degrees count as 0."""
    _, first = np.unique(np.round(angles_deg, 6) % 360, return_index=True)
    return angles_deg[first] % 360, responses[first]


@dataclass(frozen=True)
class DirectionTuning:
    """One closed or open curve of a polar plot."""

    name: str  # in the legend
    angles_deg: Series  # rising
    responses: Series
    unit: str  # of the responses
    look: dict[str, Any]  # line properties of matplotlib
    symmetric: bool = False  # whether half a turn gives the same stimulus
    angle: str = "direction of motion"  # the meaning of the angle
    doubts: str = ""  # why the curve means little; a line break before each reason
    deviations: Series | None = None  # of the responses over the seeds; None if they are no means

    @property
    def numbers(self) -> _Selectivity:
        """Peak and selectivity; a symmetric stimulus has no index of direction."""
        numbers = selectivity(self.angles_deg, self.responses)
        return replace(numbers, direction_index=None) if self.symmetric else numbers

    @property
    def about(self) -> str:
        """The peak and its unit in words."""
        peak = self.numbers.peak
        return f"peak {style.short_number(peak)} ({self.unit})" if peak > 0 else "no response"

    def line(self) -> str:
        """Return the numbers in one line, for standard output."""
        numbers = self.numbers
        if numbers.peak <= 0:
            return f"{self.name}: no response"
        missing = "unknown (opposite not shown)"
        if self.symmetric:
            missing = "does not apply (opposite directions are the same)"
        direction, axis = (
            reason if index is None else f"{index:z.3f}"  # z: no "-0.000"
            for index, reason in (
                (numbers.direction_index, missing),
                (numbers.axis_index, "unknown (axes not spread evenly)"),
            )
        )
        return (
            f"{self.name}: peak {numbers.peak:.4g} ({self.unit}) at {numbers.preferred_deg:g} deg, "
            f"direction selectivity index {direction}, axis selectivity index {axis}, "
            f"least response {numbers.least:.3g} of the peak"
        )


def direction_tunings(request: Request) -> list[DirectionTuning]:
    """Return the curves of a polar plot of tuning tables.

    The LPLC2 tuning to the bar ``auto`` is added if the stimulus shows the bar of the catalogue.

    Raises
    ------
    ResultError
        If a table has no direction or more than one parameter, or if no table has a detector.
    """
    curves = [direction_tuning(curve) for curve in request.curves()]
    if request.lplc2 == "auto":
        width = _bar_width(request.tunings)
    else:
        width = int(request.lplc2) if request.lplc2.isdigit() else None
    reference = bar_tuning(width) if width else {}
    if reference:
        look = {"color": style.LPLC2, "marker": "s", "markersize": 2.5, "lw": 0.9, "linestyle": ":"}
        curves.append(symmetric_tuning(f"LPLC2, {width} deg bar", reference, "of the loom", look))
    return curves


def symmetric_tuning(
    name: str, peaks: Mapping[Any, float], unit: str, look: dict[str, Any]
) -> DirectionTuning:
    """Return the curve of peaks by axis in degrees, as :class:`DirectionTuning` takes them."""
    angles, values = np.array(list(peaks), float), np.array(list(peaks.values()))
    return DirectionTuning(name, *full_circle(angles, values), unit, look, symmetric=True)


def direction_tuning(curve: TuningCurve) -> DirectionTuning:
    """Return the curve of one detector; raises ResultError as :func:`direction_tunings` does."""
    tuning, detector = curve.tuning, curve.detector
    direction = tuning.direction
    if direction is None:
        kind = "heat" if len(tuning.parameters) == 2 else "line"
        raise ResultError(
            f"{tuning.path}: has no column of a direction, such as bar.axis_deg; draw kind '{kind}'"
        )
    if len(tuning.parameters) > 1:
        other = next(name for name in tuning.parameters if name != direction)
        two = len(tuning.parameters) == 2
        advice = "draw kind 'heat'" if two else "a plot shows two swept columns at most"
        raise ResultError(f"{tuning.path}: column '{other}' is swept too; {advice}")
    stated = curve.rows[direction].to_numpy(float)
    values, deviations = curve.peaks, curve.deviations
    if tuning.sidecar and is_rounding_error(curve.largest, least_response_of(detector.name)):
        values, deviations = np.zeros_like(values), None
    completed = full_circle if tuning.symmetric else _in_order
    angles, values = completed(stated, values)
    return DirectionTuning(
        f"{detector.label}, {curve.table}" if curve.table else detector.label,
        angles,
        values,
        detector.unit,
        {**curve.look, "markersize": 2.2},
        tuning.symmetric,
        "rotation of the scene" if direction == _SCENE else "direction of motion",
        curve.doubts,
        None if deviations is None else completed(stated, deviations)[1],
    )


def _bar_width(tunings: Sequence[Tuning]) -> int | None:
    """Return the width of the published study's bar, if all stimuli show this bar and turn it.

    The width comes from the stimulus's name.
    """
    if any(tuning.direction == _SCENE for tuning in tunings):
        return None
    matches = [re.search(r"bar-(?:expand-)?(\d+)$", tuning.name) for tuning in tunings]
    width, *others = {int(match[1]) if match else 0 for match in matches}
    is_published = width in BAR_WIDTHS and not others
    return width if is_published and all(map(_as_published, tunings)) else None


def _as_published(tuning: Tuning) -> bool:
    """Return whether the stimulus looks as in the catalogue, whatever the axis of its bar is."""
    first = first_stimulus(tuning)
    if not first:  # without a sidecar, only the name is known
        return True
    tables = [entry.protocols()[0].as_table() for entry in entries() if entry.name == tuning.name]
    return any(_appearance(first) == _appearance(table) for table in tables)


def _appearance(table: Mapping[str, Any]) -> list[Any]:
    """Return the parts of a protocol that decide its look: not its size, pauses and axis."""
    objects = [{**obj, "axis_deg": 0} for obj in table.get("object", []) if isinstance(obj, dict)]
    background = table.get("display", {}).get("background")
    return [objects, background, table.get("scene"), table.get("effects")]


def plot_polar(request: Request) -> tuple[Figure, list[Axes]]:
    """Draw up to six curves, divided by their peaks, into one plot; of more, each has its own.

    Raw responses have a plot for each curve.
    """
    curves, raw, title = direction_tunings(request), request.raw, request.title
    if len(curves) > 6:
        return _draw_multiples(curves, raw=raw, title=title)
    groups = [[curve] for curve in curves] if raw else [list(curves)]
    columns = 1 if len(groups) <= 2 else 2 if len(groups) <= 4 else 3
    rows = -(-len(groups) // columns)
    width = style.COLUMN if columns == 1 else style.PAGE
    across = style.LEGEND_WIDTH if columns < 3 else _NARROW
    lines = [1 + _label(curve, across, raw=raw).count("\n") for curve in curves]
    most = rows * max(lines) if raw else sum(lines)
    height = 0.1 + 0.25 * bool(title) + rows * (0.9 * width / columns + 0.45) + 0.14 * most
    with style.styled_figure(width, height) as figure:
        axes: list[Any] = style.panel_grid(figure, len(groups), columns, subplot_kw=_POLAR)
        for panel, group in zip(axes, groups, strict=True):
            draw_polar(panel, group, raw=raw, across=across)
        style.write_title(figure, title)
        spread(figure)
    return figure, axes


def _draw_multiples(
    curves: Sequence[DirectionTuning], *, raw: bool, title: str
) -> tuple[Figure, list[Axes]]:
    """Draw a small plot for each curve; the meaning of radius and angle is written once."""
    rows = -(-len(curves) // 4)
    with style.styled_figure(style.PAGE, 0.4 + 2.1 * rows) as figure:
        axes: list[Any] = style.panel_grid(figure, len(curves), 4, subplot_kw=_POLAR)
        for panel, curve in zip(axes, curves, strict=True):
            draw_polar(panel, [curve], raw=raw)
            panel.get_legend().remove()
            panel.set_xlabel("")
            panel.set_thetagrids(range(0, 360, 90), [])
            panel.tick_params(labelsize=style.LEAST_SIZE)
            name = f"{curve.name}\n{curve.about}{curve.doubts}"
            panel.set_title(style.wrapped(name, _NARROW), fontsize=6.8, pad=3)
        style.write_title(figure, title, 2 * style.TITLE_WIDTH)
        radius = "response" if raw else "response / peak"
        figure.supxlabel(
            f"radius: {radius}; angle: {_angle_of(curves)}, to the right: 0°", fontsize=7.5
        )
    return figure, axes


def spread(figure: Figure) -> None:
    """Leave room around polar plots, as matplotlib's layout ignores the labels of angles."""
    engine: Any = figure.get_layout_engine()
    engine.set(h_pad=0.09, w_pad=0.09)


def draw_polar(
    axes: PolarAxes,
    curves: Sequence[DirectionTuning],
    *,
    raw: bool = False,
    across: int = style.LEGEND_WIDTH,
) -> None:
    """Draw curves into one polar plot, divided by their peaks or, if `raw`, in their own unit.

    A curve that means little is thin and grey.
    A line of text below the plot has at most `across` characters.
    """
    top = 0.0
    for curve in curves:
        peak = curve.numbers.peak
        over = 1.0 if raw or peak <= 0 else peak
        angles, values = _closed(curve.angles_deg, curve.responses / over)
        look = dict(curve.look)
        if curve.doubts:
            look |= style.DOUBTFUL | {"color": style.GREY}  # darker than the circles
        axes.plot(np.deg2rad(angles), values, label=_label(curve, across, raw=raw), **look)
        top = max(top, float(np.max(values, initial=0)))
        if curve.deviations is not None:
            bars, heights = curve.deviations / over, curve.responses / over
            style.error_bars(axes, np.deg2rad(curve.angles_deg), heights, bars, look["color"])
            top = max(top, float(np.nanmax(heights + bars, initial=0)))
    axes.set_thetagrids(range(0, 360, 45), [f"{angle}°" for angle in range(0, 360, 45)])
    top = top or 1.0
    ticks = [tick for tick in MaxNLocator(3).tick_values(0, top) if 0 < tick <= top]
    axes.set_ylim(0, 1.08 * (top if raw else max(top, 1.0)))
    axes.set_rticks(ticks if raw else [0.5, 1])
    style.number_in_full(axes)
    axes.set_rlabel_position(_free_direction(axes))
    for number in axes.get_yticklabels():
        number.set_bbox({"facecolor": "white", "edgecolor": "none", "alpha": 0.75, "pad": 0.4})
    axes.grid(color=style.FAINT, lw=0.4)
    axes.spines["polar"].set_color(style.FAINT)
    axes.tick_params(pad=0)
    label = f"response ({style.plain(curves[0].unit)})" if raw else "response / peak"
    narrow = across < style.LEGEND_WIDTH
    between = ";\n" if narrow else "; "
    axes.set_xlabel(f"radius: {label}{between}angle: {_angle_of(curves)}")
    axes.set_anchor("S")  # so that the layout leaves room for the legend below
    # Points, not shares, keep the legend below the label of one or two lines, whatever the size.
    down = (28 + 10 * narrow) / 72
    below = axes.transAxes + ScaledTranslation(0, -down, axes.figure.dpi_scale_trans)
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, 0), bbox_transform=below, borderaxespad=0)


def _label(curve: DirectionTuning, across: int, *, raw: bool) -> str:
    """Return the entry of a curve in a legend, in lines of at most `across` characters."""
    name = curve.name if raw else f"{curve.name}, {curve.about}"
    return style.wrapped(name + curve.doubts, across)


def _angle_of(curves: Sequence[DirectionTuning]) -> str:
    return " or ".join(dict.fromkeys(curve.angle for curve in curves))


def _free_direction(axes: PolarAxes) -> float:
    """Return the direction in degrees in which labels of the radius are farthest from curves."""
    ticks = axes.get_yticks()

    def distance(direction: float) -> float:
        at = np.deg2rad(direction)
        values = [
            np.interp(
                at, np.asarray(line.get_xdata()), np.asarray(line.get_ydata()), period=2 * np.pi
            )
            for line in axes.lines
        ]
        return float(min(abs(tick - value) for tick in ticks for value in values))

    return max((22.5 + 45 * turn for turn in range(8)), key=distance)


def _closed(angles: Series, values: Series) -> tuple[Series, Series]:
    """Join the ends of a curve whose directions are spread over the complete circle."""
    gaps = np.diff(np.append(angles, angles[0] + 360))
    if len(angles) < 3 or gaps[-1] > 1.01 * max(gaps[:-1]):
        return angles, values
    return np.append(angles, angles[0]), np.append(values, values[0])
