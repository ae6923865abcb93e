"""Radial motion opponency over time."""

from __future__ import annotations

from typing import TYPE_CHECKING

import matplotlib as mpl
import numpy as np

from oppload_cli.errors import ResultError
from oppload_cli.plots.style import COLUMN, CYCLE, FAINT, STYLE, new_figure
from oppload_cli.results.reading import check_numbers

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from oppload_cli.results.reading import Result

COLUMNS = ("rmo_index", "rmo_mean", "rmo_max", "rom_share", "rom_pairs", "flow_vectors")


def plot_rmo(results: Sequence[Result]) -> Figure:
    """Draw the RMO columns over time, three panels per result.

    Parameters
    ----------
    results : sequence of Result
        Of runs with RMO.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    ResultError
        If a result was made with ``--no-rmo``.
    """
    for result in results:
        missing = next((name for name in COLUMNS if name not in result.frames.columns), None)
        if missing:
            raise ResultError(
                f"{result.path}: has no column '{missing}'; run the input again without --no-rmo"
            )
        for name in COLUMNS:
            if np.isnan(check_numbers(result.path, result.frames, name)).all():
                raise ResultError(f"{result.path}: column '{name}' is empty; run it again")
    with mpl.rc_context(STYLE):
        figure = new_figure(COLUMN, 0.3 + 3.1 * len(results))
        panels = figure.subplots(
            3 * len(results), 1, squeeze=False, height_ratios=[1.2, 1, 0.8] * len(results)
        )[:, 0]
        for number, result in enumerate(results):
            draw_rmo(list(panels[3 * number : 3 * number + 3]), result)
        panels[-1].set_xlabel("time (s)")
    return figure


def draw_rmo(panels: Sequence[Axes], result: Result) -> None:
    """Draw one result: index, mean and largest RMO, and how much motion there was.

    Parameters
    ----------
    panels : sequence of Axes
        Three of them.
    result : Result
        What to draw.
    """
    frames = result.frames
    time = frames["time_s"].to_numpy(float)
    index, size, count = panels
    index.axhline(0, color=FAINT, lw=0.6)
    index.plot(time, _values(result, "rmo_index"), color=CYCLE[0])
    index.set_ylim(-1.08, 1.08)
    index.set_yticks([-1, 0, 1])
    index.set_ylabel("RMO index")
    index.set_title(result.title)
    for name, colour, dash in (("rmo_mean", CYCLE[1], "-"), ("rmo_max", CYCLE[2], "--")):
        label = name.replace("rmo_", "") + " of ROM pairs"
        size.plot(time, _values(result, name), color=colour, linestyle=dash, label=label)
    size.set_ylim(-0.04, 1.08)
    size.set_ylabel("RMO")
    size.legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=2, borderpad=0, borderaxespad=0.1)
    count.plot(time, 100 * _values(result, "rom_share"), color=CYCLE[3])
    count.set_ylim(bottom=0)
    count.set_ylabel("ROM pairs (%)")
    for panel in panels:
        panel.set_xlim(time[0], time[-1])
    for panel in panels[:2]:
        panel.tick_params(labelbottom=False)


def _values(result: Result, name: str) -> NDArray[np.float64]:
    return result.frames[name].to_numpy(float)
