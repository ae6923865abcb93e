"""A file for the encoders' library to write into."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING

from oppload_cli.interruption import undisturbed

if TYPE_CHECKING:
    from pathlib import Path


class Sink:
    """A file that keeps what goes wrong to itself until it is asked.

    The encoder's library calls it from C, where an exception cannot pass; a full disk
    would be printed as a stack of tracebacks, and the next call would fail again; the same
    goes for Ctrl-C.

    Parameters
    ----------
    path : Path
        What to write; it is emptied.
    """

    def __init__(self, path: Path) -> None:
        # By which the library reads back what it has written; "a:b" alone would be an address.
        self.name = f"file:{path}"
        self._file = io.FileIO(path, "w+")
        self._problem: OSError | None = None

    @undisturbed
    def write(self, data: bytes) -> int:
        """Write all of it, unless something has gone wrong before."""
        if self._problem is None:
            try:
                left = memoryview(data)
                while left:
                    left = left[self._file.write(left) :]
            except OSError as problem:
                self._problem = problem
        return len(data)

    @undisturbed
    def seek(self, offset: int, whence: int = 0) -> int:
        """Go to a place; return it."""
        if self._problem is None:
            try:
                return self._file.seek(offset, whence)
            except OSError as problem:
                self._problem = problem
        return 0

    @undisturbed
    def tell(self) -> int:
        """Return the place."""
        return self._file.tell() if self._problem is None else 0

    def fail(self, problem: OSError) -> None:
        """Write nothing more."""
        self._problem = self._problem or problem

    def check(self) -> None:
        """Raise what went wrong."""
        if self._problem is not None:
            raise self._problem

    def close(self) -> None:
        """Close the file, and raise what went wrong."""
        self._file.close()
        self.check()
