"""The clips of an evaluation: a manifest, or stimuli with labels from their ground truth."""

from __future__ import annotations

import csv
import io
import json
import math
import os.path
import re
from dataclasses import dataclass, field, replace
from operator import itemgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any

from oppload_cli import stimulus
from oppload_cli.errors import (
    ManifestError,
    ParameterError,
    SourceError,
    StimulusError,
    nearest,
    suggestion,
)
from oppload_cli.evaluation.metrics.clips import Label
from oppload_cli.files.reading import is_file, is_folder, is_there, reading, text_of
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


_REQUIRED = ("file", "label", "onset_frame", "contact_frame")
_IGNORED = ("fps", "frames", "width", "height", "source", "licence")
_KNOWN = (*_REQUIRED, "motion", *_IGNORED)
_LOOMING, _NONE = "looming", "none"
_USUAL_BOXES = "boxes.json"
_FOOTAGE = {
    "scene.background_fit": "cover",
    "scene.background_rate": "own",
    "scene.background_end": "loop",
}
_CAMERA = {"pan_deg_s": "pan", "shake_deg": "shake", "forward_m_s": "forward"}


@dataclass(frozen=True)
class Entry:
    """A usable row of a manifest."""

    row: int  # its number; the header is row 1
    path: Path | Protocol  # the clip, or the protocol of a stimulus to draw
    label: Label


@dataclass(frozen=True)
class Manifest:
    """The content of a manifest, or a list of stimuli in the same form."""

    path: Path
    entries: list[Entry]
    faults: list[str] = field(default_factory=list)  # of rows and boxes that cannot be used
    rows: int = 0  # below the header, without empty ones
    names: tuple[str, ...] = ()  # the clips of all these rows
    notes: tuple[str, ...] = ()  # maybe a sentence that names the ignored columns


class _RowError(ValueError):
    """A row that cannot be used; the message says why, and what the user can do."""


def read_manifest(path: Path) -> Manifest:
    """Read a manifest; a wrong row is a fault of the manifest, not an error.

    Parameters
    ----------
    path : Path
        A CSV file with the columns ``file``, ``label``, ``onset_frame`` and
        ``contact_frame``; the paths of clips are relative to its folder.

    Raises
    ------
    ManifestError
        If the file cannot be read, is not CSV, or lacks a column.
    """
    if is_folder(path):
        raise ManifestError(
            f"{path}: is a folder; give its manifest, such as manifest.csv in it, or, if it holds "
            f"videos of stimuli, {path / '*'}"
        )
    with reading(path, ManifestError, form="CSV in UTF-8"):
        text = text_of(path, pipes=True)
        rows = list(csv.reader(io.StringIO(text, newline=""), strict=True))
    header = [cell.strip() for cell in rows[0]] if rows else []
    _check_header(path, header)
    entries: list[Entry] = []
    faults: list[str] = []
    row_of: dict[str, int] = {}
    filled = {at: row for at, row in enumerate(rows[1:], 2) if any(cell.strip() for cell in row)}
    for number, cells in filled.items():
        try:
            entries.append(_entry(path, number, header, cells, row_of))
        except _RowError as fault:
            faults.append(f"{path}: row {number}: {fault}")
    at = header.index("file")
    names = tuple(cells[at].strip() for cells in filled.values() if at < len(cells))
    return Manifest(path, entries, faults, len(filled), names, _notes_of(path, header))


def _notes_of(path: Path, header: Sequence[str]) -> tuple[str, ...]:
    """Return a sentence that names the unknown columns, if there are any."""
    unknown = [name for name in dict.fromkeys(header) if name not in _KNOWN]
    names = ", ".join(f"'{name}'{_meant(name, _KNOWN)}" for name in unknown)
    return (f"{path}: these columns are not known and are ignored: {names}",) if unknown else ()


def _meant(name: str, known: Sequence[str]) -> str:
    """Return the known name that is similar to a misspelt name, in brackets; empty if none is."""
    near = nearest(name, known)
    return f" (did you mean '{near}'?)" if near else ""


def _check_header(path: Path, header: Sequence[str]) -> None:
    missing = [name for name in _REQUIRED if name not in header]
    if missing:
        unknown = [name for name in header if name not in _KNOWN and _meant(name, missing)]
        other = f" (it has '{unknown[0]}')" if unknown else ""
        if len(header) == 1 and ";" in header[0]:  # as spreadsheets write in many countries
            other = " (its cells are separated by semicolons, not by commas)"
        raise ManifestError(
            f"{path}: its first row lacks {', '.join(missing)}{other}; begin it with "
            f"{','.join(_REQUIRED)}"
        )
    twice = [name for name in _KNOWN if header.count(name) > 1]
    if twice:
        raise ManifestError(f"{path}: its first row has {twice[0]} twice; keep one")


def _entry(
    manifest: Path, number: int, header: Sequence[str], cells: list[str], row_of: dict[str, int]
) -> Entry:
    if len(cells) != len(header):
        raise _RowError(f"has {len(cells)} cells, not {len(header)}; give one for each column")
    row = dict(zip(header, (cell.strip() for cell in cells), strict=True))
    if not row["file"]:
        raise _RowError("names no file; fill in its column 'file'")
    path = manifest.parent / row["file"]
    if not is_there(path):
        raise _RowError(
            f"{row['file']}: there is no such file; give its path from the manifest's folder"
        )
    if not (is_file(path) or is_folder(path)):
        raise _RowError(f"{row['file']}: is a pipe or a device; give a file or a folder of images")
    same = os.path.realpath(path)
    if same in row_of:
        raise _RowError(f"{row['file']} is in row {row_of[same]} already; keep one of them")
    label = _label(row)
    row_of[same] = number
    return Entry(number, path, label)


def _label(row: dict[str, str]) -> Label:
    name, label = row["file"], row["label"]
    if label not in {_LOOMING, _NONE}:
        raise _RowError(f"{name}: unknown label '{label}'{suggestion(label, (_LOOMING, _NONE))}")
    motion = row.get("motion", "")
    if label == _NONE:
        for column in ("onset_frame", "contact_frame"):
            if row[column]:
                raise _RowError(
                    f"{name}: has the {column} {row[column]}, but is labelled {_NONE}; "
                    f"empty the cell, or label it {_LOOMING}"
                )
        return Label(name, motion=motion)
    onset, contact = (_frame(name, row, column) for column in ("onset_frame", "contact_frame"))
    if contact < onset:
        raise _RowError(
            f"{name}: its contact, frame {contact}, is before its onset, frame {onset}; "
            "correct them"
        )
    return Label(name, onset, contact, motion)


def _frame(name: str, row: dict[str, str], column: str) -> int:
    text = row[column]
    if not text:
        raise _RowError(f"{name}: is labelled {_LOOMING} but has no {column}; fill it in")
    if not re.fullmatch(r"[0-9]{1,9}", text):
        raise _RowError(f"{name}: {column} must be a whole number from 0, not '{text}'")
    return int(text)


def with_boxes(manifest: Manifest, path: Path | None = None) -> Manifest:
    """Return a manifest with the boxes of its clips; a wrong box is a fault, not an error.

    The boxes come from `path`, a JSON file ``{file: {frame: [left, top, width, height]}}`` in
    source pixels. By default they come from ``boxes.json`` beside the manifest, if it exists.
    Several manifests may share ``boxes.json``, so clips of other manifests in it are ignored.

    Raises
    ------
    ManifestError
        If the file cannot be read or has another form, or if the file `path` names a clip that the
        manifest does not have.
    """
    shared = path is None
    path = path or manifest.path.with_name(_USUAL_BOXES)
    if shared and not is_file(path):
        return manifest
    content = _content(path)
    for name in content:
        if not shared and name not in manifest.names:
            raise ManifestError(
                f"{path}: names '{name}', which is not in {manifest.path}"
                f"{_meant(name, manifest.names)}; name its clips as the manifest does"
            )
    faults = list(manifest.faults)
    entries = []
    for entry in manifest.entries:
        name = entry.label.name
        boxes: dict[int, Box] = {}
        of_clip = content.get(name, {})
        if not isinstance(of_clip, dict):
            faults.append(f"{path}: {name}: must be an object of frames; correct it")
            of_clip = {}
        for frame, box in of_clip.items():
            fault = _fault_of_box(frame, box)
            if fault:
                faults.append(f"{path}: {name}: {fault}")
            else:
                boxes[int(frame)] = Box(*map(float, box))
        entries.append(replace(entry, label=replace(entry.label, boxes=boxes)))
    return replace(manifest, entries=entries, faults=faults)


def _content(path: Path) -> dict[str, Any]:
    with reading(path, ManifestError, form="JSON", check="check --boxes"):
        content = json.loads(text_of(path))
    if not isinstance(content, dict):
        raise ManifestError(
            f"{path}: must be an object of clips such as "
            '{"clip.mp4": {"12": [left, top, width, height]}}; correct the file'
        )
    return content


def _fault_of_box(frame: str, box: object) -> str:
    """Return why a frame and its box in the file of boxes cannot be used; empty if they can."""
    if not re.fullmatch(r"[0-9]{1,9}", frame):
        return f"frame '{frame}' must be a whole number from 0; correct it"
    if (
        isinstance(box, list)
        and len(box) == 4
        and all(isinstance(side, int | float) and not isinstance(side, bool) for side in box)
        and all(abs(side) < 1e9 for side in box)  # neither NaN nor infinite
        and min(box[2:]) > 0
    ):
        return ""
    return (
        f"frame {frame}: a box must be [left, top, width, height] in pixels with a width "
        f"and height above 0, not {json.dumps(box)[:60]}"
    )


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
    return _labelled(_protocols_of(names, settings, backgrounds), list(videos.values()))


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
    found = [entry.with_settings(settings) for name in names for entry in stimulus.find(name)]
    if backgrounds:
        videos = {"scene.background": [str(path) for path in backgrounds], **_FOOTAGE}
        fits = [entry for entry in found if _takes_footage(entry.table)]
        found = [entry.with_settings(videos) for entry in fits]
        if not found:
            raise StimulusError(
                f"--background: none of {', '.join(names)} has a background and a camera at rest; "
                "name others, such as 'staged/*'"
            )
    made: dict[str, Protocol] = {}
    for entry in found:
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


def _labelled(protocols: Sequence[Protocol], videos: Sequence[Path]) -> Manifest:
    """Return stimuli, and videos of stimuli, with labels from their ground truth.

    The ground truth of a video lies beside the video. A stimulus that cannot be drawn, or a video
    without a ground truth of its own, is a fault, not an error.
    """
    entries: list[Entry] = []
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
            entries.append(Entry(len(entries) + 1, source, label))
    return Manifest(Path("stimuli"), entries, faults, len(entries) + len(faults))


def _labels_of(name: str, truth: Table, video: int, size: tuple[int, int]) -> list[Label]:
    """Return the labels of a video: one for each run of frames in which an object looms.

    A video without such frames has one label. `video` is the number of the video, and `size` its
    width and height, which may be a multiple of the display's.
    """
    looming = [frame["frame"] for frame in truth["frames"] if frame["looming"]]
    onsets = [frame for frame in looming if frame - 1 not in looming]
    ends = [frame for frame in looming if frame + 1 not in looming]
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
            each,
            name=f"{name}, approach {number} of {len(labels)}",
            conditions=conditions,
            since=onset if number > 1 else 0,
            video=video,
        )
        for number, (onset, each) in enumerate(zip(onsets, labels, strict=True), 1)
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
        for each in sorted(objects, key=_arrival_s, reverse=True):
            if box := _within(each.get("box_px"), display, size):
                boxes[frame["frame"]] = box
            if each["time_to_contact_s"] is not None:
                contacts[frame["frame"]] = each["time_to_contact_s"]
                times.add(round(frame["time_s"] + each["time_to_contact_s"], 6))
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
