"""The rows of NAME.frames.csv and NAME.detections.jsonl, and the file of the sidecar.

The module ``models.columns`` defines the columns of the table. ``pipeline.execute`` puts the
content of the sidecar together.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from oppload_cli.files.atomic import PartFile, output_errors, write_atomic
from oppload_cli.files.reading import reading, text_of
from oppload_cli.files.tables import Value, formatted, rows_in
from oppload_cli.models.columns import COMMON, RMO, USUAL, RecordColumn, columns_of
from oppload_cli.models.registry import detector_named

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from oppload_cli.detection.places import Detection
    from oppload_cli.errors import OpploadError
    from oppload_cli.results.record import FrameRecord


def columns_for(
    models: Sequence[str],
    *,
    rmo: bool,
    details: bool = False,
    degrees: bool = False,
) -> tuple[RecordColumn, ...]:
    """Return the columns of a result: those of all frames, of each detector, then of RMO.

    Parameters
    ----------
    models : sequence of str
        Names of the detectors.
    rmo : bool
        Whether radial motion opponency was measured.
    details : bool
        Whether to include the inner values of the detectors (``--columns all``).
    degrees : bool
        Whether to include the columns in degrees, which need a known field of view.
    """
    of_models = tuple(
        column
        for name in models
        for column in columns_of(detector_named(name), details=details, degrees=degrees)
    )
    common = tuple(column for column in COMMON if details or column.of == USUAL)
    return common + of_models + (RMO if rmo else ())


@dataclass
class ModelSummary:
    """Summary of one detector over one input.

    `frames` is the number of frames with a response, `alarm_frames` that of frames with the alarm
    on. `peak` is the largest response, and `first_response` the first one above 0. Each frame and
    time is None if there was no such response or alarm.
    """

    frames: int = 0
    peak: float | None = None
    peak_frame: int | None = None
    peak_time_s: float | None = None
    first_response_frame: int | None = None
    first_response_time_s: float | None = None
    first_alarm_frame: int | None = None
    first_alarm_time_s: float | None = None
    alarm_frames: int = 0

    def add(self, record: FrameRecord, model: str) -> None:
        """Take one frame's record; `model` is the detector that this summary describes."""
        response = record[model].response
        if response is None:
            return
        self.frames += 1
        if self.peak is None or response > self.peak:
            self.peak = response
            self.peak_frame, self.peak_time_s = record.frame, record.time_s
        if response > 0 and self.first_response_frame is None:
            self.first_response_frame, self.first_response_time_s = record.frame, record.time_s
        if record[model].alarm:
            self.alarm_frames += 1
            if self.first_alarm_frame is None:
                self.first_alarm_frame, self.first_alarm_time_s = record.frame, record.time_s


SCHEMA = "oppload.result/2"
# Ends of the names of a result's files, and of its page.
TABLE, DETECTIONS, SIDECAR = ".frames.csv", ".detections.jsonl", ".oppload.json"
PAGE = ".report.html"


def read_sidecar(path: Path, kind: type[OpploadError], remedy: str) -> dict[str, Any]:
    """Read a sidecar of schema `SCHEMA`.

    The function raises an error of class `kind` if the file cannot be read, is not JSON or has
    another schema. `remedy` tells the user what to do then, such as ``run its input again``.
    """
    with reading(path, kind, form="JSON", check="check its rights", repair=remedy):
        content = json.loads(text_of(path))
    if not isinstance(content, dict) or content.get("schema") != SCHEMA:
        raise kind(f"{path}: is not a sidecar of schema {SCHEMA}; {remedy}")
    return content


def fault_of_rows(table: Path, sidecar: Mapping[str, Any]) -> str:
    """Return a text if a table has more or fewer rows than its run wrote, else an empty text.

    A row without its line end was cut, and does not count. Raises OSError, KeyError or TypeError if
    the table cannot be read, or the sidecar lacks the number of rows.
    """
    rows, written = rows_in(table), sidecar["decode"]["analysed"]
    return "" if rows == written else f"holds {rows} complete rows, but its run wrote {written}"


def write_sidecar(target: Path | PartFile, content: dict[str, Any]) -> None:
    """Write `content` as JSON, with the schema of a result unless it has a schema.

    Raises OutputError if the file cannot be written.
    """
    text = json.dumps({"schema": SCHEMA, **content}, indent=2, allow_nan=False)
    write_atomic(target, text + "\n")


class DetectionsFile(PartFile):
    """The part file of ``detections.jsonl``."""

    def write(self, record: FrameRecord) -> None:
        """Write a line for each detection of a frame to the disk; raises OutputError."""
        if record.detections:
            with output_errors(self.path):
                values = (detection_values(record, detection) for detection in record.detections)
                self.stream.writelines(map(detection_line, values))
                self.stream.flush()


def detection_values(record: FrameRecord, detection: Detection) -> dict[str, Value]:
    """Return the values of a detection, with the keys of ``docs/formats.md``."""
    return {
        "frame": record.frame,
        "time_s": record.time_s,
        "id": detection.identity,
        **detection.box._asdict(),
        "centre_x": detection.centre_x,
        "centre_y": detection.centre_y,
        "response": detection.response,
        "alarm": detection.alarm,
        "time_to_contact_s": detection.time_to_contact_s,
        "time_to_contact_error_s": detection.time_to_contact_error_s,
        **(detection.view._asdict() if detection.view else {}),
    }


def detection_line(values: Mapping[str, Value]) -> str:
    """Return the line of a detection; numbers have the same format as in ``frames.csv``."""
    return "{" + ", ".join(f'"{name}": {_json(value)}' for name, value in values.items()) + "}\n"


def _json(value: Value) -> str:
    if value is None or not math.isfinite(value):
        return "null"
    return str(value).lower() if isinstance(value, bool) else formatted(value)
