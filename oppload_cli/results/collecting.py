"""Many results into one table: a row per input and model, or all frames."""

from __future__ import annotations

import csv
import json
import os
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

from oppload_cli.errors import ResultError
from oppload_cli.results.columns import MODELS, columns_for
from oppload_cli.results.sidecar import SCHEMA
from oppload_cli.results.sinks import typed
from oppload_cli.results.summary import ModelSummary

if TYPE_CHECKING:
    from collections.abc import Iterator

    from oppload_cli.results.sinks import Cell

    Row = dict[str, Cell]


SIDECAR, TABLE = ".oppload.json", ".frames.csv"

ABOUT_INPUT: dict[str, type] = {
    "result": str,
    "input": str,
    "kind": str,
    "codec": str,
    "width": int,
    "height": int,
    "frame_rate": float,
    "working_width": int,
    "working_height": int,
    "preset": str,
    "decoded": int,
    "analysed": int,
    "missing": int,
    "repeats": int,
    "complete": bool,
    "wall_s": float,
    "frames_per_s": float,
    "oppload": str,
    "stimulus": str,
    "looming": bool,
    "contact_time_s": float,
    "model": str,
}
OF_MODEL: dict[str, type] = {
    name: float if name == "peak" or name.endswith("_s") else int
    for name in ModelSummary.__dataclass_fields__
}
SUMMARY_COLUMNS = {**ABOUT_INPUT, **OF_MODEL}
COUNTS = ("frame", "flow_vectors", "rom_pairs", "opplod_alarm", "dlgmd_alarm")
FRAME_COLUMNS: dict[str, type] = {
    "result": str,
    "input": str,
    **{
        column.name: int if column.name in COUNTS else float
        for column in columns_for(MODELS, rmo=True)
    },
}


def found_results(folder: Path) -> Iterator[Path]:
    """Yield the sidecars in a folder, and the tables that have none, to any depth.

    Parameters
    ----------
    folder : Path
        Where results are.

    Yields
    ------
    Path
        In the order of their names, folder by folder.

    Raises
    ------
    ResultError
        If a folder cannot be read.
    """

    def refuse(error: OSError) -> None:
        reason = (error.strerror or str(error)).lower()
        raise ResultError(f"{error.filename}: cannot be read ({reason}); check the path")

    for place, within, files in os.walk(folder, onerror=refuse):
        within.sort()
        stems = {name.removesuffix(SIDECAR) for name in files if name.endswith(SIDECAR)}
        alone = {name.removesuffix(TABLE) for name in files if name.endswith(TABLE)} - stems
        for stem in sorted(stems | alone):
            yield Path(place, stem + (TABLE if stem in alone else SIDECAR))


def summary_rows(path: Path) -> Iterator[Row]:
    """Yield what a sidecar says: a row per model.

    Parameters
    ----------
    path : Path
        From :func:`found_results`.

    Yields
    ------
    dict
        By the names of ``SUMMARY_COLUMNS``.

    Raises
    ------
    ResultError
        If it is no sidecar of ``oppload run``.
    """
    content = _sidecar(path)
    try:
        yield from list(_summaries(path, content))
    except (KeyError, TypeError, ValueError, AttributeError, ZeroDivisionError) as error:
        raise ResultError(
            f"{path}: lacks something of a sidecar ({type(error).__name__}: {error}); "
            f"run its input again"
        ) from error


def frame_rows(path: Path) -> Iterator[Row]:
    """Yield the frames of the table that belongs to a sidecar, as text.

    Parameters
    ----------
    path : Path
        From :func:`found_results`.

    Yields
    ------
    dict
        By the names of ``FRAME_COLUMNS``; those that the table lacks are left out.

    Raises
    ------
    ResultError
        If there is no such table, or it is none of ``oppload run``.
    """
    name = _sidecar(path).get("input", {}).get("name", "")
    table = path.with_name(path.name.removesuffix(SIDECAR) + TABLE)
    stem = table.name.removesuffix(TABLE)
    try:
        with table.open(encoding="utf-8", newline="") as file:
            reader = csv.DictReader(file)
            if not set(reader.fieldnames or ()) <= FRAME_COLUMNS.keys() or not reader.fieldnames:
                raise ResultError(f"{table}: is no table of 'oppload run'; run its input again")
            for row in reader:
                for column, text in row.items():
                    typed(text, FRAME_COLUMNS[column])
                yield {"result": stem, "input": name, **row}
    except (OSError, TypeError, ValueError, KeyError, csv.Error) as error:
        reason = (getattr(error, "strerror", None) or str(error)).lower()
        raise ResultError(f"{table}: cannot be read ({reason}); run its input again") from error


def _sidecar(path: Path) -> dict[str, Any]:
    if path.name.endswith(TABLE):
        raise ResultError(f"{path}: has no sidecar beside it; run its input again")
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise ResultError(f"{path}: cannot be read ({reason}); check its rights") from error
    except ValueError as error:  # of JSON, or of UTF-8
        raise ResultError(f"{path}: is not valid JSON ({error}); run its input again") from error
    if not isinstance(content, dict) or content.get("schema") != SCHEMA:
        raise ResultError(f"{path}: is no sidecar of schema {SCHEMA}; run its input again")
    return content


def _summaries(path: Path, content: dict[str, Any]) -> Iterator[Row]:
    facts, decode, working = content["input"], content["decode"], content["working"]
    stimulus = content["stimulus"] or {}
    rate = facts["frame_rate"]
    about: Row = {
        "result": path.name.removesuffix(SIDECAR),
        "input": facts["name"],
        **{name: facts[name] for name in ("kind", "codec", "width", "height")},
        "frame_rate": float(Fraction(rate)) if rate else None,
        "working_width": working["width"],
        "working_height": working["height"],
        "preset": content["preset"],
        **{name: decode[name] for name in ("decoded", "analysed", "missing", "repeats")},
        "complete": decode["complete"],
        "wall_s": content["wall_s"],
        "frames_per_s": content["frames_per_s"],
        "oppload": content["tool"]["oppload"],
        "stimulus": stimulus.get("name"),
        "looming": stimulus.get("looming"),
        "contact_time_s": stimulus.get("contact_time_s"),
    }
    for model in content["models"]:
        summary = content["summary"][model]
        row = {**about, "model": model, **{name: summary[name] for name in OF_MODEL}}
        for name, kind in SUMMARY_COLUMNS.items():
            typed(row[name], kind)  # a wrong kind is found here, not in the middle of a file
        yield row
