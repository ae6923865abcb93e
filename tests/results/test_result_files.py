"""Results as they are read back."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
import pytest

from oppload_cli.errors import ResultError
from oppload_cli.results.cells import check_numbers
from oppload_cli.results.result_files import BaseResult, frame_ends, known_threshold, read_result
from oppload_cli.results.tuning import read_tuning
from tests.results.make import frame_rows, write_rows, write_tuning

if TYPE_CHECKING:
    from collections.abc import Callable


@pytest.mark.parametrize(
    ("column", "text", "reason"),
    [
        ("frame", "8", "'8' in line 11, which is not above the value in the row before"),
        ("frame", "9.5", "'9.5' in line 11, which is not a whole number"),
        ("time_s", "0.4", "'0.4' in line 11, which is not above the value in the row before"),
        ("time_s", "-1", "'-1.0' in line 11, which is not above the value in the row before"),
        ("opplod_alarm", "2", "'2' in line 11, which is neither 0 nor 1"),
        ("dlgmd_alarm", "0.5", "'0.5' in line 11, which is neither 0 nor 1"),
        ("dlgmd_alarm", "", "is empty in line 11"),
        ("rom_pairs", "4.5", "'4.5' in line 11, which is not a whole number"),
        ("opplod_response", "1e300", "'1e+300' in line 11, which is not a finite number"),
    ],
)
def test_a_cell_that_no_run_writes(tmp_path: Path, column: str, text: str, reason: str) -> None:
    rows = frame_rows()
    rows[9][column] = text
    path = write_rows(tmp_path / "a.frames.csv", rows)
    with pytest.raises(ResultError) as found:
        read_result(path)
    assert f"{path}: column '{column}' " in str(found.value)
    assert reason in str(found.value)


def test_the_largest_number_of_a_detector_is_read(tmp_path: Path) -> None:
    """Inner values of `--columns all`: products of sums over a large frame."""
    rows = [row | {"product": "1.5e28"} for row in frame_rows()]
    path = write_rows(tmp_path / "a.frames.csv", rows)
    assert check_numbers(path, read_result(path).frames, "product").max() == 1.5e28


def test_a_result_that_ends_within_the_warm_up_is_read_but_has_no_curve(tmp_path: Path) -> None:
    path = write_rows(tmp_path / "a.frames.csv", frame_rows(frames=2))
    result = read_result(path)
    assert result.frames["opplod_response"].isna().tolist() == [True, True]
    with pytest.raises(ResultError, match="column 'opplod_response' is empty in every row"):
        result.need_responses(["opplod"])


def test_a_row_that_was_cut_is_left_out(tmp_path: Path) -> None:
    path = write_rows(tmp_path / "a.frames.csv", frame_rows(frames=30))
    complete = path.read_bytes()
    assert len(read_result(path).frames) == 30
    path.write_bytes(complete + b"30,1.5,0.01,0.2")
    assert len(read_result(path).frames) == 30


def test_a_tuning_table_without_a_sidecar_is_of_no_symmetric_stimulus(tmp_path: Path) -> None:
    values, peaks = {"bar.axis_deg": [0.0, 90.0]}, {"opplod": [1.0, 2.0]}
    path = write_tuning(tmp_path / "a.tuning.csv", values, peaks, symmetric=True)
    tuning = read_tuning(path)
    assert tuning.symmetric
    assert repr(tuning) == "Tuning('a.tuning.csv', 2 rows over bar.axis_deg: opplod)"
    assert tuning != read_tuning(path)  # no comparison of tables, which raises a ValueError
    path.with_suffix(".json").unlink()
    assert not read_tuning(path).symmetric


@pytest.mark.parametrize("read", [read_result, read_tuning])
def test_a_folder_is_no_table(tmp_path: Path, read: Callable[[Path], object]) -> None:
    with pytest.raises(ResultError, match=r": is a folder; give a .* of 'oppload "):
        read(tmp_path)


def test_a_frame_lasts_until_the_next_one_unless_frames_are_missing() -> None:
    ends = frame_ends(np.array([0.0, 1, 2.5, 3.5, 9, 10]))
    assert ends.tolist() == [1, 2.5, 3.5, 5.5, 10, 11]
    assert frame_ends(np.array([4.0])).tolist() == [4]


def test_rows_out_of_order_and_twice(tmp_path: Path) -> None:
    rows = frame_rows()
    for wrong, line in ((rows[::-1], 3), (rows[:20] + rows[15:], 22), (rows[20:] + rows[:20], 22)):
        path = write_rows(tmp_path / "a.frames.csv", wrong)
        with pytest.raises(ResultError, match=rf"'frame' holds '\d+' in line {line}, which is not"):
            read_result(path)


def test_alarms_in_words_in_every_row(tmp_path: Path) -> None:
    rows = [row | {"opplod_alarm": "True"} for row in frame_rows()]
    with pytest.raises(
        ResultError, match="'opplod_alarm' holds 'True' in line 2, which is not a fin"
    ):
        read_result(write_rows(tmp_path / "a.frames.csv", rows))


def test_a_detector_that_a_result_lacks_is_answered_with_those_it_has(tmp_path: Path) -> None:
    result = read_result(write_rows(tmp_path / "a.frames.csv", frame_rows()))
    held = "has no column 'lgmd2_response'; its detectors are opplod, dlgmd; choose among them"
    with pytest.raises(ResultError, match=held):
        result.need(["opplod_response", "lgmd2_response"])
    with pytest.raises(ResultError, match=r"no column 'x'; give a frames\.csv of 'oppload run'"):
        result.need(["x"])


def test_the_threshold_is_that_of_the_table_and_unknown_without_a_column() -> None:
    frames = pd.DataFrame(
        {"time_s": np.arange(4) * 0.1, "opplod_threshold": [0.25, np.nan, 0.0, 2.0]}
    )
    result = BaseResult(Path("clip.frames.csv"), frames, {})
    threshold = known_threshold(result, "opplod")
    assert threshold is not None
    np.testing.assert_allclose(threshold, [0.25, np.nan, np.nan, 2.0])
    assert known_threshold(result, "dlgmd") is None
