"""Tuning over direction, in polar form."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import matplotlib as mpl
import numpy as np
from matplotlib.ticker import MaxNLocator

from oppload_cli.errors import ResultError
from oppload_cli.plots.selectivity import Selectivity, selectivity, whole_circle
from oppload_cli.plots.style import (
    COLOURS,
    COLUMN,
    DASHES,
    FAINT,
    LPLC2,
    NAMES,
    STYLE,
    UNITS,
    new_figure,
)
from oppload_cli.reference.lplc2 import BAR_WIDTHS, bar_tuning

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.figure import Figure
    from matplotlib.projections.polar import PolarAxes
    from numpy.typing import NDArray

    from oppload_cli.results.tuning import Tuning


@dataclass(frozen=True)
class DirectionTuning:
    """One closed or open curve of a polar plot.

    Attributes
    ----------
    name : str
        For the legend.
    angles_deg, responses : ndarray, shape (n,)
        In rising order of angle.
    unit : str
        Of the responses.
    look : dict
        Line properties of matplotlib.
    """

    name: str
    angles_deg: NDArray[np.float64]
    responses: NDArray[np.float64]
    unit: str
    look: dict[str, Any]

    @property
    def numbers(self) -> Selectivity:
        """Peak and selectivity."""
        return selectivity(self.angles_deg, self.responses)

    def line(self) -> str:
        """Return the numbers in one line, for standard output.

        Returns
        -------
        str
        """
        n = self.numbers
        if n.axis_index is None:
            return f"{self.name}: no response"
        index = "not shown" if n.direction_index is None else f"{n.direction_index:.3f}"
        return (
            f"{self.name}: peak {n.peak:.4g} ({self.unit}) at {n.preferred_deg:g} deg, "
            f"direction selectivity index {index}, axis selectivity index {n.axis_index:.3f}, "
            f"least response {n.least:.3g} of the peak"
        )


def direction_tunings(
    tunings: Sequence[Tuning], models: Sequence[str] = (), lplc2: str = "auto"
) -> list[DirectionTuning]:
    """Collect the curves of a polar plot.

    Parameters
    ----------
    tunings : sequence of Tuning
        Tables over a direction.
    models : sequence of str
        The models to draw; none for all.
    lplc2 : str
        Width of the bar whose LPLC2 reference is overlaid, ``10`` or ``60``;
        ``none``; or ``auto``: that of the stimulus's name.

    Returns
    -------
    list of DirectionTuning

    Raises
    ------
    ResultError
        If a table has no direction, more than one parameter, or not the model.
    """
    made = [
        _of_model(tuning, model, number, len(tunings))
        for number, tuning in enumerate(tunings)
        for model in models or tuning.models
    ]
    width = _bar_width(tunings) if lplc2 == "auto" else int(lplc2) if lplc2.isdigit() else None
    reference = bar_tuning(width) if width else {}
    if reference:
        angles, values = whole_circle(np.array(list(reference)), np.array(list(reference.values())))
        look = {"color": LPLC2, "marker": "s", "markersize": 2.5, "lw": 0.9, "linestyle": ":"}
        made.append(DirectionTuning(f"LPLC2, {width} deg bar", angles, values, "of the loom", look))
    return made


def plot_polar(curves: Sequence[DirectionTuning], *, raw: bool = False, title: str = "") -> Figure:
    """Draw tuning over direction.

    Parameters
    ----------
    curves : sequence of DirectionTuning
        At least one.
    raw : bool
        A plot per curve in its own unit, instead of all over their peaks in one.
    title : str
        Of the figure.

    Returns
    -------
    matplotlib.figure.Figure
    """
    groups = [[curve] for curve in curves] if raw else [list(curves)]
    with mpl.rc_context(STYLE):
        figure = new_figure(COLUMN, 0.1 + 3.3 * len(groups) + 0.13 * len(curves))
        axes = figure.subplots(len(groups), 1, squeeze=False, subplot_kw={"projection": "polar"})[
            :, 0
        ]
        for panel, group in zip(axes, groups, strict=True):
            draw_polar(panel, group, raw=raw)
        if title:
            figure.suptitle(title, fontsize=8, x=0.02, ha="left")
    return figure


def draw_polar(axes: PolarAxes, curves: Sequence[DirectionTuning], *, raw: bool = False) -> None:
    """Draw curves into one polar plot.

    Parameters
    ----------
    axes : PolarAxes
        Where to draw.
    curves : sequence of DirectionTuning
        What to draw.
    raw : bool
        In their own unit instead of over their peaks.
    """
    for curve in curves:
        peak = curve.numbers.peak
        over = 1.0 if raw or peak <= 0 else peak
        angles, values = _closed(curve.angles_deg, curve.responses / over)
        about = f"peak {peak:.3g} ({curve.unit})" if peak > 0 else "no response"
        name = curve.name if raw else f"{curve.name}, {about}"
        axes.plot(np.deg2rad(angles), values, label=name, **curve.look)
    axes.set_thetagrids(range(0, 360, 45), [f"{angle}°" for angle in range(0, 360, 45)])
    axes.set_rlabel_position(22.5)
    axes.set_ylim(bottom=0)
    axes.yaxis.set_major_locator(MaxNLocator(3))
    if not raw:
        axes.set_rticks([0.5, 1])
        axes.set_ylim(0, 1.08)
    axes.grid(color=FAINT, lw=0.4)
    axes.spines["polar"].set_color(FAINT)
    axes.tick_params(pad=0)
    label = f"response ({curves[0].unit})" if raw else "response / peak"
    axes.set_xlabel(f"radius: {label}; angle: direction of motion")
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.17), borderaxespad=0)


def _of_model(tuning: Tuning, model: str, number: int, count: int) -> DirectionTuning:
    direction = tuning.direction
    if direction is None:
        raise ResultError(
            f"{tuning.path}: has no column of a direction, such as bar.axis_deg; draw --kind line"
        )
    if len(tuning.parameters) > 1:
        other = next(name for name in tuning.parameters if name != direction)
        raise ResultError(f"{tuning.path}: column '{other}' is swept too; draw --kind heat")
    rows = tuning.of(model)
    if rows.empty:
        raise ResultError(f"{tuning.path}: column 'model' never holds '{model}'; leave it out")
    angles, values = rows[direction].to_numpy(float) % 360, rows["peak"].to_numpy(float)
    order = np.argsort(angles, kind="stable")
    angles, values = angles[order], values[order]
    if tuning.symmetric:
        angles, values = whole_circle(angles, values)
    name = NAMES[model] if count == 1 else f"{NAMES[model]}, {tuning.name.rpartition('/')[2]}"
    look = {
        "color": COLOURS[model], "linestyle": DASHES[number % len(DASHES)],
        "marker": "o", "markersize": 2.2,
    }  # fmt: skip
    return DirectionTuning(name, angles, values, UNITS[model], look)


def _closed(
    angles: NDArray[np.float64], values: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Join the ends where directions go all the way round."""
    gaps = np.diff(np.append(angles, angles[0] + 360))
    if len(angles) < 3 or gaps[-1] > 1.01 * max(gaps[:-1]):
        return angles, values
    return np.append(angles, angles[0]), np.append(values, values[0])


def _bar_width(tunings: Sequence[Tuning]) -> int | None:
    """Return the width of the expanding bar that the names speak of, if all agree."""
    found = {re.search(r"bar-(?:expand-)?(\d+)$", tuning.name) for tuning in tunings}
    widths = {int(match[1]) if match else None for match in found}
    width = widths.pop() if len(widths) == 1 else None
    return width if width in BAR_WIDTHS else None
