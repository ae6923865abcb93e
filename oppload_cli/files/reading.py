"""Small files that are read, and the sentences on their errors that all rooms share."""

from __future__ import annotations

import csv
import errno
import stat
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from oppload_cli.errors import reason_of
from oppload_cli.processes.threads import Call

if TYPE_CHECKING:
    from collections.abc import Iterator

    from oppload_cli.errors import OpploadError


MOST_BYTES = 1 << 30  # of a file that is read as a whole


def content_of(path: Path | str, *, pipes: bool = False) -> bytes:
    """Return the content of a file, to be called within :func:`reading`.

    Parameters
    ----------
    path : Path or str
        The file.
    pipes : bool
        Whether a pipe or a device will do too, as ``<(command)`` gives; Ctrl-C ends the
        waiting for it. A name that comes from data must never make a command wait.

    Raises
    ------
    OSError
        If it cannot be read, is no file, or is too large.
    KeyboardInterrupt
        If a signal has asked the program to stop.
    """
    path = Path(path)
    there = path.stat()
    if not stat.S_ISREG(there.st_mode) and not (pipes or stat.S_ISDIR(there.st_mode)):
        raise OSError(errno.EINVAL, "a pipe or a device, not a file")

    def read() -> bytes:
        with path.open("rb") as file:
            return file.read(MOST_BYTES + 1)

    content = read() if stat.S_ISREG(there.st_mode) else Call(read).result()
    if len(content) > MOST_BYTES:
        raise OSError(errno.EFBIG, f"more than {MOST_BYTES >> 20} MB")
    return content


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
    """Turn the errors of reading and parsing a file into one sentence that names it.

    Parameters
    ----------
    path : Path or str
        The file or folder, for the message.
    kind : type
        Of the error to raise.
    form : str
        The format that the file should have, such as ``JSON``.
    check, repair : str
        Advice for the user: where the file cannot be read, and where its content is wrong.

    Raises
    ------
    OpploadError
        Of `kind`.
    """
    try:
        yield
    except OSError as error:
        raise kind(f"{path}: cannot be read ({reason_of(error)}); {check}") from error
    except (ValueError, RecursionError, csv.Error) as error:  # of UTF-8, or of the format
        raise kind(f"{path}: is not valid {form} ({reason_of(error)}); {repair}") from error
