from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from oppload_cli.evaluation.metrics.clips import curves_of, videos_of
from oppload_cli.evaluation.metrics.intervals import (
    area_interval,
    draws_of,
    estimate,
    interval,
    precision_interval,
    weighted_mean,
    weighted_median,
)
from oppload_cli.evaluation.metrics.measures import (
    FRAME_CENTRE,
    _order,
    measured,
    of_places,
    places,
)
from tests.evaluation.make import NAME, clip, peaks

if TYPE_CHECKING:
    from oppload_cli.evaluation.metrics.clips import Clip


def test_draws_keep_the_number_of_clips_of_each_kind() -> None:
    looming = [True, False, True, False, False]
    draws = draws_of(looming, 300)
    assert draws.shape == (300, 5)
    assert set(draws[:, [0, 2]].sum(axis=1)) == {2}
    assert set(draws[:, [1, 3, 4]].sum(axis=1)) == {3}
    assert draws.mean(axis=0) == pytest.approx(np.ones(5), abs=0.15)
    assert np.array_equal(draws, draws_of(looming, 300))


def test_a_clip_of_its_own_video_shares_the_number_of_no_other() -> None:
    made = clip([0.0] * 9)
    clips = [replace(made, label=replace(made.label, video=video)) for video in (1, None, 1, None)]
    first, second, third, fourth = videos_of(clips).tolist()
    assert first == third
    assert len({first, second, fourth}) == 3
    last, first, second, third = videos_of([clips[3], *clips[:3]]).tolist()
    assert first == third
    assert len({last, first, second}) == 3


def test_clips_of_one_video_are_drawn_together() -> None:
    draws = draws_of([True, False, True, True, False], 300, videos=[7, 1, 7, 4, 2])
    assert np.array_equal(draws[:, 0], draws[:, 2])
    assert set(draws[:, [0, 3]].sum(axis=1)) == {2}
    assert set(draws[:, [1, 4]].sum(axis=1)) == {2}
    assert draws.mean(axis=0) == pytest.approx(np.ones(5), abs=0.15)


def test_an_interval_is_that_of_the_draws() -> None:
    values = np.repeat([0.0, 1.0], [6, 4])
    found = estimate(lambda weights: weighted_mean(values, weights), draws_of([True] * 10, 4000))
    # 2.5 and 97.5 % of a binomial of 10 draws with 0.4.
    assert found == pytest.approx((0.4, 0.1, 0.7))
    low, high = interval(np.array([np.nan, np.nan, np.nan, 1.0, 2.0]))
    assert np.isnan([low, high]).all()
    assert interval(np.array([np.nan, np.nan, 1.0, 2.0])) == (1, 2)  # half of them are enough
    assert np.isnan(interval(np.array([1.0, 1.0, 1 - 1e-16]))).all()  # draws that agree say nothing
    assert np.isnan(interval(np.empty(0))).all()


def test_the_median_of_weighted_values() -> None:
    values = np.array([3.0, 1.0, np.nan, np.inf])
    assert weighted_median(values, np.array([1, 1, 5, 0])) == 2
    assert weighted_median(values, np.array([0, 1, 0, 2])) == np.inf
    assert np.isnan(weighted_median(values, np.array([0, 0, 1, 0])))


@pytest.mark.parametrize(
    ("approach", "ratio"),
    [
        (clip(peaks(60, {10: 2.0, 45: 8.0}), 40, 50), 4),  # 4 times what was before
        (clip(peaks(60, {45: 8.0}), 40, 50), np.inf),  # nothing before
        (clip([0.0] * 60, 40, 50), 1),  # nothing at all
        (clip(peaks(60, {8: 9.0}), 6, 50), 3),  # 0.3 s before: against the clips without
    ],
)
def test_how_far_an_approach_stands_out(approach: Clip, ratio: float) -> None:
    # A near contact raises the evidence of an alarm, but no response.
    near = replace(approach.outputs[NAME], evidence=10 * approach.outputs[NAME].response)
    approach = replace(approach, outputs={NAME: near})
    calm = [clip(peaks(60, {20: peak})) for peak in (1.0, 3.0, 30.0)]
    draws = draws_of([True, False, False, False], 100)
    found = {
        measurement.measure: measurement
        for measurement in measured([approach, *calm], NAME, draws).measurements
    }
    assert (found["distinct_ratio"].value, found["distinct_ratio"].n) == (ratio, 1)


def test_an_approach_stands_out_against_clips_without_one_alone() -> None:
    """The first approach has 0.3 s before it: 9 over the median 3; the second one has 5 over 5."""
    approaches = [clip(peaks(60, {8: 9.0}), 6, 50), clip(peaks(60, {20: 5.0, 45: 5.0}), 40, 50)]
    calm = [clip(peaks(60, {20: peak})) for peak in (1.0, 3.0, 30.0)]
    calm.append(clip(peaks(7, {5: 2.0})))  # less than half a second
    draws = draws_of([True, True, False, False, False, False], 9)
    found = {one.measure: one for one in measured([*approaches, *calm], NAME, draws).measurements}
    assert found["distinct_ratio"].value == (9 / 3 + 5 / 5) / 2


def test_half_a_second_before_an_approach_is_enough_whatever_its_times_round_to() -> None:
    start, onset = 24, 39  # of these frames at 30 per second the times are a little nearer
    response = [0.0] * (onset + 20)
    response[onset - 1], response[-1] = 2.0, 8.0
    late = clip(response, onset, onset + 19, rate=30)
    late.outputs[NAME].response[:start] = np.nan
    calm = clip([0.0] * 3 + [1.0] * 100)
    draws = draws_of([True, False], 9)
    found = {one.measure: one for one in measured([late, calm], NAME, draws).measurements}
    assert found["distinct_ratio"].value == 4


def test_places_of_the_winning_unit() -> None:
    # Fields of 40 x 40 px; boxes of 40 x 20 px about (120, 60).
    box = (100.0, 50.0, 40.0, 20.0)
    fields = np.full((80, 4), np.nan)
    fields[40] = 100, 40, 40, 40  # its centre on the box's
    fields[50] = 130, 40, 40, 40  # 30 px off: at the edge of the grown box
    fields[55] = 131, 40, 40, 40  # beyond it
    fields[58] = 100, 56, 40, 40  # 16 px below: beyond 1.5 times half the height
    boxes = dict.fromkeys((1, 40, 50, 55, 58, 60, 99), box)
    seen = clip([0.0] * 80, 30, 65, boxes=boxes, winner=fields.tolist())
    found = places([seen], NAME)
    # Of frames 40, 50, 55, 58, 60: frame 1 is warm-up, 99 beyond the clip; 60 has no winner.
    assert [place.inside for place in found] == [True, True, False, False, False]
    assert [place.near for place in found] == [False, True, True, True, True]
    assert [place.distance_px for place in found] == pytest.approx(
        [0, 30, 31, 16, np.nan], nan_ok=True
    )
    assert found[1].distance_diagonals == pytest.approx(30 / np.hypot(40, 20))
    figures = {
        (measurement.measure, measurement.condition): measurement
        for measurement in of_places([seen], NAME, draws_of([True], 100))
    }
    assert figures["place_inside", "within 15 frames of contact"].value == 0.25
    assert figures["place_inside", "all boxed frames"].value == 0.4
    assert figures["place_inside", "all boxed frames"].n == 5
    # All frames of one clip agree: one outcome, not five, gives the exact interval.
    boxes = dict.fromkeys((40, 41, 42), box)
    inside = clip([0.0] * 80, 30, 65, boxes=boxes, winner=[[100, 40, 40, 40]] * 80)
    (share, *_) = of_places([inside], NAME, draws_of([True], 100))
    assert share[3:] == pytest.approx((1, 0.025, 1, 3))
    assert figures["place_distance_px", "within 15 frames of contact"].value == 30
    assert figures["place_distance_px", "within 15 frames of contact"].n == 3
    (middle, *_) = places([seen], FRAME_CENTRE)
    assert middle.distance_px == pytest.approx(np.hypot(80, 40))


def test_frames_near_contact_are_those_from_15_before_it_to_its_own() -> None:
    boxes = dict.fromkeys((49, 50, 65, 66), (100.0, 50.0, 40.0, 20.0))
    found = places([clip([0.0] * 80, 30, 65, boxes=boxes)], FRAME_CENTRE)
    assert [place.near for place in found] == [False, True, True, False]


def test_a_detector_without_units_has_no_measurements_of_places() -> None:
    seen = clip([0.0] * 80, 30, 65, boxes={40: (0.0, 0.0, 1.0, 1.0)})
    assert of_places([seen], NAME, draws_of([True], 100)) == []


def test_every_measurement_of_a_perfect_detector() -> None:
    clips = [
        clip(peaks(100, {85: 1.0, 90: 2.0}), 80, 90),
        clip(peaks(100, {84: 1.0}), 80, 90),
        clip([0.0] * 303, motion="still"),
    ]
    draws = draws_of([True, True, False], 100)
    found = {(f.measure, f.condition): f for f in measured(clips, NAME, draws).measurements}
    last = "last second before contact"
    for rate in ("0.5", "1", "2"):
        assert found["detection_rate", f"at {rate} per minute"].value == 1
        assert found["detection_rate", f"held out at {rate} per minute"].value == 1
        assert found["false_alarms_per_minute", f"at {rate} per minute"].value == 0
        assert found["lead_time_s", f"at {rate} per minute"].value == pytest.approx(0.55)
    assert (found["roc_auc", last].value, found["average_precision", last].value) == (1, 1)
    # Two positive windows; 30 s and twice 7.7 s of others, the rest of 0.7 s included.
    assert found["roc_auc", last].n == 2 + 30 + 2 * 8
    for frames, share in ((0, 1.0), (4, 1.0), (8, 0.5), (12, 0.5)):
        assert found["ordered_pairs", f"{frames} frames before contact"].value == share
    # Each of the two approaches has 7 windows of a second and one of 0.8 s before its last one.
    assert found["ordered_pairs", "0 frames before contact"].n == 2 * 8
    assert found["distinct_ratio", "median over clips"].value == np.inf
    assert found["detection_rate", "alarm as shipped"].value == 0  # it has no alarm of its own


def test_values_of_a_condition_are_sorted_by_their_first_number() -> None:
    ordered = ["-1.5", "at rest", "3,5 m", "side 4", "12 m/s"]
    assert sorted(sorted(ordered), key=_order) == ordered


def test_bounds_of_an_area_deviate_as_far_as_chance_makes_it_deviate() -> None:
    """Each bound, as the true area, is 1.96 standard deviations (Hanley, McNeil 1982) away."""
    for area, approaches, others in ((0.9, 10, 20), (0.5, 3, 4), (0.04, 12, 40)):
        for true in area_interval(area, approaches, others):
            both, neither = true / (2 - true) - true**2, 2 * true**2 / (1 + true) - true**2
            more = (approaches + others) / 2 - 1
            variance = (true * (1 - true) + more * (both + neither)) / approaches / others
            assert abs(true - area) / variance**0.5 == pytest.approx(1.95996, rel=1e-5)
    low, high = area_interval(1.0, 12, 12)
    assert [low, high] == pytest.approx([0.8318, 1], abs=1e-4)
    assert [*area_interval(0.0, 12, 12)] == pytest.approx([0, 1 - low])
    assert [*area_interval(1.0, 1, 1)] == pytest.approx([1 / (1 + 1.95996**2), 1], rel=1e-5)
    assert np.isnan(area_interval(float("nan"), 0, 3)).all()


@pytest.mark.parametrize(("approaches", "others"), [(6, 6), (12, 12), (40, 40), (6, 30)])
def test_intervals_of_areas_hold_the_truth_as_often_as_they_say(
    approaches: int, others: int
) -> None:
    """Five windows of each video without an approach resemble each other."""
    random = np.random.default_rng(7)
    for area, distance in ((0.7, 0.7416), (0.9, 1.8124), (0.99, 3.2899)):
        held = 0
        for _ in range(200):
            near = distance + random.standard_normal(approaches)
            other = random.standard_normal((others, 1)) + random.standard_normal((others, 5))
            found = (near[:, None] > other.ravel() / 2**0.5).mean()
            low, high = area_interval(found, approaches, others)
            held += low <= area <= high
        assert held >= 180


def test_the_interval_of_a_precision_is_that_of_a_share_of_the_rarer_videos() -> None:
    """Each bound, as the true share, is 1.96 standard deviations away."""
    for precision, approaches, others in ((0.9, 10, 20), (0.3, 40, 12)):
        count = min(approaches, others)
        for true in precision_interval(precision, approaches, others):
            deviation = (true * (1 - true) / count) ** 0.5
            assert abs(true - precision) / deviation == pytest.approx(1.95996, rel=1e-5)
    assert [*precision_interval(1.0, 12, 30)] == pytest.approx([12 / (12 + 1.95996**2), 1])
    assert [*precision_interval(0.0, 1, 1)] == pytest.approx([0, 1 - 1 / (1 + 1.95996**2)])
    assert np.isnan(precision_interval(float("nan"), 0, 3)).all()


@pytest.mark.parametrize(("approaches", "others"), [(12, 12), (40, 40), (12, 40), (40, 12)])
def test_intervals_of_precisions_hold_the_truth_about_as_often_as_they_say(
    approaches: int, others: int
) -> None:
    random = np.random.default_rng(7)

    def precision(distance: float, times: int) -> float:
        near = distance + random.standard_normal(times * approaches)
        other = random.standard_normal((times * others, 1))
        other = (other + random.standard_normal((times * others, 5))) / 2**0.5
        positive = np.arange(near.size + other.size) < near.size
        found = curves_of(np.append(near, other), positive)
        return found.average_precision if found else float("nan")

    for distance in (1.8124, 2.66, 3.2899):
        true = precision(distance, 40000 // max(approaches, others))
        intervals = (
            precision_interval(precision(distance, 1), approaches, others) for _ in range(200)
        )
        assert sum(low <= true <= high for low, high in intervals) >= 182


def test_the_interval_of_an_area_counts_videos() -> None:
    clips = [
        clip(peaks(60, {55: 2.0}), 54, 56),  # above all others
        clip([0.0] * 60, 54, 56),  # below all others
        clip([0.0] * 3 + [1.0] * 100),
    ]
    draws = draws_of([True, True, False], 9)
    # The earlier windows of the approaches tie with the second one: it is not all below.
    area = next(f for f in measured(clips, NAME, draws).measurements if f.measure == "roc_auc")
    others, ties = 10 + 2 * 4, 2 * 4
    assert area.value == pytest.approx((1 + 0.5 * ties / others) / 2)
    # All three videos have windows without an approach, 18 in all.
    assert (area.low, area.high) == area_interval(area.value, 2, 3)
    halves = [replace(clip, label=replace(clip.label, video=0)) for clip in clips[:2]]
    found = measured([*halves, clips[2]], NAME, draws).measurements
    area = next(f for f in found if f.measure == "roc_auc")
    assert (area.low, area.high) == area_interval(area.value, 1, 2)
    mean = next(f for f in found if f.measure == "average_precision")
    assert (mean.low, mean.high) == precision_interval(mean.value, 1, 2)
