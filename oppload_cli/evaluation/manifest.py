"""Manifests: the clips to evaluate on, and the label of each (``docs/evaluation.md``)."""

from __future__ import annotations

import csv
import io
import json
import math
import os.path
import re
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from oppload_cli.errors import ManifestError, suggestion
from oppload_cli.evaluation.metrics.clips import Label
from oppload_cli.files.reading import is_file, is_folder, reading, text_of

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from oppload_cli.evaluation.metrics.clips import Box
    from oppload_cli.stimulus.protocol import Protocol


REQUIRED = ("file", "label", "onset_frame", "contact_frame")
IGNORED = ("fps", "frames", "width", "height", "source", "licence")
KNOWN = (*REQUIRED, "motion", *IGNORED)
LOOMING, NONE = "looming", "none"
USUAL_BOXES = "boxes.json"


@dataclass(frozen=True)
class Entry:
    """A usable row of a manifest.

    Attributes
    ----------
    row : int
        Its number; the header is row 1.
    path : Path or Protocol
        The clip, or the stimulus to draw.
    label : Label
        From the row, and from the file of boxes.
    """

    row: int
    path: Path | Protocol
    label: Label


@dataclass(frozen=True)
class Manifest:
    """A manifest, as read.

    Attributes
    ----------
    path : Path
        The file.
    entries : list of Entry
        Its usable rows, in their order.
    faults : list of str
        A sentence for each row or box that cannot be used.
    rows : int
        Rows below the header that are not empty.
    """

    path: Path
    entries: list[Entry]
    faults: list[str] = field(default_factory=list)
    rows: int = 0


class RowError(ValueError):
    """A row or a box that cannot be used; the message names the fault and its repair."""


def read_manifest(path: Path) -> Manifest:
    """Read a manifest.

    Parameters
    ----------
    path : Path
        A CSV file with the columns ``file``, ``label``, ``onset_frame`` and
        ``contact_frame``; clips are relative to its folder.

    Returns
    -------
    Manifest
        A row that is wrong is a fault, not an error.

    Raises
    ------
    ManifestError
        If it cannot be read, is no CSV, or lacks a column.
    """
    if is_folder(path):
        raise ManifestError(f"{path}: is a folder; give its manifest, such as manifest.csv in it")
    with reading(path, ManifestError, form="CSV in UTF-8"):
        text = text_of(path, pipes=True)
        rows = list(csv.reader(io.StringIO(text, newline=""), strict=True))
    header = [cell.strip() for cell in rows[0]] if rows else []
    _check_header(path, header)
    entries: list[Entry] = []
    faults = [
        f"{path}: row 1: unknown column '{name}'{suggestion(name, KNOWN)}"
        for name in dict.fromkeys(header)
        if name not in KNOWN
    ]
    row_of: dict[str, int] = {}
    filled = {at: row for at, row in enumerate(rows[1:], 2) if any(cell.strip() for cell in row)}
    for number, cells in filled.items():
        try:
            entries.append(_entry(path, number, header, cells, row_of))
        except RowError as fault:
            faults.append(f"{path}: row {number}: {fault}")
    return Manifest(path, entries, faults, len(filled))


def _check_header(path: Path, header: Sequence[str]) -> None:
    missing = [name for name in REQUIRED if name not in header]
    if missing:
        raise ManifestError(
            f"{path}: its first row lacks {', '.join(missing)}; begin it with {','.join(REQUIRED)}"
        )
    twice = [name for name in KNOWN if header.count(name) > 1]
    if twice:
        raise ManifestError(f"{path}: its first row has {twice[0]} twice; keep one")


def _entry(
    manifest: Path, number: int, header: Sequence[str], cells: list[str], row_of: dict[str, int]
) -> Entry:
    if len(cells) != len(header):
        raise RowError(f"has {len(cells)} cells, not {len(header)}; give one for each column")
    row = dict(zip(header, (cell.strip() for cell in cells), strict=True))
    if not row["file"]:
        raise RowError("names no file; fill in its first column, file")
    path = manifest.parent / row["file"]
    if os.path.exists(path) and not (os.path.isfile(path) or os.path.isdir(path)):  # noqa: PTH110, PTH112, PTH113
        raise RowError(f"{row['file']}: is a pipe or a device; give a file or a folder of images")
    if not os.path.exists(path):  # noqa: PTH110 - it says no to any name
        raise RowError(
            f"{row['file']}: there is no such file; check the path, from the manifest's folder"
        )
    same = os.path.realpath(path)
    if same in row_of:
        raise RowError(f"{row['file']} is in row {row_of[same]} already; keep one of them")
    label = _label(row)
    row_of[same] = number
    return Entry(number, path, label)


def _label(row: dict[str, str]) -> Label:
    name, label = row["file"], row["label"]
    if label not in {LOOMING, NONE}:
        raise RowError(f"{name}: unknown label '{label}'{suggestion(label, (LOOMING, NONE))}")
    motion = row.get("motion", "")
    if label == NONE:
        for column in ("onset_frame", "contact_frame"):
            if row[column]:
                raise RowError(
                    f"{name}: has the {column} {row[column]}, but is labelled {NONE}; "
                    f"empty the cell, or label it {LOOMING}"
                )
        return Label(name, motion=motion)
    onset, contact = (_frame(name, row, column) for column in ("onset_frame", "contact_frame"))
    if contact < onset:
        raise RowError(
            f"{name}: its contact, frame {contact}, is before its onset, frame {onset}; "
            "correct them"
        )
    return Label(name, onset, contact, motion)


def _frame(name: str, row: dict[str, str], column: str) -> int:
    text = row[column]
    if not text:
        raise RowError(f"{name}: is labelled {LOOMING} but has no {column}; fill it in")
    if not re.fullmatch(r"[0-9]{1,9}", text):
        raise RowError(f"{name}: {column} must be a whole number from 0, not '{text}'")
    return int(text)


def with_boxes(manifest: Manifest, path: Path | None = None) -> Manifest:
    """Return a manifest with the boxes of its clips.

    Parameters
    ----------
    manifest : Manifest
        The clips.
    path : Path, optional
        A JSON file ``{file: {frame: [left, top, width, height]}}`` in source pixels;
        else ``boxes.json`` beside the manifest, if it exists. Clips that are not in
        the manifest are ignored: several manifests may share the boxes.

    Returns
    -------
    Manifest
        A box that is wrong is a fault, not an error.

    Raises
    ------
    ManifestError
        If the file cannot be read, or is no such JSON.
    """
    if path is None:
        path = manifest.path.with_name(USUAL_BOXES)
        if not is_file(path):
            return manifest
    content = _content(path)
    faults = list(manifest.faults)
    entries = []
    for entry in manifest.entries:
        name = entry.label.name
        boxes: dict[int, Box] = {}
        for found in _boxes(content.get(name, {})):
            if isinstance(found, RowError):
                faults.append(f"{path}: {name}: {found}")
            else:
                boxes[found[0]] = found[1]
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


def _boxes(of_clip: object) -> Iterator[tuple[int, Box] | RowError]:
    if not isinstance(of_clip, dict):
        yield RowError("must be an object of frames; correct it")
        return
    for frame, box in of_clip.items():
        if not re.fullmatch(r"[0-9]{1,9}", frame):
            yield RowError(f"frame '{frame}' must be a whole number from 0; correct it")
        elif not _is_box(box):
            yield RowError(
                f"frame {frame}: a box must be [left, top, width, height] in pixels with a width "
                f"and height above 0, not {json.dumps(box)[:60]}"
            )
        else:
            yield int(frame), (float(box[0]), float(box[1]), float(box[2]), float(box[3]))


def _is_box(box: object) -> bool:
    return (
        isinstance(box, list)
        and len(box) == 4
        and all(isinstance(side, int | float) and not isinstance(side, bool) for side in box)
        and all(math.isfinite(side) and abs(side) < 1e9 for side in box)
        and box[2] > 0
        and box[3] > 0
    )
