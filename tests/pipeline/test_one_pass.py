"""The detectors over frames whose repeats are given."""

from __future__ import annotations

from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from oppload_cli.detection.places import Detection
from oppload_cli.models.detector import Box, Response
from oppload_cli.pipeline.analysis import pass_params
from oppload_cli.pipeline.one_pass import DetectorPass, Prepared
from oppload_cli.pipeline.repeats import EXACT, Repeat
from oppload_cli.video.frames import Frame, InputFacts, WorkingSize

if TYPE_CHECKING:
    from numpy.typing import NDArray

SIDE = 32


def passed(rate: int, name: str = "frame_difference", *, real_time: bool = False) -> DetectorPass:
    facts = InputFacts("a", "camera", SIDE, SIDE, Fraction(rate), None, real_time=real_time)
    return DetectorPass(WorkingSize.of(facts, None), facts, pass_params([name]), None)


def test_only_the_step_over_a_dropped_frame_has_no_pictures_in_between() -> None:
    """Frames 1/15 s apart; frame 2 was dropped, because the machine was too slow."""
    detectors, given = passed(15, real_time=True), []

    class Interpolation:
        def step(self, _luma: NDArray[np.float32], intervals: float) -> list[Any]:
            given.append(intervals)
            return []

    detectors._interpolation = Interpolation()  # type: ignore[assignment]
    luma = np.zeros((SIDE, SIDE), np.float32)
    for index in (0, 1, 3, 4):
        detectors.step(Prepared(Frame(index, index / 15, luma), Repeat(), None))
    assert given == pytest.approx([0, 2, 0, 2])


def test_motion_after_exact_repeats_is_blind_from_its_own_start() -> None:
    """A picture is repeated five times, and the detectors do not begin again."""
    detectors, blind = passed(30), []
    for index in range(20):
        still = 0 < index <= 5
        luma = np.full((SIDE, SIDE), 0 if still else index / 20, np.float32)
        repeat = Repeat(EXACT, passed_over=True) if still else Repeat()
        if detectors.step(Prepared(Frame(index, index / 30, luma), repeat, None)).blind:
            blind.append(index)
    assert blind == [0, *range(6, 16)]  # for 0.345 s from 1/30 s before frame 6 on


@pytest.mark.parametrize(
    ("repeat", "count", "evidence"), [(Repeat(), 2, 5.0), (Repeat(EXACT), 0, 0.5)]
)
def test_the_first_object_is_near_contact_but_a_repeat_outside_a_cadence_has_no_object(
    monkeypatch: pytest.MonkeyPatch, repeat: Repeat, count: int, evidence: float
) -> None:
    detectors, box = passed(30, "opplod"), Box(0, 0, 8, 8)
    found = [Detection(n, box, 4, 4, 0.5, False, left) for n, left in ((1, 0.3), (2, None))]
    monkeypatch.setattr(detectors, "_objects", lambda *_: tuple(found))
    frame = Frame(0, 0.0, np.zeros((SIDE, SIDE), np.float32))
    objects, _ = detectors._judged({"opplod": Response(0.5)}, frame, repeat, "")
    assert len(objects["opplod"]) == count
    assert detectors._alarms["opplod"].evidence == pytest.approx(evidence)


@pytest.mark.parametrize("sudden", [False, True])
def test_no_alarm_starts_with_a_sudden_response_of_a_detector(
    monkeypatch: pytest.MonkeyPatch, sudden: bool
) -> None:
    detectors = passed(30)
    responses = iter([*[0.0] * 13, 1.0])

    def respond(*_: object) -> dict[str, Response]:
        return {"frame_difference": Response(next(responses), sudden=sudden)}

    monkeypatch.setattr(detectors._bank, "respond", respond)
    for index in range(14):
        luma = np.full((SIDE, SIDE), index % 2 / 10, np.float32)
        record = detectors.step(Prepared(Frame(index, index / 30, luma), Repeat(), None))
    assert not record.blind
    assert record.alarms["frame_difference"] != sudden
