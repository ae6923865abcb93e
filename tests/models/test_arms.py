"""The arms of preset lplc2: its equations, and the answers of LPLC2 neurons (docs/lplc2.md)."""

from __future__ import annotations

from types import SimpleNamespace
from typing import TYPE_CHECKING, cast

import numpy as np
import pytest

from oppload_cli.errors import ParameterError
from oppload_cli.models.arms import (
    DIRECTIONS,
    ArmsJudgement,
    arm_response,
    arm_weights,
    graded_motion,
    smoothing,
)
from oppload_cli.models.dpc import DpcParams, Kernels
from oppload_cli.models.layers import Dpc, Layers
from oppload_cli.models.opplod import Opplod
from oppload_cli.models.opposing_motion import has_history
from oppload_cli.models.registry import parameters_of
from oppload_cli.results.table import columns_for
from tests import reference

if TYPE_CHECKING:
    from oppload_cli.models.dpc import Map

PARAMS = parameters_of("opplod", "lplc2")


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
        float(each[middle].sum()) for each in (motion.right, motion.up, motion.amount)
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
    twice = PARAMS.resolved(480)
    assert (twice.sigma_inhibition, twice.kernel_radius, twice.latency_lambda) == (10, 12, 0.35)
    assert (twice.receptive_field, twice.cell) == (400, 22)
    assert twice.resolved(480) == twice
    assert Opplod((17, 40), PARAMS).params.kernel_radius == 1
    with pytest.raises(
        ParameterError, match="height of at least 17 px, not 16; raise the working height"
    ):
        Opplod((16, 40), PARAMS)
    with pytest.raises(ParameterError, match="'axes' of opplod must be 0 with judgement=arms"):
        PARAMS.replaced(axes=45)


def test_motion_that_is_not_graded_is_the_largest_s_of_the_four_pathways() -> None:
    params = PARAMS.replaced(graded=False, history=0).resolved(96)
    dpc = Layers((96, 96)).dpc(params, (0, 90)).layer
    for t in range(4):
        dpc.step(edge(30, 2.0 * t))
    amount, parts = ArmsJudgement((96, 96), params).pooled(dpc)
    cell, sum_of_w_e = params.cell_px, float(dpc.kernels.excitation.sum())
    for found, s in zip(
        (amount, *parts),
        (np.max([*dpc.sums.pathways.values()], 0), *(dpc.sums.pathways[phi] for phi in DIRECTIONS)),
        strict=True,
    ):
        expected = reference.pooled(s, cell, params.pool_sigma) / sum_of_w_e
        np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-6)
    assert 0 < parts[0].max() < parts[0].max() + parts[1].max()


def test_motion_that_has_just_begun_does_not_count() -> None:
    """One edge moves in all frames; two others begin in the third, one beside a weaker change."""
    layers, found = Layers((96, 160)), []
    for history in (0, 0.125):
        params = PARAMS.replaced(history=history).resolved(96)
        dpc = layers.dpc(params, (0, 90)).layer
        for t in range(4 if not history else 0):
            luma = np.zeros((96, 160), np.float32)
            luma[:, : 10 + 2 * t] = 0.1 + 0.02 * t
            luma[:, 100:118] = 0.1 * t
            luma[:, 120 : 120 + 3 * max(0, t - 1)] = 1
            luma[:, 60 : 60 + 3 * max(0, t - 1)] = 1
            dpc.step(luma)
        found.append(ArmsJudgement((96, 160), params).pooled(dpc)[0])
    every, counted = found
    lasts = has_history(dpc.photoreceptors.coarse(every.shape), 0.125)
    np.testing.assert_array_equal(counted, every * lasts)
    assert 0 < counted.sum() < every.sum()


@pytest.mark.parametrize("graded", [True, False])
def test_inhibition_that_leaves_no_excitation_leaves_no_response(graded: bool) -> None:
    model = Opplod((96, 96), PARAMS.replaced(inhibition_strength=4, graded=graded), frame_rate=24)
    answers = [model.step(edge(30, 2.0 * t)) for t in range(6)]
    assert answers[3:] == [Opplod.responses(0.0, calcium=0.0)] * 3


def test_suppression_and_calcium_take_their_time_at_any_rate(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The same motion in all frames, of one interval or of two, of 1/30 s or of 1/60 s."""
    maps = np.random.default_rng(3).random((5, 22, 22), dtype=np.float32)
    monkeypatch.setattr(ArmsJudgement, "pooled", lambda *_: (maps[0], list(maps[1:])))
    params = PARAMS.replaced(suppression_s=0.2, calcium_s=1.0, units="every").resolved(176)
    found = []
    for elapsed, per_second, times in ((1.0, 30.0, 8), (2.0, 30.0, 4), (2.0, 60.0, 8)):
        judgement = ArmsJudgement((176, 176), params, per_second)
        dpc = cast("Dpc", SimpleNamespace(photoreceptors=SimpleNamespace(elapsed=elapsed)))
        judged = [judgement.judge(dpc).opponency for _ in range(times)][-1]
        found.append((judged, judgement.calcium))
    (one, calcium), *others = found
    assert calcium is not None
    assert calcium > 0
    assert [each for each, _ in others] == pytest.approx([one] * 2, rel=1e-5)
    assert others[1][1] == pytest.approx(calcium, rel=0.05)


def test_motion_upside_down_gives_the_responses_upside_down(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """So motion across an arm counts alike from both of its sides."""
    maps = np.random.default_rng(3).random((5, 22, 22), dtype=np.float32)
    params = PARAMS.replaced(threshold=0, half_saturation=50).resolved(176)
    dpc = cast("Dpc", SimpleNamespace(photoreceptors=SimpleNamespace(elapsed=1.0)))
    found = []
    for amount, right, up, left, down in (maps, maps[[0, 1, 4, 3, 2], ::-1]):
        pooled = amount, [right, up, left, down]
        monkeypatch.setattr(ArmsJudgement, "pooled", lambda *_, pooled=pooled: pooled)
        judgement = ArmsJudgement((176, 176), params)
        judgement.judge(dpc)
        found.append(judgement.maps.responses)
    np.testing.assert_allclose(found[1], found[0][::-1], rtol=1e-5)
    assert np.ptp(found[0]) > 0.01


@pytest.mark.once
def test_only_the_units_of_a_grid_answer() -> None:
    """The square grows away from the only unit, in the middle of the frame."""
    model = Opplod((240, 240), PARAMS.replaced(units="1x1"))
    for half in np.arange(20, 40, 1.5):
        answer = model.step(np.roll(square(half), 40, 1))
    assert np.count_nonzero(model.units.responses) <= 1
    assert answer is not None
    assert answer.box is None or answer.box.centre == (120, 120)


@pytest.mark.once
def test_the_calcium_signal_has_a_column_of_its_own() -> None:
    names = {
        preset: [column.name for column in columns_for(["opplod"], rmo=False, presets=(preset,))]
        for preset in ("default", "lplc2")
    }
    witnesses = ["opplod_growth", "opplod_opponency"]
    assert [name for name in names["default"] if name not in names["lplc2"]] == witnesses
    assert [name for name in names["lplc2"] if name not in names["default"]] == ["opplod_calcium"]
    model = Opplod((240, 240), PARAMS.replaced(calcium_s=1.0))
    answers = [model.step(square(half)) for half in np.arange(20, 40, 1.5)]
    known = [answer for answer in answers if answer is not None]
    assert max(answer.response for answer in known) > 0
    signal = 0.0
    for answer in known:  # the largest signal is at most that of the largest responses
        signal += (1 - np.exp(-1 / 30)) * (answer.response - signal)
        assert answer.calcium is not None
        assert answer.calcium <= signal + 1e-6
    assert known[-1].calcium == pytest.approx(signal, rel=0.5)
    assert model.at_rest() == Opplod.responses(0.0, calcium=known[-1].calcium)
    model.reset()
    assert not model.units.responses.any()
    assert [model.step(square(half)) for half in np.arange(20, 40, 1.5)] == answers
    assert Opplod((48, 48)).at_rest() == Opplod.responses(0.0, growth=0.0)
