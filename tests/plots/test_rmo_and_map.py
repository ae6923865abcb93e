from __future__ import annotations

import json
from typing import TYPE_CHECKING

import numpy as np
import pytest
from matplotlib.patches import Rectangle

from oppload_cli.errors import ResultError
from oppload_cli.plots.map import plot_map, still_of
from oppload_cli.plots.rmo import plot_rmo
from oppload_cli.results.reading import read_result
from tests.media import write_video
from tests.results.make import frame_rows, write_result, write_rows

if TYPE_CHECKING:
    from pathlib import Path


def test_rmo_over_time(tmp_path: Path) -> None:
    index, size, share = plot_rmo([read_result(write_result(tmp_path / "a.frames.csv"))]).axes
    assert set(np.asarray(index.lines[1].get_ydata())[1:]) == {0.5}
    assert [line.get_label() for line in size.lines] == ["mean of ROM pairs", "max of ROM pairs"]
    assert set(np.asarray(share.lines[0].get_ydata())[1:]) == {10}
    assert share.get_ylabel() == "ROM pairs (%)"


def test_without_rmo_the_column_is_named(tmp_path: Path) -> None:
    rows = [
        {name: cell for name, cell in row.items() if not name.startswith("rmo_")}
        for row in frame_rows()
    ]
    result = read_result(write_rows(tmp_path / "a.frames.csv", rows))
    with pytest.raises(ResultError, match=r"no column 'rmo_index'.*without --no-rmo"):
        plot_rmo([result])


def test_winning_units_over_the_frame_of_the_peak(tmp_path: Path) -> None:
    frames = [np.full((64, 96), 2 * t, np.uint8) for t in range(40)]
    video = write_video(tmp_path / "clip.avi", frames)
    path = write_result(tmp_path / "clip.frames.csv", peak=30)
    sidecar = {"input": {"name": str(video), "width": 96, "height": 64}}
    path.with_name("clip.oppload.json").write_text(json.dumps(sidecar))
    result = read_result(path)
    still = still_of(result)
    assert still is not None
    assert still.shape == (64, 96)
    np.testing.assert_allclose(still * 255, 60, atol=1)
    panel = plot_map(result, still).axes[0]
    places = np.asarray(panel.collections[0].get_offsets())
    assert {tuple(place) for place in places} == {(30, 40)}
    (box,) = panel.patches
    assert isinstance(box, Rectangle)
    assert box.get_bbox().bounds == (10, 20, 40, 40)
    assert panel.get_xlim() == (0, 96)


def test_a_video_that_is_gone_leaves_the_places(tmp_path: Path) -> None:
    path = write_result(tmp_path / "clip.frames.csv")
    path.with_name("clip.oppload.json").write_text(json.dumps({"input": {"name": "gone.avi"}}))
    result = read_result(path)
    assert still_of(result) is None
    assert plot_map(result, None).axes[0].get_xlim() == (0, 50)


def test_another_video_is_refused(tmp_path: Path) -> None:
    video = write_video(tmp_path / "short.avi", [np.full((16, 16), t, np.uint8) for t in range(5)])
    result = read_result(write_result(tmp_path / "clip.frames.csv"))
    with pytest.raises(ResultError, match="ends before frame 30"):
        still_of(result, str(video))
