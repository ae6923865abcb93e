from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import chdtri
from scipy.stats import binomtest

from oppload_cli.evaluation.metrics.alarms import Thresholds, shipped
from oppload_cli.evaluation.metrics.intervals import (
    draws_of,
    interval,
    rate_interval,
    share_interval,
    split_of,
)
from tests.evaluation.make import NAME, clip, peaks

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
    ("above", "alarms"),
    [
        ([0, 0, 0, 0], 0),
        ([1, 1, 0, 0], 1),
        ([0, 1, 1, 1], 1),
        ([0, 1] + [0] * 9 + [1], 2),
        ([0, 1] + [0] * 8 + [1, 1], 1),
        # Without a second of silence it is one alarm, however long.
        ([0, 1, 0, 1] + [0] * 6 + [0, 1] + [0] * 9 + [1], 2),
    ],
)
def test_an_alarm_begins_after_a_second_of_silence(above: list[int], alarms: int) -> None:
    seen = clip([0, 0, 0, *above], alarm=[3 + frame for frame, on in enumerate(above) if on])
    assert Thresholds([seen], NAME).outcomes(0.5).false_alarms.tolist() == [alarms]
    assert shipped([seen], NAME, draws_of([False], 1)).outcomes.false_alarms.tolist() == [alarms]


def test_an_alarm_at_one_frame_per_second_is_one_alarm_however_long() -> None:
    seen = clip([0.0] * 5 + [1.0] * 4 + [0.0, 1.0], rate=1, alarm=[5, 6, 7, 8, 10])
    thresholds = Thresholds([seen], NAME)
    assert thresholds.outcomes(0.5).false_alarms.tolist() == [2]
    assert thresholds.counts[0].tolist() == [0, 2]
    assert shipped([seen], NAME, draws_of([False], 1)).outcomes.false_alarms.tolist() == [2]


def test_the_alarms_at_all_levels_are_those_at_each_level_also_at_uneven_times() -> None:
    random = np.random.default_rng(4)
    even = clip([0.0, 0.0, 0.0, *np.round(9 * random.random(200))])
    steps_s = np.array([0.03, 0.3, 1.0, 1.2])
    time_s = np.cumsum(random.choice(steps_s, len(even), p=[0.5, 0.4, 0.05, 0.05]))
    walk = np.abs(np.cumsum(random.normal(size=100))).round(1).tolist()
    walks = [clip(walk, rate=rate) for rate in (1, 3, 30)]
    most = []
    for seen in (even, replace(even, time_s=time_s), *walks):
        thresholds = Thresholds([seen], NAME)
        in_clip = [thresholds.outcomes(level).false_alarms[0] for level in thresholds.levels]
        assert thresholds.counts[0].tolist() == in_clip
        most.append(max(in_clip))
    assert min(most[:2]) > 3


def test_the_threshold_is_the_lowest_that_keeps_to_a_rate() -> None:
    thresholds = Thresholds(CLIPS, NAME)
    assert thresholds.minutes == pytest.approx([1, 1, 0.5, 0.5])
    # Three minutes: 5, 4 (twice within a second: one), 3, 2.5, 2 and 1 are the peaks.
    assert [thresholds.lowest(ONCE, rate) for rate in (0, 0.34, 0.67, 1, 1.34, 1.7)] == [
        5, 4, 3, 2.5, 2, 1,
    ]  # fmt: skip
    assert thresholds.outcomes(2.5).false_alarms.tolist() == [2, 1, 0, 0]
    # Drawn twice, a clip counts twice: 5 and 3 are then four alarms in two minutes.
    assert thresholds.lowest(np.array([2, 0, 0, 0]), 1) == 3


def test_a_rate_that_is_kept_exactly_may_be_rounded() -> None:
    """One alarm in 0.3 + 0.35 + 0.35 minutes, whose sum is less than 1 by a rounding error."""
    clips = [clip(peaks(183, {20: 5.0})), clip([0.0] * 213), clip([0.0] * 213)]
    assert Thresholds(clips, NAME).lowest(np.ones(3, np.int64), 1.0) == 0


def test_a_low_threshold_that_merges_all_alarms_into_one_is_not_chosen() -> None:
    flickers = clip([0.0, 0, 0, *([2.0] + [1.0] * 70) * 3, 0.5, 0.5])
    thresholds = Thresholds([flickers], NAME)
    assert thresholds.levels.tolist() == [2, 1, 0.5]
    assert thresholds.counts[0].tolist() == [0, 3, 1]
    assert thresholds.lowest(np.array([1]), 3) == 2


def test_a_steady_response_is_one_alarm_from_its_start() -> None:
    steady = clip([0.0] * 3 + [1.0] * 600)
    thresholds = Thresholds([steady, CALM], NAME)
    assert thresholds.outcomes(0.0).false_alarms.tolist() == [1, 3]


def test_detection_and_lead_at_a_threshold() -> None:
    thresholds = Thresholds(CLIPS, NAME)
    assert thresholds.outcomes(3).detected[2:].tolist() == [1, 0]
    assert np.isnan(thresholds.outcomes(3).detected[:2]).all()
    assert thresholds.outcomes(3).lead_s[2] == pytest.approx(1.0)
    assert thresholds.outcomes(3.5).lead_s[2] == pytest.approx(0.5)  # it must be above
    assert thresholds.outcomes(9).detected[2:].tolist() == [0, 0]
    assert np.isnan(thresholds.outcomes(9).lead_s).all()


def test_a_later_approach_in_a_video_needs_an_alarm_of_its_own() -> None:
    """The alarm of the first one lasts through the second one, or ends in it at frame 42."""
    response = peaks(60, dict.fromkeys(range(25, 42), 2.0) | {45: 2.0, 50: 3.0})
    for contact, expected in ((41, np.nan), (50, 1)):
        first, second = clip(response, 20, 30), clip(response, 31, contact)
        second = replace(second, label=replace(second.label, since=31))
        thresholds = Thresholds([first, second], NAME)
        np.testing.assert_array_equal(thresholds.outcomes(1.9).detected, [1, expected])
    assert thresholds.outcomes(1.9).lead_s.tolist() == pytest.approx([0.5, 0.5])
    assert thresholds.outcomes(2.5).detected.tolist() == [0, 1]


def test_a_threshold_is_compared_with_the_evidence() -> None:
    response, evidence = peaks(401, {50: 2.5, 398: 1.5}), peaks(401, {50: 2.5, 397: 15.0})
    weak = clip(response, 303, 400)
    output = replace(weak.outputs[NAME], evidence=np.array(evidence))
    known = replace(weak, outputs={NAME: output})
    for seen, expected in ((weak, 0), (known, 1)):
        assert Thresholds([seen, CALM], NAME).outcomes(3).detected[0] == expected
        [outcome, _] = Thresholds([seen, CALM], NAME).held_out(1.0, DRAWS[:, :2]).outcomes.detected
        assert outcome == expected
    assert Thresholds([known], NAME).outcomes(3).lead_s.tolist() == pytest.approx([0.3])
    assert Thresholds([known], NAME).levels.tolist() == [2.5, 0]


def test_a_frame_without_evidence_hides_none_of_the_approach() -> None:
    gap = [0.0] * 25 + [np.nan] * 3 + [0.0] * 7 + [2.0] * 10
    looming = clip(gap, 20, 44)
    assert Thresholds([looming], NAME).outcomes(1.0).detected.tolist() == [1]
    assert Thresholds([looming], NAME).outcomes(1.0).lead_s.tolist() == pytest.approx([0.9])


def test_contact_and_onset_are_part_of_the_approach() -> None:
    ends = [clip(peaks(60, {at: 1.0}), 20, 40) for at in (19, 20, 40, 41)]
    assert Thresholds(ends, NAME).outcomes(0.5).detected.tolist() == [0, 1, 1, 0]
    assert Thresholds(ends, NAME).outcomes(0.5).lead_s[1:3].tolist() == pytest.approx([2.0, 0.0])


def test_figures_at_a_rate() -> None:
    found = Thresholds(CLIPS, NAME).at_rate(1.0, DRAWS)
    values = {
        (measurement.measure, measurement.condition): measurement
        for measurement in found.measurements
    }
    assert values["detection_rate", "at 1 per minute"].value == 0.5
    assert values["detection_rate", "at 1 per minute"].n == 2
    assert values["lead_time_s", "at 1 per minute"].value == pytest.approx(1.0)
    assert values["lead_time_s", "at 1 per minute"].n == 1
    assert values["threshold", "at 1 per minute"].value == 2.5
    of_kind = {
        kind: values["false_alarms_per_minute", f"at 1 per minute{kind}"].value
        for kind in ("", ", still", ", walking", ", before an approach")
    }
    assert of_kind == pytest.approx(
        {"": 1, ", still": 2, ", walking": 1, ", before an approach": 0}
    )
    # Where one of the approaches is drawn twice all or none is detected.
    rate = values["detection_rate", "at 1 per minute"]
    assert (rate.low, rate.high) == (0, 1)


def test_held_out_thresholds_come_from_other_videos() -> None:
    shared = [replace(seen, label=replace(seen.label, video=0)) for seen in CLIPS[:2]]
    # In half a minute each, LOOM and LATE have one alarm above 0 before onset.
    found = Thresholds([*shared, *CLIPS[2:]], NAME).held_out(1.0, DRAWS)
    assert found.thresholds.tolist() == [0, 0, 3, 3]


def test_a_clip_without_a_held_out_threshold_is_not_counted() -> None:
    at_once = clip(peaks(60, {40: 1.0}), 3, 50)  # no footage before its onset
    found = Thresholds([CALM, at_once], NAME).held_out(1.0, DRAWS[:, [0, 2]])
    assert np.isnan(found.thresholds).tolist() == [True, False]
    (rate,) = (one for one in found.measurements if one.measure == "false_alarms_per_minute")
    assert (np.isnan(rate.value), rate.n) == (True, 0)


def test_held_out_thresholds_come_from_the_other_clips() -> None:
    thresholds = Thresholds(CLIPS, NAME)
    found = thresholds.held_out(1.0, DRAWS)
    # At most two alarms in the two minutes without CALM, which are 4 and 2.5.
    assert found.thresholds.tolist() == [2, 2.5, 3, 3]
    assert found.outcomes.false_alarms.tolist() == [2, 1, 0, 0]
    assert found.outcomes.detected[2:].tolist() == [1, 0]
    values = {measurement.measure: measurement.value for measurement in found.measurements}
    assert values["false_alarms_per_minute"] == pytest.approx(1)
    assert values["lead_time_s"] == pytest.approx(1.0)


def test_without_a_false_alarm_the_rate_of_a_kind_is_bounded_by_its_own_footage() -> None:
    """The rule of three: at most 3 false alarms in the minutes of this kind, 95 %."""
    seen = [clip([0.0] * frames, motion=kind) for frames, kind in ((603, "still"), (1203, "pan"))]
    found = {one.condition: one for one in shipped(seen, NAME, DRAWS[:, :2]).measurements}
    bounds = {kind: found[f"alarm as shipped{kind}"].high for kind in ("", ", still", ", pan")}
    assert bounds == pytest.approx({"": 3 / 3, ", still": 3 / 1, ", pan": 3 / 2})


def test_each_draw_has_its_own_false_alarms_and_footage() -> None:
    """20 alarms in a minute and 10 in two minutes; a third clip has no footage of its own."""
    seen = [
        clip([0.0] * 603, alarm=range(50, 550, 25)),
        clip([0.0] * 1203, alarm=range(50, 1050, 100)),
        clip([0.0] * 60, 3, 50),
    ]
    draws = np.array([[2, 0, 1], [0, 2, 1], [1, 1, 1]])
    [all_kinds, of_kind] = (
        one for one in shipped(seen, NAME, draws).measurements if "false_alarms" in one.measure
    )
    for rate in (all_kinds, of_kind):
        assert (rate.value, rate.low, rate.high, rate.n) == pytest.approx((10, 5, 20, 2))
    threshold = Thresholds(seen, NAME).at_rate(1.0, draws).measurements[-1]
    assert (threshold.measure, threshold.n) == ("threshold", 2)


def test_the_alarm_as_shipped() -> None:
    clips = [
        clip([0.0] * 603, alarm=[50, 51, 55, 500]),
        clip([0.0] * 401, 303, 400, alarm=[*range(300, 306)]),
        clip([0.0] * 401, 303, 400, alarm=[]),
        clip([0.0] * 401, 303, 400, alarm=[390]),
    ]
    found = shipped(clips, NAME, draws_of([False, True, True, True], 100))
    # 55 is within a second of 50; the alarm that is on at onset began before it.
    assert found.outcomes.false_alarms.tolist() == [2, 1, 0, 0]
    assert found.outcomes.detected[1:].tolist() == [1, 0, 1]
    assert found.outcomes.lead_s[[1, 3]] == pytest.approx([9.7, 1.0])
    values = {measurement.measure: measurement.value for measurement in found.measurements}
    assert values["detection_rate"] == pytest.approx(2 / 3)
    assert values["lead_time_s"] == pytest.approx((9.7 + 1.0) / 2)


def test_without_footage_or_approaches_every_value_is_nan() -> None:
    at_once = clip(peaks(40, {30: 1.0}), 0, 39)
    thresholds = Thresholds([at_once], NAME)
    assert np.isnan(thresholds.lowest(np.array([1]), 1.0))
    found = thresholds.at_rate(1.0, draws_of([True], 100))
    assert all(np.isnan(measurement.value) for measurement in found.measurements)


def test_each_draw_chooses_its_own_threshold() -> None:
    # Only draws without the busy clip have a threshold that the approach is above.
    clips = [clip(peaks(603, {100: 5.0})), clip([0.0] * 603), clip(peaks(60, {40: 3.0}), 3, 50)]
    draws = draws_of([False, False, True], 400)
    thresholds = Thresholds(clips, NAME)
    found = thresholds.at_rate(0.4, draws)
    values = {
        measurement.measure: [measurement.value, measurement.low, measurement.high]
        for measurement in found.measurements
    }
    assert values["detection_rate"] == [0, 0, 1]
    assert values["threshold"] == [5, 0, 5]
    # Held-out thresholds are not chosen again in each draw.
    fixed = thresholds.held_out(0.4, draws)
    kept = {
        measurement.measure: [measurement.value, measurement.low, measurement.high]
        for measurement in fixed.measurements
    }
    assert kept["detection_rate"] == pytest.approx([0, 0, 0.975])


@pytest.mark.parametrize(
    ("share", "count", "expected"),
    [
        *((1.0, 2, (0.158, 1)), (0.0, 2, (0, 0.842)), (1.0, 10, (0.692, 1))),
        # One video with several approaches, or with frames or pairs of which some are right.
        *((0.5, 2, (0.0126, 0.9874)), (0.3, 10, (0.0667, 0.6525)), (2 / 3, 1, (0, 1))),
        (0.45, 10, (0.1216, 0.8129)),  # 4 of 10 at least, 5 of 10 at most
    ],
)
def test_outcomes_that_all_agree_are_not_certain(
    share: float, count: int, expected: tuple[float, float]
) -> None:
    """The exact interval of Clopper and Pearson, from scipy.stats.beta."""
    assert share_interval(share, count, np.nan, np.nan) == pytest.approx(expected, abs=5e-4)


def test_outcomes_of_0_and_1_have_at_least_the_exact_interval() -> None:
    assert share_interval(0.8, 5, 0.6, 1.0) == pytest.approx((0.2836, 1), abs=5e-4)
    assert share_interval(0.8, 5, 0.2, 0.99) == pytest.approx((0.2, 0.9949), abs=5e-4)
    # Outcomes that are shares scatter less.
    assert share_interval(0.45, 10, 0.4, 0.6) == (0.4, 0.6)


def test_the_bootstrap_may_give_a_share_a_wider_interval() -> None:
    """Each draw may have another threshold, so that not all draws agree."""
    assert share_interval(1.0, 10, 0.4, 1.0) == (0.4, 1)
    assert share_interval(0.0, 10, 0.0, 0.6) == (0, 0.6)
    assert share_interval(np.nan, 0, 0.1, 0.2) == (0.1, 0.2)


@pytest.mark.parametrize(("only_first", "only_second"), [(3, 0), (6, 1), (2, 9), (4, 4), (0, 0)])
def test_detectors_are_compared_by_the_exact_test_of_mcnemar(
    only_first: int, only_second: int
) -> None:
    both = [[1.0, 1.0], [0.0, 0.0], [np.nan, 1.0], [0.0, np.nan]]
    found = np.array([*both, *[[1.0, 0.0]] * only_first, *[[0.0, 1.0]] * only_second])
    p = binomtest(only_first, only_first + only_second).pvalue if only_first else None
    split = split_of(found[:, 0], found[:, 1], np.arange(len(found)))
    assert split[:2] == (only_first, only_second)
    assert split.p == pytest.approx(1.0 if p is None else p)


def test_approaches_of_one_video_are_no_independent_evidence() -> None:
    """Two videos with 3 and 2 approaches that only the first detects: in one of four exchanges
    each, the difference is 5 and -5. A third video has one of each kind, and decides nothing."""
    first = np.array([1.0, 1, 1, 1, 1, 1, 0])
    videos = np.array([7, 7, 7, 4, 4, 2, 2])
    assert split_of(first, 1 - first, videos) == (6, 1, 0.5)
    videos = np.array([1, 1, 1, 1, 1, 2, 3])  # differences of 5, 1 and -1
    assert split_of(first, 1 - first, videos) == (6, 1, 0.75)


@pytest.mark.parametrize("events_seen", [1, 2, 5, 40])
def test_the_interval_of_a_rate_is_that_of_garwood(events_seen: int) -> None:
    low, high = rate_interval(events_seen, 2.0, np.nan, np.nan)
    expected = chdtri(2 * events_seen, 0.975), chdtri(2 * events_seen + 2, 0.025)  # of chi-square
    assert [low, high] == pytest.approx([value / 4 for value in expected], rel=1e-6)
    assert rate_interval(events_seen, 2.0, low + 0.01, high - 0.01) == (low, high)
    assert rate_interval(events_seen, 2.0, low - 0.01, high + 0.01) == (low - 0.01, high + 0.01)


def test_no_false_alarm_has_at_least_the_upper_bound_of_the_rule_of_three() -> None:
    assert rate_interval(0, 2.0, np.nan, np.nan) == (0, 1.5)
    assert rate_interval(0, 2.0, 0, 1.4) == (0, 1.5)
    assert rate_interval(0, 2.0, 0, 1.6) == (0, 1.6)
    assert np.isnan(rate_interval(0, 0, np.nan, np.nan)).all()
    # All clips have the threshold 2, above which "b" never is; draws without "a" have a lower one.
    quiet = {"a": {100: 5.0}, "b": {100: 2.0}, "c": {}}
    clips = [clip(peaks(603, at), motion=kind) for kind, at in quiet.items()]
    found = Thresholds(clips, NAME).at_rate(0.4, draws_of([False] * 3, 400)).measurements
    of_kind = next(measurement for measurement in found if measurement.condition.endswith(", b"))
    assert [of_kind.value, of_kind.low, of_kind.high] == pytest.approx([0, 0, 3])


def test_one_clip_gives_a_rate_an_interval() -> None:
    draws = draws_of([False], 100)
    found = shipped([clip([0.0] * 603, alarm=[300])], NAME, draws)
    rate = next(one for one in found.measurements if one.measure == "false_alarms_per_minute")
    assert [rate.value, rate.low, rate.high] == pytest.approx([1, 0.0253, 5.572], abs=1e-3)


@pytest.mark.long
@pytest.mark.parametrize("clips", [5, 12, 40])
def test_intervals_hold_the_truth_as_often_as_they_say(clips: int) -> None:
    """The share of sets of clips whose interval holds the value from which the clips were drawn."""
    random, draws, minutes = np.random.default_rng(5), draws_of([True] * clips), 0.19 * clips
    for share, rate in ((0.5, 0.3), (0.75, 0.86), (0.92, 3.0)):
        held = np.zeros(2)
        for _ in range(100):
            found = (random.random(clips) < share).astype(float)
            bounds = share_interval(found.mean(), clips, *interval(draws @ found / clips))
            events = random.poisson(rate * minutes / clips, clips).astype(float)
            seen = interval(draws @ events / minutes)
            low, high = rate_interval(events.sum(), minutes, *seen)
            held += bounds[0] <= share <= bounds[1], low <= rate <= high
        assert all(held >= 91)  # 95 on average, with a standard deviation of 2.2
