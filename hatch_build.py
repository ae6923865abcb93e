"""Compile the inner loops while the package is built, where a C compiler is at hand.

Without a compiler the package is built all the same; it then computes with OpenCV and NumPy.
``OPPLOAD_TARGET=macos-arm64`` builds for another platform, with the C compiler of ``ziglang``;
the loops use no part of Python, so that one build serves every version of it.
"""

from __future__ import annotations

import os
import platform
import shlex
import shutil
import subprocess
import sys
import sysconfig
import zlib
from pathlib import Path
from typing import Any, NamedTuple

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

FOLDER = Path("oppload_cli", "compute")
OPTIONS = ("-std=gnu11", "-O3", "-ffp-contract=fast", "-shared", "-Wno-psabi")
WIDE = ("-mavx2", "-mfma")
BUILDS: dict[str, tuple[str, ...]] = {"baseline": ()}
if platform.machine().lower() in ("x86_64", "amd64"):
    BUILDS["wide"] = WIDE
SUFFIXES = {"linux": ".so", "darwin": ".dylib", "win32": ".dll"}  # as in compute/loops.py


class Target(NamedTuple):
    """A platform: its name for zig, the tag of its wheel, and ``sys.platform`` there."""

    triple: str
    tag: str
    system: str


TARGETS = {
    "linux-x86_64": Target(
        "x86_64-linux-gnu.2.17", "manylinux_2_17_x86_64.manylinux2014_x86_64", "linux"
    ),
    "linux-aarch64": Target(
        "aarch64-linux-gnu.2.17", "manylinux_2_17_aarch64.manylinux2014_aarch64", "linux"
    ),
    "macos-arm64": Target("aarch64-macos.11.0", "macosx_11_0_arm64", "darwin"),
    "macos-x86_64": Target("x86_64-macos.11.0", "macosx_11_0_x86_64", "darwin"),
    "windows-x86_64": Target("x86_64-windows-gnu", "win_amd64", "win32"),
}


class CompiledLoops(BuildHookInterface):  # type: ignore[type-arg]
    """Adds the shared libraries to a wheel, or leaves them beside their source."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Compile, and say so in the wheel's tag.

        Parameters
        ----------
        version : str
            ``standard`` or ``editable``; both are treated alike.
        build_data : dict
            What goes into the wheel.
        """
        del version
        source = Path(self.root) / FOLDER
        name = os.environ.get("OPPLOAD_TARGET", "")
        if name:
            built = _cross_compiled(source, Path(self.root) / "build" / name, TARGETS[name])
            build_data["tag"] = f"py3-none-{TARGETS[name].tag}"
            build_data["force_include"].update(
                {str(file): (FOLDER / file.name).as_posix() for file in built}
            )
        else:
            names = [each for each in BUILDS if _compile(source, each, BUILDS[each])]
            built = [file for each in names for file in _files(source, each, sys.platform)]
            # The libraries do not use Python's interface: they serve every version of it.
            tag = sysconfig.get_platform().replace("-", "_").replace(".", "_")
            build_data["tag"] = f"py3-none-{tag}" if built else "py3-none-any"
            build_data["artifacts"] += [(FOLDER / file.name).as_posix() for file in built]
        if not built:
            self.app.display_warning(
                "oppload: no C compiler works here; the models will take 10 to 20 times as long"
            )
            return
        build_data["pure_python"] = False


def _cross_compiled(source: Path, folder: Path, target: Target) -> list[Path]:
    """Build for another platform into a folder of its own; a failure ends the build."""
    folder.mkdir(parents=True, exist_ok=True)
    builds = {"baseline": ()} | ({"wide": WIDE} if target.triple.startswith("x86_64") else {})
    compiler = (sys.executable, "-m", "ziglang", "cc", "-target", target.triple, "-s")
    for name, options in builds.items():
        if not _compile(
            source, name, options, folder=folder, system=target.system, compiler=compiler
        ):
            raise OSError(f"the loops of {target.triple} could not be compiled")
    return [file for name in builds for file in _files(folder, name, target.system)]


def _files(folder: Path, name: str, system: str) -> tuple[Path, Path]:
    """Return the library of a build, and the file with its checksum."""
    library = folder / f"loops.{name}{SUFFIXES.get(system, '.so')}"
    return library, Path(f"{library}.sum")


def _compiler() -> tuple[str, ...]:
    """Return the command of the compiler: ``CC``, the one that built Python, or else ``cc``."""
    if named := shlex.split(os.environ.get("CC", "")):
        return tuple(named)
    built = shlex.split(sysconfig.get_config_var("CC") or "cc")
    return tuple(built) if shutil.which(built[0]) else ("cc",)


def _compile(
    source: Path,
    name: str,
    options: tuple[str, ...],
    *,
    folder: Path | None = None,
    system: str = sys.platform,
    compiler: tuple[str, ...] = (),
) -> bool:
    """Compile the loops; tell whether this worked."""
    target, checksum = _files(folder or source, name, system)
    part = Path(f"{target}.part")
    sources = sorted(str(each) for each in source.glob("*.c"))
    # On Windows all code can be moved, and the functions have to be exported.
    system_options = ("-Wl,--export-all-symbols",) if system == "win32" else ("-fPIC", "-lm")
    compiler = compiler or _compiler()
    command = [*compiler, *OPTIONS, *options, *sources, *system_options, "-o", str(part)]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False)  # noqa: S603
    except OSError:
        return False
    if done.returncode:
        sys.stderr.write(done.stderr)
        return False
    part.replace(target)
    checksum.write_text(f"{zlib.crc32(target.read_bytes()):08x}\n")
    return True
