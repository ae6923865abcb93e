"""The report of a batch: counts, the table at the end, and ``failures.csv``."""

from __future__ import annotations

from collections import Counter
from contextlib import suppress
from typing import TYPE_CHECKING

from oppload_cli.batch.plan import FAILURE_COLUMNS, Failure
from oppload_cli.errors import ExitCode, printable
from oppload_cli.files.tables import open_table
from oppload_cli.results.alarms import in_words, label_of

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping
    from pathlib import Path

    from oppload_cli.pipeline.task import Outcome
    from oppload_cli.results.alarms import Verdict


class Tally:
    """Counts the outcomes of a batch; failures and alarms are kept one by one.

    Parameters
    ----------
    failures : iterable of Failure
        Inputs that have failed before any was begun.
    """

    def __init__(self, failures: Iterable[Failure] = ()) -> None:
        self.failures = list(failures)
        self.inputs: Counter[str] = Counter(failed=len(self.failures))
        self.frames: Counter[str] = Counter()
        self.silent = 0
        self.verdicts: dict[str, tuple[Verdict, ...]] = {}

    @property
    def alarmed(self) -> int:
        """How many inputs had an alarm."""
        return sum(any(each.alarms for each in found) for found in self.verdicts.values())

    def add(self, name: str, result: Outcome | Failure) -> None:
        """Count one input."""
        if isinstance(result, Failure):
            self.failures.append(result)
            self.inputs["failed"] += 1
            return
        state = "skipped" if result.skipped else "done" if result.complete else "incomplete"
        self.inputs[state] += 1
        self.frames[state] += result.frames
        self.verdicts[name] = result.verdicts
        # An input that is incomplete may have had an alarm.
        self.silent += state in {"done", "skipped"} and not result.alarmed

    def exit_code_unless(self, fail_on: str | None) -> int:
        """Return the exit code of the batch, or that of a condition that is met.

        Parameters
        ----------
        fail_on : str or None
            ``alarm``: an input had one; ``no-alarm``: one that is done had none.
        """
        quiet = self.silent > 0 and self.exit_code == ExitCode.DONE
        if (fail_on == "alarm" and self.alarmed) or (fail_on == "no-alarm" and quiet):
            return ExitCode.CONDITION_MET
        return self.exit_code

    @property
    def exit_code(self) -> int:
        """The exit code of the batch (``docs/formats.md``)."""
        count = self.inputs.total()
        if count and len(self.failures) == count:
            return max(failure.code for failure in self.failures)
        if self.failures or self.inputs["incomplete"]:
            return ExitCode.INCOMPLETE
        return ExitCode.DONE

    def alarms(self, most: int, place: Path, shown: Mapping[str, str]) -> Iterator[str]:
        """Yield how many inputs alarmed, and the strongest alarms in words.

        Parameters
        ----------
        most : int
            How many inputs are listed.
        place : Path
            The file that lists all of them.
        shown : mapping of str to str
            The words for each input.
        """
        if not self.verdicts:
            return
        alarmed = {
            name: found
            for name, found in self.verdicts.items()
            if any(each.alarms for each in found)
        }
        counts = Counter(each.model for found in alarmed.values() for each in found if each.alarms)
        by_model = ", ".join(f"{label_of(model)} {count}" for model, count in counts.items())
        several = any(len(found) > 1 for found in self.verdicts.values())
        detail = f" ({by_model})" if several and counts else ""
        colon = "; the strongest first:" if alarmed else ""
        yield f"{len(alarmed)} of {len(self.verdicts)} alarmed{detail}{colon}"

        def strength(name: str) -> tuple[float, str]:
            return -max(each.strongest for each in alarmed[name] if each.alarms), name

        for name in sorted(alarmed, key=strength)[:most]:
            yield f"  {shown[name]}: {in_words(alarmed[name])}"
        if len(alarmed) > most:
            yield f"  and {len(alarmed) - most} more: {place}"

    def table(self, wall_s: float) -> Iterator[str]:
        """Yield the lines of the table of a batch that took `wall_s` seconds."""
        yield f"{'':<12}{'inputs':>10}{'frames':>14}"
        for state in ("done", "incomplete", "skipped", "failed"):
            if self.inputs[state]:
                yield f"{state:<12}{self.inputs[state]:>10}{self.frames[state]:>14}"
        total, frames = self.inputs.total(), self.frames.total()
        speed = f", {frames / wall_s:.0f} frames/s" if frames and wall_s else ""
        yield f"{'all':<12}{total:>10}{frames:>14}  in {wall_s:.1f} s{speed}"


def write_failures(path: Path, failures: Iterable[Failure]) -> None:
    """Write ``failures.csv``, which ``--files-from`` reads; without a failure, remove it.

    The rows are sorted by name, so that they do not depend on the order of the processes.

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
    with open_table(path, dict.fromkeys(FAILURE_COLUMNS, str)) as table:
        for each in rows:
            cells = (each.name, each.stem, int(each.code), printable(each.message))
            table.write(dict(zip(FAILURE_COLUMNS, cells, strict=True)))
