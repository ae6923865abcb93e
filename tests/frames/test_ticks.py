"""Whole ticks: spans are exact, and times become later with each frame."""

from __future__ import annotations

from fractions import Fraction
from itertools import accumulate, pairwise
from typing import Any

import numpy as np
import pytest

from oppload_cli.files.tables import Seconds, formatted
from oppload_cli.frame_times import TICKS_PER_S, FrameTimes, seconds_of, ticks

MS = Fraction(1, 1000)
CLOCKS = None, MS, Fraction(1, 90_000), Fraction(1, 30), Fraction(1, 10)


@pytest.mark.parametrize("rate", [1, 10, 24, 25, 30, 48, 50, 60, 90, 100, 120, 1000, 90_000])
def test_a_usual_step_is_a_whole_number_of_ticks(rate: int) -> None:
    step = ticks(1 / rate)
    assert step * rate == TICKS_PER_S
    assert sum([step] * 3 * rate) == ticks(3)
    assert seconds_of(step * rate) == 1


def test_the_nearest_tick_is_taken_for_numbers_of_any_kind() -> None:
    assert ticks(Fraction(3, 2 * TICKS_PER_S)) == 2  # halves become even
    assert ticks(Fraction(10**9) + Fraction(1, TICKS_PER_S)) == 10**9 * TICKS_PER_S + 1
    assert ticks(-0.5) == -TICKS_PER_S // 2
    one: Any
    for one in (1, 1.0, np.int64(1), np.float32(1), np.float64(1), Fraction(1)):
        assert ticks(one) == TICKS_PER_S


def test_times_one_tick_apart_have_different_cells() -> None:
    for hours in (0, 1, 100):
        cells = [formatted(Seconds(seconds_of(ticks(3600 * hours) + tick))) for tick in range(9)]
        assert all(float(before) < float(after) for before, after in pairwise(cells))


def own_times(
    given: list[int], rate: float | None = None, tick_s: Fraction | None = None
) -> tuple[list[int], FrameTimes]:
    """Return the own times of frames, and the `FrameTimes`, for times in ticks of the input."""
    times = FrameTimes(rate, tick_s)
    of_one = tick_s or Fraction(1, TICKS_PER_S)
    return [times.step(ticks(time * of_one)) for time in given], times


def test_any_sequence_of_times_becomes_later_with_each_frame() -> None:
    """2,000 sequences with equal, backward and far times, on clocks from 1 tick to 0.1 s."""
    random = np.random.default_rng(0)
    for _ in range(2000):
        tick_s = CLOCKS[random.integers(5)]
        least, most = [(0, 3), (-2, 3), (0, 40), (-(10**6), 10**6), (0, 1)][random.integers(5)]
        given = [int(time) for time in np.cumsum(random.integers(least, most, 40))]
        rate = [None, 0.1, 30, 20_000][random.integers(4)]
        found, times = own_times(given, rate, tick_s)
        assert all(before < after for before, after in pairwise(found))
        assert times.wrong <= 39
        if tick_s and all(before <= after for before, after in pairwise(given)):
            tick = ticks(tick_s)
            late = [own - time * tick for own, time in zip(found, given, strict=True)]
            assert min(late) >= 0
            assert max(late) < tick


def test_steps_of_no_one_or_two_frames_give_different_cells() -> None:
    random = np.random.default_rng(0)
    for _ in range(200):
        found, _ = own_times(list(accumulate(map(int, random.integers(0, 3, 40)))), 30, MS)
        cells = [float(formatted(Seconds(seconds_of(time)))) for time in found]
        assert all(before < after for before, after in pairwise(cells))


def test_equal_times_are_spread_inside_a_tick() -> None:
    """Without a usual step so short, half of a tick is left after the second, then a third."""
    found, times = own_times([0, 40, 40, 40, 40, 80], tick_s=MS)
    assert [seconds_of(time) for time in found] == pytest.approx(
        [0, 0.04, 0.0405, 0.04 + 0.002 / 3, 0.04075, 0.08], abs=1e-8
    )
    assert times.as_dict()["not_after_the_one_before"] == 3
    assert times.rate == pytest.approx(25, rel=0.01)  # equal times are no step


def test_a_tick_has_room_for_many_frames() -> None:
    found, _ = own_times([0, 40] + [80] * 1000 + [81], tick_s=MS)
    assert all(before < after for before, after in pairwise(found))
    assert found[-2] < found[-1] == ticks(0.081)


@pytest.mark.parametrize("rate", [1200, 2000, 10_000, 20_000])
@pytest.mark.parametrize("declared", [False, True])
def test_a_clock_too_coarse_for_the_rate_keeps_times_and_rate(rate: int, declared: bool) -> None:
    """Milliseconds, as in Matroska; with the declared rate the steps inside a tick are even."""
    count = rate // 5
    given = [round(1000 * index / rate) for index in range(count)]
    found, times = own_times(given, rate if declared else None, MS)
    right = [ticks(index / rate) for index in range(count)]
    most = max(abs(own - time) for own, time in zip(found, right, strict=True))
    assert most <= ticks(0.0005 if declared else 0.001)
    assert times.rate == pytest.approx(rate, rel=0.03)


def test_a_clock_that_goes_back_goes_on_a_usual_step_later() -> None:
    """By a shift of at least a second that stays; equal times in it are spread like others."""
    given = [*range(0, 400, 40), *range(-5000, -4600, 40), -4640, -4600]
    found, times = own_times(given, 25, MS)
    assert found[:20] == [ticks(index / 25) for index in range(20)]
    assert found[20:] == [ticks(19 / 25 + 0.0005), ticks(20 / 25)]
    assert times.wrong == 3


def test_times_put_right_elsewhere_are_counted_and_kept() -> None:
    """As those of a part of an input, which are those of the complete input."""
    given = [0, 40, 40, 80, 60, 120, 160]
    complete, _ = own_times(given, 25, MS)
    part, wrong = FrameTimes(25, MS), {2, 4, 5}
    kept = [part.step(time, corrected=k in wrong) for k, time in enumerate(complete)]
    assert kept == complete
    assert part.wrong == 3
    assert part.rate == pytest.approx(25, rel=0.02)
