"""Compile the inner loops while the package is built, where there is a compiler.

Without one the package is built all the same: it then computes by OpenCV and NumPy.
"""

from __future__ import annotations

import os
import platform
import shlex
import subprocess
import sys
import sysconfig
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

FOLDER = Path("oppload_cli", "native")
OPTIONS = ("-std=gnu11", "-O3", "-ffp-contract=fast", "-fPIC", "-shared", "-Wno-psabi")
BUILDS = {"baseline": ()}
if platform.machine().lower() in ("x86_64", "amd64"):
    BUILDS["wide"] = ("-mavx2", "-mfma")


class CompiledLoops(BuildHookInterface):  # type: ignore[type-arg]
    """Adds the shared libraries to a wheel, or leaves them beside their source."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Compile, and say so in the wheel's tag.

        Parameters
        ----------
        version : str
            ``standard`` or ``editable``; alike to us.
        build_data : dict
            Of the wheel to be.
        """
        del version
        folder = Path(self.root) / FOLDER
        built = [name for name, options in BUILDS.items() if _compile(folder, name, options)]
        if not built:
            self.app.display_warning(
                "oppload: no C compiler works here; the models will take about four times as long"
            )
            return
        build_data["pure_python"] = False
        # The libraries know nothing of Python: any version of it will do.
        tag = sysconfig.get_platform().replace("-", "_").replace(".", "_")
        build_data["tag"] = f"py3-none-{tag}"
        build_data["artifacts"] += [(FOLDER / f"loops.{name}.so").as_posix() for name in built]


def _compile(folder: Path, name: str, options: tuple[str, ...]) -> bool:
    compiler = shlex.split(os.environ.get("CC") or sysconfig.get_config_var("CC") or "cc")
    target = folder / f"loops.{name}.so"
    part = folder / f"loops.{name}.so.part"
    sources = sorted(str(each) for each in folder.glob("*.c"))
    command = [*compiler, *OPTIONS, *options, *sources, "-lm", "-o", str(part)]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False)  # noqa: S603
    except OSError:
        return False
    if done.returncode:
        sys.stderr.write(done.stderr)
        return False
    part.replace(target)
    return True
