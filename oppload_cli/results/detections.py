"""Writing ``detections.jsonl``, a line per looming object and frame."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from oppload_cli.results.table import PartFile, formatted, naming

if TYPE_CHECKING:
    from pathlib import Path

    from oppload_cli.results.record import Detection, FrameRecord
    from oppload_cli.results.table import Value


class DetectionsFile(PartFile):
    """A file of one JSON object per line.

    Parameters
    ----------
    path : Path
        The final name.

    Raises
    ------
    OutputError
        If it cannot be written there.
    BusyError
        If another run is writing it.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        with naming(path):
            self.stream.flush()

    def write(self, record: FrameRecord) -> None:
        """Write a line per detection of a frame, at once.

        Parameters
        ----------
        record : FrameRecord
            The frame.

        Raises
        ------
        OutputError
            If it cannot be written.
        """
        if record.detections:
            with naming(self.path):
                self.stream.writelines(line_of(record, each) for each in record.detections)
                self.stream.flush()


def line_of(record: FrameRecord, detection: Detection) -> str:
    """Return a detection as its line, with the keys of ``docs/formats.md``.

    Parameters
    ----------
    record : FrameRecord
        The frame.
    detection : Detection
        The object.

    Returns
    -------
    str
        JSON and a line end; numbers as in ``frames.csv``.
    """
    values: dict[str, Value] = {
        "frame": record.frame,
        "time_s": record.time_s,
        "id": detection.identity,
        **detection.box._asdict(),
        "centre_x": detection.centre_x,
        "centre_y": detection.centre_y,
        "response": detection.response,
        "alarm": detection.alarm,
        "time_to_contact_s": detection.time_to_contact_s,
    }
    return "{" + ", ".join(f'"{name}": {_json(value)}' for name, value in values.items()) + "}\n"


def _json(value: Value) -> str:
    if value is None or not math.isfinite(value):  # JSON has no infinity
        return "null"
    return str(value).lower() if isinstance(value, bool) else formatted(value)
