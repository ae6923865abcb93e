"""The base of the writers of grey videos."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, Self

import numpy as np

from oppload_cli.errors import OutputError
from oppload_cli.video.atomic import disk_errors, part_of, remove

if TYPE_CHECKING:
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
