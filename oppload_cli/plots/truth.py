"""The ground truth of a stimulus, drawn as a strip under response curves."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from oppload_cli.plots.style import FAINT, INK
from oppload_cli.stimulus.truth import read_ground_truth

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from oppload_cli.results.reading import Result

    Truth = dict[str, Any]


def find_truth(result: Result) -> Truth | None:
    """Read the ground truth that belongs to a result.

    Parameters
    ----------
    result : Result
        Its sidecar may name a file under ``stimulus.path``, or hold the content under
        ``stimulus``; else ``{stem}.stimulus.json`` may lie beside the result.

    Returns
    -------
    dict or None
        As :func:`oppload_cli.stimulus.ground_truth` gives it; None where there is none.

    Raises
    ------
    StimulusError
        If there is a file that is no ground truth.
    """
    stated = result.sidecar.get("stimulus")
    if isinstance(stated, dict):
        if isinstance(stated.get("frames"), list):
            return stated
        stated = stated.get("path")
    named = [Path(stated), result.path.parent / stated] if isinstance(stated, str) else []
    for path in (*named, result.path.with_name(f"{result.stem}.stimulus.json")):
        if path.is_file():
            return read_ground_truth(path)
    return None


def contact_of(truth: Truth | None) -> float | None:
    """Return the time of contact in seconds, if something approaches."""
    contact = truth.get("contact_time_s") if truth else None
    return float(contact) if isinstance(contact, int | float) else None


def draw_truth(axes: Axes, truth: Truth) -> None:
    """Draw the angular size of every object over time; looming is shaded.

    Parameters
    ----------
    axes : matplotlib.axes.Axes
        Where to draw.
    truth : dict
        The ground truth.
    """
    frames = truth["frames"]
    time = np.array([frame["time_s"] for frame in frames], float)
    looming = np.array([bool(frame["looming"]) for frame in frames])
    names = list(dict.fromkeys(thing["id"] for frame in frames for thing in frame["objects"]))
    for name in names:
        size = np.array([_size(frame, name) for frame in frames])
        if np.isfinite(size).any():
            axes.plot(time, size, color=INK, lw=1)
    axes.set_ylim(bottom=0)
    axes.fill_between(
        time, 0, 1, where=looming, transform=axes.get_xaxis_transform(), color=FAINT, alpha=0.25,
        lw=0, step="mid",
    )  # fmt: skip
    axes.set_ylabel("size (deg)")
    if looming.any():
        axes.set_title("grey: looming", loc="right", fontsize=6, color=INK, pad=2)


def _size(frame: dict[str, Any], name: str) -> float:
    thing = next((one for one in frame["objects"] if one["id"] == name), None)
    size = thing["angular_size_deg"] if thing and thing["visible"] else None
    return np.nan if size is None else float(size)
