from __future__ import annotations

import json
import math
from typing import TYPE_CHECKING

from oppload_cli.results.table import DetectionsFile, detection_line, detection_values
from tests.annotation.records import detection, record

if TYPE_CHECKING:
    from pathlib import Path


def test_a_line_is_json_with_the_keys_in_their_order() -> None:
    found = detection((10, 20.5, 1 / 3, 40), alarm=True, seconds=0.12345678912)
    assert detection_line(detection_values(record(7), found)) == (
        '{"frame": 7, "time_s": 0.233333333, "id": 3, "x": 10, "y": 20.5, "width": 0.333333333, '
        '"height": 40, "centre_x": 10.1666667, "centre_y": 40.5, "response": 0.25, '
        '"alarm": true, "time_to_contact_s": 0.123456789, "time_to_contact_error_s": null}\n'
    )


def test_unknown_values_are_null() -> None:
    found = detection((1, 2, 3, 4))._replace(response=1e-12, time_to_contact_s=math.inf)
    read = json.loads(detection_line(detection_values(record(0), found)))
    assert read["time_to_contact_s"] is None
    without = detection_values(record(0), detection((1, 2, 3, 4)))
    assert json.loads(detection_line(without))["time_to_contact_s"] is None
    assert read["alarm"] is False
    assert read["response"] == 1e-12


def test_lines_are_on_the_disk_at_once(tmp_path: Path) -> None:
    file = DetectionsFile(tmp_path / "a.detections.jsonl")
    part = tmp_path / "a.detections.jsonl.part"
    file.write(record(0))
    assert part.read_bytes() == b""
    two = (detection((1, 2, 3, 4)), detection((5, 6, 7, 8)))
    file.write(record(1, detections=two))
    lines = [json.loads(line) for line in part.read_text().splitlines()]
    assert [(line["frame"], line["x"]) for line in lines] == [(1, 1), (1, 5)]
    file.commit()
    assert [path.name for path in tmp_path.iterdir()] == ["a.detections.jsonl"]
    assert (tmp_path / "a.detections.jsonl").read_bytes().count(b"\r") == 0
