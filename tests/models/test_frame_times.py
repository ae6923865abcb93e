"""Presentation times that are wrong, and what is said of them."""

from __future__ import annotations

import pytest

from oppload_cli.models.timebase import FrameTimes


def taken(times: list[float], rate: float | None = None) -> tuple[list[float], FrameTimes]:
    kept = FrameTimes(rate)
    return [kept.step(time_s) for time_s in times], kept


def test_times_that_increase_stay_as_they_are() -> None:
    times = [0.5, 0.54, 0.58, 0.7, 0.74]
    found, kept = taken(times, 25)
    assert found == times
    assert kept.notes() == []
    assert kept.rate == pytest.approx(25)
    assert kept.as_dict()["longest_step_s"] == pytest.approx(0.12)


def test_equal_and_backward_times_follow_by_a_step() -> None:
    found, kept = taken([0, 0.04, 0.04, 0.02, 0.16, 0.2], 25)
    assert found == pytest.approx([0, 0.04, 0.08, 0.12, 0.16, 0.2])
    (note,) = kept.notes()
    assert note.startswith("2 frames, the first one 2 after the first, have a time that does not")
    assert kept.as_dict()["not_after_the_one_before"] == 2


def test_times_that_all_stand_still_follow_by_the_declared_rate() -> None:
    assert taken([0.0] * 4, 50)[0] == pytest.approx([0, 0.02, 0.04, 0.06])
    assert taken([0.0] * 4)[0] == pytest.approx([0, 1 / 30, 2 / 30, 3 / 30])


def test_a_declared_rate_that_the_times_contradict_is_named() -> None:
    _, kept = taken([t / 12 for t in range(20)], 30)
    assert kept.notes() == [
        "30 frames/s are declared, but the times of most frames say 12; the times count"
    ]
    assert taken([t / 29 for t in range(20)], 30)[1].notes() == []


@pytest.mark.parametrize("rate", [1, 8])
def test_few_frames_are_named(rate: int) -> None:
    (note,) = taken([t / rate for t in range(9)], rate)[1].notes()
    assert note.startswith(f"{rate} frames/s are too few for the models")


def test_many_frames_are_no_fault() -> None:
    _, kept = taken([t / 1000 for t in range(2000)], 1000)
    assert kept.notes() == []
    assert kept.rate == pytest.approx(1000)
