"""Progress and outcome of inputs on standard error.

On a terminal the progress is a bar, elsewhere a line every 30 seconds.
"""

from __future__ import annotations

import os.path
import time
from pathlib import PurePath
from typing import TYPE_CHECKING, Never

from oppload_cli.cli import on_terminal, progress_bar, say
from oppload_cli.errors import counted, printable
from oppload_cli.processes.signals import stop_if_asked
from oppload_cli.results.alarm_log import (
    MOST_IN_A_LINE,
    Verdict,
    in_words,
    label_of,
    times,
    uncounted,
)
from oppload_cli.video.frames import sizes_in_words
from oppload_cli.video.inputs import is_camera_or_stream

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from tqdm import tqdm

    from oppload_cli.pipeline.task import Outcome, Task
    from oppload_cli.results.record import FrameRecord
    from oppload_cli.video.source import Video


_LINE_EVERY_S = 30.0
# Widths of columns of the table, in characters: names, labels, and first alarm with peak.
_WIDEST_NAME, _LABEL, _CELL = 40, 26, 23


class Progress:
    """Shows the progress of one input, with the verbosity of `RunOptions`.

    With `to_end`, the run reads the input to its end: the bar's total is the input's length.
    """

    def __init__(self, name: str, verbosity: int, *, to_end: bool) -> None:
        self._name = name
        self._verbosity = verbosity
        self._to_end = to_end
        self._bar: tqdm[Never] | None = None
        self._frames = 0
        self._next_line = time.monotonic() + _LINE_EVERY_S

    def opened(self, video: Video) -> None:
        """Show the sizes, and start the bar."""
        if self._verbosity >= 1:
            say(_described(video))
        if self._verbosity >= 0 and on_terminal():
            total = video.facts.frames_declared if self._to_end else None
            self._bar = progress_bar(total, "frame", quiet=False, name=self._name)

    def frame(self, record: FrameRecord) -> None:
        """Count a frame."""
        stop_if_asked()
        self._frames += 1
        if self._bar is not None:
            self._bar.update()
        elif self._verbosity >= 0 and time.monotonic() >= self._next_line:
            self._next_line += _LINE_EVERY_S
            say(f"{self._name}: {self._frames} frames, {record.time_s:.1f} s")

    def close(self) -> None:
        """Remove the bar."""
        if self._bar is not None:
            self._bar.close()


class BatchProgress:
    """Shows the progress of a batch: one bar, with the names of the inputs that are running."""

    def __init__(self, total: int, verbosity: int) -> None:
        self._total = total
        self._verbosity = verbosity
        self._running: dict[str, None] = {}
        self._done = self._frames = 0
        self._started = time.monotonic()
        self._next_line = self._started + _LINE_EVERY_S
        self._bar = progress_bar(total, "input", quiet=verbosity < 0)  # maybe hidden

    def started(self, name: str) -> None:
        """Show the name of an input that is begun."""
        self._running[name] = None
        self.frames(0)

    def frames(self, count: int) -> None:
        """Count more frames."""
        self._frames += count
        self._bar.set_postfix_str(self._now(), refresh=count > 0)
        if self._bar.disable and self._verbosity >= 0 and time.monotonic() >= self._next_line:
            self._next_line = time.monotonic() + _LINE_EVERY_S
            say(f"{self._done} of {self._total} inputs, {self._now()}")

    def ended(self, name: str, lines: Iterable[str]) -> None:
        """Count an input, and print lines about it."""
        self._running.pop(name, None)
        self._done += 1
        self._bar.clear()
        for line in lines:
            say(line)
        self._bar.set_postfix_str(self._now(), refresh=False)
        self._bar.update()

    def close(self) -> None:
        """Remove the bar."""
        self._bar.close()

    def _now(self) -> str:
        seconds = time.monotonic() - self._started
        running = ", ".join(printable(PurePath(name).name) for name in self._running)
        return f"{self._frames / max(seconds, 1e-3):.0f} frames/s, {running}"


def _described(video: Video) -> str:
    """Return a line with the size of an input, its working size, and the unit of speeds."""
    facts, working = video.facts, video.working
    rate = float(facts.frame_rate) if facts.frame_rate else None
    per_second = f" = {working.scale_x * rate:.4g} source px/s" if rate else ""
    others = "".join(f"; also seen at {size.width} x {size.height}" for size in video.others)
    return (
        f"{facts.name}: {sizes_in_words(facts, working)}; 1 px/frame there = "
        f"{working.scale_x:.4g} source px/frame{per_second}{others}"
    )


def outcome_lines(task: Task, outcome: Outcome) -> Iterator[str]:
    """Yield the lines about one input whose run has ended."""
    table = task.outputs and task.outputs.csv
    if outcome.skipped:
        exists = table and os.path.lexists(table)
        reason = f"{table} exists" if exists else "another run is writing it"
        yield f"{task.name}: skipped, {reason}"
    elif not task.settings.with_alarm:
        yield f"{task.name}: no detector has an alarm; the responses are in the table"
    elif len(outcome.verdicts) <= MOST_IN_A_LINE:
        yield f"{task.name}: {in_words(outcome.verdicts)}"
    else:
        yield f"{task.name}:"
        for verdict in outcome.verdicts:
            yield f"  {label_of(verdict.model):<{_LABEL}}{verdict}"
    if task.outputs and not outcome.skipped:
        first, *others = task.outputs.paths()
        names = [str(first), *(path.name for path in others)]
        wall_s = outcome.wall_s
        speed = f", {outcome.frames / wall_s:.0f} analysed per second" if wall_s else ""
        if is_camera_or_stream(task.name):  # the run may wait for frames
            speed = f" in {wall_s:.1f} s"
        yield f"  {counted(outcome.frames, 'frame')}{speed} -> {', '.join(names)}"
    yield from faults(task, outcome)
    for remark in outcome.remarks:
        yield f"oppload: {task.name}: {remark}"


class AlarmTable:
    """The table of a batch: first alarm and peak of every detector, for each input that ends.

    If there are too many detectors for one line, each detector has a row. A peak is the largest
    response to an input divided by its threshold. A star marks a peak above the threshold
    that is in no alarm. `names` are the texts of the first column.
    """

    def __init__(self, names: Iterable[str], models: Sequence[str]) -> None:
        self._name_width = max(
            5, min(_WIDEST_NAME, max((len(printable(name)) for name in names), default=0))
        )
        self._models, self._is_new = models, True
        self._by_row = len(models) > MOST_IN_A_LINE
        self._stars = False

    def lines(self, name: str, outcome: Outcome) -> Iterator[str]:
        """Yield the row of an input, and before the first row the header."""
        if self._is_new:
            yield from self._header()
        self._is_new = False
        cells = {verdict.model: _cell(verdict) for verdict in outcome.verdicts}
        self._stars = self._stars or any(verdict.is_uncounted for verdict in outcome.verdicts)
        name = printable(name)  # as it is printed: an escaped character is wider than its name
        text = name if len(name) <= self._name_width else f"...{name[3 - self._name_width :]}"
        end = "skipped" if outcome.skipped else f"{outcome.frames / (outcome.wall_s or 1):.0f}"
        rows = {model: f"{cells.get(model, ''):<{_CELL}}" for model in self._models}
        if not self._by_row:
            yield f"{text:<{self._name_width}}  {''.join(rows.values())}{end}"
            return
        for model, row in rows.items():
            yield f"{text:<{self._name_width}}  {label_of(model):<{_LABEL}}{row}{end}".rstrip()
            text = end = ""  # only in the row of the first detector

    def legend(self) -> Iterator[str]:
        """Yield the meaning of the column of peaks, if there are rows with peaks."""
        if self._models and not self._is_new:
            yield "peak: largest response of the input, as a multiple of its threshold (x)"
        if self._stars:
            yield f"*: a peak {uncounted(None)}"

    def _header(self) -> Iterator[str]:
        titles = f"{'first alarm':<13}{'peak':<{_CELL - 13}}"
        if self._by_row:
            titles = f"{'detector':<{_LABEL}}{titles}"
        else:
            labels = (f"{label_of(name):<{_CELL}}" for name in self._models)
            if self._models:
                yield f"{'':<{self._name_width}}  {''.join(labels)}".rstrip()
            titles *= len(self._models)
        yield f"{'input':<{self._name_width}}  {titles}frames/s"


def _cell(verdict: Verdict) -> str:
    first = f"{verdict.alarms[0].start_s:.2f} s" if verdict.alarms else "-"
    star = "*" if verdict.is_uncounted else ""
    return f"{first:<13}{'-' if verdict.peak is None else f'{times(verdict.peak)} x{star}'}"


def faults(task: Task, outcome: Outcome, *, quiet: bool = False) -> Iterator[str]:
    """Yield the line that says why a result is incomplete, or a line of notes unless `quiet`."""
    notes = "; ".join(outcome.notes)
    if not outcome.complete:
        reason = notes or "damaged frames"
        yield f"oppload: {task.name}: incomplete ({reason}); the rows in the table are valid"
    elif notes and not quiet:
        yield f"oppload: {task.name}: {notes}"
