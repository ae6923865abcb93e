"""The compiled loops: the build that is chosen, the switch, bands of rows, the build hook."""

from __future__ import annotations

import itertools
import os
import shutil
import subprocess
import sys
import threading
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest

from oppload_cli.compute import loops
from oppload_cli.models.dlgmd import group
from oppload_cli.models.dpc import DpcParams
from oppload_cli.models.layers import Layers
from tests.arithmetic import many_bands
from tests.cli.inside import oppload
from tests.cli.process import python

if TYPE_CHECKING:
    from collections.abc import Iterator

__all__ = ["many_bands"]

ROOT = Path(__file__).parents[2]
SOURCES = ROOT / "oppload_cli" / "compute"


@pytest.fixture
def builds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """An empty folder of builds."""
    monkeypatch.setattr(loops, "portable", False)
    monkeypatch.setattr(loops, "__file__", str(tmp_path / "loops.py"))
    loops._loaded.cache_clear()
    yield tmp_path
    loops._loaded.cache_clear()


def build(folder: Path, name: str) -> None:
    """Build the loops in a folder.

    A build beside the sources is copied: compiling takes seconds.
    """
    built = SOURCES / f"loops.{name}{loops.SUFFIX}"
    if built.exists():
        for path in SOURCES.glob(f"{built.name}*"):
            shutil.copy(path, folder)
        return
    if not (shutil.which("cc") or shutil.which("gcc")):
        pytest.skip("no C compiler is installed")
    for path in SOURCES.glob("*.[ch]"):
        shutil.copy(path, folder)
    code = "import sys, hatch_build as h; from pathlib import Path; " + (
        "sys.exit(not h._compile(Path(sys.argv[1]), sys.argv[2], h.BUILDS.get(sys.argv[2], ())))"
    )
    done = python(code, folder, name, cwd=ROOT)
    assert done.returncode == 0, done.stderr


def calls_of_twins(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Group a small map; return the names of the twins that this called."""
    called = []

    def twin(*_: object) -> tuple[float, float]:
        called.append("group")
        return 0.0, 0.0

    monkeypatch.setitem(loops._TWINS, "group", twin)
    group(np.ones((3, 3), np.float32), 1, 0.0, 1.0, np.zeros((3, 3), np.float32))
    return called


def test_without_a_build_the_plain_functions_run(
    builds: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert list(builds.iterdir()) == []
    assert loops.arithmetic() == "portable"
    assert calls_of_twins(monkeypatch) == []
    assert "no compiled loops" in (loops.why_portable() or "")


def test_a_build_is_found_and_can_be_switched_off(
    builds: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    build(builds, "baseline")
    assert loops.arithmetic() == "compiled"
    assert calls_of_twins(monkeypatch) == ["group"]
    monkeypatch.setattr(loops, "portable", True)
    assert loops.arithmetic() == "portable"
    assert calls_of_twins(monkeypatch) == []


def test_the_environment_switches_the_loops_off() -> None:
    code = """if True:
        import os
        from importlib import reload
        from oppload_cli.compute import loops
        for os.environ["OPPLOAD_PORTABLE"] in "1", "0", "":
            print(reload(loops).portable, loops.arithmetic())
    """
    switched, *others = python(code).stdout.splitlines()
    assert switched == "True portable"
    assert [line.split()[0] for line in others] == ["False", "False"]


def test_the_baseline_build_agrees_with_the_wide_one(builds: Path) -> None:
    frames = np.random.default_rng(8).random((4, 40, 61), dtype=np.float32)
    maps = []
    for name in ("baseline", "wide"):
        build(builds, name)
        loops._loaded.cache_clear()
        if not loops._library().runs_wide():
            pytest.skip("NOT COMPARED: this processor has no build for wide vectors")
        dpc = Layers((40, 61)).dpc(DpcParams(), (45, 135)).layer
        for frame in frames:
            dpc.step(frame)
        maps.append(np.stack([dpc.sums.presynaptic, *dpc.sums.pathways.values()]))
    np.testing.assert_allclose(maps[0], maps[1], atol=2e-6)
    assert maps[0].max() > 0.1


@pytest.mark.parametrize("damage", ["stale", "not a library"])
def test_a_build_that_does_not_fit_is_not_used(
    builds: Path, damage: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    if damage == "stale":
        build(builds, "baseline")
        monkeypatch.setattr(loops, "INTERFACE", loops.INTERFACE + 1)
    else:
        (builds / f"loops.baseline{loops.SUFFIX}").write_bytes(b"not a library")
    assert loops.arithmetic() == "portable"
    reason = "belongs to another version" if damage == "stale" else "does not load on this system"
    assert reason in (loops.why_portable() or "")


@pytest.mark.skipif(sys.platform == "win32", reason="a loaded library cannot be replaced there")
def test_a_cut_library_is_not_loaded(builds: Path) -> None:
    """To load it could end the process; the checksum shows that it is not complete."""
    build(builds, "baseline")
    assert loops.why_portable() is None
    library = builds / f"loops.baseline{loops.SUFFIX}"
    cut = library.read_bytes()[:-4096]
    library.unlink()  # if the loaded file were changed in place, this process would crash at exit
    library.write_bytes(cut)
    loops._loaded.cache_clear()
    assert loops.arithmetic() == "portable"
    assert loops.why_portable() == f"{library} is damaged; install oppload again"


@pytest.mark.skipif(sys.platform == "win32", reason="a loaded library cannot be replaced there")
def test_a_run_says_why_it_is_slow(builds: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def said(*options: str) -> str:
        loops._loaded.cache_clear()
        return oppload("run", "missing.mp4", *options, cwd=builds).stderr

    def cut(name: str) -> str:
        library = builds / f"loops.{name}{loops.SUFFIX}"
        content = library.read_bytes()[:-4096]
        library.unlink()  # as in the test before
        library.write_bytes(content)
        return f"oppload: {library} is damaged; install oppload again. The alarms are the same, "

    assert "no compiled loops" in said()
    build(builds, "baseline")
    build(builds, "wide")
    assert "usual" not in said()
    if loops._library().runs_wide():
        assert f"{cut('wide')}but the models are slower than usual" in said()
        assert loops.arithmetic() == "compiled"
    assert f"{cut('baseline')}but the models are 10 to 20 times as slow as usual" in said()
    assert "usual" not in said("--quiet")
    monkeypatch.setattr(loops, "portable", True)
    assert "usual" not in said()


def test_small_frames_are_one_band_and_large_ones_several() -> None:
    assert loops._bands_of((240, 427)) == [(0, 0, 240)]
    assert loops._bands_of((1, 1)) == [(0, 0, 1)]
    bands = loops._bands_of((1081, 1920))
    assert bands[0][:2] == (0, 0)
    assert bands[-1][2] == 1081
    assert all(first[2] == second[1] for first, second in itertools.pairwise(bands))


@pytest.mark.usefixtures("many_bands")
@pytest.mark.parametrize("threads", [1, 2, 5])
def test_every_band_is_computed_once(threads: int) -> None:
    cv2.setNumThreads(threads)
    computed: list[tuple[int, int, int]] = []
    seen = set()

    def compute(number: int, first: int, last: int) -> None:
        computed.append((number, first, last))
        seen.add(threading.get_ident())

    loops._in_bands((40, 3), compute)
    assert sorted(computed) == [(n, 7 * n, min(7 * n + 7, 40)) for n in range(6)]
    assert (seen == {threading.get_ident()}) == (threads == 1)


@pytest.mark.usefixtures("many_bands")
def test_a_thread_that_outlives_the_main_thread_computes_its_bands_itself() -> None:
    cv2.setNumThreads(3)
    loops._band_threads(3).shutdown()  # as Python does before it waits for other threads
    computed = []
    try:
        loops._in_bands((40, 3), lambda number, *_: computed.append(number))
    finally:
        loops._band_threads.cache_clear()
    assert computed == list(range(6))


@pytest.mark.usefixtures("many_bands")
@pytest.mark.parametrize("threads", [1, 3])
def test_an_error_in_a_band_is_raised(threads: int) -> None:
    cv2.setNumThreads(threads)

    def fail(number: int, *_: int) -> None:
        if number == 2:
            raise ArithmeticError("band 2")

    with pytest.raises(ArithmeticError, match="band 2"):
        loops._in_bands((40, 3), fail)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="processes are not forked here")
def test_a_forked_child_has_threads_of_its_own() -> None:
    code = """if True:
        import cv2, os, signal
        from oppload_cli.compute import loops
        cv2.setNumThreads(2)
        loops._in_bands((1000, 1000), lambda *_: None)
        if child := os.fork():
            raise SystemExit(os.waitpid(child, 0)[1])
        signal.alarm(30)  # without threads it would wait for ever
        loops._in_bands((1000, 1000), lambda *_: None)
        os._exit(0)
    """
    done = python(code, PYTHONWARNINGS="ignore")
    assert done.returncode == 0, done.stderr


def test_the_compiler_that_built_python_may_be_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Python of Debian names aarch64-linux-gnu-gcc, also where only Clang is installed."""
    pytest.importorskip("hatchling")
    from hatch_build import _compiler

    found = (f"'{sys.executable}' -O", (sys.executable, "-O"))
    monkeypatch.delenv("CC", raising=False)
    for built, expected in (found, ("missing-gcc -O", ("cc",))):
        monkeypatch.setattr("sysconfig.get_config_var", lambda _, built=built: built)
        assert _compiler() == expected
    monkeypatch.setenv("CC", "ccache clang")
    assert _compiler() == ("ccache", "clang")


@pytest.mark.slow
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
