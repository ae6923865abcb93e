from __future__ import annotations

import json
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from matplotlib.collections import PathCollection
from matplotlib.patches import Rectangle

from oppload_cli.errors import ParameterError, ResultError, SourceError
from oppload_cli.plots.place_map import plot_places, still_of
from oppload_cli.results.result_files import find_video, read_result
from tests.media import write_video
from tests.results.make import frame_rows, write_result, write_rows

if TYPE_CHECKING:
    from pathlib import Path

    from oppload_cli.results.result_files import BaseResult


def result_of_video(folder: Path, video: str) -> BaseResult:
    """A result with a peak in frame 30 of a video, whose sidecar gives the video this name."""
    write_video(folder / "clip.avi", [np.full((64, 96), 2 * t, np.uint8) for t in range(40)])
    path = write_result(folder / "clip.frames.csv", peak=30)
    facts = {"name": video, "kind": "container", "width": 96, "height": 64}
    path.with_name("clip.oppload.json").write_text(json.dumps({"input": facts}))
    return read_result(path)


def test_winning_units_over_the_frame_of_the_peak(tmp_path: Path) -> None:
    result = result_of_video(tmp_path, str(tmp_path / "clip.avi"))
    still = still_of(result, find_video(result))
    assert still.shape == (64, 96)
    np.testing.assert_allclose(still * 255, 60, atol=1)
    panel = plot_places(result, still)[1][0]
    places = np.asarray(panel.collections[0].get_offsets())
    assert {tuple(place) for place in places} == {(30, 40)}
    # Frames 24 to 36 have at least 5 % of the peak.
    shares = np.exp(-(((np.arange(24, 37) - 30) / 4) ** 2))
    dots = panel.collections[0]
    assert isinstance(dots, PathCollection)
    np.testing.assert_allclose(dots.get_sizes(), 6 + 60 * shares, rtol=1e-6)
    np.testing.assert_allclose(np.asarray(dots.get_array()), np.arange(24, 37) / 20)
    (box,) = panel.patches
    assert isinstance(box, Rectangle)
    assert box.get_bbox().bounds == (10, 20, 40, 40)
    assert panel.get_xlim() == (0, 96)


def test_a_frame_of_another_size_is_drawn_at_the_size_of_the_source(tmp_path: Path) -> None:
    result = result_of_video(tmp_path, str(tmp_path / "clip.avi"))
    small = np.zeros((32, 48), np.float32)
    panel = plot_places(result, small)[1][0]
    assert (panel.get_xlim(), panel.get_ylim()) == ((0, 96), (64, 0))
    assert [*panel.images[0].get_extent()] == [0, 96, 64, 0]
    with pytest.raises(ParameterError, match="still must be luminance from 0 to 1, not of type u"):
        plot_places(result, small.astype(np.uint8))


def test_the_size_of_the_ground_is_that_of_a_ground_truth_without_a_sidecar(tmp_path: Path) -> None:
    path = write_result(tmp_path / "clip.frames.csv", peak=30)
    panel = plot_places(read_result(path))[1][0]
    assert panel.get_xlim() == (0, 50)  # the places reach no further
    truth = {"schema": "oppload.stimulus/1", "name": "disk", "looming": False, "frames": []}
    truth |= {"contact_time_s": None, "display": {"width": 120, "height": 90}}
    (tmp_path / "clip.stimulus.json").write_text(json.dumps(truth))
    panel = plot_places(read_result(path))[1][0]
    assert (panel.get_xlim(), panel.get_ylim()) == ((0, 120), (90, 0))


def test_the_video_is_found_beside_the_result(tmp_path: Path) -> None:
    result = result_of_video(tmp_path, "elsewhere/clip.avi")
    still = still_of(result, find_video(result))
    np.testing.assert_allclose(still * 255, 60, atol=1)


def test_inputs_that_moved_are_found_in_the_folders_of_their_paths(tmp_path: Path) -> None:
    new = tmp_path / "new"
    for name in ("s02/clip.avi", "clip.avi", "s02/frames/1.png", "frames/1.png", "own.avi"):
        (new / name).parent.mkdir(parents=True, exist_ok=True)
        (new / name).touch()
    result = read_result(write_result(tmp_path / "clip.frames.csv"))
    stayed = tmp_path / "stayed.avi"
    stayed.touch()
    for kind, name, moved, found in (
        ("container", "../lab/s02/clip.avi", new, new / "s02" / "clip.avi"),
        ("container", "/lab/s01/clip.avi", new, new / "clip.avi"),
        ("container", "s02/clip.avi", new / "own.avi", new / "own.avi"),
        ("container", str(stayed), new, stayed),
        ("images", "lab/s02/frames", new, new / "s02" / "frames"),
        ("images", "lab/s02/%d.png", new / "frames", new / "frames" / "%d.png"),
        ("images", "lab/s02", new / "frames", new / "frames"),
    ):
        sidecar = {"input": {"name": name, "kind": kind}}
        assert find_video(replace(result, sidecar=sidecar), moved) == str(found)
    gone = {"input": {"name": "s02/gone.avi", "kind": "container"}}
    with pytest.raises(SourceError, match=r"s02/gone\.avi: is not found below .*new; say where"):
        find_video(replace(result, sidecar=gone), new)


def test_the_title_says_how_strong_the_peak_is_and_whether_there_is_an_object(
    tmp_path: Path,
) -> None:
    rows = frame_rows()
    for row in rows[3:]:
        row.update(dict.fromkeys(("opplod_x", "opplod_y", "opplod_width", "opplod_height"), ""))
    for threshold, ratio in (("20", "0.05"), ("0.008", "125")):
        stated = [{**row, "opplod_threshold": threshold} for row in rows]
        path = write_rows(tmp_path / "clip.frames.csv", stated)
        panel = plot_places(read_result(path))[1][0]
        assert panel.get_title("left").split("\n")[1:] == [
            "OppLoD, peak in frame 30; no looming object",
            f"peak: {ratio} times the threshold of the alarm",
        ]
        assert len(panel.patches) == 0


def test_the_places_of_the_chosen_detector(tmp_path: Path) -> None:
    rows = [row | {"ttc_gradient_alarm": "0"} for row in frame_rows()]
    for row in rows[3:]:
        at = int(row["frame"])
        row |= {"ttc_gradient_response": str(1 / (1 + abs(at - 20)))}
        row |= {"ttc_gradient_x": "1", "ttc_gradient_y": "2", "ttc_gradient_width": "7"}
        row |= {"ttc_gradient_height": "8", "ttc_gradient_unit_x": "4", "ttc_gradient_unit_y": "5"}
    names = dict.fromkeys(name for row in rows[3:] for name in row)
    rows = [{name: row.get(name, "") for name in names} for row in rows]
    result = read_result(write_rows(tmp_path / "clip.frames.csv", rows))
    panel = plot_places(result, model="ttc_gradient")[1][0]
    assert {tuple(place) for place in np.asarray(panel.collections[0].get_offsets())} == {(4, 5)}
    (box,) = panel.patches
    assert box.get_path().get_extents(box.get_patch_transform()).bounds == (1, 2, 7, 8)
    assert panel.get_title("left").split("\n")[1:3] == [
        "TTC gradient, peak in frame 20; box: looming",
        "object",
    ]
    with pytest.raises(ResultError, match="D-LGMD has no places; leave the model out"):
        plot_places(result, model="dlgmd")
    with pytest.raises(ResultError, match="has no column 'lgmd2_response'"):
        plot_places(result, model="lgmd2")
    without = result.frames.drop(columns=["opplod_response", "ttc_gradient_response"])
    with pytest.raises(ResultError, match=r"no detector with places; .* such as opplod$"):
        plot_places(replace(result, frames=without))


def test_a_list_of_results_is_told_that_a_map_shows_one(tmp_path: Path) -> None:
    result: Any = [read_result(write_result(tmp_path / "clip.frames.csv"))]
    with pytest.raises(ParameterError, match="a map shows one result; draw each result of the"):
        plot_places(result)


def test_without_the_video_places_are_drawn_on_white(tmp_path: Path) -> None:
    path = write_result(tmp_path / "clip.frames.csv")
    path.with_name("clip.oppload.json").write_text(json.dumps({"input": {"name": "gone.avi"}}))
    assert plot_places(read_result(path))[1][0].get_xlim() == (0, 50)


def test_a_video_that_ends_before_the_peak_is_refused(tmp_path: Path) -> None:
    video = write_video(tmp_path / "short.avi", [np.full((16, 16), t, np.uint8) for t in range(5)])
    result = read_result(write_result(tmp_path / "clip.frames.csv"))
    with pytest.raises(ResultError, match="ends before frame 30"):
        still_of(result, str(video))
