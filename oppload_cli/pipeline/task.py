"""A task (one input with its settings and result files), its outcome, and the writing of files."""

from __future__ import annotations

import hashlib
import json
import os
from contextlib import suppress
from dataclasses import asdict, dataclass, field, fields
from enum import StrEnum
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Any

from oppload_cli.errors import BusyError, OutputError, without_login
from oppload_cli.files.atomic import PartFile, output_errors, part_of
from oppload_cli.files.reading import reading
from oppload_cli.files.tables import Table
from oppload_cli.models.registry import known_names, loaded, needs_loading, placing_detector
from oppload_cli.results.alarm_log import in_words, verdicts_in
from oppload_cli.results.table import (
    DETECTIONS,
    SIDECAR,
    TABLE,
    DetectionsFile,
    fault_of_rows,
    read_sidecar,
    write_sidecar,
)
from oppload_cli.video.inputs import ANNOTATED, bytes_of, is_camera_or_stream
from oppload_cli.video.span import Reading, Span

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from oppload_cli.annotation.video import AnnotatedVideo
    from oppload_cli.pipeline.settings import Settings
    from oppload_cli.results.alarm_log import Verdict
    from oppload_cli.results.record import FrameRecord
    from oppload_cli.results.table import ModelSummary
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
        parts = [part_of(path) for path in (detections, annotated) if path not in self.paths()]
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
    reading: Reading = field(default_factory=Reading)  # what the user states about the input
    if_exists: IfExists = IfExists.ERROR
    command: Sequence[str] = ()  # the command line, for the sidecar
    threads: int = 0  # of the decoder, and of detectors on large frames; 0: automatic
    boxes: str = "alarm"  # objects whose boxes the annotated video shows: alarm, all or none
    stem: str = ""  # the beginning of the names of the result files

    def settings_sha256(self) -> str:
        """Return a checksum of all that decides about the result, by which a run knows it again.

        Of the input, only the size in bytes and the name without its folder count: a long video is
        not read for it, and may be moved.
        """
        settings, name = self.settings, without_login(self.name)
        # `origins` only tells where the settings come from.
        top = {setting.name: getattr(settings, setting.name) for setting in fields(settings)}
        del top["groups"], top["origins"]
        idle = set(known_names()) - set(settings.models)
        own = any(map(needs_loading, settings.models))
        content = {
            "settings": top,
            "groups": {
                group: values.as_dict()
                for group, values in settings.groups.items()
                if group not in idle
            },
            "span": asdict(self.span),
            "reading": self.reading,
            "loaded": sorted(file["sha256"] for file in loaded()) if own else [],
            "input": name if is_camera_or_stream(name) else PurePath(name).name,
            "bytes": bytes_of(self.name),
        }
        text = json.dumps(content, sort_keys=True, default=str)
        return hashlib.sha256(text.encode()).hexdigest()


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
    verdicts: tuple[Verdict, ...] = ()  # one for each detector that has an alarm, also if skipped

    @property
    def alarmed(self) -> bool:
        """Whether any detector had an alarm."""
        return any(verdict.alarms for verdict in self.verdicts)


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
    task keeps it, but the result belongs to another input or has other settings: all results in a
    folder must have the same settings.
    """
    if task.outputs is None or not task.outputs.kept(task.if_exists):
        return None
    table, path = task.outputs.csv, task.outputs.sidecar
    content = read_sidecar(path, OutputError, REMEDY)
    if content.get("settings_sha256") != task.settings_sha256():
        raise OutputError(f"{path}: is a result with other settings or of another input; {REMEDY}")
    try:
        outcome = Outcome(
            skipped=True,
            complete=bool(content["decode"]["complete"]),
            notes=tuple(content["decode"]["messages"]),
            remarks=tuple(content["remarks"]),
            verdicts=verdicts_in(content),
        )
        in_words(outcome.verdicts)  # raises an error if a value has a wrong type
        with reading(table, OutputError, check="check its rights", repair=REMEDY):
            fault = fault_of_rows(table, content)
    except (KeyError, TypeError, ValueError, AttributeError, ZeroDivisionError) as error:
        raise OutputError(f"{path}: is damaged; {REMEDY}") from error
    if fault:
        raise OutputError(f"{table}: {fault}; {REMEDY}")
    return outcome


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
        for file in self._other_files:
            file.write(record)

    def commit(self, content: Callable[[], dict[str, Any]]) -> None:
        """Give the files their final names, the table last; `content` gives the sidecar's data."""
        if self._video is not None:
            self._video.finish()
        self._outputs.remove_earlier()
        write_sidecar(self._outputs.sidecar, content())
        for file in self._other_files:
            file.commit()
        self._file.commit()

    def keep(self) -> None:
        """Close the files, leaving them as ``NAME.part``."""
        self._file.keep()
        for file in self._other_files:
            file.keep()

    def discard(self) -> None:
        """Remove the files and close them."""
        for file in self._other_files:
            file.discard()
        self._file.discard()
