"""Pictures between frames that are more than an interval apart."""

from __future__ import annotations

import itertools
from fractions import Fraction
from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest

from oppload_cli import Analysis, analyse
from oppload_cli.frame_times import ticks
from oppload_cli.frames.between import Interpolation
from oppload_cli.models.registry import detector_named
from oppload_cli.models.units import CellDetector
from oppload_cli.motion.flow import DenseFlow, Flow
from oppload_cli.video.frames import Frame, InputFacts, WorkingSize
from tests.media import disk, texture

if TYPE_CHECKING:
    from collections.abc import Iterator

    from oppload_cli.models.detector import Response
    from tests.media import Luma


def moved(shift: float) -> Luma:
    by = np.array([[1, 0, shift], [0, 1, 0]], np.float32)
    wide = cv2.GaussianBlur(texture(80, 160, 5), (0, 0), 2)
    return np.asarray(cv2.warpAffine(wide, by, (120, 80), flags=cv2.INTER_CUBIC), np.float32)


def between(before: Luma, now: Luma, intervals: float) -> list[tuple[float, Luma]]:
    """Return the pictures between two frames, and their places in time."""
    interpolation, search = Interpolation(), DenseFlow()
    assert list(interpolation.step(before, 0, search.step(before, 0))) == []
    return list(interpolation.step(now, intervals, search.step(now, intervals / 30)))


@pytest.mark.parametrize(
    ("intervals", "count"),
    [(0.5, 1), (1, 1), (1.25, 1), (1.5, 1), (2, 2), (2.5, 2), (3, 3), (6, 6), (7, 1), (60, 1)],
)
def test_the_number_of_pictures_follows_the_time(intervals: float, count: int) -> None:
    shares = [share for share, _ in between(moved(0), moved(-4), intervals)]
    assert shares == pytest.approx([number / count for number in range(1, count)])


# In frames lower than 32 px, and 80 px wide or wider, OpenCV's own scales end the process.
@pytest.mark.parametrize("rows", [slice(None), slice(30, 61), slice(30, 46)])
def test_what_moves_is_halfway_in_between(rows: slice) -> None:
    [(share, picture)] = between(moved(0)[rows], moved(-6)[rows], 2)
    assert share == 0.5
    inner, half = np.s_[4:-4, 15:-15], moved(-3)[rows]
    error = np.abs(picture - half)[inner].mean()
    assert error < 0.1 * np.abs(moved(0)[rows] - half)[inner].mean()
    assert picture.dtype == np.float32


@pytest.mark.parametrize("intervals", [2, 3, 5])
def test_between_equal_frames_nothing_changes(intervals: int) -> None:
    pictures = [picture for _, picture in between(moved(0), moved(0), intervals)]
    assert len(pictures) == intervals - 1
    assert all(np.array_equal(picture, moved(0)) for picture in pictures)


def test_pictures_in_between_have_the_place_of_their_time() -> None:
    inner = np.s_[4:-4, 15:-15]
    for share, picture in between(moved(0), moved(-6), 3):
        expected, away = moved(-6 * share), moved(-6 * (1 - share))
        error = np.abs(picture - expected)[inner].mean()
        assert error < 0.1 * np.abs(away - expected)[inner].mean()


def test_the_motion_of_each_pixel_is_that_of_its_sample() -> None:
    """Samples of 3 px in frames of 25 x 31 px, whose last row and column fill no square."""
    before = np.tile(np.arange(31, dtype=np.float32), (25, 1))
    vectors = np.zeros((8, 10, 2), np.float32)
    vectors[..., 0] = 0.6 * np.arange(10)
    interpolation = Interpolation()
    list(interpolation.step(before, 0, None))
    flow = Flow(vectors, vectors[..., 0], 3, 1 / 15)
    [(_, picture)] = interpolation.step(before, 2, flow)
    samples = np.clip((np.arange(31) + 0.5) / 3 - 0.5, 0, 9)
    expected = np.maximum(0, np.arange(31) - 0.5 * 0.6 * samples)
    # OpenCV 4 shifts pictures by multiples of 1/32 px, OpenCV 5 by any distance.
    np.testing.assert_allclose(picture, np.tile(expected, (25, 1)), atol=1 / 30)


def test_a_picture_in_between_has_no_part_of_the_later_frame() -> None:
    interpolation = Interpolation()
    list(interpolation.step(moved(0), 0, None))
    still = Flow(np.zeros((80, 120, 2), np.float32), np.ones((80, 120), np.float32), 1, 1 / 15)
    [(_, picture)] = interpolation.step(np.ones_like(moved(0)), 2, still)
    np.testing.assert_array_equal(picture, moved(0))


def test_pictures_in_between_do_not_depend_on_frames_before_both() -> None:
    [(_, expected)] = between(moved(0), moved(-6), 2)
    interpolation, search = Interpolation(), DenseFlow()
    for shift in (12, 0, -6):
        flow = search.step(moved(shift), (12 - shift) / 90)
        pictures = list(interpolation.step(moved(shift), 2, flow))
    np.testing.assert_array_equal(pictures[0][1], expected)


def test_frames_without_a_flow_get_no_pictures() -> None:
    """They are too small for the flow, or it is not known."""
    small = np.zeros((15, 60), np.float32)
    assert between(small, small, 2) == []
    interpolation = Interpolation()
    assert [list(interpolation.step(moved(0), 2, None)) for _ in range(2)] == [[], []]


def growing_disk() -> Luma:
    radii = 3 + 60 * (np.arange(31) / 30) ** 2
    return np.array([disk(120, 60, 60, radius) for radius in radii])


@pytest.mark.long
@pytest.mark.once
@pytest.mark.parametrize(
    ("name", "without"), [("opplod", 0.97), ("opplod_reference", 0.8), ("opplod_lplc2", 0.95)]
)
def test_with_pictures_in_between_the_peak_at_15_frames_per_s_is_as_at_30(
    name: str, without: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    peaks = {}
    for interpolates in (True, False):
        monkeypatch.setattr(detector_named(name), "interpolates", interpolates)
        for every in (1, 2):
            records = analyse(growing_disk()[::every], [name], rate=30 / every, rmo=False)
            found = [record[name].response for record in records]
            peaks[interpolates, every] = max(value for value in found if value is not None)
    assert peaks[True, 1] == peaks[False, 1] > 0
    assert peaks[True, 2] / peaks[True, 1] == pytest.approx(1, abs=0.3)
    assert peaks[False, 2] / peaks[False, 1] < without


@pytest.mark.long
@pytest.mark.once
def test_there_are_no_pictures_in_between_where_the_machine_was_too_slow_for_a_frame(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """They would take time in which the next frame is dropped; the index shows the gap."""
    shown = growing_disk()

    class Camera:
        def __init__(self, indices: range, real_time: bool) -> None:
            size, rate = (120, 120), Fraction(30)
            self.facts = InputFacts("disk", "camera", *size, rate, None, real_time=real_time)
            self.working, self.indices = WorkingSize.of(self.facts, 120), indices

        def __iter__(self) -> Iterator[Frame]:
            for index, luma in zip(self.indices, shown[::2], strict=True):
                yield Frame(index, ticks(self.indices.index(index) / 15), luma.astype(np.float32))

    count = len(shown[::2])
    every, second = range(count), range(0, 2 * count, 2)
    found: dict[tuple[range, bool, bool], list[Response | None]] = {}
    for between in (True, False):
        monkeypatch.setattr(CellDetector, "interpolates", between)
        for indices, real_time in itertools.product((every, second), (False, True)):
            records = analyse(Camera(indices, real_time), ["opplod_reference"], rmo=False)
            answers = [record["opplod_reference"].answer for record in records]
            found[indices, real_time, between] = answers
    without = found[every, False, False]
    assert found[second, True, True] == without
    assert found[every, True, True] == found[second, False, True] != without


@pytest.mark.long
@pytest.mark.once
def test_what_shares_layers_gets_no_pictures_in_between() -> None:
    """D-LGMD and OppLoD share layers only until the first picture in between."""
    detectors = ["opplod_reference"], ["dlgmd"], ["opplod_reference", "dlgmd"]
    alone, other, both = (Analysis((120, 120), chosen, rate=30) for chosen in detectors)
    for one in (0, 1, 2, 3, *range(4, 31, 2)):
        frame = growing_disk()[one], one / 30
        expected = {**alone.step(*frame).detectors, **other.step(*frame).detectors}
        assert both.step(*frame).detectors == expected


@pytest.mark.long
@pytest.mark.once
def test_a_cut_at_a_low_rate_causes_no_alarm() -> None:
    """The pictures between two scenes are blends; they are blind like the frame after them."""
    one, other = texture(120, 160, 1), texture(120, 160, 2)
    shown = np.array([*([one] * 12), *([other] * 12)])
    grain = np.random.default_rng(1).normal(0, 0.01, shown.shape)
    records = list(analyse(np.clip(shown + grain, 0, 1), rate=15, rmo=False))
    assert [record.blind for record in records[12:15]] == ["cut"] * 3
    assert not any(record["opplod"].alarm for record in records)


@pytest.mark.long
@pytest.mark.once
def test_a_rest_before_motion_keeps_the_times_in_order() -> None:
    """Exact repeats are shown to the detectors late; no picture comes before them."""
    moving = [disk(120, 60, 60, 5 + 2 * t) for t in range(16)]
    frames = np.array([*([moving[0]] * 10), *moving[1:]])
    analysis = Analysis((120, 120), ["opplod"], rate=15)
    for t, frame in enumerate(frames):
        analysis.step(frame, t / 15)
    dpc = analysis._detectors._bank.detectors["opplod"]._dpc.layer  # type: ignore[attr-defined]
    assert dpc.photoreceptors._now == pytest.approx(2 * (len(frames) - 1))
