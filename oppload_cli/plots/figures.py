"""From files to a figure: which kind of plot suits what is given."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from oppload_cli.errors import ResultError
from oppload_cli.plots.heat import plot_heat
from oppload_cli.plots.line import plot_line
from oppload_cli.plots.polar import direction_tunings, plot_polar

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.figure import Figure

    from oppload_cli.results.tuning import Tuning

TUNING_KINDS = ("polar", "line", "heat")


@dataclass(frozen=True)
class Drawn:
    """A figure and what is to be said of it.

    Attributes
    ----------
    figure : Figure
        Not saved yet.
    lines : tuple of str
        Its numbers, for standard output.
    """

    figure: Figure
    lines: tuple[str, ...] = ()


def draw_tuning(
    tunings: Sequence[Tuning],
    kind: str | None = None,
    *,
    models: Sequence[str] = (),
    raw: bool = False,
    lplc2: str = "auto",
) -> Drawn:
    """Draw tuning tables.

    Parameters
    ----------
    tunings : sequence of Tuning
        At least one.
    kind : str, optional
        ``polar``, ``line`` or ``heat``; else what suits the swept parameters.
    models : sequence of str
        The models to draw; none for all.
    raw : bool
        In the models' own units.
    lplc2 : str
        ``10``, ``60``, ``none`` or ``auto``: the reference in a polar plot.

    Returns
    -------
    Drawn

    Raises
    ------
    ResultError
        If the tables do not suit the kind.
    """
    first = tunings[0]
    if kind is None:
        kind = "heat" if len(first.parameters) == 2 else "polar" if first.direction else "line"
    if kind == "polar":
        curves = direction_tunings(tunings, models, lplc2)
        title = first.name if len(tunings) == 1 else ""
        return Drawn(
            plot_polar(curves, raw=raw, title=title), tuple(curve.line() for curve in curves)
        )
    if kind == "line":
        return Drawn(plot_line(tunings, models, raw=raw))
    if len(tunings) > 1:
        raise ResultError(f"{tunings[1].path}: a heat map shows one table; plot them apart")
    return Drawn(plot_heat(first, models))
