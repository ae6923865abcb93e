"""The plot of the places of winning units, over a frame of the video."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.patches import Rectangle

from oppload_cli.errors import ParameterError, ResultError
from oppload_cli.models.detector import Box, Detector
from oppload_cli.models.registry import detector_named, detectors, placing_detector
from oppload_cli.plots import style
from oppload_cli.results.alarm_log import times
from oppload_cli.results.cells import check_numbers
from oppload_cli.results.result_files import BaseResult, known_threshold
from oppload_cli.results.truths import usable_truth
from oppload_cli.video.source import open_video
from oppload_cli.video.span import Position, Span

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    Still = NDArray[np.float32]


def still_of(result: BaseResult, video: str, *, model: str | None = None) -> Still:
    """Read the frame of the peak from the video of a result.

    Parameters
    ----------
    result : Result
        A result with the places of a detector.
    video : str
        The name of the video, such as :func:`oppload_cli.results.result_files.find_video` returns.
    model : str, optional
        The detector of the peak; by default the first detector of the result that has places.

    Returns
    -------
    ndarray of float32, shape (height, width)
        Luminance at the source's size.

    Raises
    ------
    SourceError
        If the video cannot be read.
    ResultError
        If the video ends before the peak, or if the result has no places of the detector.
    """
    peak = int(result.frames["frame"].iloc[_peak_row(result, _detector(result, model))])
    span = Span(start=Position(frame=peak), duration=Position(frame=1))
    with open_video(video, height=None, span=span) as source:
        for frame in source:
            return frame.luma
    raise ResultError(f"{video}: ends before frame {peak}, so it is not the input of {result.path}")


def plot_places(
    result: BaseResult,
    still: Still | None = None,
    *,
    title: str | None = None,
    model: str | None = None,
) -> tuple[Figure, list[Axes]]:
    """Draw the centres of the winning units, and the looming object's box at the peak.

    Each frame with a response of at least 5 % of the peak has a dot. The dot's area shows the
    response, its colour the time.

    Parameters
    ----------
    result : Result
        A result with the places of a detector.
    still : ndarray of float32, shape (height, width), optional
        The luminance of a frame to draw on, 0 to 1, of any size, such as the `luma` of a
        :class:`Frame`; by default the background is white.
    title : str, optional
        Title of the figure; by default the input's name.
    model : str, optional
        The detector whose places are drawn; by default the first of the result that has places.

    Returns
    -------
    matplotlib.figure.Figure, list of Axes
        The figure, not saved yet, and its panel.

    Raises
    ------
    ParameterError
        If it is no result, or `still` is not of a float type.
    ResultError
        If the result has no places of the detector, or is too short for a response.

    Examples
    --------
    >>> import oppload_cli as oppload
    >>> result = oppload.run("controls/looming-perspective", rmo=False)
    >>> figure, (panel,) = oppload.plot_places(result, title="where it looms")
    >>> panel.get_xlabel()
    'x (px)'
    """
    if isinstance(result, list | tuple):
        raise ParameterError("a map shows one result; draw each result of the list on its own")
    style.check_drawn(result, BaseResult)
    style.check_title(title)
    kind = getattr(still, "dtype", type(still))
    if still is not None and getattr(kind, "kind", "") != "f":
        raise ParameterError(f"still must be luminance from 0 to 1, not of type {kind}")
    detector = _detector(result, model)
    places = [f"{detector.name}_{name}" for name in ("unit_x", "unit_y", *Box._fields)]
    result.need(places)
    result.need_responses([detector.name])
    x, y, *box = (check_numbers(result.path, result.frames, name) for name in places)
    response = result.frames[f"{detector.name}_response"].to_numpy(float)
    best = _peak_row(result, detector)
    if not np.isfinite(x[best]):
        raise ResultError(
            f"{result.path}: column '{places[0]}' is empty at the peak, as {detector.label} never "
            "responded"
        )
    shown = np.isfinite(x) & (response >= 0.05 * response[best])
    time = result.frames["time_s"].to_numpy(float)
    rows, columns = _size(result, detector, still)
    height = 0.85 + min(4.5, (style.COLUMN - 0.5) * rows / columns)
    with style.styled_figure(style.COLUMN, height) as figure:
        axes = figure.subplots()
        if still is not None:
            axes.imshow(still, cmap="gray", vmin=-0.4, vmax=1.1, extent=(0, columns, rows, 0))
        dots = axes.scatter(
            x[shown], y[shown], c=time[shown], cmap=style.SHADES,
            s=6 + 60 * response[shown] / response[best], edgecolors="white", linewidths=0.25,
        )  # fmt: skip
        frame = int(result.frames["frame"].iloc[best])
        left, top, width, height = (side[best] for side in box)
        if np.isfinite(left):
            axes.add_patch(
                Rectangle((left, top), width, height, fill=False, lw=1.2, ec=detector.colour)
            )
        box_text = "box: looming object" if np.isfinite(left) else "no looming object"
        text = f"{title or result.title}\n{detector.label}, peak in frame {frame}; {box_text}"
        text += _over_threshold(result, detector.name, best)
        axes.set_title(style.wrapped(text, style.TITLE_WIDTH), fontsize=7)
        axes.set(
            xlim=(0, columns), ylim=(rows, 0), xlabel="x (px)", ylabel="y (px)", aspect="equal"
        )
        bar = figure.colorbar(dots, ax=axes, orientation="horizontal", pad=0.02, aspect=40)
        bar.set_label("time (s); area of a dot: response", color=style.INK)
    return figure, [axes]


def _over_threshold(result: BaseResult, detector: str, row: int) -> str:
    """Return the peak divided by its threshold in words, as the dots of noise can be large too."""
    threshold = known_threshold(result, detector)
    if threshold is None or np.isnan(threshold[row]):
        return ""
    ratio = float(result.frames[f"{detector}_response"].iloc[row]) / threshold[row]
    return f"\npeak: {times(ratio)} times the threshold of the alarm"


def _detector(result: BaseResult, model: str | None) -> type[Detector]:
    """Return the detector `model`, or the first one of the result, that has places."""
    if model is not None:
        detector = detector_named(model)
        result.need([f"{model}_response"])
        if not detector.places:
            raise ResultError(f"{result.path}: {detector.label} has no places; leave the model out")
        return detector
    first = placing_detector(result.models)
    if first is None:
        placing = next(name for name, detector in detectors().items() if detector.places)
        raise ResultError(
            f"{result.path}: holds no detector with places; run one that has them, such as "
            f"{placing}"
        )
    return first


def _peak_row(result: BaseResult, detector: type[Detector]) -> int:
    response = f"{detector.name}_response"
    return int(np.nanargmax(result.frames[response].to_numpy(float)))


def _size(result: BaseResult, detector: type[Detector], still: Still | None) -> tuple[int, int]:
    """Return height and width of the source, or of `still`, or of the part that places reach."""
    facts = result.part("input") or (usable_truth(result) or {}).get("display", {})
    try:
        return int(facts["height"]), int(facts["width"])
    except (KeyError, TypeError, ValueError):
        if still is not None:
            return still.shape[0], still.shape[1]
        frames, name = result.frames, detector.name
        right = np.fmax(frames[f"{name}_unit_x"], frames[f"{name}_x"] + frames[f"{name}_width"])
        bottom = np.fmax(frames[f"{name}_unit_y"], frames[f"{name}_y"] + frames[f"{name}_height"])
        return int(bottom.max()), int(right.max())
