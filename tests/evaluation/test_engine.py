from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import pytest

from oppload_cli import OpplodReferenceParams, analyse, open_video
from oppload_cli.detection.alarm import alarm_params
from oppload_cli.evaluation.detectors import evaluated_detectors
from oppload_cli.evaluation.engine import analyse_clips
from oppload_cli.evaluation.manifest import ClipEntry
from oppload_cli.evaluation.metrics.alarms import shipped
from oppload_cli.evaluation.metrics.clips import Label
from oppload_cli.evaluation.metrics.intervals import draws_of
from oppload_cli.models.detector import Box
from oppload_cli.models.flow_divergence import FlowDivergence
from oppload_cli.stimulus import load
from tests.media import grey_frames, write_video

if TYPE_CHECKING:
    from pathlib import Path

# Tests in which the size does not matter are quick at a small one.
SMALL = evaluated_detectors(["opplod_reference"], height="60")
NOWHERE = [None] * 4  # a box


def test_the_times_of_a_clip_in_slow_motion_are_those_of_its_camera(tmp_path: Path) -> None:
    write_video(tmp_path / "slow.avi", grey_frames(30), rate=25)
    (tmp_path / "images").mkdir()
    for index, frame in enumerate(grey_frames(30)):
        cv2.imwrite(str(tmp_path / "images" / f"{index}.png"), frame)
    for name in ("slow.avi", "images"):
        entry = ClipEntry(2, tmp_path / name, Label(name), true_rate=Fraction(100))
        ((clip, faults),) = analyse_clips([entry], SMALL)
        assert faults == []
        assert clip is not None
        assert clip.time_s == pytest.approx(np.arange(30) / 100), name


@pytest.mark.long
def test_detectors_respond_as_they_do_alone(labelled: Path) -> None:
    path = labelled / "beside.avi"
    chosen = evaluated_detectors(
        ["opplod_reference", "opplod_paper"], assignments={"opplod_reference.cell": 6}
    )
    entry = ClipEntry(2, path, Label("beside.avi", 45, 89))
    (analysed,) = analyse_clips([entry], chosen)
    clip = analysed.clip
    assert clip is not None
    assert analysed.faults == []
    assert (len(clip), clip.width, clip.height, clip.first) == (90, 160, 120, 3)
    assert list(clip.outputs)[:3] == ["opplod_reference", "opplod_paper", "dlgmd"]
    for name, params in (
        ("opplod_reference", OpplodReferenceParams(cell=6)),
        ("opplod_paper", "opplod_paper"),
        ("dlgmd", "dlgmd"),
    ):
        records = list(analyse(path, [params], rmo=None))
        found, said = clip.outputs[name], [record[name] for record in records]
        expected: dict[str, list[Any]] = {"response": [one.response for one in said]}
        if name == "opplod_paper":
            assert found.alarm is None
        else:
            expected["alarm"] = [one.alarm for one in said]
        if name == "dlgmd":
            assert (found.winner, found.box, found.contact_s) == (None, None, None)
        else:
            winners = [one.answer and one.answer.box for one in said]
            expected |= {
                "evidence": [one.evidence for one in said],
                "winner": [box or NOWHERE for box in winners],
                "box": [one.box or NOWHERE for one in said],
                "contact_s": [one.contact_s for one in said],
            }
        for field, values in expected.items():
            np.testing.assert_array_equal(getattr(found, field), np.array(values, float), field)
            assert np.isfinite(getattr(found, field)).any(), field
    changes = [record.luma_change for record in records]
    assert np.array_equal(
        clip.outputs["frame_difference"].response[1:], np.array(changes[1:], float), equal_nan=True
    )


@pytest.mark.long
def test_a_detector_whose_alarms_are_off_is_not_one_without_a_false_alarm() -> None:
    off = replace(SMALL[0], alarm=alarm_params(on=False))
    ((clip, _),) = analyse_clips(
        [ClipEntry(2, load("controls/static-texture"), Label("still"))], [off]
    )
    assert clip is not None
    found = shipped([clip], off.name, draws_of([False], 100))
    assert np.isnan(found.outcomes.false_alarms).all()
    rate = next(one for one in found.measurements if one.measure == "false_alarms_per_minute")
    assert np.isnan([rate.value, rate.low, rate.high]).all()


def test_the_flow_skips_repeats(tmp_path: Path) -> None:
    frames = [frame for frame in grey_frames(8, 128, 96) for _ in range(2)]
    path = write_video(tmp_path / "twice.mkv", frames)
    (analysed,) = analyse_clips([ClipEntry(2, path, Label("twice.mkv"))], SMALL)
    assert analysed.clip is not None
    found = analysed.clip.outputs["flow_divergence"].response
    # Frame 2 has response 0 too: it is not known yet whether the first picture stood still.
    assert found[1:4].tolist() == [0.0] * 3
    assert found[5::2].tolist() == found[4::2].tolist()
    with open_video(path, height=60) as video:
        flow = FlowDivergence(video.working.shape)
        answers = [flow.step(frame.luma) for frame in video if frame.index % 2 == 0]
    assert answers[0] is None
    assert found[4::2].tolist() == [answer.response for answer in answers[2:] if answer]
    assert np.isnan(found[0])


@pytest.mark.long
def test_a_contact_without_any_response(labelled: Path) -> None:
    labels = [Label("a", 45, 90), Label("a", 0, 2), Label("a", 0, 3)]
    entries = [ClipEntry(2, labelled / "centre.avi", label) for label in labels]
    late, early, enough = analyse_clips(entries, SMALL)
    for analysed, reason in (
        (late, "its contact, frame 90, is beyond its last frame, 89"),
        (early, "its contact, frame 2, is before the first response, frame 3"),
    ):
        assert analysed.clip is None
        assert reason in analysed.faults[0]
    assert enough.clip is not None  # the first response is enough


def test_a_clip_that_cannot_be_decoded_or_is_too_short_is_a_fault(tmp_path: Path) -> None:
    (tmp_path / "text.avi").write_text("no video")
    (analysed,) = analyse_clips([ClipEntry(2, tmp_path / "text.avi", Label("text.avi"))], SMALL)
    assert analysed.clip is None
    assert "text.avi" in analysed.faults[0]
    short = write_video(tmp_path / "short.mkv", grey_frames(3))
    (analysed,) = analyse_clips([ClipEntry(2, short, Label("short.mkv"))], SMALL)
    assert analysed.faults == ["short.mkv: has 3 frames, too few for any response; leave it out"]


def test_a_clip_too_wide_for_the_working_height_is_a_fault(tmp_path: Path) -> None:
    wide = write_video(tmp_path / "wide.mkv", grey_frames(2, 2400, 8))
    detectors = [replace(detector, height=240) for detector in SMALL]
    (analysed,) = analyse_clips([ClipEntry(2, wide, Label("wide.mkv"))], detectors)
    assert analysed.clip is None
    assert analysed.faults[0].startswith(f"{wide}: a working size of ")


def test_a_cut_clip_is_used_and_reported(tmp_path: Path) -> None:
    whole = write_video(tmp_path / "whole.mkv", grey_frames(60, 320, 240)).read_bytes()
    (tmp_path / "cut.mkv").write_bytes(whole[: len(whole) * 2 // 3])
    boxes = dict.fromkeys(range(60), Box(0.0, 0.0, 1.0, 1.0))
    entry = ClipEntry(2, tmp_path / "cut.mkv", Label("cut.mkv", boxes=boxes))
    (analysed,) = analyse_clips([entry], SMALL)
    assert analysed.clip is not None
    assert 30 < len(analysed.clip) < 50
    assert analysed.faults[0] == "cut.mkv: is damaged or cut; what could be decoded is used"
    last = len(analysed.clip) - 1
    assert analysed.faults[1:] == [
        f"cut.mkv: the box of frame {frame} is beyond its last frame, {last}; correct it"
        for frame in range(last + 1, 60)
    ]


@pytest.mark.parametrize(
    ("name", "changes", "field"),
    [
        ("frame_difference", {"alarm.factor": 1, "alarm.frame_difference_floor": 0.01}, "alarm"),
        ("frame_difference", {"repeats.handling": "keep"}, "response"),
        ("opplod_reference", {"time.interval": "frame"}, "response"),
    ],
)
def test_the_settings_of_the_detectors_hold_for_their_run(
    tmp_path: Path, name: str, changes: dict[str, object], field: str
) -> None:
    """Moving pictures at 40 frames/s that are each shown twice."""
    frames = [frame for frame in grey_frames(40) for _ in range(2)]
    path = write_video(tmp_path / "twice.mkv", frames, rate=80)
    found = []
    for chosen in (SMALL, evaluated_detectors(assignments=changes, height="60")):
        (analysed,) = analyse_clips([ClipEntry(2, path, Label("twice.mkv"))], chosen)
        assert analysed.clip is not None
        found.append(getattr(analysed.clip.outputs[name], field))
        (one,) = (detector for detector in chosen if detector.name == name)
    own: Any = {"alarm": one.alarm, "repeats": one.repeats, "time": one.time}
    records = analyse(path, [one.params], height=60, rmo=None, **own)
    expected = np.array([getattr(record[name], field) for record in records], float)
    np.testing.assert_array_equal(found[1], expected)
    assert (np.nan_to_num(found[0]) != np.nan_to_num(found[1])).any()
