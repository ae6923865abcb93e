"""Stimuli in place of a manifest: labels from the truth, and what is measured with them."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from oppload_cli import stimulus
from oppload_cli.errors import StimulusError
from oppload_cli.evaluation.clip_inputs import clips_of
from oppload_cli.evaluation.detectors import evaluated_detectors
from oppload_cli.evaluation.engine import evaluate
from oppload_cli.evaluation.metrics.clips import Clip, Label, Output
from oppload_cli.evaluation.metrics.intervals import draws_of
from oppload_cli.evaluation.metrics.measures import measured, overlap
from oppload_cli.models.detector import Box
from tests.cli.inside import oppload
from tests.media import grey_frames, write_video

if TYPE_CHECKING:
    from pathlib import Path

SMALL: dict[str, Any] = {"display.width": 64, "display.height": 48, "timing.motion_s": 1.0}
HIT = "staged/collision-shape/background-street_drawing-box_size-m-1.6"
CHANGES = [f"{key}={value}" for key, value in SMALL.items()]
MISS = "staged/near-miss/background-street_miss-sizes-2_side-left_speed-m-8"


@pytest.mark.long
def test_the_benchmark_has_300_clips_in_two_parts() -> None:
    names = [protocol.name for protocol in stimulus.load_all("staged/*")]
    assert len(names) >= 300
    for place in ("street", "sky", "forest", "room"):
        part = stimulus.load_all(f"staged/*/background-{place}*")
        assert len(part) == len(names) // 4
        looming = [any(obj.course is not None for obj in protocol.objects) for protocol in part]
        assert 70 < sum(looming) < len(part)


def label_of(name: str, *changes: str) -> Label:
    return clips_of([name], None, [], changes).entries[0].label


def test_a_label_follows_from_the_truth() -> None:
    label = label_of(HIT, *CHANGES, "camera.looming_within_s=0.5")
    assert [label.onset, label.contact, label.motion] == [15, 29, ""]
    assert label.contacts[15] == pytest.approx(0.5)
    assert list(label.boxes[29]) == [0, 0, 64, 48]
    left, top, width, height = label.boxes[16]
    eye = 32 / np.tan(np.radians(30))
    assert width == pytest.approx(eye * 1.6 / (8 * 14 / 30), rel=1e-3)
    assert (left + width / 2, top + height / 2) == pytest.approx((32, 24))
    assert label.conditions["speed"] == "8 m/s"
    assert label.conditions["camera"] == "at rest"
    paler = label_of(HIT, *CHANGES, "thing.relative_luminance=0.55")
    assert paler.conditions["contrast"] == "-0.45"
    missed = label_of(MISS, *CHANGES)
    assert not missed.looming
    assert missed.motion == "near miss at 2 sizes"
    assert ("side" in label.conditions, missed.conditions["side"]) == (False, "left")
    panned = label_of("staged/collision-pan/background-sky_pan-5_speed-m-8", *CHANGES)
    assert panned.conditions["camera"] == "pan 5"
    assert missed.boxes == {}


FOUR = """
[display]
width = 64
height = 64
frame_rate = 30
field_of_view_deg = 72
[timing]
before_s = 1.0
motion_s = 2.0
after_s = 0.2
"""
DISK = """
[[object]]
id = "{0}"
kind = "disk"
luminance = 0.0
centre_deg = [{1}, 0]
onset_s = {2}
duration_s = 0.4
appears = "onset"
vanishes = "end"
[object.growth]
kind = "approach"
l_over_v_ms = 20
most_deg = 30
contact_s = {3}
"""


@pytest.mark.long
def test_approaches_one_after_the_other_are_measured_each(tmp_path: Path) -> None:
    disks = [DISK.format(f"d{i}", 20 * (-1) ** i, i / 2, i / 2 + 1.4) for i in range(4)]
    (tmp_path / "four.toml").write_text(FOUR + "".join(disks))
    manifest = clips_of([str(tmp_path / "four.toml")], None, [], [])
    labels = [entry.label for entry in manifest.entries]
    assert [label.name.rpartition(", ")[2] for label in labels] == [
        f"approach {number} of 4" for number in (1, 2, 3, 4)
    ]
    spans = [(label.onset, label.contact) for label in labels]
    assert spans == [(30 + 15 * i, 39 + 15 * i) for i in range(4)]
    assert [label.since for label in labels] == [0, 45, 60, 75]
    assert [label.video for label in labels] == [0, 0, 0, 0]
    # Alarms before and in the first, in the gap before the third, and in it; 96 frames.
    shipped = outcomes_of(labels, [10, 35, 40, 58, 66, 95])
    assert list(shipped.detected) == [1, 0, 1, 0]
    assert list(shipped.false_alarms) == [1, 0, 0, 0]
    assert shipped.lead_s[[0, 2]] == pytest.approx([7 / 30, 6 / 30])  # the disks stop 0.1 s before
    # Held from the first into the second and begun again, and held through the fourth.
    held = outcomes_of(labels, [*range(37, 50), 52, *range(74, 96)])
    np.testing.assert_array_equal(held.detected, [1, 1, 0, np.nan])
    assert held.lead_s[[0, 1]] == pytest.approx([5 / 30, 5 / 30])
    # All are of one video: each draw of the bootstrap has all of them.
    found = evaluate(manifest, evaluated_detectors(["frame_difference"]), draws=50)
    leads = [one for one in found.measurements if one.measure == "lead_time_s" and one.n == 4]
    assert leads
    assert all(np.isnan([one.low, one.high]).all() for one in leads)
    outputs = [(clip, clip.outputs["frame_difference"].evidence) for clip in found.clips]
    assert len({evidence[slice(*clip.approach)].max() for clip, evidence in outputs}) > 1
    # Begun in the first frame of the third.
    begun = outcomes_of(labels, [60, 63])
    assert list(begun.detected) == [0, 0, 1, 0]
    assert begun.lead_s[2] == pytest.approx(12 / 30)


def outcomes_of(labels: list[Label], alarms: list[int]) -> Any:
    """Return the outcomes of the alarm of one detector that is on in some of 96 frames."""
    on = np.isin(np.arange(96), alarms)
    output = Output(on.astype(float), on.astype(float), on)
    clips = [Clip(label, np.arange(96) / 30, 64, 64, {"d": output}) for label in labels]
    assert [clip.quiet for clip in clips] == [(0, 30), (45, 45), (60, 60), (75, 75)]
    performance = measured(clips, "d", draws_of([True] * 4, 100))
    fixed, own = (
        performance.thresholds.outcomes(0.5),
        performance.decisions["alarm as shipped"].outcomes,
    )
    for rule in ("detected", "lead_s"):  # a fixed threshold holds alarms as the detector does
        np.testing.assert_array_equal(getattr(fixed, rule), getattr(own, rule))
    return own


@pytest.mark.parametrize(
    ("name", "contacts"),
    [
        ("klapoetke2017/loom-l-over-v/l-over-v-200", [2.2]),  # stops at its largest size
        ("controls/two-looming-disks", [1.6, 2.2]),
        ("opplod2023/expanding-bar-vertical", []),  # a bar has no contact
        ("controls/receding-disk", []),
    ],
)
def test_leads_count_to_the_next_true_contact(name: str, contacts: list[float]) -> None:
    label = label_of(name)
    assert label.contact_times == pytest.approx(contacts)
    if label.contact is None:
        return
    times = np.arange(300) / 60
    shown = Clip(label, times, 64, 64, {})
    for frame in (5, label.contact):
        ahead = [later for later in contacts if later > times[frame]] or [times[label.contact]]
        assert shown.lead(frame) == pytest.approx(ahead[0] - times[frame])


def test_the_true_time_to_contact_is_that_of_the_object_that_arrives_first() -> None:
    """The first disk, with its contact at 1.6 s, has its largest size from frame 40 on."""
    found = label_of("controls/two-looming-disks").contacts
    expected = {frame: (1.6 if frame < 40 else 2.2) - frame / 30 for frame in range(6, 58)}
    assert found == pytest.approx(expected)


BALLS = """
[display]
width = 64
height = 48
field_of_view_deg = 60
projection = "perspective"
[timing]
motion_s = 0.5
"""
BALL = """
[[object]]
id = "{0}"
kind = "picture"
drawing = "ball"
size_m = 0.6
course = {{ kind = "collision", speed_m_s = 6, contact_s = {1}, bearing_deg = [{2}, 0] }}
"""


def test_the_true_box_is_that_of_the_object_that_arrives_first(tmp_path: Path) -> None:
    early, late = BALL.format("early", 0.6, 12), BALL.format("late", 1.2, -12)
    boxes = []
    for objects in (early, early + late, late + early):
        (tmp_path / "two.toml").write_text(BALLS + objects)
        boxes.append(label_of(str(tmp_path / "two.toml")).boxes)
    assert boxes[1] == boxes[2] == boxes[0] != {}


def test_stimuli_of_one_name_are_refused(tmp_path: Path) -> None:
    for folder, most in (("a", "30"), ("b", "40")):
        (tmp_path / folder).mkdir()
        disk = DISK.format("d", 0, 0.0, 1.4).replace("most_deg = 30", f"most_deg = {most}")
        (tmp_path / folder / "x.toml").write_text(FOUR + disk)
    names = [str(tmp_path / folder / "x.toml") for folder in ("a", "b")]
    with pytest.raises(StimulusError, match="two different stimuli are named 'x'; rename a file"):
        clips_of(names, None, [], [])
    assert len(clips_of([names[0], names[0]], None, [], []).entries) == 1


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("staged/pan/background-sky_pan-8", "pan"),
        ("staged/forward/background-sky_forward-m-1", "forward"),
        ("staged/still/background-sky_noise-0", "still"),
        ("staged/cut/background-sky_cut-1.6", "cut"),
        ("staged/flash/background-sky_luminance-0", "flash"),
        ("staged/braking/background-sky_relative-luminance-0.5", "braking"),
        ("staged/receding/background-sky_speed-m-3_relative-luminance-0.4", "receding"),
        ("controls/receding-disk", "controls"),
    ],
)
def test_kinds_of_clips(name: str, kind: str) -> None:
    assert label_of(name, *CHANGES[:2]).conditions["kind"].startswith(kind)


def test_the_users_own_videos_take_the_place_of_the_backgrounds() -> None:
    # Those with a camera that moves, or with a cut between two backgrounds, are left out.
    patterns = [f"staged/{name}" for name in ("braking", "flash", "cut", "collision-pan")]
    entries = clips_of(patterns, None, ["a.mp4", "b.mp4"], CHANGES[:2]).entries
    made = [entry.path for entry in entries if isinstance(entry.path, stimulus.Protocol)]
    assert {protocol.scene.background for protocol in made} == {"a.mp4", "b.mp4"}
    assert {protocol.scene.background_fit for protocol in made} == {"cover"}
    assert not any(protocol.camera and protocol.camera.moves for protocol in made)
    assert not any(protocol.scene.cut_s for protocol in made)
    assert len(made) == 2 * 4
    with pytest.raises(StimulusError, match="--background: none of staged/pan has a background"):
        clips_of(["staged/pan"], None, ["a.mp4"], [])
    with pytest.raises(StimulusError, match="--background: none of staged/braking has"):
        clips_of(["staged/braking"], None, ["a.mp4"], [*CHANGES[:2], "camera.start_deg=5"])


def truthful(
    response: list[float],
    conditions: dict[str, str],
    contact: int | None = None,
    box: tuple[float, ...] | None = None,
    estimate: float = np.nan,
) -> Clip:
    """A clip of 20 frames at 10 per second; the true box is that of 10 x 10 px at 0."""
    frames = len(response)
    found = np.tile([np.nan] * 4 if box is None else box, (frames, 1))
    output = Output(
        np.array(response),
        np.array(response),
        np.array(response) > 1,
        found,
        found,
        np.full(frames, estimate),
    )
    onset = None if contact is None else 5
    label = Label(str(conditions), onset, contact, "", {}, {}, conditions)
    if contact is not None:
        label.boxes[contact - 5] = Box(0.0, 0.0, 10.0, 10.0)
        label.contacts[contact - 4] = 0.4
    return Clip(label, np.arange(frames) / 10, 100, 100, {"d": output})


def test_outcomes_by_condition() -> None:
    calm, high = [0.0] * 20, [0.0] * 12 + [5.0] + [0.0] * 7
    clips = [
        truthful(high, {"kind": "collision", "speed": "3 m/s"}, 15),
        truthful(calm, {"kind": "collision", "speed": "12 m/s"}, 15),
        truthful([0.0] * 3 + [9.0] + [0.0] * 12 + [9.0] + [0.0] * 3, {"kind": "near miss"}),
        truthful(calm, {"kind": "near miss", "speed": "12 m/s"}),
        truthful(calm, {"kind": "pan"}),
    ]
    draws = draws_of([clip.label.looming for clip in clips], 100)
    found = {(one.measure, one.condition): one for one in measured(clips, "d", draws).measurements}
    at = "alarm as shipped"
    # One clip each: the exact interval of Clopper and Pearson.
    always, never = pytest.approx((1, 0.025, 1, 1)), pytest.approx((0, 0, 0.975, 1))
    assert found["detection_rate", f"{at}, speed 3 m/s"][3:] == always
    assert found["detection_rate", f"{at}, speed 12 m/s"][3:] == never
    assert found["detection_rate", f"{at}, kind collision"][3:] == (0.5, 0.0, 1.0, 2)
    assert found["lead_time_s", f"{at}, speed 3 m/s"].value == pytest.approx(0.3)
    assert found["alarmed_share", f"{at}, kind near miss"].value == 0.5
    assert found["alarmed_share", f"{at}, kind pan"][3:] == never
    assert found["alarmed_share", at].value == pytest.approx(1 / 3)
    assert ("alarmed_share", f"{at}, speed 12 m/s") not in found
    assert ("detection_rate", f"{at}, kind pan") not in found
    speeds = [condition for _, condition in found if "speed" in condition]
    assert speeds.index(f"{at}, speed 3 m/s") < speeds.index(f"{at}, speed 12 m/s")


def test_clips_without_a_condition_have_no_measurement_of_it() -> None:
    clips = [truthful([5.0] * 20, {"kind": "a"} | speed, 15) for speed in ({}, {"speed": "3 m/s"})]
    found = measured(clips, "d", draws_of([True, True], 9)).measurements
    assert {one.condition for one in found if "speed" in one.condition} == {
        f"{rule}, speed 3 m/s" for rule in ("alarm as shipped", "at 1 per minute")
    }


def test_a_detector_without_alarms_has_no_share_of_alarmed_clips() -> None:
    seen = truthful([0.0] * 20, {"kind": "pan"})
    silent = replace(seen, outputs={"d": replace(seen.outputs["d"], alarm=None)})
    for one, conditions in ((seen, 4), (silent, 2)):
        found = measured([one], "d", draws_of([False], 9)).measurements
        assert sum(measurement.measure == "alarmed_share" for measurement in found) == conditions


@pytest.mark.parametrize(("estimate", "share"), [(0.33, 1), (0.31, 0), (0.47, 1), (0.49, 0)])
def test_a_time_to_contact_may_be_wrong_by_a_fifth(estimate: float, share: float) -> None:
    seen = truthful([1.0] * 20, {"kind": "a"}, 15, (0, 0, 9, 9), estimate)  # in truth 0.4 s
    found = {one.measure: one for one in measured([seen], "d", draws_of([True], 9)).measurements}
    assert found["contact_within"].value == share


def test_boxes_and_times_to_contact_are_held_to_the_truth() -> None:
    clips = [
        truthful([1.0] * 20, {"kind": "a"}, 15, (0, 0, 10, 20), 0.44),
        truthful([1.0] * 20, {"kind": "a"}, 15, (0, 0, 10, 10), 0.2),
        truthful([1.0] * 20, {"kind": "a"}, 15),
    ]
    draws = draws_of([True] * 3, 100)
    found = {one.measure: one for one in measured(clips, "d", draws).measurements}
    assert found["box_overlap"].value == pytest.approx(0.5)
    assert found["contact_within"].value == pytest.approx(1 / 3)
    assert found["contact_error"].value == pytest.approx(0.3)
    assert (found["box_overlap"].n, found["contact_within"].n, found["contact_error"].n) == (
        3,
        3,
        2,
    )
    # A clip without true times to contact says nothing about those of the detector.
    clips[2].label.contacts.clear()
    found = {one.measure: one for one in measured(clips, "d", draws).measurements}
    assert found["contact_within"].value == pytest.approx(1 / 2)
    assert found["contact_within"].n == 2
    found = {one.measure: one for one in measured(clips[:1], "d", draws[:, :1]).measurements}
    assert found["contact_within"][3:] == pytest.approx((1, 0.025, 1, 1))


def test_the_error_of_a_clip_is_the_median_of_the_frames_that_give_a_time() -> None:
    """The errors are 0, 0.1 and 0.6; the box is only in a frame before the first response."""
    seen = truthful([np.nan] * 12 + [1.0] * 8, {"kind": "a"}, 15, (0, 0, 9, 9))
    seen.label.contacts.update({11: 0.4, 12: 0.3, 13: 0.2, 14: 0.1, 99: 0.2})
    times = seen.outputs["d"].contact_s
    assert times is not None
    times[11:15] = 0.4, 0.33, np.nan, 0.16
    found = {one.measure: one for one in measured([seen], "d", draws_of([True], 9)).measurements}
    assert found["contact_error"].value == pytest.approx(0.1)
    assert "box_overlap" not in found


@pytest.mark.parametrize(("left_s", "clips"), [(0.0, 0), (0.1, 1), (0.5, 1), (0.6, 0)])
def test_half_a_second_before_contact_is_of_the_last_half_second(left_s: float, clips: int) -> None:
    seen = truthful([1.0] * 20, {"kind": "a"}, 15, estimate=0.4)
    seen.label.contacts.clear()
    seen.label.contacts[10] = left_s
    found = {one.measure: one for one in measured([seen], "d", draws_of([True], 100)).measurements}
    assert found["contact_within"].n == clips


@pytest.mark.parametrize(
    ("box", "share"),
    [((0, 0, 10, 20), 1 / 2), ((5, 0, 10, 10), 1 / 3), ((20, 20, 5, 5), 0), ((0, 0, 10, 10), 1)],
)
def test_the_overlap_of_a_box_with_that_of_the_truth(box: tuple[float, ...], share: float) -> None:
    clips = [truthful([1.0] * 20, {"kind": "a"}, 15, box)]
    found = {one.measure: one for one in measured(clips, "d", draws_of([True], 100)).measurements}
    assert found["box_overlap"].value == pytest.approx(share)


def test_boxes_without_an_area_do_not_overlap() -> None:
    assert overlap((5, 5, 0, 0), (5, 5, 0, 0)) == 0


@pytest.mark.slow
def test_one_command_draws_labels_and_measures(tmp_path: Path) -> None:
    changes = [f"--change={key}={value}" for key, value in SMALL.items()]
    wanted = [HIT, MISS, *changes, "-j", "1", "--draws", "100", "--model", "opplod"]
    done = oppload("evaluate", *wanted, "-o", tmp_path / "out")
    assert done.returncode == 0
    assert "approaches: 1, clips without one: 1, " in done.stderr
    with (tmp_path / "out" / "evaluation.csv").open() as lines:
        found = {(row["measure"], row["condition"]) for row in csv.DictReader(lines)}
    assert ("alarmed_share", "alarm as shipped, kind near miss at 2 sizes") in found
    assert ("box_overlap", "5 frames before contact") in found


@pytest.mark.slow
def test_a_lossless_video_of_a_stimulus_gives_what_the_stimulus_gives(tmp_path: Path) -> None:
    changes = [f"--change={key}={value}" for key, value in SMALL.items()]
    wanted = ["-j", "1", "--draws", "100", "--model", "opplod"]
    assert oppload("evaluate", HIT, MISS, *changes, *wanted, "-o", tmp_path / "out").returncode == 0
    for name in (HIT, MISS):
        stimulus.write(stimulus.load(name, SMALL), tmp_path)
    done = oppload("evaluate", *sorted(tmp_path.glob("*.avi")), *wanted, "-o", tmp_path / "b")
    assert done.returncode == 0
    figures = [(tmp_path / name / "evaluation.csv").read_bytes() for name in ("out", "b")]
    assert figures[0] == figures[1]


def test_what_cannot_be_drawn_is_a_fault(tmp_path: Path) -> None:
    wanted = [HIT, MISS, "--change=scene.background=gone.mp4", "--draws", "100", "-j", "1"]
    done = oppload("evaluate", *wanted, "-o", tmp_path)
    assert done.returncode == 3
    # The fault of both stimuli is named once.
    assert "row 1 and 1 other row: scene: background = 'gone.mp4'" in done.stderr
    assert done.stderr.count("gone.mp4") == 1


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["staged/collison"], "no stimulus 'staged/collison'"),
        (["staged/collision", "--boxes", "b.json"], "--boxes goes with a manifest"),
        (["m.csv", "--background", "a.mp4"], "--background and --change go with stimuli"),
    ],
)
def test_what_does_not_go_together_is_refused(arguments: list[str], said: str) -> None:
    done = oppload("evaluate", *arguments)
    assert done.returncode == 2
    assert said in done.stderr


@pytest.mark.long
def test_images_of_a_stimulus_have_its_label(tmp_path: Path) -> None:
    stimulus.write(stimulus.load(HIT, SMALL), tmp_path, form="png")
    (folder,) = (path for path in tmp_path.iterdir() if path.is_dir())
    (entry,) = clips_of([str(folder)], None, [], []).entries
    true = label_of(HIT, *CHANGES)
    assert (entry.path, entry.label.name) == (folder, folder.name)
    assert (entry.label.onset, entry.label.boxes) == (true.onset, true.boxes)


def test_the_boxes_of_a_scaled_video_are_in_its_own_pixels(tmp_path: Path) -> None:
    truth = stimulus.ground_truth(stimulus.load(HIT, SMALL))
    for name, width, frames in (("half", 32, 30), ("other", 48, 30), ("long", 32, 60)):
        write_video(tmp_path / f"{name}.avi", grey_frames(frames, width, 24))
        (tmp_path / f"{name}.stimulus.json").write_text(json.dumps(truth))
    videos = [str(tmp_path / f"{name}.avi") for name in ("half", "other", "long")]
    (tmp_path / "empty.avi").touch()
    videos.append(str(tmp_path / "empty.avi"))
    found = clips_of([*videos, videos[0]], None, [], [])  # each video counts once
    (label,) = (entry.label for entry in found.entries)
    complete = label_of(HIT, *CHANGES)
    write_video(tmp_path / "wide.avi", grey_frames(30, 65, 48))  # not of the display's shape
    (tmp_path / "wide.stimulus.json").write_text(json.dumps(truth))
    (wide,) = clips_of([str(tmp_path / "wide.avi")], None, [], []).entries
    for frame, box in complete.boxes.items():
        stretched = 65 / 64 * box.x, box.y, 65 / 64 * box.width, box.height
        assert wide.label.boxes[frame] == pytest.approx(stretched)
    assert label.boxes == {
        frame: tuple(side / 2 for side in box) for frame, box in complete.boxes.items()
    }
    # Of boxes that reach into the display by half a pixel and by one and a half, one has a place.
    for frame, left in ((18, 63.5), (19, 62.5)):
        truth["frames"][frame]["objects"][0]["box_px"] = [left, 10, 20, 20]
    (tmp_path / "half.stimulus.json").write_text(json.dumps(truth))
    matched = [str(path) for path in tmp_path.glob("half.*")]  # also the ground truth
    (entry,) = clips_of(matched, None, [], []).entries
    assert 18 not in entry.label.boxes
    assert entry.label.boxes[19] == pytest.approx((31.25, 5, 0.75, 10))
    assert ["belongs to another video" in fault for fault in found.faults] == [True, True, False]
    assert found.faults[2].startswith(f"{videos[3]}: the file is empty")
