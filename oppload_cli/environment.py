"""The versions and cores that a result depends on: for the sidecar, and for ``oppload info``."""

from __future__ import annotations

import platform
import sys
from pathlib import Path
from typing import Any

import cv2

from oppload_cli.compute.loops import arithmetic, why_not_wide, why_portable
from oppload_cli.processes import cores
from oppload_cli.version import __version__

_LIBRARIES = ("numpy", "opencv-python-headless", "av", "click", "pandas", "matplotlib", "tqdm")


def environment() -> dict[str, Any]:
    """Return the versions and cores that a result depends on.

    Returns
    -------
    dict
        ``oppload``, ``python``, ``platform``, ``cores``, ``arithmetic`` (compiled loops or
        libraries) and ``libraries``. Also ``why portable`` if no compiled loops run, and ``why not
        wide`` if the loops for the processor's wide vectors are damaged.
    """
    reasons = {"why portable": why_portable(), "why not wide": why_not_wide()}
    return {
        "oppload": __version__,
        "python": platform.python_version(),
        "platform": platform.platform(),
        "cores": cores(),
        "arithmetic": arithmetic(),
        **{name: reason for name, reason in reasons.items() if reason},
        "libraries": _versions(),
    }


def _versions() -> dict[str, str | None]:
    """Return the version of each library, None if the library is not installed.

    The version is in the name of a folder, as ``NAME-VERSION.dist-info``: to ask
    `importlib.metadata` would take 30 ms of each run.
    """
    versions: dict[str, str] = {}
    for folder in (info for path in sys.path for info in Path(path).glob("*.*-info")):
        name, _, version = folder.stem.partition("-")
        versions.setdefault(name.lower().replace("_", "-"), version)
    # OpenCV has several packages, which overwrite each other: only the library itself knows.
    package = getattr(cv2, "version", None)
    versions["opencv-python-headless"] = getattr(package, "opencv_version", cv2.__version__)
    return {name: versions.get(name) for name in _LIBRARIES}
