"""OMJ of presets `reference` and `default`: pooling, offsets, units."""

from __future__ import annotations

import numpy as np
import pytest

from oppload_cli.models.detector import Box
from oppload_cli.models.dpc import DpcParams
from oppload_cli.models.layers import Dpc, Layers
from oppload_cli.models.opplod import Opplod
from oppload_cli.models.opposing_motion import (
    PooledJudgement,
    cell_centres,
    enhanced,
    offset_weights,
    pool,
    pooling_weights,
    unit_starts,
)
from tests import reference
from tests.media import looming
from tests.presets import REFERENCE

SHAPE = (40, 61)


def layers(pathways: dict[int, np.ndarray]) -> Dpc:
    """Layers over frames that change everywhere, with these S_phi."""
    axes = sorted(pathways)[:2]
    shape = pathways[axes[0]].shape
    dpc = Layers((shape[0], shape[1])).dpc(DpcParams(), (axes[0], axes[1])).layer
    for frame in np.random.default_rng(1).random((4, *shape), dtype=np.float32):
        dpc.step(frame)
    for phi, values in pathways.items():
        dpc.sums.pathways[phi][:] = values
    return dpc


# ---- The equations -------------------------------------------------------------------------


def test_cells_lie_centred_in_the_frame() -> None:
    np.testing.assert_allclose(cell_centres(427, 8)[[0, -1]], [1.5 + 4, 427 - 5.5])
    np.testing.assert_allclose(cell_centres(3, 8), [1.5])
    # If the number of units is odd, one of them is in the middle.
    np.testing.assert_allclose(cell_centres(32, 8, 3), [8, 16, 24])
    np.testing.assert_allclose(cell_centres(32, 8, 2), [4, 12, 20, 28])
    np.testing.assert_allclose(cell_centres(8, 8, 1), [4])
    assert list(cell_centres(61, 5)) == reference.centres(61, 5)


def pooled(values: np.ndarray, cell: int, sigma: float) -> np.ndarray:
    down, across = (
        pooling_weights(length, cell_centres(length, cell), sigma) for length in values.shape
    )
    return np.asarray(pool([values], down, across)[0], np.float32)


@pytest.mark.parametrize(
    ("cell", "sigma"), [(8, 12.0), (8, 11.9), (7, 3.0), (50, 10.0), (16, 24.0), (24, 36.0)]
)
@pytest.mark.parametrize("shape", [(37, 53), (64, 90), (131, 118)])
def test_pooling_agrees_with_the_literal_reference(
    shape: tuple[int, int], cell: int, sigma: float
) -> None:
    values = np.random.default_rng(2).random(shape, dtype=np.float32)
    expected = reference.pooled(values, cell, sigma / cell)
    np.testing.assert_allclose(pooled(values, cell, sigma), expected, atol=2e-6)


def test_pooling_keeps_a_constant_inside_and_loses_the_part_outside() -> None:
    means = pooled(np.ones((400, 400), np.float32), 8, 12.0)
    np.testing.assert_allclose(means[10:-10, 10:-10], 1, atol=1e-6)
    assert means[0, 25] == pytest.approx(0.63, abs=0.01)


def test_pooling_without_spread_takes_the_pixel_at_the_centre() -> None:
    values = np.arange(20 * 20, dtype=np.float32).reshape(20, 20)
    np.testing.assert_array_equal(pooled(values, 5, 0.0), values[2::5, 2::5])


def test_offsets_ahead_weigh_1_and_offsets_behind_minus_w_p() -> None:
    right = offset_weights(2, 0, 0.7)
    np.testing.assert_allclose(right, np.tile([-0.7, -0.7, 0, 1, 1], (5, 1)))
    up = offset_weights(1, 90, 2.0)  # rows grow down
    np.testing.assert_array_equal(up, [[1, 1, 1], [0, 0, 0], [-2, -2, -2]])
    up_right = offset_weights(1, 45, 1.0)
    np.testing.assert_array_equal(up_right, [[0, 1, 1], [-1, 0, 1], [-1, -1, 0]])


@pytest.mark.parametrize("axis", [0, 45, 90, 135])
def test_expansion_is_outward_and_contraction_is_inward(axis: int) -> None:
    """S_phi is 1 at c + u, and S_(phi+180) at c - u; or the two places are exchanged."""
    up, right = np.sin(np.radians(axis)), np.cos(np.radians(axis))
    ahead = (round(10 - 4 * up), round(10 + 4 * right))
    behind = (20 - ahead[0], 20 - ahead[1])
    judged = {}
    for name, (first, second) in {"out": (ahead, behind), "in": (behind, ahead)}.items():
        pathways = {axis + turn: np.zeros((21, 21), np.float32) for turn in (0, 90, 180, 270)}
        pathways[axis][first] = 1
        pathways[axis + 180][second] = 1
        first_axis = axis % 90
        params = REFERENCE.replaced(receptive_field=11, cell=1, pool_sigma=0.0, axes=first_axis)
        maps = {phi % 360: values for phi, values in pathways.items()}
        judged[name] = PooledJudgement((21, 21), params).judge(layers(maps))
    assert judged["out"].opponency == 1
    assert (judged["out"].box, judged["in"].opponency) == (Box(5, 5, 11, 11), 0)


def test_enhancing_squares_values_above_the_threshold() -> None:
    values = np.array([[0.0, 0.5, 1.0, 2.0]], np.float32)
    np.testing.assert_array_equal(enhanced(values, 3.0, 0.5), [[0, 0, 3, 12]])


def test_a_row_of_units_spans_the_room() -> None:
    assert unit_starts(600, 5) == [0, 150, 300, 450, 600]
    assert unit_starts(600, 1) == [300]
    assert unit_starts(0, 3) == [0, 0, 0]


# ---- The judgement over one video ----------------------------------------------------------


@pytest.mark.once
@pytest.mark.parametrize("axes", [0, 45])
def test_the_winning_unit_is_the_best_one_of_the_maps(axes: int) -> None:
    model = Opplod((240, 240), REFERENCE.replaced(axes=axes, gain=2.0))
    answer = [model.step(frame) for frame in looming(240, 100, 130, 12)][-1]
    maps = model.units
    assert answer is not None
    assert answer.box is not None
    assert maps.responses.max() == pytest.approx(answer.response, rel=1e-6)
    row, column = np.unravel_index(maps.responses.argmax(), maps.responses.shape)
    assert maps.centres_x[column] == answer.box.x + 50
    assert maps.centres_y[row] == answer.box.y + 50
    assert maps.field == 100
    for phi in (axes, axes + 90, axes + 180, axes + 270):
        expected = pooled(model.pathways[phi], 8, 12.0)
        assert expected.max() > 0
        np.testing.assert_array_equal(maps.pathways[phi], expected)


def test_a_grid_has_its_own_numbers_of_columns_and_rows() -> None:
    """An odd number of units needs an odd number of cells."""
    params = REFERENCE.replaced(receptive_field=8, cell=8, units="3x2")
    judgement = PooledJudgement((32, 48), params)
    assert judgement.maps.responses.shape == (4, 5)
    rows, columns = (axis.tolist() for axis in np.nonzero(judgement._selected))
    assert (rows, columns) == ([0] * 3 + [3] * 3, [0, 2, 4] * 2)


def test_motion_without_history_has_no_pathways() -> None:
    """The left half rests until the latest frame; 6 cells from the right half there is none."""
    params = REFERENCE.replaced(receptive_field=9, cell=1, pool_sigma=0.0)
    dpc = Layers((20, 40)).dpc(DpcParams(), (45, 135)).layer
    for t, frame in enumerate(np.random.default_rng(1).random((4, 20, 40), dtype=np.float32)):
        if t < 3:
            frame[:, :20] = 0.5
        dpc.step(frame)
    for s in dpc.sums.pathways.values():
        s[:] = 1
    judgement = PooledJudgement((20, 40), params)
    judgement.opponency(dpc)
    for each in judgement.maps.pathways.values():
        np.testing.assert_array_equal(each[:, :14], 0)
        np.testing.assert_array_equal(each[:, 14:], 1)


@pytest.mark.once
def test_units_below_the_threshold_and_beside_the_grid_answer_zero() -> None:
    frames = looming(240, 120, 120, 12)
    answers = {}
    for params in (REFERENCE, REFERENCE.replaced(threshold=0.1), REFERENCE.replaced(units="4x4")):
        model = Opplod((240, 240), params)
        for frame in frames:
            model.step(frame)
        answers[params.threshold, params.units] = model.units.responses
    every = answers[0.0, "every"]
    expected = np.where(every > 0.1**2, every, 0)
    assert 0 < (expected > 0).sum() < (every > 0).sum()
    np.testing.assert_array_equal(answers[0.1, "every"], expected)
    grid = answers[0.0, "4x4"]
    assert 0 < (grid > 0).sum() <= 16
    np.testing.assert_array_equal(grid[grid > 0], every[grid > 0])


def test_r_at_the_threshold_is_no_response(monkeypatch: pytest.MonkeyPatch) -> None:
    judgement = PooledJudgement(SHAPE, REFERENCE.replaced(receptive_field=30, cell=5, threshold=1))
    monkeypatch.setattr(judgement, "opponency", lambda _: np.ones_like(judgement.maps.responses))
    judged = judgement.judge(layers({phi: np.ones(SHAPE) for phi in range(45, 360, 90)}))
    assert (judged.opponency, judged.response, judged.box) == (1, 0, None)
    assert judgement.maps.responses.max() == 0
