"""OMJ of presets `reference` and `default`: pooling, offsets, units, adaptation."""

from __future__ import annotations

import numpy as np
import pytest

from oppload_cli.models import opposing_motion
from oppload_cli.models.camera import NO_BARS, Widths
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


@pytest.mark.parametrize("border", [0, 3, 19, 20, 50])
def test_the_border_weighs_nothing(border: int) -> None:
    free = pooling_weights(40, cell_centres(40, 5), 5.0)
    weights = pooling_weights(40, cell_centres(40, 5), 5.0, (border, 2))
    inner = slice(border, max(border, 38))
    np.testing.assert_array_equal(weights[:, inner], free[:, inner])
    assert np.count_nonzero(weights) == np.count_nonzero(weights[:, inner])
    assert not pooling_weights(40, cell_centres(40, 5), 5.0, (border, 45)).any()


def test_offsets_ahead_weigh_1_and_offsets_behind_minus_w_p() -> None:
    right = offset_weights(2, 0, 90.0, 0.7)
    np.testing.assert_allclose(right, np.tile([-0.7, -0.7, 0, 1, 1], (5, 1)))
    up = offset_weights(1, 90, 90.0, 2.0)  # rows grow down
    np.testing.assert_array_equal(up, [[1, 1, 1], [0, 0, 0], [-2, -2, -2]])
    up_right = offset_weights(1, 45, 90.0, 1.0)
    np.testing.assert_array_equal(up_right, [[0, 1, 1], [-1, 0, 1], [-1, -1, 0]])


def test_the_cone_drops_offsets_aside_of_the_motion() -> None:
    narrow = offset_weights(2, 0, 45.0, 1.0)
    assert narrow[1].tolist() == [-1, -1, 0, 1, 1]  # 45 degrees are still within
    assert narrow[0].tolist() == [-1, 0, 0, 0, 1]
    assert np.count_nonzero(offset_weights(2, 135, 1.0, 1.0)) == 4


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
    assert (maps.field, maps.spread) == (100, 12)
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


@pytest.mark.parametrize(
    ("bars", "strip"),
    [
        (Widths(left=12), np.s_[:, :12]),
        (Widths(right=12), np.s_[:, -12:]),
        (Widths(top=12), np.s_[:12]),
        (Widths(bottom=12), np.s_[-12:]),
    ],
)
def test_a_bar_is_left_out_at_its_own_side(
    bars: Widths, strip: slice | tuple[slice, slice]
) -> None:
    params = REFERENCE.replaced(receptive_field=30, cell=5, pool_sigma=0.0, border=0)
    judgement = PooledJudgement(SHAPE, params)
    judgement.judge(layers({phi: np.ones(SHAPE) for phi in range(45, 360, 90)}), bars=bars)
    counts = np.ones(SHAPE, np.float32)
    counts[strip] = 0
    at = np.ix_(judgement.maps.centres_y.astype(int), judgement.maps.centres_x.astype(int))
    np.testing.assert_array_equal(judgement.maps.pathways[45], counts[at])


def test_motion_at_the_edge_of_the_picture_is_left_out_at_half_the_size() -> None:
    """A bar of 12 px and 8 px beside it are 6 px and 4 px there."""
    params = REFERENCE.replaced(receptive_field=30, cell=5, border=2, entering=8)
    half = Layers((20, 30)).dpc(DpcParams(), (45, 135)).layer
    for t in range(4):  # all pixels change
        half.step(np.full((20, 30), t % 2, np.float32))
    for s in half.sums.pathways.values():
        s[:] = 1
    judgement = PooledJudgement(SHAPE, params.replaced(halved_weight=1))
    maps = layers({phi: np.ones(SHAPE) for phi in range(45, 360, 90)})
    judgement.judge(maps, half, Widths(left=12))
    expected = np.zeros((20, 30))
    expected[:, :6] = expected[4:-4, 10:-4] = 1
    np.testing.assert_array_equal(half.sums.pathways[45], expected)
    counts = judgement._pooling[2][1].any(axis=0)  # the border and the bar weigh nothing
    np.testing.assert_array_equal(np.flatnonzero(counts), np.arange(7, 29))


@pytest.mark.parametrize(
    ("border", "reduction", "found"), [(6, 1, (24, 6)), (6, 2, (12, 3)), (1, 2, (12, 1))]
)
def test_strips_at_the_edge_are_smaller_at_half_the_size(
    monkeypatch: pytest.MonkeyPatch, border: int, reduction: int, found: tuple[int, int]
) -> None:
    given: list[object] = []
    monkeypatch.setattr(
        opposing_motion, "leave_out_entering", lambda _maps, _p, *strips: given.extend(strips)
    )
    params = REFERENCE.replaced(receptive_field=30, cell=5, border=border, entering=24)
    shape = SHAPE[0] // reduction, SHAPE[1] // reduction
    dpc = layers({phi: np.ones(shape) for phi in range(45, 360, 90)})
    PooledJudgement(SHAPE, params).opponency(dpc, reduction)
    assert given == [*found, NO_BARS]


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


def test_the_compression_widens_what_a_thin_edge_gives() -> None:
    """The square root of a Gaussian is a Gaussian with sqrt(2) times its sigma."""
    params = [REFERENCE.replaced(compression=each).resolved(240) for each in (1.0, 0.5)]
    spreads = [PooledJudgement((240, 240), each).maps.spread for each in params]
    assert spreads == pytest.approx([12, 12 * 2**0.5])


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


@pytest.mark.once
def test_adaptation_divides_by_the_median_of_the_background() -> None:
    """Reach 8 frames and guard 2 at 16 frames/s, recomputed literally on random maps."""
    params = REFERENCE.replaced(
        receptive_field=30, cell=5, pool_sigma=1.0, periphery=0.7,
        adaptation_level=2.0, adaptation_s=0.5, adaptation_guard_s=0.125,
    )  # fmt: skip
    judgement = PooledJudgement(SHAPE, params, 16.0)
    plain = PooledJudgement(SHAPE, params.replaced(adaptation_level=0.0))
    rng = np.random.default_rng(3)
    raw: list[float] = []
    divided = whole = 0
    for t in range(30):
        amount = 1 + t % 4 if t < 20 else 0.5  # at the end, nothing is divided
        maps = layers({phi: rng.random(SHAPE) * amount for phi in range(45, 360, 90)})
        judged = judgement.judge(maps)
        before = sorted(raw[max(0, t - 10) : max(0, t - 2)])
        background = float(np.median(before)) if before else 0.0
        raw.append(plain.judge(maps).opponency)
        factor = min(1.0, 2.0 / background) if background else 1.0
        divided += factor < 1
        whole += 0 < background < 1.9
        assert judged.opponency == pytest.approx(factor * raw[-1], rel=1e-5)
        assert judged.response == pytest.approx((factor * raw[-1]) ** 2, rel=1e-5)
        assert judgement.maps.responses.max() == pytest.approx(judged.response, rel=1e-5)
    assert divided > 15
    assert whole > 1


def test_persistence_keeps_a_share_of_r_from_frame_to_frame() -> None:
    params = REFERENCE.replaced(receptive_field=30, cell=5, pool_sigma=1.0, persistence=0.75)
    kept = PooledJudgement(SHAPE, params)
    plain = PooledJudgement(SHAPE, params.replaced(persistence=0.0))
    adapting = {"adaptation_level": 1e-3, "adaptation_guard_s": 0}
    adapted = PooledJudgement(SHAPE, params.replaced(**adapting))
    rng = np.random.default_rng(4)
    expected, before = np.zeros_like(plain.maps.responses), list[float]()
    for _ in range(5):
        maps = layers({phi: rng.random(SHAPE) for phi in range(45, 360, 90)})
        expected = 0.75 * expected + 0.25 * plain.opponency(maps)[0]
        assert kept.judge(maps).opponency == pytest.approx(expected.max(), rel=1e-5)
        # What is kept is R before it is adapted.
        factor = 1e-3 / np.median(before) if before else 1
        assert adapted.judge(maps).opponency == pytest.approx(factor * expected.max(), rel=1e-5)
        before.append(float(expected.max()))
    rest = Layers(SHAPE).dpc(DpcParams(), (45, 135)).layer  # no frames are compared: begin again
    assert kept.judge(rest).opponency == 0
    assert kept.judge(maps).opponency == pytest.approx(0.25 * plain.judge(maps).opponency, rel=1e-5)
    kept.reset()
    assert kept.judge(maps).opponency == pytest.approx(0.25 * plain.judge(maps).opponency, rel=1e-5)


@pytest.mark.parametrize(
    ("elapsed", "largest", "expected"),
    [
        (1.0, [1, 1, 0.01, 1, 1, 1], [1, 0, 1, 1, 0, 0]),
        (0.5, [1, 1, 1, 0.01, 1, 1, 1], [1, 1, 0, 1, 0, 1, 0]),
    ],
)
def test_a_response_is_sudden_if_r_is_small_now_or_was_an_interval_ago(
    monkeypatch: pytest.MonkeyPatch, elapsed: float, largest: list[float], expected: list[int]
) -> None:
    """Small is below 0.15 of R with persistence; R of motion without history does not matter."""
    params = REFERENCE.replaced(receptive_field=30, cell=5, persistence=0.5, sudden=0.15)
    judgement = PooledJudgement(SHAPE, params)
    dpc = layers({phi: np.ones(SHAPE) for phi in range(45, 360, 90)})
    dpc.photoreceptors.elapsed = elapsed
    for _ in range(2):
        sudden = []
        for each in largest:
            both = np.zeros((2, *judgement.maps.responses.shape), np.float32)
            both[:, 3, 4] = each, 10
            monkeypatch.setattr(judgement, "opponency", lambda *_, both=both: both)
            sudden.append(judgement.judge(dpc).sudden)
        assert sudden == [bool(each) for each in expected]
        judgement.reset()


def test_r_at_the_threshold_is_no_response(monkeypatch: pytest.MonkeyPatch) -> None:
    judgement = PooledJudgement(SHAPE, REFERENCE.replaced(receptive_field=30, cell=5, threshold=1))
    both = np.ones((2, *judgement.maps.responses.shape), np.float32)
    monkeypatch.setattr(judgement, "opponency", lambda *_: both)
    judged = judgement.judge(layers({phi: np.ones(SHAPE) for phi in range(45, 360, 90)}))
    assert (judged.opponency, judged.response, judged.box) == (1, 0, None)
    assert judgement.maps.responses.max() == 0


@pytest.mark.parametrize(("change", "counts"), [(5e-5, False), (5e-4, True)])
def test_a_scene_at_rest_is_no_background(change: float, counts: bool) -> None:
    """At rest the mean of P is below 1e-4."""
    params = REFERENCE.replaced(
        receptive_field=30, cell=5, history=0, adaptation_level=1e-6, adaptation_guard_s=0
    )
    judgement = PooledJudgement(SHAPE, params)
    dpc = Layers(SHAPE).dpc(DpcParams(), (45, 135)).layer
    values = np.random.default_rng(1).random((4, *SHAPE), dtype=np.float32)
    found = []
    for t in range(6):
        ready = dpc.step(np.full(SHAPE, 0.5 + change * t, np.float32))
        for s, each in zip(dpc.sums.pathways.values(), values, strict=True):
            s[:] = each
        if ready:
            found.append(judgement.judge(dpc).opponency)
    assert found[0] > 0.1
    assert found[1:] == pytest.approx([1e-6 if counts else found[0]] * 2, rel=1e-5)


def test_the_opponency_at_half_the_size_is_added() -> None:
    params = REFERENCE.replaced(receptive_field=30, cell=5, pool_sigma=1.0, halved_weight=0.5)
    judgement = PooledJudgement(SHAPE, params)
    rng = np.random.default_rng(5)
    maps, half = (
        layers({phi: rng.random(shape) for phi in range(45, 360, 90)})
        for shape in (SHAPE, (20, 30))
    )
    r, other = judgement.opponency(maps), judgement.opponency(half, 2)
    judged = judgement.judge(maps, half).opponency
    assert judged == pytest.approx((r + 0.5 * other)[0].max())
    assert judged > judgement.judge(maps).opponency
    # Without motion at the full size that has lasted long enough, what is kept stays.
    kept = PooledJudgement(SHAPE, params.replaced(persistence=0.75))
    assert kept.judge(maps, half).opponency == pytest.approx(0.25 * judged)
    rest = Layers(SHAPE).dpc(DpcParams(), (45, 135)).layer
    expected = 0.75 * 0.25 * (r + 0.5 * other)[0] + 0.25 * 0.5 * other[0]
    assert kept.judge(rest, half).opponency == pytest.approx(expected.max())
