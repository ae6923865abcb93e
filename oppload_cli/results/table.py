"""The rows of NAME.frames.csv and NAME.detections.jsonl, and the file of the sidecar.

The module ``models.columns`` defines the columns of the table. ``pipeline.execute`` puts the
content of the sidecar together.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from oppload_cli.errors import ParameterError, suggestion
from oppload_cli.files.atomic import PartFile, output_errors, write_atomic
from oppload_cli.files.reading import reading, text_of
from oppload_cli.files.tables import Cell, Seconds, Value, formatted, rows_in
from oppload_cli.models.columns import COMMON, COMMON_DETAILS, PLACE, RMO, VIEW, columns_of
from oppload_cli.models.registry import detector_named

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from oppload_cli.detection.places import Detection
    from oppload_cli.errors import OpploadError
    from oppload_cli.models.detector import Box, Column, Response
    from oppload_cli.motion.rmo import RmoMetrics


def columns_for(
    models: Sequence[str],
    *,
    rmo: bool,
    details: bool = False,
    degrees: bool = False,
) -> tuple[Column, ...]:
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
    return COMMON + (COMMON_DETAILS if details else ()) + of_models + (RMO if rmo else ())


@dataclass(frozen=True)
class FrameRecord:
    """One row of ``frames.csv``.

    Attributes
    ----------
    frame : int
        Number of the frame in the complete input, in the order of decoding, from 0.
    time_s : float
        Presentation time minus that of frame 0, in seconds.
    luma_change : float or None
        Mean of P; None for the first frame.
    responses : mapping of str to Response or None
        The response of each detector; None during warm-up. Boxes are in source pixels.
    alarms : dict of str to bool
        Whether the alarm of each detector is on; False during warm-up.
    rmo : RmoMetrics or None
        Radial motion opponency; None for the first frame, or if not measured.
    repeat : str
        ``exact`` or ``near`` for a frame that repeats the picture before it, else empty.
    thresholds : dict of str to float
        By detector, the threshold of its alarm in this frame.
    detections : tuple of Detection
        The looming objects that the first detector with places finds, the largest response first.
    objects : dict of str to Detection or None
        For each detector with places, its strongest looming object.
    blind : str
        Why the frame does not count for an alarm: ``start``, ``cut``, ``rest`` or ``gap`` (see
        ``docs/alarms.md``); empty if it counts.
    evidence : dict of str to float
        By detector, the number that its alarm compares with the threshold.

    Examples
    --------
    >>> import oppload_cli as oppload
    >>> first, *_, last = oppload.analyse("controls/looming-perspective", rmo=False)
    >>> first.values().keys() == last.values().keys()
    True
    >>> first.values()["opplod_response"] is None, last.alarms
    (True, {'opplod': True, 'dlgmd': True})
    """

    frame: int
    time_s: float
    luma_change: float | None
    responses: Mapping[str, Response | None]
    alarms: dict[str, bool] = field(default_factory=dict)
    rmo: RmoMetrics | None = None
    repeat: str = ""
    thresholds: dict[str, float] = field(default_factory=dict)
    detections: tuple[Detection, ...] = ()
    objects: dict[str, Detection | None] = field(default_factory=dict)
    blind: str = ""
    evidence: dict[str, float] = field(default_factory=dict)

    @property
    def boxes(self) -> dict[str, Box | None]:
        """For each detector with places, the box of its strongest object in source pixels."""
        return {
            name: None if detection is None else detection.box
            for name, detection in self.objects.items()
        }

    def over_threshold(self, model: str) -> float | None:
        """Return a detector's response divided by its threshold; None if it has no threshold.

        A detector that did not run is a ParameterError.
        """
        model = str(model)  # a caller may give a list or an array, in spite of the type
        if model not in self.responses:
            raise ParameterError(
                f"'{model}' has no response in this record{suggestion(model, self.responses)}"
            )
        response = self.responses[model]
        return self._multiple(model, None if response is None else response.response)

    def _multiple(self, model: str, value: float | None) -> float | None:
        """Return a value divided by a detector's threshold; None if one of them is missing."""
        threshold = self.thresholds.get(model, 0.0)
        return None if value is None or not 0 < threshold < math.inf else value / threshold

    def values(self) -> dict[str, Cell]:
        """Return the values by column; the columns are the same for every frame.

        A missing value is None: a response during warm-up, a box if nothing looms, RMO if it was
        not measured, degrees if the field of view is not known. An alarm is 0 or 1, as in the
        table.
        """
        values: dict[str, Cell] = {
            "frame": self.frame,
            "time_s": Seconds(self.time_s),
            "luma_change": self.luma_change,
            "blind": self.blind,
        }
        for name, response in self.responses.items():
            detector = detector_named(name)
            cells: dict[str, Cell] = {
                "response": None if response is None else response.response,
                "alarm": int(self.alarms.get(name, False)),
            }
            if detector.places:
                detection = self.objects.get(name)
                box = (None,) * 4 if detection is None else detection.box
                unit = None if response is None else response.box
                centre = (None,) * 2 if unit is None else unit.centre
                cells.update(zip((column.name for column in PLACE), (*box, *centre), strict=True))
                view = None if detection is None else detection.view
                cells.update((column.name, getattr(view, column.name, None)) for column in VIEW)
                cells["evidence_over_threshold"] = self._multiple(name, self.evidence.get(name))
                for key in ("time_to_contact_s", "time_to_contact_error_s"):
                    cells[key] = getattr(detection, key, None)
            cells["over_threshold"] = self.over_threshold(name)
            for column in (*detector.columns, *detector.details):
                cells[column.name] = getattr(response, column.name, None)
            values.update((f"{name}_{key}", value) for key, value in cells.items())
        values.update((column.name, getattr(self.rmo, column.name, None)) for column in RMO)
        return values


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
        response = record.responses[model]
        if response is None:
            return
        self.frames += 1
        if self.peak is None or response.response > self.peak:
            self.peak = response.response
            self.peak_frame, self.peak_time_s = record.frame, record.time_s
        if response.response > 0 and self.first_response_frame is None:
            self.first_response_frame, self.first_response_time_s = record.frame, record.time_s
        if record.alarms[model]:
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
