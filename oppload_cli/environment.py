"""What a run stood on: for the sidecar, and for ``oppload info``."""

from __future__ import annotations

import os
import platform
import sys
from functools import cache
from pathlib import Path
from typing import Any

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
    from oppload_cli.native.library import arithmetic  # noqa: PLC0415 - others only count cores

    return {
        "oppload": __version__,
        "python": platform.python_version(),
        "platform": _platform(),
        "cores": cores(),
        "arithmetic": arithmetic(),
        "libraries": {name: _version(name) for name in LIBRARIES},
    }


def _platform() -> str:
    """Return what `platform.platform` does, without the processor, which takes another process."""
    parts = [platform.system(), platform.release(), platform.machine()]
    library = "".join(platform.libc_ver())
    return "-".join([*parts, "with", library] if library else parts)


def _version(name: str) -> str | None:
    version = _installed().get(name.replace("-", "_"))
    if version is None and name.startswith("opencv") and name != "opencv-python":
        # OpenCV comes under several names; which one is installed does not matter.
        return _version("opencv-python")
    return version


@cache
def _installed() -> dict[str, str]:
    """Return the versions of what is installed, by the names of folders: no file is parsed."""
    found: dict[str, str] = {}
    for folder in map(Path, reversed(sys.path)):
        try:
            names = [each.name for each in folder.iterdir()]
        except OSError:
            continue
        for name in names:
            if name.endswith((".dist-info", ".egg-info")):
                package, _, version = name.rpartition(".")[0].partition("-")
                found[package.lower()] = version.partition("-")[0]
    return found
