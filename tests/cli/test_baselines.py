"""The two baselines from the command line: run, plotted, annotated and tuned."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import av
import numpy as np
import pytest

from oppload_cli.models.registry import detector_named
from oppload_cli.palette import bgr
from oppload_cli.video.source import open_video
from tests.cli.inside import oppload
from tests.results.make import rows_of
from tests.tuning.test_tuning import DISK

if TYPE_CHECKING:
    from pathlib import Path
NAMES = ("frame_difference", "flow_divergence")


@pytest.mark.parametrize("name", NAMES)
def test_run(name: str, clip: Path, tmp_path: Path) -> None:
    done = oppload("run", clip, "-o", tmp_path, "-q", "--no-rmo", "--model", name)
    assert (done.returncode, done.stderr) == (0, "")
    # A detector without places lists no objects.
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "loom.frames.csv",
        "loom.oppload.json",
    ]
    table = rows_of(tmp_path / "loom.frames.csv")
    own = [f"{name}_{column}" for column in ("response", "threshold", "alarm")]
    assert list(table[0]) == ["frame", "time_s", "luma_change", *own]
    with open_video(clip) as video:
        detector = detector_named(name)(video.working.shape)
        answers = [detector.step(frame.luma) for frame in video]
    responses = [float(row[f"{name}_response"] or "nan") for row in table]
    expected = [np.nan if each is None else each.response for each in answers]
    assert responses == pytest.approx(expected, rel=1e-8, nan_ok=True)
    assert np.nanmax(responses) > 0.01
    sidecar = json.loads((tmp_path / "loom.oppload.json").read_text())
    assert sidecar["parameters"]["alarm"][f"{name}_floor"] == detector_named(name).alarm.floor
    assert sidecar["summary"][name]["frames"] == len(table) - 1


def test_the_frame_difference_is_the_luminance_change(clip: Path, tmp_path: Path) -> None:
    oppload("run", clip, "-o", tmp_path, "-q", "--no-rmo", "--model", "frame_difference")
    for row in rows_of(tmp_path / "loom.frames.csv"):
        assert row["frame_difference_response"] == row["luma_change"]


@pytest.mark.long
@pytest.mark.parametrize("name", NAMES)
def test_plot(name: str, clip: Path, tmp_path: Path) -> None:
    oppload("run", clip, "-o", tmp_path, "-q", "--no-rmo", "--model", name)
    table = tmp_path / "loom.frames.csv"
    done = oppload("plot", table, "-o", tmp_path / "a.svg", "--scale", "raw")
    assert (done.returncode, done.stderr) == (0, "")
    drawn, detector = (tmp_path / "a.svg").read_text(), detector_named(name)
    assert f"<!-- {detector.label}, peak" in drawn
    assert f"<!-- response ({detector.unit}) -->" in drawn
    assert f"stroke: {detector.colour.lower()}" in drawn


@pytest.mark.long
def test_annotate(clip: Path, tmp_path: Path) -> None:
    done = oppload(
        "run", clip, "-o", tmp_path, "-q", "--no-rmo", "--annotate",
        *(word for name in NAMES for word in ("--model", name)),
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (0, "")
    with av.open(str(tmp_path / "loom.annotated.mp4")) as container:
        *_, last = (frame.to_ndarray(format="bgr24") for frame in container.decode(video=0))
    for name in NAMES:  # their labels and curves, below a picture without boxes
        away = np.abs(last.astype(int) - bgr(detector_named(name).colour)).max(axis=2)
        assert (away[480:] < 30).sum() > 100
        assert not (away[:480] < 30).any()


@pytest.mark.parametrize("name", NAMES)
def test_tune(name: str, tmp_path: Path) -> None:
    (tmp_path / "disk.toml").write_text(DISK.format(before=0))
    done = oppload(
        "tune", tmp_path / "disk.toml", "-o", tmp_path, "--height", "native", "--jobs",
        "1", "--model", name, "--plot", "none", "--change", "timing.after_s=0.1",
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (0, "")
    table = rows_of(tmp_path / "disk.tuning.csv")
    assert [row["model"] for row in table] == [name] * 3
    peaks = [float(row["peak"]) for row in table]
    assert 0 < peaks[0] < peaks[1] < peaks[2]
    assert {row["centre_x"] for row in table} == {""}
