from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from oppload_cli.results.reading import BaseResult, known_threshold


def test_before_the_background_is_known_the_threshold_is_the_floor() -> None:
    responses = np.r_[np.nan, np.nan, np.full(8, 0.5)]
    table = {"time_s": np.arange(10) * 0.1, "opplod_response": responses, "opplod_alarm": 0}
    alarm = {"guard_s": 0.35, "factor": 4, "opplod_floor": 0.25}
    sidecar = {"parameters": {"alarm": alarm}}
    result = BaseResult(Path("clip.frames.csv"), pd.DataFrame(table), sidecar)
    threshold = known_threshold(result, "opplod")
    assert threshold is not None
    assert np.isnan(threshold[:2]).all()
    np.testing.assert_allclose(threshold[2:6], 0.25)
    np.testing.assert_allclose(threshold[6:], 2.0)
