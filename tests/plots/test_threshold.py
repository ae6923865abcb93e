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
def test_the_threshold_is_that_of_the_alarm(model: str, seed: int) -> None:
    random = np.random.default_rng(seed)
    times = np.asarray(np.cumsum(random.uniform(0.01, 0.08, 300)), np.float64)
    responses = np.asarray(random.gamma(0.3, 2e-2, 300), np.float64)
    params = AlarmParams(
        background_s=1.0, guard_s=0.25, factor=3, opplod_floor=1e-3, dlgmd_floor=1e-3
    )
    alarm = Alarm(model, params)
    expected = []
    for response, time in zip(responses, times, strict=True):
        alarm.step(response, time)
        expected.append(alarm.threshold)
    threshold = alarm_threshold(times, responses, params, model)
    np.testing.assert_array_equal(threshold, expected)
    assert threshold[0] == 1e-3
    assert threshold.max() > 0.01


def test_before_there_is_a_background_it_is_the_floor() -> None:
    times = np.asarray(np.arange(10) * 0.1, np.float64)
    responses = np.r_[np.nan, np.nan, np.full(8, 0.5)]
    params = AlarmParams(guard_s=0.35, factor=4, opplod_floor=0.25)
    threshold = alarm_threshold(times, responses, params, "opplod")
    assert np.isnan(threshold[:2]).all()
    np.testing.assert_allclose(threshold[2:6], 0.25)
    np.testing.assert_allclose(threshold[6:], 2.0)


def test_the_parameters_come_from_the_sidecar() -> None:
    frames = pd.DataFrame()
    result = Result(Path("a.csv"), frames, {"parameters": {"alarm": {"factor": 7.0}}})
    assert alarm_params(result).factor == 7
    assert alarm_params(Result(Path("a.csv"), frames)) == AlarmParams()
    wrong = Result(Path("a.csv"), frames, {"parameters": {"alarm": {"factor": -1}}})
    with pytest.raises(ResultError, match="wrong alarm"):
        alarm_params(wrong)
