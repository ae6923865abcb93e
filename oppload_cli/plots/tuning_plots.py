"""Plots of the tables of ``oppload tune``: polar plots, lines, heat maps, classic figures."""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import replace
from itertools import cycle, product
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from matplotlib.colors import LogNorm, Normalize

from oppload_cli.errors import ParameterError, ResultError
from oppload_cli.models.registry import detector_named
from oppload_cli.plots import style
from oppload_cli.plots.classic import FIGURES
from oppload_cli.plots.naming import indicator_of, labels_of
from oppload_cli.plots.peak_times import contact_lines, fit_of, plot_contact
from oppload_cli.plots.polar import direction_tuning, direction_tunings, plot_polar
from oppload_cli.plots.tuning_curves import (
    Request,
    TuningCurve,
    averaged,
    described,
    first_stimulus,
)
from oppload_cli.results.cells import check_numbers
from oppload_cli.results.tuning import Tuning
from oppload_cli.stimulus.catalogue import in_toml
from oppload_cli.video.frames import AUTO

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from matplotlib.axes import Axes
    from matplotlib.cm import ScalarMappable
    from matplotlib.figure import Figure


_NARROW = 7  # columns of a heat map with numbers that fit into a journal's column
_IN_A_ROW = 4  # small panels


def plot_tuning(
    tunings: Tuning | Sequence[Tuning],
    kind: str | None = None,
    *,
    models: Sequence[str] = (),
    scale: str = "peak",
    lplc2: str = "auto",
    published: bool = True,
    title: str | None = None,
    labels: Sequence[str] = (),
) -> tuple[Figure, list[Axes]]:
    """Draw tuning tables.

    Parameters
    ----------
    tunings : Tuning or sequence of Tuning
        At least one.
    kind : str, optional
        ``polar``, ``line`` or ``heat``; or a classic figure: ``contact``, ``position``, ``ends``,
        ``contrast`` or ``habituation``. By default the classic figure that the table was made for,
        or the kind that suits the swept parameters.
    models : sequence of str
        The detectors to draw; empty for all.
    scale : str
        ``peak`` or ``raw`` for ``polar`` and ``line``; other kinds are always over a peak.
    lplc2 : str
        The bar whose LPLC2 tuning a polar plot shows: ``10`` or ``60`` degrees wide, ``none``, or
        ``auto`` for the bar of the table.
    published : bool
        Whether ``contact`` and ``ends`` show published neurons.
    title : str, optional
        Title of the figure; by default the stimulus's name.
    labels : sequence of str
        Names of the tables; by default what differs between their names.

    Returns
    -------
    matplotlib.figure.Figure, list of Axes
        The figure, not saved yet, and its panel, or a panel for each detector.

    Raises
    ------
    ParameterError
        If there is no such kind or scale.
    ResultError
        If the tables do not suit the kind.

    Examples
    --------
    >>> import pandas, pathlib, oppload_cli as oppload
    >>> rows = [("disk", speed, "opplod", speed / 80) for speed in (20, 40, 80)]
    >>> table = pandas.DataFrame(rows, columns=["stimulus", "disk.speed_deg_s", "model", "peak"])
    >>> tuning = oppload.Tuning(pathlib.Path("disk"), table, ("disk.speed_deg_s",))
    >>> figure, (panel,) = oppload.plot_tuning(tuning)
    >>> panel.get_xlabel()
    'speed (deg/s)'
    """
    tunings, models = style.as_list(tunings, Tuning), style.as_names(models)
    names = labels_of(tunings, labels)
    style.check_title(title)
    if str(scale) not in {"peak", "raw"}:
        raise ParameterError(
            f"a tuning plot has the scale peak or raw, not '{scale}'; choose one of them"
        )
    kind = kind or kind_of(tunings[0])
    if kind not in KINDS:
        raise ParameterError(f"no kind '{kind}' of a tuning plot; choose {', '.join(KINDS)}")
    for tuning in tunings:
        if len(tuning.rows[list(tuning.parameters)].drop_duplicates()) < 2:
            raise ResultError(
                f"{tuning.path}: holds one condition, so that there is nothing to draw; sweep over "
                "more values"
            )
    title = _title(tunings, kind) if title is None else title
    shown = [_shown(tuning, kind) for tuning in tunings]
    request = Request(shown, models, names, title, published, scale == "raw", lplc2)
    figure, axes = _PLOTS[kind](request)
    seeds = [_seeds_text(*pair, kind) for pair in zip(tunings, shown, strict=True)]
    _write_below(figure, _settings_lines(tunings, names, title, seeds))
    return figure, axes


def kind_of(tuning: Tuning) -> str:
    """Return the kind of the classic figure of a table, or the kind that suits its parameters."""
    figure_kind = tuning.sidecar.get("figure", {}).get("kind")
    reduced = averaged(_reduced(tuning))
    single_row = len(reduced.parameters) == 1 < len(tuning.parameters)
    if figure_kind in KINDS and not (single_row and figure_kind in {"heat", "position"}):
        return str(figure_kind)
    return "heat" if len(reduced.parameters) == 2 else "polar" if reduced.direction else "line"


def _reduced(tuning: Tuning) -> Tuning:
    """Return a table without those parameters that have the same value in all rows."""
    varied = tuple(name for name in tuning.parameters if tuning.rows[name].nunique() > 1)
    return replace(tuning, parameters=varied) if varied else tuning


def _shown(tuning: Tuning, kind: str) -> Tuning:
    """Return a table as a kind of plot takes it.

    Some leave out parameters of a single value. Seeds are averaged, except by a heat map over them.
    """
    crowded = kind == "heat" and len(tuning.parameters) > 2
    shown = _reduced(tuning) if crowded or kind in {"polar", "line"} else tuning
    return shown if kind == "heat" and len(shown.parameters) == 2 else averaged(shown)


def lines_of(
    tunings: Sequence[Tuning],
    kind: str | None = None,
    *,
    models: Sequence[str] = (),
    lplc2: str = "auto",
    labels: Sequence[str] = (),
) -> list[str]:
    """Return the numbers of a plot in words: a line of text for each curve.

    The numbers are the directional selectivity of ``polar`` and the fits of ``contact``; other
    kinds have no lines. The parameters are those of :func:`plot_tuning`.
    """
    kind = kind or kind_of(tunings[0])
    shown = [_shown(tuning, kind) for tuning in tunings]
    request = Request(shown, models, labels_of(tunings, labels), lplc2=lplc2)
    if kind == "polar":
        return [curve.line() for curve in direction_tunings(request)]
    return contact_lines(request) if kind == "contact" else []


def summary_of(tuning: Tuning) -> dict[str, dict[str, Any]]:
    """Return the numbers of each curve of a table's plot of the default kind, by detector.

    All kinds have the largest peak, and the smallest peak over it. ``polar`` adds the preferred
    direction in degrees and both selectivity indices. ``contact`` adds the slope and the delay of
    the line, the angular threshold in degrees, and their confidence intervals of 95 %. A number
    that is not known is None.

    Raises
    ------
    ResultError
        If the table lacks what its kind of plot needs.
    """
    kind = kind_of(tuning)
    summary: dict[str, dict[str, Any]] = {}
    for curve in Request([_shown(tuning, kind)], (), [tuning.name]).curves():
        name, largest = curve.detector.name, curve.largest
        least = float(curve.peaks.min()) / largest if largest > 0 else None
        summary[name] = {"largest_peak": largest, "least_over_largest": least}
        if kind == "contact" and (fit := fit_of(curve)):
            summary[name] |= {
                "slope": fit.slope,
                "slope_error": fit.slope_error,
                "threshold_deg": None if fit.falls else fit.angle_deg,
                "threshold_limits_deg": None if fit.falls else list(fit.angle_limits_deg),
                "delay_s": fit.delay_s,
                "delay_error_s": fit.delay_error_s,
            }
        if kind == "polar":
            numbers = direction_tuning(curve).numbers
            summary[name] |= {
                "preferred_deg": numbers.preferred_deg if numbers.peak > 0 else None,
                "direction_selectivity_index": numbers.direction_index,
                "axis_selectivity_index": numbers.axis_index,
            }
    return summary


def _title(tunings: Sequence[Tuning], kind: str) -> str:
    """Return the name of the stimulus of a single table, and the indicator of all tables.

    A classic figure has a title of its own, which suits its own kind of plot only.
    """
    first = tunings[0]
    figure = first.sidecar.get("figure", {}) if kind == kind_of(first) else {}
    title = str(figure.get("title", first.name)) if len(tunings) == 1 else ""
    indicators = {indicator_of(tuning.sidecar) for tuning in tunings}
    through = f"through an {indicators.pop()}" if len(indicators) == 1 and all(indicators) else ""
    return ", ".join(filter(None, (title, through)))


def _seeds_text(tuning: Tuning, shown: Tuning, kind: str) -> str:
    """Return in words over how many seeds a figure averages; empty if it does not average."""
    if shown.parameters == tuning.parameters or "seed" not in _reduced(tuning).parameters:
        return ""
    measures = "mean and standard deviation" if kind in {"line", "polar"} else "mean"
    return f"{measures} of {tuning.rows['seed'].nunique()} seeds"


def _settings_lines(
    tunings: Sequence[Tuning], names: Sequence[str], title: str, seeds: Sequence[str]
) -> list[str]:
    """Return lines with the working height, all changes and seeds: one if all tables agree.

    An indicator that neither the title nor the name of its table states, because they are the
    user's, is stated too.
    """
    lines = []
    for tuning, name, seeds_text in zip(tunings, names, seeds, strict=True):
        indicator = indicator_of(tuning.sidecar)
        unstated = "" if indicator in f"{title}, {name}" else indicator
        lines.append("; ".join(filter(None, (_settings_of(tuning), unstated, seeds_text))))
    if len(set(lines)) == 1:
        return [lines[0]] if lines[0] else []
    return [f"{name}: {line}" for name, line in zip(names, lines, strict=True) if line]


def _settings_of(tuning: Tuning) -> str:
    sidecar = tuning.sidecar
    if "models" not in sidecar:
        return ""
    stated = dict(sidecar.get("changed", {}))
    changes = sidecar.get("stimulus", {}).get("changes")
    for key, value in changes.items() if isinstance(changes, dict) else ():
        stated[key] = value if isinstance(value, str) else in_toml(value)
    reduced = _reduced(tuning)
    for name in tuning.parameters:
        if name not in reduced.parameters:
            stated[name] = _number(tuning.rows[name].iloc[0])
    texts = [_height_of(tuning), *(f"{key}={value}" for key, value in stated.items())]
    return "; ".join(filter(None, texts))


def _height_of(tuning: Tuning) -> str:
    """Return the working height, of each detector if they differ; empty if it is not known."""
    height = tuning.sidecar.get("height")
    if height == AUTO:
        kinds = [detector_named(name) for name in tuning.models]
        if len({kind.height for kind in kinds}) > 1:
            return ", ".join(f"{kind.label} {kind.height} px" for kind in kinds)
        height = kinds[0].height
    elif not isinstance(height, int):  # the native one
        height = first_stimulus(tuning).get("display", {}).get("height")
    return f"{height} px" if isinstance(height, int) else ""


def _write_below(figure: Figure, lines: Sequence[str]) -> None:
    """Write lines in small grey letters at the foot of a figure, and make it higher by them."""
    letters = int(figure.get_figwidth() * 19)  # of the smallest size
    text = "\n".join(style.wrapped(line, letters) for line in lines)
    if not text:
        return
    more = 0.1 * (text.count("\n") + 1)
    height = figure.get_figheight() + more
    figure.set_figheight(height)
    below = more
    if label := figure.get_supxlabel():  # the layout would write it over the foot
        figure.supxlabel(label, y=(more + 0.04) / height, fontsize=7.5)
        below += 0.19
    engine: Any = figure.get_layout_engine()
    engine.set(rect=(0, below / height, 1, 1 - below / height))
    figure.text(
        0.99, 0.02 / height, text, ha="right", va="bottom", fontsize=style.LEAST_SIZE,
        color=style.GREY,
    )  # fmt: skip


def _plot_line(request: Request) -> tuple[Figure, list[Axes]]:
    """Draw the peak over one swept parameter; raw peaks have a panel for each detector."""
    tunings, raw, title = request.tunings, request.raw, request.title
    parameter = _common_parameter(tunings)
    places = _places_of_texts(tunings, parameter)
    curves = request.curves()
    names = list(dict.fromkeys(curve.detector.name for curve in curves))
    if len(curves) > 6 or (raw and len(names) > style.FEW):
        return _plot_small_lines(curves, parameter, places, title, raw=raw)
    groups = [request._replace(models=[name]).curves() for name in names] if raw else [curves]
    lines = sum(1 + curve.label.count("\n") for curve in curves)
    many = not raw and len(names) > style.FEW
    height = 0.3 + len(groups) * 1.9 + lines * (0.09 if many else 0.13)
    with style.styled_figure(style.PAGE if many else style.COLUMN, height) as figure:
        axes = style.panel_grid(figure, len(groups), 1, sharex=True)
        for panel, group in zip(axes, groups, strict=True):
            # Grey curves share their colour, so that only dashes and markers tell them apart.
            grey = cycle(product(("full", "none"), style.DASHES))
            for curve in group:
                look = dict(curve.look)
                if curve.doubts:
                    look["fillstyle"], look["linestyle"] = next(grey)
                _draw_line(panel, curve, parameter, places, look, raw=raw)
            unit = style.plain(group[0].detector.unit)
            panel.set_ylabel(f"peak response ({unit})" if raw else "peak / largest peak")
            if not many:
                style.legend_over(panel)
        axes[-1].set_xlabel(described(parameter))
        if many:
            style.legend_over_figure(figure, axes[0], title, 2)
        else:
            labels = axes[0].get_legend_handles_labels()[1]
            above = sum(label.count("\n") + 1 for label in labels)
            axes[0].set_title(style.wrapped(title, style.TITLE_WIDTH), pad=6 + 10 * above)
    return figure, axes


def _draw_line(
    panel: Axes,
    curve: TuningCurve,
    parameter: str,
    places: Mapping[str, int],
    look: dict[str, Any],
    *,
    raw: bool = False,
) -> None:
    """Draw a curve divided by its largest peak, or raw; thin and grey if it means little.

    Texts have `places` along the axis, and no line between their points.
    """
    look = look | {"markersize": 3}
    if curve.doubts:
        look |= style.DOUBTFUL
    column = curve.rows[parameter]
    if places:
        look["linestyle"] = "none"
        column = column.astype(str).map(places)
        panel.set_xticks(list(places.values()), list(places))
        panel.set_xlim(-0.5, len(places) - 0.5)
    elif parameter == "seed":
        panel.locator_params(axis="x", integer=True)
    values = column.to_numpy(float)
    order = np.argsort(values, kind="stable")  # the values of a sweep may be in any order
    peaks = curve.peaks[order] / (1.0 if raw else curve.largest or 1.0)
    panel.plot(values[order], peaks, **look, label=curve.label)
    if curve.deviations is not None:
        bars = curve.deviations[order] / (1.0 if raw else curve.largest or 1.0)
        style.error_bars(panel, values[order], peaks, bars, look["color"])
    style.begin_at_zero(panel)
    if raw:
        style.number_in_full(panel)


def _plot_small_lines(
    curves: Sequence[TuningCurve],
    parameter: str,
    places: Mapping[str, int],
    title: str,
    *,
    raw: bool,
) -> tuple[Figure, list[Axes]]:
    """Draw a small panel for each curve, divided by its largest peak, or raw."""
    with _small_panels(len(curves), 1.5, title, one_scale=not raw) as (figure, axes):
        for panel, curve in zip(axes, curves, strict=True):
            look = {"color": curve.detector.colour, "marker": "o"}
            _draw_line(panel, curve, parameter, places, look, raw=raw)
            _name_small(panel, curve, curve.largest)
        figure.supxlabel(described(parameter), fontsize=7.5)
        figure.supylabel("peak response" if raw else "peak / largest peak", fontsize=7.5)
    return figure, axes


def _name_small(panel: Axes, curve: TuningCurve, largest: float) -> None:
    name = f"{curve.name}\npeak {style.short_number(largest)} ({curve.detector.unit}){curve.doubts}"
    panel.set_title(style.wrapped(name, 34), fontsize=6, pad=2)
    panel.tick_params(labelsize=6)


@contextmanager
def _small_panels(
    count: int, height: float, title: str, *, one_scale: bool = True
) -> Iterator[tuple[Figure, list[Axes]]]:
    """Make small panels in rows of four, each `height` inches high.

    They share the horizontal axis and, with `one_scale`, the vertical one.
    """
    rows = -(-count // _IN_A_ROW)
    with style.styled_figure(style.PAGE, 0.5 + height * rows) as figure:
        yield figure, style.panel_grid(figure, count, _IN_A_ROW, sharex=True, sharey=one_scale)
        style.write_title(figure, title, 2 * style.TITLE_WIDTH)


def _common_parameter(tunings: Sequence[Tuning]) -> str:
    """Return the one swept parameter; raise ResultError if the tables suit no common line plot."""
    first = tunings[0]
    if len(first.parameters) > 1:
        columns = f"{', '.join(first.parameters[:-1])} and {first.parameters[-1]}"
        two = len(first.parameters) == 2
        advice = "draw kind 'heat'" if two else "a plot shows two at most"
        raise ResultError(f"{first.path}: columns {columns} are swept; {advice}")
    parameter = first.parameters[0]
    for tuning in tunings:
        if tuning.parameters != first.parameters:
            raise ResultError(
                f"{tuning.path}: has no column '{parameter}' as {first.path} has; "
                "plot them separately"
            )
    return parameter


def _places_of_texts(tunings: Sequence[Tuning], parameter: str) -> dict[str, int]:
    """Return the places of texts, such as ``forward``, along an axis; none for numbers."""
    values = pd.concat([tuning.rows[parameter].astype(str) for tuning in tunings])
    if pd.to_numeric(values, errors="coerce").isna().all():
        return {text: place for place, text in enumerate(values.unique())}
    for tuning in tunings:
        check_numbers(tuning.path, tuning.rows, parameter)
    return {}


def _plot_heat(request: Request) -> tuple[Figure, list[Axes]]:
    """Draw the peak over two swept parameters; a combination without a row is blank."""
    curves = request.of_one_table("a heat map")
    tuning = curves[0].tuning
    if len(tuning.parameters) != 2:
        raise ResultError(
            f"{tuning.path}: sweeps {' and '.join(tuning.parameters)}; a heat map needs two swept "
            "parameters"
        )
    if len(curves) > style.FEW:
        return _plot_small_heats(curves, request.title)
    columns, rows = (tuning.rows[name].nunique() for name in tuning.parameters)
    width = style.COLUMN if columns <= _NARROW else style.PAGE
    height = 0.2 + len(curves) * (0.75 + min(2.4, max(0.9, 0.28 * rows)))
    with style.styled_figure(width, height) as figure:
        axes = style.panel_grid(figure, len(curves), 1)
        style.write_title(figure, request.title)
        shares = [curve.over_largest(*tuning.parameters)[0] for curve in curves]
        norm = style.norm_of(np.concatenate([share.to_numpy().ravel() for share in shares]))
        for panel, curve in zip(axes, curves, strict=True):
            image = _draw_heat(panel, curve, norm)
            cut = np.nanmin(np.asarray(image.get_array())) < (image.norm.vmin or 0)
            extend = "min" if cut else "neither"
            style.colour_bar(figure, image, panel, "peak / largest peak", pad=0.02, extend=extend)
    return figure, axes


def _plot_small_heats(curves: Sequence[TuningCurve], title: str) -> tuple[Figure, list[Axes]]:
    """Draw a small heat map without numbers for each detector, all on one scale."""
    across, up = curves[0].tuning.parameters
    with _small_panels(len(curves), 1.75, title) as (figure, axes):
        norm = LogNorm(10.0**-style.DECADES, 1.0, clip=True)
        for panel, curve in zip(axes, curves, strict=True):
            image = _draw_heat(panel, curve, norm, small=True)
        figure.supxlabel(described(across), fontsize=7.5)
        figure.supylabel(described(up), fontsize=7.5)
        bar = "peak / largest peak"
        style.colour_bar(figure, image, axes, bar, shrink=0.7, pad=0.02, extend="min")
    return figure, axes


def _draw_heat(
    axes: Axes, curve: TuningCurve, norm: Normalize, *, small: bool = False
) -> ScalarMappable:
    across, up = curve.tuning.parameters
    cells, largest = curve.over_largest(across, up)
    share = cells.to_numpy(float)
    image: ScalarMappable
    if {across.rpartition(".")[2], up.rpartition(".")[2]} == {"right", "up"}:  # at true distances
        x, y = cells.columns.to_numpy(float), cells.index.to_numpy(float)
        edges = style.edges_of(x), style.edges_of(y)
        image = axes.pcolormesh(*edges, share, cmap=style.SHADES, norm=norm, rasterized=True)
    else:
        x, y = np.arange(share.shape[1]), np.arange(share.shape[0])
        image = axes.imshow(share, origin="lower", aspect="auto", cmap=style.SHADES, norm=norm)
    names = [_number(value) for value in cells.columns]
    letters = 26 if small else 96 if len(x) > _NARROW else 42  # in a line along the map
    fitting = letters // (1 + max(map(len, names)))  # names that fit beside each other
    every = -(-len(x) // max(1, min(fitting, 6 if small else 24)))
    axes.set_xticks(x[::every], names[::every])
    every = -(-len(y) // (12 if small else 20))
    axes.set_yticks(y[::every], [_number(value) for value in cells.index[::every]])
    if small:
        _name_small(axes, curve, largest)
        return image
    if share.size <= 100 and share.shape[1] <= 16:  # else numbers do not fit
        least = norm.vmin or 0.0
        for (row, column), value in np.ndenumerate(share):
            if np.isfinite(value):
                place = float(x[column]), float(y[row])
                text = f"{value:.2g}" if value >= least else f"<{least:.2g}"
                ink = "black" if norm(value) > 0.55 else "white"
                axes.text(*place, text, ha="center", va="center", color=ink, size=6)
    axes.set_xlabel(described(across))
    axes.set_ylabel(described(up))
    title = f"{curve.name}, largest peak {style.short_number(largest)} ({curve.detector.unit})"
    axes.set_title(style.wrapped(title + curve.doubts, style.TITLE_WIDTH))
    return image


def _number(value: object) -> str:
    return f"{value:g}" if isinstance(value, int | float) else str(value)


_PLOTS = {
    "polar": plot_polar,
    "line": _plot_line,
    "heat": _plot_heat,
    "contact": plot_contact,
    **FIGURES,
}
KINDS = tuple(_PLOTS)
