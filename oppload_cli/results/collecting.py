"""Collects many results in one table, with a row per input and detector, or per frame."""

from __future__ import annotations

import os
import re
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from oppload_cli.errors import NoResultError, ResultError
from oppload_cli.files.atomic import refuse_existing
from oppload_cli.files.reading import is_file, is_folder, reading
from oppload_cli.files.tables import open_table, typed
from oppload_cli.models.registry import default_names, known_names
from oppload_cli.processes.signals import stop_if_asked
from oppload_cli.results.reading import check_frames, kind_of_column, read_table
from oppload_cli.results.table import (
    SIDECAR,
    TABLE,
    ModelSummary,
    columns_for,
    fault_of_rows,
    read_sidecar,
)
from oppload_cli.schema import parsed_fraction

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

    from oppload_cli.files.tables import Cell

    Row = dict[str, Cell]


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
_SUMMARY_COLUMNS = {**_ABOUT_INPUT, **_OF_MODEL}
_LIST_OF_BATCH = re.compile(r"(alarms|failures)(-\d+-of-\d+)?\.csv")
_REMEDY = "run its input again"


class _Collected(NamedTuple):
    """Numbers of results that were and were not collected, and of rows."""

    good: int
    bad: int
    rows: int


def collect(
    folders: Sequence[Path],
    output: Path,
    *,
    of_frames: bool,
    if_exists: str,
    told: Callable[[ResultError], object],
) -> _Collected:
    """Write one table of the results in folders.

    Parameters
    ----------
    folders : sequence of Path
        Folders, searched to any depth.
    output : Path
        The table, CSV or Parquet.
    of_frames : bool
        Whether the table has a row per frame; if not it has a row per input and detector.
    if_exists : str
        ``error`` or ``overwrite``.
    told : callable
        Called with the error of each result that cannot be collected. The others are collected.

    Raises
    ------
    NoResultError
        If there are results, but none can be collected.
    ResultError
        If there is no result, or a folder cannot be read.
    OutputError
        If the table exists already, or cannot be written.
    """
    refuse_existing([output], if_exists)
    results = [(path, folder) for folder in folders for path in _found_results(folder)]
    columns = _frame_columns(path for path, _ in results) if of_frames else _SUMMARY_COLUMNS
    good = bad = rows = 0
    with open_table(output, columns, new=if_exists == "error") as table:
        for path, folder in results:
            stop_if_asked()
            name = _name_in(folder, path)
            try:
                for row in (_frame_rows if of_frames else _summary_rows)(path, name):
                    table.write(row)
                    rows += 1
            except ResultError as error:
                told(error)
                bad += 1
            else:
                good += 1
        if not good:
            where = ", ".join(map(str, folders))
            if bad:
                raise NoResultError(f"{where}: no result could be read; {_REMEDY}")
            raise ResultError(f"{where}: no result of 'oppload run' in there; check the folder")
    return _Collected(good, bad, rows)


def _frame_columns(results: Iterable[Path]) -> dict[str, type]:
    """Return the columns of the frames of some results, with the types of their values.

    They always include the columns of the detectors that run by default.
    """
    used, presets, details, degrees = set(default_names()), set(), False, False
    for path in results:
        with suppress(ResultError):  # reading the rows raises the error again
            content = _sidecar(path)
            models = content.get("models")
            used.update(map(str, models if isinstance(models, list) else ()))
            presets.add(str(content.get("preset")))
            details = details or content.get("columns") == "all"
            degrees = degrees or bool(content.get("field_of_view"))
    named = [name for name in known_names() if name in used]
    kinds = {
        column.name: kind_of_column(column.name)
        for column in columns_for(
            named, rmo=True, details=details, degrees=degrees, presets=presets
        )
    }
    return {"result": str, "input": str, **kinds}


def _found_results(folder: Path) -> Iterator[Path]:
    """Yield the sidecars in a folder of any depth, and the tables without a sidecar.

    They are sorted by name within each folder.
    """

    def refuse(error: OSError) -> None:
        with reading(str(error.filename), ResultError):
            raise error

    for place, within, files in os.walk(folder, onerror=refuse):
        within.sort()
        stems = {name.removesuffix(SIDECAR) for name in files if name.endswith(SIDECAR)}
        alone = {name.removesuffix(TABLE) for name in files if name.endswith(TABLE)} - stems
        for stem in sorted(stems | alone):
            yield Path(place, stem + (TABLE if stem in alone else SIDECAR))


def _name_in(folder: Path, path: Path) -> str:
    suffix = TABLE if path.name.endswith(TABLE) else SIDECAR
    return _text(path.relative_to(folder).as_posix().removesuffix(suffix))


def tables_in(paths: Sequence[Path]) -> list[tuple[Path, Path]]:
    """Return the tables that names stand for, each after its name.

    A file stands for itself, and a folder for the tables in it, to any depth. The lists that a
    batch writes beside its tables are left out where tables are named too, as by ``results/*.csv``.

    Raises
    ------
    ResultError
        If a folder has no table, or cannot be read.
    """
    others = [path for path in paths if not _LIST_OF_BATCH.fullmatch(path.name)]
    found: list[tuple[Path, Path]] = []
    for path in others or paths:
        tables = [_table_of(each) for each in _found_results(path)] if is_folder(path) else [path]
        if not tables:
            raise ResultError(f"{path}: holds no result; give a folder of 'oppload run --output'")
        found += ((path, table) for table in tables)
    return found


def _table_of(path: Path) -> Path:
    if path.name.endswith(TABLE):
        return path
    return path.with_name(path.name.removesuffix(SIDECAR) + TABLE)


def _summary_rows(path: Path, name: str) -> Iterator[Row]:
    """Yield a row per detector from the sidecar of a result; `name` is the result's name."""
    content, table = _sidecar(path), _table_of(path)
    if is_file(table):  # a summary needs only the sidecar
        _check_rows(table, content)
    try:
        yield from list(_summaries(name, content))
    except (LookupError, TypeError, ValueError, AttributeError, ArithmeticError) as error:
        raise _lacking(path, error) from error


def _frame_rows(path: Path, name: str) -> Iterator[Row]:
    content, table = _sidecar(path), _table_of(path)
    facts = content.get("input")
    source = str(facts.get("name", "")) if isinstance(facts, dict) else ""
    if not is_file(table):  # reading a pipe might never end
        raise ResultError(f"{table}: there is no such file; {_REMEDY}")
    _check_rows(table, content)
    frames = read_table(table, _REMEDY)
    if not set(frames.columns) <= _frame_columns([path]).keys():
        raise ResultError(f"{table}: is no table of 'oppload run'; {_REMEDY}")
    check_frames(table, frames, frames.columns)
    columns = list(frames.columns)
    filled = frames.astype(object).where(frames.notna(), None)
    for cells in filled.itertuples(index=False, name=None):
        yield {"result": name, "input": _text(source), **dict(zip(columns, cells, strict=True))}


def _check_rows(table: Path, content: dict[str, Any]) -> None:
    try:
        with reading(table, ResultError, check="check its rights"):
            fault = fault_of_rows(table, content)
    except (LookupError, TypeError) as error:
        raise _lacking(table, error) from error
    if fault:
        raise ResultError(f"{table}: {fault}; {_REMEDY}")


def _lacking(path: Path, error: Exception) -> ResultError:
    return ResultError(
        f"{path}: lacks something of a sidecar ({type(error).__name__}: {error}); {_REMEDY}"
    )


def _sidecar(path: Path) -> dict[str, Any]:
    if path.name.endswith(TABLE):
        raise ResultError(f"{path}: has no sidecar beside it; {_REMEDY}")
    return read_sidecar(path, ResultError, _REMEDY)


def _summaries(name: str, content: dict[str, Any]) -> Iterator[Row]:
    facts, decode, working = content["input"], content["decode"], content["working"]
    stimulus = content["stimulus"] or {}
    rate = facts["frame_rate"]
    about: Row = {
        "result": name,
        "input": facts["name"],
        **{key: facts[key] for key in ("kind", "codec", "width", "height")},
        "frame_rate": float(parsed_fraction(rate)) if rate else None,
        "working_width": working["width"],
        "working_height": working["height"],
        "preset": content["preset"],
        **{key: decode[key] for key in ("decoded", "analysed", "missing", "repeats")},
        **{key: decode.get(key) for key in ("near_repeats", "pictures_per_s")},
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
        row = {**about, "model": model, **{column: summary[column] for column in _OF_MODEL}}
        for column, kind in _SUMMARY_COLUMNS.items():
            # A value of a wrong type, or a name with an undecodable byte, is found here, before
            # any row is written.
            value = typed(row[column], kind)
            row[column] = _text(value) if isinstance(value, str) else row[column]
        yield row


def _text(name: str) -> str:
    r"""Return a name with its undecodable bytes written as ``\udcff``."""
    return name.encode("utf-8", "backslashreplace").decode()
