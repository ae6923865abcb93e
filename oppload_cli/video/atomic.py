"""Files that are there as a whole or not at all."""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING

from oppload_cli.errors import OutputError

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from pathlib import Path


def part_of(path: Path) -> Path:
    """Return the name that a result has while it is written.

    Parameters
    ----------
    path : Path
        The result's own name.

    Returns
    -------
    Path
        Beside it.
    """
    return path.with_name(f"{path.name}.part")


def remove(path: Path) -> None:
    """Remove a file or a folder, if it is there.

    Parameters
    ----------
    path : Path
        What to remove.
    """
    if path.is_dir():
        import shutil  # noqa: PLC0415 - seldom needed

        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def write_atomic(path: Path, parts: Iterable[bytes]) -> None:
    """Write a small file as a whole or not at all.

    Parameters
    ----------
    path : Path
        Where it shall be.
    parts : iterable of bytes
        What it shall hold, piece by piece.

    Raises
    ------
    OutputError
        If it cannot be written.
    """
    part = part_of(path)
    with disk_errors(path):
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            with part.open("wb") as file:
                file.writelines(parts)
            part.replace(path)
        except BaseException:
            remove(part)
            raise


@contextmanager
def disk_errors(path: Path) -> Iterator[None]:
    """Turn what the system says about a disk into an OutputError.

    Parameters
    ----------
    path : Path
        The result, for the message.

    Raises
    ------
    OutputError
        Instead of any OSError within.
    """
    try:
        yield
    except OSError as problem:
        reason = problem.strerror or str(problem)
        raise OutputError(
            f"{path}: cannot write: {reason}; nothing half-written is left; check the "
            "folder and the space on its disk"
        ) from problem
