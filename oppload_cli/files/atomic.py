"""Files and folders that appear under their name only when they are complete.

Every refusal of the system ends in the one sentence of :func:`cannot_write`.
"""

from __future__ import annotations

import errno
import os
import platform
import shutil
import stat
import sys
import time
from abc import ABC, abstractmethod
from contextlib import contextmanager, suppress
from io import BufferedRandom, FileIO, TextIOWrapper
from typing import TYPE_CHECKING, Self

from oppload_cli.errors import (
    BusyError,
    OpploadError,
    OutputError,
    ShortageError,
    reason_of,
    shortage,
)

if sys.platform != "win32":
    import fcntl

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator
    from pathlib import Path
    from types import TracebackType


_DYING_S = 0.5  # for so long a run that was killed may still hold its lock
# No link is followed, and no pipe waited for. Windows has neither: `_opened` looks first.
_CAUTIOUS = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)


def cannot_write(path: Path, error: OSError) -> OpploadError:
    """Return the error to raise where the system refuses to write a result."""
    short = shortage(error)
    if short:
        return ShortageError(f"{path}: cannot be written, because {short}")
    return OutputError(
        f"{path}: cannot be written ({reason_of(error)}); check the folder and the space on its "
        f"disk, or choose another --output"
    )


@contextmanager
def output_errors(path: Path) -> Iterator[None]:
    """Raise the OutputError of :func:`cannot_write` for `path` in place of any OSError within."""
    try:
        yield
    except OSError as error:
        raise cannot_write(path, error) from error


def part_of(path: Path) -> Path:
    """Return the name that a result has while it is written."""
    return path.with_name(f"{path.name}.part")


def remove(path: Path) -> None:
    """Remove a file, a link or a folder with its content, if it exists."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def make_folder(folder: Path) -> None:
    """Make a folder and those above it; raise OutputError if that is refused."""
    with output_errors(folder):
        _make_folder(folder)


def write_atomic(target: Path | PartFile, content: str | bytes | Iterable[bytes]) -> None:
    """Write a complete file, a text as UTF-8, or none.

    The target is a name, whose missing folders are made, or a file that was begun before. Raises
    OutputError as :class:`PartFile` does.
    """
    if isinstance(content, str):
        content = content.encode("utf-8", "backslashreplace")
    with target if isinstance(target, PartFile) else PartFile(target) as file:
        file.binary.writelines([content] if isinstance(content, bytes) else content)


def refuse_existing(paths: Iterable[Path], if_exists: str) -> None:
    """Raise OutputError if a result exists and `if_exists` is ``error``."""
    if if_exists == "error":
        for path in paths:
            if os.path.lexists(path):  # which, unlike `Path.exists`, accepts any name
                raise _exists_already(path)


def _exists_already(path: Path) -> OutputError:
    """Return the error to raise where a result exists, or the part file of an earlier run."""
    return OutputError(f"{path}: exists already; choose --if-exists overwrite, or another --output")


@contextmanager
def claimed(path: Path, if_exists: str) -> Iterator[PartFile]:
    """Hold the name of a result while its content is computed; the caller writes and commits it.

    So a file that cannot be written is refused before minutes of work, and of several runs at once
    with ``error`` for `if_exists` only one makes the file. Without a commit, nothing remains of it.
    Raises OutputError as :class:`PartFile` does.
    """
    missing = [folder for folder in path.parents if not os.path.lexists(folder)]
    file = PartFile(path, new=if_exists == "error")
    try:
        yield file
    finally:
        file.discard()
        for folder in missing:
            with suppress(OSError):  # it holds results
                folder.rmdir()


class _Part(ABC):
    """A context that gives a result its name at the end, or removes it after an error."""

    path: Path
    part: Path
    _done = False

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        try:
            if error is None:
                self.commit()
        finally:
            self.discard()
        if isinstance(error, OSError):
            raise cannot_write(self.path, error) from error

    @abstractmethod
    def commit(self) -> None:
        """Close the result and give it its name."""

    @abstractmethod
    def discard(self) -> None:
        """Close the result and remove it; do nothing after `commit`."""


class PartFile(_Part):
    """A file that is written as ``NAME.part`` under a lock, and renamed when it is complete.

    An interrupted run keeps the part, readable as far as it goes. Where there are no locks, as on
    Windows, a second run writes ``NAME.HOST-PROCESS.part``, so that two runs never write into one
    file. A link, a folder or a pipe in the place of the part file is an error; no link is followed.

    Parameters
    ----------
    path : Path
        The final name; folders above it are made.
    new : bool
        Whether a file of this name is an error.

    Attributes
    ----------
    part : Path
        The name until `commit`.
    raw, binary : binary files
        Where bytes are written, without a buffer or with one; both can be read back.
    stream : text file
        Where text is written, as UTF-8 with ``surrogateescape`` and line ends as given.

    Raises
    ------
    OutputError
        If it cannot be written there.
    BusyError
        If another run is writing it.
    """

    def __init__(self, path: Path, *, new: bool = False) -> None:
        self.path = path
        with output_errors(path):
            _make_folder(path.parent)
            if path.is_dir() and not path.is_symlink():
                raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
            self._open(part_of(path), new=new)
        if new and os.path.lexists(path):  # maybe since just now, by another run
            self.discard()
            raise _exists_already(path)

    def _open(self, part: Path, *, new: bool) -> None:
        self.part = part
        self.raw, made = _opened(part)
        self.binary = BufferedRandom(self.raw)
        try:
            alone = _lock(self.raw.fileno(), part)
            if alone is False:
                raise BusyError(f"{self.path}: another run is writing it; wait for that one")
            own = self.path.with_name(f"{self.path.name}.{platform.node()}-{os.getpid()}.part")
            if alone is None and not made and part != own:
                if new:
                    raise _exists_already(part)
                self.binary.close()
                self._open(own, new=False)
                return
            self.binary.truncate(0)  # only now is it certain that no other run writes it
            self.stream = TextIOWrapper(
                self.binary, encoding="utf-8", errors="surrogateescape", newline=""
            )
        except BaseException:
            self.binary.close()
            raise

    def commit(self) -> None:
        """Close the file and give it its name; do nothing after the first `commit`.

        Raises OutputError if the disk refuses, or another file has taken the place of the part.
        """
        if self._done:
            return
        with output_errors(self.path):
            self.stream.flush()
            os.fsync(self.binary.fileno())  # or a crash may leave the name without the content
            if not os.path.samestat(os.fstat(self.binary.fileno()), os.lstat(self.part)):
                raise FileExistsError(errno.EEXIST, f"{self.part.name} is another file now")
            if sys.platform == "win32":  # where an open file keeps its name
                self.stream.close()
            # Renamed while locked: after the lock another run might begin to write it.
            self.part.replace(self.path)
            self._done = True
            self.stream.close()

    def keep(self) -> None:
        """Close the file, leaving it as ``NAME.part``."""
        self._done = True
        with suppress(OSError):  # a full disk refuses the last rows once more
            self.stream.close()

    def discard(self) -> None:
        """Close the file and remove it; do nothing after `commit` or `keep`."""
        if self._done:
            return
        if sys.platform == "win32":
            self.keep()
        with suppress(OSError):
            self.part.unlink()
        self.keep()


class PartFolder(_Part):
    """A folder that is filled as ``NAME.part`` under a lock, and renamed when it is complete.

    Parameters and errors are those of :class:`PartFile`; a file or folder of the name is replaced.

    Attributes
    ----------
    part : Path
        Where files are put until `commit`.
    """

    def __init__(self, path: Path, *, new: bool = False) -> None:
        self.path, self.part = path, part_of(path)
        self._held = -1
        with output_errors(path):
            _make_folder(path.parent)
            if self.part.is_symlink() or not self.part.is_dir():
                remove(self.part)
            self.part.mkdir(exist_ok=True)
            self._hold()
            for each in self.part.iterdir():  # of an earlier run
                remove(each)
        if new and os.path.lexists(path):
            self.discard()
            raise _exists_already(path)

    def _hold(self) -> None:
        if sys.platform == "win32":  # where no folder can be locked
            return
        self._held = os.open(self.part, os.O_RDONLY | _CAUTIOUS)
        if _lock(self._held, self.part) is False:
            self._let_go()
            raise BusyError(f"{self.path}: another run is writing it; wait for that one")

    def _let_go(self) -> None:
        if self._held >= 0:
            os.close(self._held)
            self._held = -1

    def commit(self) -> None:
        """Give the folder its name; raise OutputError if that is refused."""
        with output_errors(self.path):
            remove(self.path)
            self.part.rename(self.path)
        self._done = True
        self._let_go()

    def discard(self) -> None:
        """Remove the folder; do nothing after `commit`."""
        if self._done:
            return
        self._done = True
        with suppress(OSError):
            remove(self.part)
        self._let_go()


def _make_folder(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except FileExistsError:  # its text, "file exists", would puzzle the user
        raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR)) from None


def _opened(part: Path) -> tuple[FileIO, bool]:
    """Open a new part file, or a regular one that has no other name; tell whether it is new."""

    def opener(flags: int) -> Callable[[str, int], int]:
        return lambda name, own: os.open(name, own | flags | _CAUTIOUS, 0o666)

    with suppress(FileExistsError):
        return FileIO(part, "r+", opener=opener(os.O_CREAT | os.O_EXCL)), True
    _check_alone(os.lstat(part), part)  # to open some devices has an effect
    file = FileIO(part, "r+", opener=opener(0))
    try:
        _check_alone(os.fstat(file.fileno()), part)
    except BaseException:
        file.close()
        raise
    return file, False


def _check_alone(there: os.stat_result, part: Path) -> None:
    """Refuse a folder or a device, and a file that has a second name."""
    if not stat.S_ISREG(there.st_mode) or there.st_nlink > 1:
        raise FileExistsError(errno.EEXIST, f"{part.name} is a link, a folder or a device")


def _lock(file: int, path: Path) -> bool | None:
    """Lock an open file; tell whether no other process holds it, or has just renamed it.

    None where the system or the file system has no locks.
    """
    if sys.platform == "win32":
        return None
    deadline = time.monotonic() + _DYING_S
    while True:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return os.path.samestat(os.fstat(file), path.stat())
        except BlockingIOError:
            # The system releases the files of a killed process a moment after its death.
            if time.monotonic() >= deadline:
                return False
            time.sleep(_DYING_S / 20)
        except FileNotFoundError:
            return False
        except OSError:  # a file system without locks
            return None
