"""Reading files: their content, messages for their errors, and a check of names from data."""

from __future__ import annotations

import csv
import errno
import os
import re
import stat
import sys
import unicodedata
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from oppload_cli.errors import ParameterError, reason_of
from oppload_cli.processes.threads import Call

if TYPE_CHECKING:
    from collections.abc import Iterator

    from oppload_cli.errors import OpploadError


_MOST_BYTES = 1 << 30  # the size of the largest file that is read at once
_PIECE = 1 << 20  # bytes; `read` takes memory for all the bytes that it is asked for
NOT_IN_NAMES = "\\" + ('<>:"|?*' if sys.platform == "win32" else "")
_DRIVE = re.compile(r"[A-Za-z]:")
# Windows opens a device under these names, whatever the folder and the suffix.
_DEVICES = re.compile(r"(CON|PRN|AUX|NUL|CONIN\$|CONOUT\$|(COM|LPT)[0-9¹²³])\s*(\..*)?", re.I)

# Unlike the methods of `Path`, these functions return False for a name that is too long, holds a
# NUL, or lies in a folder that cannot be read.
is_file, is_folder, is_there = os.path.isfile, os.path.isdir, os.path.exists


def path_of(given: object, argument: str) -> Path:
    """Return a path that the user's program gives; anything but a name or a path is an error.

    The ParameterError names the `argument`.
    """
    if not isinstance(given, str | os.PathLike):
        raise ParameterError(f"{argument} must be a name or a Path, not {given!r:.60}")
    return Path(given)


def content_of(path: Path | str, *, pipes: bool = False) -> bytes:
    """Return the content of a file; call this function within :func:`reading`.

    With `pipes`, the file may also be a pipe or a device, such as ``<(command)``. Reading a pipe
    may take for ever, so that a name that comes from data must not be a pipe.

    Raises
    ------
    OSError
        If the file cannot be read, is no file, or is too large.
    KeyboardInterrupt
        If a signal has asked the program to stop while it reads a pipe.
    """
    path = Path(path)
    mode = path.stat().st_mode
    if not (pipes or stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
        raise OSError(errno.EINVAL, "a pipe or a device, not a file")

    def read() -> bytes:
        pieces: list[bytes] = []
        with path.open("rb") as file:
            while piece := file.read(_PIECE):
                pieces.append(piece)
                if len(pieces) * _PIECE > _MOST_BYTES:
                    raise OSError(errno.EFBIG, f"more than {_MOST_BYTES >> 20} MB")
        return b"".join(pieces)

    return read() if stat.S_ISREG(mode) else Call(read).result()


def text_of(path: Path | str, *, pipes: bool = False) -> str:
    """Return the content of a file as text in UTF-8, like :func:`content_of`."""
    return content_of(path, pipes=pipes).decode("utf-8-sig")


@contextmanager
def reading(
    path: Path | str,
    kind: type[OpploadError],
    *,
    form: str = "UTF-8",
    check: str = "check the path",
    repair: str = "correct the file",
) -> Iterator[None]:
    """Replace the errors of reading and parsing a file by an error with one sentence.

    Parameters
    ----------
    path : Path or str
        The file or folder, for the message.
    kind : type
        Class of the error that the context raises.
    form : str
        The format that the file should have, such as ``JSON``.
    check, repair : str
        Advice to the user if the file cannot be read, and if its content is wrong.
    """
    try:
        yield
    except OSError as error:
        raise kind(f"{path}: cannot be read ({reason_of(error)}); {check}") from error
    except UnicodeDecodeError as error:
        reason = f"byte {error.start + 1} cannot be read as text"
        raise kind(f"{path}: is not valid {form} ({reason}); {repair}") from error
    except (ValueError, RecursionError, csv.Error) as error:
        raise kind(f"{path}: is not valid {form} ({reason_of(error)}); {repair}") from error


def fault_of_stem(stem: str) -> str:
    """Return why a stem is no valid path of a file on every system, or leads out of its folder.

    A stem such as ``cam1/clip`` has names between ``/``; undecodable bytes are allowed. The result
    is the end of a sentence on the first faulty name, such as ``holds ':'``, or empty.
    """
    return next(filter(None, map(_fault_of_name, stem.split("/"))), "")


def _fault_of_name(name: str) -> str:
    if not name.strip(". "):
        return "names no file"
    if _DRIVE.match(name):
        return "begins with a drive"
    if character := next((character for character in name if character in NOT_IN_NAMES), ""):
        return f"holds '{character}'"
    if any(unicodedata.category(character) == "Cc" for character in name):
        return "holds a control character"
    return "is a device on Windows" if _DEVICES.fullmatch(name) else ""
