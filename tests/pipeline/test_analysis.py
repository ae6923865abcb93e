from __future__ import annotations

import copy
import pickle
import re
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from fractions import Fraction
from functools import cache
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import pytest

from oppload_cli import (
    Analysis,
    Dlgmd,
    DlgmdParams,
    FrameRecord,
    OpplodLplc2Response,
    OpplodParams,
    OpplodReferenceParams,
    RmoMetrics,
    analyse,
    open_video,
    parameters_of,
    run,
    stimulus,
)
from oppload_cli.errors import FrameError, OpploadError, ParameterError, SourceError
from oppload_cli.models.bank import DetectorBank
from oppload_cli.models.detector import Box, Response
from oppload_cli.models.frame_difference import FrameDifferenceParams
from oppload_cli.models.timebase import TimeParams
from oppload_cli.models.units import CellDetector
from oppload_cli.pipeline.one_pass import _in_source
from oppload_cli.pipeline.sources import ArrayLuminance, StimulusVideo, open_source
from oppload_cli.results.alarm_log import AlarmLog
from oppload_cli.video.frames import WorkingSize
from oppload_cli.video.inputs import checked_rate
from oppload_cli.video.span import Span, parse_position
from tests.detection.showing import approaching
from tests.media import disk, looming, texture, write_video

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from oppload_cli.frames.preparation import Prepared
    from oppload_cli.schema import Parameters

    Frames = NDArray[np.uint8]

REFERENCE = OpplodReferenceParams()


def records(
    path: Path, params: Sequence[Parameters] | None = None, *, height: int | None = None
) -> list[FrameRecord]:
    with open_video(path, height=height) as video:
        return list(analyse(video, params))


def answers(record: FrameRecord) -> dict[str, Response | None]:
    return {name: said.answer for name, said in record.detectors.items()}


def eight_bits(frames: list[np.ndarray]) -> list[np.ndarray]:
    return [(frame * 255).round().astype(np.uint8) for frame in frames]


@pytest.mark.parametrize(
    "params", [[REFERENCE, DlgmdParams()], [OpplodParams()]], ids=["reference", "opplod"]
)
def test_content_that_is_slower_than_its_file_answers_as_it_would_at_its_own_rate(
    tmp_path: Path, params: list[Parameters]
) -> None:
    frames = eight_bits(looming(120, 60, 60, 10))
    own = records(write_video(tmp_path / "own.mkv", frames, rate=10), params)
    thrice = [frame for frame in frames for _ in range(3)]
    copied = records(write_video(tmp_path / "copied.mkv", thrice, rate=30), params)
    # The second picture has no response: the first one may have stood still.
    assert [answers(record) for record in copied[6::3]] == [answers(record) for record in own[2:]]
    assert not any(said.response for said in copied[3].detectors.values())
    assert sum(each.repeat == "exact" for each in copied) == 20
    assert [each.luma_change for each in copied[1:3]] == [0, 0]
    # After two repeated pictures, each repeat has the response of its picture.
    for first in range(6, 30, 3):
        picture, *again = copied[first : first + 3]
        for record in again:
            assert answers(record) == answers(picture)
            assert [said.alarm for said in record.detectors.values()] == [
                said.alarm for said in picture.detectors.values()
            ]
            assert (record.luma_change, record.rmo) == (0, picture.rmo)


@pytest.mark.parametrize(("crf", "most"), [(23, 0.08), (35, 0.3)])
def test_pictures_that_are_coded_anew_answer_as_they_would_at_their_own_rate(
    tmp_path: Path, crf: int, most: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The detectors do not get the repeats; only the coding of the pictures differs.

    Pictures in between are left out, because optical flow follows the errors of the encoder.
    """
    monkeypatch.setattr(CellDetector, "interpolates", False)
    frames = eight_bits([frame * 0.8 + 0.1 for frame in looming(240, 120, 120, 16)])
    twice = [frame for frame in frames for _ in range(2)]
    own, shown = (
        records(
            write_video(
                tmp_path / f"{rate}.mp4",
                pictures,
                codec="libx264",
                pixel_format="yuv420p",
                rate=rate,
                options={"crf": str(crf)},
            ),
            [REFERENCE],
        )
        for rate, pictures in ((15, frames), (30, twice))
    )
    assert all(record.repeat for record in shown[9::2])
    assert "near" in {record.repeat for record in shown}
    values = [
        [said.response for record in found if (said := record["opplod_reference"]).answer]
        for found in (own[6:], shown[12::2], shown[13::2])
    ]
    assert values[1] == pytest.approx(values[0], rel=most)
    assert values[2] == values[1]


def test_names_stand_for_the_default_parameters() -> None:
    shown = looming(60, 30, 30, 16)
    names, sets = (
        [answers(record) for record in analyse(shown, models, rate=30, rmo=False)]
        for models in (
            ["lgmd2", "opplod_reference"],
            [parameters_of("lgmd2"), parameters_of("opplod_reference")],
        )
    )
    assert names == sets
    assert list(names[0]) == ["lgmd2", "opplod_reference"]


VERSIONS = "opplod", "opplod_reference", "opplod_paper", "opplod_lplc2", "dlgmd"


@pytest.mark.long
@pytest.mark.parametrize(
    "case", ["30 frames/s", "12 frames/s", "3:2 copies", "after a rest", "upright"]
)
def test_a_detector_answers_alike_alone_and_beside_all_others(case: str) -> None:
    """At two working heights and two time bases, also with pictures in between."""
    rate = 12 if case == "12 frames/s" else 30
    ground = texture(96, 128, 3) * np.float32(0.4) + np.float32(0.6)
    radii = [12 / (1.1 - t / rate) for t in range(round(0.95 * rate))]
    shown = np.array([np.minimum(ground, disk(128, 56, 40, radius)[:96]) for radius in radii])
    if case == "3:2 copies":
        shown, rate = np.repeat(shown[::2], [2, 3] * (len(shown[::2]) // 2), axis=0), 60
    elif case == "after a rest":
        shown = np.concatenate([np.repeat(shown[:1], 14, axis=0), shown])
    elif case == "upright":
        shown = np.ascontiguousarray(shown.transpose(0, 2, 1))
    frames = (shown * 255).round().astype(np.uint8)
    together = list(analyse(frames, VERSIONS, rate=rate, rmo=False))
    for name in VERSIONS:
        alone = list(analyse(frames, [name], rate=rate, rmo=False))
        assert [record[name] for record in together] == [record[name] for record in alone], name
        assert [(record.luma_change, record.blind) for record in together] == [
            (record.luma_change, record.blind) for record in alone
        ]
        assert max(record[name].response or 0 for record in alone) > 0
    assert not any(record["opplod_paper"].alarm for record in together)


def test_frames_one_by_one_have_the_heights_of_their_detectors() -> None:
    frames = np.array(looming(120, 60, 60, 12))
    expected = list(analyse(frames, VERSIONS, rate=30, rmo=False))
    analysis = Analysis((120, 120), VERSIONS, rate=30)
    assert [analysis.step(frame, t / 30) for t, frame in enumerate(frames)] == expected
    models = analysis._detectors._bank.detectors
    sides = {name: 600 if name == "opplod_paper" else 240 for name in VERSIONS}
    assert {name: model.shape for name, model in models.items()} == {
        name: (side, side) for name, side in sides.items()
    }
    box = expected[-1]["opplod_paper"].box
    assert box is not None
    assert 0 <= box.x < box.x + box.width <= 120  # in source pixels


@pytest.mark.parametrize(("height", "side"), [(60, 60), ("native", 120)])
def test_a_stated_height_is_that_of_all_detectors(height: int | str, side: int) -> None:
    analysis = Analysis((120, 120), VERSIONS, rate=30, height=height)
    models = analysis._detectors._bank.detectors.values()
    assert {model.shape for model in models} == {(side, side)}
    frames = np.array(looming(120, 60, 60, 8))
    found = list(analyse(frames, VERSIONS, rate=30, height=height, rmo=False))
    assert [analysis.step(frame, t / 30) for t, frame in enumerate(frames)] == found


def test_a_near_repeat_holds_the_object_and_counts_its_time_down(tmp_path: Path) -> None:
    frames = [frame for frame in eight_bits(approaching(120, 120, 28, 26)) for _ in range(2)]
    found = records(write_video(tmp_path / "a.mkv", frames, rate=60))
    held = 0
    for before, here in zip(found[6::2], found[7::2], strict=True):
        assert [each.box for each in here.detections] == [each.box for each in before.detections]
        for one, other in zip(before.detections, here.detections, strict=True):
            if one.time_to_contact_s and other.time_to_contact_s:
                passed = one.time_to_contact_s - other.time_to_contact_s
                assert passed == pytest.approx(1 / 60, abs=1e-3)
                held += 1
    assert held >= 8


@pytest.mark.long
@pytest.mark.parametrize(
    "pictures", [12, *(pytest.param(each, marks=pytest.mark.slow) for each in (20, 24))]
)
def test_the_time_to_contact_goes_by_the_times_at_which_pictures_were_taken(pictures: int) -> None:
    """So many pictures per second in 30 frames/s last for one, two or three frames."""
    taken = np.arange(82) * pictures // 30
    grain = np.random.default_rng(1).normal(0, 0.002, (taken[-1] + 1, 240, 240))
    shown = [0.1 + 0.8 * disk(240, 125, 118, 30 / (3 - p / pictures)) + grain[p] for p in taken]
    frames = (np.clip(shown, 0, 1) * 255).round().astype(np.uint8)
    errors = [
        left / (3 - record.time_s) - 1
        for record in analyse(frames, rate=30, rmo=None)
        for said in record.detectors.values()
        if (left := said.contact_s)
    ]
    assert len(errors) > 14
    assert np.median(np.abs(errors)) < 0.12


def test_a_scene_that_stands_still_is_seen_by_the_models(tmp_path: Path) -> None:
    """After a pause the first moving frame meets no inhibition, as the equations say."""
    moving = eight_bits(looming(120, 60, 60, 14))
    paused = [*moving[:4], *([moving[4]] * 12), *moving[5:]]
    with_pause = records(write_video(tmp_path / "a.mkv", paused))
    assert with_pause[14]["dlgmd"].answer is not None
    after = with_pause[16]["dlgmd"].answer
    assert after is not None
    without = records(write_video(tmp_path / "b.mkv", moving))[5]["dlgmd"].answer
    assert without is not None
    assert after.response > 2 * without.response


@pytest.mark.parametrize("pause", [6, 7, 12])
def test_motion_after_a_still_start_is_answered_at_once(tmp_path: Path, pause: int) -> None:
    moving = eight_bits(looming(120, 60, 60, 6))
    frames = [*([moving[0]] * (pause + 1)), *moving[1:]]
    shown = records(write_video(tmp_path / "a.mkv", frames))
    model = Dlgmd((120, 120))
    for record, frame in zip(shown, frames, strict=True):
        assert record["dlgmd"].answer == model.step(frame.astype(np.float32) / np.float32(255))


@pytest.mark.long
def test_repeats_before_the_cadence_is_known_leave_no_trace() -> None:
    """12 pictures/s in 30 frames/s, with noise: after frame 10 the responses are the same."""
    disks = np.array(looming(120, 60, 60, 24))
    grain = np.random.default_rng(3).standard_normal((60, 120, 120)) * 0.002
    shown = np.clip(disks[np.arange(60) * 12 // 30] + grain, 0, 1)
    own = list(analyse(np.clip(disks + grain[:24], 0, 1), [OpplodParams()], rate=12, rmo=False))
    assert max(each.response for record in own if (each := record["opplod"].answer)) > 0.4
    for frame, record in enumerate(analyse(shown, [OpplodParams()], rate=30, rmo=False)):
        if 10 <= frame < 50:
            one, other = record["opplod"].answer, own[frame * 12 // 30]["opplod"].answer
            assert one is not None
            assert other is not None
            assert one.response == pytest.approx(other.response, rel=0.25, abs=0.02)


@pytest.mark.parametrize("copies", [2, 3, 4, 5])
def test_a_response_that_was_given_never_goes_back_to_empty(copies: int) -> None:
    pictures = looming(60, 30, 30, 8)
    frames = np.array([picture for picture in pictures for _ in range(copies)])
    records = list(analyse(frames, rate=30, rmo=False))
    for name in ("opplod", "dlgmd"):
        given = [each[name].answer is not None for each in records]
        assert given == sorted(given)
        assert given[-1]


@pytest.mark.long
def test_the_calcium_signal_outlasts_the_motion() -> None:
    """It stays while frames may be repeats, and then falls with its time constant of 1 s."""
    pictures = looming(120, 60, 60, 14)
    frames = np.array(pictures + pictures[-1:] * 20)
    found = list(analyse(frames, ["opplod_lplc2"], rate=30))
    given = [record["opplod_lplc2"].answer for record in found[13:]]
    signal = [answer.calcium or 0 for answer in given if isinstance(answer, OpplodLplc2Response)]
    assert len(signal) == 21
    assert signal[0] == signal[5] > 0
    falling = [signal[0] * np.exp(-frame / 30) for frame in range(6, 21)]
    assert signal[6:] == pytest.approx(falling, rel=0.05)


def test_a_still_video_answers_zero_from_the_fourth_frame(tmp_path: Path) -> None:
    still = records(write_video(tmp_path / "a.mkv", [np.full((48, 64), 90, np.uint8)] * 12))
    assert [each["opplod"].answer for each in still[:3]] == [None] * 3
    for record in still[3:]:
        assert [said.response for said in record.detectors.values()] == [0, 0]
    assert [each.luma_change for each in still] == [None] + [0] * 11
    assert [each.rmo for each in still] == [None] + [RmoMetrics()] * 11
    with open_video(tmp_path / "a.mkv", span=Span(parse_position("0.1"))) as part:
        given = [each["opplod"].answer is not None for each in analyse(part)]
    assert given == [False] * 3 + [True] * 6


def test_a_still_scene_answers_zero_from_the_frame_in_which_a_moving_one_is_answered() -> None:
    """At 30.2 frames/s three frames last for 2.98 intervals, which count as three."""
    still = np.full((8, 48, 64), 90, np.uint8)
    moving = (255 * np.array(looming(48, 24, 24, 8))).astype(np.uint8)
    for frames in (still, moving):
        answers = [each["dlgmd"].answer for each in analyse(frames, rate=30.2, rmo=False)]
        assert [each is None for each in answers] == [True] * 3 + [False] * 5
        time = TimeParams(interval="frame")
        paper = analyse(frames, ["dlgmd"], rate=30.2, time=time, height=48, rmo=False)
        assert [each["dlgmd"].answer is None for each in paper] == [True] * 3 + [False] * 5


def test_a_still_start_lasts_for_frames_where_a_detector_counts_them() -> None:
    """At 60 frames/s three intervals of 1/30 s last for six frames."""
    still = np.full((10, 48, 64), 90, np.uint8)
    moving = np.array([frame[:48] for frame in looming(64, 32, 24, 10)])
    for frames in (still, moving):
        found = list(analyse(frames, ["opplod_paper", "opplod"], rate=60, rmo=False))
        for name, warm_up in (("opplod_paper", 3), ("opplod", 6)):
            silent = [record[name].answer is None for record in found]
            assert silent == [True] * warm_up + [False] * (10 - warm_up), name


def test_a_scene_that_comes_to_rest_in_a_cadence_stays_at_rest() -> None:
    """Each picture is shown twice, and the last one for longer."""
    pictures = eight_bits([disk(60, 30, 30, 5 + 2 * t) for t in range(11)])
    shown = np.repeat(np.array(pictures), [2] * 10 + [8], axis=0)
    found = list(analyse(shown, [FrameDifferenceParams()], rate=30, height=60, rmo=False))
    values = [record["frame_difference"].response or 0.0 for record in found[16:]]
    assert values[0] == values[1] < values[2] == values[3] < values[4] == values[5]
    assert values[6:] == [0] * 6


def test_the_rate_of_an_array_is_that_of_its_usual_step() -> None:
    for rate in (Fraction(30000, 1001), Fraction(1, 1 << 20)):
        assert checked_rate(float(rate)) == rate
    times = [0, 1 / 32, 2 / 32, 3 / 32, 9]  # after a pause
    with open_source(np.zeros((5, 8, 8), np.uint8), times=times) as video:
        assert video.facts.frame_rate == 32
    with open_source(np.zeros((2, 8, 8), np.uint8), times=[0, 1e-6]) as video:
        assert video.facts.frame_rate is None
    with (
        pytest.raises(ParameterError, match=r"frame 2 has .* and the frame before"),
        open_source(np.zeros((3, 8, 8), np.uint8), times=[0, 0.1, 0.1]),
    ):
        pass


def test_each_presentation_of_a_stimulus_goes_on_where_the_one_before_ended() -> None:
    short = {"timing.motion_s": 0.1, "timing.after_s": 0, "display.frame_rate": 20}
    protocol = stimulus.load(
        "controls/translating-disk-speed/speed-20", {**short, "timing.before_s": 0}
    )
    video, count = StimulusVideo(protocol, 24, 2), protocol.frame_count
    frames = list(video)
    assert video.times.remarks() == []  # no time goes back, and none had to be put right
    assert [frame.time_s for frame in frames] == pytest.approx(np.arange(2 * count) / 20)
    for first, second in zip(frames[:count], frames[count:], strict=True):
        np.testing.assert_array_equal(first.luma, second.luma)


def test_a_second_pause_is_shown_to_the_models_with_its_own_times() -> None:
    """The models get all frames of a pause of 0.5 s, and then of a slower video."""
    picture = eight_bits(looming(60, 30, 30, 16))
    shown = [*picture[:4], *picture[3:4] * 15, *picture[4:8], *picture[7:8] * 15, *picture[8:]]
    times = np.cumsum([1 / 30] * 39 + [1 / 15] * 7) - 1 / 30
    bank = DetectorBank((60, 60), [DlgmdParams()], 30)
    largest = 0.0
    found = analyse(np.array(shown), [DlgmdParams()], times=times.tolist(), height=60, rmo=False)
    for record, frame in zip(found, shown, strict=True):
        expected = bank.step(frame.astype(np.float32) / np.float32(255), record.time_s)["dlgmd"]
        if not record.repeat and expected:
            assert record["dlgmd"].answer == expected
            largest = max(largest, expected.response)
    assert largest > 0.01


@pytest.mark.long
def test_pictures_that_last_two_frames_and_three_change_by_equal_intervals() -> None:
    """Each of 12 pictures/s in 30 frames/s is compared with the picture 1/12 s before."""
    pictures = np.array(eight_bits([disk(60, 30, 30, 5 + t) for t in range(20)]))
    lasts = np.resize([2, 3], 20)
    shown = list(analyse(np.repeat(pictures, lasts, axis=0), rate=30, rmo=False))
    own = analyse(pictures, times=[t / 12 for t in range(20)], rmo=False)
    changes = [shown[at].luma_change for at in np.cumsum([0, *lasts[:-1]])]
    assert changes[8:] == pytest.approx([each.luma_change for each in own][8:], rel=0.03)


@pytest.mark.long
def test_growth_is_measured_over_an_interval_at_a_high_frame_rate() -> None:
    """From frame to frame, at 240 frames/s, noise is as large as the growth."""
    grain = np.random.default_rng(1).normal(0, 0.006, (90, 120, 120))
    shown = [0.1 + 0.8 * disk(120, 60, 60, 6 / (110 - t) * 240) for t in range(90)]
    frames = (np.clip(shown + grain, 0, 1) * 255).round().astype(np.uint8)
    errors = [
        left / (110 / 240 - record.time_s) - 1
        for record in analyse(frames, rate=240, height=120, rmo=False)
        if (each := record["opplod"].object) and (left := each.time_to_contact_s)
    ]
    assert len(errors) > 30
    assert np.abs(errors).max() < 0.25


def test_boxes_are_in_source_pixels(tmp_path: Path) -> None:
    frames = eight_bits(looming(240, 160, 100, 12))
    at_half = records(write_video(tmp_path / "a.mkv", frames), height=120)
    boxes = [answer.box for record in at_half if (answer := record["opplod"].answer) and answer.box]
    last = boxes[-1]
    assert (last.width, last.height) == (100, 100)
    centre = (last.x + last.width / 2, last.y + last.height / 2)
    assert centre == pytest.approx((160, 100), abs=8)


def test_a_box_in_source_pixels_has_the_scale_of_each_side() -> None:
    shown = _in_source(Response(1.0, Box(1, 2, 3, 4)), WorkingSize(40, 20, 2.0, 5.0))
    assert shown is not None
    assert shown.box == Box(2, 10, 6, 20)


def test_one_model_alone(tmp_path: Path) -> None:
    path = write_video(tmp_path / "a.mkv", eight_bits(looming(60, 30, 30, 6)))
    with open_video(path) as video:
        [*_, last] = analyse(video, [DlgmdParams()])
    assert list(last.detectors) == ["dlgmd"]
    assert "opplod_response" not in last.values()
    with open_video(path) as video:
        [*_, last] = analyse(video, [REFERENCE])
    assert "dlgmd_response" not in last.values()


@cache
def approach() -> Frames:
    """A disk before texture in colour, at uneven times: contact after 1.2 s."""
    ground = texture(180, 320, 3)[..., None] * np.array([0.9, 1.0, 0.8])
    y, x = np.mgrid[:180, :320]
    grey = [np.hypot(x - 130, y - 100) - 14 / (1.2 - t) for t in TIMES]
    frames = [np.clip(each, 0, 1)[..., None] * (0.3 + 0.6 * ground) for each in grey]
    shown = (np.asarray(frames) * 255).round().astype(np.uint8)
    shown.flags.writeable = False  # all tests are shown the same
    return shown


TIMES = np.arange(34) / 30 + np.random.default_rng(2).uniform(-0.004, 0.004, 34)


@pytest.mark.long
def test_frames_one_by_one_give_the_results_of_the_array() -> None:
    """Times may begin anywhere, and the caller may overwrite a frame after its step."""
    frames = approach()
    expected = list(analyse(frames, times=TIMES.tolist()))
    analysis = Analysis((180, 320), rate=30, rmo=True)
    memory = np.empty_like(frames[0])
    for index, each in enumerate(expected):
        memory[:] = frames[index]
        record = analysis.step(memory, 1e3 + TIMES[index])
        assert record.time_s == pytest.approx(each.time_s, abs=1e-6)
        own, other = record.values(), each.values()
        assert own.keys() == other.keys()
        assert record.blind == each.blind
        for name in own.keys() - {"time_s", "blind"}:
            one, same = (np.nan if value is None else value for value in (own[name], other[name]))
            assert one == pytest.approx(same, rel=1e-4, nan_ok=True), (index, name)
    assert [said.alarm for said in expected[-1].detectors.values()] == [True, True]
    assert expected[-3]["opplod"].contact_s == pytest.approx(1.2 - TIMES[-3], rel=0.15)


def test_frames_keep_their_numbers_where_the_detectors_begin_again() -> None:
    """A second of a still picture, and then 10 pictures/s, each for three frames."""
    pictures = eight_bits(looming(60, 30, 30, 6))
    shown = [*pictures[:1] * 30, *(picture for picture in pictures for _ in range(3))]
    analysis = Analysis((60, 60), ["frame_difference"], rate=30)
    found = [analysis.step(picture, index / 30) for index, picture in enumerate(shown)]
    assert found[-1].repeat  # the detectors have found the cadence
    assert [record.frame for record in found] == list(range(48))
    assert repr(analysis).endswith("; 48 frames so far)")


@pytest.fixture(scope="module")
def undisturbed() -> list[FrameRecord]:
    analysis = Analysis((180, 320))
    return [analysis.step(*each) for each in zip(approach(), TIMES, strict=True)]


@pytest.mark.long
@pytest.mark.parametrize(
    ("frame", "late_s"),
    [
        *((18, late_s) for late_s in (0.08, 5.0, -3.0)),
        *(pytest.param(10, late_s, marks=pytest.mark.slow) for late_s in (0.08, 5.0, -3.0)),
    ],
)
def test_one_wrong_time_costs_neither_alarm_nor_time_to_contact(
    frame: int, late_s: float, undisturbed: list[FrameRecord]
) -> None:
    """After a jump by seconds the models begin again, and 0.35 s are blind."""
    wrong = Analysis((180, 320))
    alarms, contacts = [], []
    for index, (picture, right) in enumerate(zip(approach(), undisturbed, strict=True)):
        given = TIMES[index] + (late_s if index == frame else 0)
        records = (right, wrong.step(picture, given))
        alarms.append([record["opplod"].alarm for record in records])
        found = [record["opplod"].object for record in records]
        contacts.append([each.time_to_contact_s for each in found if each])
    first, other = ([each[which] for each in alarms].index(True) for which in (0, 1))
    assert first - 1 <= other <= frame + 11
    for expected, after in contacts[25:33]:
        assert after == pytest.approx(expected, rel=0.13)


@pytest.mark.long
def test_an_alarm_ends_with_the_frames_before_a_gap() -> None:
    """The frames stop for ten seconds while the alarm is on, and the scene is another one then."""
    frames, log = approach(), AlarmLog("opplod")
    shown = np.concatenate([frames, frames[:10]])
    times = [*TIMES, *(TIMES[:10] + TIMES[-1] + 10)]
    records = list(analyse(shown, times=times, rmo=False))
    for record in records:
        log.add(record)
    assert records[33]["opplod"].alarm
    assert not any(record["opplod"].alarm for record in records[34:])
    (alarm,) = log.verdict.alarms
    assert alarm.end_s == pytest.approx(TIMES[-1] - TIMES[0])


def test_threads_that_share_an_analysis_take_turns(monkeypatch: pytest.MonkeyPatch) -> None:
    analysis = Analysis((30, 40), rate=30)
    step, inside, met = analysis._detectors.step, threading.Lock(), []

    def alone(prepared: Prepared) -> FrameRecord:
        met.append(not inside.acquire(blocking=False))
        time.sleep(0.01)
        record = step(prepared)
        if not met[-1]:
            inside.release()
        return record

    monkeypatch.setattr(analysis._detectors, "step", alone)
    with ThreadPoolExecutor(2) as pool:
        grey = np.zeros((30, 40), np.uint8)
        records = list(pool.map(lambda at: analysis.step(grey, at / 30), range(4)))
    assert (sorted(each.frame for each in records), met) == ([0, 1, 2, 3], [False] * 4)


@pytest.mark.long
def test_objects_in_two_threads_do_not_disturb_each_other(undisturbed: list[FrameRecord]) -> None:
    def watched(_camera: int) -> list[FrameRecord]:
        analysis = Analysis((180, 320))
        return [analysis.step(*each) for each in zip(approach(), TIMES, strict=True)]

    with ThreadPoolExecutor(2) as pool:
        assert list(pool.map(watched, range(2))) == [undisturbed] * 2


@pytest.mark.long
def test_frames_one_by_one_in_degrees_and_at_another_height() -> None:
    analysis = Analysis((180, 320), height=90, fov=60)
    for index, frame in enumerate(approach()[:31]):  # later the disk fills the frame
        record = analysis.step(frame.mean(axis=2) / 255, TIMES[index])
    values = record.values()
    assert record.frame == 30
    assert values["opplod_azimuth_deg"] == pytest.approx(-6.2, abs=1)
    assert values["flow_vectors"] is None


@pytest.mark.long
def test_frames_of_a_source_have_the_degrees_of_frames_one_by_one() -> None:
    options: dict[str, Any] = {"fov": 60, "height": 90, "rmo": False}
    analysis = Analysis((180, 320), **options)
    expected = [analysis.step(*each) for each in zip(approach(), TIMES, strict=True)]
    assert expected[-1].values()["opplod_azimuth_deg"] is not None
    assert list(analyse(approach(), times=TIMES, **options)) == expected
    with pytest.raises(ParameterError, match="fov must be"):
        next(analyse(approach(), times=TIMES, fov=180))


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"shape": (0, 9)}, "shape must be"),
        ({"shape": (90, 120, 3)}, r"give image.shape\[:2\]"),
        ({"rate": "30"}, "rate must be"),
        ({"fov": 0}, "fov must be"),
        ({"height": "tall"}, "height must be"),
        ({"shape": 90}, "shape must be height and width in pixels, not 90"),
        ({"shape": ("90", "120")}, "shape must be height and width"),
        ({"shape": (100_000, 100_000)}, "at most 67108864 pixels.*or set OPPLOAD_MAX_PIXELS"),
        ({"models": [DlgmdParams(), DlgmdParams()]}, "not hold two sets of 'dlgmd'"),
        ({"models": DlgmdParams()}, r"give a list, such as \['opplod'\]"),
        ({"models": [3]}, "models must not be 3; give names of detectors, or sets"),
        ({"models": ["opplad"]}, "no model 'opplad'; did you mean 'opplod'"),
        ({"models": ["opplod:paper"]}, "in place of 'paper' write --model opplod_paper"),
        ({"models": ["opplod_reference", REFERENCE]}, "not hold two sets of 'opplod_reference'"),
        ({"alarm": 3}, r"alarm must not be 3; give oppload_cli.alarm_params\(\)"),
        ({"rmo": "x"}, "rmo must not be 'x'; give True"),
        ({"places": 3}, "places must not be 3; give True"),
        ({"time": "frame"}, r"time must not be 'frame'; .*TimeParams\(interval='frame'\)"),
        ({"repeats": "exact"}, r"repeats must not be 'exact'; .*RepeatParams\(handling='exact'\)"),
    ],
)
def test_wrong_uses_of_frames_one_by_one(options: dict[str, Any], sentence: str) -> None:
    with pytest.raises(ParameterError, match=sentence):
        Analysis(**{"shape": (90, 120), **options})


@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy, pickle.dumps])
def test_an_analysis_is_not_copied(copied: Callable[[Analysis], object]) -> None:
    with pytest.raises(TypeError, match="make another one with the same arguments"):
        copied(Analysis((90, 120)))


@pytest.mark.parametrize(
    ("per_second", "apart"), [(1e3, "33.3"), (1e6, "3.33e+04"), (1e9, "3.33e+07")]
)
def test_times_of_another_unit_give_a_warning(per_second: float, apart: str) -> None:
    analysis, frames = Analysis((180, 320)), approach()
    for index in range(9):
        analysis.step(frames[index], index / 30 * per_second)
    sentence = (
        f"by their times, frames are {apart} s apart; if that is wrong, give the times in seconds"
    )
    with pytest.warns(UserWarning, match=re.escape(sentence)):
        analysis.step(frames[9], 9 / 30 * per_second)
    slow, unit = analysis.remarks
    assert "frames/s are too few for the models, which compare pictures 1/30 s" in slow
    assert unit == sentence


@pytest.mark.long
def test_the_remarks_are_those_of_the_sidecar() -> None:
    """8 pictures/s come twice each, one time goes back, and the declared rate is wrong."""
    frames = [frame for frame in eight_bits(looming(120, 60, 60, 16)) for _ in range(2)]
    times = [index / 16 for index in range(len(frames))]
    times[20] = times[19]
    analysis = Analysis((120, 120), rate=30, height=12)
    assert len(analysis.remarks) == 1
    records = [analysis.step(frame, time_s) for frame, time_s in zip(frames, times, strict=True)]
    assert [each.time_s for each in records[18:22]] == [18 / 16, 19 / 16, 20 / 16, 21 / 16]
    back, rate, repeats, small = analysis.remarks
    assert back.startswith("1 frame has a time that is not later than that of the frame before")
    assert (
        rate == "30 frames/s are declared, but the times of most frames say 16; the times are used"
    )
    # The times count here: the declared rate would give twice as many pictures/s.
    assert repeats.startswith("holds about 8 different pictures/s in 16 frames/s; the repeats")
    assert small.startswith(
        "has a working size of 12 x 12 px: below 13 px no detector is known to respond"
    )
    steady = Analysis((180, 320))
    for picture, time_s in zip(approach(), TIMES, strict=True):
        steady.step(picture, time_s)
    assert steady.remarks == []


@pytest.mark.long
def test_a_picture_that_stands_still_gives_a_remark() -> None:
    dead, frozen = Analysis((90, 120), height=90), Analysis((90, 120), height=90)
    for index in range(60):
        dead.step(np.zeros((90, 120)), index / 30)
        frozen.step(np.full((90, 120), min(index, 20) / 59), index / 30)
        if index == 29:
            assert dead.remarks == frozen.remarks == []
    same = "all pictures are the same, and nothing can cause an alarm; check the input"
    assert dead.remarks == [same]
    assert frozen.remarks == ["the picture has stood still for the latest 1.3 s"]
    frozen.step(np.ones((90, 120)), 2)
    assert frozen.remarks == []


@pytest.mark.long
def test_pictures_without_contrast_give_a_remark() -> None:
    """A thermal camera of 14 bits uses a small part of 16."""
    raw, scaled = Analysis((180, 320)), Analysis((180, 320))
    for picture, time_s in zip(approach(), TIMES, strict=True):
        raw.step(7000 + 4 * picture.astype(np.uint16), time_s)
        scaled.step(picture, time_s)
    assert TIMES[-1] > 1
    assert scaled.remarks == []
    [remark] = raw.remarks
    assert remark.startswith("all luminance lies between 0.107 and 0.120 of 0 (black) to 1 (white)")


@pytest.mark.long
@pytest.mark.once
def test_with_little_contrast_an_alarm_comes_late_and_the_remark_says_so() -> None:
    """Images of 12 bits in 16 use 0 to 1/16 of the range."""
    protocol = stimulus.load("controls/looming-perspective")
    grey = np.stack([each.grey for each in stimulus.frames(protocol)]).astype(np.uint16)
    runs = [run(grey * scale, rate=60, models=["opplod"], rmo=False) for scale in (257, 8)]
    full, little = (each.summary["opplod"]["first_alarm_time_s"] for each in runs)
    assert full + 0.03 < little < 1.6  # the time of contact
    assert runs[0].sidecar["remarks"] == []
    [remark] = runs[1].sidecar["remarks"]
    assert "0.031 of 0 (black) to 1 (white): with so little contrast an alarm comes late" in remark


def test_colours_are_not_rounded_to_grey_of_8_bits() -> None:
    """Grey of 8 bits holds no step that is smaller than a code; colours do, and average to it."""
    blue = np.zeros((90, 120, 3), np.uint8)
    blue[..., 2] = np.arange(120) // 30 * 2 + 10  # steps of 2 codes of blue: 0.23 of grey
    blue[..., :2] = 60
    luma = ArrayLuminance(WorkingSize(120, 90, 1, 1))(blue, "it")
    exact = blue @ np.array([0.299, 0.587, 0.114]) / 255
    np.testing.assert_allclose(luma, exact, atol=2e-5)
    small = ArrayLuminance(WorkingSize(40, 30, 3, 3))(blue, "it")
    np.testing.assert_allclose(small[:, 4::10], exact[::3, 13::30], atol=6e-4)
    grey = np.repeat(np.arange(90 * 120).astype(np.uint8).reshape(90, 120, 1), 3, axis=2)
    whole = ArrayLuminance(WorkingSize(120, 90, 1, 1))
    np.testing.assert_array_equal(whole(grey, "it"), whole(grey[..., 0], "it"))


@pytest.mark.parametrize("shape", [(60, 80), (40, 200), (200, 50), (180, 240)])
def test_floats_are_resized_like_codes(shape: tuple[int, int]) -> None:
    """A frame that is larger than 120 x 160 px is averaged, and a smaller one is interpolated."""
    codes = np.random.default_rng(5).integers(0, 65536, shape, np.uint16)
    luminance = ArrayLuminance(WorkingSize(160, 120, 1, 1))
    floats = luminance(codes / 65535, "it")
    np.testing.assert_allclose(floats, luminance(codes, "it"), atol=1e-4)


@pytest.mark.parametrize("kind", [np.uint8, np.uint16, np.float32])
def test_a_reversed_view_of_bgr_gives_the_luminance_of_its_copy(kind: type) -> None:
    white = 1 if kind is np.float32 else np.iinfo(kind).max
    bgr: NDArray[Any] = (white * np.random.default_rng(4).random((90, 120, 3))).astype(kind)
    luminance = ArrayLuminance(WorkingSize(60, 45, 2, 2))
    rgb, before = bgr[..., ::-1], bgr.copy()
    np.testing.assert_array_equal(luminance(rgb, "it"), luminance(rgb.copy(), "it"))
    np.testing.assert_array_equal(bgr, before)
    assert not np.allclose(luminance(rgb, "it"), luminance(bgr, "it"), atol=0.01)


def test_wrong_frames_one_by_one() -> None:
    analysis = Analysis((90, 120))
    wrong: Any
    for wrong in (
        (np.zeros((12, 90)), 0.0, FrameError, r"must be of shape \(90, 120\).*another Analysis"),
        (np.zeros((120, 90, 3)), 0.0, FrameError, "the shape of an Analysis is its height and its"),
        (np.zeros((90, 120, 4)), 0.0, FrameError, r"\(90, 120, 4\); give frame\[..., :3\]"),
        (np.zeros((135, 120)), 0.0, FrameError, r"the luma, which is frame\[:90\] of NV12"),
        (np.zeros((90, 120)), np.nan, FrameError, "time must be a finite number"),
        (np.zeros((90, 120)), None, FrameError, "finite number of seconds, not None"),
        (np.zeros((90, 120)), np.timedelta64(33, "ms"), FrameError, r"seconds, not .*\(33,'ms'\)"),
        (np.zeros((90, 120)), "0.5", FrameError, "finite number of seconds, not '0.5'"),
        (None, 0.0, FrameError, "must be an array, not None; OpenCV gives None"),
        (cv2.UMat(90, 120, cv2.CV_8U), 0.0, FrameError, r"UMat.*; give an array .* umat.get\(\)"),
        (np.zeros((90, 120), np.int64), 0.0, SourceError, "^frame 0: its type is int64"),
        (np.full((90, 120), 200.0), 0.0, SourceError, "frame 0 holds values outside"),
    ):
        frame, time_s, kind, sentence = wrong
        with pytest.raises(kind, match=sentence):
            analysis.step(frame, time_s)
    assert analysis.step(np.zeros((90, 120)), 5.0).time_s == 0  # the wrong frames did not count


@pytest.mark.long
def test_a_refused_frame_leaves_no_trace(undisturbed: list[FrameRecord]) -> None:
    analysis = Analysis((180, 320))
    wrong: list[Any] = [(None, 0.5), (np.full((180, 320), 2.0), 0.5), (approach()[5], np.nan)]
    for index, expected in enumerate(undisturbed):
        for frame, time_s in wrong if index % 5 == 0 else []:
            with pytest.raises(OpploadError):
                analysis.step(frame, time_s)
        assert analysis.step(approach()[index], TIMES[index]) == expected


@pytest.mark.parametrize(
    ("still", "blind_s"), [(0, [0, 0.1, 0.2, 0.3]), (1, [0, 0.2, 0.3, 0.4, 0.5])]
)
def test_the_start_at_ten_frames_per_second(still: int, blind_s: list[float]) -> None:
    """After the first frame 0.35 s are blind; after a still picture, from 1/30 s before motion."""
    analysis = Analysis((60, 80), rate=10, height=60)
    ground = texture(60, 80, 1)
    shown = [np.roll(ground, 2 * max(0, t - still), axis=1) for t in range(9)]
    found = [analysis.step(picture, t / 10) for t, picture in enumerate(shown)]
    assert [record.time_s for record in found if record.blind] == pytest.approx(blind_s)


@pytest.mark.long
@pytest.mark.parametrize("version", ["opplod_reference", "opplod"])
@pytest.mark.parametrize("rate", [24, 60])
def test_a_pause_of_any_length_at_the_start_changes_nothing(rate: int, version: str) -> None:
    """Frames that stand still at the start are no repeats, unless a cadence follows."""
    moving = [disk(120, 60, 60, 2 + 48 * t / rate) for t in range(round(0.5 * rate))]

    def responses(pause: int) -> list[float]:
        shown = np.array([moving[0]] * pause + moving)
        found = list(analyse(shown, [version], rate=rate, rmo=False))
        return [record[version].response or 0.0 for record in found[pause:]]

    without = responses(0)
    assert max(without) > 0
    for pause in (count for count in (1, 2, 3, 5, 8, 14) if count < 0.25 * rate):
        # With `opplod` the growth of the first frames counts where the warm-up is over.
        ready, within = (6, 3e-3) if version == "opplod" else (0, 1e-6)
        expected = pytest.approx(without[ready:], abs=within * max(without))
        assert responses(pause)[ready:] == expected, pause
