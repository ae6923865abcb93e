from __future__ import annotations

import pytest

from oppload_cli.detection.alarm import Alarm, AlarmParams
from oppload_cli.errors import ParameterError

RATE = 30


def alarms(responses: list[float], params: AlarmParams | None = None) -> list[bool]:
    alarm = Alarm("opplod", params or AlarmParams())
    return [alarm.step(response, t / RATE) for t, response in enumerate(responses)]


def test_a_response_far_above_the_background_alarms_after_enough_frames() -> None:
    quiet = [1e-3] * 60
    on = alarms([*quiet, 5e-3, 5e-3, 5e-3, *quiet])
    assert on.index(True) == 62
    # The last window that holds three frames above ends there; then it is held.
    assert sum(on) == 1 + round(0.5 * RATE)


def test_nothing_alarms_at_the_background_times_the_factor() -> None:
    assert not any(alarms([1e-3] * 60 + [4e-3] * 5))


def test_two_frames_are_not_enough() -> None:
    assert not any(alarms([1e-3] * 60 + [1.0, 1.0] + [1e-3] * 30))


def test_below_the_floor_nothing_alarms() -> None:
    assert not any(alarms([0.0] * 60 + [3e-5] * 30))
    assert any(alarms([0.0] * 60 + [3.1e-5] * 30))


def test_the_floor_is_the_models_own() -> None:
    alarm = Alarm("dlgmd", AlarmParams(dlgmd_floor=0.5, opplod_floor=0))
    assert not any(alarm.step(0.4, t / RATE) for t in range(60))


def test_the_background_forgets() -> None:
    params = AlarmParams(background_s=1, guard_s=0.1)
    burst = [1.0] * 5
    again = [*burst, *([1e-3] * 60), *([0.5] * 3)]
    assert alarms(again, params)[-1]
    assert not alarms([*burst, *([1e-3] * 10), *([0.5] * 3)], AlarmParams(hold_s=0))[-1]


def test_the_alarm_knows_only_the_past() -> None:
    responses = [1e-3 * (1 + t % 7) for t in range(80)] + [0.5] * 6
    whole = alarms(responses)
    assert alarms(responses[:83]) == whole[:83]


def test_enough_is_within_the_window() -> None:
    with pytest.raises(ParameterError, match="'enough' of alarm must be at most 'window'"):
        AlarmParams(enough=5, window=4)
