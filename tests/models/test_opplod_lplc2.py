"""OppLoD tuned like LPLC2 neurons: its equations, and its answers (docs/lplc2.md)."""

from __future__ import annotations

from types import SimpleNamespace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from oppload_cli.errors import ParameterError
from oppload_cli.models.columns import columns_of
from oppload_cli.models.dpc import DpcParams, Kernels
from oppload_cli.models.layers import Layers
from oppload_cli.models.opplod_lplc2 import (
    DIRECTIONS,
    OpplodLplc2,
    OpplodLplc2Params,
    OpplodLplc2Response,
    arm_response,
    arm_weights,
    graded_motion,
    smoothing,
)
from oppload_cli.models.timebase import Clock, TimeParams
from oppload_cli.models.units import has_history

if TYPE_CHECKING:
    from oppload_cli.models.dpc import Map


def model_with(shape: tuple[int, int], per_second: float = 30.0, **values: float) -> OpplodLplc2:
    """A model with other parameters and another number of intervals per second."""
    clock = Clock(TimeParams(interval=str(1 / per_second)))
    return OpplodLplc2(shape, OpplodLplc2Params().replaced(**values), layers=Layers(shape, clock))


def edge(angle_deg: float, at: float) -> Map:
    """Draw a bright half-plane whose edge stands `at` px from the middle, along its normal."""
    y, x = np.mgrid[:96, :96] - 47.5
    angle = np.radians(angle_deg)
    along = x * np.cos(angle) - y * np.sin(angle)
    return np.asarray(np.clip(at - along + 0.5, 0, 1), np.float32)


def square(half: float) -> Map:
    """Draw a dark square of some half-width in px in the middle."""
    y, x = np.mgrid[:240, :240] - 119.5
    return np.asarray(1 - np.clip(half - np.maximum(abs(x), abs(y)) + 0.5, 0, 1), np.float32)


def moving(angle_deg: float, step: float) -> tuple[float, float]:
    """Return the direction in degrees and the amount of motion of an edge in the middle."""
    frames = [edge(angle_deg, step * t) for t in range(-3, 1)]
    p = [np.abs(frames[-1 - n] - frames[-2 - n]) for n in range(3)]
    motion = graded_motion(p, Kernels.of(DpcParams(), (0, 90)))
    middle = np.s_[32:64, 32:64]
    right, up, amount = (
        float(part[middle].sum()) for part in (motion.right, motion.up, motion.amount)
    )
    return float(np.degrees(np.arctan2(up, right))), amount


@pytest.mark.parametrize("angle", [0, 20, 45, 70, 90, 135, 200, 300])
def test_the_direction_of_motion_is_graded(angle: float) -> None:
    found, amount = moving(angle, 2.0)
    assert (found - angle + 180) % 360 - 180 == pytest.approx(0, abs=8)
    assert amount == pytest.approx(moving(0, 2.0)[1], rel=0.35)


def test_the_weights_of_an_arm() -> None:
    right = arm_weights(3, 0, 45)
    assert right.shape == (7, 7)
    assert right[3, 3] == 0
    np.testing.assert_allclose(right[3], [0, 0, 0, 0, 1, 1, 0.5], atol=1e-4)
    assert right[2, 4] == pytest.approx(0.5)  # on the edge of the cone
    for direction, turns in zip(DIRECTIONS, range(4), strict=True):
        turned = arm_weights(3, direction, 45)
        np.testing.assert_allclose(turned, np.rot90(right, turns), atol=1e-6)


def test_an_arm_saturates_and_is_divided() -> None:
    outward = np.array([0, 1, 3, 1], np.float32)
    suppression = np.array([0, 0, 0, 1], np.float32)
    found = arm_response(outward, suppression, 1.0, 1.0)
    np.testing.assert_allclose(found, [0, 1 / 2, 3 / 4, 1 / 3], rtol=1e-6)
    np.testing.assert_allclose(arm_response(outward, suppression, 1.0, 2.0)[2], 0.9, rtol=1e-6)
    # Within the ranges of the parameters powers leave the numbers of 32 bits.
    np.testing.assert_allclose(arm_response(outward, suppression, 1e-12, 20.0), [0, 1, 1, 0.5])


def test_a_low_pass_forgets_with_its_time_constant() -> None:
    assert smoothing(1.0, 0) == 1
    assert smoothing(30, 30) == pytest.approx(1 - np.exp(-1))


def test_its_parameters() -> None:
    params = OpplodLplc2Params()
    twice = params.scaled(480)
    assert twice == DpcParams(
        sigma_excitation=3, sigma_inhibition=10, kernel_radius=12, latency_lambda=0.35
    )
    assert params.scaled(240) == DpcParams()
    assert params.resolved(480).scaled(480) == twice
    model = OpplodLplc2((17, 40))
    assert model._dpc.layer.kernels.inhibition[0].shape == (3, 3)
    with pytest.raises(
        ParameterError, match="height of at least 17 px, not 16; raise the working height"
    ):
        OpplodLplc2((16, 40))


def test_motion_that_has_just_begun_does_not_count() -> None:
    """One edge moves in all frames; two others begin in the third, one beside a weaker change."""
    found = []
    for history in (0, 0.125):
        model = model_with((96, 160), history=history)
        for t in range(4):
            luma = np.zeros((96, 160), np.float32)
            luma[:, : 10 + 2 * t] = 0.1 + 0.02 * t
            luma[:, 100:118] = 0.1 * t
            luma[:, 120 : 120 + 3 * max(0, t - 1)] = 1
            luma[:, 60 : 60 + 3 * max(0, t - 1)] = 1
            model.step(luma)
        found.append(model.pooled(model._dpc.layer)[0])
    every, counted = found
    lasts = has_history(model._dpc.layer.photoreceptors.coarse(every.shape), 0.125)
    np.testing.assert_array_equal(counted, every * lasts)
    assert 0 < counted.sum() < every.sum()


def test_inhibition_that_leaves_no_excitation_leaves_no_response() -> None:
    params = OpplodLplc2Params(inhibition_strength=4)
    model = OpplodLplc2((96, 96), params, frame_rate=24)
    answers = [model.step(edge(30, 2.0 * t)) for t in range(6)]
    assert answers[3:] == [OpplodLplc2Response(0.0, calcium=0.0)] * 3


def sees(
    model: OpplodLplc2,
    motion: tuple[Map, list[Map]],
    monkeypatch: pytest.MonkeyPatch,
    elapsed: float = 1.0,
) -> None:
    """Let a model see the same pooled motion in every frame, each `elapsed` intervals long."""
    layer = SimpleNamespace(photoreceptors=SimpleNamespace(elapsed=elapsed))
    monkeypatch.setattr(model, "_dpc", SimpleNamespace(layer=layer, step=lambda _: True))
    monkeypatch.setattr(model, "pooled", lambda _: motion)


def test_suppression_and_calcium_take_their_time_at_any_rate(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The same motion in all frames, of one interval or of two, of 1/30 s or of 1/60 s."""
    maps = np.random.default_rng(3).random((5, 22, 22), dtype=np.float32)
    found, luma = [], np.zeros((176, 176), np.float32)
    for elapsed, per_second, times in ((1.0, 30.0, 8), (2.0, 30.0, 4), (2.0, 60.0, 8)):
        model = model_with((176, 176), per_second, suppression_s=0.2)
        sees(model, (maps[0], list(maps[1:])), monkeypatch, elapsed)
        answer = [model.step(luma) for _ in range(times)][-1]
        assert answer is not None
        found.append((answer.opponency, answer.calcium))
    (one, calcium), *others = found
    assert calcium is not None
    assert calcium > 0
    assert [opponency for opponency, _ in others] == pytest.approx([one] * 2, rel=1e-5)
    assert others[1][1] == pytest.approx(calcium, rel=0.05)


def test_motion_upside_down_gives_the_responses_upside_down(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """So motion across an arm counts alike from both of its sides."""
    maps = np.random.default_rng(3).random((5, 22, 22), dtype=np.float32)
    found = []
    for amount, right, up, left, down in (maps, maps[[0, 1, 4, 3, 2], ::-1]):
        model = model_with((176, 176), threshold=0, half_saturation=50)
        sees(model, (amount, [right, up, left, down]), monkeypatch)
        model.step(np.zeros((176, 176), np.float32))
        found.append(model.units.responses)
    np.testing.assert_allclose(found[1], found[0][::-1], rtol=1e-5)
    assert np.ptp(found[0]) > 0.01


@pytest.mark.once
def test_only_the_units_of_a_grid_answer() -> None:
    """The square grows away from the only unit, in the middle of the frame."""
    model = OpplodLplc2((240, 240), OpplodLplc2Params(units="1x1"))
    for half in np.arange(20, 40, 1.5):
        answer = model.step(np.roll(square(half), 40, 1))
    assert np.count_nonzero(model.units.responses) <= 1
    assert answer is not None
    assert answer.box is None or answer.box.centre == (120, 120)


@pytest.mark.once
def test_the_calcium_signal_has_a_column_of_its_own() -> None:
    assert "opplod_lplc2_calcium" in [column.name for column in columns_of(OpplodLplc2)]
    model = OpplodLplc2((240, 240))
    answers = [model.step(square(half)) for half in np.arange(20, 40, 1.5)]
    known = [answer for answer in answers if answer is not None]
    assert max(answer.response for answer in known) > 0
    signal = 0.0
    for answer in known:  # the largest signal is at most that of the largest responses
        signal += (1 - np.exp(-1 / 30)) * (answer.response - signal)
        assert answer.calcium is not None
        assert answer.calcium <= signal + 1e-6
    assert known[-1].calcium == pytest.approx(signal, rel=0.5)
    assert model.at_rest() == OpplodLplc2Response(0.0, calcium=known[-1].calcium)
    model.reset()
    assert not model.units.responses.any()
    assert [model.step(square(half)) for half in np.arange(20, 40, 1.5)] == answers
    silent = OpplodLplc2((240, 240), OpplodLplc2Params(calcium_s=0))
    assert silent.at_rest() == OpplodLplc2Response(0.0)
