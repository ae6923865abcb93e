"""The versions and cores behind a result: for the sidecar, and for ``oppload info``."""

from __future__ import annotations

import platform
import sys
from pathlib import Path
from typing import Any

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
        libraries), ``why portable`` where no compiled loops run, ``why not wide`` where those
        for the processor's wide vectors are damaged, and ``libraries``.
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
    """Return the version of each library, None for one that is not installed.

    The name of its folder, ``NAME-VERSION.dist-info``, tells it; `importlib.metadata`, which is
    asked where there is no such folder, would read a page of each library: 30 ms of each run.
    """
    found: dict[str, str] = {}
    for place in sys.path:
        for folder in Path(place).glob("*.dist-info"):
            name, _, version = folder.name.removesuffix(".dist-info").partition("-")
            found.setdefault(name.lower().replace("_", "-"), version)
    # OpenCV comes under several names; either serves.
    return {
        name: found.get(name) or found.get(name.removesuffix("-headless")) or _asked(name)
        for name in _LIBRARIES
    }


def _asked(name: str) -> str | None:
    from importlib import metadata  # noqa: PLC0415 - seldom needed

    for each in (name, name.removesuffix("-headless")):
        try:
            return metadata.version(each)
        except metadata.PackageNotFoundError:
            continue
    return None
