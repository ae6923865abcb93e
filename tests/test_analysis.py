from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from oppload_cli import (
    Dlgmd,
    DlgmdParams,
    FrameRecord,
    OpplodParams,
    OpplodResponse,
    RmoMetrics,
    analyse,
    open_video,
)
from tests.media import looming, write_video

if TYPE_CHECKING:
    from pathlib import Path


def records(path: Path, height: int | None = None) -> list[FrameRecord]:
    with open_video(path, height=height) as video:
        return list(analyse(video))


def eight_bits(frames: list[np.ndarray]) -> list[np.ndarray]:
    return [(frame * 255).round().astype(np.uint8) for frame in frames]


def test_content_that_is_slower_than_its_file_answers_as_it_would_at_its_own_rate(
    tmp_path: Path,
) -> None:
    frames = eight_bits(looming(120, 60, 60, 10))
    own = records(write_video(tmp_path / "own.mkv", frames, rate=10))
    thrice = [frame for frame in frames for _ in range(3)]
    copied = records(write_video(tmp_path / "copied.mkv", thrice, rate=30))
    assert [each.responses for each in copied[::3]] == [each.responses for each in own]
    assert sum(each.repeat for each in copied) == 20
    for record in (*copied[4::3], *copied[5::3]):
        assert [answer.response for answer in record.responses.values() if answer] == [0, 0]


def test_a_scene_that_stands_still_is_seen_by_the_models(tmp_path: Path) -> None:
    """After a pause the first moving frame meets no inhibition, as the equations have it."""
    moving = eight_bits(looming(120, 60, 60, 14))
    paused = [*moving[:4], *([moving[4]] * 12), *moving[5:]]
    with_pause = records(write_video(tmp_path / "a.mkv", paused))
    assert with_pause[14].responses["dlgmd"] is not None
    after = with_pause[16].responses["dlgmd"]
    assert after is not None
    without = records(write_video(tmp_path / "b.mkv", moving))[5].responses["dlgmd"]
    assert without is not None
    assert after.response > 2 * without.response


@pytest.mark.parametrize("pause", [6, 7, 12])
def test_motion_after_a_still_start_is_answered_at_once(tmp_path: Path, pause: int) -> None:
    moving = eight_bits(looming(120, 60, 60, 6))
    frames = [*([moving[0]] * (pause + 1)), *moving[1:]]
    shown = records(write_video(tmp_path / "a.mkv", frames))
    model = Dlgmd((120, 120))
    for record, frame in zip(shown, frames, strict=True):
        assert record.responses["dlgmd"] == model.step(frame.astype(np.float32) / np.float32(255))


def test_a_still_video_answers_zero_from_the_fourth_frame(tmp_path: Path) -> None:
    still = records(write_video(tmp_path / "a.mkv", [np.full((48, 64), 90, np.uint8)] * 12))
    assert [each.responses["opplod"] for each in still[:3]] == [None] * 3
    for record in still[3:]:
        assert [answer.response for answer in record.responses.values() if answer] == [0, 0]
    assert [each.luma_change for each in still] == [None] + [0] * 11
    assert [each.rmo for each in still] == [None] + [RmoMetrics()] * 11


def test_boxes_are_in_source_pixels(tmp_path: Path) -> None:
    frames = eight_bits(looming(240, 160, 100, 12))
    at_half = records(write_video(tmp_path / "a.mkv", frames), height=120)
    boxes = [
        answer.box
        for each in at_half
        if isinstance(answer := each.responses["opplod"], OpplodResponse) and answer.box
    ]
    last = boxes[-1]
    assert (last.width, last.height) == (100, 100)
    centre = (last.x + last.width / 2, last.y + last.height / 2)
    assert centre == pytest.approx((160, 100), abs=8)


def test_one_model_alone(tmp_path: Path) -> None:
    path = write_video(tmp_path / "a.mkv", eight_bits(looming(60, 30, 30, 6)))
    with open_video(path) as video:
        [*_, last] = analyse(video, [DlgmdParams()])
    assert list(last.responses) == ["dlgmd"]
    assert "opplod_response" not in last.values()
    with open_video(path) as video:
        [*_, last] = analyse(video, [OpplodParams()])
    assert "dlgmd_response" not in last.values()
