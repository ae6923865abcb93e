"""Attack the real command: damaged media, hostile names, limits, signals, disks, servers.

python -m tools.attack --cases 5000 --seed 1 --jobs 2
python -m tools.attack --seed 1 --only servers --case 123   # run one case again

The seed and the number of a case determine everything in it. Every case runs in its own folder.
The attack then checks the files, processes and messages that the command has left behind. It
prints a table of all families, and keeps the files and the command line of each case that fails.
"""  # fmt: skip

from __future__ import annotations

import argparse
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
from functools import partial
from pathlib import Path
from random import Random
from typing import TYPE_CHECKING

from tools.attack.families import FAMILIES, Material, make_case, make_material
from tools.attack.judge import SHARED, Case, Ended, adopt_orphans, faults

if TYPE_CHECKING:
    from collections.abc import Sequence

_OWN_MOUNTS = 0x20000  # CLONE_NEWNS of Linux


@dataclass(frozen=True)
class Judged:
    """The outcome of one case."""

    family: str
    number: int
    code: int
    seconds: float
    wrong: tuple[str, ...]


def _run(number: int, seed: int, folder: Path, material: Material, only: str) -> Judged:
    """Make a case, run it and check its results; keep its folder if something is wrong."""
    work = folder / "work" / str(number)
    shutil.rmtree(work, ignore_errors=True)
    case = make_case(number, work, material, Random(f"{seed} {number}"), only)  # noqa: S311
    began = time.monotonic()
    with ExitStack() as around:
        for each in case.around:
            around.enter_context(each)
        wrong, ended = faults(case)
        if wrong:
            with suppress(OSError):  # the disks of the case are unmounted after this block
                shutil.copytree(case.out, case.folder / "copied", symlinks=True)
    if wrong:
        keep(case, ended, wrong, folder / "failures" / f"{case.family}-{seed}-{number}")
    shutil.rmtree(work, ignore_errors=True)
    seconds = time.monotonic() - began
    return Judged(case.family, number, ended.code, seconds, tuple(wrong))


def keep(case: Case, ended: Ended, wrong: list[str], folder: Path) -> None:
    """Move the files of a case that failed to `folder`; add its command and its faults."""
    facts = {
        "wrong": wrong,
        "command": shlex.join([*case.command[:1], "-m", "oppload_cli", *case.words]),
        "words": case.words,
        "limits": case.limits,
        "environment": case.environment,
        "one_core": case.one_core,
        "umask": case.umask,
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


def _attack(
    numbers: Sequence[int], seed: int, jobs: int, folder: Path, only: str = ""
) -> list[Judged]:
    """Run the cases of these numbers, `jobs` at the same time, and print their faults.

    `folder` receives the folders `work` and `failures`; `only` names a family, or is empty.
    """
    (folder / "work").mkdir(parents=True, exist_ok=True)
    verdicts = []
    try:
        material = make_material(folder / "work")
        run = partial(_run, seed=seed, folder=folder, material=material, only=only)
        spawn = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(jobs, mp_context=spawn, initializer=isolate) as pool:
            for verdict in pool.map(run, numbers):
                verdicts.append(verdict)
                if verdict.wrong:
                    faulty = f"{verdict.family} {verdict.number}: {'; '.join(verdict.wrong)}\n"
                    sys.stderr.write(faulty)
    finally:
        shutil.rmtree(folder / "work", ignore_errors=True)
    return verdicts


def isolate() -> None:
    """Give this process its own orphans and, if it may mount, its own disks and shared memory.

    The faults that it finds then belong to its own case, and not to a case that runs beside it.
    """
    adopt_orphans()
    # A command inherits ignored signals, for example from nohup.
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


def table(verdicts: list[Judged]) -> str:
    """Return the cases and failures of each family, and their exit codes, as text."""
    lines = [f"{'family':<14}{'cases':>7}{'failures':>10}{'longest':>10}  exit codes"]
    for family in (*FAMILIES, "all"):
        cases = [each for each in verdicts if family in {each.family, "all"}]
        if cases:
            failed = sum(bool(each.wrong) for each in cases)
            longest = max(each.seconds for each in cases)
            codes = sorted(Counter(each.code for each in cases).items())
            shown = ", ".join(f"{code}: {count}" for code, count in codes)
            lines.append(f"{family:<14}{len(cases):>7}{failed:>10}{longest:>8.1f} s  {shown}")
    return "\n".join(lines)


def main(arguments: list[str] | None = None) -> int:
    """Run the attack that the command line asks for; return 1 if a case failed."""
    parser = argparse.ArgumentParser(
        prog="python -m tools.attack",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--cases", type=int, default=500, help="number of cases (500)")
    parser.add_argument("--seed", type=int, default=1, help="seed of the cases (1)")
    parser.add_argument("--jobs", type=int, default=2, help="cases at a time (2)")
    parser.add_argument(
        "--folder", type=Path, default=Path("attack"), help="for the cases that fail (attack)"
    )  # .gitignore names it
    parser.add_argument("--only", choices=list(FAMILIES), default="", help="the only family")
    parser.add_argument("--case", type=int, help="the number of the only case")
    options = parser.parse_args(arguments)
    folder = options.folder.resolve()
    numbers = range(options.cases) if options.case is None else [options.case]
    verdicts = _attack(numbers, options.seed, options.jobs, folder, options.only)
    sys.stdout.write(table(verdicts) + "\n")
    failed = sum(bool(each.wrong) for each in verdicts)
    if failed:
        sys.stdout.write(f"{failed} cases are kept in {folder / 'failures'}\n")
    return 1 if failed else 0
