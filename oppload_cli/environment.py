"""What a run stood on: for the sidecar, and for ``oppload info``."""

from __future__ import annotations

import os
import platform
from importlib import metadata
from typing import Any

from oppload_cli.native.library import arithmetic
from oppload_cli.version import __version__

LIBRARIES = ("numpy", "opencv-python-headless", "av", "click", "pandas", "matplotlib", "tqdm")


def cores() -> int:
    """Return how many cores this process may use, by its affinity mask.

    Returns
    -------
    int
    """
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def environment() -> dict[str, Any]:
    """Return the versions and cores that a result depends on.

    Returns
    -------
    dict
        ``oppload``, ``python``, ``platform``, ``cores``, ``arithmetic`` (by what the
        inner loops of the models are computed) and ``libraries``.
    """
    return {
        "oppload": __version__,
        "python": platform.python_version(),
        "platform": platform.platform(),
        "cores": cores(),
        "arithmetic": arithmetic(),
        "libraries": {name: _version(name) for name in LIBRARIES},
    }


def _version(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        # OpenCV comes under several names; which one is installed does not matter.
        if name.startswith("opencv"):
            return _version("opencv-python") if name != "opencv-python" else None
        return None
