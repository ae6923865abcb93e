"""The versions and cores behind a result: for the sidecar, and for ``oppload info``."""

from __future__ import annotations

import platform
from importlib import metadata
from typing import Any

from oppload_cli.compute.loops import arithmetic, why_portable
from oppload_cli.processes import cores
from oppload_cli.version import __version__

LIBRARIES = ("numpy", "opencv-python-headless", "av", "click", "pandas", "matplotlib", "tqdm")


def environment() -> dict[str, Any]:
    """Return the versions and cores that a result depends on.

    Returns
    -------
    dict
        ``oppload``, ``python``, ``platform``, ``cores``, ``arithmetic`` (compiled loops or
        libraries), ``why portable`` where no compiled loops run, and ``libraries``.
    """
    reason = why_portable()
    return {
        "oppload": __version__,
        "python": platform.python_version(),
        "platform": platform.platform(),
        "cores": cores(),
        "arithmetic": arithmetic(),
        **({"why portable": reason} if reason else {}),
        "libraries": {name: _version(name) for name in LIBRARIES},
    }


def _version(name: str) -> str | None:
    # OpenCV comes under several names; either serves.
    for each in (name, name.removesuffix("-headless")):
        try:
            return metadata.version(each)
        except metadata.PackageNotFoundError:
            continue
    return None
