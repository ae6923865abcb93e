"""Runs the analysis of one input and writes its result files."""

from __future__ import annotations

import os
import sys
import threading
import time
from contextlib import contextmanager, suppress
from copy import copy
from dataclasses import asdict
from typing import IO, TYPE_CHECKING, Any

import cv2

from oppload_cli.compute.loops import is_large
from oppload_cli.environment import environment
from oppload_cli.errors import (
    DetectorError,
    OpploadError,
    OutputError,
    ParameterError,
    ShortageError,
    SourceError,
    counted,
    reason_of,
    shortage,
    without_login,
)
from oppload_cli.files.atomic import cannot_write
from oppload_cli.files.tables import Table, rows_in
from oppload_cli.frames.repeats import Repeats
from oppload_cli.models.registry import detector_named, loaded
from oppload_cli.models.timebase import FRAME, REFERENCE_INTERVAL
from oppload_cli.pipeline.analysis import pass_params, side_by_side
from oppload_cli.pipeline.settings import ALL_COLUMNS
from oppload_cli.pipeline.task import Interrupted, Outcome, Task, Writing, exists_already
from oppload_cli.processes import cores
from oppload_cli.processes.signals import stop_if_asked, takes_a_line
from oppload_cli.results.alarm_log import AlarmLog
from oppload_cli.results.table import ModelSummary, columns_for
from oppload_cli.results.truths import facts_of_truth, read_truth
from oppload_cli.video.inputs import rate_beside, truth_beside
from oppload_cli.video.opening import Opening
from oppload_cli.video.optics import Optics
from oppload_cli.video.span import Span

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence
    from pathlib import Path

    from oppload_cli.pipeline.settings import Settings
    from oppload_cli.results.record import FrameRecord
    from oppload_cli.schema import Parameters
    from oppload_cli.video.frames import DecodedSource, FrameSource, InputFacts, WorkingSize
    from oppload_cli.video.source import Video


# Dropped frames give a remark if they are a larger share, and more than the burst of frames with
# which a network stream begins.
_FEW_DROPPED, _BURST = 0.05, 30
_CONTRADICTION = 0.01  # a larger relative difference of --fov from the ground truth gives a remark
_threads_lock = threading.Lock()
_threads_before: list[int] = []  # for each current run, OpenCV's threads before all of them


def run_task(
    task: Task,
    *,
    on_open: Callable[[Video], object] | None = None,
    on_frame: Callable[[FrameRecord], object] | None = None,
    opening: Opening | None = None,
) -> Outcome:
    """Analyse one input and write its results.

    `on_open` takes the open input, `on_frame` the record of each frame after it was written.
    `opening`, if given, opens the same input at the same height and span; this function closes it.
    Raises SourceError if nothing can be read (then nothing is written), OutputError if a result
    exists or cannot be written, and Interrupted if the user stops the run; then the rows so far
    stay as ``NAME.part``.
    """
    kept = exists_already(task)
    if kept is not None:
        return kept
    started = time.perf_counter()
    opening = opening or Opening(
        task.name,
        height=task.settings.pixels,
        others=task.settings.other_heights,
        span=task.span,
        reading=task.reading,
        threads=task.threads,
        colour=task.outputs is not None and task.outputs.annotated is not None,
    )
    with opening.result() as video, _threads(video.working, task.threads):
        if on_open:
            on_open(video)
        run = _Run(task, video, started, on_frame)
        if task.outputs is None:
            _write_stream(run)
        else:
            table = task.outputs.begin(task.if_exists)
            if table is None:
                return exists_already(task) or Outcome(skipped=True)
            models = task.settings.models
            writing = Writing(task.outputs, table, video, run.columns, models, boxes=task.boxes)
            _write_files(run, writing, task.outputs.csv)
        return run.outcome()


def analyse_source(
    source: DecodedSource,
    settings: Settings,
    keep: Callable[[FrameRecord], object],
    stimulus: dict[str, Any] | None,
) -> tuple[list[str], dict[str, Any]]:
    """Analyse an open source without writing files; the source is not closed.

    The function calls `keep` with the record of each frame. It returns the columns of the table and
    the content of the sidecar that ``oppload run`` would write. `stimulus` is the ground truth of
    the source, if it has one, for the sidecar.
    """
    task = Task(source.facts.name, settings)
    run = _Run(task, source, time.perf_counter(), stimulus=stimulus)
    with _threads(source.working, 0):
        run.analyse(source, keep)
    return run.columns, run.sidecar()


@contextmanager
def _threads(working: WorkingSize, threads: int) -> Iterator[None]:
    """Set OpenCV's number of threads for the time of a run.

    The number is that of the whole process. So the last of several runs at the same time sets it
    back for the caller's own program.
    """
    with _threads_lock:
        _threads_before.append(_threads_before[-1] if _threads_before else cv2.getNumThreads())
        # On small frames OpenCV's threads would wait longer for each other than they work.
        cv2.setNumThreads((threads or cores()) if is_large(working.shape) else 1)
    try:
        yield
    finally:
        with _threads_lock:
            before = _threads_before.pop()
            if not _threads_before:
                cv2.setNumThreads(before)


def _write_files(run: _Run, writing: Writing, csv: Path) -> None:
    """Write the files while frames come, and give them their final names at the end.

    A live input ends when the user stops the run; its files are finished then too.
    """
    try:
        run.analyse(writing.frames, writing.write)
        writing.commit(run.sidecar)
    except BaseException as error:
        if _is_bug(error):
            writing.discard()  # part files would block the next run, and no message names them
            raise
        if run.frames == 0:
            writing.discard()
            kept = ""
        elif isinstance(error, KeyboardInterrupt) and run.video.facts.live:
            writing.commit(run.sidecar)
            raise Interrupted(_rows_kept("all", csv), run.outcome()) from error
        else:
            writing.keep()
            kept = _rows_kept("the first", writing.part)
        explained = _explained(error, csv, kept)
        if explained is None:
            raise
        raise explained from error


def _rows_kept(which: str, table: Path) -> str:
    """Return a text with the number of rows in a table; empty if the table no longer exists."""
    with suppress(OSError):
        rows = rows_in(table)
        return f"{which} {rows} rows are in {table}" if rows != 1 else f"one row is in {table}"
    return ""


def _is_bug(error: BaseException) -> bool:
    """Return whether an error is a bug of oppload or of the user's own detector."""
    if isinstance(error, DetectorError):
        return True
    known = isinstance(error, OpploadError | OSError) or shortage(error)
    return isinstance(error, Exception) and not known


def _explained(error: BaseException, path: Path, kept: str) -> BaseException | None:
    """Return an error whose message also says which rows are kept; None for other errors."""
    if isinstance(error, KeyboardInterrupt):
        return Interrupted(kept)
    kept = kept and f"; {kept}"
    if isinstance(error, OSError):
        error = cannot_write(path, error)
    if isinstance(error, OpploadError):
        return type(error)(f"{error}{kept}")
    short = shortage(error)
    return ShortageError(f"{path}: cannot be finished, because {short}{kept}") if short else None


def _write_stream(run: _Run) -> None:
    stream: IO[str] | None = sys.stdout
    if stream is None:  # Python's value of a closed standard output: "oppload ... >&-"
        raise OutputError("standard output: is closed; open it, or give a folder with --output")
    if sys.platform != "win32":
        # If the reader is slow, Python drops rows in silence where writing does not wait.
        with suppress(OSError):  # a stream of a test is no file of the system
            os.set_blocking(stream.fileno(), True)

    def wait() -> None:
        while not takes_a_line(stream):
            stop_if_asked()

    def write(record: FrameRecord) -> None:
        wait()
        table.write(record.values())

    try:
        wait()
        table = Table(stream, run.columns, at_once=True)
        run.analyse(run.video, write)
    except KeyboardInterrupt as error:
        if not (run.frames and run.video.facts.live):
            raise
        raise Interrupted(outcome=run.outcome()) from error
    except BrokenPipeError:
        raise  # the program that reads the pipe has ended, which is no error
    except OSError as error:
        raise OutputError(
            f"standard output: cannot be written ({reason_of(error)}); check the place it goes to"
        ) from error


class _Run:
    """The state of one pass over a video; `started` is the time of `perf_counter` at its start."""

    def __init__(
        self,
        task: Task,
        video: DecodedSource,
        started: float,
        on_frame: Callable[[FrameRecord], object] | None = None,
        stimulus: dict[str, Any] | None = None,
    ) -> None:
        self._task = task
        self.video = video
        self._started = started
        self._on_frame = on_frame
        self._summaries = {name: ModelSummary() for name in task.settings.models}
        self._alarms = {name: AlarmLog(name) for name in task.settings.with_alarm}
        self._repeats = Repeats(task.settings.repeats)
        self._stimulus = stimulus or _ground_truth(task.name, video.facts)
        self._display = _stimulus_optics(video.facts, self._stimulus)
        # No video file states the field of view. Focal lengths in image files are those of the
        # uncropped sensor, and videos seldom use the complete sensor.
        self._optics, fov = self._display, task.settings.fov
        if fov is not None:
            self._optics = Optics.of_fov(video.facts.width, video.facts.height, fov)
        self._settings = task.settings.seen_through(self._optics, video.working)
        self.frames = 0
        self._decode = video.decode

    @property
    def columns(self) -> list[str]:
        settings = self._settings
        columns = columns_for(
            settings.models,
            rmo=settings.measure_rmo,
            details=settings.columns == ALL_COLUMNS,
            degrees=self._optics is not None,
        )
        return [column.name for column in columns]

    def analyse(self, frames: FrameSource, write: Callable[[FrameRecord], object]) -> None:
        settings = self._settings
        chosen = pass_params(
            settings.model_params(),
            alarm=settings.alarm,
            places=settings.places,
            rmo=settings.rmo,
            repeats=self._repeats,
            time=settings.time,
        )
        try:
            for (record,) in side_by_side(frames, [chosen], self._optics):
                write(record)
                self.frames += 1
                for name, summary in self._summaries.items():
                    summary.add(record, name)
                for log in self._alarms.values():
                    log.add(record)
                if self._on_frame:
                    self._on_frame(record)
        finally:  # if the user stops a live input, a thread still decodes and counts
            self._decode = copy(self.video.decode)
        if self.frames == 0 and self._task.span != Span():
            count, rate = self._decode.decoded, self.video.facts.frame_rate
            count = max(count, self.video.facts.frames_declared or 0)
            seconds = f"{float(count / rate):.2f} s, " if rate else ""
            raise ParameterError(
                f"{self._task.name}: has no frame in the part that --start, --end and --duration "
                f"leave; it has {seconds}{counted(count, 'frame')}"
            )
        if self.frames == 0 and self._decode.decoded:
            raise SourceError(
                f"{self._task.name}: has no frame left in its span; open it again, or with another "
                "span"
            )

    @property
    def _wall_s(self) -> float:
        return time.perf_counter() - self._started

    def outcome(self) -> Outcome:
        decode = self._decode
        return Outcome(
            complete=decode.complete,
            frames=self.frames,
            wall_s=self._wall_s,
            notes=tuple(decode.messages),
            remarks=self._remarks(),
            summaries=self._summaries,
            verdicts=tuple(alarm.verdict for alarm in self._alarms.values()),
        )

    def _remarks_on_rate(self) -> Iterator[str]:
        facts, images = self.video.facts, self.video.facts.kind == "images"
        true_rate = "--true-rate (in Python true_rate)"
        if facts.rate_assumed:
            option = "--image-rate (in Python rate)" if images else true_rate
            verb = "images carry" if images else "the stream carries"
            yield (
                f"{facts.frame_rate} frames/s are assumed, as {verb} no times; {option} states "
                "another rate"
            )
        elif self._task.reading.image_rate and not images:
            yield (
                "has times or a rate of its own: --image-rate has no effect on it; for slow motion "
                "give --true-rate"
            )
        elif facts.kind == "array" and facts.frame_rate and facts.frame_rate < 1:
            yield (
                f"frames are {float(1 / facts.frame_rate):.3g} s apart; if that is wrong, give the "
                "rate in frames per second, or the times in seconds"
            )
        if facts.rate_in_file is not None and facts.frame_rate is not None:
            yield (
                f"{true_rate} is {facts.frame_rate} frames/s, and the rate of the file "
                f"{facts.rate_in_file}: all times are those of the file divided by "
                f"{float(facts.frame_rate / facts.rate_in_file):.4g}"
            )
        stated = images or facts.rate_in_file is not None
        if stated and (rate := rate_beside(self._task.name)) not in {None, facts.frame_rate}:
            yield (
                f"the rate given is {facts.frame_rate} frames/s, but that of the ground truth "
                f"{rate}; the given one is used, so that the times of the ground truth do not fit"
            )

    def _remarks(self) -> tuple[str, ...]:
        facts = self.video.facts
        remarks = self.video.times.remarks()
        remarks += self._remarks_on_rate()
        # Frames before --start, and those that wait when the user stops the run, do not count.
        dropped, wanted = self._decode.dropped, self._decode.dropped + self.frames
        if dropped > max(_FEW_DROPPED * wanted, _BURST):
            remarks.append(
                f"{dropped} of {wanted} frames were dropped, because they came faster than they "
                f"were analysed; choose fewer models, a smaller height, no RMO (--no-rmo), or "
                "a camera with fewer frames per second"
            )
        if facts.video_streams > 1:
            remarks.append(
                f"stream {facts.video_stream} of {facts.video_streams} video streams, "
                f"{facts.width} x {facts.height}, is analysed; --stream (in Python stream) chooses "
                "another"
            )
        if self._stimulus and "error" in self._stimulus:
            remarks.append(f"its ground truth is left out ({self._stimulus['error']})")
        fov, aspect = self._task.settings.fov, facts.pixel_aspect
        if fov is not None and self._display:
            true_fov = self._display.degrees(facts.width)
            if abs(fov / true_fov - 1) > _CONTRADICTION:
                remarks.append(
                    f"the field of view given is {fov:.4g} degrees, but that of the ground truth "
                    f"{true_fov:.4g}; the given one is used"
                )
        if fov is not None and aspect and aspect != 1:
            remarks.append(
                f"has pixels of an aspect of {float(aspect):.4g}, but the field of view is meant "
                "for square pixels: vertical angles are wrong"
            )
        remarks += self._repeats.remarks()
        remarks += self.video.working.remarks()
        silent = [name for name, summary in self._summaries.items() if not summary.frames]
        if self.frames and silent:
            remarks.append(self._never_responded(silent))
        seconds, alarm = self.video.times.seconds, self._settings.alarm
        rules = [alarm.rule_of(name) for name in self._settings.models]
        begins_blind = any(rule.floor is not None for rule in rules) and alarm.cut_ratio > 0
        if self.frames and begins_blind and seconds < alarm.blind_s:
            remarks.append(
                f"lasts {seconds:.2f} s: too short for an alarm, as the first "
                f"{alarm.blind_s:.3g} s never count"
            )
        return tuple(remarks)

    def _never_responded(self, silent: Sequence[str]) -> str:
        labels = [detector_named(name).label for name in silent]
        longest = max(detector_named(name).warm_up for name in silent)
        interval = self._settings.time.interval or detector_named(silent[0]).interval
        warm_up = counted(longest, "frame" if interval == FRAME else "interval")
        warm_up += "" if interval == FRAME else f" of {interval} s"
        return (
            f"has no response of {', '.join(labels)} to any frame, so that nothing could cause an "
            f"alarm: it ends within the warm-up of {warm_up}; give a longer video"
            + ("" if interval in {FRAME, REFERENCE_INTERVAL} else ", or a shorter time.interval")
        )

    def _field_of_view(self, groups: Mapping[str, Parameters]) -> dict[str, Any] | None:
        if self._optics is None:
            return None
        working, optics = self.video.working, self._optics
        height = min(working.shape)

        def degrees(group: str, size: float) -> float:
            own = self._settings.height_of(group, height)
            return optics.degrees(size * height / own * working.scale_y)

        sizes = {
            f"{group}.{declared.name}": degrees(group, size)
            for group in self._settings.models
            for declared in groups[group].declared()
            if declared.unit == "px"
            and isinstance(size := getattr(groups[group], declared.name), int | float)
            and size
        }
        return {**self._optics.as_dict(), "sizes_deg": sizes}

    def sidecar(self) -> dict[str, Any]:
        """Return the content of the sidecar, with the keys of ``docs/formats.md``, for JSON."""
        task, settings, wall_s = self._task, self._settings, self._wall_s
        facts, decode, working = self.video.facts, self._decode, self.video.working
        rate = float(facts.frame_rate) if facts.frame_rate else None
        groups = settings.resolved(min(working.width, working.height))
        return {
            "tool": environment(),
            "command": [without_login(word) for word in task.command],
            "loaded": loaded(),
            "models": list(settings.models),
            "height": settings.height,
            "columns": settings.columns,
            "measure_rmo": settings.measure_rmo,
            "parameters": {name: params.as_dict() for name, params in groups.items()},
            "input": facts.as_dict(),
            "span": asdict(task.span),
            "settings_sha256": task.settings_sha256(),
            "working": {
                "width": working.width,
                "height": working.height,
                "source_px_per_px_x": working.scale_x,
                "source_px_per_px_y": working.scale_y,
                "source_px_per_s_at_1_px_per_frame": working.scale_x * rate if rate else None,
            },
            "field_of_view": self._field_of_view(groups),
            "decode": {
                "declared": facts.frames_declared,
                "decoded": decode.decoded,
                "analysed": self.frames,
                "failures": decode.failures,
                "corrupt": decode.corrupt,
                "missing": decode.missing,
                "dropped": decode.dropped,
                "repeats": self._repeats.exact,
                "near_repeats": self._repeats.near,
                "pictures_per_s": self._repeats.pictures_per_s,
                "complete": decode.complete,
                "messages": decode.messages,
            },
            "time": {**self.video.times.as_dict(), "smoothed_arrivals": decode.smoothed},
            "threads": {
                "decoder": decode.threads,
                "decoder_apart": decode.own_process,
                "models": cv2.getNumThreads(),
            },
            "remarks": list(self._remarks()),
            "stimulus": self._stimulus,
            "wall_s": round(wall_s, 3),
            "frames_per_s": round(self.frames / wall_s, 1) if wall_s else None,
            "summary": {name: asdict(summary) for name, summary in self._summaries.items()},
            "alarms": {name: alarm.verdict.as_dict() for name, alarm in self._alarms.items()},
        }


def _stimulus_optics(facts: InputFacts, stimulus: Mapping[str, Any] | None) -> Optics | None:
    """Return the optics of an input's ground truth; None if the input has none."""
    try:
        return Optics.of_display((stimulus or {})["display"], facts.width, facts.height)
    except (KeyError, TypeError, ValueError, ZeroDivisionError):
        return None


def _ground_truth(name: str, facts: InputFacts) -> dict[str, Any] | None:
    """Return the main facts of the ground truth beside the video of a stimulus, if it exists.

    If the ground truth is unusable, or belongs to another video, the result has an ``error``.
    """
    path = truth_beside(name)
    if not os.path.lexists(path):  # also False, without an error, if the name is too long
        return None
    try:
        truth = read_truth(path, facts.width, facts.height, facts.frames_declared)
    except OpploadError as error:
        return {"path": str(path), "error": str(error)}
    return facts_of_truth(path, truth)
