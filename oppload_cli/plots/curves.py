"""Figures of responses over time: curves, small panels for more, or a heat map for very many."""

from __future__ import annotations

from collections.abc import Mapping, Sized
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.lines import Line2D
from matplotlib.ticker import NullFormatter

from oppload_cli.errors import ParameterError, ResultError
from oppload_cli.models.registry import detector_named
from oppload_cli.plots import style
from oppload_cli.plots.panels import (
    FLOOR,
    NOT_DOTTED,
    SCALES,
    CurveOptions,
    draw_curves,
    draw_marks,
    log_axis,
    panels_of,
    shared_truth,
)
from oppload_cli.results.result_files import BaseResult
from oppload_cli.results.truths import sizes_in

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.colorbar import Colorbar
    from matplotlib.figure import Figure
    from matplotlib.image import AxesImage

    from oppload_cli.plots.panels import Curve
    from oppload_cli.results.result_files import Series
    from oppload_cli.results.truths import Truth

    Panels = Sequence[Sequence[Curve]]
    Drawn = tuple[Figure, list[Axes]]

_LEGEND_LINE = 0.09  # inches: the height of a line of a legend


def plot_curves(
    results: BaseResult | Sequence[BaseResult],
    *,
    models: Sequence[str] = (),
    scale: str = "threshold",
    align: str | None = None,
    xlim: tuple[float, float] | None = None,
    title: str | None = None,
    labels: Sequence[str] = (),
    marks: Mapping[str, Sequence[float | None]] | None = None,
    threshold: bool = True,
    any_length: bool = False,
    axes: Axes | None = None,
) -> tuple[Figure, list[Axes]]:
    """Draw responses over time.

    Several detectors over one input share a panel, and so do several inputs of one detector.
    Several detectors over several inputs have a panel for each input. More than six curves have
    small panels. More than 24 results are a heat map with a row for each result.

    Parameters
    ----------
    results : Result or sequence of Result
        At least one.
    models : sequence of str
        The detectors to draw; empty for all detectors of each result.
    scale : str
        ``threshold``: divided by the alarm's threshold in each frame, on a logarithmic axis from
        0.01; ``peak``: each curve divided by its peak; ``raw``: in the detector's unit.
    align : str, optional
        ``contact``: time counts from the contact, which `marks` or a ground truth states.
    xlim : tuple of float, optional
        First and last time of the axis, in seconds.
    title : str, optional
        Title of the figure.
    labels : sequence of str
        Names of the results; by default what differs between their names.
    marks : mapping of str to sequence of float or None
        Labelled times in seconds, one for each result, such as ``{"onset": [0.5]}``.
    threshold : bool
        Whether the alarm's threshold is drawn.
    any_length : bool
        Whether results of different lengths may share a panel.
    axes : Axes, optional
        Axes to draw into; only if the curves share one panel. If they are too narrow for the
        legend, it has only the names of the curves.

    Returns
    -------
    matplotlib.figure.Figure, list of Axes
        The figure, not saved yet, and its panels and strips of ground truth from top to bottom.

    Raises
    ------
    ParameterError
        If an option has no such value, or if `axes` are given for several panels.
    ResultError
        If a result lacks a detector, lengths differ, a contact is not known, or a sidecar is
        wrong.

    Examples
    --------
    >>> import oppload_cli as oppload
    >>> result = oppload.run("controls/looming-perspective", rmo=False)
    >>> figure, (panel, truth) = oppload.plot_curves(result, models=["opplod"], align="contact")
    >>> panel.get_ylabel(), truth.get_xlabel()
    ('response / alarm threshold', 'time from contact (s)')
    """
    results = style.as_list(results, BaseResult)
    style.check_title(title)
    if str(scale) not in SCALES:
        raise ParameterError(f"no scale '{scale}'; choose {', '.join(SCALES)}")
    if align is not None and str(align) != "contact":
        raise ParameterError(f"curves cannot be aligned at '{align}'; choose contact")
    if not isinstance(marks, Mapping | None):
        raise ParameterError(
            f"marks must be a dict of times by label, such as {{'onset': [0.5]}}, not {marks!r:.60}"
        )
    for label, times in (marks or {}).items():
        given: object = times  # a caller may give a number, in spite of the type
        count = len(given) if isinstance(given, Sized) else 0
        if count != len(results):
            raise ParameterError(
                f"marks: '{label}' has {count} times; give a list of one, or None, for each result "
                f"({len(results)})"
            )
    options = CurveOptions(
        style.as_names(models), scale, align, xlim, title, style.as_names(labels),
        dict(marks or {}), threshold, any_length,
    )  # fmt: skip
    panels = panels_of(results, options)
    style.check_xlim([curve.time for curves in panels for curve in curves], xlim)
    if axes is not None:
        return _draw_into(axes, panels, options.with_bars(panels))
    if sum(map(len, panels)) <= 6:  # with a line of the legend for each curve
        return _draw_few(panels, options.with_bars(panels))
    if len(results) <= 24:
        small = _small_panels(panels)
        return _draw_multiples(small, options.with_bars(small))
    return _draw_heat(_small_panels(panels), options)


def _draw_into(axes: Axes, panels: Panels, options: CurveOptions) -> Drawn:
    """Draw the only panel into the user's axes, with the legend inside."""
    given: object = axes  # maybe of a wrong type
    if not isinstance(given, Axes):
        raise ParameterError(
            f"axes must be one Axes of matplotlib, not {type(given).__name__}; of an array of Axes "
            "give one"
        )
    _check_lengths(panels, options)
    if len(panels) > 1:
        raise ParameterError(
            f"these results have {len(panels)} panels, which do not fit into one; choose one "
            "detector or one result, or leave out the axes"
        )
    _draw_responses(axes, panels[0], options)
    legend = axes.legend(fontsize="small")
    if legend.get_window_extent().width > axes.get_window_extent().width:
        axes.legend(handles=_names_in_legend(panels), fontsize="small")
    axes.set_xlabel(options.time_label)
    draw_marks([axes], panels[0], options)
    return axes.figure.figure, [axes]


def _draw_few(panels: Panels, options: CurveOptions) -> Drawn:
    """Draw panels with a legend each, and below a panel the ground truth of its input."""
    _check_lengths(panels, options)
    truths = [shared_truth(curves) for curves in panels]
    strips = [truth if truth and sizes_in(truth["frames"]) else None for truth in truths]
    if options.scale == "raw":  # of the panels of a result, the last one has a strip
        last = {curves[-1].number: index for index, curves in enumerate(panels)}
        strips = [strip if i in last.values() else None for i, strip in enumerate(strips)]
    heights: list[float] = []
    for curves, strip in zip(panels, strips, strict=True):
        heights += [1.75 + 0.12 * len(curves), *([] if strip is None else [0.62])]
    with style.styled_figure(style.COLUMN, 1) as figure:
        axes = style.panel_grid(figure, len(heights), 1, height_ratios=heights)
        remaining, lines = iter(axes), 0
        one_time = _of_like_length(panels)
        drawn: list[list[Axes]] = []
        titles = _titles(panels, options)
        for curves, strip, title in zip(panels, strips, titles, strict=True):
            panel = [next(remaining)]
            if drawn and one_time:
                panel[0].sharex(axes[0])
            lines += _draw_panel(panel[0], curves, options, title)
            if strip is not None:
                panel.append(next(remaining))
                panel[1].sharex(panel[0])
                _draw_truth(panel[1], strip, curves[0].zero_s)
                panel[0].tick_params(labelbottom=False)
            drawn.append(panel)
        for panel, curves in zip(drawn, panels, strict=True):
            draw_marks(panel, curves, options)
            style.spread_ticks(panel[-1], style.PANEL_WIDTH)
        axes[-1].set_xlabel(options.time_label)
        figure.set_figheight(min(style.MOST_HEIGHT, 0.2 + sum(heights) + _LEGEND_LINE * lines))
        style.write_title(figure, options.title if len(panels) > 1 else None)
    return figure, axes


def _titles(panels: Panels, options: CurveOptions) -> list[str]:
    """Return the title of each panel: of the figure, of its detector, or of its input.

    If results have the same input, what differs between the results follows the input's name.
    """
    if len(panels) == 1 and options.title:
        return [options.title]
    inputs = {curves[0].number: curves[0].result.title for curves in panels}
    same_input = len(set(inputs.values())) < len(inputs)
    titles = []
    for curves, name in zip(panels, _panel_names(panels), strict=True):
        number = curves[0].number
        if len({curve.number for curve in curves}) > 1:
            titles.append(detector_named(curves[0].detector).label)
        elif options.labels:
            titles.append(options.labels[number])
        else:
            titles.append(inputs[number] + f": {name}" * same_input)
    return titles


def _of_like_length(panels: Panels) -> bool:
    """Return whether one time axis suits all inputs: the shortest one remains visible on it."""
    durations = [float(np.ptp(curve.time)) for curves in panels for curve in curves]
    return max(durations) <= 4 * min(durations)


def _check_lengths(panels: Panels, options: CurveOptions) -> None:
    if options.any_length or options.align:
        return
    for first, *others in panels:
        for other in others:
            rows = [len(curve.result.frames) for curve in (first, other)]
            if rows[0] != rows[1]:
                raise ResultError(
                    f"{other.result.path}: column 'frame' has {rows[1]} rows, that of "
                    f"{first.result.path} {rows[0]}; give results of one length, or "
                    "--any-length (in Python any_length=True)"
                )


def _draw_responses(axes: Axes, curves: Sequence[Curve], options: CurveOptions) -> None:
    """Draw the curves of a panel, with its notes as entries of the legend."""
    scale = options.scale_of(curves)
    for note in draw_curves(axes, curves, options, scale):
        axes.plot([], [], linestyle="none", label=style.wrapped(note, style.LEGEND_WIDTH))
    axes.set_ylabel(_value_label(scale, curves[0]))


def _draw_panel(axes: Axes, curves: Sequence[Curve], options: CurveOptions, title: str) -> int:
    """Draw a panel with its legend above it, and return the number of lines of the legend."""
    _draw_responses(axes, curves, options)
    texts: list[str] = axes.get_legend_handles_labels()[1]
    lines = sum(text.count("\n") + 1 for text in texts)
    axes.set_title(style.wrapped(title, style.TITLE_WIDTH), pad=4 + 9 * lines)
    legend = style.legend_over(axes, labelspacing=0.25, handlelength=1.8)
    legend.set_in_layout(False)  # a long name must not make the panel smaller
    return lines


def _draw_truth(axes: Axes, truth: Truth, zero_s: float) -> None:
    """Draw the angular size of each object over time, on a grey ground while an object looms."""
    frames = truth["frames"]
    time = np.array([frame["time_s"] for frame in frames], float) - zero_s
    looming = np.array([bool(frame["looming"]) for frame in frames])
    sizes = sizes_in(frames)
    for number, (name, size) in enumerate(sizes.items()):
        dash, label = style.DASHES[number % len(style.DASHES)], style.wrapped(name, 16)
        axes.plot(time, np.array(size, float), color=style.INK, lw=1, linestyle=dash, label=label)
    if 1 < len(sizes) <= len(style.DASHES):
        look = {"fontsize": 6, "handlelength": 2.2, "columnspacing": 1}
        style.legend_over(axes, ncols=len(sizes), **look)
    axes.set_ylim(bottom=0)
    axes.fill_between(
        time, 0, 1, where=looming, transform=axes.get_xaxis_transform(), color=style.FAINT,
        alpha=0.25, lw=0, step="mid",
    )  # fmt: skip
    axes.set_ylabel("size (deg)")
    if looming.any():
        axes.set_title("grey: looming", loc="right", fontsize=6, color=style.INK, pad=2)


def _small_panels(panels: Panels) -> list[list[Curve]]:
    """Return a panel for each input, or for each curve if there is one input or one detector.

    The curves have the colours of their detectors.
    """
    inputs = {curve.number for curves in panels for curve in curves}
    if len(inputs) > 1 and len({curve.number for curve in panels[0]}) == 1:
        return [list(curves) for curves in panels]
    curves = [(curve, detector_named(curve.detector)) for curves in panels for curve in curves]
    return [[replace(one, name=kind.label, colour=kind.colour, dash="-")] for one, kind in curves]


def _panel_names(panels: Panels) -> list[str]:
    """Return the name of each panel's input, or of its detector if all panels have one input."""
    one_input = len({curves[0].number for curves in panels}) == 1 < len(panels)
    return [curves[0].name if one_input else curves[0].result_name for curves in panels]


def _draw_multiples(panels: Panels, options: CurveOptions) -> Drawn:
    """Draw small panels, all on one scale."""
    columns = 2 if len(panels) <= 4 else 3
    rows = -(-len(panels) // columns)
    scales = [options.scale_of(curves) for curves in panels]
    scale = scales[0] if len(set(scales)) == 1 else options.scale
    with style.styled_figure(style.PAGE, 0.6 + 1.35 * rows) as figure:
        shared = scale != "raw" and len(set(scales)) == 1
        one_time = _of_like_length(panels)
        axes = style.panel_grid(figure, len(panels), columns, sharex=one_time, sharey=shared)
        several = len({curves[0].number for curves in panels}) > 1
        notes: dict[str, None] = {}
        top = 0.0
        names = _panel_names(panels)
        units = _units(panels, scale)
        for panel, curves, name, own_scale, unit in zip(
            axes, panels, names, scales, units, strict=True
        ):
            own_notes = draw_curves(panel, curves, options, own_scale)
            text = f"{name}: {curves[0].name}" if scale == "raw" and several else name
            if own_scale == scale:
                notes.update(dict.fromkeys(own_notes))
                top = max(top, panel.get_ylim()[1])
            else:
                text += ", divided by its peak: no threshold"
            text = style.wrapped(text + unit, style.TITLE_WIDTH * 5 // 7)
            panel.set_title(text, fontsize=6.8, pad=2)
            panel.tick_params(labelsize=6)
        for panel, curves, own_scale in zip(axes, panels, scales, strict=True):
            if own_scale == "threshold":
                log_axis(panel, top)
            draw_marks([panel], curves, options)
            panel.locator_params(axis="x", nbins=15 // columns)  # the numbers do not touch
            style.spread_ticks(panel, 2 * style.PANEL_WIDTH / columns)
        legend = panels if several else []
        title = options.title or ("" if several else panels[0][0].result.title)
        shown_notes = [note for note in notes if "above the panel" not in note]
        if len(shown_notes) < len(notes):
            shown_notes.append(NOT_DOTTED)
        _legend(figure, legend, shown_notes, style.wrapped(title, 2 * style.TITLE_WIDTH))
        label = "response" * any(units) or _value_label(scale, panels[0][0])
        if rows == 1:  # in two lines, as one line would be longer than the panel is high
            axes[0].set_ylabel(label.replace(" / ", " /\n").replace(" (", "\n("))
        else:
            figure.supylabel(label, fontsize=7.5)
        figure.supxlabel(options.time_label, fontsize=7.5)
    return figure, axes


def _units(panels: Panels, scale: str) -> list[str]:
    """Return the unit of each panel, for its title; empty if all panels have the same unit."""
    units = [detector_named(curves[0].detector).unit for curves in panels]
    several = scale == "raw" and len(set(units)) > 1
    unbroken = [unit.replace(" ", "\xa0") for unit in units]  # in one line of the title
    return [f" ({unit})" * several for unit in unbroken]


def _value_label(scale: str, curve: Curve) -> str:
    unit = detector_named(curve.detector).unit
    return {
        "threshold": "response / alarm threshold",
        "peak": "response / peak",
        "raw": f"response ({style.plain(unit)})",
    }[scale]


def _names_in_legend(panels: Sequence[Sequence[Curve]]) -> list[Line2D]:
    """Return an entry of the legend for each name of a curve, without its peak."""
    curves = {curve.name: curve for panel in panels for curve in panel}
    return [
        Line2D([], [], color=curve.colour, ls=curve.dash, label=style.plain(name))
        for name, curve in curves.items()
    ]


def _legend(figure: Figure, panels: Panels, notes: Sequence[str], title: str) -> None:
    """Write the title, the colours of the detectors and the notes above all panels."""
    # The page has room for four columns of short names, or three columns with notes.
    columns = 3 if notes else 4
    texts = [style.wrapped(note, 41) for note in notes]
    blank = [Line2D([], [], linestyle="none", label=text) for text in texts]
    entries = [*_names_in_legend(panels), *blank]
    figure.legend(
        handles=entries, loc="outside upper left", ncols=columns,
        title=title or None, title_fontsize=8, alignment="left",
    )  # fmt: skip
    # The figure grows by the lines of the legend, so that the panels keep their height.
    rows = -(-len(entries) // columns)
    texts = [str(entry.get_label()) for entry in entries]
    most = max("\n".join(texts[at : at + rows]).count("\n") for at in range(0, len(texts), rows))
    more = _LEGEND_LINE * 1.5 * most
    figure.set_figheight(min(style.MOST_HEIGHT, figure.get_figheight() + more))


def _draw_heat(panels: Panels, options: CurveOptions) -> Drawn:
    """Draw a heat map for each detector, side by side, with a row for each input."""
    curves = [curve for panel in panels for curve in panel]
    detectors = list(dict.fromkeys(curve.detector for curve in curves))
    by_input: dict[int, dict[str, Curve]] = {}
    for curve in curves:
        by_input.setdefault(curve.number, {})[curve.detector] = curve
    rows = list(by_input.values())
    names = _panel_names([list(row.values()) for row in rows])
    names = [style.wrapped(name, max(36, len(name) // 2 + 8)) for name in names]  # two lines
    scale = options.scale_of(curves)
    lines = -(-len(detectors) // 5)  # of maps side by side
    columns = -(-len(detectors) // lines)
    row_height = 0.15 if all("\n" not in name for name in names) else 0.23
    height = 1.2 + row_height * len(rows) * lines
    with style.styled_figure(style.PAGE, height) as figure:
        axes = style.panel_grid(figure, len(detectors), columns, sharex=lines > 1, sharey=True)
        ends = min(curve.time[0] for curve in curves), max(curve.time[-1] for curve in curves)
        images = []
        for panel, detector in zip(axes, detectors, strict=True):
            cells = [row.get(detector) for row in rows]
            images.append(_draw_rows(panel, cells, options, options.xlim or ends, scale))
            panel.set_title(
                style.plain(detector_named(detector).label), fontsize=8 if lines == 1 else 6.8
            )
            if options.align:
                panel.axvline(0, color="white", lw=0.7, linestyle=(0, (4, 2)))
        for panel in axes[-columns:]:
            panel.set_xlabel(options.time_label)
        note = "line in a row: alarm on"
        if marked := [label for label, times in options.marks.items() if set(times) != {None}]:
            note += f"\nwhite: {' and '.join(marked)}"
        # Ratios have one scale for all detectors; a response has the unit of its detector.
        groups = [[image] for image in images] if scale == "raw" else [images]
        for group, detector in zip(groups, detectors, strict=False):
            first = next(curve for curve in curves if curve.detector == detector)
            bar = _draw_bar(figure, group, f"{_value_label(scale, first)}\n{note}", scale)
            if len(groups) > 3:  # their labels stand side by side
                label = bar.ax.get_xlabel().replace(" (", "\n(", 1)
                bar.set_label(label, fontsize=style.LEAST_SIZE)
        _write_names(axes[::columns], names)
        style.write_title(figure, options.title, 2 * style.TITLE_WIDTH)
    return figure, axes


def _write_names(axes: Sequence[Axes], names: Sequence[str]) -> None:
    """Write the names of the rows beside the leftmost heat map of each line of maps."""
    # Lines of maps have their titles and perhaps colour bars between them.
    most = 60 if all("\n" not in name for name in names) else 40
    step = -(-len(names) // (most // (2 * len(axes) - 1)))
    shown = range(0, len(names), step)
    axes[0].set_yticks(shown, [names[at] for at in shown])
    for panel in axes:
        panel.tick_params(axis="y", labelsize=style.LEAST_SIZE, length=0)
    if step > 1:
        axes[0].set_ylabel(f"one name in {step} is written")


def _draw_rows(
    axes: Axes,
    curves: Sequence[Curve | None],
    options: CurveOptions,
    ends: tuple[float, float],
    scale: str,
) -> AxesImage:
    """Draw a heat map of a detector, without the scale of its colours."""
    bins = min(400, max(len(curve.time) for curve in curves if curve is not None))
    values = np.full((len(curves), bins), np.nan)
    for row, curve in enumerate(curves):
        if curve is not None:
            values[row] = _binned(curve.time, curve.scaled(scale), *ends, bins)
            for start, duration in curve.alarms():
                axes.plot([start, start + duration], [row + 0.36] * 2, color="#D55E00", lw=1.6,
                          solid_capstyle="butt")  # fmt: skip
            for times in options.marks.values():
                if (time := times[curve.number]) is not None:
                    x = time - curve.zero_s
                    axes.plot([x, x], [row - 0.5, row + 0.5], color="white", lw=0.9)
    image = axes.imshow(
        values, aspect="auto", cmap=style.SHADES, interpolation="nearest",
        extent=(*ends, len(curves) - 0.5, -0.5),
    )  # fmt: skip
    axes.set_xlim(ends)
    return image


def _draw_bar(figure: Figure, images: Sequence[AxesImage], label: str, scale: str) -> Colorbar:
    """Give heat maps one scale of colours, and draw its colour bar below them."""
    thresholded = scale == "threshold"
    values = np.concatenate([np.asarray(image.get_array()).ravel() for image in images])
    norm = LogNorm(FLOOR, 100, clip=True) if thresholded else style.norm_of(values)
    for image in images:
        image.set_norm(norm)
    maps = [image.axes for image in images]
    bar = style.colour_bar(
        figure, images[0], maps, label, orientation="horizontal", pad=0.02, aspect=30
    )
    if thresholded:
        bar.set_ticks([0.01, 0.1, 1, 10, 100], labels=["≤0.01", "0.1", "1", "10", "≥100"])
    elif isinstance(norm, LogNorm):
        _write_few_numbers(bar)
    return bar


def _write_few_numbers(bar: Colorbar) -> None:
    """Write few numbers at a logarithmic colour bar that has one power of ten.

    Matplotlib also writes 2, 3, 4 and 6 times this power, which overlap below a narrow map.
    """
    first, last = bar.ax.get_xlim()
    powers = np.arange(np.ceil(np.log10(first)), np.floor(np.log10(last)) + 1)
    if len(powers) == 1:
        numbers = [share * 10.0 ** float(powers[0]) for share in (0.3, 1, 3)]
        ticks = [number for number in numbers if first <= number <= last]
        bar.set_ticks(ticks, labels=[style.short_number(tick) for tick in ticks])
        bar.ax.xaxis.set_minor_formatter(NullFormatter())


def _binned(time: Series, value: Series, begin: float, end: float, bins: int) -> Series:
    """Return the largest value in each bin of time; NaN before the first and after the last."""
    number = np.floor((time - begin) / max(end - begin, 1e-9) * bins).clip(-1, bins).astype(int)
    number[time == end] = bins - 1
    counts = np.isfinite(value)
    counts[np.flatnonzero(number < 0)[:-1]] = False  # of frames before all bins, the last counts
    largest = pd.Series(value[counts]).groupby(number[counts]).max().reindex(range(-1, bins + 1))
    # A bin between two frames shows the frame before it.
    return np.asarray(largest.ffill().where(largest.bfill().notna()), np.float64)[1:-1]
