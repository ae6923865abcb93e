"""Many cases, in processes that know nothing of each other, and a table of what came of them."""

from __future__ import annotations

import ctypes
import json
import multiprocessing
import os
import shlex
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from random import Random
from typing import TYPE_CHECKING

from tools.attack.families import FAMILIES, Material, made, ready
from tools.attack.judge import SHARED, Case, Ended, adopt_orphans, faults

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

_OWN_MOUNTS = 0x20000  # CLONE_NEWNS of Linux


@dataclass(frozen=True)
class Verdict:
    """The outcome of one case."""

    family: str
    number: int
    code: int
    seconds: float
    wrong: tuple[str, ...]


@dataclass(frozen=True)
class Task:
    """All that a worker needs to know."""

    number: int
    seed: int
    folder: Path
    material: Material
    only: str


def one(task: Task) -> Verdict:
    """Make a case, run it and judge it; keep its folder if something is wrong."""
    folder = task.folder / "work" / str(task.number)
    shutil.rmtree(folder, ignore_errors=True)
    random = Random(f"{task.seed} {task.number}")  # noqa: S311
    case = made(task.number, folder, task.material, random, task.only)
    began = time.monotonic()
    with ExitStack() as around:
        for each in case.around:
            around.enter_context(each)
        wrong, ended = faults(case)
        if wrong:
            kept = task.folder / "failures" / f"{case.family}-{task.seed}-{case.number}"
            with suppress(OSError):  # what lies on a disk of its own goes with it
                shutil.copytree(case.out, case.folder / "copied", symlinks=True)
    if wrong:
        keep(case, ended, wrong, kept)
    shutil.rmtree(folder, ignore_errors=True)
    seconds = time.monotonic() - began
    return Verdict(case.family, case.number, ended.code, seconds, tuple(wrong))


def keep(case: Case, ended: Ended, wrong: list[str], folder: Path) -> None:
    """Move the folder of a case to where it is kept, with the command and what is wrong."""
    facts = {
        "wrong": wrong,
        "command": shlex.join([*case.command[:1], "-m", "oppload_cli", *case.words]),
        "words": case.words,
        "in": "in",
        "limits": case.limits,
        "user": case.user,
        "signals": case.signals,
        "reads": case.reads,
        "code": ended.code,
        "memory": ended.memory,
        "stderr": ended.stderr[-3000:],
    }
    shutil.rmtree(folder, ignore_errors=True)
    folder.parent.mkdir(parents=True, exist_ok=True)
    case.folder.rename(folder)
    (folder / "case.json").write_text(json.dumps(facts, indent=2) + "\n")


def attack(
    numbers: Sequence[int], seed: int, jobs: int, folder: Path, only: str = ""
) -> list[Verdict]:
    """Run cases; return what came of each.

    Parameters
    ----------
    numbers : sequence of int
        Those of the cases.
    seed : int
        Of all their random numbers.
    jobs : int
        How many at a time.
    folder : Path
        Where `work` and `failures` are made.
    only : str
        The only family, or an empty string.
    """
    folder = folder.resolve()
    (folder / "work").mkdir(parents=True, exist_ok=True)
    try:
        material = ready(folder / "work")
        tasks = [Task(number, seed, folder, material, only) for number in numbers]
        spawn = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(jobs, mp_context=spawn, initializer=set_apart) as pool:
            return [told(verdict) for verdict in pool.map(one, tasks, chunksize=1)]
    finally:
        shutil.rmtree(folder / "work", ignore_errors=True)


def set_apart() -> None:
    """Give this process orphans, disks and shared memory of its own, as far as it may.

    What it finds left behind is then of its own case, and not of one that runs beside it. A
    command inherits what is ignored, as under nohup: here no signal is.
    """
    adopt_orphans()
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) is signal.SIG_IGN:
            signal.signal(number, signal.SIG_DFL)
    with suppress(OSError, AttributeError):
        if os.geteuid() != 0 or ctypes.CDLL(None).unshare(_OWN_MOUNTS):
            return
        for words in (
            ("mount", "--make-rprivate", "/"),
            ("mount", "-t", "tmpfs", "tmpfs", str(SHARED)),
        ):
            subprocess.run(words, capture_output=True, check=False)


def told(verdict: Verdict) -> Verdict:
    """Print a case that failed at once; return it."""
    if verdict.wrong:
        line = f"{verdict.family} {verdict.number}: {'; '.join(verdict.wrong)}\n"
        sys.stderr.write(line)
    return verdict


def table(verdicts: list[Verdict]) -> str:
    """Return the cases and failures of each family, and their exit codes, as text."""
    lines = [f"{'family':<14}{'cases':>7}{'failures':>10}{'longest':>10}  exit codes"]
    for family in (*FAMILIES, "all"):
        those = [each for each in verdicts if family in {each.family, "all"}]
        if those:
            failed = sum(bool(each.wrong) for each in those)
            longest = max(each.seconds for each in those)
            codes = sorted(Counter(each.code for each in those).items())
            shown = ", ".join(f"{code}: {count}" for code, count in codes)
            lines.append(f"{family:<14}{len(those):>7}{failed:>10}{longest:>8.1f} s  {shown}")
    return "\n".join(lines)
