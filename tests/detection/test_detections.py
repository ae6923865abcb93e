from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import pytest

from oppload_cli import Detection, FrameRecord, alarm_params, analyse, open_video
from oppload_cli.detection.contact import PlaceParams
from oppload_cli.detection.places import Detections
from oppload_cli.models.detector import Box, Response
from oppload_cli.models.opplod_reference import OpplodReference, OpplodReferenceResponse
from oppload_cli.motion.flow import DenseFlow
from oppload_cli.video.frames import WorkingSize
from oppload_cli.video.optics import View
from tests.detection.showing import RATE, SIZE, approaching, remaining, together
from tests.media import write_video

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from tests.media import Luma

PLACES = PlaceParams().of(OpplodReference.least_object)
TWICE = WorkingSize(SIZE, SIZE, 3.0, 2.0)


def two_disks(frames: int) -> list[Luma]:
    return together(approaching(65, 70, 26, frames), approaching(178, 165, 28, frames))


def detected(
    frames: Iterable[Luma], alarm: bool = False, threshold: float = math.inf
) -> list[Detection]:
    """The detections of the last frame; the alarm goes on with it."""
    model = OpplodReference((SIZE, SIZE))
    detections, measured = Detections(TWICE, PLACES), DenseFlow()
    found: tuple[Detection, ...] = ()
    for t, frame in enumerate(frames):
        flow = measured.step(frame, t / RATE)
        if model.step(frame):
            found = detections.step(model.units, flow, t / RATE)
    return list(detections.with_alarm(found, alarm=alarm, threshold=threshold))


def test_detections_are_in_source_pixels() -> None:
    [found] = detected(approaching(131, 103, 24, 18))
    assert (found.centre_x, found.centre_y) == pytest.approx((3 * 131, 2 * 103), abs=3)
    assert (found.box.width / 3, found.box.height / 2) == pytest.approx((96, 96), rel=0.25)
    x, y = found.box.centre
    assert (x / 3, y / 2) == pytest.approx((131, 103), abs=10)
    assert found.time_to_contact_s == pytest.approx(remaining(17, 24), rel=0.2)


def test_boxes_end_at_the_frame() -> None:
    """The radius is 80 px; a few of the outermost samples are left out."""
    [found] = detected(approaching(70, 70, 24, 20))
    assert (found.box.x / 3, found.box.y / 2) == pytest.approx((4, 4), abs=4)
    assert (found.box.width / 3, found.box.height / 2) == pytest.approx((150, 150), rel=0.2)


def test_the_alarm_is_that_of_what_set_it_off_and_of_what_is_above_the_threshold() -> None:
    frames = two_disks(20)
    first, second = detected(frames)
    assert [each.alarm for each in (first, second)] == [False, False]
    between = (first.response + second.response) / 2
    assert [each.alarm for each in detected(frames, alarm=True)] == [True, False]
    assert [each.alarm for each in detected(frames, True, between)] == [True, False]
    assert [each.alarm for each in detected(frames, True, second.response / 2)] == [True, True]
    assert [each.alarm for each in detected(frames, False, second.response / 2)] == [False, False]


def records(path: Path, frames: Iterable[Luma]) -> list[FrameRecord]:
    images = [(frame * 255).round().astype(np.uint8) for frame in frames]
    with open_video(write_video(path, images)) as video:
        alarm = alarm_params(guard_s=0, enough_s=0)
        return list(analyse(video, ["opplod_reference"], alarm=alarm))


def test_a_pass_over_a_video_gives_detections(tmp_path: Path) -> None:
    found = records(tmp_path / "a.mkv", [*two_disks(21), *[two_disks(21)[-1]] * 8])
    for record in found[:21]:
        response = record["opplod_reference"].answer
        if record.detections:
            assert isinstance(response, OpplodReferenceResponse)
            assert record.detections[0].response == pytest.approx(response.response, rel=1e-5)
    assert [len(record.detections) for record in found[15:21]] == [2] * 6
    assert found[20]["opplod_reference"].alarm
    assert found[20].detections[0].alarm
    # It stands still.
    assert not any(record.detections for record in found[21:])


def test_a_still_video_has_no_detections(tmp_path: Path) -> None:
    found = records(tmp_path / "a.mkv", [two_disks(16)[-1]] * 14)
    assert not any(record.detections for record in found)


def test_no_objects_are_looked_for_without_opplod_or_places(tmp_path: Path) -> None:
    images = [(frame * 255).round().astype(np.uint8) for frame in two_disks(20)]
    path = write_video(tmp_path / "a.mkv", images)
    with open_video(path) as video:
        assert not any(record.detections for record in analyse(video, places=None))
    from oppload_cli import DlgmdParams

    with open_video(path) as video:
        assert not any(record.detections for record in analyse(video, [DlgmdParams()]))


def seen(identity: int, response: float, left: float | None = None) -> Detection:
    """An object without a place."""
    return Detection(identity, Box(0, 0, 9, 9), 4.0, 4.0, response, False, left, 0.05)


def test_an_alarm_that_ends_leaves_nothing_to_the_next_one() -> None:
    detections = Detections(TWICE, PLACES)
    one, other = seen(1, 0.5), seen(2, 0.4)

    def on(*found: Detection, alarm: bool) -> list[int]:
        known = detections.with_alarm(found, alarm=alarm, threshold=math.inf)
        return [each.identity for each in known if each.alarm]

    assert on(one, other, alarm=True) == [1]
    assert on(other, one, alarm=True) == [1]  # it went on because of this one
    assert on(other, one, alarm=False) == []
    assert on(other, one, alarm=True) == [2]


def test_a_time_to_contact_that_has_passed_is_none() -> None:
    left = [seen(1, 0.5, 0.2).after(passed_s) for passed_s in (0.15, 0.2, 0.3)]
    assert [each.time_to_contact_s for each in left] == [pytest.approx(0.05), None, None]
    assert [each.time_to_contact_error_s for each in left] == [0.05, None, None]


def test_the_angular_speed_is_known_as_long_as_the_time_to_contact() -> None:
    view = View(0.0, 0.0, 9.0, 9.0, 9.0, 50.0)
    left = [seen(1, 0.5, 0.2)._replace(view=view).after(passed_s) for passed_s in (0.15, 0.3)]
    assert [each.view and each.view.angular_speed_deg_s for each in left] == [50.0, None]


def test_a_box_ends_at_the_right_and_the_lower_edge_of_a_wide_frame() -> None:
    answer = Response(1.0, Box(30, 20, 20, 30))
    [found] = Detections(WorkingSize(40, 30, 3.0, 2.0), PLACES).of_box(answer)
    assert [*found.box] == [90, 40, 30, 20]
    assert (found.centre_x, found.centre_y) == (120, 70)
