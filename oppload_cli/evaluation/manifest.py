"""Manifests: which clips there are, and what is known of each (``docs/evaluation.md``)."""

from __future__ import annotations

import csv
import io
import os.path
import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from oppload_cli.detection.evaluation.series import Label
from oppload_cli.errors import ManifestError, suggestion

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

REQUIRED = ("file", "label", "onset_frame", "contact_frame")
PASSED_OVER = ("fps", "frames", "width", "height", "source", "licence")
KNOWN = (*REQUIRED, "motion", *PASSED_OVER)
LOOMING, NONE = "looming", "none"


@dataclass(frozen=True)
class Entry:
    """A usable row of a manifest.

    Attributes
    ----------
    row : int
        Its number; the header is row 1.
    path : Path
        The clip.
    label : Label
        What is known of it.
    """

    row: int
    path: Path
    label: Label


@dataclass(frozen=True)
class Manifest:
    """What a manifest names.

    Attributes
    ----------
    path : Path
        The file.
    entries : list of Entry
        Its usable rows, in their order.
    faults : list of str
        What was wrong with it, a sentence each; the rest stands.
    rows : int
        Rows below the header that are not empty.
    """

    path: Path
    entries: list[Entry]
    faults: list[str] = field(default_factory=list)
    rows: int = 0


class RowError(ValueError):
    """What is wrong with one row or one box; the message says what, and what to do."""


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
    rows = _rows(path)
    header = [cell.strip() for cell in rows[0]] if rows else []
    _check_header(path, header)
    manifest = Manifest(path, [], list(_unknown(path, header)))
    seen: dict[str, int] = {}
    count = 0
    for number, cells in enumerate(rows[1:], 2):
        if not any(cell.strip() for cell in cells):
            continue
        count += 1
        try:
            manifest.entries.append(_entry(path, number, header, cells, seen))
        except RowError as fault:
            manifest.faults.append(f"{path}: row {number}: {fault}")
    return Manifest(path, manifest.entries, manifest.faults, count)


def _rows(path: Path) -> list[list[str]]:
    try:
        text = path.read_text(encoding="utf-8-sig")
        return list(csv.reader(io.StringIO(text, newline=""), strict=True))
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise ManifestError(f"{path}: cannot be read ({reason}); check the path") from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise ManifestError(f"{path}: is no CSV in UTF-8 ({error}); correct the file") from error


def _check_header(path: Path, header: Sequence[str]) -> None:
    missing = [name for name in REQUIRED if name not in header]
    if missing:
        raise ManifestError(
            f"{path}: its first row lacks {', '.join(missing)}; begin it with {','.join(REQUIRED)}"
        )
    twice = [name for name in KNOWN if header.count(name) > 1]
    if twice:
        raise ManifestError(f"{path}: its first row has {twice[0]} twice; keep one")


def _unknown(path: Path, header: Sequence[str]) -> Iterator[str]:
    for name in dict.fromkeys(header):
        if name not in KNOWN:
            yield f"{path}: row 1: unknown column '{name}'{suggestion(name, KNOWN)}"


def _entry(
    manifest: Path, number: int, header: Sequence[str], cells: list[str], seen: dict[str, int]
) -> Entry:
    if len(cells) != len(header):
        raise RowError(f"has {len(cells)} cells, not {len(header)}; give one for each column")
    row = dict(zip(header, (cell.strip() for cell in cells), strict=True))
    path = _file(manifest, row["file"])
    same = os.path.realpath(path)
    if same in seen:
        raise RowError(f"{row['file']} is in row {seen[same]} already; keep one of them")
    label = _label(row)
    seen[same] = number
    return Entry(number, path, label)


def _file(manifest: Path, name: str) -> Path:
    if not name:
        raise RowError("names no file; fill in its first column, file")
    path = manifest.parent / name
    if not os.path.exists(path):  # noqa: PTH110 - it says no to any name
        raise RowError(f"{name}: there is no such file; check the path, from the manifest's folder")
    return path


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
