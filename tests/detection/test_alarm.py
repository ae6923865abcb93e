"""The alarm against numbers worked out by hand; 32 frames/s, so that times are exact."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest

from oppload_cli.detection.alarm import Alarm, AlarmParams, _Steps, alarm_params
from oppload_cli.errors import ParameterError
from oppload_cli.frame_times import ticks
from oppload_cli.models.registry import detectors

RATE = 32
# Nothing but the floor, frame by frame.
BARE = alarm_params(
    opplod_floor=1, factor=0, enough_s=0, window_s=0, release=1, hold_s=0, refractory_s=0
)


def alarms(responses: list[float], params: AlarmParams, blind: tuple[int, ...] = ()) -> list[int]:
    """Return the frames in which the alarm is on."""
    alarm = Alarm("opplod", params)
    return [
        t
        for t, response in enumerate(responses)
        if alarm.step(response, t / RATE, blind=t in blind)
    ]


def test_the_alarm_is_on_above_the_floor() -> None:
    assert alarms([0, 1, 1.001, 0.5, 7], BARE) == [2, 4]


def test_the_floor_is_the_models_own() -> None:
    params = BARE.replaced(dlgmd_floor=3)
    alarm = Alarm("dlgmd", params)
    assert [alarm.step(response, t) for t, response in enumerate([2, 3, 4])] == [0, 0, 1]


def test_the_threshold_is_the_factor_times_the_median_of_the_background() -> None:
    params = BARE.replaced(opplod_floor=0.5, factor=4, background_s=0.5, guard_s=0.125)
    alarm = Alarm("opplod", params)
    thresholds = []
    for t in range(40):
        alarm.step(float(t), t / RATE)
        thresholds.append(alarm.threshold)
    # Of frame t: t - 5, the first one over 0.125 s ago, and before it 0.5 s to t - 20.
    assert thresholds[:5] == [0.5] * 5
    for t in range(5, 40):
        background = list(range(max(0, t - 20), t - 4))
        assert thresholds[t] == max(0.5, 4 * np.median(background))


def test_a_lone_peak_is_no_background() -> None:
    """As a median, and not a maximum, the background of one cut does not last for seconds."""
    params = BARE.replaced(opplod_floor=0.5, factor=3, guard_s=0)
    assert alarms([0.2] * 20 + [90] * 3 + [0.2] * 20 + [0.61], params) == [20, 21, 22, 43]
    assert alarms([0.2] * 20 + [0.61], params.replaced(factor=4)) == []


@pytest.mark.parametrize(
    ("enough", "expected"), [(0, [2, 3, 4, 5, 6, 7]), (1, [4, 5]), (2, []), (0.5, [4, 5])]
)
def test_long_enough_within_the_latest_window(enough: float, expected: list[int]) -> None:
    params = BARE.replaced(enough_s=enough / RATE, window_s=3 / RATE)
    assert alarms([0, 0, 2, 0, 2, 0, 0, 0, 0], params) == expected


def test_evidence_between_release_and_threshold_at_the_end_of_an_alarm_does_not_count() -> None:
    """The alarm ends at frame 3; the next one needs two frames above the threshold."""
    params = BARE.replaced(enough_s=1 / RATE, window_s=1 / RATE, hold_s=1 / RATE, release=0.5)
    assert alarms([2, 2, 0, 0.6, 2, 2], params) == [1, 2, 5]


def test_long_enough_takes_the_same_time_at_any_frame_rate() -> None:
    params = BARE.replaced(enough_s=0.03, window_s=0.09)
    for rate in (10, 15, 24, 30, 60, 120, 240, 1000):
        alarm, first = Alarm("opplod", params), rate // 2
        on = [t for t in range(rate) if alarm.step(2.0 if t >= first else 0.0, t / rate)]
        assert 0.03 <= (on[0] - first) / rate < 0.03 + 1 / rate, rate


@pytest.mark.parametrize("zero_s", [0.0, 0.3, 7.77, 1000.0, -50.0])
def test_evidence_as_old_as_the_window_counts_whatever_the_clock_says(zero_s: float) -> None:
    """Four frames in 0.09 s, at 100 frames/s, last for three steps: 0.03 s."""
    alarm = Alarm("opplod", BARE.replaced(enough_s=0.03, window_s=0.09))
    shown = [2.0 if t in {0, 3, 6, 9} else 0.0 for t in range(11)]
    on = [t for t, value in enumerate(shown) if alarm.step(value, zero_s + t / 100)]
    assert on == [9]


def test_long_enough_is_within_the_window() -> None:
    with pytest.raises(ParameterError, match="'enough_s' of alarm must be at most 'window_s'"):
        AlarmParams(enough_s=0.5, window_s=0.4)


def test_an_alarm_that_is_on_stays_on_above_the_release() -> None:
    responses = [0.6, 2, 0.6, 0.51, 0.5, 0.6, 2]
    assert alarms(responses, BARE.replaced(release=0.5)) == [1, 2, 3, 6]
    assert alarms(responses, BARE) == [1, 6]


def test_an_alarm_is_held_after_its_last_frame() -> None:
    responses = [0, 2, 0, 2] + [0.0] * 10
    assert alarms(responses, BARE.replaced(hold_s=4 / RATE)) == [1, 2, 3, 4, 5, 6, 7]


@pytest.mark.parametrize("rate", [24, 25, 30, 60, 120])
def test_a_hold_of_whole_steps_holds_for_them(rate: int) -> None:
    for steps in (1, 6):
        alarm = Alarm("opplod", BARE.replaced(hold_s=steps / rate))
        on = [alarm.step(0.0 if t else 2.0, 12.345 + t / rate) for t in range(steps + 3)]
        assert on == [True] * (steps + 1) + [False] * 2


@pytest.mark.parametrize(
    ("steps", "late", "gap"),
    [([], 0.24, False), ([], 0.26, True), ([0.2] * 8 + [0.1] * 7, 0.3, False),
     ([0.2] * 8 + [0.1] * 8, 0.3, True)],
)  # fmt: skip
def test_the_usual_step_is_the_median_of_the_latest_fifteen(
    steps: list[float], late: float, gap: bool
) -> None:
    """Before any step it is 0.1 s; a gap is longer than two and a half of them."""
    found = _Steps()
    for time_s in np.cumsum([0, *steps]).tolist():
        assert found.gap(ticks(time_s)) == 0
    assert found.gap(ticks(time_s + late)) == (pytest.approx(ticks(late)) if gap else 0)


@pytest.mark.parametrize(("late", "on"), [(0.5, True), (0.5625, True), (0.59375, False)])
def test_a_step_of_more_than_two_and_a_half_usual_steps_is_a_gap(late: float, on: bool) -> None:
    """One lost frame, a step of two, is no gap, also if times are rounded."""
    alarm = Alarm("opplod", BARE)
    assert [alarm.step(2.0, time_s) for time_s in (0.0, 0.125, 0.25, late)] == [True] * 3 + [on]


def test_an_alarm_ends_in_a_gap_between_frames() -> None:
    """Held to 0.6 s, it has ended when the next frame comes a minute later, whatever that shows."""
    for late, expected in (
        (0.05, [False, True, False, False, False, False]),
        (0.5, [False, True, False, True, True, True]),  # off once: another alarm
    ):
        alarm, times = Alarm("opplod", alarm_params()), (0.0, 0.1, 60.0, 60.1, 60.2, 60.3)
        shown = (0.0, 0.5, late, *([0.0] * 3 if late < 0.1 else [0.5] * 3))
        found = [alarm.step(value, time_s) for value, time_s in zip(shown, times, strict=True)]
        assert found == expected
    # Its refractory time counts from its end, not from the frame that came after the gap.
    params = BARE.replaced(hold_s=0.5, refractory_s=0.5)
    for gap_s, expected in ((0.6, [False] * 2), (1.2, [False, True])):
        alarm = Alarm("opplod", params)
        assert [alarm.step(2.0, t / RATE) for t in range(4)] == [True] * 4
        assert [alarm.step(2.0, 3 / RATE + gap_s + t / RATE) for t in range(2)] == expected


def test_an_alarm_ends_once_its_condition_has_not_held_for_the_hold() -> None:
    """A response that comes back in the first frame after that does not prolong it."""
    params = BARE.replaced(hold_s=4 / RATE, release=0.5)
    assert alarms([2, 0, 0, 0, 0.6, 0.6, 0, 0, 0, 0, 0], params) == list(range(10))
    assert alarms([2, 0, 0, 0, 0, 0.6, 0.6], params) == list(range(5))


@pytest.mark.parametrize("rate", [1, 4, 30])
def test_frames_that_all_count_are_one_alarm_at_any_rate(rate: int) -> None:
    for hold_s in (0.0, 0.1, 0.5):
        alarm = Alarm("opplod", BARE.replaced(hold_s=hold_s))
        shown = [0.0] * 3 + [2.0] * 9
        assert [alarm.step(value, t / rate) for t, value in enumerate(shown)] == [*map(bool, shown)]


def test_no_alarm_goes_on_within_the_refractory_time() -> None:
    # Off at frame 1: none before frame 5. Frame 8 follows frame 6 without a break.
    responses = [2.0, 0, 2, 2, 2, 0, 2, 2, 2]
    assert alarms(responses, BARE.replaced(refractory_s=4 / RATE)) == [0, 6, 7, 8]
    assert alarms([*responses[:5], 2.0], BARE.replaced(refractory_s=4 / RATE)) == [0, 5]


@pytest.mark.parametrize("rate", [24, 25, 30, 60, 120])
def test_a_refractory_time_of_one_step_ends_with_it(rate: int) -> None:
    alarm = Alarm("opplod", BARE.replaced(refractory_s=1 / rate))
    shown = 2.0, 0.0, 2.0
    found = [alarm.step(value, 12.345 + t / rate) for t, value in enumerate(shown)]
    assert found == [True, False, True]


def test_blind_frames_do_not_count() -> None:
    responses = [0.0, 2, 2, 2, 2]
    assert alarms(responses, BARE, blind=(1, 2)) == [3, 4]
    # They do not end an alarm that is held, but they do not prolong it either.
    held = BARE.replaced(hold_s=2 / RATE)
    assert alarms([2, 2, 2, 2, 2, 2], held, blind=(1, 2, 3, 4)) == [0, 1, 2, 5]


def test_the_alarm_knows_only_the_past() -> None:
    responses = list(np.random.default_rng(8).gamma(0.3, 0.1, 400))
    params = alarm_params(opplod_floor=0.01, factor=3, hold_s=0.1, refractory_s=0.1, guard_s=0.1)
    whole = alarms(responses, params)
    starts = [b for a, b in pairwise(whole) if b > a + 1]
    assert len(starts) > 5
    for end in (50, *starts, 399):
        assert alarms(responses[:end], params) == [t for t in whole if t < end]


def test_every_detector_has_its_own_rule_or_says_why_it_has_none() -> None:
    params = alarm_params()
    for name, kind in detectors().items():
        assert params.rule_of(name) == AlarmParams().rule_of(name) == kind.alarm
        floor = kind.alarm.floor
        assert Alarm(name, params).threshold == (math.inf if floor is None else floor)
        assert (floor is None) == bool(kind.alarm.why_none)
        assert floor is None or floor > 0
    silent = [name for name, kind in detectors().items() if kind.alarm.floor is None]
    assert silent == ["opplod_paper", "opplod_lplc2"]


def test_without_an_alarm_no_response_is_above_the_threshold() -> None:
    assert alarms([0, 1, 1e9, 1e9], BARE.replaced(on=False)) == []


def test_the_rules_of_the_alarms() -> None:
    params = alarm_params()
    assert (params.factor, params.enough_s, params.window_s) == (None, None, None)
    assert params.rule_of("opplod")[:4] == (0.09, 0, 0, 0)
    assert params.rule_of("opplod_reference")[:4] == (8e-4, 30, 0.03, 0.09)
    assert params.rule_of("dlgmd")[:4] == (0.01, 8, 0, 0)


def test_what_is_set_replaces_the_rule_of_every_detector() -> None:
    params = alarm_params(factor=2, enough_s=0.1, window_s=0.2, opplod_floor=0.5)
    assert params.rule_of("opplod")[:4] == (0.5, 2, 0.1, 0.2)
    assert params.rule_of("opplod_reference")[:4] == (8e-4, 2, 0.1, 0.2)
    off = params.replaced(on=False).rule_of("opplod")
    assert (off.floor, off.why_none) == (None, "alarm.on is false")


def test_a_detector_without_an_alarm_gets_one_from_a_floor() -> None:
    """Its factor is then the usual one."""
    responses = [0.0, 1e9, 1e9]
    for params, expected in (
        (alarm_params(), [False, False, False]),
        (alarm_params(opplod_paper_floor=0.1), [False, True, True]),
    ):
        alarm = Alarm("opplod_paper", params)
        assert [alarm.step(value, t / RATE) for t, value in enumerate(responses)] == expected
        assert alarm.threshold == (0.1 if any(expected) else math.inf)


def test_an_unknown_detector_is_an_error() -> None:
    with pytest.raises(ParameterError, match="no model 'oplod'; did you mean 'opplod'"):
        Alarm("oplod")


@pytest.mark.parametrize("rate", [25, 30, 50, 100, 200])
def test_the_zero_of_the_clock_changes_no_alarm(rate: int) -> None:
    """The spans of the rules are whole numbers of frames, and times are rounded."""
    responses = [2.0 if at in {1, 3} else 0.0 for at in range(5) for _ in range(rate // 2)]
    for name in ("opplod", "opplod_reference"):
        found = set()
        for zero_s in (0.0, 0.1, 7.77, 1000.0, 1e5, -50.0):
            alarm = Alarm(name, alarm_params())
            on = [alarm.step(value, zero_s + t / rate) for t, value in enumerate(responses)]
            found.add(tuple(on))
        assert len(found) == 1, name
