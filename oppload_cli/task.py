"""One input from its first frame to its result files."""

from __future__ import annotations

import os.path
import sys
import time
from dataclasses import asdict, dataclass, field
from enum import StrEnum
from fractions import Fraction
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, Protocol

import cv2

from oppload_cli.analysis import analyse
from oppload_cli.environment import cores, environment
from oppload_cli.errors import BusyError, OpploadError, OutputError
from oppload_cli.models.crew import is_large
from oppload_cli.results.columns import columns_for
from oppload_cli.results.sidecar import write_sidecar
from oppload_cli.results.summary import ModelSummary
from oppload_cli.results.table import PartFile, Table, cannot_write
from oppload_cli.video.atomic import part_of
from oppload_cli.video.source import open_video
from oppload_cli.video.span import Span

if TYPE_CHECKING:
    from collections.abc import Sequence

    from oppload_cli.results.record import FrameRecord
    from oppload_cli.settings import Settings
    from oppload_cli.video.source import Video


class IfExists(StrEnum):
    """What to do where a result is there already."""

    ERROR = "error"
    SKIP = "skip"
    OVERWRITE = "overwrite"


@dataclass(frozen=True)
class Task:
    """What to do with one input.

    Attributes
    ----------
    name : str
        The input.
    settings : Settings
        How to analyse it.
    csv, sidecar : Path or None
        The files to write; None for both streams the CSV to standard output.
    span : Span
        The part of the input.
    image_rate : Fraction
        Frames per second of images.
    if_exists : IfExists
        What to do where `csv` or `sidecar` exists.
    command : sequence of str
        The command line, for the sidecar.
    threads : int
        Of the decoder, and of the models on large frames; 0 leaves the choice to them.
    """

    name: str
    settings: Settings
    csv: Path | None = None
    sidecar: Path | None = None
    span: Span = field(default_factory=Span)
    image_rate: Fraction = Fraction(30)
    if_exists: IfExists = IfExists.ERROR
    command: Sequence[str] = ()
    threads: int = 0


@dataclass(frozen=True)
class Outcome:
    """What became of a task.

    Attributes
    ----------
    skipped : bool
        The result was there already.
    complete : bool
        Everything that the input declared was decoded.
    frames : int
        Rows written.
    wall_s : float
        Seconds from opening to the last row.
    notes : tuple of str
        What was wrong with the input, a line each.
    summaries : dict of str to ModelSummary
        By model.
    """

    skipped: bool = False
    complete: bool = True
    frames: int = 0
    wall_s: float = 0.0
    notes: tuple[str, ...] = ()
    summaries: dict[str, ModelSummary] = field(default_factory=dict)

    @property
    def alarmed(self) -> bool:
        """Whether the alarm of any model went on."""
        return any(each.first_alarm_frame is not None for each in self.summaries.values())


class Watcher(Protocol):
    """Whoever wants to know how a task gets on."""

    def opened(self, video: Video) -> None:
        """Take note that the input is open."""

    def frame(self, record: FrameRecord) -> None:
        """Take note of a frame that is written."""


class Interrupted(KeyboardInterrupt):
    """The user stopped a task; the message says what is left of it."""


def run_task(task: Task, watcher: Watcher | None = None) -> Outcome:
    """Analyse one input and write its results.

    Parameters
    ----------
    task : Task
        What to do.
    watcher : Watcher, optional
        Told of each frame.

    Returns
    -------
    Outcome

    Raises
    ------
    SourceError
        If nothing can be read; nothing is written then.
    OutputError
        If a result exists, or cannot be written.
    Interrupted
        If the user stops it; the rows so far stay as ``NAME.part``.
    """
    if exists_already(task):
        return Outcome(skipped=True)
    started = time.perf_counter()
    with open_video(
        task.name,
        height=task.settings.height,
        span=task.span,
        image_rate=task.image_rate,
        threads=task.threads,
    ) as video:
        # On small frames OpenCV's threads wait for each other longer than they work.
        cv2.setNumThreads((task.threads or cores()) if is_large(video.working.shape) else 1)
        if watcher:
            watcher.opened(video)
        run = _Run(task, video, watcher)
        if task.csv is None:
            _write_stream(run, sys.stdout)
        else:
            file = _begun(task, task.csv)
            if file is None:
                return Outcome(skipped=True)
            _write_files(run, file, task.sidecar, started)
        return run.outcome(time.perf_counter() - started)


def exists_already(task: Task) -> bool:
    """Tell whether the results of a task are there and shall be kept.

    A result is whole when both files are there; one alone is what a killed run left.

    Parameters
    ----------
    task : Task
        What would be done.

    Returns
    -------
    bool

    Raises
    ------
    OutputError
        If a result is there and nothing was said of it.
    """
    results = [path for path in (task.csv, task.sidecar) if path is not None]
    # These say no to a name that may not be looked up; writing it will tell the reason.
    there = [path for path in results if os.path.lexists(path)]
    if task.if_exists is IfExists.ERROR:
        there += [part_of(path) for path in results if os.path.lexists(part_of(path))]
        if there:
            raise OutputError(
                f"{there[0]}: exists already; "
                f"choose --if-exists overwrite or skip, or another --output"
            )
    return task.if_exists is IfExists.SKIP and bool(there) and len(there) == len(results)


def _begun(task: Task, csv: Path) -> PartFile | None:
    """Open the table for writing; None if what another run does, or has just done, is kept."""
    try:
        file = PartFile(csv)
    except BusyError:
        if task.if_exists is IfExists.SKIP:
            return None
        raise
    if task.if_exists is IfExists.SKIP and exists_already(task):
        file.discard()
        return None
    return file


def _write_files(run: _Run, file: PartFile, sidecar: Path | None, started: float) -> None:
    """Write the rows, the sidecar, and last give the rows their name."""
    csv = file.path
    try:
        run.write(file.stream)
        if sidecar is not None:
            # An old table must never stand beside a new sidecar, however this ends.
            csv.unlink(missing_ok=True)
            write_sidecar(sidecar, run.sidecar(run.outcome(time.perf_counter() - started)))
        file.commit()
    except BaseException as error:
        if run.frames == 0:
            file.discard()
            left = ""
        else:
            file.keep()
            left = f"; the first {run.frames} rows are in {file.part}"
        explained = _explained(error, csv, left)
        if explained is None:
            raise
        raise explained from error


def _explained(error: BaseException, path: Path, left: str) -> BaseException | None:
    """Return an error that says what is left of the result; None for a bug."""
    if isinstance(error, KeyboardInterrupt):
        return Interrupted(left.removeprefix("; "))
    if isinstance(error, OSError):
        return OutputError(f"{cannot_write(path, error)}{left}")
    if isinstance(error, OpploadError):
        return type(error)(f"{error}{left}")
    return None


def _write_stream(run: _Run, stream: IO[str] | None) -> None:
    if stream is None:  # as Python has it after "oppload ... >&-"
        raise OutputError("standard output: is closed; open it, or give a folder with --output")
    try:
        run.write(stream)
    except BrokenPipeError:
        raise  # the reader has gone: not an error of ours
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise OutputError(f"standard output: cannot be written ({reason}); free it") from error


class _Run:
    """The state of one pass over a video."""

    def __init__(self, task: Task, video: Video, watcher: Watcher | None) -> None:
        self._task = task
        self._video = video
        self._watcher = watcher
        self._summaries = {name: ModelSummary() for name in task.settings.models}
        self._repeats = 0
        self.frames = 0

    def write(self, stream: IO[str]) -> None:
        """Analyse every frame and write its row."""
        settings = self._task.settings
        columns = columns_for(settings.models, rmo=settings.rmo is not None)
        table = Table(stream, [column.name for column in columns])
        records = analyse(
            self._video,
            settings.model_params(),
            alarm=settings.alarm,
            places=settings.places,
            rmo=settings.rmo,
            repeats=settings.repeats,
        )
        for record in records:
            table.write(record.values())
            self.frames += 1
            self._repeats += record.repeat
            for name, summary in self._summaries.items():
                summary.add(record, name)
            if self._watcher:
                self._watcher.frame(record)
        stream.flush()

    def outcome(self, wall_s: float) -> Outcome:
        """Return what became of the pass."""
        decode = self._video.decode
        return Outcome(
            complete=decode.complete,
            frames=self.frames,
            wall_s=wall_s,
            notes=tuple(decode.messages),
            summaries=self._summaries,
        )

    def sidecar(self, outcome: Outcome) -> dict[str, Any]:
        """Return the content of the sidecar."""
        settings, facts, decode = self._task.settings, self._video.facts, self._video.decode
        working = self._video.working
        rate = facts.frame_rate
        groups = {
            **settings.groups,
            "opplod": settings.opplod.resolved(working.height),
        }
        return {
            "tool": environment(),
            "command": list(self._task.command),
            "preset": settings.preset,
            "models": list(settings.models),
            "parameters": {name: params.as_dict() for name, params in groups.items()},
            "input": facts.as_dict(),
            "span": asdict(self._task.span),
            "working": {
                "width": working.width,
                "height": working.height,
                "source_px_per_px_x": working.scale_x,
                "source_px_per_px_y": working.scale_y,
                "source_px_per_s_at_1_px_per_frame": (
                    working.scale_x * float(rate) if rate else None
                ),
            },
            "decode": {
                "declared": facts.frames_declared,
                "decoded": decode.decoded,
                "analysed": self.frames,
                "failures": decode.failures,
                "corrupt": decode.corrupt,
                "missing": decode.missing,
                "repeats": self._repeats,
                "complete": decode.complete,
                "messages": decode.messages,
            },
            "threads": {"decoder": decode.threads, "models": cv2.getNumThreads()},
            "stimulus": _ground_truth(Path(self._task.name)),
            "wall_s": round(outcome.wall_s, 3),
            "frames_per_s": round(self.frames / outcome.wall_s, 1) if outcome.wall_s else None,
            "summary": {name: summary.as_dict() for name, summary in self._summaries.items()},
        }


def _ground_truth(video: Path) -> dict[str, Any] | None:
    """Return what the ground truth beside a stimulus's video says; None if there is none."""
    path = video.with_name(f"{video.stem}.stimulus.json")
    if not os.path.lexists(path):  # which says no to a name too long to look up
        return None
    from oppload_cli.stimulus.truth import read_ground_truth  # noqa: PLC0415 - few inputs have it

    try:
        truth = read_ground_truth(path)
    except OpploadError as error:
        return {"path": str(path), "error": str(error)}
    kept = ("name", "looming", "contact_time_s", "display")
    return {"path": str(path), **{key: truth[key] for key in kept}}
