"""Build and check the files of a release: the source archive, and a wheel for each platform.

    python -m tools.dist          # or: make dist

ziglang's C compiler builds the loops for other platforms on this machine. If a check fails, the
command ends with an error.
"""

from __future__ import annotations

import os
import re
import shutil
import struct
import subprocess
import sys
import zipfile
import zlib
from pathlib import Path
from subprocess import PIPE, STDOUT

from hatch_build import FOLDER, SUFFIXES, TARGETS, Target

_ROOT = Path(__file__).parents[1]
_DIST = _ROOT / "dist"
_FOLDER = FOLDER.as_posix()
# For the libraries of each platform: the first bytes, the offset and the format of the machine
# type, and the machine type. (A PE file states the offset itself.)
ELF, MACH_O, PE = b"\x7fELF", b"\xcf\xfa\xed\xfe", b"MZ"
HEADERS = {
    "linux-x86_64": (ELF, 18, "<H", 62),
    "linux-aarch64": (ELF, 18, "<H", 183),
    "macos-arm64": (MACH_O, 4, "<I", 0x0100000C),
    "macos-x86_64": (MACH_O, 4, "<I", 0x01000007),
    "windows-x86_64": (PE, None, "<H", 0x8664),
}


class WrongWheelError(Exception):
    """A wheel whose contents do not fit its tag."""


def check_wheel(wheel: Path, name: str) -> None:
    """Check the tag of a wheel, its libraries, their machine and their checksums.

    `name` is the wheel's platform, a key of ``hatch_build.TARGETS``.

    Raises
    ------
    WrongWheelError
        If anything is missing or belongs to another platform.
    """
    target = TARGETS[name]
    if not wheel.stem.endswith(f"-py3-none-{target.tag}"):
        raise WrongWheelError(f"{wheel.name}: the tag is not py3-none-{target.tag}")
    with zipfile.ZipFile(wheel) as archive:
        found = {each for each in archive.namelist() if each.startswith(f"{_FOLDER}/loops.")}
        if found - {f"{_FOLDER}/loops.py"} != _expected(name, target):
            raise WrongWheelError(f"{wheel.name}: holds {sorted(found)}")
        for each in sorted(found):
            if each.endswith(SUFFIXES[target.system]):
                content = archive.read(each)
                if not _is_for(content, name):
                    raise WrongWheelError(f"{wheel.name}: {each} is for another machine")
                if archive.read(f"{each}.sum").decode() != f"{zlib.crc32(content):08x}\n":
                    raise WrongWheelError(f"{wheel.name}: {each} has another checksum")


def _expected(name: str, target: Target) -> set[str]:
    builds = ("baseline", "wide") if "x86_64" in name else ("baseline",)
    libraries = [f"{_FOLDER}/loops.{each}{SUFFIXES[target.system]}" for each in builds]
    return {f"{each}{end}" for each in libraries for end in ("", ".sum")}


def _is_for(content: bytes, name: str) -> bool:
    magic, offset, layout, machine = HEADERS[name]
    if not content.startswith(magic):
        return False
    if offset is None:
        offset = struct.unpack_from("<I", content, 0x3C)[0] + 4
    return bool(struct.unpack_from(layout, content, offset)[0] == machine)


def _python(*words: str | Path, **environment: str) -> str:
    command = [sys.executable, "-m", *map(str, words)]
    env = {**os.environ, **environment}
    done = subprocess.run(
        command, cwd=_ROOT, env=env, stdout=PIPE, stderr=STDOUT, text=True, check=False
    )
    if done.returncode:
        sys.exit(f"{words[0]} ended with {done.returncode}:\n{done.stdout}")
    return done.stdout


def main() -> None:
    """Build and check; print a line for each file."""
    shutil.rmtree(_DIST, ignore_errors=True)
    _python("build", "--no-isolation", "--sdist")
    print(f"{next(_DIST.glob('*.tar.gz')).name}: built")
    for name, target in TARGETS.items():
        _python("build", "--no-isolation", "--wheel", OPPLOAD_TARGET=name)
        (wheel,) = _DIST.glob(f"*{target.tag}.whl")
        check_wheel(wheel, name)
        result = "the right libraries"
        if target.system == "linux":
            shown = " ".join(_python("auditwheel", "show", wheel).split())
            tag = re.search(r'tag: "(\w+)"', shown)
            if not tag or tag.group(1) not in target.tag.split("."):
                sys.exit(f"{wheel.name}: auditwheel says: {shown}")
            result += f", auditwheel: {tag.group(1)}"
        print(f"{wheel.name}: {result}")
    files = sorted(_DIST.iterdir())
    _python("twine", "check", "--strict", *files)
    _python("check_wheel_contents", *(each for each in files if each.suffix == ".whl"))
    print("twine check and check-wheel-contents: no errors")


if __name__ == "__main__":
    main()
