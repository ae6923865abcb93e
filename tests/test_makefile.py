"""The Python that the targets of make use."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.skipif(
    sys.platform == "win32" or not shutil.which("make"), reason="NOT TESTED: needs make"
)

ROOT = Path(__file__).parents[1]
MAKEFILE = ROOT / "Makefile"
ANEW = "-m venv --clear .venv\n"
VERSION = 'exec {} -c "import sys; sys.version_info = {}; $2"'


def stand_in(path: Path, answer: str) -> Path:
    """Write a program that answers like a Python, or a version of it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f"#!/bin/sh\n{answer}\n")
    path.chmod(0o755)
    return path


def make(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        ["make", "-f", str(MAKEFILE), *words],
        cwd=folder,
        env={"PATH": os.environ["PATH"]},  # without the variables of a make that runs this test
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder whose .venv is complete."""
    for name in ("pyproject.toml", "hatch_build.py", ".venv/pyvenv.cfg", ".venv/.ready"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    stand_in(tmp_path / ".venv/bin/python", "echo 3.12.1 /usr")
    return tmp_path


def test_a_venv_of_another_python_is_made_anew(folder: Path) -> None:
    same = stand_in(folder / "same", "echo 3.12.1 /usr")
    other = stand_in(folder / "other", "echo 3.13.0 /usr")
    for words, anew in (((), False), ((f"PYTHON={same}",), False), ((f"PYTHON={other}",), True)):
        done = make(folder, "--dry-run", "test", *words)
        assert "-m pytest" in done.stdout
        assert (ANEW in done.stdout, done.stderr) == (anew, "")


def test_an_old_python_is_refused_before_anything_is_made(tmp_path: Path) -> None:
    for name in ("pyproject.toml", "hatch_build.py"):
        (tmp_path / name).touch()
    old = stand_in(tmp_path / "old", VERSION.format(sys.executable, (3, 10)))
    done = make(tmp_path, "demo", f"PYTHON={old}")
    assert done.stderr.startswith("oppload needs Python 3.11 or later; name one, as in: ")
    assert not (tmp_path / ".venv").exists()


def test_the_lowest_versions_refuse_a_python_that_is_too_new_for_them(folder: Path) -> None:
    stand_in(folder / ".venv/bin/python", VERSION.format(sys.executable, (3, 13)))
    done = make(folder, "test-lowest")
    assert done.stderr.startswith("the lowest versions need Python 3.11 or 3.12; name one: ")
    assert not (folder / ".venv-lowest").exists()


def test_a_failed_test_of_any_mark_runs_again(folder: Path) -> None:
    assert '-m "" --last-failed' in make(folder, "--dry-run", "test-failed").stdout


def test_help_has_every_target_and_what_is_called_exists(folder: Path) -> None:
    phony = re.findall(r"^\.PHONY: (.*)$", MAKEFILE.read_text("utf-8"), re.MULTILINE)
    targets = {target for line in phony for target in line.split()} - {"help", "another"}
    described = re.findall(r"^make ([a-z-]+)", make(folder).stdout, re.MULTILINE)
    assert sorted(described) == sorted(targets)
    # An archive of the source has no folder of workflows.
    callers = [*ROOT.glob(".github/workflows/*"), *ROOT.glob(".ci/*"), *ROOT.glob(".pre-commit*")]
    called = "\n".join(path.read_text("utf-8") for path in [*callers, ROOT / "CONTRIBUTING.md"])
    words = re.findall(r"(?:run: |entry: |^ *|`)make ((?:[a-z-]+ ?)+)", called, re.MULTILINE)
    assert {target for each in words for target in each.split()} <= targets
    assert len(words) > 20
