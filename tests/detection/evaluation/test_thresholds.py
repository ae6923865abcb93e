from __future__ import annotations

import numpy as np
import pytest

from oppload_cli.detection.evaluation.alarms import at_rate, held_out, shipped
from oppload_cli.detection.evaluation.intervals import draws_of
from oppload_cli.detection.evaluation.thresholds import (
    Approaches,
    FalseAlarms,
    events,
    held_out_thresholds,
)
from tests.detection.evaluation.make import NAME, clip, peaks

# A minute of footage without an approach each, at 10 frames/s.
CALM = clip(peaks(603, {100: 5.0, 200: 3.0, 300: 1.0}), motion="still")
BUSY = clip(peaks(603, {100: 4.0, 105: 4.0, 200: 2.0}), motion="walking")
# Half a minute before onset, then an approach.
LOOM = clip(peaks(401, {50: 2.5, 390: 3.5, 395: 9.0}), 303, 400)
LATE = clip(peaks(401, {398: 1.5}), 303, 400)
CLIPS = [CALM, BUSY, LOOM, LATE]
ONCE = np.ones(len(CLIPS), np.int64)
DRAWS = draws_of([seen.label.looming for seen in CLIPS], 200)


@pytest.mark.parametrize(
    ("above", "expected"),
    [
        ([0, 0, 0, 0], []),
        ([1, 1, 0, 0], [0]),
        ([0, 1, 1, 1], [1]),
        ([0, 1] + [0] * 9 + [1], [1, 11]),
        ([0, 1] + [0] * 8 + [1, 1], [1]),
        # Without a second of silence it is one alarm, however long.
        ([0, 1, 0, 1] + [0] * 6 + [0, 1] + [0] * 9 + [1], [1, 21]),
    ],
)
def test_an_alarm_begins_after_a_second_of_silence(above: list[int], expected: list[int]) -> None:
    assert events(np.array(above, bool), np.arange(len(above)) / 10) == expected


def test_the_threshold_is_the_lowest_that_keeps_to_a_rate() -> None:
    alarms = FalseAlarms(CLIPS, NAME)
    assert alarms.minutes == pytest.approx([1, 1, 0.5, 0.5])
    # Three minutes: 5, 4 (twice within a second: one), 3, 2.5, 2 and 1 are the peaks.
    assert [alarms.threshold(ONCE, rate) for rate in (0, 0.34, 0.67, 1, 1.34, 1.7)] == [
        5, 4, 3, 2.5, 2, 1,
    ]  # fmt: skip
    assert alarms.false_alarms(2.5).tolist() == [2, 1, 0, 0]
    # Drawn twice, a clip counts twice: 5 and 3 are then four alarms in two minutes.
    assert alarms.threshold(np.array([2, 0, 0, 0]), 1) == 3


def test_a_response_that_stays_above_is_no_way_to_have_few_alarms() -> None:
    flickers = clip([0.0, 0, 0, *([2.0] + [1.0] * 70) * 3, 0.5, 0.5])
    alarms = FalseAlarms([flickers], NAME)
    assert alarms.thresholds.tolist() == [2, 1, 0.5]
    assert alarms.counts[0].tolist() == [0, 3, 1]
    assert alarms.threshold(np.array([1]), 3) == 2


def test_a_steady_response_is_one_alarm_from_its_start() -> None:
    steady = clip([0.0] * 3 + [1.0] * 600)
    alarms = FalseAlarms([steady, CALM], NAME)
    assert alarms.false_alarms(0.0).tolist() == [1, 3]


def test_detection_and_lead_at_a_threshold() -> None:
    approaches = Approaches(CLIPS, NAME)
    assert approaches.detected(3)[2:].tolist() == [1, 0]
    assert np.isnan(approaches.detected(3)[:2]).all()
    assert approaches.leads(3)[2] == pytest.approx(1.0)
    assert approaches.leads(3.5)[2] == pytest.approx(0.5)  # it must be above
    assert approaches.detected(9)[2:].tolist() == [0, 0]
    assert np.isnan(approaches.leads(9)).all()


def test_contact_and_onset_are_part_of_the_approach() -> None:
    ends = [clip(peaks(60, {at: 1.0}), 20, 40) for at in (19, 20, 40, 41)]
    assert Approaches(ends, NAME).detected(0.5).tolist() == [0, 1, 1, 0]
    assert Approaches(ends, NAME).leads(0.5)[1:3].tolist() == pytest.approx([2.0, 0.0])


def test_figures_at_a_rate() -> None:
    alarms, approaches = FalseAlarms(CLIPS, NAME), Approaches(CLIPS, NAME)
    found = at_rate(CLIPS, alarms, approaches, 1.0, DRAWS)
    values = {(measure, condition): (each, n) for measure, condition, each, n in found.estimates}
    assert values["detection_rate", "at 1 per minute"][0].value == 0.5
    assert values["detection_rate", "at 1 per minute"][1] == 2
    assert values["lead_time_s", "at 1 per minute"][0].value == pytest.approx(1.0)
    assert values["lead_time_s", "at 1 per minute"][1] == 1
    assert values["threshold", "at 1 per minute"][0].value == 2.5
    of_kind = {
        kind: values["false_alarms_per_minute", f"at 1 per minute{kind}"][0].value
        for kind in ("", ", still", ", walking", ", before an approach")
    }
    assert of_kind == pytest.approx(
        {"": 1, ", still": 2, ", walking": 1, ", before an approach": 0}
    )
    # Where one of the approaches is drawn twice all or none is detected.
    rate = values["detection_rate", "at 1 per minute"][0]
    assert (rate.low, rate.high) == (0, 1)


def test_held_out_thresholds_come_from_the_other_clips() -> None:
    alarms = FalseAlarms(CLIPS, NAME)
    # At most two alarms in the two minutes without CALM, which are 4 and 2.5.
    assert held_out_thresholds(alarms, 1.0).tolist() == [2, 2.5, 3, 3]
    found = held_out(CLIPS, NAME, alarms, 1.0, DRAWS)
    assert found.outcomes.false_alarms.tolist() == [2, 1, 0, 0]
    assert found.outcomes.detected[2:].tolist() == [1, 0]
    values = {measure: each.value for measure, _, each, _ in found.estimates}
    assert values["false_alarms_per_minute"] == pytest.approx(1)
    assert values["lead_time_s"] == pytest.approx(1.0)


def test_the_alarm_as_shipped() -> None:
    clips = [
        clip([0.0] * 603, alarm=[50, 51, 55, 500]),
        clip([0.0] * 401, 303, 400, alarm=[*range(300, 306)]),
        clip([0.0] * 401, 303, 400, alarm=[]),
        clip([0.0] * 401, 303, 400, alarm=[390]),
    ]
    (found,) = shipped(clips, NAME, draws_of([False, True, True, True], 100))
    # 55 is within a second of 50; the alarm that is on at onset began before it.
    assert found.outcomes.false_alarms.tolist() == [2, 1, 0, 0]
    assert found.outcomes.detected[1:].tolist() == [1, 0, 1]
    assert found.outcomes.lead_s[[1, 3]] == pytest.approx([9.7, 1.0])
    values = {measure: each.value for measure, _, each, _ in found.estimates}
    assert values["detection_rate"] == pytest.approx(2 / 3)
    assert values["lead_time_s"] == pytest.approx((9.7 + 1.0) / 2)
    assert list(shipped(CLIPS, NAME, DRAWS)) == []


def test_without_footage_or_approaches_nothing_is_claimed() -> None:
    at_once = clip(peaks(40, {30: 1.0}), 0, 39)
    alarms = FalseAlarms([at_once], NAME)
    assert np.isnan(alarms.threshold(np.array([1]), 1.0))
    found = at_rate([at_once], alarms, Approaches([at_once], NAME), 1.0, draws_of([True], 100))
    assert all(np.isnan(each.value) for _, _, each, _ in found.estimates)


def test_each_draw_chooses_its_own_threshold() -> None:
    # Only draws without the busy clip have a threshold that the approach is above.
    clips = [clip(peaks(603, {100: 5.0})), clip([0.0] * 603), clip(peaks(60, {40: 3.0}), 3, 50)]
    draws = draws_of([False, False, True], 400)
    alarms, approaches = FalseAlarms(clips, NAME), Approaches(clips, NAME)
    found = at_rate(clips, alarms, approaches, 0.4, draws)
    values = {measure: [*each] for measure, _, each, _ in found.estimates}
    assert values["detection_rate"] == [0, 0, 1]
    assert values["threshold"] == [5, 0, 5]
    # The outcomes held out are not chosen again.
    fixed = held_out(clips, NAME, alarms, 0.4, draws)
    kept = {measure: [*each] for measure, _, each, _ in fixed.estimates}
    assert kept["detection_rate"] == [0, 0, 0]
