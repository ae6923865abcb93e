"""Footage in other codings: its size, and its repeats, change neither alarms nor peaks."""

from __future__ import annotations

from fractions import Fraction
from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest

from benchmarks.footage import LOSSLESS, answers, coded, compared, planes, repeated, sizes

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from numpy.typing import NDArray

    Plane = NDArray[np.uint8]

pytestmark = pytest.mark.slow

DEFAULT = (("opplod", "default"),)


def footage(height: int, frames: int, noise: float = 0.0) -> Iterator[Plane]:
    """A textured disk that approaches over a texture; in contact after the last."""
    random = np.random.default_rng(7)
    width, scale = height * 4 // 3, height / 240
    ground, skin = (random.random((48, 96), np.float32) for _ in range(2))
    size = (width, height)
    ground, skin = (
        np.asarray(cv2.resize(each, size, interpolation=cv2.INTER_CUBIC), np.float32)
        for each in (ground, skin)
    )
    y, x = np.mgrid[:height, :width].astype(np.float32)
    for t in range(frames):
        radius = 400 * scale / (frames - t)
        distance = np.hypot(x - 0.55 * width, y - 0.45 * height)
        inside = np.clip((radius - distance) / scale + 0.5, 0, 1)
        behind = 0.45 + 0.4 * ground
        shown = behind + inside * (0.1 + 0.15 * skin - behind)
        grain = random.standard_normal(shown.shape, np.float32) * np.float32(noise)
        yield np.clip(np.rint(255 * (shown + grain)), 0, 255).astype(np.uint8)


def check(shown: list[Plane], folder: Path, most: dict[str, float]) -> None:
    """Preset `default` alarms as with every picture once; so does its peak, to such a share."""
    codings = 0
    for how, here, there in repeated(shown, Fraction(30), folder):
        for coding in (each for each in most if how.endswith(each)):
            [plain], [answer] = (answers(path, DEFAULT)[0].values() for path in (there, here))
            ratio, apart = compared(answer, plain)
            assert abs(ratio - 1) <= most[coding], how
            assert np.isnan(apart) or abs(apart) <= 1 / 12, how
            codings += 1
    assert codings == 2 * len(most)


def test_repeats_of_generated_footage_change_no_alarm(tmp_path: Path) -> None:
    """At CRF 28 and above the encoder codes the pictures themselves otherwise."""
    shown = list(footage(240, 60, 0.004))
    check(shown, tmp_path, {"exactly": 0.03, "CRF 23": 0.05, "CRF 28": 0.35})


@pytest.mark.parametrize(("name", "count"), [("tc22.mp4", 70), ("c38.mp4", 105)])
def test_repeats_of_a_clip_change_no_alarm(
    name: str, count: int, shared: Path, tmp_path: Path
) -> None:
    shown = list(planes(shared / "clips" / name, count))
    check(shown, tmp_path, {"exactly": 0.05, "CRF 23": 0.16, "CRF 28": 0.35})


def test_the_size_of_a_video_changes_little(tmp_path: Path) -> None:
    """What the encoder loses of a small picture changes D-LGMD's mean most."""
    path = coded(tmp_path / "a.mp4", footage(2160, 30), Fraction(30), LOSSLESS)
    for how, here, there in sizes(path, 30, tmp_path):
        plain = answers(there)[0]
        for detector, answer in answers(here)[0].items():
            ratio, apart = compared(answer, plain[detector])
            lost = detector == "dlgmd, default" and how == "360 rows, CRF 18"
            assert abs(ratio - 1) < (0.2 if lost else 0.1), (how, detector)
            assert np.isnan(apart) or abs(apart) < 1.01 / 30, (how, detector)


@pytest.mark.parametrize("name", ["tc22.mp4", "walk.mkv"])
@pytest.mark.parametrize("crf", [LOSSLESS, 28])
def test_a_real_picture_at_rest_panned_slowly_or_faded_is_no_repeat(
    name: str, crf: int | None, shared: Path, tmp_path: Path
) -> None:
    [picture] = list(planes(shared / "clips" / name, 1))
    height, width = picture.shape
    grain = np.random.default_rng(2).normal(0, 1.5, (75, *picture.shape))

    def moved(shift: float, level: float = 1.0) -> Plane:
        by = np.array([[1, 0, -shift], [0, 1, 0]], np.float32)
        return np.asarray(level * cv2.warpAffine(picture, by, (width, height)), np.float32)

    scale = height / 240
    scenes = {
        "rest": [moved(min(t, 25) * 3 * scale) for t in range(75)],
        "stop and go": [
            moved((t - t // 30 * 15 - max(0, t % 30 - 15)) * 3 * scale) for t in range(75)
        ],
        "slow pan": [moved(0.3 * t * scale) for t in range(75)],
        "fade": [moved(0, 1 - t / 75) for t in range(75)],
    }
    for kind, frames in scenes.items():
        shown = [
            np.clip(np.rint(a + b), 0, 255).astype(np.uint8)
            for a, b in zip(frames, grain, strict=True)
        ]
        path = coded(tmp_path / "a.mp4", shown, Fraction(30), crf)
        assert answers(path, DEFAULT)[1].near == 0, kind
