"""Response curves over time."""

from __future__ import annotations

from typing import TYPE_CHECKING

import matplotlib as mpl
import numpy as np

from oppload_cli.plots.style import COLOURS, NAMES, STYLE, new_figure

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from oppload_cli.results.reading import Result

ALARM_TOP, ALARM_STEP = 1.16, 0.06


def plot_curves(results: Sequence[Result]) -> Figure:
    """Draw the normalised responses of every model, one panel per result.

    Parameters
    ----------
    results : sequence of Result
        At least one.

    Returns
    -------
    matplotlib.figure.Figure
        Each curve is divided by its own peak, which the legend states.
    """
    with mpl.rc_context(STYLE):
        figure = new_figure(7.2, 0.4 + 2.4 * len(results))
        panels = figure.subplots(len(results), 1, squeeze=False)[:, 0]
        for panel, result in zip(panels, results, strict=True):
            draw_curves(panel, result)
        panels[-1].set_xlabel("time (s)")
    return figure


def draw_curves(axes: Axes, result: Result) -> None:
    """Draw one result: the curve, peak and alarms of each of its models.

    Parameters
    ----------
    axes : matplotlib.axes.Axes
        Where to draw.
    result : Result
        What to draw.
    """
    time = result.frames["time_s"].to_numpy(float)
    for order, model in enumerate(result.models):
        _draw_model(axes, result, model, time)
        _draw_alarms(axes, result, model, time, ALARM_TOP - order * ALARM_STEP)
    axes.set_title(result.title)
    axes.set_ylabel("response / peak")
    axes.set_ylim(-0.03, ALARM_TOP + 0.05)
    axes.set_yticks([0, 0.5, 1])
    axes.margins(x=0.01)
    axes.legend(loc="upper left", bbox_to_anchor=(1, 1))


def _draw_model(axes: Axes, result: Result, model: str, time: NDArray[np.float64]) -> None:
    response = result.frames[f"{model}_response"].to_numpy(float)
    name, colour = NAMES[model], COLOURS[model]
    if not np.isfinite(response).any() or np.nanmax(response) <= 0:
        axes.plot(time, np.where(np.isfinite(response), 0.0, np.nan), color=colour)
        axes.lines[-1].set_label(f"{name}\nno response")
        return
    peak = int(np.nanargmax(response))
    frame = int(result.frames["frame"].iloc[peak])
    axes.plot(
        time,
        response / response[peak],
        color=colour,
        label=f"{name}\npeak {response[peak]:.3g}\nat frame {frame}",
    )
    # Hollow, so that two peaks in one place are both seen.
    axes.plot(time[peak], 1, "o", markersize=9 - 3 * (model == "opplod"), mfc="none", mec=colour)


def _draw_alarms(
    axes: Axes, result: Result, model: str, time: NDArray[np.float64], height: float
) -> None:
    """Draw a bar over the frames with the alarm on."""
    column = f"{model}_alarm"
    if column not in result.frames.columns:
        return
    on = result.frames[column].to_numpy(float) == 1
    if not on.any():
        return
    step = float(np.median(np.diff(time))) if len(time) > 1 else 0.0
    edges = np.flatnonzero(np.diff(np.concatenate(([False], on, [False])).astype(int)))
    spans = [(time[a], time[b - 1] - time[a] + step) for a, b in edges.reshape(-1, 2)]
    axes.broken_barh(
        spans, (height - 0.02, 0.04), facecolors=COLOURS[model], label=f"{NAMES[model]} alarm"
    )
