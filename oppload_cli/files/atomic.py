"""Files and folders that get their names only when they are complete.

If the system refuses to write one, the error is always that of :func:`cannot_write`.
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
from contextlib import ExitStack, contextmanager, suppress
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

if sys.platform == "win32":
    import _winapi
    import msvcrt
else:
    import fcntl

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator
    from pathlib import Path


PART = ".part"  # end of the name of a file or folder that is still being written
_DYING_S = 0.5  # time for which a run that was killed may still hold its lock
# On Windows no other program can read a locked byte: so this one is far behind the end of the file.
_LOCKED_BYTE = 1 << 40
# Values of CreateFile on Windows: make a new file, and let other programs read, write and remove
# the file while it is open, which `os.open` does not do.
_CREATE_NEW, _SHARED = 1, 7
# Flags that follow no link and wait for no pipe. Windows lacks them: there, only `_check_regular`
# refuses links and pipes.
_CAUTIOUS = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)


def cannot_write(path: Path, error: OSError) -> OpploadError:
    """Return the error to raise if the system refuses to write a result."""
    short = shortage(error)
    if short:
        return ShortageError(f"{path}: cannot be written, because {short}")
    return OutputError(
        f"{path}: cannot be written ({reason_of(error)}); check the folder and the space on its "
        "disk, or choose another --output"
    )


@contextmanager
def output_errors(path: Path) -> Iterator[None]:
    """Raise the error of :func:`cannot_write` for `path` in place of an OSError."""
    try:
        yield
    except OSError as error:
        raise cannot_write(path, error) from error


def part_of(path: Path) -> Path:
    """Return the path of the part file of a result."""
    return path.with_name(f"{path.name}{PART}")


def remove(path: Path) -> None:
    """Remove a file, a link or a folder with its content, if it exists."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def make_folder(folder: Path) -> None:
    """Make a folder and the folders above it; raise OutputError if the system refuses."""
    with output_errors(folder):
        _make_folder(folder)


@contextmanager
def folder_of_outputs(folder: Path) -> Iterator[None]:
    """Make a folder as `make_folder` does; at the end, remove new folders that have no file."""
    missing = [parent for parent in (folder, *folder.parents) if not os.path.lexists(parent)]
    make_folder(folder)
    try:
        yield
    finally:
        for parent in missing:
            with suppress(OSError):  # as it is not empty
                parent.rmdir()


def write_atomic(target: Path | PartFile, content: str | bytes | Iterable[bytes]) -> None:
    """Write a file completely or not at all; text becomes UTF-8.

    The target is a path, whose missing folders are made, or a part file. Raises the errors of
    :class:`PartFile`.
    """
    if isinstance(content, str):
        content = content.encode("utf-8", "backslashreplace")
    with target if isinstance(target, PartFile) else PartFile(target) as file:
        file.binary.writelines([content] if isinstance(content, bytes) else content)


def refuse_existing(paths: Iterable[Path], if_exists: str) -> None:
    """Raise OutputError if a result exists and `if_exists` is ``error``."""
    if if_exists == "error":
        for path in paths:
            if os.path.lexists(path):  # unlike `Path.exists`, accepts any name
                raise _exists_already(path)


def _exists_already(path: Path) -> OutputError:
    return OutputError(f"{path}: exists already; choose --if-exists overwrite, or another --output")


@contextmanager
def claimed(path: Path, if_exists: str) -> Iterator[PartFile]:
    """Open the part file of a result before its content is computed.

    If the file cannot be written, or another run writes it, the command thus fails before minutes
    of work. The caller writes and commits the part file; without a commit it is removed, with the
    folders made for it. Raises the errors of :class:`PartFile`.
    """
    with folder_of_outputs(path.parent):
        file = PartFile(path, new=if_exists == "error")
        try:
            yield file
        finally:
            file.discard()


class _Part(ABC):
    """A context that commits a result at the end, or discards it after an error."""

    path: Path
    part: Path
    _done = False

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
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

    An interrupted run may keep the part file, with the rows so far. If the file system has no locks
    and ``NAME.part`` exists, the name of the part is ``NAME.HOST-PROCESS.part``, so that two runs
    never write into one file. A link, a folder or a pipe named ``NAME.part`` is an error.

    Parameters
    ----------
    path : Path
        The final name; folders above it are made.
    new : bool
        Whether an existing file of this name is an error.

    Attributes
    ----------
    part : Path
        The path until `commit`.
    raw, binary : binary files
        The file without and with a buffer, for writing and reading bytes.
    stream : text file
        The file for writing text, in UTF-8 with ``surrogateescape``; it keeps line ends.

    Raises
    ------
    OutputError
        If the file cannot be written.
    BusyError
        If another run is writing the file.
    """

    def __init__(self, path: Path, *, new: bool = False) -> None:
        self.path = path
        with output_errors(path):
            _make_folder(path.parent)
            if path.is_dir() and not path.is_symlink():
                raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
            self._open(part_of(path), new=new)
        if new and os.path.lexists(path):  # after the lock: another run may just have finished
            self.discard()
            raise _exists_already(path)

    def _open(self, part: Path, *, new: bool) -> None:
        self.part = part
        self.raw, made = _opened(part, self.path)
        self.binary = BufferedRandom(self.raw)
        try:
            locked = _lock(self.raw.fileno(), part, self.path)
            own = self.path.with_name(f"{self.path.name}.{platform.node()}-{os.getpid()}{PART}")
            if not locked and not made and part != own:
                if new:
                    raise _exists_already(part)
                self.binary.close()
                self._open(own, new=False)
                return
            self.binary.truncate(0)  # with the lock: no other run writes the file
            self.stream = TextIOWrapper(
                self.binary, encoding="utf-8", errors="surrogateescape", newline=""
            )
        except BaseException:
            self.binary.close()
            raise

    def commit(self) -> None:
        """Close the file and give it its name; do nothing after the first `commit`.

        Raises OutputError if the system refuses, or ``NAME.part`` is another file now.
        """
        if self._done:
            return
        with output_errors(self.path):
            self.stream.flush()
            os.fsync(self.binary.fileno())  # a system crash must not leave an empty file
            if not os.path.samestat(os.fstat(self.binary.fileno()), os.lstat(self.part)):
                raise FileExistsError(errno.EEXIST, f"{self.part.name} is another file now")
            # The file is still open and so locked: no other run can write it.
            self.part.replace(self.path)
            self._done = True
            self.stream.close()

    def keep(self) -> None:
        """Close the file, but do not rename it."""
        self._done = True
        with suppress(OSError):  # closing writes the last rows, which a full disk refuses
            self.stream.close()

    def discard(self) -> None:
        """Close the file and remove it; do nothing after `commit` or `keep`."""
        if self._done:
            return
        with suppress(OSError):
            self.part.unlink()
        self.keep()


class PartFolder(_Part):
    """A folder that is filled as ``NAME.part`` under a lock, and renamed when it is complete.

    Parameters and errors are those of :class:`PartFile`. The caller writes files into the folder
    `part`; `commit` replaces an existing file or folder of the final name.
    """

    def __init__(self, path: Path, *, new: bool = False) -> None:
        self.path, self.part = path, part_of(path)
        with output_errors(path), ExitStack() as lock:
            _make_folder(path.parent)
            if self.part.is_symlink() or not self.part.is_dir():
                remove(self.part)
            self.part.mkdir(exist_ok=True)
            if sys.platform != "win32":  # cannot lock a folder
                descriptor = os.open(self.part, os.O_RDONLY | _CAUTIOUS)
                lock.callback(os.close, descriptor)
                _lock(descriptor, self.part, path)
            for left in self.part.iterdir():  # of an interrupted run
                remove(left)
            self._lock = lock.pop_all()
        if new and os.path.lexists(path):
            self.discard()
            raise _exists_already(path)

    def commit(self) -> None:
        """Give the folder its name; raise OutputError if the system refuses."""
        with output_errors(self.path):
            remove(self.path)
            self.part.rename(self.path)
        self._done = True
        self._lock.close()

    def discard(self) -> None:
        """Remove the folder; do nothing after `commit`."""
        if self._done:
            return
        self._done = True
        with suppress(OSError):
            remove(self.part)
        self._lock.close()


def _make_folder(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except FileExistsError:  # its text, "file exists", does not say that a folder is needed
        raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR)) from None


def _opened(part: Path, path: Path) -> tuple[FileIO, bool]:
    """Open a part file, and make it if there is none; return whether it was made.

    Raises BusyError if another run renames the part at this moment.
    """

    def opener(flags: int) -> Callable[[str, int], int]:
        return lambda _, file_flags: _open_descriptor(part, file_flags | flags)

    with suppress(FileExistsError):
        return FileIO(part, "r+", opener=opener(os.O_CREAT | os.O_EXCL)), True
    try:
        _check_regular(os.lstat(part), part)  # before `open`, which has an effect on some devices
        file = FileIO(part, "r+", opener=opener(0))
    except FileNotFoundError:
        raise _busy(path) from None
    try:
        _check_regular(os.fstat(file.fileno()), part)
    except BaseException:
        file.close()
        raise
    return file, False


def _open_descriptor(part: Path, flags: int) -> int:
    """Open a file that may be renamed and removed while it is open."""
    if sys.platform == "win32":
        access = _winapi.GENERIC_READ | _winapi.GENERIC_WRITE
        how = _CREATE_NEW if flags & os.O_EXCL else _winapi.OPEN_EXISTING
        handle = _winapi.CreateFile(str(part), access, _SHARED, _winapi.NULL, how, 0, _winapi.NULL)
        descriptor = msvcrt.open_osfhandle(handle, flags)
    else:
        descriptor = os.open(part, flags | _CAUTIOUS, 0o666)
    return descriptor


def _check_regular(status: os.stat_result, part: Path) -> None:
    """Raise FileExistsError unless the part is a regular file without a second hard link."""
    if not stat.S_ISREG(status.st_mode) or status.st_nlink > 1:
        raise FileExistsError(errno.EEXIST, f"{part.name} is a link, a folder or a device")


def _lock(descriptor: int, part: Path, path: Path) -> bool:
    """Lock an open part file or folder; return False if the file system has no locks.

    Raises BusyError if another process holds the lock, or has just renamed the part.
    """
    deadline = time.monotonic() + _DYING_S
    while True:
        try:
            _lock_now(descriptor)
            if os.path.samestat(os.fstat(descriptor), part.stat()):
                return True
            break
        except BlockingIOError:
            # The system releases the lock of a killed process a moment after its death.
            if time.monotonic() >= deadline:
                break
            time.sleep(_DYING_S / 20)
        except FileNotFoundError:
            break
        except OSError:  # a file system without locks
            return False
    raise _busy(path)


def _lock_now(descriptor: int) -> None:
    """Lock an open file, or a folder except on Windows; BlockingIOError if another run has it."""
    if sys.platform == "win32":
        os.lseek(descriptor, _LOCKED_BYTE, os.SEEK_SET)
        try:
            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
        except OSError as error:
            if error.errno == errno.EINVAL:  # a file system without locks
                raise
            raise BlockingIOError from error
        finally:
            os.lseek(descriptor, 0, os.SEEK_SET)
    else:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)


def _busy(path: Path) -> BusyError:
    return BusyError(f"{path}: another run is writing it; wait for that one")
