"""Times of arrival, smoothed."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from oppload_cli.video.arrivals import Arrivals

Times = NDArray[np.float64]
PERIOD_S = 1 / 30
EVEN = np.arange(90.0) * PERIOD_S
LOST = np.delete(EVEN, [5, 21, 22, 30, 44, 51, 60, 61, 73, 80])
HALVED = np.append(EVEN[:45], EVEN[45::2])
ALTERNATING = np.cumsum([1, 2] * 30) * PERIOD_S
PAUSED = np.append(EVEN[:45], EVEN[45:] + 1)


def smoothed(arrived: Times) -> tuple[Times, Arrivals]:
    clock = Arrivals()
    return np.array([clock.step(float(time_s)) for time_s in arrived]), clock


def delayed(taken: Times, most_s: float) -> Times:
    late = np.random.default_rng(1).uniform(0, most_s, len(taken))
    return np.asarray(np.maximum.accumulate(taken + late) + np.arange(len(taken)) * 1e-6)


def wrong(times: Times, taken: Times) -> float:
    """Return the median error of a step, as a share of it, after the first second."""
    return float(np.median(np.abs(np.diff(times) / np.diff(taken) - 1)[30:]))


@pytest.mark.parametrize("taken", [EVEN, EVEN * 2, EVEN / 2, HALVED], ids=len)
def test_delays_that_vary_change_a_step_by_less_than_a_quarter_of_their_change(
    taken: Times,
) -> None:
    arrived = delayed(taken, 0.03)
    found, clock = smoothed(arrived)
    assert wrong(found, taken) < wrong(arrived, taken) / 4
    assert clock.smoothed > len(taken) / 3


@pytest.mark.parametrize("together", [2, 3])
def test_frames_that_arrive_together_have_times_apart(together: int) -> None:
    number = np.arange(90)
    arrived = EVEN[number // together * together] + number % together * 0.002
    found, _ = smoothed(arrived)
    steps = np.diff(found)[30:]
    assert steps == pytest.approx(PERIOD_S, rel=0.25)
    assert np.diff(arrived)[30:].min() < 0.1 * PERIOD_S


@pytest.mark.parametrize("taken", [LOST, ALTERNATING], ids=["lost", "alternating"])
def test_lost_pictures_are_counted(taken: Times) -> None:
    arrived = delayed(taken, 0.01)
    found, _ = smoothed(arrived)
    assert wrong(found, taken) < wrong(arrived, taken) / 4


@pytest.mark.parametrize(
    "taken",
    [EVEN, LOST, HALVED, ALTERNATING, PAUSED],
    ids=["even", "lost", "halved", "alternating", "paused"],
)
def test_times_without_delays_stay_as_they_are(taken: Times) -> None:
    assert smoothed(taken)[0] == pytest.approx(taken, abs=1e-9)


@pytest.mark.parametrize("seed", range(9))
def test_uneven_steps_of_the_camera_stay(seed: int) -> None:
    taken = np.cumsum(np.random.default_rng(seed).uniform(0.02, 0.05, 90))
    found, _ = smoothed(taken)
    assert np.mean(found == taken) > 0.8


def test_a_pause_begins_the_line_anew() -> None:
    arrived = delayed(PAUSED, 0.01)
    found, _ = smoothed(arrived)
    kept = found == arrived
    assert kept[45:59].all()
    assert not kept[59:74].any()


@pytest.mark.parametrize("seed", range(6))
def test_at_a_change_of_the_rate_frames_far_from_the_line_keep_their_time(seed: int) -> None:
    arrived = HALVED + np.random.default_rng(seed).uniform(0, 0.01, len(HALVED))
    assert smoothed(arrived)[0] == pytest.approx(HALVED + 0.005, abs=0.0051)


@pytest.mark.long
@given(st.lists(st.sampled_from([0, 0.002, 0.033, 0.067]) | st.floats(1e-6, 9), max_size=60))
@settings(max_examples=100, deadline=None)
def test_any_times_become_later_with_each_frame_and_need_no_later_frame(steps: list[float]) -> None:
    arrived = np.cumsum([0.0, *steps])
    found, clock = smoothed(arrived)
    assert all(np.diff(found) > 0)
    assert 0 <= clock.smoothed <= len(found)
    half = len(found) // 2
    assert smoothed(arrived[:half])[0].tolist() == found[:half].tolist()
