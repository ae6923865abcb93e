"""The inputs of an evaluation: a manifest, or stimuli with labels from their ground truth."""

from __future__ import annotations

import math
import os.path
from dataclasses import replace
from operator import itemgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any

from oppload_cli import stimulus
from oppload_cli.errors import ManifestError, ParameterError, SourceError, StimulusError
from oppload_cli.evaluation.manifest import STIMULI, ClipEntry, Manifest, read_manifest, with_boxes
from oppload_cli.evaluation.metrics.clips import Label
from oppload_cli.files.reading import is_file, is_folder
from oppload_cli.models.detector import Box
from oppload_cli.results.truths import read_truth
from oppload_cli.stimulus.catalogue import parsed_settings
from oppload_cli.stimulus.objects import PICTURE
from oppload_cli.video.inputs import is_video, truth_beside, without_truths
from oppload_cli.video.source import open_video

if TYPE_CHECKING:
    from collections.abc import Sequence

    from oppload_cli.stimulus.protocol import Protocol

    Table = dict[str, Any]


_CAMERA = {"pan_deg_s": "pan", "shake_deg": "shake", "forward_m_s": "forward"}


def clips_of(
    inputs: Sequence[str], boxes: Path | None, backgrounds: Sequence[str], changes: Sequence[str]
) -> Manifest:
    """Return the clips to evaluate, from a manifest or from stimuli.

    Parameters
    ----------
    inputs : sequence of str
        The path of a manifest; or names of stimuli, and videos or folders of images with their
        ground truth beside them.
    boxes : Path or None
        The file with the boxes of the manifest's clips.
    backgrounds : sequence of str
        Videos that replace the background of the stimuli.
    changes : sequence of str
        Values of the stimuli to change, each as ``KEY=VALUE``.

    Raises
    ------
    ParameterError
        If an option cannot be used with these inputs.
    ManifestError, StimulusError
        If an input cannot be read.
    """
    if not inputs:
        raise ParameterError(
            "--boxes, --background and --change go with a manifest, stimuli or videos; name some"
            if boxes or backgrounds or changes
            else "name a manifest, stimuli or videos to evaluate, or give --battery"
        )
    manifest = _manifest_in(inputs)
    if manifest is not None:
        if backgrounds or changes:
            raise ParameterError("--background and --change go with stimuli, not with a manifest")
        return with_boxes(read_manifest(manifest), boxes)
    if boxes is not None:
        raise ParameterError(
            "--boxes goes with a manifest; the boxes of stimuli come from their ground truth"
        )
    settings = parsed_settings(changes)
    inputs = without_truths(inputs)
    names = [name for name in inputs if not _is_clip(name)]
    videos = {os.path.realpath(name): Path(name) for name in inputs if _is_clip(name)}  # each once
    return labelled(_protocols_of(names, settings, backgrounds), list(videos.values()))


def _is_clip(name: str) -> bool:
    """Tell whether an input is a file, but no protocol, or a folder of a stimulus's images."""
    if is_folder(name):
        return is_file(truth_beside(name))
    return is_file(name) and not name.endswith(".toml")


def _manifest_in(inputs: Sequence[str]) -> Path | None:
    """Return the path of the manifest; None if the inputs are stimuli or their videos."""
    path = Path(inputs[0])
    table = next((name for name in inputs if name.lower().endswith(".csv")), None)
    if len(inputs) > 1 and table is not None:
        raise ManifestError(
            f"{table}: is a manifest, which must be the only input; to use several manifests, "
            "join their rows in one file"
        )
    if len(inputs) > 1 or path.suffix == ".toml":
        return None
    if os.path.lexists(path):
        if _is_clip(inputs[0]) and is_file(truth_beside(path)):
            return None
        if is_video(path.name):
            raise ManifestError(
                f"{path}: has no ground truth beside it ({truth_beside(path).name}); write a "
                "manifest that says when its contact is"
            )
        return path
    return path if path.suffix == ".csv" else None


def _protocols_of(
    names: Sequence[str], settings: Table, backgrounds: Sequence[str]
) -> list[Protocol]:
    """Return the protocols of the stimuli to evaluate.

    If videos replace the background, stimuli without a background, with a cut or with a moving
    camera are left out.
    """
    entries = [entry.with_settings(settings) for name in names for entry in stimulus.find(name)]
    if backgrounds:
        footage = {
            "scene.background": list(backgrounds),
            "scene.background_fit": "cover",
            "scene.background_rate": "own",
            "scene.background_end": "loop",
        }
        fits = [entry for entry in entries if _takes_footage(entry.table)]
        entries = [entry.with_settings(footage) for entry in fits]
        if not entries:
            raise StimulusError(
                f"--background: none of {', '.join(names)} has a background and a camera at rest; "
                "name others, such as 'staged/*'"
            )
    made: dict[str, Protocol] = {}
    for entry in entries:
        for protocol in entry.protocols():
            if made.setdefault(protocol.name, protocol) != protocol:
                raise StimulusError(
                    f"{entry.path}: two different stimuli are named '{protocol.name}'; rename a "
                    "file, or evaluate them one by one"
                )
    return list(made.values())


def _takes_footage(table: Table) -> bool:
    scene, camera = table.get("scene", {}), table.get("camera", {})
    moved = any(camera.get(key) for key in (*_CAMERA, "start_deg"))
    return "background" in scene and "cut_s" not in scene and not moved


def labelled(protocols: Sequence[Protocol], videos: Sequence[Path]) -> Manifest:
    """Return stimuli, and videos of stimuli, with labels from their ground truth.

    The ground truth of a video lies beside the video. A stimulus that cannot be drawn, or a video
    without a ground truth of its own, is a fault, not an error.
    """
    entries: list[ClipEntry] = []
    faults = []
    sources: list[Protocol | Path] = [*protocols, *videos]
    for video, source in enumerate(sources):
        name = source.name
        try:
            if isinstance(source, Path):
                with open_video(source) as opened:
                    facts = opened.facts
                size, path = (facts.width, facts.height), truth_beside(source)
                truth = read_truth(path, *size, facts.frames_declared)
            else:
                size = source.display.width, source.display.height
                truth = stimulus.ground_truth(source)
        except SourceError as problem:
            faults.append(str(problem))  # begins with the video
            continue
        except StimulusError as problem:
            faults.append(f"{name}: {problem}")
            continue
        for label in _labels_of(name, truth, video, size):
            entries.append(ClipEntry(len(entries) + 1, source, label))
    return Manifest(STIMULI, entries, faults, len(entries) + len(faults))


def _labels_of(name: str, truth: Table, video: int, size: tuple[int, int]) -> list[Label]:
    """Return the labels of a video: one for each run of frames in which an object looms.

    A video without such frames has one label. `video` is the number of the video, and `size` its
    width and height, which may be a multiple of the display's.
    """
    looming = {frame["frame"] for frame in truth["frames"] if frame["looming"]}
    onsets = sorted(frame for frame in looming if frame - 1 not in looming)
    ends = sorted(frame for frame in looming if frame + 1 not in looming)
    conditions = _conditions_of(truth["protocol"])
    if not onsets:
        return [Label(name, motion=conditions["kind"], conditions=conditions)]
    labels = [
        _label_of_approach(name, truth, onset, contact, size)
        for onset, contact in zip(onsets, ends, strict=True)
    ]
    if len(labels) == 1:
        return [replace(labels[0], conditions=conditions)]
    return [
        replace(
            label,
            name=f"{name}, approach {number} of {len(labels)}",
            conditions=conditions,
            since=onset if number > 1 else 0,
            video=video,
        )
        for number, (onset, label) in enumerate(zip(onsets, labels, strict=True), 1)
    ]


def _label_of_approach(
    name: str, truth: Table, onset: int, contact: int, size: tuple[int, int]
) -> Label:
    """Return the label of the frames `onset` to `contact`: boxes, and times to contact."""
    display = truth["display"]["width"], truth["display"]["height"]
    boxes: dict[int, Box] = {}
    contacts: dict[int, float] = {}
    times: set[float] = set()
    for frame in truth["frames"]:
        if not onset <= frame["frame"] <= contact:
            continue
        objects = filter(itemgetter("looming"), frame["objects"])
        # The object that arrives first comes last, so that the frame has its box and its time.
        for looming_object in sorted(objects, key=_arrival_s, reverse=True):
            if box := _within(looming_object.get("box_px"), display, size):
                boxes[frame["frame"]] = box
            if looming_object["time_to_contact_s"] is not None:
                contacts[frame["frame"]] = looming_object["time_to_contact_s"]
                times.add(round(frame["time_s"] + looming_object["time_to_contact_s"], 6))
    return Label(name, onset, contact, "", boxes, contacts, contact_times=tuple(sorted(times)))


def _arrival_s(truth: Table) -> float:
    """Return the time to contact of an object; infinite if it is not known."""
    contact_s = truth["time_to_contact_s"]
    return math.inf if contact_s is None else float(contact_s)


def _within(
    box: Sequence[float] | None, display: tuple[int, int], size: tuple[int, int]
) -> Box | None:
    """Return the part of a box on the display, in pixels of a video of another size.

    None if this part is smaller than a pixel of the display.
    """
    if box is None:
        return None
    left, top = max(box[0], 0.0), max(box[1], 0.0)
    width, height = min(box[0] + box[2], display[0]) - left, min(box[1] + box[3], display[1]) - top
    x, y = size[0] / display[0], size[1] / display[1]
    return Box(x * left, y * top, x * width, y * height) if min(width, height) >= 1 else None


def _conditions_of(protocol: Table) -> dict[str, str]:
    """Return the values by which clips are grouped, such as the speed, from a resolved protocol."""
    scene, camera = protocol.get("scene", {}), protocol.get("camera", {})
    pictures = [item for item in protocol.get("object", []) if item["kind"] == PICTURE]
    moves = [f"{word} {camera[key]:g}" for key, word in _CAMERA.items() if camera.get(key)]
    conditions = {"kind": _kind(protocol, pictures, moves)}
    if scene.get("background"):
        conditions["background"] = Path(scene["background"]).stem
        conditions["camera"] = ", ".join(moves) or "at rest"
    for picture in pictures[:1]:
        course = picture["course"]
        conditions["size"] = f"{picture['size_m']:g} m"
        conditions["drawing"] = picture.get("drawing") or Path(picture["file"]).stem
        for key, name, unit in (("speed_m_s", "speed", " m/s"), ("side", "side", "")):
            if course.get(key) and not (key == "side" and course["kind"] == "collision"):
                conditions[name] = f"{course[key]:g}{unit}" if unit else course[key]
        if "relative_luminance" in picture:
            conditions["contrast"] = f"{picture['relative_luminance'] - 1:+.2g}"
        right, up = course["bearing_deg"]
        conditions["place"] = f"{right:g}, {up:g} deg"
    return conditions


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
