"""Reads CSV tables and checks their cells; a message names the column and line of a wrong cell."""

from __future__ import annotations

import re
from io import StringIO
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from oppload_cli.errors import ResultError, reason_of
from oppload_cli.files.reading import is_file, is_folder, is_there, reading, text_of
from oppload_cli.files.tables import EMPTY_CELLS, rows_in, separator_hint
from oppload_cli.results.table import DETECTIONS, SIDECAR, TABLE
from oppload_cli.video.inputs import is_video

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence
    from pathlib import Path

    from numpy.typing import NDArray


ANOTHER_RESULT = "give a frames.csv of 'oppload run'"
_COUNTS = ("frame", "flow_vectors", "rom_pairs")
_TEXTS = ("blind",)
_ALARM = "_alarm"  # end of the names of columns with alarms
# Largest number that is read. The largest of a detector is a product of four sums over quarters of
# the frame: about 1e19 at a height of 600 px, and 1e29 at 8192 px.
LARGEST = 1e30


def read_table(
    path: Path, advice: str, wanted: Callable[[str], bool] | None = None
) -> pd.DataFrame:
    """Read a table without checking its cells; cells that are empty, NA or NaN are NaN.

    Parameters
    ----------
    path : Path
        The CSV file; its last row may be cut.
    advice : str
        What the user can do if the file is not a table.
    wanted : callable, optional
        Returns whether to read the column of a name; by default all columns are read.

    Raises
    ------
    ResultError
        If the file cannot be read, is not a CSV table, or has no row.
    """
    if is_folder(path):
        raise ResultError(f"{path}: is a folder; {advice}")
    check, video_advice = "check the path", "run it first with 'oppload run'"
    if beside := _result_beside(path):
        check = video_advice = advice = f"did you mean '{beside}'?"
    if is_video(path.name) and is_there(path):
        raise ResultError(f"{path}: is a video, not a result; {video_advice}")
    # Sidecars, detections and settings lie beside tables.
    if path.suffix in {".json", ".jsonl", ".toml"} and is_there(path):
        raise ResultError(f"{path}: is not a CSV table; {advice}")
    with reading(path, ResultError, form="text in UTF-8", check=check, repair=advice):
        hint = separator_hint([_first_line(path)])
        if hint:
            raise ResultError(f"{path}: is not a CSV table{hint}; save it with commas")
        table = _parsed(path, advice, wanted)
    if table.empty and len(table.columns):  # without columns, the caller names a missing column
        raise ResultError(f"{path}: holds no row; run the input again")
    return table


def _first_line(path: Path) -> str:
    """Return the names of a table's columns, up to the first comma; empty for a pipe."""
    if not is_file(path):  # a pipe can be read only once
        return ""
    with path.open(encoding="utf-8-sig") as file:
        return file.readline(1 << 16).partition(",")[0]


def _parsed(path: Path, advice: str, wanted: Callable[[str], bool] | None) -> pd.DataFrame:
    source: Path | StringIO = path
    if is_file(path):
        rows = rows_in(path)  # without a last row that was cut
    else:  # a pipe, which can be read only once
        source, rows = StringIO(text_of(path, pipes=True)), None
    try:
        table = pd.read_csv(
            source, keep_default_na=False, na_values=EMPTY_CELLS, usecols=wanted, nrows=rows
        )
        # R and pandas write the numbers of the rows first, under no name.
        return table.drop(columns="Unnamed: 0", errors="ignore")
    except UnicodeDecodeError:
        raise
    except ValueError as error:  # all errors of pandas' parser are ValueErrors
        reason = reason_of(error)
        if "out of memory" in reason:  # the parser raises no MemoryError
            raise MemoryError(reason) from error
        uneven = re.search(r"Expected (\d+) fields in line (\d+), saw (\d+)", str(error))
        if uneven:
            cells, line, found = uneven.groups()
            reason = f"line {line} has {found} cells, not {cells}"
        raise ResultError(f"{path}: is not a CSV table ({reason}); {advice}") from error


def _result_beside(path: Path) -> Path | None:
    """Return the table of the result of which a path is the input, another file, or half a name."""
    stem = path.name.removesuffix(SIDECAR).removesuffix(DETECTIONS)
    for name in (path.name, stem, path.stem):
        table = path.with_name(name + TABLE)
        if table != path and is_file(table):
            return table
    return None


def check_frames(path: Path, frames: pd.DataFrame, names: Iterable[str]) -> None:
    """Check the cells of ``frame``, ``time_s`` and the columns `names` in the table `frames`.

    Raises
    ------
    ResultError
        If a cell is not a finite number, a count is not an integer, or an alarm is neither 0 nor 1,
        or if frame numbers or times do not increase. The message names `path` and the line.
    """
    need_columns(path, frames, ("frame", "time_s"), ANOTHER_RESULT)
    for name in ("frame", "time_s", *sorted(set(names) - {"frame", "time_s", *_TEXTS})):
        values = check_numbers(path, frames, name)
        alarm = name.endswith(_ALARM)
        if alarm or name in {"frame", "time_s"}:
            check_filled(path, name, values, "run it again")
        if alarm:
            _refuse(path, frames, name, ~np.isin(values, (0, 1)), "is neither 0 nor 1")
        elif kind_of_column(name) is int:
            _refuse(path, frames, name, values % 1 > 0, "is not a whole number")
        if name in {"frame", "time_s"}:
            back = np.diff(values, prepend=-np.inf) <= 0
            _refuse(path, frames, name, back, "is not above the value in the row before")


def kind_of_column(name: str) -> type:
    """Return the type of a column's values: int (counts and alarms), str (words) or float."""
    return int if name in _COUNTS or name.endswith(_ALARM) else str if name in _TEXTS else float


def check_numbers(path: Path, table: pd.DataFrame, name: str) -> NDArray[np.float64]:
    """Return the numbers of a column of a table, NaN for empty cells.

    Raises
    ------
    ResultError
        If a cell is neither empty nor a finite number. The message names `path` and the line.
    """
    cells = table[name]
    if cells.dtype in (object, bool):  # pandas keeps very long integers, and words, as they are
        cells = cells.where(cells.isna(), cells.astype(str))
    values = np.asarray(pd.to_numeric(cells, errors="coerce"), float)
    bad = cells.notna().to_numpy() & ~(np.abs(values) <= LARGEST)
    _refuse(path, table, name, bad, "is not a finite number")
    return values


def _refuse(path: Path, table: pd.DataFrame, name: str, bad: NDArray[np.bool_], why: str) -> None:
    """Raise a ResultError that names the first bad cell of a column, if there is one."""
    if bad.any():
        row = int(bad.argmax())
        raise ResultError(
            f"{path}: column '{name}' holds '{str(table[name].iloc[row])[:40]}' in line {row + 2}, "
            f"which {why}; make the file again"
        )


def check_filled(path: Path, name: str, values: NDArray[np.float64], advice: str) -> None:
    """Raise a ResultError that names the line of the first empty cell, if there is one."""
    empty = np.isnan(values)
    if empty.any():
        line = int(empty.argmax()) + 2
        raise ResultError(f"{path}: column '{name}' is empty in line {line}; {advice}")


def need_columns(path: Path, table: pd.DataFrame, columns: Sequence[str], advice: str) -> None:
    """Raise a ResultError that names the first missing column, if one is missing."""
    for name in columns:
        if name not in table.columns:
            raise ResultError(f"{path}: has no column '{name}'; {advice}")
