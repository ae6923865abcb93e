"""Tables that are written row by row, as CSV or as Parquet."""

from __future__ import annotations

import csv
import time
from contextlib import contextmanager
from typing import IO, TYPE_CHECKING, Any, Self

from oppload_cli.errors import OutputError
from oppload_cli.files.atomic import PartFile

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping
    from pathlib import Path

Value = float | int | None
Cell = str | Value

_FLUSH_EVERY_S = 1.0
_ROWS_AT_ONCE = 10_000  # of a Parquet file are in memory


def formatted(value: Cell) -> str:
    """Return a cell as all tables have it: a number ``%.9g``, nothing for None, 1 for True."""
    if isinstance(value, str):
        return value
    return "" if value is None else f"{value:.9g}" if isinstance(value, float) else str(int(value))


class _PlainEnds:
    """A stream of rows that end in a line feed alone.

    A CSV writer quotes a cell only if it holds a character of the writer's own line end. The
    default line end, carriage return and line feed, makes it quote both: without quotes, a carriage
    return in a name would end the row for a reader.
    """

    def __init__(self, stream: IO[str]) -> None:
        self._stream = stream

    def write(self, row: str) -> object:
        return self._stream.write(row.removesuffix("\r\n") + "\n")


class Table:
    """A CSV stream: a header, then rows that are on the disk within a second.

    Parameters
    ----------
    stream : text file
        Opened with ``newline=""``.
    columns : iterable of str
        The header.
    cell : callable
        Returns a value as its text.
    """

    def __init__(
        self, stream: IO[str], columns: Iterable[str], cell: Callable[[Any], str] = formatted
    ) -> None:
        self._stream, self._columns, self._cell = stream, tuple(columns), cell
        self._writer = csv.writer(_PlainEnds(stream))
        self._writer.writerow(self._columns)
        self._stream.flush()
        self._flushed = time.monotonic()

    def write(self, row: Mapping[str, Any]) -> None:
        """Write one row; a column that it lacks is an empty cell."""
        self._writer.writerow(map(self._cell, map(row.get, self._columns)))
        now = time.monotonic()
        if now - self._flushed >= _FLUSH_EVERY_S:
            self._stream.flush()
            self._flushed = now


@contextmanager
def open_table(
    path: Path, columns: Mapping[str, type], *, new: bool = False
) -> Iterator[Table | _Parquet]:
    """Open a table for many rows; it appears when it is complete, or not at all.

    Parameters
    ----------
    path : Path
        ``.csv`` or ``.parquet``.
    columns : mapping of str to type
        Names and types of the columns: str, int, float, bool (written as ``true``).
    new : bool
        Whether a file of this name is an error.

    Yields
    ------
    Table
        Its `write` takes a row; few rows are in memory at a time.

    Raises
    ------
    OutputError
        If it cannot be written, or pyarrow is missing, or the suffix is another.
    """
    suffix = path.suffix.lower()
    if suffix not in {".csv", ".parquet"}:
        raise OutputError(f"{path}: is neither .csv nor .parquet; choose one for --output")
    arrow = _pyarrow(path) if suffix == ".parquet" else None
    with PartFile(path, new=new) as file:
        if arrow is None:
            yield Table(file.stream, columns, _text)
        else:
            with _Parquet(arrow, file, columns) as table:
                yield table


def rows_in(path: Path) -> int:
    """Return how many complete rows a CSV file without line ends in its cells holds."""
    with path.open("rb") as file:
        lines = sum(chunk.count(b"\n") for chunk in iter(lambda: file.read(1 << 20), b""))
    return max(lines - 1, 0)


def typed(value: Cell, kind: type) -> Cell:
    """Return a value, or the text of a number, as its column has it; None for an empty cell.

    Raises
    ------
    TypeError, ValueError
        If it is of another type.
    """
    if value is None or value == "":
        return None
    if kind in {str, bool} and not isinstance(value, kind):
        raise TypeError(f"{value!r} is no {kind.__name__}")
    result: Cell = kind(value)
    if isinstance(result, int) and not -(2**63) <= result < 2**63:
        raise ValueError("more than 64 bits")  # which Parquet and most readers have
    return result


def _text(value: Cell) -> str:
    if isinstance(value, str):
        return value
    return str(value).lower() if isinstance(value, bool) else formatted(value)


def _pyarrow(path: Path) -> Any:
    try:
        import pyarrow.parquet  # noqa: PLC0415 - an optional extra
    except ImportError as error:
        raise OutputError(
            f"{path}: Parquet needs pyarrow; pip install 'oppload[parquet]', or choose a .csv"
        ) from error
    return pyarrow


class _Parquet:
    def __init__(self, arrow: Any, file: PartFile, columns: Mapping[str, type]) -> None:
        kinds = {str: arrow.string(), int: arrow.int64(), float: arrow.float64()}
        kinds[bool] = arrow.bool_()
        self._arrow, self._columns = arrow, dict(columns)
        self._schema = arrow.schema([(name, kinds[kind]) for name, kind in columns.items()])
        self._writer = arrow.parquet.ParquetWriter(file.binary, self._schema)
        self._rows: list[Mapping[str, Any]] = []

    def write(self, row: Mapping[str, Any]) -> None:
        self._rows.append(row)
        if len(self._rows) >= _ROWS_AT_ONCE:
            self._flush()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        try:
            if error is None:
                self._flush()
                self._writer.close()
        finally:
            # Else the writer of a table that failed would write the end of the file as it is
            # deleted, when the file is closed.
            self._writer.is_open = False

    def _flush(self) -> None:
        arrays = [
            self._arrow.array([typed(row.get(name), kind) for row in self._rows], type=field)
            for (name, kind), field in zip(self._columns.items(), self._schema.types, strict=True)
        ]
        self._writer.write_table(self._arrow.table(arrays, schema=self._schema))
        self._rows.clear()
