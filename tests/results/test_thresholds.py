from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from oppload_cli.results.result_files import BaseResult, known_threshold


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


def test_the_threshold_of_the_run_counts_if_the_table_states_it() -> None:
    """The alarm of the run saw other pictures than the rows show, so its background was another."""
    frames = pd.DataFrame(
        {
            "time_s": np.arange(6) * 0.1,
            "opplod_response": [np.nan, 0.5, 0.5, 0.0, 3.0, 0.5],
            "opplod_over_threshold": [np.nan, 2.0, 2.0, 0.0, 4.0, np.nan],
            "opplod_alarm": 0,
        }
    )
    sidecar = {"parameters": {"alarm": {"guard_s": 60, "opplod_floor": 0.2}}}
    threshold = known_threshold(BaseResult(Path("clip.frames.csv"), frames, sidecar), "opplod")
    assert threshold is not None
    # A response of 0 does not tell the threshold: there it is computed, as without the column.
    np.testing.assert_allclose(threshold, [np.nan, 0.25, 0.25, 0.2, 0.75, 0.2])
