from __future__ import annotations

from dataclasses import asdict

from oppload_cli import DetectorRecord, DlgmdResponse, FrameRecord
from oppload_cli.detection.places import Detection
from oppload_cli.models.detector import Box, Response
from oppload_cli.results.table import ModelSummary


def record(frame: int, response: float | None, alarm: bool = False) -> FrameRecord:
    answer = None if response is None else DlgmdResponse(response, s=response)
    return FrameRecord(frame, frame / 10, 0.0, {"dlgmd": DetectorRecord(answer, alarm)})


def test_summary_of_a_run() -> None:
    summary = ModelSummary()
    responses = [None, 0.0, 0.5, 2.0, 2.0, 1.0]
    for frame, response in enumerate(responses):
        summary.add(record(frame, response, alarm=frame in (3, 4)), "dlgmd")
    assert asdict(summary) == {
        "frames": 5,
        "peak": 2.0,
        "peak_frame": 3,
        "peak_time_s": 0.3,
        "first_response_frame": 2,
        "first_response_time_s": 0.2,
        "first_alarm_frame": 3,
        "first_alarm_time_s": 0.3,
        "alarm_frames": 2,
    }


def test_summary_of_nothing() -> None:
    summary = ModelSummary()
    summary.add(record(0, None), "dlgmd")
    assert (summary.frames, summary.peak, summary.first_alarm_frame) == (0, None, None)


def test_a_row_has_the_box_of_the_object_and_the_centre_of_the_unit() -> None:
    place = Detection(1, Box(10, 20, 30, 40), 25.0, 40.0, 0.5, False, None)
    unit = Response(0.5, Box(100, 200, 8, 4))
    row = FrameRecord(
        7, 0.7, 0.1, {"opplod": DetectorRecord(unit, True, 0.25, 5.0, (place,))}
    ).values()
    names = ("x", "y", "width", "height", "unit_x", "unit_y")
    assert [row[f"opplod_{name}"] for name in names] == [10, 20, 30, 40, 104, 202]
    assert (row["opplod_response"], row["opplod_over_threshold"]) == (0.5, 2)
    assert (row["opplod_alarm"], row["opplod_evidence_over_threshold"]) == (True, 20)
