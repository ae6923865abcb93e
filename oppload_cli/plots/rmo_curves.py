"""The plot of radial motion opponency over time."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from oppload_cli.errors import ResultError
from oppload_cli.models.columns import RMO
from oppload_cli.plots import style
from oppload_cli.plots.naming import labels_of
from oppload_cli.results.cells import check_numbers
from oppload_cli.results.result_files import BaseResult

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def plot_rmo(
    results: BaseResult | Sequence[BaseResult],
    *,
    labels: Sequence[str] = (),
    title: str | None = None,
    xlim: tuple[float, float] | None = None,
) -> tuple[Figure, list[Axes]]:
    """Draw RMO over time: the index, the mean and the largest RMO, and the share of ROM pairs.

    Parameters
    ----------
    results : Result or sequence of Result
        At most three, with three panels each.
    labels : sequence of str
        Names of the results; by default what differs between their names.
    title : str, optional
        Title of the figure.
    xlim : tuple of float, optional
        First and last time, in seconds.

    Returns
    -------
    matplotlib.figure.Figure, list of Axes
        The figure, not saved yet, and its panels from top to bottom.

    Raises
    ------
    ParameterError
        If the axis has no length in seconds, or shows no frame.
    ResultError
        If a result was made with ``--no-rmo``, has one frame only, a column is empty, or there are
        too many results.

    Examples
    --------
    >>> import oppload_cli as oppload
    >>> result = oppload.run("controls/looming-perspective")
    >>> figure, (index, mean, share) = oppload.plot_rmo(result)
    >>> index.get_ylabel()
    'RMO index'
    """
    results = style.as_list(results, BaseResult)
    style.check_title(title)
    if len(results) > 3:
        raise ResultError(
            f"{results[3].path}: one figure shows the RMO of at most 3 results; "
            "give fewer, or leave out --output"
        )
    for result in results:
        result.need_responses(())
        for name in (column.name for column in RMO):
            if name not in result.frames.columns:
                raise ResultError(
                    f"{result.path}: has no column '{name}'; run the input again without --no-rmo "
                    "(in Python without rmo=False)"
                )
            if np.isnan(check_numbers(result.path, result.frames, name)).all():
                raise ResultError(f"{result.path}: column '{name}' is empty; run it again")
    style.check_xlim([result.frames["time_s"].to_numpy(float) for result in results], xlim)
    heights = [1.2, 1, 0.8] * len(results)
    with style.styled_figure(style.COLUMN, 0.3 + 2.9 * len(results)) as figure:
        panels = style.panel_grid(figure, len(heights), 1, height_ratios=heights)
        for number, label in enumerate(labels_of(results, labels)):
            own_panels = panels[3 * number : 3 * number + 3]
            _draw(own_panels, results[number], xlim)
            style.spread_ticks(own_panels[-1], style.PANEL_WIDTH)
            own_panels[0].set_title(style.wrapped(label, style.TITLE_WIDTH))
        panels[-1].set_xlabel("time (s)")
        style.write_title(figure, title)
    return figure, panels


def _draw(panels: Sequence[Axes], result: BaseResult, xlim: tuple[float, float] | None) -> None:
    time, index, mean, largest, share = (
        result.frames[name].to_numpy(float)
        for name in ("time_s", "rmo_index", "rmo_mean", "rmo_max", "rom_share")
    )
    upper, middle, lower = panels
    # As on the HTML pages; OppLoD and D-LGMD have other colours.
    index_colour, mean_colour = style.CYCLE[3], style.CYCLE[4]
    upper.axhline(0, color=style.FAINT, lw=0.6)
    upper.plot(time, index, color=index_colour)
    upper.set(ylim=(-1.08, 1.08), yticks=[-1, 0, 1], ylabel="RMO index")
    middle.plot(time, mean, color=mean_colour, linestyle="-", label="mean of ROM pairs")
    middle.plot(time, largest, color=mean_colour, lw=0.9, linestyle="--", label="max of ROM pairs")
    middle.set(ylim=(-0.04, 1.08), ylabel="RMO")
    style.legend_over(middle, ncols=2, borderpad=0)
    lower.plot(time, 100 * share, color=style.INK)
    lower.set_ylim(bottom=0)
    lower.set_ylabel("ROM pairs (%)")
    for panel in panels:
        panel.set_xlim(xlim or (time[0], time[-1]))
    for panel in (upper, middle):
        panel.tick_params(labelbottom=False)
