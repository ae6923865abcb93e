"""Tables that are written row by row, as CSV or as Parquet."""

from __future__ import annotations

import csv
from contextlib import contextmanager
from typing import TYPE_CHECKING, Protocol

from oppload_cli.errors import OutputError
from oppload_cli.results.table import PartFile, cannot_write, formatted
from oppload_cli.video.atomic import part_of

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

Cell = str | int | float | bool | None

ROWS_AT_ONCE = 10_000  # of a Parquet file: what is in memory


class Sink(Protocol):
    """Where rows go."""

    def write(self, row: Mapping[str, Cell]) -> None:
        """Take one row."""


@contextmanager
def sink(path: Path, columns: Mapping[str, type]) -> Iterator[Sink]:
    """Open the table to collect into; it appears whole or not at all.

    Parameters
    ----------
    path : Path
        ``.csv`` or ``.parquet``.
    columns : mapping of str to type
        Their names and kinds.

    Yields
    ------
    Sink
        A row at a time; little is kept in memory.

    Raises
    ------
    OutputError
        If it cannot be written, or pyarrow is missing, or the suffix is another.
    """
    kinds: dict[str, type[_CsvSink | _ParquetSink]] = {
        ".csv": _CsvSink,
        ".parquet": _ParquetSink,
    }
    if path.suffix.lower() not in kinds:
        raise OutputError(f"{path}: is neither .csv nor .parquet; choose one for --output")
    opened = kinds[path.suffix.lower()](path, columns)
    try:
        yield opened
        opened.commit()
    except BaseException as error:
        opened.discard()
        if isinstance(error, OSError):
            raise cannot_write(path, error) from error
        raise


class _CsvSink:
    def __init__(self, path: Path, columns: Mapping[str, type]) -> None:
        self._file = PartFile(path)
        self._columns = tuple(columns)
        self._writer = csv.writer(self._file.stream, lineterminator="\n")
        self._writer.writerow(self._columns)
        self.commit, self.discard = self._file.commit, self._file.discard

    def write(self, row: Mapping[str, Cell]) -> None:
        self._writer.writerow([_text(row.get(name)) for name in self._columns])


class _ParquetSink:
    def __init__(self, path: Path, columns: Mapping[str, type]) -> None:
        try:
            import pyarrow  # noqa: PLC0415 - an optional extra
            import pyarrow.parquet  # noqa: PLC0415
        except ImportError as error:
            raise OutputError(
                f"{path}: Parquet needs pyarrow; pip install 'oppload[parquet]', or choose a .csv"
            ) from error
        kinds = {
            str: pyarrow.string(),
            int: pyarrow.int64(),
            float: pyarrow.float64(),
            bool: pyarrow.bool_(),
        }
        self._pyarrow, self._path, self._columns = pyarrow, path, dict(columns)
        self._schema = pyarrow.schema([(name, kinds[kind]) for name, kind in columns.items()])
        self._rows: list[Mapping[str, Cell]] = []
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._writer = pyarrow.parquet.ParquetWriter(str(part_of(path)), self._schema)
        except OSError as error:
            raise cannot_write(path, error) from error

    def write(self, row: Mapping[str, Cell]) -> None:
        self._rows.append(row)
        if len(self._rows) >= ROWS_AT_ONCE:
            self._flush()

    def commit(self) -> None:
        self._flush()
        self._writer.close()
        part_of(self._path).replace(self._path)

    def discard(self) -> None:
        part_of(self._path).unlink(missing_ok=True)

    def _flush(self) -> None:
        arrays = [
            self._pyarrow.array([typed(row.get(name), kind) for row in self._rows], type=field)
            for (name, kind), field in zip(self._columns.items(), self._schema.types, strict=True)
        ]
        batch = self._pyarrow.table(arrays, schema=self._schema)
        self._writer.write_table(batch)
        self._rows.clear()


def typed(value: Cell, kind: type) -> Cell:
    """Return a value as its column has it.

    Parameters
    ----------
    value : str, int, float, bool or None
        Also the text of a number.
    kind : type
        Of the column.

    Returns
    -------
    str, int, float, bool or None
        An empty cell is None.

    Raises
    ------
    TypeError, ValueError
        If it is of another kind.
    """
    if value is None or value == "":
        return None
    if kind in {str, bool} and not isinstance(value, kind):
        raise TypeError(f"{value!r} is no {kind.__name__}")
    result: Cell = kind(value)
    return result


def _text(value: Cell) -> str:
    if isinstance(value, str):
        return value
    return str(value).lower() if isinstance(value, bool) else formatted(value)
