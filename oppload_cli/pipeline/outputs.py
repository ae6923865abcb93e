"""The result files of one input: their names, and how they are written together."""

from __future__ import annotations

import os.path
from dataclasses import dataclass, fields
from enum import StrEnum
from typing import TYPE_CHECKING, Any

from oppload_cli.errors import BusyError, OutputError
from oppload_cli.files.atomic import PartFile, output_errors, part_of
from oppload_cli.files.tables import Table
from oppload_cli.models.registry import placing_detector
from oppload_cli.results.table import DetectionsFile, write_sidecar
from oppload_cli.video.inputs import ANNOTATED

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from oppload_cli.annotation.video import AnnotatedVideo
    from oppload_cli.results.table import FrameRecord
    from oppload_cli.video.frames import FrameSource
    from oppload_cli.video.source import Video


class IfExists(StrEnum):
    """The ways to deal with a result that exists already."""

    ERROR = "error"
    SKIP = "skip"
    OVERWRITE = "overwrite"


@dataclass(frozen=True)
class Outputs:
    """The result files of one input; a file that is None is not written.

    Attributes
    ----------
    csv : Path
        ``{stem}.frames.csv``, the sign of a finished result: it gets its name last.
    sidecar : Path or None
        ``{stem}.oppload.json``.
    detections : Path or None
        ``{stem}.detections.jsonl``.
    annotated : Path or None
        ``{stem}.annotated.mp4``.
    """

    csv: Path
    sidecar: Path | None = None
    detections: Path | None = None
    annotated: Path | None = None

    @classmethod
    def of(
        cls, folder: Path, stem: str, models: Sequence[str], *, annotate: bool = False
    ) -> Outputs:
        """Return all files of a run.

        Parameters
        ----------
        folder : Path
            Their folder.
        stem : str
            The beginning of their names.
        models : sequence of str
            The detectors of the run; those that have places give detections.
        annotate : bool
            Whether an annotated video is written.
        """
        return cls(
            folder / f"{stem}.frames.csv",
            folder / f"{stem}.oppload.json",
            folder / f"{stem}.detections.jsonl" if placing_detector(models) else None,
            folder / f"{stem}{ANNOTATED}" if annotate else None,
        )

    def paths(self) -> list[Path]:
        """Return the files, the table first."""
        named = (getattr(self, each.name) for each in fields(self))
        return [path for path in named if path is not None]

    def absolute(self) -> Outputs:
        """Return the same files by absolute paths, for another process."""
        named = {each.name: getattr(self, each.name) for each in fields(self)}
        return Outputs(**{name: path and path.absolute() for name, path in named.items()})

    def kept(self, if_exists: IfExists) -> bool:
        """Tell whether the files exist and are kept.

        A result is complete when every file exists; a killed run may leave some of them.

        Raises
        ------
        OutputError
            If a file exists and `if_exists` is ``ERROR``.
        """
        results = self.paths()
        # False for a name that may not be looked up; writing the file gives the reason.
        existing = [path for path in results if os.path.lexists(path)]
        if if_exists is IfExists.ERROR:
            existing += [part_of(path) for path in results if os.path.lexists(part_of(path))]
            if existing:
                raise OutputError(
                    f"{existing[0]}: exists already; "
                    f"choose --if-exists overwrite or skip, or another --output"
                )
        return if_exists is IfExists.SKIP and len(existing) == len(results)


def begun(outputs: Outputs, if_exists: IfExists) -> PartFile | None:
    """Begin a result by its table: the run that holds the table writes all files.

    Parameters
    ----------
    outputs : Outputs
        The files.
    if_exists : IfExists
        What to do where a result exists.

    Returns
    -------
    PartFile or None
        The table; None if another run writes the result, or has just written it, and
        that is kept.

    Raises
    ------
    OutputError
        If it cannot be written, or another run is writing it.
    """
    try:
        table = PartFile(outputs.csv, new=if_exists is IfExists.ERROR)
    except BusyError:
        if if_exists is IfExists.SKIP:
            return None
        raise
    if if_exists is IfExists.SKIP and outputs.kept(if_exists):
        table.discard()
        return None
    return table


class Writing:
    """The files of one result while they are written, each as ``NAME.part``.

    Parameters
    ----------
    outputs : Outputs
        The files.
    table : PartFile
        From :func:`begun`.
    video : Video
        The input; opened with ``colour=True`` if an annotated video is written.
    columns, models : sequence of str
        The columns of the table, and the detectors whose responses it holds.
    boxes : str
        Objects with a box in an annotated video.

    Attributes
    ----------
    part : Path
        The table's name until `commit`.
    frames : FrameSource
        The frames for the detectors.

    Raises
    ------
    OutputError
        If a file cannot be written; also by `write` and `commit`.
    """

    def __init__(
        self,
        outputs: Outputs,
        table: PartFile,
        video: Video,
        columns: Sequence[str],
        models: Sequence[str],
        *,
        boxes: str = "alarm",
    ) -> None:
        self._outputs, self._file = outputs, table
        self.part = table.part
        self.frames: FrameSource = video
        self._beside: list[DetectionsFile | AnnotatedVideo] = []
        self._video: AnnotatedVideo | None = None
        try:
            with output_errors(outputs.csv):
                self._table = Table(table.stream, columns)
            if outputs.detections is not None:
                self._beside.append(DetectionsFile(outputs.detections))
            if outputs.annotated is not None:
                self._annotate(video, models, boxes)
        except BaseException:
            self.discard()
            raise

    def _annotate(self, video: Video, models: Sequence[str], boxes: str) -> None:
        from oppload_cli.annotation.video import AnnotatedVideo  # noqa: PLC0415 - an encoder

        path = self._outputs.annotated
        if path is not None:
            self._video = AnnotatedVideo(path, video, models, boxes)
            self._beside.append(self._video)
            self.frames = self._video.frames

    def write(self, record: FrameRecord) -> None:
        """Write the record of the next frame."""
        with output_errors(self._outputs.csv):
            self._table.write(record.values())
        for each in self._beside:
            each.write(record)

    def commit(self, content: Callable[[], dict[str, Any]]) -> None:
        """Give the files their names, the table last; `content` returns that of the sidecar."""
        if self._video is not None:
            self._video.finish()
        with output_errors(self._outputs.csv):
            self._file.stream.flush()
            # An old table must never lie beside new files, even after a crash.
            self._outputs.csv.unlink(missing_ok=True)
        if self._outputs.sidecar is not None:
            write_sidecar(self._outputs.sidecar, content())
        for each in self._beside:
            each.commit()
        self._file.commit()

    def keep(self) -> None:
        """Close the files, leaving them as ``NAME.part``."""
        self._file.keep()
        for each in self._beside:
            each.keep()

    def discard(self) -> None:
        """Remove the files and close them."""
        for each in self._beside:
            each.discard()
        self._file.discard()
