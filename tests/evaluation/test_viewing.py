from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from oppload_cli import DlgmdParams, OpplodParams, OpplodResponse, analyse, open_video
from oppload_cli.detection.evaluation.series import Label
from oppload_cli.evaluation.contenders import Contender, contenders
from oppload_cli.evaluation.manifest import Entry
from oppload_cli.evaluation.viewing import view
from oppload_cli.motion.divergence import FlowDivergence
from tests.media import grey_frames, write_video

if TYPE_CHECKING:
    from pathlib import Path

# What does not depend on the size is quick at a small one.
SMALL = [replace(each, height=60) for each in contenders(["opplod:default"])]


def test_contenders_answer_as_they_do_alone(labelled: Path) -> None:
    path = labelled / "beside.avi"
    # Two OppLoDs of the same size, and one of another, in step.
    wide = Contender("opplod:wide", "", 120, OpplodParams(receptive_field=80))
    small = Contender("opplod:small", "", 60, OpplodParams())
    usual = [replace(each, height=120) for each in contenders(["opplod:default"])]
    viewed = view(Entry(2, path, Label("beside.avi", 45, 89)), [wide, small, *usual])
    seen = viewed.seen
    assert seen is not None
    assert viewed.faults == []
    assert (len(seen), seen.width, seen.height, seen.first) == (90, 160, 120, 3)
    assert list(seen.answers)[:3] == ["opplod:wide", "opplod:small", "opplod:default"]
    for name, params, height in (
        ("opplod:default", OpplodParams(), 120),
        ("opplod:wide", OpplodParams(receptive_field=80), 120),
        ("opplod:small", OpplodParams(), 60),
        ("dlgmd", DlgmdParams(), 120),
    ):
        with open_video(path, height=height) as video:
            records = list(analyse(video, [params], rmo=None))
        found, model = seen.answers[name], name.split(":", maxsplit=1)[0]
        answers = [record.responses[model] for record in records]
        alone = [np.nan if each is None else each.response for each in answers]
        assert np.array_equal(found.response, alone, equal_nan=True)
        assert found.alarm is not None
        assert found.alarm.tolist() == [record.alarms.get(model, False) for record in records]
        last = answers[-1]
        if isinstance(last, OpplodResponse) and last.box and found.place is not None:
            box = last.box
            assert found.place[-1].tolist() == [box.x, box.y, box.width, box.height]
        else:
            assert found.place is None
    changes = [record.luma_change for record in records]
    assert np.array_equal(
        seen.answers["mean_p"].response[1:], np.array(changes[1:], float), equal_nan=True
    )


def test_the_flow_is_that_of_the_frames_that_are_no_copies(tmp_path: Path) -> None:
    frames = [frame for frame in grey_frames(8, 128, 96) for _ in range(2)]
    path = write_video(tmp_path / "twice.mkv", frames)
    viewed = view(Entry(2, path, Label("twice.mkv")), SMALL)
    assert viewed.seen is not None
    found = viewed.seen.answers["flow_divergence"].response
    assert found[1::2].tolist() == [0.0] * 8
    flow = FlowDivergence()
    with open_video(path, height=60) as video:
        alone = [flow.step(frame.luma) for frame in video if frame.index % 2 == 0]
    assert found[2::2].tolist() == alone[1:]
    assert np.isnan(found[0])


@pytest.mark.parametrize(
    ("label", "reason"),
    [
        (Label("a", 45, 90), "its contact, frame 90, is beyond its last frame, 89"),
        (Label("a", 0, 2), "its contact, frame 2, is before the first response, frame 3"),
    ],
)
def test_a_contact_where_nothing_can_answer(labelled: Path, label: Label, reason: str) -> None:
    viewed = view(Entry(2, labelled / "centre.avi", label), SMALL)
    assert viewed.seen is None
    assert reason in viewed.faults[0]


def test_what_cannot_be_decoded_or_is_too_short(tmp_path: Path) -> None:
    (tmp_path / "text.avi").write_text("no video")
    viewed = view(Entry(2, tmp_path / "text.avi", Label("text.avi")), SMALL)
    assert viewed.seen is None
    assert "text.avi" in viewed.faults[0]
    short = write_video(tmp_path / "short.mkv", grey_frames(3))
    viewed = view(Entry(2, short, Label("short.mkv")), SMALL)
    assert viewed.faults == ["short.mkv: has 3 frames, too few for any response; leave it out"]


def test_a_cut_clip_is_used_and_said_to_be_cut(tmp_path: Path) -> None:
    whole = write_video(tmp_path / "whole.mkv", grey_frames(60, 320, 240)).read_bytes()
    (tmp_path / "cut.mkv").write_bytes(whole[: len(whole) * 2 // 3])
    boxes = {50: (0.0, 0.0, 1.0, 1.0)}
    viewed = view(Entry(2, tmp_path / "cut.mkv", Label("cut.mkv", boxes=boxes)), SMALL)
    assert viewed.seen is not None
    assert 30 < len(viewed.seen) < 50
    assert viewed.faults[0] == "cut.mkv: is damaged or cut; what could be decoded is used"
    assert "cut.mkv: the box of frame 50 is beyond its last frame" in viewed.faults[1]
