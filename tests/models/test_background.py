from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from oppload_cli.frame_times import ticks
from oppload_cli.models import timebase
from oppload_cli.models.timebase import Background

pytestmark = pytest.mark.once

STEPS = st.lists(
    st.tuples(st.integers(0, 12), st.integers(0, 6).map(float)), min_size=1, max_size=80
)


def plain(times: list[int], values: list[float], reach: int, guard: int) -> float:
    """The median of the values before the last one that are older than the guard, within reach."""
    *before, now = times
    counted = sorted(
        value
        for time, value in zip(before, values, strict=False)
        if now - guard - reach <= time < now - guard
    )
    return float(np.median(counted)) if counted else 0.0


@pytest.mark.long
@settings(max_examples=120)
@given(steps=STEPS, reach=st.integers(1, 40), guard=st.integers(0, 20))
def test_it_is_a_plain_median(steps: list[tuple[int, float]], reach: int, guard: int) -> None:
    running = Background(reach, guard)
    times = np.cumsum([step for step, _ in steps]).tolist()
    values = [value for _, value in steps]
    for count, (time, value) in enumerate(zip(times, values, strict=True), start=1):
        assert running.step(value, time) == plain(times[:count], values[:count], reach, guard)


@pytest.mark.parametrize("rate", [24, 25, 30, 60])
@pytest.mark.parametrize("start_s", [0.0, 12.345])
def test_a_frame_as_old_as_the_guard_is_no_background(rate: int, start_s: float) -> None:
    running = Background(ticks(10), ticks(5 / rate))
    times = [ticks(start_s) + ticks(frame / rate) for frame in range(8)]
    found = [running.step(float(frame), time) for frame, time in enumerate(times)]
    assert found == [0, 0, 0, 0, 0, 0, 0, 0.5]


def test_of_an_even_number_the_mean_of_both_in_the_middle() -> None:
    running = Background(10, 0)
    assert [running.step(value, time) for time, value in enumerate([5.0, 1, 7, 3, 0])] == [
        *(0, 5, 3, 5, 4)
    ]


@pytest.mark.parametrize(("step", "guard"), [(0, 1), (1, 0), (1, 10**9)])
def test_what_it_remembers_is_bounded(
    monkeypatch: pytest.MonkeyPatch, step: int, guard: int
) -> None:
    monkeypatch.setattr(timebase, "_MOST_VALUES", 50)
    running = Background(10**9, guard)
    for count in range(500):
        running.step(float(count), count * step)
    assert len(running._waiting) <= 50
    assert len(running._counted) == len(running._sorted) <= 50
    if guard == 0:
        # The latest 50 before the last one: 449 to 498.
        assert running.step(0, 499) == 473.5
