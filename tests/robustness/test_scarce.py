"""A machine that is short of memory, processes, files or room: one sentence, or fewer threads."""

from __future__ import annotations

import os
import shutil
import sys
from typing import TYPE_CHECKING

import pytest

from tests.cli.process import python
from tests.media import grey_frames, write_video
from tools.attack.judge import Ended, faults, prepared

if TYPE_CHECKING:
    from pathlib import Path

pytestmark = pytest.mark.skipif(
    sys.platform != "linux" or not shutil.which("prlimit"), reason="NOT TESTED: needs prlimit"
)

QUICK = ("--height", "24", "--no-rmo")
USER = 61_000


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    frames = grey_frames(12)
    return write_video(tmp_path_factory.mktemp("scarce") / "clip.avi", frames, codec="ffv1")


def ended(folder: Path, words: list[str], user: int = 0, **limits: int) -> Ended:
    """Run a command under limits; check its messages and its files."""
    case = prepared("scarce", 0, folder)
    case.words, case.limits, case.user = words, limits, user
    wrong, how = faults(case)
    assert wrong == [], (limits, how.stderr)
    return how


def commands(clip: Path) -> dict[str, list[str]]:
    return {
        "alone": ["run", str(clip), "-o", "../out", *QUICK],
        "jobs": ["run", str(clip), "nothing.avi", "-o", "../out", *QUICK, "--jobs", "2"],
        "reproduce": ["reproduce", "--only", "up-down", "-o", "../out", "--jobs", "2"],
        "stimuli": ["stimuli", "generate", "controls/appearing-disk", "-o", "../out"],
        "tune": ["tune", "klapoetke2017/bar-expand-10", "--over", "speed=40", "-o", "../out", "-q"],
    }


@pytest.mark.long
@pytest.mark.parametrize("size", [10_000, pytest.param(30_000, marks=pytest.mark.slow), 100_000])
def test_files_of_limited_size(clip: Path, tmp_path: Path, size: int) -> None:
    done = ended(tmp_path / "case", commands(clip)["alone"], fsize=size)
    if size == 100_000:
        assert (done.code, "12 frames" in done.stderr) == (0, True), done.stderr
    else:
        assert done.code in {0, 2}
        assert done.code == 0 or "cannot be written (file too large)" in done.stderr


def counted_user() -> int:
    """Another user, since the limit of processes does not apply to root."""
    if os.geteuid() != 0 or not shutil.which("setpriv"):
        pytest.skip("NOT TESTED: needs root and setpriv")
    return USER + os.getpid() % 4000


NPROC = [
    pytest.param(number, command, marks=() if quick else pytest.mark.slow)
    for number in range(1, 13)
    for command in ("alone", "jobs", "reproduce", "stimuli", "tune")
    for quick in [number == 1 and command in {"alone", "jobs"}]
    if command not in {"reproduce", "tune"} or number in {1, 4, 8}
]


@pytest.mark.long
@pytest.mark.parametrize(("number", "command"), NPROC)
def test_few_processes(clip: Path, tmp_path: Path, number: int, command: str) -> None:
    done = ended(tmp_path / "case", commands(clip)[command], counted_user(), nproc=number)
    if command == "alone":
        assert (done.code, "12 frames" in done.stderr) == (0, True), done.stderr
    assert done.code in {0, 3, 4}, done.stderr
    short = "no further process or thread can be started"
    assert done.code != 3 or short in done.stderr, done.stderr


MEMORY = [60, 80, 100, 120, 150, 200, 300]


@pytest.mark.parametrize(
    "megabytes",
    [pytest.param(each, marks=() if each == 100 else pytest.mark.slow) for each in MEMORY],
)
@pytest.mark.parametrize("limit", ["as", "data"])
def test_little_memory(clip: Path, tmp_path: Path, megabytes: int, limit: str) -> None:
    done = ended(tmp_path / "case", commands(clip)["alone"], **{limit: megabytes * 1000 * 1024})
    assert done.code in {0, 3}, done.stderr
    assert done.code == 0 or "memory is short" in done.stderr
    if megabytes == 100:
        assert done.code == 3


@pytest.mark.parametrize(
    "megabytes",
    [pytest.param(each, marks=() if each == 520 else pytest.mark.slow) for each in (300, 500, 520)],
)
def test_little_memory_for_tables(clip: Path, tmp_path: Path, megabytes: int) -> None:
    # With too little memory, Arrow would end the process, or fail without an error.
    done = ended(tmp_path / "case", commands(clip)["tune"], **{"as": megabytes << 20})
    assert (done.code, "memory is short" in done.stderr) == (3, True), done.stderr


# Under a limit that leaves 4 MB to the process as it is: a small file, then a large product.
LITTLE = """
import resource, sys
from pathlib import Path
import numpy as np
from oppload_cli.cli import _check_memory
from oppload_cli.files.reading import text_of

resource.setrlimit(resource.RLIMIT_AS, (1 << 31, resource.RLIM_INFINITY))
_check_memory("run")
square = np.ones((256, 256))
pages = int(Path("/proc/self/statm").read_text().split()[0])
used = pages * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (used + (4 << 20), resource.RLIM_INFINITY))
print(text_of(sys.argv[1]), (square @ square)[0, 0])
"""


def test_memory_for_a_small_file_and_a_product(tmp_path: Path) -> None:
    (tmp_path / "small.toml").write_text("small")
    done = python(LITTLE, tmp_path / "small.toml", OPENBLAS_NUM_THREADS="1")
    assert done.stdout == "small 256.0\n", done.stderr
