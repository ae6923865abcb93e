"""The inputs of a batch: their order, the names of their results, and the count of outcomes."""

from __future__ import annotations

import codecs
import os
import re
import sys
import unicodedata
from collections import Counter, defaultdict
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from oppload_cli.errors import ExitCode, ParameterError, printable
from oppload_cli.files.atomic import output_errors
from oppload_cli.files.reading import content_of, reading
from oppload_cli.files.tables import open_csv, rows_of
from oppload_cli.processes.threads import Call
from oppload_cli.results.alarm_log import ALARM_COLUMNS, MOST_IN_A_LINE, in_words, label_of
from oppload_cli.video.inputs import (
    each_once,
    found_inputs,
    is_image_file,
    result_stem,
    without_truths,
)

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

    from oppload_cli.pipeline.task import Outcome
    from oppload_cli.results.alarm_log import Verdict


_STANDARD_INPUT = "-"
FAILURE_COLUMNS = ("input", "stem", "exit_code", "error")  # of failures.csv


class Input(NamedTuple):
    """One input of a batch, and its stem: the names of its results are ``{stem}.frames.csv``."""

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
        The stem that its results would have; empty if it has none of its own.
    code : int
        The exit code of a run of this input alone (``docs/formats.md``).
    message : str
        One sentence: the fault, its place, and the remedy.
    """

    name: str
    stem: str
    code: int
    message: str


@dataclass(frozen=True)
class Plan:
    """The inputs of a batch, each once and sorted by name, and the names that are no input."""

    inputs: list[Input]
    failures: list[Failure]

    def __len__(self) -> int:
        return len(self.inputs) + len(self.failures)

    def shard(self, number: int, count: int) -> Plan:
        """Return every `count`-th input, beginning with the `number`-th one (from 1).

        The same list gives the same shards; they never overlap, and together they are the plan.
        Results keep the names that they have in the complete plan. All failures of the plan are in
        the first shard.
        """
        return Plan(self.inputs[number - 1 :: count], self.failures if number == 1 else [])


def planned(named: Iterable[str], *, recursive: bool = False) -> Plan:
    """Return the plan for the names that the user gives.

    Parameters
    ----------
    named : iterable of str
        Files, folders, patterns and addresses.
    recursive : bool
        Whether folders are searched to any depth.
    """
    stems: dict[str, str] = {}
    failures: list[Failure] = []
    for given in named:
        for name, error, folder in found_inputs(given, recursive=recursive):
            if error is None:
                stems.setdefault(name, result_stem(name, folder))
            else:
                failures.append(Failure(name, "", error.exit_code, str(error)))
    names = sorted(without_truths(each_once(stems)))
    single_images = _single_images(names)
    for folder, images in single_images.items():
        message = (
            f"{folder}: {len(images)} of its images are given one by one, and a single image shows "
            f"no motion; give the folder, or a pattern such as frame_%03d{Path(images[0]).suffix}"
        )
        failures.append(Failure(folder, "", ExitCode.NOTHING_READ, message))
    not_videos = set(chain.from_iterable(single_images.values()))
    names = [name for name in names if name not in not_videos]
    holders: dict[str, str] = {}  # the input that has a stem, by `_stem_key`
    inputs: list[Input] = []
    for name in names:
        holder = holders.setdefault(_stem_key(stems[name]), name)
        if holder == name:
            inputs.append(Input(name, stems[name]))
        else:
            failures.append(_same_stem(name, holder))
    return Plan(inputs, list(dict.fromkeys(failures)))


def _stem_key(stem: str) -> str:
    """Return the same key for stems that a system may take for one name: A and a, é and e + ´."""
    return unicodedata.normalize("NFC", stem.casefold())


def _same_stem(name: str, holder: str) -> Failure:
    """Return the failure of an input whose stem another input has."""
    in_other_folder = Path(name).parent != Path(holder).parent and os.path.lexists(name)
    message = (
        f"{name}: its results would have the same names as those of {holder}; "
        f"{'give a folder of both with --recursive, or ' * in_other_folder}rename it, or run it "
        "alone with another --output"
    )
    return Failure(name, "", ExitCode.USAGE, message)


def _single_images(names: Iterable[str]) -> dict[str, list[str]]:
    """Return the folders of which several images are inputs, with these images."""
    images: defaultdict[str, list[str]] = defaultdict(list)
    for name in names:
        if is_image_file(name):
            images[os.path.dirname(name) or "."].append(name)  # noqa: PTH120 - keeps "./"
    return {folder: paths for folder, paths in images.items() if len(paths) > 1}


def parse_shard(text: str) -> tuple[int, int]:
    """Return I and N of a shard ``I/N``; raise ParameterError for any other text."""
    match = re.fullmatch(r"(\d{1,9})/(\d{1,9})", text)
    number, count = (int(match[1]), int(match[2])) if match else (0, 0)
    if not 1 <= number <= count:
        raise ParameterError(
            f"--shard must be I/N with I from 1 to N, such as 1/8 to 8/8, not '{text}'"
        )
    return number, count


def read_list(source: str, *, null: bool = False) -> list[str]:
    """Return the names in a list of inputs.

    Parameters
    ----------
    source : str
        A file, or ``-`` for standard input, with a name on each line (empty lines are ignored).
    null : bool
        Whether the names end in NUL, as ``find -print0`` writes them.

    Raises
    ------
    ParameterError
        If the list cannot be read, names nothing, or is a table of a batch.
    """
    content = _content(source).removeprefix(codecs.BOM_UTF8)
    if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        raise ParameterError(f"--files-from {source}: is text in UTF-16; save it as UTF-8")
    try:
        text = os.fsdecode(content)
    except UnicodeDecodeError as error:  # on Windows, where every name is text
        raise ParameterError(
            f"--files-from {source}: is not text in UTF-8; save it as UTF-8"
        ) from error
    if text.startswith((",".join(ALARM_COLUMNS), ",".join(FAILURE_COLUMNS))):
        raise ParameterError(
            f"--files-from {source}: is a table of a batch, not a list; give a file with a name on "
            f"each line, or the command of the batch with --if-exists skip"
        )
    if null:
        if "\0" not in text and "\n" in text:
            raise ParameterError(
                f"--files-from {source}: its names do not end in NUL; leave out -0"
            )
        names = [name for name in text.split("\0") if name]
    else:
        # Not `splitlines`, which also splits at other characters that a name may hold.
        lines = (line.removesuffix("\r") for line in text.split("\n"))
        names = [line for line in lines if line]
    if not names:
        raise ParameterError(f"--files-from {source}: names no input; put a name on each line")
    if any("\0" in name for name in names):
        raise ParameterError(f"--files-from {source}: its names end in NUL; add -0")
    return names


def _content(source: str) -> bytes:
    if source == _STANDARD_INPUT:
        # In a thread: while the program before the pipe is slow, Ctrl-C must still work.
        content: bytes = Call(sys.stdin.buffer.read).result()
        return content
    with reading(f"--files-from {source}", ParameterError):
        return content_of(source, pipes=True)


class Tally:
    """Counts the outcomes of a batch, and keeps its failures and its alarms.

    `failures` are the failures of the plan.
    """

    def __init__(self, failures: Iterable[Failure] = ()) -> None:
        self.failures = list(failures)
        self.inputs: Counter[str] = Counter(failed=len(self.failures))
        self.frames: Counter[str] = Counter()
        self.silent = 0  # complete inputs without an alarm
        self.incomplete = 0  # inputs, also those whose result was kept
        self.verdicts: dict[str, tuple[Verdict, ...]] = {}

    @property
    def alarmed(self) -> dict[str, tuple[Verdict, ...]]:
        """The verdicts on the inputs that had an alarm, by input."""
        return {
            name: verdicts
            for name, verdicts in self.verdicts.items()
            if any(verdict.alarms for verdict in verdicts)
        }

    def add(self, name: str, result: Outcome | Failure) -> None:
        """Count one input."""
        if isinstance(result, Failure):
            self.failures.append(result)
            self.inputs["failed"] += 1
            return
        state = "skipped" if result.skipped else "done" if result.complete else "incomplete"
        self.inputs[state] += 1
        self.frames[state] += result.frames
        self.incomplete += not result.complete  # a skipped result may be incomplete too
        if result.skipped and not result.verdicts:
            return  # another run is writing the result, and lists its alarms
        self.verdicts[name] = result.verdicts
        # In an incomplete input, frames that could not be read may belong to an alarm.
        self.silent += result.complete and not result.alarmed

    def exit_code(self, fail_on: str | None = None) -> int:
        """Return the exit code of the batch (``docs/formats.md``).

        Parameters
        ----------
        fail_on : str, optional
            The condition of exit code 5: ``alarm`` if an input had an alarm, ``no-alarm`` if a
            complete input had none.
        """
        if (fail_on == "alarm" and self.alarmed) or (fail_on == "no-alarm" and self.silent):
            return ExitCode.CONDITION_MET
        count = self.inputs.total()
        if count and len(self.failures) == count:
            return max(failure.code for failure in self.failures)
        if self.failures or self.incomplete:
            return ExitCode.INCOMPLETE
        return ExitCode.DONE

    def alarms(self, most: int, path: Path, stems: Mapping[str, str]) -> Iterator[str]:
        """Yield how many inputs had an alarm, and the strongest alarms as sentences.

        At most `most` inputs are listed, each by its stem; `path` is the file with all alarms. If
        there are more detectors than a line can hold, the lines instead count the inputs on which
        each detector alarmed.
        """
        if not self.verdicts:
            return
        alarmed = self.alarmed
        counts: Counter[str] = Counter()
        # Detectors without an alarm are counted first, so that all keep their order, and left out.
        for verdict in chain.from_iterable(alarmed.values()):
            counts[verdict.model] += bool(verdict.alarms)
        counts = +counts
        most_detectors = max(map(len, self.verdicts.values()))
        if most_detectors > MOST_IN_A_LINE:
            yield f"{len(alarmed)} of {len(self.verdicts)} inputs had an alarm; all alarms: {path}"
            for model, count in counts.most_common():
                yield f"  {label_of(model):<26}{count}"
            return
        by_model = ", ".join(f"{label_of(model)} {count}" for model, count in counts.items())
        detail = f" ({by_model})" if most_detectors > 1 and counts else ""
        colon = "; the strongest first:" if alarmed else ""
        yield f"{len(alarmed)} of {len(self.verdicts)} inputs had an alarm{detail}{colon}"

        def strength(name: str) -> tuple[float, str]:
            return -max(verdict.strongest for verdict in alarmed[name] if verdict.alarms), name

        for name in sorted(alarmed, key=strength)[:most]:
            yield f"  {stems[name]}: {in_words(alarmed[name])}"
        if len(alarmed) > most:
            yield f"  and {len(alarmed) - most} more: {path}"

    def table(self, wall_s: float) -> Iterator[str]:
        """Yield the lines of the table of a batch that took `wall_s` seconds."""
        yield f"{'':<12}{'inputs':>10}{'frames':>14}"
        for state in ("done", "incomplete", "skipped", "failed"):
            if self.inputs[state]:
                yield f"{state:<12}{self.inputs[state]:>10}{self.frames[state]:>14}"
        total, frames = self.inputs.total(), self.frames.total()
        speed = f", {frames / wall_s:.0f} frames/s" if frames and wall_s else ""
        yield f"{'all':<12}{total:>10}{frames:>14}  in {wall_s:.1f} s{speed}"


def failed_in(folder: Path) -> Iterator[tuple[str, str]]:
    """Yield the stem and the error of each input that failed, from a folder's lists of failures.

    The lists are those of one batch, or of its shards. A list that cannot be read is skipped.
    """
    for path in sorted(folder.glob("failures*.csv")):
        for row in rows_of(path, FAILURE_COLUMNS):
            yield row["stem"] or "", row["error"] or ""


def write_failures(path: Path, failures: Iterable[Failure]) -> None:
    """Write ``failures.csv``; without a failure, remove it.

    The rows are sorted by name, as the processes of a batch end in any order. Raises OutputError if
    the file cannot be written.
    """
    rows = sorted(failures, key=lambda failure: failure.name)
    if not rows:
        with output_errors(path):
            path.unlink(missing_ok=True)
        return
    with open_csv(path, FAILURE_COLUMNS) as table:
        for failure in rows:
            cells = (failure.name, failure.stem, int(failure.code), printable(failure.message))
            table.write(dict(zip(FAILURE_COLUMNS, cells, strict=True)))
