from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from oppload_cli.detection.alarm import Alarm, AlarmParams
from oppload_cli.errors import ResultError
from oppload_cli.plots.threshold import alarm_params, alarm_threshold
from oppload_cli.results.reading import Result


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("model", ["opplod", "dlgmd"])
def test_the_threshold_alarms_when_the_alarm_does(model: str, seed: int) -> None:
    random = np.random.default_rng(seed)
    times = np.asarray(np.cumsum(random.uniform(0.01, 0.08, 300)), np.float64)
    bursts = np.where(random.random(300) < 0.1, 30.0, 1.0)
    responses = np.asarray(random.gamma(0.3, 1e-3, 300) * bursts, np.float64)
    params = AlarmParams(background_s=1.0, guard_s=0.25, enough=1, window=1, hold_s=0, factor=2)
    alarm = Alarm(model, params)
    expected = [alarm.step(r, t) for r, t in zip(responses, times, strict=True)]
    threshold = alarm_threshold(times, responses, params, model)
    got = np.where(np.isnan(threshold), False, responses > threshold)
    assert 3 < sum(expected) < 250
    np.testing.assert_array_equal(got, expected)


def test_there_is_none_before_a_background() -> None:
    times = np.asarray(np.arange(10) * 0.1, np.float64)
    responses = np.r_[np.nan, np.nan, np.full(8, 0.5)]
    threshold = alarm_threshold(times, responses, AlarmParams(guard_s=0.35), "opplod")
    assert np.isnan(threshold[:6]).all()
    np.testing.assert_allclose(threshold[6:], 2.0)


def test_the_parameters_come_from_the_sidecar() -> None:
    frames = pd.DataFrame()
    result = Result(Path("a.csv"), frames, {"parameters": {"alarm": {"factor": 7.0}}})
    assert alarm_params(result).factor == 7
    assert alarm_params(Result(Path("a.csv"), frames)) == AlarmParams()
    wrong = Result(Path("a.csv"), frames, {"parameters": {"alarm": {"factor": -1}}})
    with pytest.raises(ResultError, match="wrong alarm"):
        alarm_params(wrong)
