"""Note the modules of the package that ``oppload run`` enters on a small clip.

    python tools/tracer.py CHECKOUT LOG FOLDER

Each line of LOG is "CALLER CALLED": a module of the package, and another one that it calls,
directly or through a library. A thread's first call has no caller. Calls while a module is
imported do not count. The clip and the result are written into FOLDER.
"""  # fmt: skip

from __future__ import annotations

import os
import sys
import threading
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

if TYPE_CHECKING:
    from types import FrameType

_WIDTH, _HEIGHT, _FRAMES = 64, 48, 12


class _Tracer:
    """Notes calls from one module of the package into another, in every thread and process."""

    def __init__(self, root: Path, log: Path) -> None:
        self._root = root
        self._package = str(root / "oppload_cli") + os.sep
        # A forked process appends to the same file, one line at a time.
        self._log = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
        self._noted: set[tuple[str, str]] = set()

    def __call__(self, frame: FrameType, _event: str, _argument: object) -> None:
        """Note a call; `sys.settrace` takes this method."""
        called, caller = self._module(frame), ""
        if not called:
            return
        outer: FrameType | None = frame
        while outer is not None:
            module = self._module(outer)
            if module and outer.f_code.co_name == "<module>":
                return  # an import, or a call while a module is imported
            if outer is not frame:
                caller = caller or module
            outer = outer.f_back
        if caller != called and (caller, called) not in self._noted:
            self._noted.add((caller, called))
            os.write(self._log, f"{caller} {called}\n".encode())

    def _module(self, frame: FrameType) -> str:
        """Return the dotted name of a frame's module; empty if it is not of the package."""
        file = frame.f_code.co_filename
        if not file.startswith(self._package):
            return ""
        return ".".join(Path(file).relative_to(self._root).with_suffix("").parts)


def main() -> None:
    """Make the clip and run the command under the tracer."""
    root, log, folder = (Path(word).resolve() for word in sys.argv[1:])
    clip = folder / "clip.avi"
    code = cv2.VideoWriter.fourcc(*"MJPG")
    writer = cv2.VideoWriter(str(clip), code, 30, (_WIDTH, _HEIGHT))
    for index in range(_FRAMES):
        picture = np.full((_HEIGHT, _WIDTH, 3), 255, np.uint8)
        cv2.circle(picture, (_WIDTH // 2, _HEIGHT // 2), 2 + index, (0, 0, 0), -1)
        writer.write(picture)
    writer.release()
    sys.path.insert(0, str(root))
    sys.argv = ["oppload", "run", str(clip), "-o", str(folder)]
    entry: Any = import_module("oppload_cli.__main__").entry
    tracer = _Tracer(root, log)
    threading.settrace(tracer)
    sys.settrace(tracer)
    entry()


if __name__ == "__main__":
    main()
