"""Where the winning units were, over a still of the video."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import matplotlib as mpl
import numpy as np
from matplotlib.patches import Rectangle

from oppload_cli.errors import ResultError
from oppload_cli.plots.style import COLOURS, COLUMN, INK, SHADES, STYLE, new_figure
from oppload_cli.results.reading import check_numbers
from oppload_cli.video.source import open_video
from oppload_cli.video.span import Position, Span

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from oppload_cli.results.reading import Result

    Still = NDArray[np.float32]

PLACES = ("opplod_x", "opplod_y", "opplod_width", "opplod_height")
WEAKEST = 0.05


def still_of(result: Result, video: str | None = None) -> Still | None:
    """Read the frame of the peak from the video that a result was made of.

    Parameters
    ----------
    result : Result
        With its sidecar, which names the input.
    video : str, optional
        The input, where it has moved.

    Returns
    -------
    ndarray of float32, shape (height, width), or None
        Luminance at the source's size; None where the input is not known.

    Raises
    ------
    SourceError
        If the video cannot be read.
    ResultError
        If it ends before that frame.
    """
    name = video or result.sidecar.get("input", {}).get("name")
    if not isinstance(name, str) or (video is None and not Path(name).exists()):
        return None
    peak = int(result.frames["frame"].iloc[_peak(result)])
    span = Span(start=Position(frame=peak), duration=Position(frame=1))
    with open_video(name, height=None, span=span) as source:
        for frame in source:
            return frame.luma
    raise ResultError(f"{name}: ends before frame {peak}, so it is not the input of {result.path}")


def plot_map(result: Result, still: Still | None) -> Figure:
    """Draw the centre of every winning unit, and its field at the peak.

    Parameters
    ----------
    result : Result
        With the places of OppLoD.
    still : ndarray or None
        A frame to draw on, shape (height, width); None draws on white.

    Returns
    -------
    matplotlib.figure.Figure
        A dot per frame of at least 5 % of the peak: its area is the response, its
        shade the time.

    Raises
    ------
    ResultError
        If the result has no places.
    """
    result.need(("opplod_response", *PLACES))
    x, y, width, height = (check_numbers(result.path, result.frames, name) for name in PLACES)
    response = result.frames["opplod_response"].to_numpy(float)
    best = _peak(result)
    if not np.isfinite(x[best]):
        raise ResultError(
            f"{result.path}: column 'opplod_x' is empty at the peak, as OppLoD never responded"
        )
    shown = np.isfinite(x) & (response >= WEAKEST * response[best])
    time = result.frames["time_s"].to_numpy(float)
    with mpl.rc_context(STYLE):
        rows, columns = _size(result, still)
        figure = new_figure(COLUMN, 0.85 + min(4.5, (COLUMN - 0.5) * rows / columns))
        axes = figure.subplots()
        if still is not None:
            axes.imshow(still, cmap="gray", vmin=-0.4, vmax=1.1, extent=(0, columns, rows, 0))
        dots = axes.scatter(
            (x + width / 2)[shown], (y + height / 2)[shown], c=time[shown], cmap=SHADES,
            s=6 + 60 * response[shown] / response[best], edgecolors="white", linewidths=0.25,
        )  # fmt: skip
        axes.add_patch(
            Rectangle(
                (x[best], y[best]),
                width[best],
                height[best],
                fill=False,
                lw=1.2,
                ec=COLOURS["opplod"],
            )
        )
        frame = int(result.frames["frame"].iloc[best])
        axes.set_title(f"{result.title}\nbox: winning field at the peak, frame {frame}", fontsize=7)
        axes.set(
            xlim=(0, columns), ylim=(rows, 0), xlabel="x (px)", ylabel="y (px)", aspect="equal"
        )
        bar = figure.colorbar(dots, ax=axes, orientation="horizontal", pad=0.02, aspect=40)
        bar.set_label("time (s); area of a dot: response", color=INK)
    return figure


def _peak(result: Result) -> int:
    result.need(("opplod_response",))
    return int(np.nanargmax(result.frames["opplod_response"].to_numpy(float)))


def _size(result: Result, still: Still | None) -> tuple[int, int]:
    if still is not None:
        return still.shape[0], still.shape[1]
    facts = result.sidecar.get("input", {})
    try:
        return int(facts["height"]), int(facts["width"])
    except (KeyError, TypeError, ValueError):
        frames = result.frames
        right = (frames["opplod_x"] + frames["opplod_width"]).max()
        bottom = (frames["opplod_y"] + frames["opplod_height"]).max()
        return int(bottom), int(right)
