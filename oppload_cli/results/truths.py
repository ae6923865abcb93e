"""Whether a ground truth that lies beside a video is that of this video."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Mapping

FACTS = ("name", "looming", "contact_time_s", "display")  # that a sidecar keeps
_OTHER_SIDES = 0.03  # of the ratio of the sides: scaled videos have even widths and heights
_OTHER_LENGTH = 0.1  # of the frames: a video may be cut by a few
_FEW_FRAMES = 5


def fault_of_truth(truth: Mapping[str, Any], width: Any, height: Any, frames: Any = None) -> str:
    """Return in words why a ground truth is not that of a video; empty where it may be.

    A video may have been scaled, and cut by a few frames. So its sides have another ratio if that
    differs by more than 3 %, and its number of frames is another one if it differs by more than a
    tenth, and by more than 5 frames.

    Parameters
    ----------
    truth : mapping
        As :func:`oppload_cli.stimulus.ground_truth` gives it.
    width, height : int or None
        Of the video as it is displayed; from a sidecar, so that anything else than a number above 0
        is not compared.
    frames : int or None
        That the video declares; likewise.
    """
    missing = next((key for key in FACTS if key not in truth), None)
    if missing:
        return f"lacks its {missing}; generate the stimulus again"
    try:
        display, length = truth["display"], len(truth["frames"])
        wide, high = float(display["width"]), float(display["height"])
        ratio = wide / high
    except (KeyError, TypeError, ValueError, ZeroDivisionError):
        return "lacks the size of its display; generate the stimulus again"
    own, other = f"{wide:g} x {high:g} and {length} frames", f"{width} x {height}"
    known = isinstance(width, int) and isinstance(height, int) and width > 0 and height > 0
    if known and abs(width / height / ratio - 1) > _OTHER_SIDES:
        return f"is that of another video, of {own}: this one has {other}"
    most = max(_FEW_FRAMES, _OTHER_LENGTH * length)
    if isinstance(frames, int) and frames > 0 and abs(frames - length) > most:
        return f"is that of another video, of {own}: this one has {frames} frames"
    return ""
