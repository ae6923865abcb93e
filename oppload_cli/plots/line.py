"""Tuning over one parameter, as lines."""

from __future__ import annotations

from typing import TYPE_CHECKING

import matplotlib as mpl

from oppload_cli.errors import ResultError
from oppload_cli.plots.style import (
    COLOURS,
    COLUMN,
    DASHES,
    NAMES,
    STYLE,
    UNITS,
    described,
    new_figure,
)
from oppload_cli.results.reading import check_numbers

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.figure import Figure

    from oppload_cli.results.tuning import Tuning


def plot_line(
    tunings: Sequence[Tuning], models: Sequence[str] = (), *, raw: bool = False
) -> Figure:
    """Draw the peak response over a swept parameter.

    Parameters
    ----------
    tunings : sequence of Tuning
        Tables over one and the same parameter.
    models : sequence of str
        The models to draw; none for all.
    raw : bool
        In the model's own unit, a panel per model, instead of over the largest peak.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    ResultError
        If the tables are not over one and the same parameter of numbers.
    """
    parameter = _parameter(tunings)
    names = list(models) or list(dict.fromkeys(m for each in tunings for m in each.models))
    groups = [[name] for name in names] if raw else [names]
    with mpl.rc_context(STYLE):
        count = len(names) * len(tunings)
        figure = new_figure(COLUMN, 0.3 + len(groups) * 1.9 + 0.13 * count)
        axes = figure.subplots(len(groups), 1, squeeze=False, sharex=True)[:, 0]
        for panel, group in zip(axes, groups, strict=True):
            for number, tuning in enumerate(tunings):
                for model in group:
                    rows = tuning.of(model)
                    largest = float(rows["peak"].max()) if len(rows) else 0.0
                    over = 1.0 if raw or largest <= 0 else largest
                    label = f"{NAMES[model]}, largest peak {largest:.3g} ({UNITS[model]})"
                    if len(tunings) > 1:
                        label = f"{tuning.name.rpartition('/')[2]}: {label}"
                    panel.plot(
                        rows[parameter], rows["peak"] / over, "o", markersize=3,
                        color=COLOURS[model], linestyle=DASHES[number % 4], label=label,
                    )  # fmt: skip
            unit = f"peak response ({UNITS[group[0]]})" if raw else "peak / largest peak"
            panel.set_ylabel(unit)
            panel.set_ylim(bottom=0)
            panel.legend(loc="lower left", bbox_to_anchor=(0, 1), borderaxespad=0.1, borderpad=0.1)
        axes[-1].set_xlabel(described(parameter))
        if len(tunings) == 1:
            axes[0].set_title(tunings[0].name, pad=6 + 10 * len(groups[0]))
    return figure


def _parameter(tunings: Sequence[Tuning]) -> str:
    first = tunings[0]
    if len(first.parameters) > 1:
        raise ResultError(
            f"{first.path}: columns {' and '.join(first.parameters)} are swept; draw --kind heat"
        )
    parameter = first.parameters[0]
    for tuning in tunings:
        if tuning.parameters != first.parameters:
            raise ResultError(
                f"{tuning.path}: has no column '{parameter}' as {first.path} has; plot them apart"
            )
        check_numbers(tuning.path, tuning.rows, parameter)
    return parameter
