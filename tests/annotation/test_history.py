from __future__ import annotations

import pytest

from oppload_cli.annotation.history import History, Point, ratio_of
from tests.annotation.records import record

BOTH = ("opplod", "dlgmd")


def test_responses_are_held_against_their_thresholds() -> None:
    history = History(BOTH)
    history.add(record(0, {"opplod": 2.0, "dlgmd": None}, {"opplod": True}))
    assert list(history.points["opplod"]) == [Point(0.0, 2.0, True)]
    assert list(history.points["dlgmd"]) == [Point(0.0, None, False)]
    without = record(0, {"opplod": 2.0})
    without.thresholds["opplod"] = 0.0
    assert ratio_of(without, "opplod") is None
    without.thresholds.clear()
    assert ratio_of(without, "opplod") is None


def test_the_window_fills_and_then_moves() -> None:
    history = History(BOTH)
    starts = []
    for frame in range(301):
        history.add(record(frame))
        starts.append(history.start_s)
    assert starts[150] == 0
    assert starts[180] == pytest.approx(1)
    assert starts[300] == pytest.approx(5)
    # One frame from before the left edge, for the line that leads to it.
    assert history.points["opplod"][0].time_s == pytest.approx(149 / 30)
    assert len(history.points["opplod"]) == 152


def test_a_short_video_is_shown_as_a_whole() -> None:
    assert History(BOTH, 1.5).window_s == 1.5
    assert History(BOTH, 60).window_s == History(BOTH).window_s == 5
    assert History(BOTH, 0.001).window_s == 0.1


def test_a_video_that_begins_late_begins_at_the_left_edge() -> None:
    history = History(BOTH)
    history.add(record(90))
    assert history.start_s == 3


def test_copied_frames_are_passed_over_and_a_still_scene_is_not() -> None:
    history = History(("opplod",))
    for frame in range(12):
        history.add(record(frame, {"opplod": 0.0 if frame % 3 else 1.0}, repeat=bool(frame % 3)))
    assert [point.ratio for point in history.points["opplod"]] == [1, 1, 1, 1]
    for frame in range(12, 20):
        history.add(record(frame, {"opplod": 0.0}, repeat=True))
    assert [point.ratio for point in history.points["opplod"]][4:] == [0] * 5
