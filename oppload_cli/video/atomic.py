"""Files that are there as a whole or not at all, and the base of the video writers."""

from __future__ import annotations

from abc import ABC, abstractmethod
from contextlib import contextmanager
from typing import TYPE_CHECKING, Self

import numpy as np

from oppload_cli.errors import OutputError

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from fractions import Fraction
    from pathlib import Path
    from types import TracebackType

    from numpy.typing import NDArray

    Grey = NDArray[np.uint8]


class Writer(ABC):
    """Base of the writers: a context that renames its ``.part`` at the end, or removes it.

    Parameters
    ----------
    path : Path
        Where the result shall be.
    width, height : int
        Of every frame, in pixels.
    frame_rate : Fraction
        Frames per second.
    count : int
        Number of frames that will be written.
    """

    def __init__(
        self, path: Path, width: int, height: int, frame_rate: Fraction, count: int
    ) -> None:
        self.path, self.part = path, part_of(path)
        self.width, self.height, self.frame_rate = width, height, frame_rate
        self.count, self.frames = count, 0

    def __enter__(self) -> Self:
        with disk_errors(self.path):
            self.path.parent.mkdir(parents=True, exist_ok=True)
        try:
            with disk_errors(self.path):
                self._open()
        except BaseException:
            remove(self.part)
            raise
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        problem: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        try:
            if kind is None:
                if self.frames != self.count:
                    raise OutputError(
                        f"{self.path}: {self.frames} frames were written, not {self.count}; "
                        "nothing is kept"
                    )
                with disk_errors(self.path):
                    self._close()
                    remove(self.path)
                    self.part.rename(self.path)
            else:
                self._abandon()
        except BaseException:
            self._abandon()
            raise

    def write(self, grey: Grey) -> None:
        """Write the next frame.

        Parameters
        ----------
        grey : ndarray
            uint8 (h, w), luminance times 255.

        Raises
        ------
        OutputError
            If the frame has another size, or the disk is full.
        """
        if grey.shape != (self.height, self.width) or grey.dtype != np.uint8:
            raise OutputError(
                f"{self.path}: frame {self.frames} is {grey.dtype} {grey.shape}, not uint8 "
                f"{(self.height, self.width)}; give every frame the same size"
            )
        with disk_errors(self.path):
            self._write(np.ascontiguousarray(grey))
        self.frames += 1

    @abstractmethod
    def _open(self) -> None:
        """Begin the part."""

    @abstractmethod
    def _write(self, grey: Grey) -> None:
        """Write a frame to the part."""

    @abstractmethod
    def _close(self) -> None:
        """Finish the part."""

    def _abandon(self) -> None:
        remove(self.part)


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
