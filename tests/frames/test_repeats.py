"""Repeats, exact or re-encoded, and scenes that look like repeats."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import pytest

from oppload_cli import open_video
from oppload_cli.frame_times import FrameTimes, seconds_of, ticks
from oppload_cli.frames.preparation import Preparation
from oppload_cli.frames.repeats import (
    EXACT,
    NEAR,
    Repeat,
    RepeatParams,
    Repeats,
    _Change,
    _Proof,
)
from oppload_cli.pipeline.sources import StimulusVideo
from oppload_cli.stimulus.catalogue import load_all
from oppload_cli.video.frames import Frame
from tests.media import texture, write_video

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from oppload_cli.frames.preparation import Prepared

    Luma = NDArray[np.float32]

RESTED = Repeat(EXACT, still_begins=True)
RUN = _Proof(0, 0, 1, deep=True)
HEIGHT, WIDTH = 120, 160


def answers(frames: Sequence[Luma], rate: float = 30, **params: Any) -> tuple[str, Repeats]:
    """Return a letter per frame, and the `Repeats`.

    E and N are exact and near repeats of a cadence, e is an exact repeat outside one.
    """
    repeats = Repeats(RepeatParams(**params))
    found = [repeats.step(frame, ticks(index / rate)) for index, frame in enumerate(frames)]
    assert all(repeat.passed_over for repeat in found if repeat.held)
    kinds = (repeat.kind[:1].upper() if repeat.held else repeat.kind[:1] for repeat in found)
    return "".join(kind or "." for kind in kinds), repeats


def noise(frames: int, sigma: float) -> Luma:
    grain = np.random.default_rng(4).standard_normal((frames, HEIGHT, WIDTH), np.float32)
    return np.float32(sigma) * grain


def noisy(frames: Sequence[Luma]) -> list[Luma]:
    """Return frames with so little noise that no two of them are equal."""
    return [a + b for a, b in zip(frames, noise(len(frames), 0.001), strict=True)]


def converted(count: int, rate: int = 30, pictures: int = 12) -> list[Luma]:
    """Return frames of a pan that a converter has taken from fewer pictures/s, with noise."""
    moving = panned(np.arange(count * pictures // rate + 1) * 3.0)
    return noisy([moving[k * pictures // rate] for k in range(count)])


def panned(shifts: Iterable[float], sigma: float = 0.0) -> list[Luma]:
    """Return frames of a texture, shifted by numbers of pixels, with noise."""
    wide = texture(HEIGHT, 512, 3)
    moved = [
        cv2.warpAffine(wide, np.array([[1, 0, -shift], [0, 1, 0]], np.float32), (WIDTH, HEIGHT))
        for shift in shifts
    ]
    grain = noise(len(moved), sigma)
    return [np.clip(a + b, 0, 1).astype(np.float32) for a, b in zip(moved, grain, strict=True)]


def coded(path: Path, frames: Sequence[Luma], rate: int, crf: int) -> list[Luma]:
    """Return the frames after they were encoded in H.264 and decoded."""
    shown = [(frame * 255).round().astype(np.uint8) for frame in frames]
    write_video(path, shown, codec="libx264", pixel_format="yuv420p", rate=rate,
                options={"crf": str(crf)})  # fmt: skip
    with open_video(path, height=HEIGHT) as video:
        return [frame.luma.copy() for frame in video]


def frames_told(found: Sequence[Repeat]) -> list[float]:
    """Return when the pictures of frames at 30 frames/s were taken, in frames."""
    return [k + 30 * seconds_of(x.shift) for k, x in enumerate(found) if not x.passed_over]


@pytest.mark.parametrize(("rate", "pictures"), [(30, 12), (60, 25), (60, 24)])
def test_the_pictures_of_a_cadence_are_evenly_spaced_in_time(rate: int, pictures: int) -> None:
    """A file of 30 frames/s shows 12 pictures/s for two frames and three in turn."""
    repeats = Repeats(RepeatParams())
    shown = enumerate(converted(4 * rate, rate, pictures))
    steps = [(k / rate, repeats.step(frame, ticks(k / rate))) for k, frame in shown]
    times = np.array(
        [(at, at + seconds_of(step.shift)) for at, step in steps if not step.passed_over]
    )
    # The repeats that are shown before the cadence is known do not disturb it.
    intervals = np.diff(times, axis=0)[next(k for k, step in enumerate(steps) if step[1].held) :]
    intervals *= pictures
    assert np.ptp(intervals[:, 0]) > 0.3
    assert intervals[:, 1] == pytest.approx(np.ones(len(intervals)), abs=0.05)
    assert intervals[20:, 1] == pytest.approx(np.ones(len(intervals) - 20), abs=0.025)
    assert np.abs(times[:, 0] - times[:, 1]).max() < 1.5 / rate


@pytest.mark.parametrize(
    ("lasts", "most"),
    [((2, 3), 0.01), ((2, 2, 3, 2, 3), 0.01), ((1, 1, 1, 2), 0.02), ((3, 1, 1, 1), 0.03)],
)
def test_pictures_of_a_regular_pattern_get_even_times(lasts: tuple[int, ...], most: float) -> None:
    """The last pattern is that of two converters: pictures of 20 per second miss theirs by 1.5."""
    pictures = np.random.default_rng(1).random((120, 4, 4)).astype(np.float32)
    frames = np.repeat(pictures, np.resize(lasts, 120), axis=0)
    repeats = Repeats(RepeatParams())
    found = [repeats.step(frame, ticks(k / 30)) for k, frame in enumerate(frames)]
    told = frames_told(found)
    assert len(told) == 120
    # The next one is later than this.
    assert 30 * seconds_of(repeats._taken) == pytest.approx(told[-1])
    assert np.diff(told).min() > 0.4
    intervals = np.diff(told)[60:] / np.mean(lasts)
    assert np.sqrt(np.mean((intervals - 1) ** 2)) < most


def test_a_picture_may_be_repeated_once_more_than_the_one_before() -> None:
    """12 pictures/s in 30 frames/s: once and twice in turn, from the start of the cadence."""
    found, _ = answers(converted(30))
    assert found == "..........." + "NN.N." * 3 + "NN.N"


@pytest.mark.parametrize("still", [0, 30])
def test_the_detectors_begin_again_once_the_cadence_is_known(still: int) -> None:
    """12 pictures/s in 30 frames/s, at once or after a second of a still picture."""
    shown = converted(24)
    preparation = Preparation(FrameTimes(30), Repeats(RepeatParams()), None, None)
    begun = {}
    for k, luma in enumerate(shown[:1] * still + shown):
        prepared = preparation.step(Frame(k, ticks(k / 30), luma))
        if prepared.again:
            frames = [*prepared.again, prepared]
            begun[k - still] = [(x.frame.index - still, x.repeat.passed_over) for x in frames]
    passed_over = {1, 2, 4, 6, 7, 9}
    assert begun == {10: [(k, k in passed_over) for k in range(11)]}


class Told:
    """In the place of `Repeats`: letters say which frames are repeats, a number the cadence."""

    def __init__(self, kinds: str, known_at: int = 1000, *, in_run: bool = False) -> None:
        self._kinds, self._known_at, self.in_run = kinds, known_at, in_run
        self._count = self.forgotten = 0

    def step(self, _luma: Luma, _time: int) -> Repeat:
        self._count += 1
        return Repeat(NEAR, passed_over=True) if self._kinds[self._count - 1] == "r" else Repeat()

    @property
    def is_cadence(self) -> bool:
        return self._count > self._known_at

    def again(self, frames: list[object]) -> list[Repeat]:
        return [Repeat(NEAR) for _ in frames]

    def forget_cadence(self) -> None:
        self.forgotten += 1


def prepared_as(
    told: Told, count: int, luma: Luma, rate: int, first_s: float = 0.0
) -> list[Prepared]:
    repeats: Any = told
    preparation = Preparation(FrameTimes(rate), repeats, None, None)
    return [preparation.step(Frame(k, ticks(first_s + k / rate), luma)) for k in range(count)]


@pytest.mark.parametrize(
    ("shape", "known_at", "again"),
    [((8, 8), 12, 12), ((8, 8), 13, 0), ((4096, 2048), 1, 1), ((4096, 2048), 2, 0)],
)
@pytest.mark.parametrize("first_s", [0.0, 1.0])
def test_a_cadence_counts_from_the_start_for_0_6_s_and_64_mb(
    shape: tuple[int, int], known_at: int, again: int, first_s: float
) -> None:
    """At 20 frames/s; frames of 4096 x 2048 px take 32 MB each."""
    luma = np.broadcast_to(np.float32(0), shape)
    told = Told("p" * 20, known_at)
    prepared = prepared_as(told, known_at + 2, luma, rate=20, first_s=first_s)
    assert [len(seen.again) for seen in prepared] == [0] * known_at + [again, 0]


@pytest.mark.parametrize("in_run", [False, True])
def test_a_first_picture_that_stood_still_was_not_repeated(in_run: bool) -> None:
    """No repeat follows the second picture: the detectors get all frames."""
    told = Told("prrpp", in_run=in_run)
    prepared = prepared_as(told, 5, np.zeros((8, 8), np.float32), rate=30)
    assert [seen.undecided for seen in prepared] == [False] * 3 + [True, False]
    assert [len(seen.again) for seen in prepared] == [0] * 4 + [0 if in_run else 4]
    assert not any(seen.repeat.passed_over for seen in prepared[4].again)
    assert told.forgotten == (not in_run)


def test_a_start_with_exact_and_near_repeats_is_no_rest() -> None:
    """The encoder coded the first picture's repeats exactly, but that of the second one anew."""
    moving = panned(np.arange(4) * 3.0)
    shown = [moving[k] for k in (0, 0, 0, 1, 1, 2)]
    shown[4] = shown[4] + np.float32(5e-4)
    preparation = Preparation(FrameTimes(30), Repeats(RepeatParams()), None, None)
    prepared = [preparation.step(Frame(k, ticks(k / 30), luma)) for k, luma in enumerate(shown)]
    assert [bool(seen.again) for seen in prepared] == [False] * 5 + [True]
    assert [seen.repeat.passed_over for seen in prepared[5].again] == [
        False,
        True,
        True,
        False,
        True,
    ]


@pytest.mark.parametrize(
    ("mean", "largest", "strict", "lenient"),
    [
        (0.34, 0.34, True, True),
        (0.36, 0.2, False, True),
        (0.2, 0.36, False, True),
        (0.69, 0.17, False, True),
        (0.17, 0.69, False, True),
        (0.71, 0.1, False, False),
        (0.1, 0.71, False, False),
        (0.5, 0.26, False, False),
    ],
)
def test_both_values_of_a_change_are_below_a_share_or_in_a_cadence_their_geometric_mean(
    mean: float, largest: float, strict: bool, lenient: bool
) -> None:
    """The share is 0.35: its square is 0.1225, and 0.5 * 0.26 is 0.13."""
    change, other = _Change(0.1 * mean, 0.3 * largest), _Change(0.1, 0.3)
    found = [change.below(0.35, other, lenient=in_cadence) for in_cadence in (False, True)]
    assert found == [strict, lenient]
    repeats = Repeats(RepeatParams())
    for cadence in (strict, lenient):
        repeats._usual.extend([other] * 3)
        assert repeats._is_drop(change) == cadence
        repeats._proofs.extend([RUN] * 2)


def test_the_usual_change_is_a_median_or_before_a_cadence_a_large_one() -> None:
    repeats = Repeats(RepeatParams())
    repeats._usual.extend(_Change(x / 100, x / 10) for x in (9, 8, 1, 4, 4, 4, 2, 1))
    assert repeats._usual_change() == (0.04, 0.4)  # the second largest of the latest 6
    repeats._proofs.extend([RUN] * 2)
    assert repeats._usual_change() == (0.02, 0.2)  # the median of the latest 3


@pytest.mark.parametrize(
    ("usual", "largest", "change", "proved"),
    [
        (0.2, 0.01, 0.075, False),  # the change rises to 0.4 of the usual change
        (0.2, 0.01, 0.085, True),
        (0.0, 0.001, 0.007, False),  # or to the least change
        (0.0, 0.001, 0.009, True),
        (0.2, 0.036, 0.1, False),  # the run is below 0.35 of it
        (0.2, 0.034, 0.1, True),
    ],
)
def test_a_run_is_proved_by_a_change_that_rises(
    usual: float, largest: float, change: float, proved: bool
) -> None:
    repeats = Repeats(RepeatParams())
    repeats._usual.extend([_Change(usual, usual)] * (usual > 0))
    repeats._run, repeats._before, repeats._largest = 2, ticks(0.1), _Change(largest, largest)
    repeats._end_run(_Change(change, change), ticks(0.15))
    assert [proof.length for proof in repeats._proofs] == [2] * proved
    # One value of the run may reach 0.7 of the change. Of runs in a cadence the proved ones count.
    repeats._proofs.extend([RUN] * 2)
    for mean in (0.06, 0.08):
        repeats._run, repeats._largest = 3, _Change(mean, 0.01)
        repeats._end_run(_Change(0.1, 0.2), ticks(0.15))
    assert repeats._proofs[-1] == (ticks(0.15), 0, 3, False)
    assert len(repeats._proofs) == 3 + proved
    assert (repeats._pictures, repeats._repeats) == (1, 3)


def test_a_proof_counts_for_two_seconds_and_a_run_for_itself() -> None:
    one, other = np.zeros((2, 4, 4), np.float32)
    other[0, 0] = 1
    for time, cadence in ((ticks(2), True), (ticks(2) + 1, False)):
        repeats = Repeats(RepeatParams())
        repeats.step(one, 0)
        repeats._proofs.extend([RUN, RUN._replace(time=ticks(1.9))])
        repeats.step(other, time)
        assert repeats.is_cadence == cadence
        repeats._largest = _Change(1, 1)
        repeats.step(other.copy(), time + ticks(0.01))
        assert repeats._largest == (0, 0)


@pytest.mark.parametrize(
    ("time_s", "taken_s", "told_s"),
    [
        (1.02, 0.9, 1.0),  # up to a frame late
        (1.07, 0.9, 1.0 + 0.1 * 0.03),  # 0.07 s late, of which 0.04 s are a frame
        (0.98, 0.9, 1.0 - 0.1 * 0.02),  # early
        (1.11, 0.9, 1.11 - 2 * 0.04),  # at most two frames late
        (1.02, 0.99, 0.99 + 0.02),  # half a frame after the frame shown before
        (0.94, 0.9, 0.94 + 0.04),  # at most a frame early
    ],
)
def test_an_even_time_is_pulled_into_the_frame_before_the_picture(
    time_s: float, taken_s: float, told_s: float
) -> None:
    """The picture before was taken at 0.9 s; pictures last for 0.1 s, and frames for 0.04 s."""
    repeats = Repeats(RepeatParams())
    repeats._proofs.extend([RUN] * 2)
    repeats._picture, repeats._even = ticks(time_s - 0.1), ticks(0.9)
    repeats._taken, repeats._before = ticks(taken_s), ticks(time_s - 0.04)
    even = repeats._even_time(ticks(time_s))
    assert even == pytest.approx(ticks(told_s), abs=1)


def test_the_first_pictures_get_even_times_by_all_lengths_of_the_cadence() -> None:
    """20 pictures/s in 30 frames/s: known after frame 5, when two pictures have lasted twice."""
    random = np.random.default_rng(1)
    pictures = random.uniform(0.3, 0.7, (9, 15, 15))
    indices = np.repeat(np.arange(9), np.resize([1, 2], 9))
    shown = [
        np.asarray(pictures[k] + random.normal(0, 1e-3, (15, 15)), np.float32) for k in indices
    ]
    repeats = Repeats(RepeatParams())
    known = 0
    while not repeats.is_cadence:
        repeats.step(shown[known], ticks(known / 30))
        known += 1
    found = repeats.again([(shown[k], ticks(k / 30)) for k in range(known)])
    told = frames_told(found)
    assert np.diff(told) == pytest.approx(np.full(len(told) - 1, 1.5), abs=0.15)
    counts = repeats._pictures, repeats._repeats, repeats._frames
    assert counts == (len(told) - 1, known - len(told), known)


def test_a_cadence_stays_if_its_runs_are_one_run_when_they_are_recognised_again() -> None:
    """In a cadence one cell of a repeat, as in frame 5, may change by 0.6 of the usual change."""
    repeats = Repeats(RepeatParams())
    shown: list[tuple[Luma, int]] = []
    luma = np.zeros((15, 15), np.float32)
    for change in (0.1, 0.1, 0.1, 0.1, 1e-3, 0.018, 1e-3, 0.1):
        luma = luma + np.float32(change)
        luma[0, 0] += 0.04 * (change == 0.018)
        shown.append((luma, ticks(len(shown) / 30)))
    for frame in shown:
        assert not repeats.is_cadence
        repeats.step(*frame)
    assert repeats.is_cadence
    assert [repeat.passed_over for repeat in repeats.again(shown)[3:6]] == [False, True, True]
    assert repeats.is_cadence


def test_a_second_cadence_does_not_use_the_intervals_of_the_first() -> None:
    """10 and 15 pictures/s, with 2.5 s of 30 pictures/s in between."""
    lasts = [3] * 10 + [1] * 75 + [2] * 10
    pictures = np.random.default_rng(1).uniform(0.3, 0.7, (95, 15, 15)).astype(np.float32)
    repeats = Repeats(RepeatParams())
    frames = enumerate(np.repeat(pictures, lasts, axis=0))
    told = frames_told([repeats.step(frame, ticks(k / 30)) for k, frame in frames])
    assert np.diff(told)[-8:] == pytest.approx(np.full(8, 2), abs=1e-6)


def test_the_first_repeats_are_recognised_once_the_cadence_is_known() -> None:
    shown = converted(24)
    repeats = Repeats(RepeatParams())
    for known in range(24):
        repeats.step(shown[known], ticks(known / 30))
        if repeats.is_cadence:
            break
    assert known == 10
    found = repeats.again([(shown[k], ticks(k / 30)) for k in range(known + 1)])
    pictures = [k * 12 // 30 for k in range(known + 1)]
    assert [repeat.passed_over for repeat in found] == [
        before == now for before, now in zip([-1, *pictures], pictures, strict=False)
    ]
    # Pictures 0 to 4 begin at frames 0, 3, 5, 8 and 10. Their mean distance is known: 2.5 frames.
    told = frames_told(found)
    assert told == pytest.approx([0, 2.5, 5, 7.5, 10], abs=0.5)
    assert (repeats.near, repeats.exact) == (0, 0)
    assert repeats.pictures_per_s == pytest.approx(12, abs=1)
    repeats._cadence //= 1000
    assert "000 different pictures/s in 30000 frames/s" in repeats.remarks()[0]


@pytest.mark.parametrize("first", range(4))
@pytest.mark.parametrize(
    ("rate", "length"),
    [(30, 2), (30, 3), pytest.param(60, 3, marks=pytest.mark.slow), (60, 4), (30, 5)],
)
def test_repeats_are_recognised_whichever_frame_of_a_picture_is_the_first(
    rate: int, length: int, first: int
) -> None:
    """Most of the frames before the cadence is known may be repeats."""
    pictures = (np.arange(2 * rate) + first) // length
    found, repeats = answers(panned(2.0 * pictures, 0.003), rate)
    again = np.diff(pictures, prepend=-1) == 0
    assert repeats.near > 0.6 * again.sum()
    assert not any(kind == "N" for kind, repeat in zip(found, again, strict=True) if not repeat)


def test_a_few_exact_repeats_are_repeats_and_many_are_a_still_scene() -> None:
    repeats = Repeats(RepeatParams(longest_s=0.07))
    one, other = np.zeros((2, 2), np.float32), np.ones((2, 2), np.float32)
    shown = [one, one.copy(), other, other, other, other, other, one]
    found = [repeats.step(frame, ticks(index / 30)) for index, frame in enumerate(shown)]
    alone = Repeat(EXACT, passed_over=True)
    picture = Repeat()
    at_rest = Repeat(EXACT)
    assert found == [picture, alone, picture, alone, alone, RESTED, at_rest, picture]
    assert repeats.exact == 5


def test_a_change_at_the_border_is_no_exact_repeat() -> None:
    """Cells of 2 px leave out the last row and column of 31 x 31 px."""
    repeats = Repeats(RepeatParams())
    one = np.full((31, 31), 0.5, np.float32)
    other = one.copy()
    other[:, 30] = 0.6
    found = [repeats.step(luma, ticks(k / 30)) for k, luma in enumerate((one, other, other))]
    assert [repeat.kind for repeat in found] == ["", "", EXACT]


def stepped(levels: Sequence[float]) -> list[str]:
    """Return the remarks on uniform pictures of these luminances at 30 frames/s."""
    repeats = Repeats(RepeatParams())
    for k, level in enumerate(levels):
        repeats.step(np.full((4, 4), level, np.float32), ticks(k / 30))
    return repeats.remarks()


def test_remarks_on_pictures_without_change_or_contrast() -> None:
    level = np.linspace(0.5, 0.539, 31)
    assert "all luminance lies between 0.500 and 0.539" in stepped([*level])[0]
    assert stepped([*level, 0.541]) == []
    assert stepped([*level[:30]]) == []  # shorter than a second
    assert "all pictures are the same" in stepped([0.5] * 31)[0]
    assert stepped([0.4, *[0.5] * 31]) == []


def test_a_twentieth_of_repeats_makes_a_remark() -> None:
    repeats = Repeats(RepeatParams())
    assert repeats.pictures_per_s is None
    repeats._frames, repeats._pictures, repeats._cadence = 100, 15, ticks(2 / 3)
    for repeats._repeats, pictures in ((4, None), (5, 22.5)):
        assert repeats.pictures_per_s == pictures


def test_frames_that_are_dropped_hold_no_pictures() -> None:
    """Of 30 exact pictures/s in 60 frames/s most repeats and some pictures are dropped."""
    pictures = np.random.default_rng(1).random((91, 4, 4)).astype(np.float32)
    kept = [k for k in range(180) if k % 20 not in {1, 3, 6, 7, 9, 10, 11, 13, 17, 19}]
    repeats = Repeats(RepeatParams())
    for k in kept:
        repeats.step(pictures[k // 2], ticks(k / 60))
    assert repeats.pictures_per_s == pytest.approx(24, abs=0.5)  # 8 pictures in 20 frames
    assert "pictures/s in 30 frames/s" in repeats.remarks()[0]
    repeats.step(pictures[90], ticks(4))  # a pause is no part of the cadence
    repeats.step(pictures[89], ticks(4.1))
    assert repeats.pictures_per_s == pytest.approx(24, abs=0.5)


def test_a_picture_that_is_kept_stands_still_too() -> None:
    _, kept = answers([np.zeros((4, 4), np.float32)] * 31, handling="keep")
    assert (kept.exact, kept.still_s) == (30, 1)


def test_rests_are_no_repeats_that_make_a_cadence() -> None:
    """Four rests of 0.23 s, which is longer than a picture is repeated for."""
    lasts = np.resize([1, 8], 8)
    pictures = np.random.default_rng(1).random((9, 4, 4)).astype(np.float32)
    _, repeats = answers([*np.repeat(pictures[:8], lasts, axis=0), pictures[8]])
    assert not repeats.is_cadence


@pytest.mark.parametrize("rate", [12, 25, 30, 50, 60, 240])  # at 50, 0.18 s are 9 frames
def test_a_picture_is_repeated_for_a_limited_time_at_any_rate(rate: int) -> None:
    still = [np.zeros((4, 4), np.float32)] * rate
    shown, _ = answers(still, rate)
    repeats = Repeats(RepeatParams())
    passed = sum(repeats.step(frame, ticks(k / rate)).passed_over for k, frame in enumerate(still))
    assert passed == int(0.18 * rate)
    assert shown == "." + "e" * (rate - 1)


@pytest.mark.parametrize("first", range(5))
def test_spans_are_exact_wherever_they_begin(first: int) -> None:
    """Of 50 frames/s, nine repeats last for exactly 0.18 s."""
    pictures = np.random.default_rng(1).random((10, 4, 4)).astype(np.float32)
    repeats = Repeats(RepeatParams())
    found = [repeats.step(pictures[k // 10], ticks((first + k) / 50)) for k in range(100)]
    assert [repeat.passed_over for repeat in found] == ([False] + [True] * 9) * 10
    assert repeats.pictures_per_s == pytest.approx(5)


@pytest.mark.parametrize("crf", [23, pytest.param(28, marks=pytest.mark.slow), 35])
@pytest.mark.parametrize(
    ("rate", "pictures", "runs"), [(60, 30, {1}), (30, 12, {1, 2}), (50, 20, {1, 2})]
)
def test_pictures_that_are_coded_anew_are_repeats(
    tmp_path: Path, rate: int, pictures: int, runs: set[int], crf: int
) -> None:
    moving = panned(np.arange(2 * pictures) * 3.0, 0.01)
    shown = [moving[k * pictures // rate] for k in range(2 * rate)]
    found, repeats = answers(coded(tmp_path / "a.mp4", shown, rate, crf), rate)
    expected = [k * pictures // rate == (k - 1) * pictures // rate for k in range(2 * rate)]
    # The first repeats make the cadence; after them exactly the repeats are recognised.
    begun = 20
    assert [letter != "." for letter in found[begun:]] == expected[begun:]
    assert repeats.near > 0
    assert {len(run) for run in found[begun:-2].replace("E", "N").split(".") if run} == runs
    assert repeats.pictures_per_s == pytest.approx(pictures, rel=0.05)


@pytest.mark.long
@pytest.mark.parametrize("crf", [0, pytest.param(23, marks=pytest.mark.slow), 35])
def test_real_rest_is_not_taken_for_repeats(tmp_path: Path, crf: int) -> None:
    """Noise goes on at rest; motion that stops and goes on again does so slowly, or seldom."""
    shifts = np.concatenate([np.arange(30) * 3, [90] * 15, 90 + np.arange(30) * 3, [180] * 30])
    shown = panned(shifts.astype(float), 0.02)
    found, repeats = answers(coded(tmp_path / "a.mp4", shown, 30, crf))
    assert "N" not in found
    assert repeats.near == 0
    assert repeats.pictures_per_s is None


@pytest.mark.parametrize(
    ("apart", "moved_px", "cadence"),
    [(6, 0.4, True), (7, 0.4, False), (7, 0.01, True), (30, 0.01, True), (6, 1.5, False)],
)
def test_runs_far_apart_are_repeats_only_if_hardly_anything_changes(
    apart: int, moved_px: float, cadence: bool
) -> None:
    """A view moves by 3 px per frame, and by less in one frame of several."""
    steps = np.full(95, 3.0)
    steps[apart::apart] = moved_px
    found, _ = answers(noisy(panned(np.cumsum(steps))))
    assert ("N" in found) is cadence


SHAKEN = "controls/looming-with-shake", "controls/camera-shake"


def shaken(name: str, seed: int, shake_hz: float, shake_deg: float) -> list[Repeat]:
    """Return the repeats of a film that a camera that shakes takes."""
    motion = {"shake_deg": shake_deg, "shake_hz": shake_hz}
    changes = {f"scene.motion.{key}": value for key, value in motion.items()} | {"seed": seed}
    repeats = Repeats(RepeatParams())
    video = StimulusVideo(load_all(name, changes)[0], 240)
    return [repeats.step(frame.luma, frame.time) for frame in video]


@pytest.mark.long
@pytest.mark.parametrize("film", [(SHAKEN[0], 11, 5, 0.8), (SHAKEN[1], 12, 3, 0.8)])
def test_a_camera_that_shakes_shows_no_repeats(film: tuple[str, int, float, float]) -> None:
    """Where it turns back, pictures change little; without a cadence they keep their times."""
    for repeat in shaken(*film):
        assert (repeat.kind in {"", EXACT}, repeat.shift) == (True, 0)


@pytest.mark.slow
def test_of_many_films_of_a_camera_that_shakes_few_show_repeats() -> None:
    degrees = 0.1, 0.2, 0.3, 0.4, 0.6, 0.8, 1.2
    films = itertools.product(SHAKEN, (11, 12, 13, 14), (3, 5, 8), degrees)
    assert sum(any(repeat.kind == NEAR for repeat in shaken(*film)) for film in films) == 9


@pytest.mark.parametrize(
    ("speed", "crf", "sigma"),
    [
        # Noise that is coded without loss takes longest.
        pytest.param(
            *case, marks=pytest.mark.slow if case[1:] == (0, 0.01) or case[1] == 28 else ()
        )
        for case in itertools.product((0.1, 0.5), (0, 28, 35), (0.0, 0.01))
    ],
)
def test_a_slow_pan_is_not_taken_for_repeats(
    tmp_path: Path, speed: float, crf: int, sigma: float
) -> None:
    shown = coded(tmp_path / "a.mp4", panned(np.arange(75) * speed, sigma), 30, crf)
    assert answers(shown)[1].near == 0


@pytest.mark.parametrize("crf", [0, 28])
@pytest.mark.parametrize("seconds", [1.0, 2.5])
def test_a_fade_is_not_taken_for_repeats(tmp_path: Path, seconds: float, crf: int) -> None:
    [picture] = panned([0.0])
    levels = np.linspace(1, 0, int(30 * seconds))
    frames = [(picture * level).astype(np.float32) for level in levels]
    assert answers(coded(tmp_path / "a.mp4", frames, 30, crf))[1].near == 0


@pytest.mark.parametrize("crf", [pytest.param(0, marks=pytest.mark.slow), 28])
@pytest.mark.parametrize("sigma", [0.01, 0.05])
def test_noise_alone_is_not_taken_for_repeats(tmp_path: Path, sigma: float, crf: int) -> None:
    shown = panned([0.0] * 75, sigma)
    assert answers(coded(tmp_path / "a.mp4", shown, 30, crf))[1].near == 0


def test_motion_that_stops_in_a_cadence_is_seen_at_rest() -> None:
    """The detectors see it at the rate of the pictures at first, and then every frame."""
    moving = panned(np.arange(12) * 3.0, 0.001)
    tail = panned([33.0] * 20, 0.001)
    shown = [frame for frame in moving for _ in range(2)][:-1] + tail
    found, _ = answers(noisy(shown))
    assert found == "......" + ".N" * 11 + "." * 15


def test_one_picture_that_was_held_for_long_does_not_make_the_cadence_slower() -> None:
    """Each picture comes twice, one four times: at rest every third frame is seen.

    Pictures at even intervals are repeated equally often, or once more.
    """
    lasts = [2] * 11 + [1]
    lasts[6] = 4
    moving = panned(np.arange(12) * 3.0, 0.001)
    shown = [*np.repeat(moving, lasts, axis=0), *panned([33.0] * 10, 0.001)]
    found, _ = answers(noisy(shown))
    assert found == ".......N.N.N.N.N.N.N.N.N." + "NN." * 2 + "...."


def test_an_object_that_moves_on_is_no_repeat_where_the_rest_stops() -> None:
    """The mean of P falls far below the usual, but not where the object moves."""
    ground = panned(np.repeat(np.arange(20), 2) * 3.0)
    for index, frame in enumerate(ground):
        frame[40:80, 40 + 2 * index : 44 + 2 * index] = index % 2
    assert answers(ground)[1].near == 0


def test_a_cadence_is_forgotten_two_seconds_after_its_end() -> None:
    shifts = np.concatenate([np.repeat(np.arange(10), 2), np.arange(10, 80)]) * 3.0
    begun = panned(shifts, 0.001)
    again = panned([begun_at := 79 * 3.0, begun_at, begun_at + 3, begun_at + 6], 0.001)
    found, _ = answers([*begun, *again])
    assert "N" in found[:20]
    assert "N" not in found[20:]


def test_exact_repeats_only_or_none(tmp_path: Path) -> None:
    moving = panned(np.arange(30) * 3.0, 0.01)
    shown = coded(tmp_path / "a.mp4", [frame for frame in moving for _ in range(2)], 60, 28)
    shown[40] = shown[39]
    near, _ = answers(shown, 60)
    exact, counted = answers(shown, 60, handling=EXACT)
    kept, seen = answers(shown, 60, handling="keep")
    assert "N" in near
    assert set(exact) <= {".", "e", "E"}
    assert counted.exact == seen.exact >= 1
    assert counted.near == 0
    assert set(kept) == {"."}
