"""The detectors over frames whose repeats are given."""

from __future__ import annotations

from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from oppload_cli.detection.places import Detection
from oppload_cli.frame_times import ticks
from oppload_cli.frames.preparation import Prepared
from oppload_cli.frames.repeats import EXACT, Repeat
from oppload_cli.models.detector import Box, Response
from oppload_cli.models.timebase import TimeParams
from oppload_cli.motion.rmo import RmoMetrics
from oppload_cli.pipeline.analysis import pass_params
from oppload_cli.pipeline.one_pass import DetectorPass, PassParams
from oppload_cli.video.frames import Frame, InputFacts, WorkingSize
from tests.media import texture

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

SIDE = 32


def passed(rate: int, name: str = "frame_difference", *, real_time: bool = False) -> DetectorPass:
    facts = InputFacts("a", "camera", SIDE, SIDE, Fraction(rate), None, real_time=real_time)
    return DetectorPass(WorkingSize.of(facts, None), [], facts, pass_params([name]), None)


def test_only_the_step_over_a_dropped_frame_has_no_pictures_in_between() -> None:
    """Frames 1/15 s apart; frame 2 was dropped, because the machine was too slow."""
    detectors, given = passed(15, real_time=True), []

    class Interpolation:
        def step(self, _luma: object, intervals: float, _flow: object) -> list[Any]:
            given.append(intervals)
            return []

    detectors._interpolations = {(SIDE, SIDE): Interpolation()}  # type: ignore[dict-item]
    luma = np.zeros((SIDE, SIDE), np.float32)
    for index in (0, 1, 3, 4):
        detectors.step(Prepared(Frame(index, ticks(index / 15), luma), Repeat(), None, None))
    assert given == pytest.approx([0, 2, 0, 2])


def test_motion_after_exact_repeats_is_blind_from_its_own_start() -> None:
    """A picture is repeated five times, and the detectors do not begin again."""
    detectors, blind = passed(30), []
    for index in range(20):
        still = 0 < index <= 5
        luma = np.full((SIDE, SIDE), 0 if still else index / 20, np.float32)
        repeat = Repeat(EXACT, passed_over=True) if still else Repeat()
        if detectors.step(
            Prepared(Frame(index, ticks(index / 30), luma), repeat, None, None)
        ).blind:
            blind.append(index)
    assert blind == [0, *range(6, 16)]  # for 0.35 s from 1/30 s before frame 6 on


@pytest.mark.parametrize(("repeat", "count"), [(Repeat(), 2), (Repeat(EXACT), 0)])
def test_a_repeat_outside_a_cadence_has_no_object(
    monkeypatch: pytest.MonkeyPatch, repeat: Repeat, count: int
) -> None:
    detectors, box = passed(30, "opplod"), Box(0, 0, 8, 8)
    found = [Detection(n, box, 4, 4, 0.5, False, left) for n, left in ((1, 0.3), (2, None))]
    monkeypatch.setattr(detectors, "_objects", lambda *_: tuple(found))
    frame = Frame(0, 0, np.zeros((SIDE, SIDE), np.float32))
    prepared = Prepared(frame, repeat, None, None)
    for blind, evidence in (("", 0.5), ("cut", 0.0)):
        said = detectors._judged({"opplod": Response(0.5)}, prepared, blind)["opplod"]
        assert (len(said.objects), said.evidence) == (count, evidence)


def moving(count: int) -> list[NDArray[np.float32]]:
    wide = texture(SIDE, SIDE + count, 2)
    return [np.ascontiguousarray(wide[:, t : t + SIDE]) for t in range(count)]


def flows_of(chosen: PassParams, frames: Sequence[Frame]) -> list[Prepared]:
    preparation = chosen.preparation(None)
    return [preparation.step(frame) for frame in frames]


@pytest.mark.parametrize(("interval", "older"), [("frame", 1), ("1/30", 2), ("0.1", 6)])
def test_the_flow_is_that_of_an_interval_of_the_time_base(interval: str, older: int) -> None:
    """At 60 frames/s a texture moves left by 1 px in each frame."""
    chosen = pass_params(["frame_difference"], time=TimeParams(interval=interval))
    frames = [Frame(t, ticks(t / 60), luma) for t, luma in enumerate(moving(12))]
    first, *_, latest = flows_of(chosen, frames)
    assert first.flow is None
    assert latest.flow is not None
    assert latest.flow.passed_s == pytest.approx(older / 60)
    assert np.median(latest.flow.vectors[..., 0]) == pytest.approx(-older, abs=0.4)


def test_a_repeat_has_no_flow_and_the_next_picture_that_of_its_own_step() -> None:
    frames = moving(20)
    for t in (10, 15):
        frames[t] = frames[t - 1]
    prepared = flows_of(
        pass_params([]), [Frame(t, ticks(t / 30), luma) for t, luma in enumerate(frames)]
    )
    for t in (10, 15):
        assert prepared[t].repeat.kind
        assert prepared[t].flow is None
        assert prepared[t].rmo == RmoMetrics()
        after = prepared[t + 1].flow
        assert after is not None
        assert np.median(after.vectors[..., 0]) == pytest.approx(-2, abs=0.3)


def test_after_a_rest_the_flow_is_that_of_one_step() -> None:
    """The scene stands still for longer than a repeat lasts."""
    frames = [*[moving(4)[0]] * 20, *moving(4)[1:]]
    prepared = flows_of(
        pass_params([]), [Frame(t, ticks(t / 30), luma) for t, luma in enumerate(frames)]
    )
    flow = prepared[20].flow
    assert flow is not None
    assert np.median(flow.vectors[..., 0]) == pytest.approx(-1, abs=0.3)
    assert flow.passed_s == pytest.approx(1 / 30)
