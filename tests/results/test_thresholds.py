from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from oppload_cli.errors import StimulusError
from oppload_cli.results.reading import Result, find_truth, read_result, result_threshold
from oppload_cli.stimulus import ground_truth, load
from tests.results.make import write_result


def test_before_the_background_is_known_the_threshold_is_the_floor() -> None:
    responses = np.r_[np.nan, np.nan, np.full(8, 0.5)]
    frames = pd.DataFrame({"time_s": np.arange(10) * 0.1, "opplod_response": responses})
    alarm = {"guard_s": 0.35, "factor": 4, "opplod_floor": 0.25}
    result = Result(Path("clip.frames.csv"), frames, {"parameters": {"alarm": alarm}})
    threshold = result_threshold(result, "opplod")
    assert np.isnan(threshold[:2]).all()
    np.testing.assert_allclose(threshold[2:6], 0.25)
    np.testing.assert_allclose(threshold[6:], 2.0)


def with_sidecar(tmp_path: Path, stimulus: object) -> Path:
    path = write_result(tmp_path / "clip.frames.csv")
    path.with_name("clip.oppload.json").write_text(json.dumps({"stimulus": stimulus}))
    return path


def test_the_sidecar_names_or_holds_the_ground_truth(tmp_path: Path) -> None:
    truth = ground_truth(load("klapoetke2017/loom-l-over-v/l-over-v-40"))
    (tmp_path / "other.stimulus.json").write_text(json.dumps(truth))
    for stated in ({"path": "other.stimulus.json"}, "other.stimulus.json", truth):
        stimulus = stated if isinstance(stated, dict) else {"path": str(tmp_path / stated)}
        found = find_truth(read_result(with_sidecar(tmp_path, stimulus)))
        assert found is not None
        assert len(found["frames"]) == len(truth["frames"])
        assert found["contact_time_s"] == pytest.approx(2.2)


def test_a_result_may_have_no_ground_truth(tmp_path: Path) -> None:
    assert find_truth(read_result(write_result(tmp_path / "clip.frames.csv"))) is None


def test_a_file_that_is_no_ground_truth_is_named(tmp_path: Path) -> None:
    path = write_result(tmp_path / "clip.frames.csv")
    path.with_name("clip.stimulus.json").write_text('{"schema": "x"}')
    with pytest.raises(StimulusError, match=r"clip\.stimulus\.json: its schema is 'x'"):
        find_truth(read_result(path))
