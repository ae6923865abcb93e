"""A machine that is short of processes or room for files: one sentence, or fewer threads."""

from __future__ import annotations

import os
import shutil
import sys
from typing import TYPE_CHECKING

import pytest

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
