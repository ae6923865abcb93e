"""One panel of responses over time: its curves, thresholds, alarms and labelled times."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import product
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from matplotlib.ticker import FixedLocator, FuncFormatter

from oppload_cli.errors import ResultError
from oppload_cli.models.registry import detector_named
from oppload_cli.plots import style
from oppload_cli.plots.naming import in_number_order, labels_of
from oppload_cli.results.alarm_log import uncounted, uncounted_in
from oppload_cli.results.result_files import alarm_rows, frame_ends, known_threshold
from oppload_cli.results.truths import contacts_of, stated_contact, usable_truth

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from matplotlib.axes import Axes

    from oppload_cli.results.result_files import BaseResult, Series
    from oppload_cli.results.truths import Truth

SCALES = ("threshold", "peak", "raw")
FLOOR = 0.01  # of the threshold; smaller responses are drawn at this level
_HEADROOM = 1.25  # upper end of an axis over the peak
# Lengths as shares of a panel's width or height.
_ROW = 0.066  # height of a row of labels; 7.5 points
_BAR_STEP = 0.035  # from the bar of an alarm to the next one
NOT_DOTTED = "no dotted line: threshold above the panel"


@dataclass(frozen=True)
class CurveOptions:
    """How curves are drawn; the fields are arguments of :func:`oppload_cli.plot_curves`."""

    models: tuple[str, ...] = ()
    scale: str = "threshold"
    align: str | None = None
    xlim: tuple[float, float] | None = None
    title: str | None = None
    labels: tuple[str, ...] = ()
    marks: Mapping[str, Sequence[float | None]] = field(default_factory=dict)
    threshold: bool = True
    any_length: bool = False
    bars: bool = False  # whether alarms are bars at the top of a panel, not shades

    @property
    def time_label(self) -> str:
        """The label of the time axis."""
        return "time from contact (s)" if self.align else "time (s)"

    def with_bars(self, panels: Sequence[Sequence[Curve]]) -> CurveOptions:
        """Return the options, with bars if the shades of alarms would mix in some panel."""
        bars = any(
            len({curve.number for curve in curves}) > 1
            or sum(bool(curve.alarms()) for curve in curves) > 1
            for curves in panels
        )
        return replace(self, bars=bars)

    def bars_of(self, curves: Sequence[Curve]) -> dict[Curve, float]:
        """Return the upper end of each curve's alarm bar, as a share of the panel's height.

        Curves without an alarm have no bar.
        """
        alarming = [curve for curve in curves if self.bars and curve.alarms()]
        return {curve: 0.97 - _BAR_STEP * order for order, curve in enumerate(alarming)}

    def scale_of(self, curves: Sequence[Curve]) -> str:
        """Return the scale of a panel: ``peak`` in place of ``threshold`` if a curve has none."""
        if self.scale == "threshold" and any(curve.threshold is None for curve in curves):
            return "peak"
        return self.scale


@dataclass(frozen=True, eq=False)
class Curve:
    """The responses of a detector in one of the results: a line of a panel."""

    result: BaseResult
    number: int  # position of the result among the results
    result_name: str  # from the user, or what differs between the results
    detector: str
    name: str  # in the legend
    colour: str
    truth: Truth | None  # ground truth of the result's stimulus, if it is known
    zero_s: float  # the time of the result that is 0 on the axis
    dash: object = "-"

    @property
    def time(self) -> Series:
        """Time of each frame, as on the axis."""
        return self.result.frames["time_s"].to_numpy(float) - self.zero_s

    @property
    def response(self) -> Series:
        """Response to each frame; NaN during warm-up."""
        return self.result.frames[f"{self.detector}_response"].to_numpy(float)

    @cached_property
    def threshold(self) -> Series | None:
        """The alarm's threshold in each frame; None if the alarms were off."""
        return known_threshold(self.result, self.detector)

    def scaled(self, scale: str) -> Series:
        """Return the responses divided by the threshold or by their peak, or in their unit."""
        response = self.response
        if scale == "threshold" and self.threshold is not None:
            return np.asarray(response / self.threshold, np.float64)
        peak = np.nanmax(response)
        return response / peak if scale == "peak" and peak > 0 else response

    def alarms(self) -> list[tuple[float, float]]:
        """Return the beginning of each alarm, as on the axis, and its duration, in seconds."""
        time, ends = self.time, frame_ends(self.time)
        rows = alarm_rows(self.result, self.detector)
        return [(time[first], ends[stop - 1] - time[first]) for first, stop in rows]


def panels_of(results: Sequence[BaseResult], options: CurveOptions) -> list[list[Curve]]:
    """Return the curves of each panel.

    Several detectors over one input share a panel, and so do several inputs of one detector, in
    the order of the numbers in their names. Several detectors over several inputs have a panel for
    each input. Raw responses have a panel for each curve.

    Raises
    ------
    ResultError
        If a result lacks a chosen detector or its responses, or curves are aligned and a contact
        is not known.
    """
    for result in results:
        result.need([f"{name}_response" for name in options.models])
    detectors = [options.models or result.models for result in results]
    for result, names in zip(results, detectors, strict=True):
        result.need_responses(names)
    labels = labels_of(results, options.labels)
    groups = [
        _curves_of_result(results[at], at, labels[at], detectors[at], options)
        for at in in_number_order(labels)
    ]
    if len(results) > 1 and len(set(detectors)) == 1 and len(detectors[0]) == 1:
        curves = [curve for group in groups for curve in group]
        looks = style.looks_of([curve.detector for curve in curves])
        named = [
            replace(curve, name=curve.result_name, colour=look["color"], dash=look["linestyle"])
            for curve, look in zip(curves, looks, strict=True)
        ]
        return [named]
    if options.scale == "raw":
        return [[curve] for group in groups for curve in group]
    return groups


def _curves_of_result(
    result: BaseResult, at: int, label: str, names: Sequence[str], options: CurveOptions
) -> list[Curve]:
    """Return the curves of the detectors in result number `at`, as they look in one panel."""
    truth = usable_truth(result)
    zero_s = _contact(result, truth, options.marks.get("contact"), at) if options.align else 0.0
    looks = () if options.scale == "raw" else style.looks_of(names)  # raw curves have a panel each
    dashes = [look["linestyle"] for look in looks] or ["-"] * len(names)
    return [
        Curve(
            result, at, label, detector.name, detector.label, detector.colour, truth, zero_s, dash
        )
        for detector, dash in zip(map(detector_named, names), dashes, strict=True)
    ]


def _contact(
    result: BaseResult, truth: Truth | None, contacts: Sequence[float | None] | None, at: int
) -> float:
    """Return the time of contact of result `at`: from the user, or else from the ground truth."""
    contact = contacts[at] if contacts else None
    contact = stated_contact(truth) if contact is None and truth else contact
    if contact is None:
        raise ResultError(
            f"{result.path}: its time of contact is not known; leave the result out, or give "
            "the time with --contact (in Python marks={'contact': [SECONDS, ...]}), or with a "
            "--manifest of clips that states it"
        )
    return contact


def draw_curves(
    axes: Axes, curves: Sequence[Curve], options: CurveOptions, scale: str
) -> list[str]:
    """Draw curves, thresholds and alarms into a panel; return the notes for its legend."""
    values = [curve.scaled(scale) for curve in curves]
    notes: list[str] = []
    if options.xlim:  # before the curves, so that the axes cut the ring of a peak outside
        axes.set_xlim(options.xlim)
    bars = options.bars_of(curves)
    largest = max(float(np.nanmax(value, initial=0)) for value in values)
    for order, (curve, value) in enumerate(zip(curves, values, strict=True)):
        _draw_curve(axes, curve, value, scale, order)
        _draw_alarms(axes, curve, bars.get(curve))
        if options.threshold and scale != "threshold":
            notes += _draw_threshold(axes, curve, scale, largest)
    notes += _alarm_notes(curves, options)
    if scale != options.scale:
        without = [
            detector_named(curve.detector).label for curve in curves if curve.threshold is None
        ]
        whose = f" of {', '.join(without)}" if len(without) < len(curves) else ""
        notes.append(f"divided by the peak: no alarm threshold{whose}")
    if scale == "raw":
        style.number_in_full(axes)
    axes.margins(x=0.01)
    bars_height = _BAR_STEP * len(bars)
    if scale == "threshold":
        if options.threshold:
            axes.axhline(1, color=style.INK, lw=0.9)
        log_axis(axes, max(10.0, 3 * largest) * 10 ** (4 * bars_height))
    elif largest > 0:
        axes.set_ylim(-0.03 * largest, _HEADROOM * largest * (1 + bars_height))
        if scale == "peak":
            axes.set_yticks([0, 0.5, 1])
    return list(dict.fromkeys(notes))


def _alarm_notes(curves: Sequence[Curve], options: CurveOptions) -> list[str]:
    notes = []
    if any(curve.alarms() for curve in curves):
        notes.append("bar at the top: alarm on" if options.bars else "shaded: alarm on")
    silent = [curve for curve in curves if not curve.alarms() and curve.threshold is not None]
    reasons = {
        uncounted_in(curve.result.part("alarms"), curve.detector)
        for curve in silent
        if np.nanmax(curve.scaled("threshold"), initial=0) > 1
    }
    if reasons:
        reason = reasons.pop() if len(reasons) == 1 else uncounted(None)
        notes.append(f"peak above the threshold, {reason}")
    return notes


def _draw_alarms(axes: Axes, curve: Curve, height: float | None) -> None:
    """Shade the frames in which the alarm is on, or draw a bar with an upper end at `height`."""
    for begin, duration in curve.alarms():
        if height is None:
            axes.axvspan(begin, begin + duration, color=curve.colour, alpha=0.18, lw=0)
        else:
            axes.axvspan(begin, begin + duration, height - 0.022, height, color=curve.colour, lw=0)


def _draw_curve(axes: Axes, curve: Curve, value: Series, scale: str, order: int) -> None:
    look: dict[str, Any] = {"color": curve.colour, "linestyle": curve.dash}
    name = style.wrapped(curve.name, style.LEGEND_WIDTH)
    if np.nanmax(curve.response) <= 0:
        shown = np.where(np.isnan(value), np.nan, FLOOR) if scale == "threshold" else value
        axes.plot(curve.time, shown, **look, label=f"{name}, no response")
        return
    best = int(np.nanargmax(value))
    largest, time = float(value[best]), curve.time
    shown = np.maximum(value, FLOOR) if scale == "threshold" else value
    label = style.wrapped(_legend_line(curve, scale, best), style.LEGEND_WIDTH)
    axes.plot(time, shown, **look, label=label)
    if scale == "threshold" and largest < FLOOR:
        return
    # Hollow rings of two sizes, so that two peaks in one place are both visible.
    size = 6 - 2 * (order % 2)
    axes.plot(
        time[best], largest, "o", markersize=size, mfc="none", mec=curve.colour, zorder=3,
        clip_on=not axes.get_autoscalex_on(),
    )  # fmt: skip


def _legend_line(curve: Curve, scale: str, best: int) -> str:
    """Return a curve's line in the legend: its name, its peak and the time of the peak."""
    peak, value = float(curve.response[best]), float(curve.scaled(scale)[best])
    time = float(curve.time[best])
    aligned = curve.zero_s != 0
    when = f"{time:.2f} s" if aligned else f"{style.short_number(time)} s"
    if scale == "threshold" and value < FLOOR:
        return f"{curve.name}, below {FLOOR:g} of the threshold"
    value = min(value, 0.999) if value < 1 else value  # below the threshold it does not become 1
    multiple = f"{style.short_number(value)} times threshold"
    height = multiple if scale == "threshold" else f"peak {style.short_number(peak)}"
    text = f"{curve.name}, {height} at {when}"
    frame = f" (frame {int(curve.result.frames['frame'].iloc[best])})"
    fits = len(text + frame) <= style.LEGEND_WIDTH
    return text + frame if fits and not aligned else text


def _draw_threshold(axes: Axes, curve: Curve, scale: str, largest: float) -> list[str]:
    """Draw an alarm's threshold where it lies in the panel; return the notes for the legend.

    `largest` is the largest value of all curves in the panel.
    """
    threshold, peak = curve.threshold, float(np.nanmax(curve.response))
    if threshold is None:
        return []
    divisor = peak if scale == "peak" else 1.0
    above = threshold > _HEADROOM * largest * divisor
    shown = np.where(above, np.nan, threshold) / divisor
    if not np.isfinite(shown).any():
        height = "no response"
        if peak > 0:
            multiple = style.short_number(float(np.nanmin(threshold)) / peak)
            height = f"{multiple} times the peak or more"
        return [f"threshold of {curve.name} above the panel: {height}"]
    axes.plot(
        curve.time, shown, color=curve.colour, lw=0.8, linestyle=(0, (1, 1)), drawstyle="steps-mid"
    )
    notes = ["dotted: threshold of the alarm"]
    return [*notes, NOT_DOTTED] if above.any() else notes


def log_axis(axes: Axes, top: float) -> None:
    """Make the vertical axis logarithmic, from the floor up to `top`, with plain numbers."""
    axes.set_yscale("log")
    axes.set_ylim(0.75 * FLOOR, top)
    last = int(np.floor(np.log10(top)))
    step = 1 if last <= 2 else 2
    axes.yaxis.set_major_locator(FixedLocator([10.0**power for power in range(-2, last + 1, step)]))
    axes.yaxis.set_major_formatter(FuncFormatter(_plain_number))
    axes.minorticks_off()


def _plain_number(tick: float, _: object) -> str:  # no lambda, so that figures can be pickled
    return f"≤{tick:g}" if tick <= FLOOR else f"{tick:,g}"


def draw_marks(axes: Sequence[Axes], curves: Sequence[Curve], options: CurveOptions) -> None:
    """Draw the labelled times in `axes`, a panel and perhaps the ground truth below it.

    Each time is a vertical line with a label at the top of the panel. If the time is outside the
    panel, only its label is drawn. If inputs of the panel have different times, each line has the
    colour of its curve.
    """
    marks, other_contacts = _marks_of(curves, options)
    first, last = axes[0].get_xlim()

    def draw_line(time: float, colour: str) -> None:
        for panel in axes if first <= time <= last else ():
            panel.axvline(time, color=colour, lw=0.7, linestyle=(0, (4, 2)))

    below = max((1 - bar + _BAR_STEP for bar in options.bars_of(curves).values()), default=0.0)
    taken: list[_Label] = []  # the places of labels
    lines = _curves_of(axes[0])
    for label, times in marks.items():
        aligned = {curve: time - curve.zero_s for curve, time in times.items() if time is not None}
        same_time = len({round(time, 6) for time in aligned.values()}) == 1
        for curve, time in aligned.items():
            draw_line(time, style.INK if same_time else curve.colour)
        if not aligned or (label == "contact" and options.align):  # the axis label says it
            continue
        time = next(iter(aligned.values()))
        text = f"{label}s" if label == "contact" and other_contacts else label
        if not first <= time <= last:
            text = f"{label} at {style.short_number(time)} s"
        share = min(max((time - first) / (last - first), 0.0), 1.0)
        _write_mark(axes[0], text, share, 1 - below, taken=taken, lines=lines)
    for time in other_contacts:
        draw_line(time, style.INK)
    axes[0].set_xlim(first, last)


def _write_mark(
    axes: Axes,
    text: str,
    share: float,
    top: float,
    *,
    taken: list[_Label],
    lines: Sequence[Series],
) -> None:
    """Write the label of a vertical line where it covers no other label and no curve.

    `share` is the place of the line, as a share of the panel's width; `top` is the upper end of the
    first row of labels, as a share of its height. `taken` has the places of other labels, and gets
    that of this label; `lines` are the curves from :func:`_curves_of`.
    """
    letter = 0.02  # its width, as a share of the width of the panel
    width = letter * len(text)
    # A second label stands to the right of its line, away from the first label.
    right = share < 0.2 or (bool(taken) and share + width < 1)
    sides = [right, not right] if width <= share <= 1 - width else [right]
    left_ends = [share if side else share - width for side in sides]
    places = (_Label(left, left + width, row) for row, left in product(range(4), left_ends))
    place = next((place for place in places if _is_free(place, top, taken, lines)), None)
    upright = place is None  # an upright label is narrow, and may cover a curve
    begin = min(share, 1 - 2 * letter)
    place = place or _Label(begin, begin + 2 * letter, 0)
    taken.append(place)
    right = place.left >= share
    axes.annotate(
        text, (share, top), xycoords="axes fraction",
        xytext=(2 if right else -2, -1 - 7.5 * place.row), textcoords="offset points",
        ha="left" if right else "right", va="top", fontsize=6, color=style.INK,
        rotation=90 if upright else 0,
    )  # fmt: skip


def _marks_of(
    curves: Sequence[Curve], options: CurveOptions
) -> tuple[dict[str, dict[Curve, float | None]], list[float]]:
    """Return the labelled times of a panel by label and input, and the contacts of other objects.

    A contact comes from the user, or else from the ground truth that the inputs share.
    """
    truth = shared_truth(curves)
    of_inputs = {curve.number: curve for curve in curves}.values()
    other_contacts: list[float] = []
    marks = {
        label: {curve: times[curve.number] for curve in of_inputs}
        for label, times in options.marks.items()
    }
    if options.align or not any(time is not None for time in marks.get("contact", {}).values()):
        contact = stated_contact(truth) if truth else None
        marks["contact"] = {
            curve: curve.zero_s if options.align else contact for curve in of_inputs
        }
        contacts = contacts_of(truth) if truth else []
        other_contacts = [time - curves[0].zero_s for time in contacts if time != contact]
    return marks, other_contacts


class _Label(NamedTuple):
    """The place of a label: its ends as shares of the panel's width, and its row from the top."""

    left: float
    right: float
    row: int


def _curves_of(axes: Axes) -> list[Series]:
    """Return the curves of a panel as rows of (x, y), in shares of its width and height.

    A line of one point is a peak, and becomes a line along the top of its ring. A line of two
    points is not a curve, but a labelled time or a threshold.
    """
    place = axes.transData + axes.transAxes.inverted()
    lines = [place.transform(np.asarray(line.get_xydata(), float)) for line in axes.lines]
    ring = 0.03  # half its size
    top = np.array([(-ring, ring), (ring, ring)])
    tops = [line + top for line in lines if len(line) == 1]
    return [line for line in lines if len(line) > 2] + tops


def _is_free(place: _Label, top: float, taken: Sequence[_Label], lines: Sequence[Series]) -> bool:
    """Return whether a label covers no label and no curve; arguments as for `_write_mark`."""
    left, right, row = place
    if any(row == other.row and left < other.right and other.left < right for other in taken):
        return False
    high, margin = top - _ROW * row, 0.02
    x = np.linspace(left, right, 50)
    heights = (np.interp(x, line[:, 0], line[:, 1], np.nan, np.nan) for line in lines)
    return not any(np.any((y > high - _ROW - margin) & (y < high + margin)) for y in heights)


def shared_truth(curves: Sequence[Curve]) -> Truth | None:
    """Return the ground truth of a panel; None if its inputs have different ones."""
    truth = curves[0].truth
    return truth if all(curve.truth == truth for curve in curves) else None
