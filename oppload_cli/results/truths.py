"""Finds and reads the ground truth of a video, and checks that it belongs to the video."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from oppload_cli import stimulus
from oppload_cli.errors import StimulusError
from oppload_cli.files.reading import is_file
from oppload_cli.video.inputs import GROUND_TRUTH

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from oppload_cli.results.result_files import BaseResult

    Truth = dict[str, Any]


_FACTS = ("name", "looming", "contact_time_s", "display")  # the facts that a sidecar keeps


def read_truth(path: Path, width: Any, height: Any, frames: Any = None) -> Truth:
    """Read the ground truth of a video, and check that it belongs to this video.

    It belongs to another video if the ratio of the sides differs by more than 3 %, or if the number
    of frames differs by more than a tenth and by more than 5 frames.

    Parameters
    ----------
    path : Path
        The ground truth.
    width, height, frames : int or None
        Sides of the displayed video, and its declared number of frames. A value that is not an
        integer above 0, as in a damaged sidecar, is not compared.

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
    """Return the path and the main facts of a ground truth, for the sidecar."""
    return {"path": str(path), **{key: truth[key] for key in _FACTS}}


def find_truth(result: BaseResult) -> Truth | None:
    """Return the ground truth of a result; None if there is none, or if the run left it out.

    The sidecar may have the ground truth under ``stimulus``, or the path of its file under
    ``stimulus.path``. Otherwise ``NAME.stimulus.json`` may be beside the result. Raises
    StimulusError if the file is not a ground truth, or belongs to another video.
    """
    stated = result.part("stimulus")
    if isinstance(stated.get("frames"), list):
        return stated
    if "error" in stated:
        return None
    path = stated.get("path")
    candidates = [Path(path), result.path.parent / path] if isinstance(path, str) else []
    facts = result.part("input")
    for path in (*candidates, result.path.with_name(result.stem + GROUND_TRUTH)):
        if is_file(path):
            sides = (facts.get(name) for name in ("width", "height", "frames_declared"))
            return read_truth(path, *sides)
    return None


def usable_truth(result: BaseResult) -> Truth | None:
    """Return the ground truth of a result; None if it has none that can be used."""
    try:
        return find_truth(result)
    except StimulusError:  # `truth_fault` gives the reason
        return None


def stated_contact(truth: Mapping[str, Any]) -> float | None:
    """Return the time of contact that a ground truth states, in seconds."""
    contact = truth.get("contact_time_s")
    return float(contact) if isinstance(contact, int | float) else None


def contacts_of(truth: Mapping[str, Any]) -> list[float]:
    """Return the times of contact in seconds: the stated one first, then those of other objects."""
    stated = stated_contact(truth)
    contacts: dict[str, float] = {}
    for frame in truth["frames"]:
        for obj in frame["objects"]:
            remaining_s = obj.get("time_to_contact_s")
            if remaining_s is not None:
                contacts.setdefault(obj["id"], frame["time_s"] + remaining_s)
    if stated is None:
        return list(contacts.values())
    return [stated, *(time for time in contacts.values() if abs(time - stated) > 1e-6)]


def sizes_in(frames: Sequence[Mapping[str, Any] | None]) -> dict[str, list[float | None]]:
    """Return the angular sizes in degrees of each object that has one, by frame.

    A size is None in a frame that is None or does not show the object.
    """
    sizes: dict[str, list[float | None]] = {}
    for at, frame in enumerate(frames):
        for obj in frame["objects"] if frame else ():
            of_object = sizes.setdefault(obj["id"], [None] * len(frames))
            of_object[at] = obj["angular_size_deg"] if obj["visible"] else None
    return {
        name: values for name, values in sizes.items() if any(size is not None for size in values)
    }


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
    other = f"belongs to another video, of {wide:g} x {high:g} and {length} frames: this one has"
    # Scaling rounds the sides to even numbers of pixels, and a few frames may be cut off.
    known = isinstance(width, int) and isinstance(height, int) and width > 0 and height > 0
    if known and abs(width / height / ratio - 1) > 0.03:
        return f"{other} {width} x {height}"
    most = max(5, 0.1 * length)
    if isinstance(frames, int) and frames > 0 and abs(frames - length) > most:
        return f"{other} {frames} frames"
    return ""
