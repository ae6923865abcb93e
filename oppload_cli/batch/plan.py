"""The inputs of a batch: their order, the names of their results, and their outcomes."""

from __future__ import annotations

import codecs
import csv
import io
import os
import re
import sys
from collections import Counter, defaultdict
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from oppload_cli.errors import ExitCode, ParameterError, printable
from oppload_cli.files.reading import content_of, fault_of_stem, reading
from oppload_cli.files.tables import open_table
from oppload_cli.processes.threads import Call
from oppload_cli.results.alarms import MOST_IN_A_LINE, in_words, label_of
from oppload_cli.results.table import TABLE
from oppload_cli.video.inputs import (
    each_once,
    found_inputs,
    is_image_file,
    other_stems,
    result_stem,
)

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

    from oppload_cli.pipeline.task import Outcome
    from oppload_cli.results.alarms import Verdict


_STANDARD_INPUT = "-"
FAILURE_COLUMNS = ("input", "stem", "exit_code", "error")  # of failures.csv


class Listed(NamedTuple):
    """One entry of a list of inputs.

    Attributes
    ----------
    name : str
        A file, a folder, a pattern or an address.
    stem : str
        The stem of its results, where an earlier batch has chosen it; else empty.
    """

    name: str
    stem: str = ""


@dataclass(frozen=True)
class _Planned:
    """One input of a batch.

    Attributes
    ----------
    name : str
        The input.
    stem : str
        Of its results: ``{stem}.frames.csv`` and ``{stem}.oppload.json``.
    """

    name: str
    stem: str


@dataclass(frozen=True)
class Failure:
    """An input that failed.

    Attributes
    ----------
    name : str
        The input, as the user named it.
    stem : str
        Of its results; empty where no input was found under the name. Trying it again from
        ``failures.csv`` keeps it.
    code : int
        The exit code that it has alone (``docs/formats.md``).
    message : str
        One sentence: the fault, its place, and the remedy.
    """

    name: str
    stem: str
    code: int
    message: str


@dataclass(frozen=True)
class Plan:
    """All inputs of a batch, each once, sorted by name.

    Attributes
    ----------
    inputs : list of _Planned
        The inputs to analyse.
    failures : list of Failure
        Names under which no input was found.
    """

    inputs: list[_Planned] = field(default_factory=list)
    failures: list[Failure] = field(default_factory=list)

    def __len__(self) -> int:
        return len(self.inputs) + len(self.failures)

    def shard(self, number: int, of: int) -> Plan:
        """Return every `of`-th input, from the `number`-th (from 1) on.

        The same list gives the same shards; they never overlap, and together they are
        the plan. Results keep the names of the complete plan. A name without an input
        fails in the first shard.
        """
        return Plan(self.inputs[number - 1 :: of], self.failures if number == 1 else [])


def planned(named: Iterable[str | Listed | Failure], *, recursive: bool = False) -> Plan:
    """Return the plan for the names that the user gives.

    Parameters
    ----------
    named : iterable of str, Listed or Failure
        Files, folders, patterns and addresses; a listed one with a stem keeps it. A
        failure of a list is passed on.
    recursive : bool
        Whether folders are searched to any depth.
    """
    stems: dict[str, str] = {}
    failures: list[Failure] = []
    names: list[str] = []
    for entry in dict.fromkeys(named):
        if isinstance(entry, Failure):
            failures.append(entry)
            continue
        each = entry if isinstance(entry, Listed) else Listed(entry)
        if each.stem:
            stems[each.name] = each.stem
            names.append(each.name)
            continue
        for name, error, folder in found_inputs(each.name, recursive=recursive):
            if error is None:
                names.append(name)
                stems.setdefault(name, result_stem(name, folder))
            else:
                failures.append(Failure(name, "", error.exit_code, str(error)))
    inputs: list[_Planned] = []
    holders: dict[str, str] = {}
    clashing: list[str] = []
    kept = sorted(each_once(names))
    single_images = _single_images(kept)
    for folder, images in single_images.items():
        message = (
            f"{folder}: {len(images)} of its images are given one by one, and a single image shows "
            f"no motion; give the folder, or a pattern such as frame_%03d{Path(images[0]).suffix}"
        )
        failures.append(Failure(folder, "", ExitCode.NOTHING_READ, message))
    left_out = set(chain.from_iterable(single_images.values()))
    for name in kept:
        if name in left_out:
            continue
        stem = stems[name]
        holder = holders.setdefault(stem.casefold(), name)
        if holder == name:
            inputs.append(_Planned(name, stem))
        else:
            clashing.append(name)
    failures += [_second(name, stems[name], holders) for name in clashing]
    return Plan(inputs, list(dict.fromkeys(failures)))


def _second(name: str, stem: str, holders: dict[str, str]) -> Failure:
    """Return the failure of an input whose stem another one holds; `holders` gets its new stem.

    Only a list may give it that: which input comes second changes as others join.
    """
    holder = holders[stem.casefold()]
    others = other_stems(name, stem)
    own = next(each for each in others if holders.setdefault(each.casefold(), name) == name)
    apart = Path(name).parent != Path(holder).parent and os.path.lexists(name)
    message = (
        f"{name}: its results would have the names of those of {holder}; "
        f"{'give a folder of both with --recursive, or ' * apart}try it again by the list of "
        f"failures, which names its table {own}{TABLE}"
    )
    return Failure(name, own, ExitCode.USAGE, message)


def _single_images(names: Iterable[str]) -> dict[str, list[str]]:
    """Return the folders of which several images are named, as by a pattern, with their names."""
    images: defaultdict[str, list[str]] = defaultdict(list)
    for name in names:
        if is_image_file(name):
            images[os.path.dirname(name) or "."].append(name)  # noqa: PTH120 - keeps "./"
    return {folder: found for folder, found in images.items() if len(found) > 1}


def parse_shard(text: str) -> tuple[int, int]:
    """Read a shard ``I/N``, the I-th of N from 1; return I and N.

    Raises
    ------
    ParameterError
        If it is written in another way, or I is not 1 to N.
    """
    match = re.fullmatch(r"(\d{1,9})/(\d{1,9})", text)
    number, of = (int(match[1]), int(match[2])) if match else (0, 0)
    if not 1 <= number <= of:
        raise ParameterError(
            f"--shard must be I/N with I from 1 to N, such as 1/8 to 8/8, not '{text}'"
        )
    return number, of


def read_list(source: str, *, null: bool = False) -> list[Listed | Failure]:
    """Read a list of inputs.

    Parameters
    ----------
    source : str
        A file, or ``-`` for standard input, with a name on each line (empty lines are
        passed over); or the ``failures.csv`` of a batch.
    null : bool
        Whether the names end in NUL, as ``find -print0`` writes them.

    Returns
    -------
    list of Listed or Failure
        A row with a stem that may not be used is a failure.

    Raises
    ------
    ParameterError
        If it cannot be read, or names nothing.
    """
    entries: list[Listed | Failure]
    content = _content(source).removeprefix(codecs.BOM_UTF8)
    if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        raise ParameterError(f"--files-from {source}: is text in UTF-16; save it as UTF-8")
    text = os.fsdecode(content)
    if null:
        entries = [Listed(name) for name in text.split("\0") if name]
    elif text.startswith(",".join(FAILURE_COLUMNS)):
        entries = list(_failed_before(source, text))
    else:
        # Only line ends separate: a name may hold any other character.
        lines = (line.removesuffix("\r") for line in text.split("\n"))
        entries = [Listed(line) for line in lines if line]
    if not entries:
        raise ParameterError(f"--files-from {source}: names no input; put a name on each line")
    if any("\0" in entry.name for entry in entries):
        raise ParameterError(f"--files-from {source}: its names end in NUL; add -0")
    return entries


def _failed_before(source: str, text: str) -> Iterator[Listed | Failure]:
    """Yield the rows of a ``failures.csv``.

    The file may come from elsewhere: no stem may lead out of the folder of the batch, or to the
    results of another input.
    """
    holders: dict[str, str] = {}
    with reading(f"--files-from {source}", ParameterError, form="CSV"):
        for number, row in enumerate(csv.DictReader(io.StringIO(text, newline="")), 2):
            name, stem = row["input"] or "", row["stem"] or ""
            fault = fault_of_stem(stem) if stem else ""
            fault = fault and f"is no plain name, as it {fault}"
            holder = holders.setdefault(stem.casefold(), name)
            if stem and holder != name:
                fault = f"is that of {holder} already"
            if fault:
                place = f"--files-from {source}: row {number}"
                message = f"{place}: the stem '{stem}' {fault}; correct the row"
                yield Failure(name, "", ExitCode.USAGE, message)
            else:
                yield Listed(name, stem)


def _content(source: str) -> bytes:
    if source == _STANDARD_INPUT:
        if sys.stdin is None:  # as Python has it after "oppload ... <&-"
            raise ParameterError("--files-from -: standard input is closed; pipe a list into it")
        # In a thread, as the list may be long in coming.
        content: bytes = Call(sys.stdin.buffer.read).result()
        return content
    with reading(f"--files-from {source}", ParameterError):
        return content_of(source, pipes=True)


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
        self.silent = self.incomplete = 0
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
        self.incomplete += not result.complete  # of a result that is kept too
        # An input that is incomplete may have had an alarm.
        self.silent += result.complete and not result.alarmed

    def exit_code_unless(self, fail_on: str | None) -> int:
        """Return the exit code of the batch, or that of a condition that is met.

        Parameters
        ----------
        fail_on : str or None
            ``alarm``: met if an input had an alarm; ``no-alarm``: met if an input that is complete
            had none.
        """
        if (fail_on == "alarm" and self.alarmed) or (fail_on == "no-alarm" and self.silent):
            return ExitCode.CONDITION_MET
        return self.exit_code

    @property
    def exit_code(self) -> int:
        """The exit code of the batch (``docs/formats.md``)."""
        count = self.inputs.total()
        if count and len(self.failures) == count:
            return max(failure.code for failure in self.failures)
        if self.failures or self.incomplete:
            return ExitCode.INCOMPLETE
        return ExitCode.DONE

    def alarms(self, most: int, place: Path, shown: Mapping[str, str]) -> Iterator[str]:
        """Yield how many inputs alarmed, and the strongest alarms in words.

        Of more detectors than fit into a line the inputs that each alarmed on are counted.

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
        if any(len(found) > MOST_IN_A_LINE for found in self.verdicts.values()):
            yield f"{len(alarmed)} of {len(self.verdicts)} alarmed; all alarms: {place}"
            for model, count in counts.most_common():
                yield f"  {label_of(model):<26}{count}"
            return
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
