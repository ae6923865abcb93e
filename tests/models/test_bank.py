from __future__ import annotations

import pickle
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import cv2
import numpy as np
import pytest

from oppload_cli.detection.alarm import alarm_params
from oppload_cli.errors import DetectorError, FrameError, ParameterError
from oppload_cli.models import registry
from oppload_cli.models.bank import DetectorBank
from oppload_cli.models.detector import AlarmRule, Box, Column, Detector, Response, UnitMaps
from oppload_cli.models.dlgmd import Dlgmd, DlgmdParams, DlgmdResponse
from oppload_cli.models.frame_difference import FrameDifferenceParams
from oppload_cli.models.opplod import OpplodParams
from oppload_cli.models.opplod_reference import (
    OpplodReference,
    OpplodReferenceParams,
    OpplodReferenceResponse,
)
from oppload_cli.models.registry import detectors
from oppload_cli.motion.flow import Flow
from oppload_cli.schema import Parameters
from tests.arithmetic import many_bands
from tests.media import disk, looming

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.media import Luma

__all__ = ["many_bands"]

pytestmark = pytest.mark.usefixtures("same_detectors_after")


def random_frames(count: int, shape: tuple[int, int]) -> list[Luma]:
    return list(np.random.default_rng(21).random((count, *shape), dtype=np.float32))


def test_the_bank_gives_p_and_its_mean() -> None:
    frames = looming(120, 60, 60, 4)
    bank = DetectorBank((120, 120), [OpplodReferenceParams()])
    bank.step(frames[0])
    assert bank.luma_change is None
    assert not bank.photoreceptors.any()
    bank.step(frames[1])
    change = np.abs(frames[1] - frames[0])
    np.testing.assert_array_equal(bank.photoreceptors, change)
    assert bank.luma_change == pytest.approx(float(change.mean()))


def test_reset_starts_over() -> None:
    frames = looming(60, 30, 30, 6)
    bank = DetectorBank((60, 60), [OpplodParams(), DlgmdParams(), FrameDifferenceParams()])
    first = [bank.step(frame) for frame in frames]
    bank.reset()
    assert [bank.step(frame) for frame in frames] == first
    assert bank.luma_change is not None


@pytest.mark.once
@pytest.mark.parametrize("kind", detectors().values(), ids=detectors())
def test_every_detector_refuses_an_array_that_is_no_frame(kind: type[Detector]) -> None:
    """A detector refuses the array at every frame, and then answers as if it had not come."""
    frames = [disk(40, 20, 20, 5 + t) * np.float32(0.9 + 0.1 * (t % 2)) for t in range(7)]
    model, other = kind((40, 40), frame_rate=30), kind((40, 40), frame_rate=30)
    gap = frames[0].copy()
    gap[3, 4] = np.nan
    wrong: list[Any] = [gap, gap[1:], frames[0].astype(np.float64), np.full_like(gap, -np.inf)]
    wrong += [None, gap.tolist()]
    for frame in frames:
        for array in wrong:
            with pytest.raises(FrameError, match=r"float32 array of shape|not finite"):
                model.step(array)
        assert model.step(frame) == other.step(frame)


def test_no_model_is_an_error() -> None:
    with pytest.raises(ParameterError, match="no model is chosen; name at least one"):
        DetectorBank((9, 9), [])


def test_a_model_given_twice_is_an_error() -> None:
    with pytest.raises(ParameterError, match="model 'dlgmd' is given twice; name each once"):
        DetectorBank((9, 9), [DlgmdParams(), DlgmdParams(group_size=2)])


@pytest.mark.usefixtures("many_bands")
def test_the_number_of_threads_changes_no_bit() -> None:
    frames = random_frames(7, (90, 131))
    answers, maps = [], []
    for threads in (1, 2, 5):
        cv2.setNumThreads(threads)
        bank = DetectorBank((90, 131), [OpplodReferenceParams(), DlgmdParams()])
        answers.append([bank.step(frame) for frame in frames])
        opplod, dlgmd = bank.detectors.values()
        assert isinstance(opplod, OpplodReference)
        assert isinstance(dlgmd, Dlgmd)
        pathways = b"".join(layer.tobytes() for layer in opplod.maps.values())
        maps.append((pathways, dlgmd.grouped.tobytes()))
    assert answers[0] == answers[1] == answers[2]
    assert answers[0][-1]["opplod_reference"] is not None
    assert maps[0] == maps[1] == maps[2]


@pytest.mark.once
def test_a_bank_forgets_within_its_memory() -> None:
    memory = 3
    params = OpplodReferenceParams(receptive_field=40, cell=5, history=0)
    # A frame of high contrast after faint frames is not completely inhibited.
    frames = [
        frame * np.float32(0.02 if t % memory else 1)
        for t, frame in enumerate(random_frames(20, (60, 80)))
    ]
    bank, fresh = (DetectorBank((60, 80), [DlgmdParams(), params]) for _ in "ab")
    for frame in frames:
        bank.step(frame)
    for frame in frames[:memory]:
        bank.step(frame)
        fresh.step(frame)
    answer = fresh.step(frames[memory])
    assert bank.step(frames[memory]) == answer
    assert isinstance(answer["opplod_reference"], OpplodReferenceResponse)
    assert answer["opplod_reference"].response > 0


def test_the_answer_at_rest_is_that_to_a_repeated_frame() -> None:
    params = [OpplodReferenceParams(), DlgmdParams(), FrameDifferenceParams()]
    bank = DetectorBank((60, 60), params)
    none = {"opplod_reference": None, "dlgmd": None, "frame_difference": None}
    assert bank.at_rest(0, 0) == none
    for frames in range(6):
        answers = bank.step(np.full((60, 60), 0.5, np.float32))
        assert bank.at_rest(frames, frames / 30) == answers
    assert answers["dlgmd"] == DlgmdResponse(0.0)
    bank.reset()
    assert bank.at_rest(9, 0.3) == none


def test_a_detector_that_has_answered_is_never_silent() -> None:
    """Not even if its first answer was `at_rest`, in a video at rest throughout the warm-up."""
    bank = DetectorBank((60, 60), [DlgmdParams(), FrameDifferenceParams()])
    frames = looming(60, 30, 30, 6)
    assert bank.step(frames[0]) == bank.at_rest(1, 0.5 / 30)
    assert bank.at_rest(2, 2 / 30) == {"dlgmd": None, "frame_difference": Response(0.0)}
    assert bank.at_rest(3, 2.98 / 30)["dlgmd"] == DlgmdResponse(0.0)
    answers = [bank.step(frame)["dlgmd"] for frame in frames[1:]]
    assert answers[:2] == [DlgmdResponse(0.0)] * 2
    alone = Dlgmd((60, 60))
    assert answers[2:] == [alone.step(frame) for frame in frames][3:]
    moved = DetectorBank((60, 60), [DlgmdParams()])
    for frame in frames[:2]:
        moved.step(frame)
    assert moved.at_rest(9, 0.3) == {"dlgmd": None}


@dataclass(frozen=True, kw_only=True)
class LooseParams(Parameters):
    pass


class Loose(Detector):
    """A detector that returns its attribute `answer`."""

    name, label, colour, meaning = "loose", "Loose", "#000000", "for this test"
    parameters: ClassVar[type[Parameters]] = LooseParams
    answer: Any = None

    def reset(self) -> None:
        pass

    def step(self, _: Luma) -> Response | None:
        answer: Response | None = self.answer
        return answer


@dataclass(frozen=True)
class Inner(Response):
    share: Any = 0.0


def test_an_answer_of_another_class_than_declared_is_refused(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    bank = DetectorBank((9, 9), [DlgmdParams()])
    monkeypatch.setattr(Dlgmd, "step", lambda *_: Response(1.0))
    message = "detector 'dlgmd': its step returned Response, not a DlgmdResponse or None"
    with pytest.raises(DetectorError, match=message):
        bank.step(np.zeros((9, 9), np.float32))


@pytest.mark.parametrize(
    ("answer", "kind"), [(0.5, "float"), (np.float32(1), "float32"), ((1.0, None), "tuple")]
)
def test_an_answer_that_is_not_a_response_is_refused(
    monkeypatch: pytest.MonkeyPatch, answer: object, kind: str
) -> None:
    registry.register(Loose)
    bank = DetectorBank((9, 9), [DlgmdParams(), LooseParams()])
    monkeypatch.setattr(Loose, "answer", Response(0.25))
    assert bank.step(np.zeros((9, 9), np.float32))["loose"] == Response(0.25)
    monkeypatch.setattr(Loose, "answer", answer)
    message = f"detector 'loose': its step returned {kind}, not a Response or None"
    with pytest.raises(DetectorError, match=message):
        bank.step(np.zeros((9, 9), np.float32))


def test_numbers_of_numpy_become_those_of_python(monkeypatch: pytest.MonkeyPatch) -> None:
    @dataclass(frozen=True)
    class WithShare(Response):
        share: float = 0.0

    half: Any = np.float32(0.5)
    three: Any = np.int64(3)
    # A float64 is a float of Python too, but its comparisons are no bool, which JSON refuses.
    double = np.float64(2)
    monkeypatch.setattr(Loose, "answer", WithShare(three, Box(half, double, 1, 2), double))
    registry.register(Loose)
    answer = DetectorBank((9, 9), [LooseParams()]).step(np.zeros((9, 9), np.float32))["loose"]
    assert answer == WithShare(3, Box(0.5, 2, 1, 2), 2)
    assert isinstance(answer, WithShare)
    assert answer.box is not None
    kinds = [type(number) for number in (answer.response, answer.share, *answer.box)]
    assert kinds == [int, float, float, float, float, float]


@pytest.mark.parametrize(
    ("answer", "fault"),
    [
        (Response(np.nan), "a response of nan, not a finite number of at least 0"),
        (Response(np.inf), "a response of inf, not a finite"),
        (Response(-1e-9), "a response of -1e-09, not a finite"),
        (Response("0.5"), "a response of '0.5', not a finite"),  # type: ignore[arg-type]
        (Response(np.ones(9)), "a response of array"),  # type: ignore[arg-type]
        (Response(1.0, (1, 2, 3, 4)), "a box of (1, 2, 3, 4), not a Box"),  # type: ignore[arg-type]
        (Response(1.0, Box(1, 2, np.nan, 4)), "a box of Box(x=1, y=2, width=nan"),
        (Response(1.0, Box(1, 2, -3, 4)), "a box of Box(x=1, y=2, width=-3, height=4), not a Box"),
        (Response(1.0, Box("1", 2, 3, 4)), "a box of Box(x='1'"),  # type: ignore[arg-type]
        (Inner(1.0, share="much"), "share = 'much', not a finite number or None"),
        (Inner(1.0, share=np.inf), "share = inf, not a finite"),
        (Inner(1.0, share=np.ones(2)), "share = array"),
    ],
)
def test_an_answer_that_is_no_number_is_refused(
    monkeypatch: pytest.MonkeyPatch, answer: Response, fault: str
) -> None:
    monkeypatch.setattr(Loose, "answer", answer)
    monkeypatch.setattr(Loose, "responses", type(answer))
    if isinstance(answer, Inner):
        monkeypatch.setattr(Loose, "details", (Column("share", "", "share"),))
    registry.register(Loose)
    with pytest.raises(DetectorError) as refused:
        DetectorBank((9, 9), [LooseParams()]).step(np.zeros((9, 9), np.float32))
    assert f"detector 'loose': its step returned {fault}" in str(refused.value)


@pytest.mark.parametrize(
    "units",
    [
        5,
        UnitMaps([[1.0]], np.ones(1), np.ones(1), 9),  # type: ignore[arg-type]
        UnitMaps(np.ones((2, 1), np.float32), np.ones(1), np.ones(2), 9),
        UnitMaps(np.full((1, 1), np.nan, np.float32), np.ones(1), np.ones(1), 9),
    ],
)
def test_units_that_are_none_are_refused(units: object, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Loose, "units", units)
    registry.register(Loose)
    with pytest.raises(DetectorError, match="detector 'loose': its units must be UnitMaps or None"):
        DetectorBank((9, 9), [LooseParams()]).units_of("loose")


class _Failing(Loose):
    name = "failing"
    parameters = Parameters
    alarm: ClassVar = AlarmRule(0.0)

    def step(self, luma: Luma) -> Response | None:
        luma -= luma.mean()
        return None


def test_a_detector_that_fails_or_changes_the_frame_is_named() -> None:
    """The frame stays as it was for the other detectors."""
    registry.register(_Failing)
    params = [_Failing.parameters(), DlgmdParams()]
    sent = pickle.loads(pickle.dumps(params[0]))  # noqa: S301 - to another process
    assert type(sent) is _Failing.parameters
    frame = np.full((9, 9), 0.5, np.float32)
    with pytest.raises(DetectorError) as failed:
        DetectorBank((9, 9), params).step(frame)
    assert "detector 'failing': its step failed (ValueError: " in str(failed.value)
    assert f"{__file__}, line " in str(failed.value)
    assert (frame == 0.5).all()
    assert frame.flags.writeable


@pytest.mark.parametrize("member", ["at_rest", "separate", "units"])
@pytest.mark.parametrize("kind", [ValueError, SystemExit])
def test_each_member_that_fails_is_named(
    member: str, kind: type[BaseException], monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(_: Detector) -> None:
        raise kind("own words")

    failing = property(fail) if member == "units" else fail
    monkeypatch.setattr(Loose, "answer", Response(1.0))
    monkeypatch.setattr(Loose, "interpolates", True)
    monkeypatch.setattr(Loose, member, failing, raising=False)
    registry.register(Loose)
    bank = DetectorBank((9, 9), [LooseParams()])
    bank.step(np.zeros((9, 9), np.float32))
    calls: dict[str, Callable[[], object]] = {
        "at_rest": lambda: bank.at_rest(1, 1 / 30),
        "separate": bank.separate,
        "units": lambda: bank.units_of("loose"),
    }
    with pytest.raises(DetectorError, match=f"detector 'loose': its {member} failed") as failed:
        calls[member]()
    assert f"{kind.__name__}: own words" in str(failed.value)


class _Unmakable(Loose):
    name = "unmakable"
    parameters = Parameters

    def __init__(self, shape: tuple[int, int]) -> None:
        super().__init__(shape)


def test_a_detector_that_cannot_be_made_is_named() -> None:
    registry.register(_Unmakable)
    with pytest.raises(DetectorError, match="detector 'unmakable': cannot be made"):
        DetectorBank((9, 9), [_Unmakable.parameters()])


def again(**others: object) -> type[Detector]:
    """Return a new class of the same name, as a notebook's cell defines it when it runs again."""
    fields = {"__qualname__": "Again", "name": "again", "parameters": Parameters, **others}
    return type("Again", (Loose,), fields)


def test_a_class_defined_again_takes_the_place_of_the_one_before() -> None:
    for label, least in (("one", 0.5), ("two", 0.9)):
        registry.register(again(label=label, alarm=AlarmRule(least)))
        assert alarm_params().rule_of("again").floor == least
        assert type(alarm_params())().rule_of("again").floor == least
    assert registry.detector_named("again").label == "two"
    with pytest.raises(ParameterError, match="its name is taken"):
        registry.register(again(__qualname__="Other"))


@pytest.mark.parametrize(
    ("detector", "fault"),
    [
        (Loose((9, 9)), "is no detector: register a class that extends Detector"),
        (again(step=Detector.step), "it lacks step; define it"),
        (again(alarm=AlarmRule(None)), "its alarm has no floor; say why in why_none"),
        (again(columns=("a", "b")), "its columns must be a tuple of Column"),
        (again(details=Column("a", "", "b")), "its details must be a tuple of Column"),
    ],
)
def test_a_class_that_is_not_complete_is_refused(detector: Any, fault: str) -> None:
    with pytest.raises(ParameterError, match=fault):
        registry.register(detector)
    assert "again" not in registry.known_names()


def test_detectors_read_the_time_of_the_frame() -> None:
    bank = DetectorBank((9, 9), [DlgmdParams()])
    layers = bank.detectors["dlgmd"].layers
    frame = np.zeros((9, 9), np.float32)
    bank.step(frame, 1.25)
    assert layers.time_s == 1.25
    bank.step(frame)
    assert layers.time_s is None


@pytest.mark.parametrize("time_s", [float("nan"), float("inf")])
def test_a_time_that_is_not_finite_is_refused(time_s: float) -> None:
    """Without the error no later frame would be later than this one."""
    bank = DetectorBank((9, 9), [DlgmdParams()])
    frame = np.zeros((9, 9), np.float32)
    with pytest.raises(FrameError, match=f"finite number, not {time_s}; leave it out"):
        bank.step(frame, time_s)
    for t in range(4):
        response = bank.step(frame, t / 30)["dlgmd"]
    assert response is not None


class _Paired(Loose):
    """A detector that says what it got."""

    name = "paired"
    parameters = Parameters

    def step(self, luma: Luma) -> Response:
        assert luma.shape == self.shape
        return Response(float(luma.mean()), Box(0, 0, *luma.shape[::-1]))


def test_a_detector_may_have_frames_of_another_size() -> None:
    """The others, P and its mean do not change."""
    registry.register(_Paired)
    shapes = {"paired": (12, 16)}
    small, large = looming(12, 6, 6, 6), looming(60, 30, 30, 6)
    bank = DetectorBank((60, 60), [DlgmdParams(), _Paired.parameters()], shapes=shapes)
    other = DetectorBank((60, 60), [DlgmdParams()])
    assert {name: model.shape for name, model in bank.detectors.items()} == {
        "dlgmd": (60, 60),
        "paired": (12, 16),
    }
    for t, (frame, luma) in enumerate(zip(large, small, strict=True)):
        wide = np.pad(luma, ((0, 0), (2, 2)))
        bank.see(frame, t / 30)
        found = bank.respond({(60, 60): frame, (12, 16): wide}, t / 30)
        assert found["paired"] == Response(float(wide.mean()), Box(0, 0, 16, 12))
        assert {"dlgmd": found["dlgmd"]} == other.step(frame, t / 30)
        assert bank.luma_change == other.luma_change
        assert bank.photoreceptors.shape == (60, 60)


def test_detectors_share_layers_only_at_one_size_and_time_base() -> None:
    """The frames of opplod_paper are counted, also if its frames are as large as the others."""
    names = ["opplod", "opplod_reference", "opplod_paper", "opplod_lplc2", "dlgmd"]
    params = [registry.parameters_of(name) for name in names]
    bank = DetectorBank((60, 80), params, 30, shapes={"opplod_lplc2": (30, 40)})
    layers = {name: bank.detectors[name].layers for name in names}
    assert layers["opplod"] is layers["opplod_reference"] is layers["dlgmd"]
    assert len({id(one) for one in layers.values()}) == 3
    assert layers["opplod_paper"].shape == (60, 80)
    assert layers["opplod_lplc2"].shape == (30, 40)
    flow = Flow(np.ones((30, 40, 2), np.float32), np.ones((30, 40), np.float32), 2, 1 / 30)
    bank.give(flow)
    assert layers["opplod"].flow().of(np.zeros((60, 80), np.float32), 0) is flow
    halved = layers["opplod_lplc2"].flow().of(np.zeros((30, 40), np.float32), 0)
    assert halved is not None
    assert (halved.side, halved.passed_s, float(halved.vectors.max())) == (1, 1 / 30, 0.5)
