"""One input from its first frame to its result files."""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass, field
from fractions import Fraction
from importlib import import_module
from typing import IO, TYPE_CHECKING, Any, Protocol

from oppload_cli.environment import cores
from oppload_cli.errors import OpploadError, OutputError
from oppload_cli.outputs import IfExists
from oppload_cli.results.columns import columns_for
from oppload_cli.results.summary import ModelSummary
from oppload_cli.results.table import Table, cannot_write
from oppload_cli.video.opening import begin_opening
from oppload_cli.video.span import Span
from oppload_cli.writing import Writing, begun

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from oppload_cli.outputs import Outputs
    from oppload_cli.results.record import FrameRecord
    from oppload_cli.settings import Settings
    from oppload_cli.video.apart import DecodingProcess
    from oppload_cli.video.frames import FrameSource
    from oppload_cli.video.source import Video


@dataclass(frozen=True)
class Task:
    """What to do with one input.

    Attributes
    ----------
    name : str
        The input.
    settings : Settings
        How to analyse it.
    outputs : Outputs or None
        The files to write; None streams the CSV to standard output.
    span : Span
        The part of the input.
    image_rate : Fraction
        Frames per second of images.
    if_exists : IfExists
        What to do where one of them exists.
    command : sequence of str
        The command line, for the sidecar.
    threads : int
        Of the decoder, and of the models on large frames; 0 leaves the choice to them.
    """

    name: str
    settings: Settings
    outputs: Outputs | None = None
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


def run_task(
    task: Task, watcher: Watcher | None = None, apart: DecodingProcess | None = None
) -> Outcome:
    """Analyse one input and write its results.

    Parameters
    ----------
    task : Task
        What to do.
    watcher : Watcher, optional
        Told of each frame.
    apart : DecodingProcess, optional
        Decodes a video file beside this process, and is closed at the end; without it,
        and for other inputs, a thread does.

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
    opening = begin_opening(
        task.name,
        height=task.settings.height,
        span=task.span,
        image_rate=task.image_rate,
        threads=task.threads,
        colour=task.outputs is not None and task.outputs.annotated is not None,
        apart=apart,
    )
    import cv2  # noqa: PLC0415 - this and the models: loaded while the input is being opened

    from oppload_cli.models.crew import is_large  # noqa: PLC0415
    from oppload_cli.native.memory import keep_freed  # noqa: PLC0415

    keep_freed()
    cv2.setNumThreads(1)  # until the size of the frames is known
    import_module("oppload_cli.analysis")
    with opening.result() as video:
        # On small frames OpenCV's threads wait for each other longer than they work.
        cv2.setNumThreads((task.threads or cores()) if is_large(video.working.shape) else 1)
        if watcher:
            watcher.opened(video)
        run = _Run(task, video, watcher)
        if task.outputs is None:
            _write_stream(run, sys.stdout)
        else:
            table = begun(task.outputs, task.if_exists)
            if table is None:
                return Outcome(skipped=True)
            models = task.settings.models
            writing = Writing(task.outputs, table, video, run.columns, models)
            _write_files(run, writing, task.outputs.csv, started)
        return run.outcome(time.perf_counter() - started)


def exists_already(task: Task) -> bool:
    """Tell whether the results of a task are there and shall be kept.

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
    return task.outputs is not None and task.outputs.kept(task.if_exists)


def _write_files(run: _Run, writing: Writing, csv: Path, started: float) -> None:
    """Write the files as frames come, and give them their names in the end."""
    try:
        run.write(writing.frames, writing)
        writing.commit(lambda: run.sidecar(time.perf_counter() - started))
    except BaseException as error:
        if run.frames == 0:
            writing.discard()
            left = ""
        else:
            writing.keep()
            left = f"; the first {run.frames} rows are in {writing.part}"
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
        run.write(run.video, _Rows(stream, run.columns))
        stream.flush()
    except BrokenPipeError:
        raise  # the reader has gone: not an error of ours
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise OutputError(f"standard output: cannot be written ({reason}); free it") from error


class _Rows:
    """The rows alone, on standard output."""

    def __init__(self, stream: IO[str], columns: Sequence[str]) -> None:
        self._table = Table(stream, columns)

    def write(self, record: FrameRecord) -> None:
        self._table.write(record.values())


class _Run:
    """The state of one pass over a video."""

    def __init__(self, task: Task, video: Video, watcher: Watcher | None) -> None:
        self._task = task
        self.video = video
        self._watcher = watcher
        self._summaries = {name: ModelSummary() for name in task.settings.models}
        self._repeats = 0
        self.frames = 0

    @property
    def columns(self) -> list[str]:
        """Names of the table's columns."""
        settings = self._task.settings
        columns = columns_for(settings.models, rmo=settings.rmo is not None)
        return [column.name for column in columns]

    def write(self, frames: FrameSource, writing: Writing | _Rows) -> None:
        """Analyse every frame and write what is known of it."""
        from oppload_cli.analysis import analyse  # noqa: PLC0415 - see run_task

        settings = self._task.settings
        records = analyse(
            frames,
            settings.model_params(),
            alarm=settings.alarm,
            places=settings.places,
            rmo=settings.rmo,
            repeats=settings.repeats,
        )
        for record in records:
            writing.write(record)
            self.frames += 1
            self._repeats += record.repeat
            for name, summary in self._summaries.items():
                summary.add(record, name)
            if self._watcher:
                self._watcher.frame(record)

    def outcome(self, wall_s: float) -> Outcome:
        """Return what became of the pass."""
        decode = self.video.decode
        return Outcome(
            complete=decode.complete,
            frames=self.frames,
            wall_s=wall_s,
            notes=tuple(decode.messages),
            summaries=self._summaries,
        )

    def sidecar(self, wall_s: float) -> dict[str, Any]:
        """Return the content of the sidecar."""
        from oppload_cli.sidecar_content import sidecar_content  # noqa: PLC0415 - see run_task

        return sidecar_content(self._task, self.video, self.outcome(wall_s), self._repeats)
