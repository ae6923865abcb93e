"""What is released: the checks of the wheels, on archives that are wrong in one way each."""

from __future__ import annotations

import re
import struct
import tomllib
import zipfile
import zlib
from pathlib import Path

import pytest

pytest.importorskip("hatchling")

from hatch_build import FOLDER, SUFFIXES, TARGETS
from tools.dist import ELF, HEADERS, MACH_O, WrongWheelError, check_wheel


def library(name: str) -> bytes:
    """The head of a library of a platform, and nothing else."""
    magic, offset, layout, machine = HEADERS[name]
    content = bytearray(256)
    content[: len(magic)] = magic
    if offset is None:
        struct.pack_into("<I", content, 0x3C, 128)
        offset = 132
    struct.pack_into(layout, content, offset, machine)
    return bytes(content)


def wheel(folder: Path, name: str, content: bytes | None = None, *, cut: bool = False) -> Path:
    """A wheel with the libraries of a platform, or with others."""
    path = folder / f"oppload-1.0-py3-none-{TARGETS[name].tag}.whl"
    builds = ("baseline", "wide") if "x86_64" in name else ("baseline",)
    with zipfile.ZipFile(path, "w") as archive:
        for build in builds:
            inside = (FOLDER / f"loops.{build}{SUFFIXES[TARGETS[name].system]}").as_posix()
            held = content or library(name)
            archive.writestr(inside, held[:-1] if cut else held)
            archive.writestr(f"{inside}.sum", f"{zlib.crc32(held):08x}\n")
        archive.writestr((FOLDER / "loops.py").as_posix(), "")
    return path


@pytest.mark.parametrize("name", TARGETS)
def test_a_good_wheel_passes(tmp_path: Path, name: str) -> None:
    check_wheel(wheel(tmp_path, name), name)


@pytest.mark.parametrize("name", TARGETS)
def test_a_library_of_another_machine_is_found(tmp_path: Path, name: str) -> None:
    other = next(each for each in TARGETS if HEADERS[each] != HEADERS[name])
    with pytest.raises(WrongWheelError, match="is for another machine"):
        check_wheel(wheel(tmp_path, name, library(other)), name)


def test_what_is_missing_or_cut_is_found(tmp_path: Path) -> None:
    with pytest.raises(WrongWheelError, match="another checksum"):
        check_wheel(wheel(tmp_path, "linux-x86_64", cut=True), "linux-x86_64")
    with pytest.raises(WrongWheelError, match="the tag is not"):
        check_wheel(wheel(tmp_path, "macos-arm64"), "macos-x86_64")
    path = wheel(tmp_path, "linux-aarch64")
    path.replace(tmp_path / f"oppload-1.0-py3-none-{TARGETS['linux-x86_64'].tag}.whl")
    with pytest.raises(WrongWheelError, match="holds"):
        check_wheel(next(tmp_path.glob("*1.0*x86_64*.whl")), "linux-x86_64")


def test_the_platforms_differ() -> None:
    assert {HEADERS[name][0] for name in ("linux-x86_64", "macos-arm64")} == {ELF, MACH_O}
    assert len({HEADERS[name] for name in TARGETS}) == len(TARGETS) == 5


def test_the_conda_recipe_asks_for_the_same_libraries() -> None:
    root = Path(__file__).parents[1]
    project = tomllib.loads((root / "pyproject.toml").read_text())["project"]
    wanted = {f"python{project['requires-python']}", *project["dependencies"]}
    others = {"matplotlib-base": "matplotlib", "py-opencv": "opencv-python-headless"}
    recipe = (root / "conda" / "meta.yaml").read_text()
    listed = re.findall(r"- (\S+) (\S+)", recipe.partition("  run:\n")[2].partition("\n\n")[0])
    assert {others.get(name, name) + bounds for name, bounds in listed} == wanted
