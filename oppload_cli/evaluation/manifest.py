"""Manifests of labelled clips, and the boxes of their looming objects."""

from __future__ import annotations

import csv
import io
import json
import os.path
import re
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from oppload_cli.errors import ManifestError, ParameterError, nearest, suggestion
from oppload_cli.evaluation.metrics.clips import Label
from oppload_cli.files.reading import is_file, is_folder, is_there, reading, text_of
from oppload_cli.files.tables import EMPTY_CELLS, separator_hint
from oppload_cli.models.detector import Box
from oppload_cli.schema import parsed_fraction
from oppload_cli.video.inputs import checked_rate

if TYPE_CHECKING:
    from collections.abc import Sequence
    from fractions import Fraction

    from oppload_cli.stimulus.protocol import Protocol


_REQUIRED = ("file", "label", "onset_frame", "contact_frame")
_KNOWN = (
    *(*_REQUIRED, "motion", "true_rate"),
    *("fps", "frames", "width", "height", "source", "licence"),  # not read
)
_LOOMING, _NONE = "looming", "none"
STIMULI = Path("stimuli")  # in place of the path of a manifest


@dataclass(frozen=True)
class ClipEntry:
    """A usable row of a manifest."""

    row: int  # its number; the header is row 1
    path: Path | Protocol  # the clip, or the protocol of a stimulus to draw
    label: Label
    true_rate: Fraction | None = None  # frames/s of the camera; None: those of the file


@dataclass(frozen=True)
class Manifest:
    """The content of a manifest, or a list of stimuli in the same form."""

    path: Path
    entries: list[ClipEntry]
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
    entries: list[ClipEntry] = []
    faults: list[str] = []
    row_of: dict[str, int] = {}
    filled = {i: row for i, row in enumerate(rows[1:], 2) if any(cell.strip() for cell in row)}
    for number, cells in filled.items():
        try:
            entries.append(_entry(path, number, header, cells, row_of))
        except _RowError as fault:
            faults.append(f"{path}: row {number}: {fault}")
    column = header.index("file")
    names = tuple(cells[column].strip() for cells in filled.values() if column < len(cells))
    return Manifest(path, entries, faults, len(filled), names, _notes_of(path, header))


def _notes_of(path: Path, header: Sequence[str]) -> tuple[str, ...]:
    """Return a sentence that names the unknown columns, if there are any."""
    unknown = [name for name in dict.fromkeys(header) if name not in _KNOWN]
    names = ", ".join(f"'{name}'{_meant(name, _KNOWN)}" for name in unknown)
    return (f"{path}: these columns are not known and are ignored: {names}",) if unknown else ()


def _meant(name: str, known: Sequence[str]) -> str:
    """Return the known name that is similar to a misspelt name, in brackets; empty if none is."""
    similar = nearest(name, known)
    return f" (did you mean '{similar}'?)" if similar else ""


def _check_header(path: Path, header: Sequence[str]) -> None:
    missing = [name for name in _REQUIRED if name not in header]
    if missing:
        unknown = [name for name in header if name not in _KNOWN and _meant(name, missing)]
        hint = f" (it has '{unknown[0]}')" if unknown else ""
        hint = separator_hint(header) or hint
        raise ManifestError(
            f"{path}: its first row lacks {', '.join(missing)}{hint}; begin it with "
            f"{','.join(_REQUIRED)}"
        )
    repeated = [name for name in _KNOWN if header.count(name) > 1]
    if repeated:
        raise ManifestError(f"{path}: its first row has {repeated[0]} twice; keep one")


def _entry(
    manifest: Path, number: int, header: Sequence[str], cells: list[str], row_of: dict[str, int]
) -> ClipEntry:
    if len(cells) != len(header):
        raise _RowError(f"has {len(cells)} cells, not {len(header)}; give one for each column")
    row = dict(zip(header, (cell.strip() for cell in cells), strict=True))
    for column in ("onset_frame", "contact_frame", "true_rate"):
        if row.get(column) in EMPTY_CELLS:
            row[column] = ""
    if not row["file"]:
        raise _RowError("names no file; fill in its column 'file'")
    path = manifest.parent / row["file"]
    if not is_there(path):
        raise _RowError(
            f"{row['file']}: there is no such file; give its path from the manifest's folder"
        )
    if not (is_file(path) or is_folder(path)):
        raise _RowError(f"{row['file']}: is a pipe or a device; give a file or a folder of images")
    real_path = os.path.realpath(path)
    if real_path in row_of:
        raise _RowError(f"{row['file']} is in row {row_of[real_path]} already; keep one of them")
    label, true_rate = _label(row), _true_rate(row)
    row_of[real_path] = number
    return ClipEntry(number, path, label, true_rate)


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
    # pandas writes 44.0 if other rows of the column have no number.
    number = re.fullmatch(r"([0-9]{1,9})(?:\.0+)?", text)
    if not number:
        raise _RowError(f"{name}: {column} must be a whole number from 0, not '{text}'")
    return int(number[1])


def _true_rate(row: dict[str, str]) -> Fraction | None:
    text = row.get("true_rate", "")
    try:
        return checked_rate(parsed_fraction(text) if text else None)
    except (ValueError, ZeroDivisionError, ParameterError):
        raise _RowError(
            f"{row['file']}: true_rate must be the frames/s of the camera, such as 500 or "
            f"30000/1001, not '{text[:60]}'"
        ) from None


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
    path = path or manifest.path.with_name("boxes.json")
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
        if of_clip and not entry.label.looming:
            faults.append(
                f"{path}: {name}: has boxes, but is labelled {_NONE}, so that they do not count; "
                f"remove them, or label it {_LOOMING}"
            )
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
