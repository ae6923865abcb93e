"""The published detectors against the outputs of their authors' own code."""

from __future__ import annotations

import csv
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import pytest

from oppload_cli.models.registry import detector_named
from oppload_cli.video.source import open_video
from tests.cli.inside import oppload

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    Grey = NDArray[np.uint8]

SERIES = (  # size, model, parameters, the file's name where it is another
    *(("native", name, {}, "") for name in ("lgmd1_single", "lgmd1_onoff", "lgmd1_group")),
    *(("native", name, {}, "") for name in ("lgmd2", "lgmd_plus")),
    *(("q4", name, {}, "") for name in ("lgmd1_single", "lgmd1_onoff", "lgmd1_group", "lgmd2")),
    *(("q4", name, {}, "") for name in ("lgmd_plus", "lgmd_contrast", "ci_lmd")),
    *(("q4", name, {}, "") for name in ("area_growth", "ttc_gradient")),
    ("q4", "lgmd1_group", {"layer_threshold": 15.0, "grouping": 3.0, "decay": 0.5},
     "lgmd1_thresh15"),
    *(("q4", name, {}, "") for name in ("emd_lplc2_gf", "zhou_lrf", "hua_fixed", "hua_literal")),
    ("q4", "emd_lplc2_gf", {"full_scale": 255.0}, "emd_lplc2_gf_x255"),
    ("h2", "mlplc2", {}, ""),
)  # fmt: skip
STEPS = {"native": 1, "h2": 2, "q4": 4}


@pytest.fixture(scope="module")
def ball(shared: Path) -> list[Grey]:
    """The 61 frames in grey levels, as an open video gives them."""
    with open_video(shared / "data" / "dlgmd_ball", height=None) as video:
        return [np.asarray(np.rint(frame.luma * 255), np.uint8) for frame in video]


def rows_of(shared: Path, size: str, name: str) -> list[dict[str, float]]:
    path = shared / "data" / "detectors" / f"A_{size}_{name}.csv"
    with path.open() as file:
        return [{key: float(value) for key, value in row.items()} for row in csv.DictReader(file)]


def answers(name: str, frames: list[Grey], size: str, params: dict[str, Any]) -> list[Any]:
    kind, step = detector_named(name), STEPS[size]
    small = [np.ascontiguousarray(frame[::step, ::step]) for frame in frames]
    model = kind(small[0].shape, kind.parameters(**params), frame_rate=30)
    return [model.step(frame.astype(np.float32) / np.float32(255)) for frame in small]


@pytest.mark.parametrize(
    "series",
    [
        pytest.param(series, marks=[pytest.mark.slow] if series[0] == "native" else [])
        for series in SERIES
    ],
    ids=lambda series: f"{series[3] or series[1]}-{series[0]}",
)
def test_every_column_is_the_authors(
    shared: Path, ball: list[Grey], series: tuple[str, str, dict[str, Any], str]
) -> None:
    size, name, params, file = series
    rows = rows_of(shared, size, file or name)
    found = answers(name, ball, size, params)
    assert len(rows) >= 59
    for column in set(rows[0]) - {"frame"}:
        got = [float(getattr(found[int(row["frame"])], column)) for row in rows]
        expected = np.array([row[column] for row in rows])
        scale = float(np.abs(expected).max())
        assert got == pytest.approx(expected, rel=1e-3, abs=1e-7 * scale), column


@pytest.mark.parametrize("p", ["0.3", pytest.param("0.55", marks=pytest.mark.slow)])
def test_plgmd_scatters_about_the_authors_means(shared: Path, ball: list[Grey], p: str) -> None:
    rows = rows_of(shared, "q4", "plgmd")
    runs = 20
    found = answers("plgmd", ball, "q4", {"p": float(p), "runs": runs})
    off = []
    for row, answer in zip(rows, found, strict=True):
        sd = row[f"sumg_sd_p{p}"]
        allowed = 4 * sd * (1 / 20 + 1 / runs) ** 0.5
        assert abs(answer.sumg_mean - row[f"sumg_mean_p{p}"]) <= allowed
        if sd:
            off.append((answer.sumg_mean - row[f"sumg_mean_p{p}"]) / allowed * 4)
    assert len(off) > 50
    assert abs(np.mean(off)) < 4 / len(off) ** 0.5  # the frames scatter independently


def test_a_folder_of_images_has_the_columns_of_the_authors(
    shared: Path, ball: list[Grey], tmp_path: Path
) -> None:
    (tmp_path / "ball").mkdir()
    for t, frame in enumerate(ball):
        cv2.imwrite(str(tmp_path / "ball" / f"{t:03d}.png"), frame[::4, ::4])
    done = oppload(
        *("run", str(tmp_path / "ball"), "-o", str(tmp_path), "-q", "--height", "native"),
        *("--no-rmo", "--columns", "all", "--model", "lgmd2,lgmd1_group"),
    )
    assert (done.returncode, done.stderr) == (0, "")
    with (tmp_path / "ball.frames.csv").open() as file:
        table = list(csv.DictReader(file))
    for name in ("lgmd2", "lgmd1_group"):
        for row in rows_of(shared, "q4", name):
            got = table[int(row.pop("frame"))]
            for column, value in row.items():
                cell = float(got[f"{name}_{column}"])
                assert cell == pytest.approx(value, rel=1e-3, abs=1e-3), column
