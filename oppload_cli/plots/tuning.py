"""Tables of ``oppload tune``: a polar plot, a line or a heat map, as suits them."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from oppload_cli.errors import ParameterError, ResultError
from oppload_cli.models.registry import detector_named
from oppload_cli.plots.naming import wrapped
from oppload_cli.plots.polar import direction_tunings, names_of, plot_polar
from oppload_cli.plots.style import (
    COLUMN,
    DASHES,
    LEGEND_WIDTH,
    MOST_HEIGHT,
    SHADES,
    TITLE_WIDTH,
    as_list,
    norm_of,
    styled_figure,
)
from oppload_cli.results.reading import check_numbers

if TYPE_CHECKING:
    from collections.abc import Sequence

    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.image import AxesImage
    from numpy.typing import ArrayLike

    from oppload_cli.results.reading import Tuning


TUNING_SCALES = ("peak", "raw")
PARAMETER_UNITS = {
    "_deg_s": "deg/s",
    "_deg": "deg",
    "_ms": "ms",
    "_hz": "Hz",
    "_per_s": "1/s",
    "_s": "s",
}


def plot_tuning(
    tunings: Tuning | Sequence[Tuning],
    kind: str | None = None,
    *,
    models: Sequence[str] = (),
    scale: str = "peak",
    lplc2: str = "auto",
    title: str | None = None,
    labels: Sequence[str] = (),
) -> tuple[Figure, list[Axes]]:
    """Draw tuning tables.

    Parameters
    ----------
    tunings : Tuning or sequence of Tuning
        At least one.
    kind : str, optional
        ``polar``, ``line``, ``heat``, or ``contact``, the time of the peak before contact over
        l/v with a line through it; else the one that suits the swept parameters.
    models : sequence of str
        The detectors to draw; none for all.
    scale : str
        ``peak`` or ``raw``; a heat map is always over its largest peak.
    lplc2 : str
        ``10``, ``60``, ``none`` or ``auto``: the reference in a polar plot.
    title : str, optional
        Of the figure; else the stimulus's name.
    labels : sequence of str
        Names of the tables; else what differs between them.

    Returns
    -------
    matplotlib.figure.Figure, list of Axes
        Not saved yet; a panel, or one for each detector.

    Raises
    ------
    ParameterError
        If there is no such scale.
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
    tunings = as_list(tunings)
    if scale not in TUNING_SCALES:
        raise ParameterError(
            f"a table of peaks is drawn over its largest peak or raw, not --scale {scale}"
        )
    first, raw = tunings[0], scale == "raw"
    kind = kind or kind_of(first)
    if title is None:
        title = first.name if len(tunings) == 1 else ""
    if kind == "polar":
        curves = direction_tunings(tunings, models, lplc2, labels)
        return plot_polar(curves, raw=raw, title=title)
    if kind == "contact":
        return _plot_contact(tunings, models, names_of(tunings, labels), title)
    if kind == "line":
        return _plot_line(tunings, models, names_of(tunings, labels), raw=raw, title=title)
    if len(tunings) > 1:
        raise ResultError(f"{tunings[1].path}: a heat map shows one table; plot them separately")
    return _plot_heat(first, models, title)


def kind_of(tuning: Tuning) -> str:
    """Return the kind of plot that suits a table: ``heat``, ``polar`` or ``line``."""
    return "heat" if len(tuning.parameters) == 2 else "polar" if tuning.direction else "line"


def _plot_line(
    tunings: Sequence[Tuning],
    detectors: Sequence[str],
    tables: Sequence[str],
    *,
    raw: bool,
    title: str,
) -> tuple[Figure, list[Axes]]:
    """Draw the peak over one swept parameter; a panel for each detector if raw."""
    parameter = _parameter(tunings)
    names = list(detectors) or list(dict.fromkeys(m for each in tunings for m in each.models))
    groups = [[name] for name in names] if raw else [names]
    height = 0.3 + len(groups) * 1.9 + 0.13 * len(names) * len(tunings)
    with styled_figure(COLUMN, min(MOST_HEIGHT, height)) as figure:
        axes = figure.subplots(len(groups), 1, squeeze=False, sharex=True)[:, 0]
        for panel, group in zip(axes, groups, strict=True):
            for number, tuning in enumerate(tunings):
                for name in group:
                    rows = tuning.of(name)
                    largest = float(rows["peak"].max()) if len(rows) else 0.0
                    detector = detector_named(name)
                    label = f"{detector.label}, largest peak {largest:.3g} ({detector.unit})"
                    if len(tunings) > 1:
                        label = f"{tables[number]}: {label}"
                    panel.plot(
                        rows[parameter], rows["peak"] / (1.0 if raw or largest <= 0 else largest),
                        "o", markersize=3, color=detector.colour,
                        linestyle=DASHES[number % 4], label=wrapped(label, LEGEND_WIDTH),
                    )  # fmt: skip
            unit = (
                f"peak response ({detector_named(group[0]).unit})" if raw else "peak / largest peak"
            )
            panel.set_ylabel(unit)
            panel.set_ylim(bottom=0)
            panel.legend(loc="lower left", bbox_to_anchor=(0, 1), borderaxespad=0.1, borderpad=0.1)
        axes[-1].set_xlabel(described(parameter))
        lines = sum(each.count("\n") + 1 for each in axes[0].get_legend_handles_labels()[1])
        axes[0].set_title(wrapped(title, TITLE_WIDTH), pad=6 + 10 * lines)
    return figure, list(axes)


class PeakTimes(NamedTuple):
    """A line through the times of peaks before contact over l/v.

    ``t = a l/v - d``: an object is seen under the angle 2 atan(1/a) at the delay d before its peak
    (Gabbiani, Krapp and Laurent 1999, J Neurosci 19:1122).

    Attributes
    ----------
    slope, slope_error : float
        a, and half of its interval of 95 %.
    delay_s, delay_error_s : float
        d in s, and half of its interval of 95 %.
    """

    slope: float
    slope_error: float
    delay_s: float
    delay_error_s: float

    @property
    def angle_deg(self) -> float:
        """The angular threshold in degrees."""
        return math.degrees(2 * math.atan2(1, self.slope))

    @classmethod
    def through(cls, l_over_v_s: ArrayLike, before_s: ArrayLike) -> PeakTimes:
        """Fit the line to at least three points by least squares; times in s.

        The intervals are those of Student's t distribution for normal, equal errors.
        """
        x, t = np.asarray(l_over_v_s, float), np.asarray(before_s, float)
        about = x - x.mean()
        slope = float(about @ t / (about @ about))
        delay = float(slope * x.mean() - t.mean())
        free = len(x) - 2
        scatter = math.sqrt(float(np.sum((t - slope * x + delay) ** 2)) / free)
        error = student_t(free) * scatter / math.sqrt(float(about @ about))
        return cls(slope, error, delay, error * math.sqrt(float(np.mean(x**2))))


def student_t(free: int) -> float:
    """Return the quantile 0.975 of Student's t distribution for some degrees of freedom."""
    if free <= len(_STUDENT):
        return _STUDENT[free - 1]
    z = _NORMAL  # the expansion of Abramowitz and Stegun, 26.7.5
    return z + (z**3 + z) / (4 * free) + (5 * z**5 + 16 * z**3 + 3 * z) / (96 * free**2)


_STUDENT = 12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262, 2.228
_NORMAL = 1.959964


def _plot_contact(
    tunings: Sequence[Tuning], detectors: Sequence[str], tables: Sequence[str], title: str
) -> tuple[Figure, list[Axes]]:
    """Draw the time of the peak before contact over l/v, and a line through it."""
    parameter = _parameter(tunings)
    if not parameter.endswith("l_over_v_ms"):
        raise ResultError(
            f"{tunings[0].path}: sweeps '{parameter}', not l/v; for --kind contact run "
            "'oppload tune loom-l-over-v'"
        )
    names = list(detectors) or list(dict.fromkeys(m for each in tunings for m in each.models))
    height = 2.2 + 0.28 * len(names) * len(tunings)
    with styled_figure(COLUMN, min(MOST_HEIGHT, height)) as figure:
        axes = figure.subplots()
        for number, tuning in enumerate(tunings):
            if "peak_before_contact_s" not in tuning.rows:
                raise ResultError(
                    f"{tuning.path}: has no column 'peak_before_contact_s'; run oppload tune again"
                )
            check_numbers(tuning.path, tuning.rows, "peak_before_contact_s")
            for name in names:
                rows = tuning.of(name)
                rows = rows[(rows["peak"] > 0) & rows["peak_before_contact_s"].notna()]
                label = f"{tables[number]}: " * (len(tunings) > 1) + detector_named(name).label
                if len(rows) >= 3:
                    label += _draw_fit(axes, rows, parameter, detector_named(name).colour)
                axes.plot(
                    rows[parameter], 1000 * rows["peak_before_contact_s"], "o", markersize=3,
                    color=detector_named(name).colour, linestyle="", label=label,
                )  # fmt: skip
        axes.set_xlabel(described(parameter))
        axes.set_ylabel("peak before contact (ms)")
        axes.legend(loc="lower left", bbox_to_anchor=(0, 1), borderaxespad=0.1, borderpad=0.1)
        lines = sum(each.count("\n") + 1 for each in axes.get_legend_handles_labels()[1])
        axes.set_title(wrapped(title, TITLE_WIDTH), pad=6 + 10 * lines)
    return figure, [axes]


def _draw_fit(axes: Axes, rows: pd.DataFrame, parameter: str, colour: str) -> str:
    """Draw the line through the peaks of one detector, and return its label."""
    l_over_v = rows[parameter].to_numpy(float)
    fit = PeakTimes.through(l_over_v / 1000, rows["peak_before_contact_s"].to_numpy(float))
    ends = np.array([0, l_over_v.max()])
    axes.plot(ends, fit.slope * ends - 1000 * fit.delay_s, color=colour, lw=0.8)
    return (
        f"\nslope {fit.slope:.2f} ± {fit.slope_error:.2f} ({fit.angle_deg:.0f} deg), delay "
        f"{1000 * fit.delay_s:.0f} ± {1000 * fit.delay_error_s:.0f} ms"
    )


def _parameter(tunings: Sequence[Tuning]) -> str:
    """Return the one parameter that all tables sweep, as numbers."""
    first = tunings[0]
    if len(first.parameters) > 1:
        raise ResultError(
            f"{first.path}: columns {' and '.join(first.parameters)} are swept; draw --kind heat"
        )
    parameter = first.parameters[0]
    for tuning in tunings:
        if tuning.parameters != first.parameters:
            raise ResultError(
                f"{tuning.path}: has no column '{parameter}' as {first.path} has; "
                "plot them separately"
            )
        check_numbers(tuning.path, tuning.rows, parameter)
    return parameter


def _plot_heat(tuning: Tuning, detectors: Sequence[str], title: str) -> tuple[Figure, list[Axes]]:
    """Draw the peak over two swept parameters; a combination that was not shown is blank."""
    if len(tuning.parameters) != 2:
        raise ResultError(
            f"{tuning.path}: column{'s' * (len(tuning.parameters) > 1)} "
            f"{', '.join(tuning.parameters)} swept; a heat map needs two parameters"
        )
    names = [name for name in tuning.models if name in (detectors or tuning.models)]
    if not names:
        raise ResultError(
            f"{tuning.path}: column 'model' never holds '{detectors[0]}'; leave it out"
        )
    rows = tuning.rows[tuning.parameters[1]].nunique()
    height = 0.2 + len(names) * (0.75 + min(2.4, max(0.9, 0.28 * rows)))
    with styled_figure(COLUMN, min(MOST_HEIGHT, height)) as figure:
        axes = list(figure.subplots(len(names), 1, squeeze=False)[:, 0])
        if title:
            figure.suptitle(wrapped(title, TITLE_WIDTH), fontsize=8, x=0.02, ha="left")
        for panel, name in zip(axes, names, strict=True):
            image = _draw_heat(panel, tuning, name)
            cut = np.nanmin(np.asarray(image.get_array())) < (image.norm.vmin or 0)
            bar = figure.colorbar(image, ax=panel, pad=0.02, extend="min" if cut else "neither")
            bar.set_label("peak / largest peak")
            bar.outline.set_linewidth(0.5)
    return figure, axes


def _draw_heat(axes: Axes, tuning: Tuning, detector: str) -> AxesImage:
    across, up = tuning.parameters
    cells = tuning.of(detector).pivot_table(index=up, columns=across, values="peak")
    values = cells.to_numpy(float)
    largest = float(np.nanmax(values))
    share = values / largest if largest > 0 else values
    norm = norm_of(share)
    image = axes.imshow(share, origin="lower", aspect="auto", cmap=SHADES, norm=norm)
    axes.set_xticks(range(share.shape[1]), [_number(value) for value in cells.columns])
    axes.set_yticks(range(share.shape[0]), [_number(value) for value in cells.index])
    if share.size <= 100:
        for (row, column), value in np.ndenumerate(share):
            if np.isfinite(value):
                ink = "black" if norm(value) > 0.55 else "white"
                axes.text(column, row, f"{value:.2g}", ha="center", va="center", color=ink, size=6)
    axes.set_xlabel(described(across))
    axes.set_ylabel(described(up))
    shown = detector_named(detector)
    axes.set_title(f"{shown.label}, largest peak {largest:.3g} ({shown.unit})")
    return image


def _number(value: object) -> str:
    return f"{value:g}" if isinstance(value, int | float) else str(value)


def described(parameter: str) -> str:
    """Return the label of an axis over a swept parameter, with its unit.

    Parameters
    ----------
    parameter : str
        A dotted key: ``disk.growth.speed_deg_s`` gives ``speed (deg/s)``.
    """
    *_, owner, leaf = ("", *parameter.split("."))
    if leaf in {"right", "up"}:  # of a place, which is in degrees
        return f"{leaf} (deg)"
    if leaf == "l_over_v_ms":
        return "l/v (ms)"
    for suffix, unit in PARAMETER_UNITS.items():
        if leaf.endswith(suffix):
            return f"{leaf.removesuffix(suffix).replace('_', ' ')} ({unit})"
    return f"{owner} {leaf}".replace("_", " ").strip()
