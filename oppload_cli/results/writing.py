"""The files beside the table: ``detections.jsonl`` and the sidecar ``oppload.json``."""

from __future__ import annotations

import json
import math
from typing import TYPE_CHECKING, Any

from oppload_cli.files.atomic import PartFile, output_errors, write_atomic
from oppload_cli.files.tables import formatted

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from oppload_cli.detection.places import Detection
    from oppload_cli.files.tables import Value
    from oppload_cli.results.table import FrameRecord


SCHEMA = "oppload.result/2"


def write_sidecar(path: Path, content: dict[str, Any]) -> None:
    """Write all that a reader needs to trust or repeat a result.

    Parameters
    ----------
    path : Path
        Its final name; the file appears complete or not at all.
    content : dict
        Ready for JSON; ``schema`` is added.

    Raises
    ------
    OutputError
        If it cannot be written.
    """
    text = json.dumps({"schema": SCHEMA, **content}, indent=2, allow_nan=False)
    write_atomic(path, text + "\n")


class DetectionsFile(PartFile):
    """A part file of one JSON object per line: a looming object in a frame."""

    def write(self, record: FrameRecord) -> None:
        """Write a line per detection of a frame, at once.

        Raises
        ------
        OutputError
            If it cannot be written.
        """
        if record.detections:
            with output_errors(self.path):
                values = (detection_values(record, each) for each in record.detections)
                self.stream.writelines(map(detection_line, values))
                self.stream.flush()


def detection_values(record: FrameRecord, detection: Detection) -> dict[str, Value]:
    """Return a detection by the keys of ``docs/formats.md``."""
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
        **(detection.view._asdict() if detection.view else {}),
    }


def detection_line(values: Mapping[str, Value]) -> str:
    """Return a detection as its line; numbers are formatted as in ``frames.csv``."""
    return "{" + ", ".join(f'"{name}": {_json(value)}' for name, value in values.items()) + "}\n"


def _json(value: Value) -> str:
    if value is None or not math.isfinite(value):  # JSON has no infinity
        return "null"
    return str(value).lower() if isinstance(value, bool) else formatted(value)
