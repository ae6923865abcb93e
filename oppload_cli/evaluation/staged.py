"""Clips of stimuli, and their labels from the ground truth instead of a manifest."""

from __future__ import annotations

import os.path
from pathlib import Path
from typing import TYPE_CHECKING, Any

from oppload_cli.errors import ParameterError, StimulusError
from oppload_cli.evaluation.manifest import Entry, Manifest, read_manifest, with_boxes
from oppload_cli.evaluation.metrics.clips import Label
from oppload_cli.stimulus.catalogue import find, parsed_setting
from oppload_cli.stimulus.objects import PICTURE
from oppload_cli.stimulus.truth import ground_truth, read_ground_truth

if TYPE_CHECKING:
    from collections.abc import Sequence

    from oppload_cli.evaluation.metrics.clips import Box
    from oppload_cli.stimulus.protocol import Protocol

    Table = dict[str, Any]

TRUTH = ".stimulus.json"
FOOTAGE = {
    "scene.background_fit": "cover",
    "scene.background_rate": "own",
    "scene.background_end": "loop",
}
_CAMERA = {"pan_deg_s": "pan", "shake_deg": "shake", "forward_m_s": "forward"}


def clips_of(
    inputs: Sequence[str], boxes: Path | None, backgrounds: Sequence[str], changes: Sequence[str]
) -> Manifest:
    """Return the clips to evaluate, of a manifest or of stimuli.

    Parameters
    ----------
    inputs : sequence of str
        A manifest, or stimuli and videos of stimuli, as the user names them.
    boxes : Path or None
        The file of boxes that goes with the manifest.
    backgrounds : sequence of str
        Videos to put behind the stimuli.
    changes : sequence of str
        Values of the stimuli to change, each as ``KEY=VALUE``.

    Raises
    ------
    ParameterError
        If an option does not go with the inputs.
    ManifestError, StimulusError
        If an input cannot be read.
    """
    manifest = _manifest_in(inputs)
    _check_options(manifest, boxes, (*backgrounds, *changes))
    if manifest is not None:
        return with_boxes(read_manifest(manifest), boxes)
    settings = dict(parsed_setting(text) for text in changes)
    names = [name for name in inputs if not _is_video(name)]
    videos = [Path(name) for name in inputs if _is_video(name)]
    return _labelled(protocols_of(names, settings, backgrounds), videos)


def _is_video(name: str) -> bool:
    """Tell whether an input is a file that is no protocol."""
    return os.path.isfile(name) and not name.endswith(".toml")  # noqa: PTH113 - any name


def _manifest_in(inputs: Sequence[str]) -> Path | None:
    """Return the manifest, if one was named: a single input that is no stimulus or its video."""
    path = Path(inputs[0])
    if len(inputs) > 1 or path.suffix == ".toml":
        return None
    if os.path.lexists(path):
        return None if _is_video(inputs[0]) and _truth_beside(path).is_file() else path
    return path if path.suffix == ".csv" else None


def _check_options(manifest: Path | None, boxes: Path | None, of_stimuli: Sequence[object]) -> None:
    if manifest is None and boxes is not None:
        raise ParameterError("--boxes goes with a manifest; the boxes of stimuli are known")
    if manifest is not None and of_stimuli:
        raise ParameterError("--background and --change go with stimuli, not with a manifest")


def protocols_of(
    names: Sequence[str], settings: Table, backgrounds: Sequence[str] = ()
) -> list[Protocol]:
    """Return the stimuli to evaluate.

    Parameters
    ----------
    names : sequence of str
        Names and patterns of the catalogue, and protocol files.
    settings : dict
        Values to change, by dotted key.
    backgrounds : sequence of str
        Videos to put behind them. Stimuli whose camera moves are then left out, and so are
        those without a background, and cuts.

    Raises
    ------
    StimulusError
        If there is no such stimulus, or one is not valid; or if none is left.
    """
    found = [entry.with_settings(settings) for name in names for entry in find(name)]
    if backgrounds:
        videos = {"scene.background": [str(path) for path in backgrounds], **FOOTAGE}
        fits = [entry for entry in found if _takes_footage(entry.table)]
        found = [entry.with_settings(videos) for entry in fits]
        if not found:
            raise StimulusError(
                f"--background: none of {', '.join(names)} has a background and a camera at rest; "
                "name others, such as 'staged/*'"
            )
    made = {protocol.name: protocol for entry in found for protocol in entry.protocols()}
    return list(made.values())


def _takes_footage(table: Table) -> bool:
    scene, camera = table.get("scene", {}), table.get("camera", {})
    moved = any(camera.get(key) for key in (*_CAMERA, "start_deg"))
    return "background" in scene and "cut_s" not in scene and not moved


def _truth_beside(video: Path) -> Path:
    """Return the file of a video's ground truth."""
    return video.with_name(f"{video.stem}{TRUTH}")


def _labelled(protocols: Sequence[Protocol], videos: Sequence[Path]) -> Manifest:
    """Return stimuli, and videos of stimuli, with the labels that their ground truth gives.

    Parameters
    ----------
    protocols : sequence of Protocol
        Stimuli, which are drawn when they are analysed.
    videos : sequence of Path
        Each with its ``NAME.stimulus.json`` beside it.

    Returns
    -------
    Manifest
        A stimulus that cannot be drawn, or a video without truth, is a fault, not an error.
    """
    entries: list[Entry] = []
    faults = []
    sources: list[Protocol | Path] = [*protocols, *videos]
    for source in sources:
        name = source.name
        try:
            if isinstance(source, Path):
                truth = read_ground_truth(_truth_beside(source))
            else:
                truth = ground_truth(source)
        except StimulusError as problem:
            faults.append(f"{name}: {problem}")
            continue
        entries.append(Entry(len(entries) + 1, source, label_of(name, truth)))
    return Manifest(Path("stimuli"), entries, faults, len(protocols) + len(videos))


def label_of(name: str, truth: Table) -> Label:
    """Return the label of a clip: an approach lasts while an object looms.

    Parameters
    ----------
    name : str
        Of the clip.
    truth : dict
        Its ground truth.
    """
    looming = [frame["frame"] for frame in truth["frames"] if frame["looming"]]
    boxes: dict[int, Box] = {}
    contacts: dict[int, float] = {}
    wide, high = truth["display"]["width"], truth["display"]["height"]
    for frame in truth["frames"]:
        for one in frame["objects"]:
            box = _within(one.get("box_px"), wide, high)
            if one["looming"] and box is not None:
                boxes[frame["frame"]] = box
                contacts[frame["frame"]] = one["time_to_contact_s"]
    conditions = conditions_of(truth["protocol"])
    motion = "" if looming else conditions["kind"]
    onset, contact = (looming[0], looming[-1]) if looming else (None, None)
    return Label(name, onset, contact, motion, boxes, contacts, conditions)


def _within(box: Sequence[float] | None, wide: int, high: int) -> Box | None:
    """Return the part of a box on the display; None for no part of at least a pixel."""
    if box is None:
        return None
    left, top = max(box[0], 0.0), max(box[1], 0.0)
    width, height = min(box[0] + box[2], wide) - left, min(box[1] + box[3], high) - top
    return (left, top, width, height) if min(width, height) >= 1 else None


def conditions_of(protocol: Table) -> dict[str, str]:
    """Return the conditions by which a clip is grouped, by name.

    Parameters
    ----------
    protocol : dict
        The resolved protocol.
    """
    scene, camera = protocol.get("scene", {}), protocol.get("camera", {})
    pictures = [each for each in protocol.get("object", []) if each["kind"] == PICTURE]
    moves = [f"{word} {camera[key]:g}" for key, word in _CAMERA.items() if camera.get(key)]
    found = {"kind": _kind(protocol, pictures, moves)}
    if scene.get("background"):
        found["background"] = Path(scene["background"]).stem
        found["camera"] = ", ".join(moves) or "at rest"
    for each in pictures[:1]:
        course = each["course"]
        found["size"] = f"{each['size_m']:g} m"
        found["drawing"] = each.get("drawing") or Path(each["file"]).stem
        for key, name, unit in (("speed_m_s", "speed", " m/s"), ("side", "side", "")):
            if course.get(key) and not (key == "side" and course["kind"] == "collision"):
                found[name] = f"{course[key]:g}{unit}" if unit else course[key]
        if "relative_luminance" in each:
            found["contrast"] = f"{each['relative_luminance'] - 1:+.2g}"
        right, up = course["bearing_deg"]
        found["place"] = f"{right:g}, {up:g} deg"
    return found


def _kind(protocol: Table, pictures: Sequence[Table], moves: Sequence[str]) -> str:
    if pictures:
        course = pictures[0]["course"]
        if course["kind"] == "near-miss":
            return f"near miss at {course['miss_sizes']:g} sizes"
        return "braking" if course.get("braking_m_s2") else str(course["kind"])
    if protocol.get("object"):
        flash = protocol["object"][0]["kind"] == "field"
        return "flash" if flash else str(protocol["name"]).rpartition("/")[0] or "stimulus"
    if protocol.get("scene", {}).get("cut_s"):
        return "cut"
    return moves[0].split()[0] if moves else "still"
