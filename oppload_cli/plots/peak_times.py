"""The plot of the time of the peak before contact over l/v, with a line and published neurons."""

from __future__ import annotations

import math
from fractions import Fraction
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from oppload_cli.errors import ResultError, StimulusError
from oppload_cli.plots import style
from oppload_cli.plots.tuning_curves import (
    Request,
    TuningCurve,
    column_of,
    described,
    first_stimulus,
)
from oppload_cli.reference import AngularThreshold, angular_thresholds
from oppload_cli.results.cells import check_numbers
from oppload_cli.stimulus.protocol_tables import Display

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import ArrayLike

    from oppload_cli.results.result_files import Series
    from oppload_cli.results.tuning import Tuning


class PeakTimes(NamedTuple):
    """A line through the times t of peaks before contact, over l/v: ``t = a l/v - d``.

    The slope a gives the angular threshold 2 atan(1/a): the peak comes a delay d after the object
    has reached this angular size (Gabbiani, Krapp and Laurent 1999, J Neurosci 19:1122). An error
    is half of the confidence interval of 95 %.
    """

    slope: float
    slope_error: float
    delay_s: float
    delay_error_s: float
    middle_s: float = 0.0  # mean of l/v, where the error of the line is smallest

    @property
    def angle_deg(self) -> float:
        """The angular threshold in degrees."""
        return _threshold(self.slope)

    @property
    def angle_limits_deg(self) -> tuple[float, float]:
        """The confidence interval of 95 % of the angular threshold; it is not symmetric."""
        return _threshold(self.slope + self.slope_error), _threshold(self.slope - self.slope_error)

    @property
    def falls(self) -> bool:
        """Whether the line falls, so that no angular threshold explains it."""
        return self.slope <= -0.005  # else it is 0.00 in words: the peak comes at contact

    @property
    def text(self) -> str:
        """Slope, angular threshold and delay in words, with their confidence intervals."""
        low, high = self.angle_limits_deg
        limits = f"{self.angle_deg:.0f} deg, {low:.0f} to {high:.0f}"
        delay, error = round(1000 * self.delay_s), 1000 * self.delay_error_s
        return (
            f"slope {self.slope:z.2f} ± {self.slope_error:.2f} "
            f"({'no threshold' if self.falls else limits}), delay {delay} ± {error:.0f} ms"
        )

    def error_s(self, l_over_v_s: Series) -> Series:
        """Return half of the confidence interval of 95 % of the line at some l/v, in s."""
        scatter = self.delay_error_s**2 - (self.slope_error * self.middle_s) ** 2
        along = self.slope_error * (l_over_v_s - self.middle_s)
        return np.sqrt(np.maximum(scatter + along**2, 0))

    @classmethod
    def through(cls, l_over_v_s: ArrayLike, before_s: ArrayLike, step_s: float = 0.0) -> PeakTimes:
        """Fit the line to at least three points by least squares; times in s.

        The confidence intervals follow from Student's t distribution for normal, equal errors.
        Times that are rounded to multiples of `step_s`, the time of a frame, may lie on a line by
        chance. So the errors are at least those of the rounding.
        """
        x, t = np.asarray(l_over_v_s, float), np.asarray(before_s, float)
        centred = x - x.mean()
        slope = float(centred @ t / (centred @ centred))
        delay = float(slope * x.mean() - t.mean())
        freedom = len(x) - 2
        variance = max(float(np.sum((t - slope * x + delay) ** 2)) / freedom, step_s**2 / 12)
        error = _student_t(freedom) * math.sqrt(variance) / math.sqrt(float(centred @ centred))
        return cls(slope, error, delay, error * math.sqrt(float(np.mean(x**2))), float(x.mean()))


def _threshold(slope: float) -> float:
    """Return the angular threshold of a slope in degrees; 180 if the slope is not above 0."""
    return math.degrees(2 * math.atan2(1, max(slope, 0.0)))


def _student_t(freedom: int) -> float:
    """Return the quantile 0.975 of Student's t distribution for some degrees of freedom."""
    first = 12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262, 2.228
    if freedom <= len(first):
        return first[freedom - 1]
    z = 1.959964  # of a normal distribution; the expansion of Abramowitz and Stegun, 26.7.5
    return z + (z**3 + z) / (4 * freedom) + (5 * z**5 + 16 * z**3 + 3 * z) / (96 * freedom**2)


def contact_lines(request: Request) -> list[str]:
    """Return the fit of each curve of :func:`plot_contact`, as a line of text."""
    lines = []
    for curve in request.curves():
        fit = fit_of(curve)
        cause = "fewer than three peaks" if _has_contact(curve) else "a stimulus without contact"
        lines.append(f"{curve.name}: {fit.text if fit else f'{cause}, no line'}")
    return lines


def _has_contact(curve: TuningCurve) -> bool:
    """Return whether a time before contact is known, or would be if there were any peak."""
    before = curve.rows["peak_before_contact_s"]
    return bool(before.notna().any() or not (curve.peaks > 0).any())


def fit_of(curve: TuningCurve) -> PeakTimes | None:
    """Return the line through the peaks of a curve; None if fewer than three l/v have a peak."""
    x, before, _ = _peaks(curve)
    return _fit(curve.tuning, x, before)


def _peaks(curve: TuningCurve) -> tuple[Series, Series, Series | None]:
    """Return l/v in ms, times of peaks before contact in s, and sizes at the peaks in degrees.

    The sizes are None if the table has no column of them.
    """
    tuning, rows = curve.tuning, curve.rows
    names = [_column_of_l_over_v(tuning), "peak_before_contact_s"]
    if names[1] not in tuning.rows:
        raise ResultError(f"{tuning.path}: has no column '{names[1]}'; run oppload tune again")
    names += ["size_at_peak_deg"] * ("size_at_peak_deg" in tuning.rows)
    for name in names:
        check_numbers(tuning.path, tuning.rows, name)
    rows = rows[(rows["peak"] > 0) & rows["peak_before_contact_s"].notna()]
    x, before, *sizes = (rows[name].to_numpy(float) for name in names)
    return x, before, sizes[0] if sizes else None


def _column_of_l_over_v(tuning: Tuning) -> str:
    """Return the name of the column of l/v; raise ResultError if l/v is not what is swept."""
    advice = "l/v; for kind 'contact' run 'oppload tune --figure peak-time'"
    return column_of(tuning, "l_over_v_ms", advice)


def plot_contact(request: Request) -> tuple[Figure, list[Axes]]:
    """Draw the times of peaks before contact over l/v with a line, and the sizes at the peaks."""
    curves = request.curves()
    few = len(curves) <= style.FEW
    peaks = [_peaks(curve) for curve in curves]
    responding = [curve for curve in curves if (curve.peaks > 0).any()]
    if responding and not any(_has_contact(curve) for curve in responding):
        raise ResultError(
            f"{responding[0].tuning.path}: column 'peak_before_contact_s' is empty, as the "
            "stimulus has no contact; draw another kind, such as 'line'"
        )
    sized = any(sizes is not None for *_, sizes in peaks)
    lines = len(curves) * (2 if few else 0.5) + 8 * request.published
    height = 2.0 + 1.3 * sized + 0.14 * lines
    with style.styled_figure(style.COLUMN if few else style.PAGE, height) as figure:
        heights = (1.6, 1)[: 1 + sized]
        axes = style.panel_grid(figure, 1 + sized, 1, sharex=True, height_ratios=heights)
        top = None if few else _axis_end(x for x, _, _ in peaks)
        bands: list[tuple[PeakTimes, float, str]] = []
        more = 0  # lines of the legend, of long names and of doubts
        if not any(len(x) for x, _, _ in peaks):  # else the axis would end near 0
            longest = max(curve.rows[_column_of_l_over_v(curve.tuning)].max() for curve in curves)
            axes[0].set_xlim(0, 1.05 * longest)
        for curve, (x, before, sizes) in zip(curves, peaks, strict=True):
            fit = _fit(curve.tuning, x, before)
            above = top is not None and len(x) > 0 and bool(1000 * before.min() > top)
            label = _label(curve, fit, few=few, above=above)
            more += max(0, label.count("\n") - few)
            if fit:
                ends = np.array([0, x.max()])
                line_ms = fit.slope * ends - 1000 * fit.delay_s
                axes[0].plot(ends, line_ms, lw=0.8, **curve.look | {"marker": ""})
                bands.append((fit, x.max(), curve.look["color"]))
            look: dict[str, Any] = curve.look | {"markersize": 3}
            points = look | {"linestyle": ""}
            axes[0].plot(x, 1000 * before, **points)
            axes[0].plot([], [], **(look if fit else points), label=label)
            if sizes is not None:
                axes[-1].plot(x, sizes, **points)
        _draw_limits(axes, [curve.tuning for curve in curves])
        if request.published:
            _draw_published(axes, axes[0].get_xlim()[1])
        if few:
            _draw_bands(axes[0], bands)
        axes[0].set_ylabel("peak before contact (ms)")
        if sized:
            axes[-1].set_ylabel("size at peak (deg)")
            axes[-1].set_ylim(0, 190)  # above 180, so that no point is cut
            axes[-1].set_yticks(range(0, 181, 45))
        axes[-1].set_xlabel(described("l_over_v_ms"))
        axes[-1].set_xlim(left=0)
        if top is not None and axes[0].get_ylim()[1] > top:
            axes[0].set_ylim(-top / 8, top)
        style.legend_over_figure(figure, axes[0], request.title, 1 if few else 2)
        figure.set_figheight(min(style.MOST_HEIGHT, height + 0.14 * more / (1 if few else 2)))
    return figure, axes


def _label(curve: TuningCurve, fit: PeakTimes | None, *, few: bool, above: bool) -> str:
    """Return the text of a curve in the legend; that of many curves has room for few words."""
    label = style.wrapped(curve.name, style.LEGEND_WIDTH)
    if not (curve.peaks > 0).any():
        label += ", no response"
    elif fit and few:
        before_delay = ", " if len(fit.text) <= 60 else ",\n"  # many characters are narrow
        label += f"\n{fit.text.replace(', delay', f'{before_delay}delay')}"
    elif fit:
        angle = "no threshold" if fit.falls else f"{fit.angle_deg:.0f} deg"
        label += f": {angle}, {round(1000 * fit.delay_s)} ms"
    if above:
        label += " (above)"
    if few and curve.doubts:
        label += f"\n{style.wrapped(curve.doubts, style.LEGEND_WIDTH)}"
    return label


def _axis_end(l_over_v_ms: Iterable[Series]) -> float:
    """Return the upper end of the axis for many detectors, in ms before contact.

    At this time, the object with the largest l/v spans 10 degrees.
    """
    longest = max((float(values.max()) for values in l_over_v_ms if len(values)), default=1.0)
    return longest / math.tan(math.radians(5))


def _fit(tuning: Tuning, l_over_v_ms: Series, before_s: Series) -> PeakTimes | None:
    if len(np.unique(l_over_v_ms)) < 3:
        return None
    try:
        step = float(1 / Fraction(first_stimulus(tuning)["display"]["frame_rate"]))
    except (KeyError, TypeError, ValueError, ZeroDivisionError):
        step = 0.0
    return PeakTimes.through(l_over_v_ms / 1000, before_s, step)


def _draw_bands(axes: Axes, bands: Iterable[tuple[PeakTimes, float, str]]) -> None:
    """Draw the confidence interval of each line from 0 to some l/v in ms, in a colour.

    Wide intervals, such as those of three points, make the axis at most twice as long.
    """
    low, high = axes.get_ylim()
    for fit, longest, colour in bands:
        x = np.linspace(0, longest, 50)
        line = fit.slope * x - 1000 * fit.delay_s
        error = 1000 * fit.error_s(x / 1000)
        axes.fill_between(x, line - error, line + error, color=colour, alpha=0.15, lw=0)
    more = (high - low) / 2
    first, last = axes.get_ylim()
    axes.set_ylim(max(first, low - more), min(last, high + more))


def _draw_limits(axes: Sequence[Axes], tunings: Iterable[Tuning]) -> None:
    """Draw the time at which the object fills the display or stops growing, for each display.

    Peaks cannot come much later.
    """
    angles = {round(angle, 6) for tuning in tunings if (angle := _largest_angle(tuning))}
    limits = sorted(angle for angle in angles if angle < 180)
    stated = " and ".join(f"{angle:.0f}" for angle in limits)
    label = f"object fills the display or stops growing: {stated} deg"
    look: dict[str, Any] = {"color": style.FAINT, "lw": 0.7, "linestyle": style.DASHES[1]}
    x = axes[0].get_xlim()[1]
    for number, angle in enumerate(limits):
        slope = 1 / math.tan(math.radians(angle / 2))
        axes[0].plot([0, x], [0, slope * x], **look, label="" if number else label)
        if len(axes) > 1:
            axes[1].axhline(angle, **look)
        axes[0].set_xlim(right=x)


def _largest_angle(tuning: Tuning) -> float | None:
    """Return the smaller of two angles: of the display, and at which the object stops growing."""
    first = first_stimulus(tuning)
    try:
        display = Display.from_table(first["display"], "display")
        field = display.angle_of(min(display.width, display.height))
        growths = [obj["growth"] for obj in first["object"] if "growth" in obj]
        return float(min([field, *(growth.get("most_deg", 180) for growth in growths)]))
    except (KeyError, TypeError, AttributeError, StimulusError):
        return None


def _draw_published(axes: Sequence[Axes], longest: float) -> None:
    """Draw published neurons: a range over animals as a band, a single value as a line."""
    x = np.array([0.0, longest])
    peaks = {(threshold.neuron, threshold.kind): threshold for threshold in angular_thresholds()}
    for (neuron, kind), threshold in peaks.items():
        line = threshold.slope * x - threshold.delay_ms
        if kind == "upper limit":
            low = peaks[neuron, "lower limit"]
            lower = low.slope * x - low.delay_ms
            shade: dict[str, Any] = {"color": style.FAINT, "alpha": 0.25, "lw": 0}
            axes[0].fill_between(
                x, line, lower, **shade, zorder=0, label=_published_label(threshold, low)
            )
            if len(axes) > 1:
                axes[1].axhspan(low.angle_deg, threshold.angle_deg, **shade, zorder=0)
        elif kind != "lower limit":
            look: dict[str, Any] = {"color": style.INK, "lw": 0.8, "zorder": 1}
            look["linestyle"] = style.DASHES[1 + (kind != "example")]
            axes[0].plot(x, line, **look, label=_published_label(threshold))
            if len(axes) > 1:
                axes[1].axhline(threshold.angle_deg, **look)
    axes[0].set_xlim(right=longest)


def _published_label(peak: AngularThreshold, low: AngularThreshold | None = None) -> str:
    """Return the label of a published threshold, or of the range from `low` to `peak`."""
    study = peak.source.rsplit(", ", 1)[0]
    kind = "range over animals" if low else peak.kind
    angle = f"{low.angle_deg:g} to {peak.angle_deg:g}" if low else f"{peak.angle_deg:g}"
    delay = f"{low.delay_ms:g} to {peak.delay_ms:g}" if low else f"{peak.delay_ms:g}"
    text = f"{peak.neuron}, {kind}\n{angle} deg, {delay} ms ({study})"
    return style.wrapped(text, style.LEGEND_WIDTH)
