"""Run the attack, print a table of its families, and keep every case that fails.

python -m tools.attack --cases 5000 --seed 1 --jobs 2
python -m tools.attack --seed 1 --only servers --case 123   # run one case again
"""  # fmt: skip

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from tools.attack.campaign import attack, table
from tools.attack.families import FAMILIES


def main(arguments: list[str] | None = None) -> int:
    """Run the attack that the command line asks for; return 1 if a case failed."""
    parser = argparse.ArgumentParser(prog="python -m tools.attack", description=__doc__)
    parser.add_argument("--cases", type=int, default=500)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--folder", type=Path, default=Path("attack"))  # .gitignore names it
    parser.add_argument("--only", choices=list(FAMILIES), default="", help="the only family")
    parser.add_argument("--case", type=int, help="the number of the only case")
    options = parser.parse_args(arguments)
    folder = options.folder.resolve()
    numbers = range(options.cases) if options.case is None else [options.case]
    verdicts = attack(numbers, options.seed, options.jobs, folder, options.only)
    sys.stdout.write(table(verdicts) + "\n")
    failed = sum(bool(each.wrong) for each in verdicts)
    if failed:
        sys.stdout.write(f"{failed} cases are kept in {folder / 'failures'}\n")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
