"""Wrong presentation times, and the remarks about them."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from oppload_cli.frame_times import FrameTimes, seconds_of, ticks
from oppload_cli.video.frames import DecodeFacts

MS = Fraction(1, 1000)


def taken(
    times: list[float], rate: float | None = None, tick_s: Fraction | None = None
) -> tuple[list[float], FrameTimes]:
    """Return the own times of frames in seconds, and the `FrameTimes`; tick_s is the input's."""
    kept = FrameTimes(rate, tick_s)
    return [seconds_of(kept.step(ticks(time_s))) for time_s in times], kept


def test_times_that_increase_stay_as_they_are() -> None:
    times = [0.5, 0.54, 0.58, 0.7, 0.74]
    found, kept = taken(times, 25)
    assert found == pytest.approx(times, abs=1e-9)
    assert kept.remarks() == []
    assert kept.rate == pytest.approx(25)
    assert kept.as_dict()["longest_step_s"] == pytest.approx(0.12)
    assert kept.seconds == pytest.approx(0.24)


@pytest.mark.parametrize(("gap_s", "said"), [(0.5, False), (0.6, True)])
def test_a_long_time_without_a_frame_gives_a_remark(gap_s: float, said: bool) -> None:
    times = [t / 25 for t in range(20)]
    _, kept = taken([*times, *(times[-1] + gap_s + t for t in times)], 25)
    remark = (
        "the longest time without a frame is 0.60 s, from 0.76 s on; what happened then was not "
        "seen"
    )
    assert kept.remarks() == [remark] * said


def test_frames_that_arrive_in_bursts_give_a_remark() -> None:
    for pairs, step_s, said in ((11, 0.002, True), (10, 0.002, False), (30, 0.006, False)):
        bursts = [pair / 15 + late for pair in range(pairs) for late in (0, step_s)]
        given = [*bursts, *(pairs / 15 + t / 30 for t in range(60))]
        found, kept = taken(given)
        assert found == pytest.approx(given, abs=1e-9)
        notes = [note.partition(",")[0] for note in kept.remarks()]
        assert notes == ["11 frames come less than 5 ms after the frame before"] * said
    assert taken([t / 240 for t in range(240)])[1].remarks() == []  # of a fast camera


def test_time_zero_is_that_of_the_frame_with_the_least_delay() -> None:
    kept = FrameTimes(None)
    assert kept.as_dict()["zero_utc"] is None
    for time_s, delay_s in ((0, 0.5), (0.04, 0.25), (0.08, 1.0)):
        kept.step(ticks(time_s))
        kept.arrived(1.8e9 + time_s + delay_s)
    assert kept.as_dict()["zero_utc"] == "2027-01-15T08:00:00.250000+00:00"


def test_equal_and_backward_times_follow_by_a_step() -> None:
    found, kept = taken([0, 0.04, 0.04, 0.02, 0.16, 0.2], 25)
    assert found == pytest.approx([0, 0.04, 0.08, 0.12, 0.16, 0.2])
    (note,) = kept.remarks()
    assert note.startswith(
        "2 frames have a time that is not later than that of the frame before (the earliest comes "
        "2 frames after the first one)"
    )
    assert kept.as_dict()["not_after_the_one_before"] == 2


STEADY = [t / 25 for t in range(60)]


@pytest.mark.parametrize("late_s", [0.05, 0.2, 5, 1000])
def test_one_time_too_late_shifts_the_later_ones(late_s: float) -> None:
    """The clock goes on from the wrong time, and a short shift is taken back."""
    given = [*STEADY[:20], STEADY[20] + late_s, *STEADY[21:]]
    found, kept = taken(given, 25)
    steps = np.diff(found)
    assert (steps > 0).all()
    assert steps[20:] == pytest.approx(0.04, rel=0.11)
    shift_s = found[-1] - given[-1]
    assert shift_s == pytest.approx(late_s if late_s > 1 else max(0, late_s - 0.15), abs=0.02)
    assert kept.as_dict()["not_after_the_one_before"] <= 2


def test_two_frames_that_change_places_shift_nothing_for_long() -> None:
    given = [*STEADY[:20], STEADY[21], STEADY[20], *STEADY[22:]]
    found, _ = taken(given, 25)
    steps = np.diff(found)
    assert (steps > 0).all()
    assert steps[25:] == pytest.approx(0.04, rel=0.11)
    assert found[-20:] == pytest.approx(given[-20:])


def test_a_clock_that_is_set_back_goes_on() -> None:
    given = [*STEADY[:30], *(time_s - 3 for time_s in STEADY[30:])]
    found, kept = taken(given, 25)
    assert found[30:] == pytest.approx(STEADY[30:])
    assert np.diff(found)[32:] == pytest.approx(0.04)
    assert kept.as_dict()["not_after_the_one_before"] == 2


def test_times_that_all_stand_still_follow_by_the_declared_rate() -> None:
    assert taken([0.0] * 4, 50)[0] == pytest.approx([0, 0.02, 0.04, 0.06])
    for rate in (None, 0, math.inf, -5, math.nan):
        assert taken([0.0] * 4, rate)[0] == pytest.approx([0, 1 / 30, 2 / 30, 3 / 30])


@pytest.mark.parametrize("rate", [10, 24, 29.97, 30, 60, 120, 240, 480, 700, 1000])
@pytest.mark.parametrize("lost", [0, 7, 20])
@pytest.mark.parametrize("tick_s", [None, MS])
def test_the_rate_is_right_although_times_are_rounded_and_frames_are_lost(
    rate: float, lost: int, tick_s: Fraction | None
) -> None:
    """Times in whole milliseconds, as in Matroska; their median step alone says 30.3 for 30."""
    counts = np.delete(np.arange(300), [20 + 9 * gap + np.arange(3) for gap in range(lost)])
    _, kept = taken([round(1000 * count / rate) / 1000 for count in counts], rate, tick_s)
    assert kept.rate == pytest.approx(rate, rel=0.01)
    assert kept.as_dict()["frames_per_s"] == pytest.approx(rate, rel=0.01)
    assert kept.remarks() == []


def test_the_rate_is_that_of_most_frames() -> None:
    """Neither a pause of a minute nor steps of twice the usual length change the rate."""
    doubled = np.cumsum([1, 1, 1, 2] * 20) / 30
    assert taken([0.0, *doubled, doubled[-1] + 60])[1].rate == pytest.approx(30)


def test_the_rate_is_that_of_the_first_1024_steps() -> None:
    steps = np.repeat([1 / 30, 1 / 10], [1024, 1100])
    assert taken(np.cumsum(steps).tolist())[1].rate == pytest.approx(30)


def test_the_rate_is_that_of_the_shorter_steps_if_half_of_the_steps_are_much_longer() -> None:
    _, kept = taken([0, 0.04, 0.2, 0.24, 0.4])
    assert kept.rate == pytest.approx(25)


def test_a_declared_rate_that_the_times_contradict_gives_a_remark() -> None:
    _, kept = taken([t / 12 for t in range(20)], 30)
    assert kept.remarks() == [
        "30 frames/s are declared, but the times of most frames say 12; the times are used"
    ]
    # A tenth of the declared rate is 3 frames/s.
    assert len(taken([t / 26.9 for t in range(20)], 30)[1].remarks()) == 1
    assert taken([t / 27.1 for t in range(20)], 30)[1].remarks() == []


@pytest.mark.parametrize("rate", [1, 8])
def test_a_low_frame_rate_gives_a_remark(rate: int) -> None:
    (note,) = taken([t / rate for t in range(9)], rate)[1].remarks()
    assert note.startswith(f"{rate} frames/s are too few for the models")


def test_a_low_frame_rate_after_a_higher_one_gives_a_remark() -> None:
    """As of a camera that exposes longer at night; the rate of most frames does not show it."""
    day = [t / 30 for t in range(1800)]
    night = [60 + t / 5 for t in range(100)]
    (note,) = taken([*day, *night])[1].remarks()
    # The median of 15 steps shows the new rate from its eighth step on.
    assert note.startswith("for 18 s in all, frames came at less than 9 per second, too few for")
    # A pause in it does not count.
    paused = [time_s + 100 * (time_s > 70) for time_s in night]
    _, again = taken([*day, *paused])[1].remarks()
    assert again == note
    assert taken([*day, *night[:15]])[1].remarks() == []  # it lasts less than 2 s
    pauses = [0, *(5 + t / 30 + 5 * (t // 100) for t in range(1800))]
    (note,) = taken(pauses)[1].remarks()
    assert note.startswith("the longest time without a frame is 5.03 s")


@given(st.lists(st.sampled_from([0, 40, 200]) | st.integers(-(10**6), 10**6), max_size=9))
@settings(max_examples=100)
def test_any_times_become_later_with_each_frame_and_have_a_rate(steps_ms: list[int]) -> None:
    times, kept = taken((np.cumsum([0, *steps_ms]) / 1000).tolist())
    assert all(np.diff(times) > 0)
    assert kept.rate is None or 0 < kept.rate < np.inf
    assert all(isinstance(remark, str) for remark in kept.remarks())


def test_many_frames_are_no_fault() -> None:
    _, kept = taken([t / 1000 for t in range(2000)], 1000)
    assert kept.remarks() == []
    assert kept.rate == pytest.approx(1000)


def test_an_input_is_complete_without_a_fault_and_keeps_five_messages() -> None:
    assert DecodeFacts().complete
    faulty = DecodeFacts(failures=1), DecodeFacts(corrupt=1), DecodeFacts(missing=1)
    assert not any(facts.complete for facts in faulty)
    facts = DecodeFacts()
    for number in (1, 1, 2, 3, 4, 5, 6):
        facts.failed(f"packet {number}")
    assert facts.failures == 7
    assert facts.messages == [f"packet {number}" for number in (1, 2, 3, 4, 5)]
