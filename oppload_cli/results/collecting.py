"""Joins many results in one table, with a row per input and detector, or a row per frame."""

from __future__ import annotations

import os
import re
from collections import defaultdict
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from oppload_cli.errors import NoResultError, ResultError
from oppload_cli.files.atomic import refuse_existing
from oppload_cli.files.reading import is_file, is_folder, is_there, reading
from oppload_cli.files.tables import Cell, Seconds, open_table, typed
from oppload_cli.models.registry import default_names, known_names
from oppload_cli.processes.signals import stop_if_asked
from oppload_cli.results.cells import ANOTHER_RESULT, check_frames, kind_of_column, read_table
from oppload_cli.results.result_files import beside, check_detectors, is_collected
from oppload_cli.results.table import (
    SIDECAR,
    TABLE,
    ModelSummary,
    columns_for,
    fault_of_rows,
    read_sidecar,
)
from oppload_cli.schema import parsed_fraction
from oppload_cli.video.frames import NATIVE

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

    Row = dict[str, Cell]


# By column: the type of its values, the part of the sidecar that has them (empty for the sidecar
# itself), and their key in this part.
_ABOUT_INPUT: dict[str, tuple[type, str, str]] = {
    "input": (str, "input", "name"),
    "kind": (str, "input", "kind"),
    "codec": (str, "input", "codec"),
    "width": (int, "input", "width"),
    "height": (int, "input", "height"),
    "frame_rate": (float, "input", "frame_rate"),
    "working_width": (int, "working", "width"),
    "working_height": (int, "working", "height"),
    "decoded": (int, "decode", "decoded"),
    "analysed": (int, "decode", "analysed"),
    "missing": (int, "decode", "missing"),
    "dropped": (int, "decode", "dropped"),
    "repeats": (int, "decode", "repeats"),
    "near_repeats": (int, "decode", "near_repeats"),
    "pictures_per_s": (float, "decode", "pictures_per_s"),
    "complete": (bool, "decode", "complete"),
    "wall_s": (float, "", "wall_s"),
    "frames_per_s": (float, "", "frames_per_s"),
    "oppload": (str, "tool", "oppload"),
    "stimulus": (str, "stimulus", "name"),
    "looming": (bool, "stimulus", "looming"),
    "contact_time_s": (float, "stimulus", "contact_time_s"),
}
_OF_MODEL: dict[str, type] = {
    name: float if name == "peak" or name.endswith("_s") else int
    for name in ModelSummary.__dataclass_fields__
}
_SUMMARY_COLUMNS: dict[str, type] = {
    "result": str,
    **{column: kind for column, (kind, _, _) in _ABOUT_INPUT.items()},
    "model": str,
    **_OF_MODEL,
}
_LIST_OF_BATCH = re.compile(r"(alarms|failures)(-\d+-of-\d+)?\.csv")
_REMEDY = "run its input again"


class _Collected(NamedTuple):
    """Number of results in the table, of results that could not be read, and of rows.

    `differences` says in which settings the results differ; it is empty if they do not.
    """

    results: int
    failures: int
    rows: int
    differences: str


def collect(
    folders: Sequence[Path],
    output: Path,
    *,
    of_frames: bool,
    if_exists: str,
    on_error: Callable[[ResultError], object],
) -> _Collected:
    """Write one table of the results in folders.

    Parameters
    ----------
    folders : sequence of Path
        Folders, which are searched to any depth. A result that lies in several of them is in the
        table once, under its name in the first one.
    output : Path
        The table, CSV or Parquet.
    of_frames : bool
        Whether the table has a row per frame; if not, it has a row per input and detector.
    if_exists : str
        ``error`` or ``overwrite``, if the table exists already.
    on_error : callable
        Takes the error of each result that cannot be read; the table has the other results.

    Raises
    ------
    NoResultError
        If there are results, but none can be read.
    ResultError
        If there is no result, or a folder cannot be read.
    OutputError
        If the table exists already, or cannot be written.
    """
    refuse_existing([output], if_exists)
    tables: dict[tuple[str, str], tuple[Path, Path]] = {}  # by real folder and name: each once
    for folder in folders:
        if is_file(folder):
            raise ResultError(f"{folder}: is a file; give the folder of the results")
        for table in _tables_below(folder):
            tables.setdefault((os.path.realpath(table.parent), table.name), (table, folder))
    results = tables.values()
    columns = _frame_columns(table for table, _ in results) if of_frames else _SUMMARY_COLUMNS
    good = bad = rows = 0
    settings: defaultdict[str, set[str]] = defaultdict(set)
    with open_table(output, columns, new=if_exists == "error") as collected:
        for table, folder in results:
            stop_if_asked()
            name = _text(table.relative_to(folder).as_posix().removesuffix(TABLE))
            try:
                content = _sidecar(table)
                for row in (_frame_rows if of_frames else _summary_rows)(table, name, content):
                    collected.write(row)
                    rows += 1
            except ResultError as error:
                on_error(error)
                bad += 1
            else:
                good += 1
                _add_settings(settings, content)
        if not good:
            where = ", ".join(map(str, folders))
            if bad:
                raise NoResultError(f"{where}: no result could be read; {_REMEDY}")
            raise ResultError(f"{where}: holds no result of 'oppload run'; check the folder")
    return _Collected(good, bad, rows, _differences(settings))


def _add_settings(settings: defaultdict[str, set[str]], content: dict[str, Any]) -> None:
    """Add the settings of a result to all values of each setting.

    At the native height the parameters are left out, because sizes follow from the input there.
    """
    height, groups = content.get("height"), content.get("parameters")
    settings["--height"].add(str(height or NATIVE))  # null before 1.0
    native = height in {None, NATIVE}
    for group, values in groups.items() if not native and isinstance(groups, dict) else ():
        for name, value in values.items() if isinstance(values, dict) else ():
            settings[f"{group}.{name}"].add("auto" if value is None else str(value))


def _differences(settings: Mapping[str, set[str]]) -> str:
    """Return the settings with several values; parameters only at one height."""
    several = [name for name, values in settings.items() if len(values) > 1]
    decisive = [name for name in several if name == "--height"]
    shown = decisive or several[:3]
    texts = [f"{name} {', '.join(sorted(settings[name]))}" for name in shown]
    omitted = ["..."] if not decisive and len(several) > 3 else []
    return "; ".join(texts + omitted)


def _frame_columns(tables: Iterable[Path]) -> dict[str, type]:
    """Return the columns for the frames of results, with the types of their values.

    The columns of the detectors that run by default are always among them.
    """
    used, details, degrees = set(default_names()), False, False
    for table in tables:
        with suppress(ResultError):  # reading the rows raises the error again
            content = _sidecar(table)
            models = content.get("models")
            used.update(map(str, models if isinstance(models, list) else ()))
            details = details or content.get("columns") == "all"
            degrees = degrees or bool(content.get("field_of_view"))
    models = [name for name in known_names() if name in used]
    columns = columns_for(models, rmo=True, details=details, degrees=degrees)
    kinds = {column.name: kind_of_column(column.name) for column in columns}
    return {"result": str, "input": str, **kinds}


def _tables_below(folder: Path) -> Iterator[Path]:
    """Yield the table of each result in a folder, to any depth; it or its sidecar may not exist.

    The results of one folder are sorted by name.
    """

    def refuse(error: OSError) -> None:
        with reading(str(error.filename), ResultError):
            raise error

    for root, folders, files in os.walk(folder, onerror=refuse):
        folders.sort()
        stems = {
            name.removesuffix(suffix)
            for name in files
            for suffix in (SIDECAR, TABLE)
            if name.endswith(suffix)
        }
        for stem in sorted(stems):
            yield Path(root, stem + TABLE)


def tables_in(paths: Sequence[Path]) -> list[tuple[Path, Path]]:
    """Return pairs of a path and a table: a file is its own table, a folder has many.

    Folders are searched to any depth. ``results/*.csv`` also names the lists that a batch writes
    beside its tables, and collected tables: they are left out if other paths are given too. Raises
    ResultError if a folder has no table, or cannot be read, or if there is nothing else than lists.
    """
    others = [
        path for path in paths if not (_LIST_OF_BATCH.fullmatch(path.name) or is_collected(path))
    ]
    if not others:
        raise ResultError(
            f"{paths[0]}: lists several results; {ANOTHER_RESULT}, or the folder of the results"
        )
    pairs: list[tuple[Path, Path]] = []
    for path in others:
        tables = list(_tables_below(path)) if is_folder(path) else [path]
        if not tables:
            raise ResultError(f"{path}: holds no result; give a folder of 'oppload run --output'")
        pairs += ((path, table) for table in tables)
    return pairs


def _summary_rows(table: Path, name: str, content: dict[str, Any]) -> Iterator[Row]:
    if is_file(table):  # a summary does not need the table, which may have been deleted
        _check_rows(table, content)
    try:
        yield from list(_summaries(name, content))
    except (LookupError, TypeError, ValueError, AttributeError, ArithmeticError) as error:
        raise _incomplete(beside(table), error) from error


def _frame_rows(table: Path, name: str, content: dict[str, Any]) -> Iterator[Row]:
    facts = content.get("input")
    source = str(facts.get("name", "")) if isinstance(facts, dict) else ""
    if not is_file(table):  # also for a pipe, which might never end
        raise ResultError(f"{table}: there is no such file; {_REMEDY}")
    _check_rows(table, content)
    frames = read_table(table, _REMEDY)
    check_detectors(table, content)
    if not set(frames.columns) <= _frame_columns([table]).keys():
        raise ResultError(f"{table}: is no table of 'oppload run'; {_REMEDY}")
    check_frames(table, frames, frames.columns)
    columns = list(frames.columns)
    filled = frames.astype(object).where(frames.notna(), None)
    for cells in filled.itertuples(index=False, name=None):
        row = dict(zip(columns, cells, strict=True))
        yield {"result": name, "input": _text(source), **row, "time_s": Seconds(row["time_s"])}


def _check_rows(table: Path, content: dict[str, Any]) -> None:
    try:
        with reading(table, ResultError, check="check its rights"):
            fault = fault_of_rows(table, content)
    except (LookupError, TypeError) as error:
        raise _incomplete(table, error) from error
    if fault:
        raise ResultError(f"{table}: {fault}; {_REMEDY}")


def _incomplete(path: Path, error: Exception) -> ResultError:
    return ResultError(
        f"{path}: the sidecar is not complete ({type(error).__name__}: {error}); {_REMEDY}"
    )


def _sidecar(table: Path) -> dict[str, Any]:
    path = beside(table)
    if not is_there(path):
        raise ResultError(f"{table}: has no sidecar beside it; {_REMEDY}")
    return read_sidecar(path, ResultError, _REMEDY)


def _summaries(name: str, content: dict[str, Any]) -> Iterator[Row]:
    parts = {**content, "": content, "stimulus": content["stimulus"] or {}}
    about: Row = {"result": name}
    for column, (_, part, key) in _ABOUT_INPUT.items():
        # A ground truth that does not belong to the input has no facts in the sidecar.
        about[column] = parts[part].get(key) if part == "stimulus" else parts[part][key]
    rate = about["frame_rate"]
    about["frame_rate"] = float(parsed_fraction(str(rate))) if rate else None
    for model in content["models"]:
        summary = content["summary"][model]
        row = {**about, "model": model, **{column: summary[column] for column in _OF_MODEL}}
        for column, kind in _SUMMARY_COLUMNS.items():
            # `typed` refuses a value of a wrong type here, before any row is written.
            value = typed(row[column], kind)
            row[column] = _text(value) if isinstance(value, str) else row[column]
        yield row


def _text(name: str) -> str:
    r"""Return a name with its undecodable bytes written as ``\udcff``."""
    return name.encode("utf-8", "backslashreplace").decode()
