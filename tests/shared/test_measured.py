"""The measuring material beside the project; skipped, loudly, where it is missing."""

from __future__ import annotations

import csv
from typing import TYPE_CHECKING

import numpy as np
import pytest

from oppload_cli import DlgmdParams, OpplodReferenceResponse, analyse, open_video
from oppload_cli.models.dlgmd import DlgmdResponse

if TYPE_CHECKING:
    from pathlib import Path


def manifest(shared: Path) -> list[dict[str, str]]:
    with (shared / "clips" / "manifest.csv").open() as file:
        return list(csv.DictReader(file))


def test_dlgmd_gives_the_authors_numbers_on_their_own_stimulus(shared: Path) -> None:
    with (shared / "data" / "dlgmd_ball_reference.csv").open() as file:
        expected = {int(row["frame"]): row for row in csv.DictReader(file)}
    with open_video(shared / "data" / "dlgmd_ball", height=None) as video:
        records = list(analyse(video, [DlgmdParams()]))
        pixels = video.working.width * video.working.height
    assert len(records) == 61
    for record in records[3:]:
        answer = record["dlgmd"].answer
        assert isinstance(answer, DlgmdResponse)
        row = expected[record.frame]
        assert answer.s * pixels == pytest.approx(float(row["sum_s"]), rel=1e-3)
        assert answer.response * pixels == pytest.approx(float(row["sum_g"]), rel=1e-3)


def test_opplod_finds_the_collision_of_tc22(shared: Path) -> None:
    with open_video(shared / "clips" / "tc22.mp4") as video:
        records = list(analyse(video, ["opplod_reference"]))
    answers = [record["opplod_reference"].answer for record in records]
    values = [answer.response if answer else 0.0 for answer in answers]
    peak = int(np.argmax(values))
    assert 50 <= peak <= 62
    best = answers[peak]
    assert isinstance(best, OpplodReferenceResponse)
    assert best.box is not None
    x, y = best.box.x + best.box.width / 2, best.box.y + best.box.height / 2
    # The labelled box of frame 58 is x 214 to 410, y 0 to 97.
    assert (204 <= x <= 420, 0 <= y <= 107) == (True, True)


@pytest.mark.slow
def test_every_clip_runs_to_its_end(shared: Path) -> None:
    for row in manifest(shared):
        with open_video(shared / "clips" / row["file"]) as video:
            count = sum(1 for _ in analyse(video))
            assert count == int(row["frames"]), row["file"]
            assert video.decode.complete, row["file"]
