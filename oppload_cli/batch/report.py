"""What came of a batch: counts, the table in the end, and ``failures.csv``."""

from __future__ import annotations

import csv
from collections import Counter
from contextlib import suppress
from typing import TYPE_CHECKING

from oppload_cli.batch.lists import FAILURE_COLUMNS
from oppload_cli.batch.plan import Failure
from oppload_cli.errors import ExitCode, printable
from oppload_cli.results.table import PartFile, cannot_write

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from pathlib import Path

    from oppload_cli.task import Outcome

STATES = ("done", "incomplete", "skipped", "failed")


class Tally:
    """Counts what comes of a batch; only failures are kept one by one.

    Parameters
    ----------
    failures : iterable of Failure
        What has failed before anything was begun.
    """

    def __init__(self, failures: Iterable[Failure] = ()) -> None:
        self.failures = list(failures)
        self.inputs: Counter[str] = Counter(failed=len(self.failures))
        self.frames: Counter[str] = Counter()
        self.alarmed = self.silent = 0

    def add(self, result: Outcome | Failure) -> None:
        """Count one input.

        Parameters
        ----------
        result : Outcome or Failure
            What came of it.
        """
        if isinstance(result, Failure):
            self.failures.append(result)
            self.inputs["failed"] += 1
            return
        state = "skipped" if result.skipped else "done" if result.complete else "incomplete"
        self.inputs[state] += 1
        self.frames[state] += result.frames
        self.alarmed += result.alarmed
        # Of an input that is incomplete, or was done before, it is not known.
        self.silent += state == "done" and not result.alarmed

    def exit_code_unless(self, fail_on: str | None) -> int:
        """Return the exit code of the whole, or that of a condition that is met.

        Parameters
        ----------
        fail_on : str or None
            ``alarm``: an input had one; ``no-alarm``: one that is done had none.

        Returns
        -------
        int
        """
        quiet = self.silent > 0 and self.exit_code == ExitCode.DONE
        if (fail_on == "alarm" and self.alarmed) or (fail_on == "no-alarm" and quiet):
            return ExitCode.CONDITION_MET
        return self.exit_code

    @property
    def exit_code(self) -> int:
        """The exit code of the whole (``docs/formats.md``)."""
        count = self.inputs.total()
        if count and len(self.failures) == count:
            return max(failure.code for failure in self.failures)
        if self.failures or self.inputs["incomplete"]:
            return ExitCode.INCOMPLETE
        return ExitCode.DONE

    def table(self, wall_s: float) -> Iterator[str]:
        """Yield the lines of the table.

        Parameters
        ----------
        wall_s : float
            Seconds that the batch took.

        Yields
        ------
        str
        """
        yield f"{'':<12}{'inputs':>10}{'frames':>14}"
        for state in STATES:
            if self.inputs[state]:
                yield f"{state:<12}{self.inputs[state]:>10}{self.frames[state]:>14}"
        total, frames = self.inputs.total(), self.frames.total()
        speed = f", {frames / wall_s:.0f} frames/s" if frames and wall_s else ""
        yield f"{'all':<12}{total:>10}{frames:>14}  in {wall_s:.1f} s{speed}"


def write_failures(path: Path, failures: Iterable[Failure]) -> None:
    """Write ``failures.csv``, which ``--files-from`` reads; without a failure, remove it.

    Parameters
    ----------
    path : Path
        The file.
    failures : iterable of Failure
        Sorted here by name, so that it does not depend on who came first.

    Raises
    ------
    OutputError
        If it cannot be written.
    """
    rows = sorted(failures, key=lambda failure: failure.name)
    if not rows:
        with suppress(FileNotFoundError, NotADirectoryError):
            path.unlink()
        return
    file = PartFile(path)
    try:
        writer = csv.writer(file.stream, lineterminator="\n")
        writer.writerow(FAILURE_COLUMNS)
        for each in rows:
            writer.writerow((each.name, each.stem, int(each.code), printable(each.message)))
        file.commit()
    except BaseException as error:
        file.discard()
        if isinstance(error, OSError):
            raise cannot_write(path, error) from error
        raise
