"""Writing the result files of one input, all of them or none."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from oppload_cli.errors import BusyError
from oppload_cli.outputs import IfExists
from oppload_cli.results.detections import DetectionsFile
from oppload_cli.results.sidecar import write_sidecar
from oppload_cli.results.table import PartFile, Table, naming

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from oppload_cli.annotation.video import AnnotatedVideo
    from oppload_cli.outputs import Outputs
    from oppload_cli.results.record import FrameRecord
    from oppload_cli.video.frames import FrameSource
    from oppload_cli.video.source import Video


def begun(outputs: Outputs, if_exists: IfExists) -> PartFile | None:
    """Begin a result by its table: whoever has that writes all of its files.

    Parameters
    ----------
    outputs : Outputs
        The files.
    if_exists : IfExists
        What to do with what is there.

    Returns
    -------
    PartFile or None
        None if what another run does, or has just done, is kept.

    Raises
    ------
    OutputError
        If it cannot be written, or another run is writing it.
    """
    try:
        table = PartFile(outputs.csv)
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
        As :func:`begun` gives it.
    video : Video
        The input; opened with ``colour=True`` if there is an annotated video.
    columns, models : sequence of str
        Of the table, and whose responses it holds.

    Attributes
    ----------
    part : Path
        Where the rows are meanwhile.
    frames : FrameSource
        What the models shall take their frames from.

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
    ) -> None:
        self._outputs, self._file = outputs, table
        self.part = table.part
        self.frames: FrameSource = video
        self._beside: list[DetectionsFile | AnnotatedVideo] = []
        self._video: AnnotatedVideo | None = None
        try:
            with naming(outputs.csv):
                self._table = Table(table.stream, columns)
            if outputs.detections is not None:
                self._beside.append(DetectionsFile(outputs.detections))
            if outputs.annotated is not None:
                self._annotate(video, models)
        except BaseException:
            self.discard()
            raise

    def _annotate(self, video: Video, models: Sequence[str]) -> None:
        # Only here: nobody else needs the encoder.
        from oppload_cli.annotation.video import AnnotatedVideo  # noqa: PLC0415

        path = self._outputs.annotated
        if path is not None:
            # The table's name meanwhile is ours alone, and so is this one.
            suffix = self.part.name.removeprefix(self._outputs.csv.name)
            part = path.with_name(path.name + suffix)
            self._video = AnnotatedVideo(path, part, video, models)
            self._beside.append(self._video)
            self.frames = self._video.frames

    def write(self, record: FrameRecord) -> None:
        """Write what is known of the next frame.

        Parameters
        ----------
        record : FrameRecord
            The frame.
        """
        with naming(self._outputs.csv):
            self._table.write(record.values())
        for each in self._beside:
            each.write(record)

    def commit(self, content: Callable[[], dict[str, Any]]) -> None:
        """Give the files their names, the table last.

        Parameters
        ----------
        content : callable
            Returns the sidecar's content.
        """
        if self._video is not None:
            self._video.finish()
        with naming(self._outputs.csv):
            self._file.stream.flush()
            # An old table must never stand beside new files, however this ends.
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
