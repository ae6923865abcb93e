"""Compare the speed of two checkouts, in turns on one machine; fail on a real regression.

    python -m benchmarks.compare BASE HEAD
    python -m benchmarks.compare --self-test

Each round runs base, head and base again, each in a process of its own. The comparison fails if the
median ratio of head to base is above 1 by more than a tenth, and by more than twice the median
difference between the two runs of the base.
"""  # fmt: skip

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
from pathlib import Path

LEAST_MARGIN = 0.10
WORKER = """
import sys, time
import numpy as np
from oppload_cli import DetectorBank, DlgmdParams, parameters_of
frames = np.random.default_rng(0).random((8, 240, 427), dtype=np.float32)
bank = DetectorBank((240, 427), [parameters_of("opplod", "reference"), DlgmdParams()])
passes = 12 + int(sys.argv[1])
for luma in frames:
    bank.step(luma)
start = time.process_time()
for _ in range(passes):
    for luma in frames:
        bank.step(luma)
print((time.process_time() - start) / 12)
"""


def _cost(checkout: Path, extra_passes: int = 0) -> float:
    """Return the processor time of the models in a checkout, in seconds."""
    done = subprocess.run(
        [sys.executable, "-c", WORKER, str(extra_passes)],
        # A waiting thread of OpenBLAS would count as the models' time, as in oppload.__main__.
        env={**os.environ, "PYTHONPATH": str(checkout), "OPENBLAS_NUM_THREADS": "1"},
        cwd=checkout, check=True, capture_output=True, text=True,
    )  # fmt: skip
    return float(done.stdout)


def _compared(base: Path, head: Path, rounds: int, extra_passes: int = 0) -> tuple[bool, str]:
    """Return whether the head is as fast as the base within the margin, and the figures.

    For the self-test, the head runs `extra_passes` more passes than the base.
    """
    ratios, drift = [], []
    for _ in range(rounds):
        before, measured, after = _cost(base), _cost(head, extra_passes), _cost(base)
        ratios.append(measured / statistics.mean((before, after)))
        drift.append(abs(after / before - 1))
    margin = max(LEAST_MARGIN, 2 * statistics.median(drift))
    median = statistics.median(ratios)
    text = f"head / base: median {median:.3f} of {rounds} rounds, margin {margin:.3f}"
    return median <= 1 + margin, text


def _self_test(rounds: int) -> bool:
    """Return whether the same code passes, and code that takes half as long again fails."""
    here = Path(__file__).resolve().parents[1]
    same, same_text = _compared(here, here, rounds)
    slower, slower_text = _compared(here, here, rounds, extra_passes=6)
    print(f"the same code: {same_text}\nslower by half: {slower_text}")
    return same and not slower


def main() -> None:
    """Parse the command line and exit 0 or 1."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("base", type=Path, nargs="?", help="folder of the older checkout")
    parser.add_argument("head", type=Path, nargs="?", help="folder of the newer checkout")
    parser.add_argument("--rounds", type=int, default=7, help="turns that are measured (7)")
    parser.add_argument(
        "--self-test", action="store_true", help="compare this checkout with slower copies of it"
    )
    options = parser.parse_args()
    if options.self_test:
        sys.exit(0 if _self_test(options.rounds) else 1)
    if options.base is None or options.head is None:
        parser.error("give two checkouts, or --self-test")
    passes, text = _compared(options.base.resolve(), options.head.resolve(), options.rounds)
    print(text + ("" if passes else ": slower"))
    sys.exit(0 if passes else 1)


if __name__ == "__main__":
    main()
