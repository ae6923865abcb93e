"""Which build of the compiled loops is chosen, and how they are built."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from oppload_cli.models.direct import DirectSums
from oppload_cli.models.layers import Dpc
from oppload_cli.models.parameters import DpcParams
from oppload_cli.models.spectral import SpectralSums
from oppload_cli.native import library

if TYPE_CHECKING:
    from collections.abc import Iterator

ROOT = Path(__file__).parents[1]
SOURCES = ROOT / "oppload_cli" / "native"


@pytest.fixture
def builds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """An empty folder of builds."""
    monkeypatch.setattr(library, "portable", False)
    monkeypatch.setattr(library, "FOLDER", tmp_path)
    library._loaded.cache_clear()
    yield tmp_path
    library._loaded.cache_clear()


def build(folder: Path, name: str, models: str | None = None) -> None:
    """Build the loops in a folder, with another models.c if one is given.

    What is built beside the sources serves as it is: compiling takes seconds.
    """
    built = SOURCES / f"loops.{name}.so"
    if models is None and built.exists():
        shutil.copy(built, folder)
        return
    for each in SOURCES.glob("*.[ch]"):
        shutil.copy(each, folder)
    if models is not None:
        (folder / "models.c").write_text(models)
    code = "import sys, hatch_build as h; from pathlib import Path; " + (
        "sys.exit(not h._compile(Path(sys.argv[1]), sys.argv[2], h.BUILDS.get(sys.argv[2], ())))"
    )
    if not (shutil.which("cc") or shutil.which("gcc")):
        pytest.skip("there is no C compiler")
    subprocess.run([sys.executable, "-c", code, folder, name], cwd=ROOT, check=True)


def test_without_a_build_the_models_are_computed_by_opencv(builds: Path) -> None:
    assert list(builds.iterdir()) == []
    assert library.library() is None
    assert library.arithmetic() == "portable"
    assert isinstance(Dpc((9, 9), DpcParams())._sums, SpectralSums)
    with pytest.raises(RuntimeError, match="were not built"):
        library.compiled()


def test_a_build_is_found_and_can_be_switched_off(
    builds: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    build(builds, "baseline")
    assert library.arithmetic() == "compiled"
    assert isinstance(Dpc((9, 9), DpcParams())._sums, DirectSums)
    monkeypatch.setattr(library, "portable", True)
    assert library.arithmetic() == "portable"
    assert isinstance(Dpc((9, 9), DpcParams())._sums, SpectralSums)


@pytest.mark.parametrize(("value", "portable"), [("1", True), ("0", False), ("", False)])
def test_the_environment_switches_them_off(value: str, portable: bool) -> None:
    code = "from oppload_cli.native import library; print(library.portable)"
    done = subprocess.run(
        [sys.executable, "-c", code], env={**os.environ, "OPPLOAD_PORTABLE": value},
        cwd=ROOT, check=True, capture_output=True, text=True,
    )  # fmt: skip
    assert done.stdout.strip() == str(portable)


def test_the_plain_build_agrees_with_the_wide_one(builds: Path) -> None:
    frames = np.random.default_rng(8).random((4, 40, 61), dtype=np.float32)
    maps = []
    for name in ("baseline", "wide"):
        build(builds, name)
        library._loaded.cache_clear()
        dpc = Dpc((40, 61), DpcParams(), (45, 135))
        for frame in frames:
            dpc.step(frame)
        maps.append(np.stack([dpc.presynaptic, *dpc.pathways.values()]))
    np.testing.assert_allclose(maps[0], maps[1], atol=2e-6)
    assert maps[0].max() > 0.1


@pytest.mark.parametrize("damage", ["stale", "no library"])
def test_a_build_that_does_not_fit_is_left_alone(builds: Path, damage: str) -> None:
    if damage == "stale":
        current = (SOURCES / "models.c").read_text()
        own = f"{{ return {library.INTERFACE}; }}"
        assert own in current
        build(builds, "baseline", current.replace(own, "{ return 0; }"))
    else:
        (builds / "loops.baseline.so").write_bytes(b"not a library")
    assert library.arithmetic() == "portable"


def test_the_hook_builds_what_the_wheel_takes(tmp_path: Path) -> None:
    """Build a wheel in a copy of the project; without a compiler it is a pure one."""
    for name in ("pyproject.toml", "hatch_build.py", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, tmp_path)
    for name in ("oppload_cli", "stimuli"):
        ignored = shutil.ignore_patterns("*.so", "__pycache__")
        shutil.copytree(ROOT / name, tmp_path / name, ignore=ignored)
    tags = {}
    for compiler in ("false", ""):
        done = subprocess.run(
            [sys.executable, "-m", "hatchling", "build", "-t", "wheel"],
            cwd=tmp_path, check=False, capture_output=True, text=True,
            env={"CC": compiler, "PATH": "/usr/bin:/bin"},
        )  # fmt: skip
        if "No module named hatchling" in done.stderr:
            pytest.skip("hatchling is not installed")
        assert done.returncode == 0, done.stderr
        wheel = next((tmp_path / "dist").glob("*.whl"))
        tags[compiler] = wheel.stem.split("-", 2)[2], "no C compiler" in done.stderr + done.stdout
        wheel.unlink()
    assert tags["false"] == ("py3-none-any", True)
    if shutil.which("cc") or shutil.which("gcc"):
        assert tags[""][0].startswith("py3-none-")
        assert tags[""] != tags["false"]
