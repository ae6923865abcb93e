"""Writing ``frames.csv``, a row per frame."""

from __future__ import annotations

import os
import platform
import sys
import time
from contextlib import contextmanager, suppress
from typing import IO, TYPE_CHECKING

from oppload_cli.errors import BusyError, OutputError
from oppload_cli.video.atomic import part_of

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from pathlib import Path

Value = float | int | None
FLUSH_EVERY_S = 1.0
DYING_S = 0.5  # that a run which was killed may still hold its lock


def formatted(value: Value) -> str:
    """Return a value as the CSV has it: ``%.9g``, nothing for None.

    Parameters
    ----------
    value : float, int or None

    Returns
    -------
    str
    """
    return "" if value is None else f"{value:.9g}" if isinstance(value, float) else str(int(value))


class Table:
    """A CSV stream: header first, then a row per frame, on the disk within a second.

    Parameters
    ----------
    stream : text file
        Where it is written; opened with ``newline=""``.
    columns : sequence of str
        The header.
    """

    def __init__(self, stream: IO[str], columns: Sequence[str]) -> None:
        self._stream = stream
        self._columns = tuple(columns)
        self._flushed = time.monotonic()
        self._stream.write(",".join(columns) + "\n")
        self._stream.flush()

    def write(self, values: Mapping[str, Value]) -> None:
        """Write one row.

        Parameters
        ----------
        values : mapping of str to float, int or None
            By column; a column without a value is an empty cell.
        """
        row = ",".join(map(formatted, map(values.get, self._columns)))
        self._stream.write(row + "\n")
        now = time.monotonic()
        if now - self._flushed >= FLUSH_EVERY_S:
            self._stream.flush()
            self._flushed = now


class PartFile:
    """A file that appears under its name only when it is whole.

    It is written as ``NAME.part``; a run that is interrupted leaves that, readable
    as far as it goes; one that fails before its first byte of content leaves nothing.
    Where the file system has no locks it is ``NAME.HOST-PROCESS.part``, so that two
    runs never write into one file.

    Parameters
    ----------
    path : Path
        The final name.

    Raises
    ------
    OutputError
        If it cannot be written there.
    BusyError
        If another run is writing it.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._open(part_of(path))
        except OSError as error:
            raise cannot_write(path, error) from error

    def _open(self, part: Path) -> None:
        self.part = part
        # Emptied only once it is known to be ours alone.
        self.stream = part.open("a", encoding="utf-8", errors="surrogateescape", newline="")
        try:
            alone = _ours_alone(self.stream, part)
            if alone is False:
                raise BusyError(f"{self.path}: another run is writing it; wait for that one")
            own = _part_of_this_process(self.path)
            if alone is None and part != own:
                self.stream.close()
                if not part.stat().st_size:  # made just now
                    part.unlink()
                self._open(own)
                return
            self.stream.truncate(0)
        except BaseException:
            self.stream.close()
            raise

    def commit(self) -> None:
        """Close the file and give it its name.

        Raises
        ------
        OutputError
            If the disk refuses.
        """
        try:
            self.stream.flush()
            os.fsync(self.stream.fileno())  # a name without its content helps nobody
            if sys.platform == "win32":  # where an open file keeps its name
                self.stream.close()
            # Renamed while locked: after the lock another run might begin to write it.
            self.part.replace(self.path)
            self.stream.close()
        except OSError as error:
            raise cannot_write(self.path, error) from error

    def keep(self) -> None:
        """Close the file, leaving it as ``NAME.part``."""
        with suppress(OSError):  # a full disk refuses the last rows once more
            self.stream.close()

    def discard(self) -> None:
        """Remove the file and close it."""
        if sys.platform == "win32":
            self.keep()
        with suppress(OSError):
            self.part.unlink()
        self.keep()


def _part_of_this_process(path: Path) -> Path:
    return path.with_name(f"{path.name}.{platform.node()}-{os.getpid()}.part")


def _ours_alone(stream: IO[str], path: Path) -> bool | None:
    """Lock an open file; tell whether no other process has it, or has just renamed it.

    None where there are no locks.
    """
    if sys.platform == "win32":
        return True
    import fcntl  # noqa: PLC0415 - there is none on Windows

    deadline = time.monotonic() + DYING_S
    while True:
        try:
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return os.path.samestat(os.fstat(stream.fileno()), path.stat())
        except BlockingIOError:
            # A process that was killed is missed before the last of its files is closed.
            if time.monotonic() >= deadline:
                return False
            time.sleep(DYING_S / 20)
        except FileNotFoundError:
            return False
        except OSError:  # a file system without locks
            return None


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Turn what the system says of a file into an error that names it.

    Parameters
    ----------
    path : Path
        The file's final name.

    Yields
    ------
    None

    Raises
    ------
    OutputError
        Instead of an OSError within.
    """
    try:
        yield
    except OSError as error:
        raise cannot_write(path, error) from error


def cannot_write(path: Path, error: OSError) -> OutputError:
    """Return the error to raise where a file cannot be written.

    Parameters
    ----------
    path : Path
        The file.
    error : OSError
        What the system said.

    Returns
    -------
    OutputError
    """
    reason = (error.strerror or str(error)).lower()
    return OutputError(f"{path}: cannot be written ({reason}); choose another folder with --output")
