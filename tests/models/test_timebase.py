"""The time base: the same scene at other frame rates, and times that are wrong."""

from __future__ import annotations

import itertools
import math
from fractions import Fraction
from functools import cache
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from oppload_cli import run
from oppload_cli.errors import FrameError, ParameterError
from oppload_cli.models import opplod_reference
from oppload_cli.models.bank import DetectorBank
from oppload_cli.models.dlgmd import DlgmdParams
from oppload_cli.models.dpc import DpcParams, excitation, referred
from oppload_cli.models.layers import Layers, Photoreceptors
from oppload_cli.models.opplod import Opplod, OpplodParams
from oppload_cli.models.opplod_lplc2 import OpplodLplc2, OpplodLplc2Params
from oppload_cli.models.opplod_paper import OpplodPaper
from oppload_cli.models.opplod_reference import OpplodReference, OpplodReferenceParams
from oppload_cli.models.registry import parameters_of
from oppload_cli.models.timebase import Clock, TimeParams, nearly_one
from oppload_cli.models.units import has_history
from oppload_cli.pipeline.analysis import analyse
from oppload_cli.pipeline.sources import StimulusVideo
from oppload_cli.stimulus.catalogue import load
from oppload_cli.stimulus.renderer import frames
from tests.media import disk

if TYPE_CHECKING:
    from collections.abc import Sequence

    from oppload_cli.models.detector import Response
    from tests.media import Luma

pytestmark = pytest.mark.once

SIZE = 120


def edge_at(x: float, width: int = 160, height: int = 40) -> Luma:
    return np.tile(np.clip(x - np.arange(width), 0, 1).astype(np.float32), (height, 1))


def seen(times: Sequence[float], frames: Sequence[Luma]) -> Photoreceptors:
    clock = Clock()
    layer = Photoreceptors(frames[0].shape, clock)
    for time_s, frame in zip(times, frames, strict=True):
        clock.time_s = time_s
        layer.step(frame)
    return layer


def numbered(count: int) -> list[Luma]:
    """Frames whose difference shows which two frames were compared."""
    return [np.full((2, 3), 0.001 * t**2, np.float32) for t in range(count)]


# ---- Which frames are compared -------------------------------------------------------------


@pytest.mark.parametrize(
    ("rate", "back", "share"),
    [
        (10, 1, 1 / 3), (15, 1, 0.5), (24, 1, 0.8), (25, 1, 5 / 6), (29.97, 1, 1), (30, 1, 1),
        (34, 1, 34 / 30), (36, 1, 1.2), (40, 2, 2 / 3), (50, 2, 5 / 6), (60, 2, 1), (90, 3, 1),
        (100, 4, 5 / 6), (120, 4, 1), (240, 8, 1), (490, 16, 1),
    ],
)  # fmt: skip
def test_each_frame_is_compared_with_that_one_interval_earlier(
    rate: float, back: int, share: float
) -> None:
    count = 3 * back + 2
    frames = numbered(count)
    layer = seen([t / rate for t in range(count)], frames)
    assert layer.ready
    assert layer.share == pytest.approx(share, rel=1e-6)
    for age, change in enumerate(layer.maps):
        now = count - 1 - age * back
        np.testing.assert_array_equal(change, frames[now] - frames[now - back])
    assert layer.luma_change == pytest.approx(float(layer.maps[0].mean()) * layer.share)


def test_a_frame_that_was_dropped_makes_the_interval_longer() -> None:
    frames = numbered(8)
    kept = [0, 1, 2, 3, 5, 6, 7]
    layer = seen([t / 30 for t in kept[:5]], [frames[t] for t in kept[:5]])
    assert [layer.share, layer.elapsed] == pytest.approx([0.5, 2])
    changes = [frames[5] - frames[3], frames[3] - frames[2], frames[2] - frames[1]]
    np.testing.assert_array_equal(layer.maps, changes)
    layer = seen([t / 30 for t in kept], [frames[t] for t in kept])
    assert (layer.share, layer.elapsed) == (1, 1)
    # Each mean is scaled by the length of its own interval: that of the third was twice as long.
    means = [float(change.mean()) for change in layer.maps]
    assert layer.means == pytest.approx([means[0], means[1], means[2] / 2])


@pytest.mark.parametrize(("before", "share"), [(1.2, 1 / 1.9), (1.1, 1 / 0.8)])
def test_a_frame_may_be_too_young_by_a_quarter_of_an_interval(before: float, share: float) -> None:
    """Else the frame 1.9 intervals ago counts, though it is three times further from one."""
    layer = seen([0, before / 30, 1.9 / 30], numbered(3))
    assert layer.share == pytest.approx(share)


def test_luminance_above_2_in_the_first_frames_is_an_error() -> None:
    layer = Photoreceptors((2, 3))
    for _ in range(3):
        with pytest.raises(FrameError, match="divide 8-bit values by 255"):
            layer.step(np.full((2, 3), 2.1, np.float32))
        layer.step(np.full((2, 3), 2, np.float32))
    layer.step(np.full((2, 3), 2.1, np.float32))


def test_after_a_gap_the_frame_before_it_counts() -> None:
    times = [t / 120 for t in range(12)]
    layer = seen([*times, 1.0], numbered(13))
    np.testing.assert_array_equal(layer.maps[0], numbered(13)[12] - numbered(13)[11])


def test_of_very_many_frames_some_are_kept() -> None:
    layer = seen([t / 3000 for t in range(400)], numbered(400))
    assert layer.ready
    assert layer.share == pytest.approx(1, rel=0.07)
    assert len(layer._lumas) <= 18


# ---- Rounded times -------------------------------------------------------------------------


WRITTEN_RATES = 24, 25, 29.97, 30, 48, 50, 59.94, 60, 75, 90, 100, 119.88, 120, 240


def times_in_files(rate: float, count: int) -> list[list[float]]:
    """Exact times, the same from a later start, and the same in whole microseconds and in ms."""
    exact = [t / rate for t in range(count)]
    rounded = ([round(time_s / unit) * unit for time_s in exact] for unit in (1e-6, 1e-3))
    return [exact, [time_s + 12.345 for time_s in exact], *rounded]


def frames_back(rate: float, ages: Sequence[float]) -> set[int]:
    """How many frames ago these numbers of intervals are."""
    return {round(age * rate / 30) for age in ages}


@pytest.mark.parametrize("rate", WRITTEN_RATES)
def test_rounded_times_do_not_choose_which_frames_are_compared(rate: float) -> None:
    found = []
    for times in times_in_files(rate, 6 * math.ceil(rate / 30)):
        clock, ages = Clock(), list[float]()
        layer = Photoreceptors((1, 1), clock)
        for t, clock.time_s in enumerate(times):
            layer.step(np.full((1, 1), 0.01 * (t % 50), np.float32))
            if layer.ready and layer._latest.before:
                ages.append(layer._latest.at - layer._latest.before.at)
        found.append(frames_back(rate, ages))
    assert found == [found[0]] * len(found)
    assert len(found[0]) == 1


@pytest.mark.parametrize("rate", WRITTEN_RATES)
def test_rounded_times_do_not_choose_which_suppression_is_that_of_an_interval_ago(
    rate: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each suppression follows from that of the youngest frame that is an interval old."""
    found = []
    for times in times_in_files(rate, 50):
        model, ages = OpplodLplc2((24, 24)), list[float]()
        nothing = np.zeros_like(model.units.responses)
        monkeypatch.setattr(model, "pooled", lambda _, nothing=nothing: (nothing, [nothing] * 4))
        for before, now in itertools.pairwise(times):
            photoreceptors = SimpleNamespace(elapsed=nearly_one(30 * (now - before)))
            layer = SimpleNamespace(photoreceptors=photoreceptors)
            hold = SimpleNamespace(layer=layer, step=lambda _: True)
            monkeypatch.setattr(model, "_dpc", hold)
            model.step(np.zeros((24, 24), np.float32))
            ages.append(model._now - model._suppressions[0][0])
        found.append(frames_back(rate, ages[20:]))
    assert found == [found[0]] * len(found)
    assert len(found[0]) == 1


# ---- What is kept of earlier frames --------------------------------------------------------


def test_before_the_first_comparison_frames_like_the_first_are_at_rest() -> None:
    first, second = numbered(2)
    layer = seen([t / 120 for t in range(4)], [first, first, second, second])
    assert layer._rest == 0.25


def test_only_the_frames_of_the_latest_intervals_are_kept() -> None:
    frame, chain = seen([t / 30 for t in range(20)], numbered(20))._latest, 0
    while frame.before:  # the frame that it was compared with
        frame, chain = frame.before, chain + 1
    assert chain == 3


def test_coarse_changes_are_means_over_squares_centred_in_the_frame() -> None:
    now = np.random.default_rng(5).random((11, 14), dtype=np.float32)
    layer = seen([0, 1 / 30], [np.zeros_like(now), now])
    expected = now[1:9, 1:13].reshape(2, 4, 3, 4).mean(axis=(1, 3))
    np.testing.assert_allclose(layer.coarse((2, 3))[0], expected, rtol=1e-6)
    np.testing.assert_allclose(layer.coarse((1, 1))[0], now[:, 1:12].mean(), rtol=1e-6)
    # More squares than pixels.
    np.testing.assert_allclose(layer.coarse((22, 28))[0][::2, ::2], now, atol=1e-6)


def test_times_that_stand_still_or_go_back_count_as_steps() -> None:
    clock = Clock(frame_rate=60)
    clock.time_s = 1.0
    assert clock.now(None) == pytest.approx(30)
    assert clock.now(30.0) == 30.5
    clock.time_s = 0.5
    assert clock.now(30.5) == 31
    clock.time_s = None
    assert clock.now(31.0) == 31.5


def test_a_clock_that_counts_frames_has_the_frame_rate_and_no_times() -> None:
    clock = Clock(TimeParams(interval="frame"), 60)
    assert (clock.per_second, clock.step) == (60, 1)
    for count, clock.time_s in enumerate((0.05, 0.9, 7.0)):
        assert clock.now(count - 1.0 if count else None) == count
    for interval in ("frame", "1/30"):
        clock = Clock(TimeParams(interval=interval))
        assert (clock.per_second, clock.step) == (30, 1)


@pytest.mark.parametrize("rate", [0.0, -30, math.inf, math.nan, "30", [30]])
def test_a_wrong_frame_rate_does_not_count_as_an_unknown_one(rate: Any) -> None:
    said = "^frame_rate must be a finite number above 0, not .*; leave it out if it is not known$"
    with pytest.raises(ParameterError, match=said):
        Opplod((60, 80), frame_rate=rate)
    with pytest.raises(ParameterError, match=said):
        DetectorBank((60, 80), [OpplodParams()], frame_rate=rate)
    assert Opplod((60, 80), frame_rate=Fraction(60)).layers.clock.step == 0.5


def test_a_step_within_3_percent_of_an_interval_is_an_interval() -> None:
    assert [nearly_one(ratio) for ratio in (0.969, 0.971, 1.029, 1.031)] == [0.969, 1, 1, 1.031]
    assert [Clock(frame_rate=rate).step for rate in (29.97, 24)] == [1, 1.25]


@pytest.mark.parametrize("rate", [10, 30, 240])
def test_frames_are_counted_where_the_interval_is_a_frame(rate: int) -> None:
    frames = [disk(SIZE, 60, 60, 10 + t) for t in range(6)]
    params = [OpplodReferenceParams(), DlgmdParams()]
    bank = DetectorBank((SIZE, SIZE), params, rate, TimeParams(interval="frame"))
    plain = DetectorBank((SIZE, SIZE), params)
    for t, frame in enumerate(frames):
        assert bank.step(frame, t / rate) == plain.step(frame)


@pytest.mark.parametrize("value", ["", "0", "-1", "1/0", "nan", "11", "frames", "1e-5"])
def test_an_interval_is_frame_or_seconds(value: str) -> None:
    with pytest.raises(ParameterError, match="'interval' of time must be 'frame', or"):
        TimeParams(interval=value)


def test_a_time_base_that_is_not_stated_is_that_of_the_detector() -> None:
    assert TimeParams().per_second == 30.0
    assert TimeParams(interval="0.04").per_second == 25.0
    assert TimeParams().of("frame").per_second is None
    assert TimeParams(interval="0.04").of("frame").per_second == 25.0
    assert OpplodPaper.interval == "frame"
    assert {Opplod.interval, OpplodReference.interval, OpplodLplc2.interval} == {"1/30"}


@pytest.mark.parametrize(("interval", "counts"), [(None, True), ("1/30", False), ("frame", True)])
def test_the_paper_counts_frames_unless_an_interval_is_stated(
    interval: str | None, counts: bool
) -> None:
    """Beside a detector with a time base of its own, which it does not disturb."""
    shown = [disk(60, 30, 30, 6 + 3 * t) for t in range(8)]
    answers = []
    for rate in (30, 75):
        params = [OpplodPaper.parameters(), DlgmdParams()]
        bank = DetectorBank((60, 60), params, rate, TimeParams(interval=interval))
        alone = DetectorBank((60, 60), [DlgmdParams()], rate, TimeParams(interval=interval))
        found = [bank.step(frame, t / rate) for t, frame in enumerate(shown)]
        assert [answer["dlgmd"] for answer in found] == [
            alone.step(frame, t / rate)["dlgmd"] for t, frame in enumerate(shown)
        ]
        answers.append([answer["opplod_paper"] for answer in found])
    assert any(answer.response > 0 for answer in answers[0] if answer)
    assert (answers[0] == answers[1]) == counts


# ---- Other intervals -----------------------------------------------------------------------


def edge_sums(speed: float) -> tuple[float, float]:
    """E and S of the passing pathway, per pixel of an edge's length, over phases of a pixel."""
    found = []
    for phase in np.arange(8) / 8:
        dpc = Layers((40, 160)).dpc(DpcParams(), (0, 90)).layer
        for t in range(4):
            dpc.step(edge_at(40 + phase + speed * t))
        e = excitation(dpc.photoreceptors.maps, dpc.kernels)
        found.append([float(layer[20].sum()) for layer in (e, dpc.sums.pathways[0])])
    return tuple(np.mean(found, axis=0))


@pytest.mark.parametrize("speed", [1, 2, 3, 5, 10])
@pytest.mark.parametrize("share", [0.5, 0.8])
def test_s_of_an_edge_is_referred_to_one_interval(speed: float, share: float) -> None:
    e, s = edge_sums(speed / share)
    _, expected = edge_sums(speed)
    assert referred(s, e, share, directional=True) == pytest.approx(expected, rel=0.08)
    # The same in the other direction: the actual interval is too short.
    back = referred(expected, e * share, 1 / share, directional=True)
    assert back == pytest.approx(s, rel=0.12)


@pytest.mark.parametrize("speed", [0.5, 3])
def test_pooled_motion_is_referred_to_one_interval(
    speed: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The same edge at 30, 15 and 36 frames/s; the slow one has S of the square of its speed."""
    params = OpplodReferenceParams(receptive_field=100, cell=8, axes=0, history=0)
    pooling = OpplodReference((40, 160), params)
    arms = OpplodLplc2((40, 160), OpplodLplc2Params(receptive_field=200, cell=11))
    pooled: list[Luma] = []

    def products(maps: Luma, _: Luma) -> Luma:
        pooled.append(maps[0])
        return maps

    monkeypatch.setattr(opplod_reference, "opponent_products", products)
    amounts = {rate: np.zeros(2) for rate in (30, 15, 36)}
    for rate, phase in itertools.product(amounts, np.arange(4) / 4):
        layers = Layers((40, 160), Clock())
        dpc = layers.dpc(DpcParams(), (0, 90))
        for t in range(4):
            layers.clock.time_s = t / rate
            dpc.step(edge_at(60 + phase + speed * t * 30 / rate))
        pooling._opponency(dpc.layer)
        amounts[rate] += arms.pooled(dpc.layer)[0].sum(), pooled[-1].sum()
    assert amounts[30].min() > 0
    assert amounts[15] == pytest.approx(amounts[30], rel=0.1)
    assert amounts[36] == pytest.approx(amounts[30], rel=0.15)


def test_s_over_the_reference_interval_stays_as_it_is() -> None:
    assert referred(0.3, 0.7, 1.0, directional=True) == pytest.approx(0.3)


def responses(rate: float, name: str) -> dict[float, Response]:
    """The answers to a disk that grows faster and faster, from 0.2 to 7/15 s."""
    bank = DetectorBank((SIZE, SIZE), [parameters_of(name)])
    answers = {}
    for t in range(1 + int(rate * 7 / 15 + 1e-9)):
        radius = 5 + 500 * max(0.0, t / rate - 0.2) ** 2
        answer = bank.step(disk(SIZE, 60, 60, radius), t / rate)[name]
        if answer is not None:
            answers[t / rate] = answer
    return answers


@pytest.mark.parametrize("name", ["opplod_reference", "dlgmd"])
@pytest.mark.parametrize(("rate", "most"), [(24, 1.4), (50, 1.25), (60, 1.25), (120, 1.25)])
def test_a_looming_disk_has_the_same_peak_at_any_rate(name: str, rate: float, most: float) -> None:
    here, there = (
        max(answer.response for answer in responses(either, name).values())
        for either in (rate, 30.0)
    )
    assert 1 / most <= here / there <= most


@pytest.mark.long
def test_a_shorter_interval_sees_faster_motion_as_1_30_s_sees_slower_motion() -> None:
    """The same frames at 3.3 times the rate, over 0.01 s; the growth is 3.3 times as fast."""
    display = {"display.frame_rate": 150, "display.width": 120, "display.height": 120}
    slow = load("klapoetke2017/loom-l-over-v/l-over-v-40", display)
    shown = np.stack([frame.grey for frame in frames(slow)])[225:]  # half a second before contact
    shares = {"opplod": 10 / 3, "opplod_reference": 1, "dlgmd": 1}
    slower, faster = (
        run(
            shown,
            rate=rate,
            models=list(shares),
            settings={"time.interval": str(interval), "opplod.growth_memory_s": 3 * interval},
            height=120,
            rmo=False,
        ).summary
        for rate, interval in ((150, 1 / 30), (500, 0.01))
    )
    for name, share in shares.items():
        assert slower[name]["peak"] > 0
        assert faster[name]["peak_frame"] == slower[name]["peak_frame"]
        assert faster[name]["peak"] == pytest.approx(share * slower[name]["peak"], rel=1e-5)


@cache
def approach_seen_by_opplod(rate: int, l_over_v_ms: int) -> tuple[float, float]:
    """The largest response, and when the alarm began, in s."""
    changes = {"disk.growth.l_over_v_ms": l_over_v_ms, "display.frame_rate": rate}
    video = StimulusVideo(load("klapoetke2017/loom-l-over-v", changes), 240)
    records = list(analyse(video, [OpplodParams()], rmo=None))
    peak = max(answer.response for record in records if (answer := record["opplod"].answer))
    return peak, next(record.time_s for record in records if record["opplod"].alarm)


@pytest.mark.long
@pytest.mark.parametrize(
    ("rate", "l_over_v_ms"),
    [
        pytest.param(*case, marks=() if case in {(10, 40), (24, 40)} else pytest.mark.slow)
        for case in itertools.product((10, 12, 15, 24), (40, 80))
    ],
)
def test_few_frames_per_second_keep_half_of_the_peak(rate: int, l_over_v_ms: int) -> None:
    """The response is about the third power of the growth, of which half is kept."""
    peak, began_s = approach_seen_by_opplod(rate, l_over_v_ms)
    usual_peak, usual_s = approach_seen_by_opplod(30, l_over_v_ms)
    assert 0.5 <= peak / usual_peak <= 1.2
    assert abs(began_s - usual_s) <= 1 / rate + 1e-6


RATES = (60, *(pytest.param(rate, marks=pytest.mark.slow) for rate in (90, 120)), 240)


@pytest.mark.parametrize("name", ["opplod_reference", "dlgmd"])
@pytest.mark.parametrize("rate", RATES)
def test_frames_between_change_nothing_at_the_same_times(name: str, rate: int) -> None:
    here = {
        round(30 * time_s, 6): found.response for time_s, found in responses(rate, name).items()
    }
    there = [answer.response for answer in responses(30, name).values()]
    assert max(there) > 0
    assert [here[number] for number in range(3, 3 + len(there))] == there


@pytest.mark.parametrize("rate", RATES)
def test_frames_between_change_nothing_for_the_slow_suppression(rate: int) -> None:
    """The suppression of opplod_lplc2 follows from its value an interval ago."""
    name = "opplod_lplc2"
    here = {
        round(30 * time_s, 6): found.response for time_s, found in responses(rate, name).items()
    }
    there = [answer.response for answer in responses(30, name).values()]
    assert max(there) > 0.1
    assert [here[number] for number in range(3, 3 + len(there))] == pytest.approx(there, rel=1e-5)


@pytest.mark.parametrize("rate", [60, 120])
def test_the_slow_suppression_begins_alike_at_any_rate(rate: int) -> None:
    """Suppression in a video's first interval is as strong as after a complete interval."""
    found = []
    for either in (30, rate):
        bank = DetectorBank((SIZE, SIZE), [OpplodLplc2Params()])
        shown = [disk(SIZE, 60, 60, 10 + 60 * t / either) for t in range(either // 6 + 1)]
        answers = [bank.step(frame, t / either)["opplod_lplc2"] for t, frame in enumerate(shown)]
        found.append([answer.response for answer in answers[:: either // 30] if answer])
    assert len(found[0]) == 3
    assert found[1] == pytest.approx(found[0], rel=1e-5)


@pytest.mark.parametrize("rate", [8, 10, 12, 15, 20, 30, 60])
def test_pictures_rarer_than_the_video_says_are_seen_at_their_own_rate(rate: int) -> None:
    """The size of the smaller frame follows from the presentation times, in time for a response."""
    series = []
    for declared in (30, rate):
        clock = Clock(frame_rate=declared)
        model = Opplod((SIZE, SIZE), layers=Layers((SIZE, SIZE), clock))
        found = []
        for t in range(18):
            clock.time_s = t / rate
            answer = model.step(disk(SIZE, 60, 60, 3 + 48 * (t / 18) ** 2))
            found.append(answer.opponency if answer else 0.0)
        series.append(found)
    one, other = series
    assert min(one[-8:]) > 0
    assert one == pytest.approx(other, rel=1e-6)


# ---- Rest ----------------------------------------------------------------------------------


def test_motion_has_a_history_where_something_moved_nearby() -> None:
    now, one, two = np.zeros((3, 40, 40), np.float32)
    now[20, 20] = 1
    one[20, 15] = two[25, 25] = 0.13
    assert has_history([now, one, two], 0.125).all()
    unknown = ~has_history([now, one, two], 0.14)
    assert unknown.sum() == 9
    assert unknown[19:22, 19:22].all()
    one[:] = 0
    one[20, 13] = 1  # seven cells from the cell that moves
    assert not has_history([now, one, two], 0.125)[20, 20]


def test_a_pause_before_changes_nothing() -> None:
    moving = [disk(SIZE, 60, 60, 5 + 5 * t) for t in range(12)]
    series = []
    for pause in (0, 7):
        layers = Layers((SIZE, SIZE))
        bank = DetectorBank((SIZE, SIZE), [OpplodReferenceParams()])
        assert layers.time_s is None
        shown = [moving[0]] * pause + moving
        answers = [bank.step(frame, t / 30)["opplod_reference"] for t, frame in enumerate(shown)]
        series.append([answer.response if answer else 0.0 for answer in answers[pause:]])
    without, paused = series
    assert max(without) > 0
    np.testing.assert_allclose(paused, without, atol=1e-4 * max(without))
    assert max(paused[:3]) < 1e-4 * max(without)


@pytest.mark.long
@pytest.mark.parametrize(
    "rate", [25, *(pytest.param(rate, marks=pytest.mark.slow) for rate in (30, 36, 50, 100)), 120]
)
def test_a_pause_before_changes_nothing_with_growth(rate: int) -> None:
    moving = [disk(240, 120, 120, 2 + 48 * t / rate) for t in range(round(0.8 * rate))]
    series = []
    for pause in (0, round(0.4 * rate)):
        bank = DetectorBank((240, 240), [OpplodParams()])
        shown = [moving[0]] * pause + moving
        answers = [bank.step(frame, t / rate)["opplod"] for t, frame in enumerate(shown)]
        series.append([answer.response if answer else 0.0 for answer in answers[pause:]])
    without, paused = series
    assert max(without) > 2e-3
    assert paused == pytest.approx(without, abs=1e-6)


def test_an_object_that_sets_off_sideways_answers_nothing() -> None:
    """With history=0 all edges of the object excite all pathways."""
    moving = [disk(SIZE, 40 + 4 * t, 60, 20) for t in range(3)]
    largest = []
    for history in (0.0, 0.125):
        bank = DetectorBank((SIZE, SIZE), [OpplodReferenceParams(history=history)])
        shown = [moving[0]] * 5 + moving
        answers = [bank.step(frame)["opplod_reference"] for frame in shown]
        largest.append(max(answer.response for answer in answers if answer))
    assert largest[1] < 0.01 * largest[0]


def test_times_may_be_numpy_numbers() -> None:
    frames = [disk(SIZE, 60, 60, 10 + 6 * t) for t in range(5)]
    answers = []
    for kind in (float, np.float64):
        bank = DetectorBank((SIZE, SIZE), [OpplodReferenceParams()])
        answers.append([bank.step(frame, kind(t / 20)) for t, frame in enumerate(frames)])
    assert answers[0] == answers[1]
