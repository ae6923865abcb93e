from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from oppload_cli.results.result_files import BaseResult, known_threshold


def test_the_threshold_is_that_of_the_table_and_unknown_without_a_column() -> None:
    frames = pd.DataFrame(
        {"time_s": np.arange(4) * 0.1, "opplod_threshold": [0.25, np.nan, 0.0, 2.0]}
    )
    result = BaseResult(Path("clip.frames.csv"), frames, {})
    threshold = known_threshold(result, "opplod")
    assert threshold is not None
    np.testing.assert_allclose(threshold, [0.25, np.nan, np.nan, 2.0])
    assert known_threshold(result, "dlgmd") is None
