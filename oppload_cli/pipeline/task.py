"""A task (one input with its settings and result files), its outcome, and the writing of files."""

from __future__ import annotations

import filecmp
import json
import math
import os
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from enum import StrEnum
from fractions import Fraction
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Any

from oppload_cli.errors import BusyError, OutputError, without_login
from oppload_cli.files.atomic import PartFile, output_errors, part_of
from oppload_cli.files.reading import is_file, reading
from oppload_cli.files.tables import Table
from oppload_cli.models.presets import NATIVE
from oppload_cli.models.registry import known_names, loaded, needs_loading, placing_detector
from oppload_cli.results.alarms import in_words, verdicts_in
from oppload_cli.results.table import (
    DETECTIONS,
    SIDECAR,
    TABLE,
    DetectionsFile,
    fault_of_rows,
    read_sidecar,
    write_sidecar,
)
from oppload_cli.video.frames import USUAL_RATE, WorkingSize
from oppload_cli.video.inputs import ANNOTATED, bytes_of, rate_beside
from oppload_cli.video.optics import FOV, Optics
from oppload_cli.video.span import Span

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from oppload_cli.annotation.video import AnnotatedVideo
    from oppload_cli.pipeline.settings import Settings
    from oppload_cli.results.alarms import Verdict
    from oppload_cli.results.table import FrameRecord, ModelSummary
    from oppload_cli.video.frames import FrameSource
    from oppload_cli.video.source import Video

REMEDY = "choose --if-exists overwrite, or another --output"


class IfExists(StrEnum):
    """What to do if a result exists already."""

    ERROR = "error"
    SKIP = "skip"
    OVERWRITE = "overwrite"


@dataclass(frozen=True)
class Outputs:
    """The result files of one input; a file that is None is not written."""

    csv: Path  # gets its final name last: if this file exists, the result is complete
    sidecar: Path
    detections: Path | None = None
    annotated: Path | None = None

    @classmethod
    def of(
        cls, folder: Path, stem: str, models: Sequence[str], *, annotate: bool = False
    ) -> Outputs:
        """Return the result files of a run; their names begin with `stem`.

        `detections` is None unless one of the detectors in `models` has places.
        """
        return cls(
            folder / f"{stem}{TABLE}",
            folder / f"{stem}{SIDECAR}",
            folder / f"{stem}{DETECTIONS}" if placing_detector(models) else None,
            folder / f"{stem}{ANNOTATED}" if annotate else None,
        )

    def paths(self) -> list[Path]:
        """Return the files, the table first."""
        return [path for path in vars(self).values() if path is not None]

    def left_over(self) -> list[Path]:
        """Return the files that only an earlier run with other options may have left.

        They are part files, and the detections of a table that exists and will be replaced.
        """
        detections, annotated = self._beside(DETECTIONS), self._beside(ANNOTATED)
        parts = [part_of(each) for each in (detections, annotated) if each not in self.paths()]
        replaced = detections not in self.paths() and os.path.lexists(self.csv)
        return [*parts, *([detections] if replaced else [])]

    def remove_earlier(self) -> None:
        """Remove the table and the files of `left_over`, before new files get their names.

        An old table must never lie beside new files, even after a crash. Raises OutputError if the
        table cannot be removed.
        """
        left_over = self.left_over()
        with output_errors(self.csv):
            self.csv.unlink(missing_ok=True)
        for path in left_over:
            with suppress(OSError):  # something else may have this name
                path.unlink()

    def _beside(self, suffix: str) -> Path:
        return self.csv.with_name(f"{self.csv.name.removesuffix(TABLE)}{suffix}")

    def absolute(self) -> Outputs:
        """Return the same files by absolute paths, for another process."""
        return Outputs(**{name: path and path.absolute() for name, path in vars(self).items()})

    def kept(self, if_exists: IfExists) -> bool:
        """Return whether an existing result is kept: `if_exists` is ``SKIP`` and all files exist.

        A killed run may leave only some of the files. Raises OutputError if `if_exists` is
        ``ERROR`` and a file exists.
        """
        results = self.paths()
        # Without access to the folder `lexists` is False; the error comes when the run writes.
        existing = [path for path in results if os.path.lexists(path)]
        if if_exists is IfExists.ERROR:
            existing += [part_of(path) for path in results if os.path.lexists(part_of(path))]
            if existing:
                raise OutputError(
                    f"{existing[0]}: exists already; "
                    f"choose --if-exists overwrite or skip, or another --output"
                )
        return if_exists is IfExists.SKIP and len(existing) == len(results)

    def begin(self, if_exists: IfExists) -> PartFile | None:
        """Create and return the part file of the table; the run that has it may write all files.

        With ``SKIP``, returns None if another run is writing the result or has just written it.
        Raises OutputError if the file cannot be written, or another run is writing it.
        """
        try:
            table = PartFile(self.csv, new=if_exists is IfExists.ERROR)
        except BusyError:
            if if_exists is IfExists.SKIP:
                return None
            raise
        if if_exists is IfExists.SKIP and self.kept(if_exists):
            table.discard()
            return None
        return table


@dataclass(frozen=True)
class Task:
    """One input, how to analyse it, and where to write the results."""

    name: str  # the input
    settings: Settings
    outputs: Outputs | None = None  # None: the table goes to standard output
    span: Span = field(default_factory=Span)  # the part of the input
    image_rate: Fraction | None = None  # frames/s of images; None: of the ground truth, or 30
    true_rate: Fraction | None = None  # frames/s that the camera took; None: those of the file
    if_exists: IfExists = IfExists.ERROR
    command: Sequence[str] = ()  # the command line, for the sidecar
    threads: int = 0  # of the decoder, and of detectors on large frames; 0: automatic
    boxes: str = "alarm"  # objects whose boxes the annotated video shows: alarm, all or none
    stem: str = ""  # the beginning of the names of the result files


@dataclass(frozen=True)
class Outcome:
    """The outcome of a task."""

    skipped: bool = False  # whether the result existed already
    complete: bool = True  # every frame that the input declared was decoded
    frames: int = 0  # rows written
    wall_s: float = 0.0  # seconds from opening to the last row
    notes: tuple[str, ...] = ()  # faults of the input, a line each
    remarks: tuple[str, ...] = ()  # unusual properties that are no faults, a line each
    summaries: dict[str, ModelSummary] = field(default_factory=dict)  # empty if skipped
    verdicts: tuple[Verdict, ...] = ()  # one for each detector, also if skipped

    @property
    def alarmed(self) -> bool:
        """Whether any detector had an alarm."""
        return any(each.alarms for each in self.verdicts)


class Interrupted(KeyboardInterrupt):
    """Raised when the user stops a task; the message says which rows are kept.

    `outcome` is that of a live input, which usually ends so; None for other inputs.
    """

    def __init__(self, kept: str = "", outcome: Outcome | None = None) -> None:
        super().__init__(kept)
        self.outcome = outcome


# ---- Results that exist already ------------------------------------------------------------


def exists_already(task: Task) -> Outcome | None:
    """Return the outcome of an existing result that the task keeps; None if it keeps none.

    Raises OutputError if a result exists and the task neither keeps nor overwrites it, or if the
    task keeps it, but the result belongs to another input or has other settings.
    """
    if task.outputs is None or not task.outputs.kept(task.if_exists):
        return None
    table, path = task.outputs.csv, task.outputs.sidecar
    content = read_sidecar(path, OutputError, REMEDY)
    try:
        difference = next(_differences(task, content), None)
        outcome = Outcome(
            skipped=True,
            complete=bool(content["decode"]["complete"]),
            notes=tuple(content["decode"]["messages"]),
            remarks=tuple(content.get("remarks", ())),  # results before 1.0 lack them
            verdicts=verdicts_in(content),
        )
        in_words(outcome.verdicts)  # raises an error if a value has a wrong type
        with reading(table, OutputError, check="check its rights", repair=REMEDY):
            fault = fault_of_rows(table, content)
    except (KeyError, TypeError, ValueError, AttributeError, ZeroDivisionError) as error:
        raise OutputError(f"{path}: is damaged; {REMEDY}") from error
    if difference:  # all results in a folder must have the same settings
        raise OutputError(f"{path}: is a result {difference}; {REMEDY}")
    if fault:
        raise OutputError(f"{table}: {fault}; {REMEDY}")
    return outcome


def _differences(task: Task, content: dict[str, Any]) -> Iterator[str]:
    """Yield texts on how a result differs from the result that the task would make."""
    settings, facts = task.settings, content["input"]
    name, size = PurePath(without_login(task.name)).name, bytes_of(task.name)
    if name != PurePath(facts["name"]).name or _are_different_files(task.name, facts["name"]):
        yield f"of another input, {facts['name']}"
    if size is not None and facts.get("bytes") not in {None, size}:
        yield f"of an input of {facts['bytes']} bytes, not {size}"
    yield from _other_rate(task, facts)
    if list(settings.models) != content["models"]:
        yield f"of the models {', '.join(content['models'])}, not {', '.join(settings.models)}"
    yield from _other_files(settings, content)
    if settings.columns != content["columns"]:
        yield f"with --columns {content['columns']}, not {settings.columns}"
    if settings.height != content["height"]:
        yield f"at --height {content['height'] or NATIVE}, not {settings.height or NATIVE}"
    if settings.measure_rmo != content["measure_rmo"]:
        yield f"with{'' if content['measure_rmo'] else 'out'} radial motion opponency"
    if _through_json(asdict(task.span)) != content["span"]:
        yield "of another part of the input: see --start, --end and --duration"
    others = list(_other_parameters(settings, content))
    if others and settings.preset != content["preset"]:  # clearer than the name of a parameter
        yield f"of preset {content['preset']}, not {settings.preset}"
    yield from others


def _other_rate(task: Task, facts: dict[str, Any]) -> Iterator[str]:
    rate = facts["frame_rate"]
    if facts["kind"] == "images":
        wanted = task.image_rate or task.true_rate or rate_beside(task.name) or USUAL_RATE
        if Fraction(rate) != wanted:
            yield f"of images at {rate} frames/s; see --image-rate"
    elif task.true_rate != (Fraction(rate) if facts.get("rate_in_file") else None):
        yield f"at {rate} frames/s; see --true-rate"


def _are_different_files(name: str, other: str) -> bool:
    """Return whether two names are files with different content."""
    try:
        same = not is_file(other) or Path(name).samefile(other)
        return not (same or filecmp.cmp(name, other, shallow=False))
    except (OSError, ValueError):  # a camera, a stream, or a file that cannot be read
        return False


def _other_files(settings: Settings, content: dict[str, Any]) -> Iterator[str]:
    if any(map(needs_loading, settings.models)):
        files = content.get("loaded", ())  # results before 1.0 lack it
        if {each["sha256"] for each in files} != {each["sha256"] for each in loaded()}:
            yield "of detectors of your own whose files (--load) had another content"


def _other_parameters(settings: Settings, content: dict[str, Any]) -> Iterator[str]:
    facts, working, view = content["input"], content["working"], content["field_of_view"]
    if view:
        per_radian = math.degrees(view["px_per_degree_in_the_middle"])
        optics = Optics(facts["width"], facts["height"], per_radian, view["projection"])
        scale = working["source_px_per_px_x"], working["source_px_per_px_y"]
        size = WorkingSize(working["width"], working["height"], *scale)
        settings = settings.seen_through(optics, size)
    fov = _fov_text(view["horizontal_deg"] if view and view["origin"] == FOV else None)
    if fov != _fov_text(settings.fov):
        yield f"with {fov}, not {_fov_text(settings.fov)}"
    groups = (*settings.models, "alarm", "places", "repeats", "time")
    groups += ("rmo",) if settings.measure_rmo else ()
    resolved = settings.resolved(min(working["width"], working["height"]))
    # The floor of a detector that does not run has no effect on the result.
    idle = {f"{name}_floor" for name in known_names() if name not in settings.models}
    for group in groups:
        existing = content["parameters"].get(group, {})
        for name, value in _through_json(resolved[group].as_dict()).items():
            if name not in idle and existing.get(name) != value:
                yield f"with {group}.{name} = {existing.get(name)}, not {value}"


def _fov_text(degrees: float | None) -> str:
    """Return a field of view as a text, without the rounding errors of sines and tangents."""
    return "no --fov" if degrees is None else f"--fov {round(degrees, 9):.12g}"


def _through_json(value: Any) -> Any:
    """Return a value in the types that it has after it was written to JSON and read again."""
    return json.loads(json.dumps(value, default=str))


# ---- Writing -------------------------------------------------------------------------------


class Writing:
    """The files of one result while they are written, each as ``NAME.part``.

    `table` is the part file of :meth:`Outputs.begin`. For an annotated video, `video` must be
    opened with ``colour=True``. `boxes` is as in :class:`Task`. If a file cannot be written, this
    class, `write` and `commit` raise OutputError.

    Attributes
    ----------
    part : Path
        The path of the table until `commit`.
    frames : FrameSource
        The source from which the detectors take the frames of `video`.
    """

    def __init__(
        self,
        outputs: Outputs,
        table: PartFile,
        video: Video,
        columns: Sequence[str],
        models: Sequence[str],
        *,
        boxes: str,
    ) -> None:
        self._outputs, self._file = outputs, table
        self.part = table.part
        self.frames: FrameSource = video
        self._other_files: list[DetectionsFile | AnnotatedVideo] = []
        self._video: AnnotatedVideo | None = None
        try:
            with output_errors(outputs.csv):
                self._table = Table(table.stream, columns, at_once=True)
            if outputs.detections is not None:
                self._other_files.append(DetectionsFile(outputs.detections))
            if outputs.annotated is not None:
                from oppload_cli.annotation.video import AnnotatedVideo  # noqa: PLC0415 - an encoder

                self._video = AnnotatedVideo(outputs.annotated, video, models, boxes)
                self._other_files.append(self._video)
                self.frames = self._video.frames
        except BaseException:
            self.discard()
            raise

    def write(self, record: FrameRecord) -> None:
        """Write the record of the next frame."""
        with output_errors(self._outputs.csv):
            self._table.write(record.values())
        for each in self._other_files:
            each.write(record)

    def commit(self, content: Callable[[], dict[str, Any]]) -> None:
        """Give the files their final names, the table last; `content` gives the sidecar's data."""
        if self._video is not None:
            self._video.finish()
        self._outputs.remove_earlier()
        write_sidecar(self._outputs.sidecar, content())
        for each in self._other_files:
            each.commit()
        self._file.commit()

    def keep(self) -> None:
        """Close the files, leaving them as ``NAME.part``."""
        self._file.keep()
        for each in self._other_files:
            each.keep()

    def discard(self) -> None:
        """Remove the files and close them."""
        for each in self._other_files:
            each.discard()
        self._file.discard()
