"""Neither the size nor the repeats of footage change its alarms or peaks."""

from __future__ import annotations

from fractions import Fraction
from typing import TYPE_CHECKING, NamedTuple

import cv2
import numpy as np
import pytest

from benchmarks.footage import (
    LOSSLESS,
    coded,
    compared,
    generated,
    measured,
    planes,
    repeated,
    sizes,
)
from oppload_cli import open_source

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    Plane = NDArray[np.uint8]

pytestmark = pytest.mark.slow

DEFAULT = ("opplod",)
# The encoder removes more texture from a small picture.
LOST = {
    ("opplod", "360 rows, CRF 18"): 0.52,
    ("opplod", "2160 rows, CRF 18"): 0.2,
}


class Case(NamedTuple):
    """The largest deviation from 1 of the ratio of peaks of `opplod`.

    `told`: the peak divided by that on the same file if the detectors are told the repeats; the
    recognition of repeats causes this deviation. `plain`: the peak divided by that on the file
    that shows every picture once; the encoder adds to this deviation. `pictures`: the largest
    difference between the starts of alarms, in pictures.
    """

    how: str
    told: float
    plain: float
    pictures: float = 1.01


GENERATED = (
    Case("twice, exactly", 0.005, 0.005),
    Case("12 in 30, exactly", 0.01, 0.01),
    Case("twice, CRF 23", 0.02, 0.12),
    Case("12 in 30, CRF 23", 0.01, 0.09),
    Case("twice, CRF 28", 0.005, 0.09),
    Case("12 in 30, CRF 28", 0.01, 0.03),
)
# The encoder encodes a picture in another way if it is repeated.
TC22 = (
    Case("twice, exactly", 0.005, 0.005),
    # One of the files has an alarm: the peak is at the floor.
    Case("12 in 30, exactly", 0.015, 0.015, pictures=float("inf")),
    Case("twice, CRF 23", 0.005, 0.11),
    Case("12 in 30, CRF 23", 0.005, 0.05),
    Case("twice, CRF 28", 0.005, 0.42),
    Case("12 in 30, CRF 28", 0.01, 0.41),
)
C38 = (
    Case("twice, exactly", 0.005, 0.005),
    Case("12 in 30, exactly", 0.005, 0.005),
    Case("twice, CRF 23", 0.005, 0.2),
    Case("12 in 30, CRF 23", 0.005, 0.22),
    Case("twice, CRF 28", 0.005, 0.08),
    Case("12 in 30, CRF 28", 0.005, 0.05),
)
PAPER = tuple(
    Case(f"{kind}, {coding}", largest, 0.08)
    for kind, largest in (("twice", 0.005), ("12 in 30", 0.03))
    for coding in ("exactly", "CRF 23", "CRF 28", "CRF 35")
)


def check(shown: list[Plane], folder: Path, cases: tuple[Case, ...]) -> None:
    """Check that the alarms of `default` are those on the file that shows every picture once."""
    limits, seen = {case.how: case for case in cases}, 0
    for pair in repeated(shown, Fraction(30), folder):
        if pair.how not in limits:
            continue
        [plain] = measured(pair.there, DEFAULT)[0].values()
        [told] = measured(pair.here, DEFAULT, pair)[0].values()
        [here] = measured(pair.here, DEFAULT)[0].values()
        ratio, apart = compared(here, plain)
        share = compared(here, told)[0]
        assert abs(share - 1) <= limits[pair.how].told, (pair.how, share)
        assert abs(ratio - 1) <= limits[pair.how].plain, (pair.how, ratio)
        assert np.isnan(apart) or abs(apart) <= limits[pair.how].pictures / pair.per_s, pair.how
        seen += 1
    assert seen == len(cases)


def test_repeats_of_generated_footage_change_no_alarm(tmp_path: Path) -> None:
    check(list(generated(240, 60, 0.004)), tmp_path, GENERATED)


@pytest.mark.parametrize("place", ["centre", "off-centre"])
def test_repeats_of_the_disk_of_the_paper_change_no_peak(place: str, tmp_path: Path) -> None:
    with open_source(f"opplod2023/looming-disk-{place}", height=600) as frames:
        shown = [np.rint(255 * frame.luma).astype(np.uint8) for frame in frames]
    check(shown, tmp_path, PAPER)


@pytest.mark.parametrize(
    ("name", "count", "cases"), [("tc22.mp4", 70, TC22), ("c38.mp4", 105, C38)]
)
def test_repeats_of_a_clip_change_no_alarm(
    name: str, count: int, cases: tuple[Case, ...], shared: Path, tmp_path: Path
) -> None:
    check(list(planes(shared / "clips" / name, count)), tmp_path, cases)


def test_the_size_of_a_video_changes_little(tmp_path: Path) -> None:
    """The encoder removes most texture from a small picture, and so the background of R."""
    path = coded(tmp_path / "a.mp4", generated(2160, 30), Fraction(30), LOSSLESS)
    for how, here, there, *_ in sizes(path, 30, tmp_path):
        plain = measured(there)[0]
        for detector, found in measured(here)[0].items():
            ratio, apart = compared(found, plain[detector])
            limit = LOST.get((detector, how), 0.1)
            assert abs(ratio - 1) < limit, (how, detector)
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
        assert measured(path, DEFAULT)[1].near == 0, kind
