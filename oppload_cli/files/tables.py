"""Tables: CSV and Parquet files that are written row by row, and what CSV files hold already."""

from __future__ import annotations

import csv
import io
import math
from contextlib import contextmanager, suppress
from typing import IO, TYPE_CHECKING, Any

from oppload_cli.errors import OutputError
from oppload_cli.files.atomic import PartFile
from oppload_cli.files.reading import is_file

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
    from pathlib import Path

Value = float | int | None
Cell = str | Value

_MOST_ROWS = 10_000  # that are kept in memory before they are written to a Parquet file


class Seconds(float):
    """A time of a frame in seconds: a table has nine decimals of it, so that no two are equal."""


def formatted(value: Cell) -> str:
    """Return the text of a cell: ``%.9g`` of a float, ``1`` for True, and no text for None."""
    if isinstance(value, str):
        return value
    if isinstance(value, Seconds):
        return f"{value:.9f}".rstrip("0").rstrip(".")
    return "" if value is None else f"{value:.9g}" if isinstance(value, float) else str(int(value))


def plain_text(value: Cell) -> str:
    """Return the text of a cell like `formatted`, but ``true`` or ``false`` for a truth value."""
    return str(value).lower() if isinstance(value, bool) else formatted(value)


def finite_text(value: Cell) -> str:
    """Return the text of a cell; empty for NaN and infinity."""
    return "" if isinstance(value, float) and not math.isfinite(value) else plain_text(value)


class _PlainEnds:
    """A stream for a CSV writer that replaces its line ends by line feeds.

    A CSV writer quotes cells with a character of its own line end. The default line end contains
    the carriage return: so the writer quotes a carriage return in a name, which would end the row.
    """

    def __init__(self, stream: IO[str]) -> None:
        self._stream = stream

    def write(self, row: str) -> object:
        return self._stream.write(row.removesuffix("\r\n") + "\n")


class Table:
    """A CSV stream with a header.

    The stream must be opened with ``newline=""``. `cell` returns the text of a value. With
    `at_once`, the operating system gets each row at once, as other programs may read the table
    while it grows.
    """

    def __init__(
        self,
        stream: IO[str],
        columns: Iterable[str],
        cell: Callable[[Any], str] = formatted,
        *,
        at_once: bool = False,
    ) -> None:
        self._stream, self._columns, self._cell = stream, tuple(columns), cell
        self._at_once = at_once
        self._writer = csv.writer(_PlainEnds(stream))
        self._writer.writerow(self._columns)
        self._stream.flush()

    def write(self, row: Mapping[str, Any]) -> None:
        """Write one row; if the row lacks a column, the cell is empty."""
        self._writer.writerow(map(self._cell, map(row.get, self._columns)))
        if self._at_once:
            self._stream.flush()


def csv_text(
    rows: Iterable[Mapping[str, Any]],
    columns: Iterable[str],
    cell: Callable[[Any], str] = formatted,
) -> str:
    """Return rows as the text of a CSV file; the arguments are those of `Table`."""
    text = io.StringIO()
    table = Table(text, columns, cell)
    for row in rows:
        table.write(row)
    return text.getvalue()


@contextmanager
def open_csv(
    path: Path,
    columns: Iterable[str],
    *,
    new: bool = False,
    cell: Callable[[Any], str] = plain_text,
) -> Iterator[Table]:
    """Open a CSV table for writing; the file appears when it is complete, or not at all.

    With `new`, an existing file of this name is an error; `columns` and `cell` are those of
    `Table`. Raises OutputError if the file cannot be written.
    """
    with PartFile(path, new=new) as file:
        yield Table(file.stream, columns, cell)


@contextmanager
def open_table(
    path: Path, columns: Mapping[str, type], *, new: bool = False
) -> Iterator[Table | _Parquet]:
    """Open a table for writing like `open_csv`, as CSV or as Parquet.

    Parameters
    ----------
    path : Path
        ``.csv`` or ``.parquet``.
    columns : mapping of str to type
        Names and types of the columns: str, int, float, bool (written as ``true``).
    new : bool
        Whether an existing file of this name is an error.

    Yields
    ------
    Table or _Parquet
        An object whose `write` takes a row.

    Raises
    ------
    OutputError
        If the file cannot be written, pyarrow is missing, or the suffix is another one.
    """
    match path.suffix.lower():
        case ".csv":
            with open_csv(path, columns, new=new) as table:
                yield table
        case ".parquet":
            arrow = _pyarrow(path)
            with PartFile(path, new=new) as file:
                parquet = _Parquet(arrow, file, columns)
                try:
                    yield parquet
                    parquet.flush()
                    parquet.writer.close()
                finally:
                    # After an error, the file is closed without the end of the table. The writer
                    # would write this end when Python deletes the writer, and fail.
                    parquet.writer.is_open = False
        case _:
            raise OutputError(f"{path}: is neither .csv nor .parquet; choose one for --output")


def rows_of(path: Path, columns: Sequence[str]) -> list[dict[str, str | None]]:
    """Return the rows of a CSV file; none if it cannot be read, or has other columns."""
    if not is_file(path):  # a pipe might never end
        return []
    # Spreadsheets write a byte order mark.
    with (
        suppress(OSError, ValueError, csv.Error),
        path.open(encoding="utf-8-sig", errors="surrogateescape", newline="") as file,
    ):
        reader = csv.DictReader(file)
        return list(reader) if reader.fieldnames == list(columns) else []
    return []


def refuse_another_table(path: Path, columns: Sequence[str]) -> None:
    """Raise OutputError if a file of this name, such as one of the user's, has other columns."""
    header = ",".join(columns)
    if is_file(path):
        with suppress(OSError), path.open(encoding="utf-8-sig", errors="replace") as file:
            if file.readline(len(header) + 1).strip() == header:
                return
        raise OutputError(
            f"{path}: exists already and is no list of this version of 'oppload run'; move it, or "
            "choose another --output"
        )


EMPTY_CELLS = ("", "NA", "NaN", "nan")  # as oppload, R, MATLAB and NumPy write a missing number


def separator_hint(header: Sequence[str]) -> str:
    """Return a hint, for messages, if other characters than commas separate the columns."""
    # As spreadsheets write in many countries, or as they copy cells.
    for mark, name in ((";", "semicolons"), ("\t", "tabs")):
        if len(header) == 1 and mark in header[0]:
            return f" (its cells are separated by {name}, not by commas)"
    return ""


def rows_in(path: Path) -> int:
    """Return how many complete rows a CSV file without line ends in its cells holds."""
    with path.open("rb") as file:
        lines = sum(chunk.count(b"\n") for chunk in iter(lambda: file.read(1 << 20), b""))
    return max(lines - 1, 0)


def typed(value: Cell, kind: type) -> Cell:
    """Convert a value, or the text of a number, to the type of its column; no text becomes None.

    Raises TypeError or ValueError if the value is of another type.
    """
    if value is None or value == "":
        return None
    if kind in {str, bool} and not isinstance(value, kind):
        raise TypeError(f"{value!r} is no {kind.__name__}")
    # A time stays one, so that it keeps its decimals.
    result: Cell = value if kind is float and isinstance(value, Seconds) else kind(value)
    if isinstance(result, int) and not -(2**63) <= result < 2**63:
        raise ValueError("more than 64 bits")  # Parquet and most readers take 64
    return result


def _pyarrow(path: Path) -> Any:
    try:
        import pyarrow.parquet  # noqa: PLC0415 - an optional extra
    except ImportError as error:
        raise OutputError(
            f"{path}: Parquet needs pyarrow; pip install 'oppload[parquet]', or choose a .csv"
        ) from error
    return pyarrow


class _Parquet:
    """A table in a Parquet file; `write` keeps rows in memory, and `flush` writes them."""

    def __init__(self, arrow: Any, file: PartFile, columns: Mapping[str, type]) -> None:
        kinds = {str: arrow.string(), int: arrow.int64(), float: arrow.float64()}
        kinds[bool] = arrow.bool_()
        self._arrow, self._columns = arrow, columns
        self._schema = arrow.schema([(name, kinds[kind]) for name, kind in columns.items()])
        self.writer = arrow.parquet.ParquetWriter(file.binary, self._schema)
        self._rows: list[dict[str, Cell]] = []

    def write(self, row: Mapping[str, Any]) -> None:
        self._rows.append(
            {name: typed(row.get(name), kind) for name, kind in self._columns.items()}
        )
        if len(self._rows) >= _MOST_ROWS:
            self.flush()

    def flush(self) -> None:
        self.writer.write_table(self._arrow.Table.from_pylist(self._rows, schema=self._schema))
        self._rows.clear()
