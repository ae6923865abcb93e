"""Finds and reads the ground truth of a video, and checks that it belongs to the video."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from oppload_cli import stimulus
from oppload_cli.errors import StimulusError
from oppload_cli.files.reading import is_file
from oppload_cli.video.inputs import GROUND_TRUTH

if TYPE_CHECKING:
    from collections.abc import Mapping

    from oppload_cli.results.reading import BaseResult

    Truth = dict[str, Any]


_FACTS = ("name", "looming", "contact_time_s", "display")  # the facts that a sidecar keeps
# Differences that are allowed. Scaled videos have even sides, and so another ratio of the sides.
# A video may also be cut by a few frames.
_OTHER_SIDES = 0.03  # as a share of the ratio of the sides
_OTHER_LENGTH = 0.1  # as a share of the frames
_FEW_FRAMES = 5


def read_truth(path: Path, width: Any, height: Any, frames: Any = None) -> Truth:
    """Read the ground truth beside a video.

    A video may have been scaled, and cut by a few frames. So it counts as another video only if the
    ratio of its sides differs by more than 3 %, or if its number of frames differs by more than a
    tenth and by more than 5 frames.

    Parameters
    ----------
    path : Path
        The file.
    width, height, frames : int or None
        Sides of the displayed video, and its declared number of frames. They come from a sidecar:
        a value that is not a number above 0 is not compared.

    Raises
    ------
    StimulusError
        If the file is not a ground truth, or belongs to another video.
    """
    truth = stimulus.read_ground_truth(path)
    fault = _fault(truth, width, height, frames)
    if fault:
        raise StimulusError(f"{path}: {fault}")
    return truth


def facts_of_truth(path: Path, truth: Mapping[str, Any]) -> dict[str, Any]:
    """Return the main facts of a ground truth and its file, for the sidecar."""
    return {"path": str(path), **{key: truth[key] for key in _FACTS}}


def find_truth(result: BaseResult) -> Truth | None:
    """Read the ground truth that belongs to a result.

    Parameters
    ----------
    result : Result
        Its sidecar may have the path of a file under ``stimulus.path``, or the content under
        ``stimulus``. Otherwise the file ``{stem}.stimulus.json`` may be beside the result.

    Returns
    -------
    dict or None
        None if there is no ground truth, or if the run left it out according to the sidecar.

    Raises
    ------
    StimulusError
        If the file is not a ground truth, or belongs to another video.
    """
    stated = result.sidecar.get("stimulus")
    if isinstance(stated, dict):
        if isinstance(stated.get("frames"), list):
            return stated
        if "error" in stated:
            return None
        stated = stated.get("path")
    named = [Path(stated), result.path.parent / stated] if isinstance(stated, str) else []
    facts = result.part("input")
    for path in (*named, result.path.with_name(result.stem + GROUND_TRUTH)):
        if is_file(path):
            shown = (facts.get(name) for name in ("width", "height", "frames_declared"))
            return read_truth(path, *shown)
    return None


def usable_truth(result: BaseResult) -> Truth | None:
    """Return the ground truth of a result; None if it has no usable one."""
    try:
        return find_truth(result)
    except StimulusError:  # `truth_fault` gives the reason
        return None


def truth_fault(result: BaseResult) -> str:
    """Return a sentence if a ground truth exists that cannot be used, else an empty text."""
    error = result.part("stimulus").get("error")
    if isinstance(error, str):
        return f"its ground truth is left out ({error})"
    try:
        find_truth(result)
    except StimulusError as fault:
        return f"its ground truth is left out ({fault})"
    return ""


def _fault(truth: Truth, width: Any, height: Any, frames: Any) -> str:
    missing = next((key for key in _FACTS if key not in truth), None)
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
