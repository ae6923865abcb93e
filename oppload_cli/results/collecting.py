"""Many results in one table: a row per input and detector, or a row per frame."""

from __future__ import annotations

import csv
import errno
import json
import os
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from oppload_cli.errors import ResultError, reason_of
from oppload_cli.files.reading import is_file, is_folder, reading, text_of
from oppload_cli.files.tables import typed
from oppload_cli.models.registry import default_names, known_names
from oppload_cli.results.table import ModelSummary, columns_for
from oppload_cli.results.writing import SCHEMA
from oppload_cli.schema import parsed_fraction

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from oppload_cli.files.tables import Cell

    Row = dict[str, Cell]


_SIDECAR, _TABLE = ".oppload.json", ".frames.csv"

_ABOUT_INPUT: dict[str, type] = {
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
    "near_repeats": int,
    "pictures_per_s": float,
    "complete": bool,
    "wall_s": float,
    "frames_per_s": float,
    "oppload": str,
    "stimulus": str,
    "looming": bool,
    "contact_time_s": float,
    "model": str,
}
_OF_MODEL: dict[str, type] = {
    name: float if name == "peak" or name.endswith("_s") else int
    for name in ModelSummary.__dataclass_fields__
}
SUMMARY_COLUMNS = {**_ABOUT_INPUT, **_OF_MODEL}
_COUNTS = ("frame", "flow_vectors", "rom_pairs")


def frame_columns(results: Iterable[Path]) -> dict[str, type]:
    """Return the columns of the frames of some results, with the type of their values.

    Parameters
    ----------
    results : iterable of Path
        From :func:`found_results`. The columns of the detectors that run by default are always
        among the columns.
    """
    used, presets, details, degrees = set(default_names()), set(), False, False
    for path in results:
        with suppress(ResultError):  # the error comes again when the rows are read
            content = _sidecar(path)
            models = content.get("models")
            used.update(map(str, models if isinstance(models, list) else ()))
            presets.add(str(content.get("preset")))
            details = details or content.get("columns") == "all"
            degrees = degrees or bool(content.get("field_of_view"))
    named = [name for name in known_names() if name in used]
    kinds = {
        column.name: int if column.name in _COUNTS or column.name.endswith("_alarm") else float
        for column in columns_for(
            named, rmo=True, details=details, degrees=degrees, presets=presets
        )
    }
    return {"result": str, "input": str, **kinds}


def found_results(folder: Path) -> Iterator[Path]:
    """Yield the sidecars in a folder, and the tables that have none, to any depth.

    They come in the order of their names, folder by folder.

    Raises
    ------
    ResultError
        If a folder cannot be read.
    """

    def refuse(error: OSError) -> None:
        with reading(str(error.filename), ResultError):
            raise error

    for place, within, files in os.walk(folder, onerror=refuse):
        within.sort()
        stems = {name.removesuffix(_SIDECAR) for name in files if name.endswith(_SIDECAR)}
        alone = {name.removesuffix(_TABLE) for name in files if name.endswith(_TABLE)} - stems
        for stem in sorted(stems | alone):
            yield Path(place, stem + (_TABLE if stem in alone else _SIDECAR))


def tables_in(path: Path) -> Iterator[Path]:
    """Yield the tables that a name stands for: a file itself, or a folder's to any depth.

    Raises
    ------
    ResultError
        If a folder holds none, or cannot be read.
    """
    if not is_folder(path):
        yield path
        return
    found = [_table_of(each) for each in found_results(path)]
    if not found:
        raise ResultError(f"{path}: holds no result; give a folder of 'oppload run --output'")
    yield from found


def _table_of(path: Path) -> Path:
    """Return the table of a sidecar or table that :func:`found_results` has yielded."""
    if path.name.endswith(_TABLE):
        return path
    return path.with_name(path.name.removesuffix(_SIDECAR) + _TABLE)


def summary_rows(path: Path) -> Iterator[Row]:
    """Yield a row per detector from a sidecar, by the names of ``SUMMARY_COLUMNS``.

    Parameters
    ----------
    path : Path
        From :func:`found_results`.

    Raises
    ------
    ResultError
        If it is no sidecar of ``oppload run``.
    """
    content = _sidecar(path)
    try:
        yield from list(_summaries(path, content))
    except (LookupError, TypeError, ValueError, AttributeError, ArithmeticError) as error:
        raise ResultError(
            f"{path}: lacks something of a sidecar ({type(error).__name__}: {error}); "
            f"run its input again"
        ) from error


def frame_rows(path: Path) -> Iterator[Row]:
    """Yield the frames of the table beside a sidecar, as text, by :func:`frame_columns`.

    Parameters
    ----------
    path : Path
        From :func:`found_results`.

    Raises
    ------
    ResultError
        If that table does not exist, or is none of ``oppload run``.
    """
    facts = _sidecar(path).get("input")
    name = str(facts.get("name", "")) if isinstance(facts, dict) else ""
    table = _table_of(path)
    stem = table.name.removesuffix(_TABLE)
    kinds = frame_columns([path])
    try:
        if not is_file(table):  # a pipe would make it wait
            raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT))
        with table.open(encoding="utf-8", newline="") as file:
            reader = csv.DictReader(file)
            if not set(reader.fieldnames or ()) <= kinds.keys() or not reader.fieldnames:
                raise ResultError(f"{table}: is no table of 'oppload run'; run its input again")
            for row in reader:
                for column, text in row.items():
                    typed(text, kinds[column])
                yield {"result": _text(stem), "input": _text(name), **row}
    except (OSError, TypeError, ValueError, LookupError, ArithmeticError, csv.Error) as error:
        reason = reason_of(error)
        raise ResultError(f"{table}: cannot be read ({reason}); run its input again") from error


def _sidecar(path: Path) -> dict[str, Any]:
    if path.name.endswith(_TABLE):
        raise ResultError(f"{path}: has no sidecar beside it; run its input again")
    again = "run its input again"
    with reading(path, ResultError, form="JSON", check="check its rights", repair=again):
        content = json.loads(text_of(path))
    if not isinstance(content, dict) or content.get("schema") != SCHEMA:
        raise ResultError(f"{path}: is no sidecar of schema {SCHEMA}; {again}")
    return content


def _summaries(path: Path, content: dict[str, Any]) -> Iterator[Row]:
    facts, decode, working = content["input"], content["decode"], content["working"]
    stimulus = content["stimulus"] or {}
    rate = facts["frame_rate"]
    about: Row = {
        "result": path.name.removesuffix(_SIDECAR),
        "input": facts["name"],
        **{name: facts[name] for name in ("kind", "codec", "width", "height")},
        "frame_rate": float(parsed_fraction(rate)) if rate else None,
        "working_width": working["width"],
        "working_height": working["height"],
        "preset": content["preset"],
        **{name: decode[name] for name in ("decoded", "analysed", "missing", "repeats")},
        **{name: decode.get(name) for name in ("near_repeats", "pictures_per_s")},
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
        row = {**about, "model": model, **{name: summary[name] for name in _OF_MODEL}}
        for name, kind in SUMMARY_COLUMNS.items():
            # A wrong kind is found here, not in the middle of a file, and so is a byte of a name
            # that is no text.
            value = typed(row[name], kind)
            row[name] = _text(value) if isinstance(value, str) else row[name]
        yield row


def _text(name: str) -> str:
    r"""Return a name whose undecodable bytes are written as ``\udcff``."""
    return name.encode("utf-8", "backslashreplace").decode()
