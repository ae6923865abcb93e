from __future__ import annotations

import numpy as np
import pytest

from oppload_cli.models.opplod import Opplod
from oppload_cli.models.opponency import PooledJudge
from oppload_cli.models.parameters import OpplodParams
from oppload_cli.models.pooling import Pooling, cell_centres
from tests import reference
from tests.media import disk, looming, texture

FIELD_OF_200 = OpplodParams(receptive_field=200, cell=10)


def strongest(frames: list[np.ndarray], params: OpplodParams) -> tuple[float, int, float, float]:
    """Peak of R, its frame, and the winning unit's centre."""
    model = Opplod(frames[0].shape, params)
    best = (-1.0, -1, np.nan, np.nan)
    for t, frame in enumerate(frames):
        answer = model.step(frame)
        if answer is not None and answer.opponency > best[0]:
            box = answer.box
            centre = (box.x + box.width / 2, box.y + box.height / 2) if box else (np.nan, np.nan)
            best = (answer.opponency, t, *centre)
    return best


@pytest.mark.parametrize("axes", [45, 0])
@pytest.mark.parametrize(
    ("shape", "cell", "field", "sigma"),
    [((40, 61), 5, 30, 1.0), ((33, 29), 7, 28, 1.5), ((3, 5), 8, 100, 1.5)],
)
def test_pooled_opponency_agrees_with_the_literal_reference(
    shape: tuple[int, int], cell: int, field: int, sigma: float, axes: int
) -> None:
    rng = np.random.default_rng(5)
    # A second half without inhibition, so that there is something to pool.
    frames = [rng.random(shape, dtype=np.float32) * s for s in (0, 0, 0.05, 0.1, 1)]
    params = OpplodParams(
        receptive_field=field, cell=cell, pool_sigma=sigma, axes=axes, periphery=0.7, gain=2.5
    )
    model = Opplod(shape, params)
    answer = [model.step(frame) for frame in frames][-1]
    p = reference.photoreceptors(frames)
    expected = reference.opponency(p, field=field, cell=cell, sigma=sigma, axes=axes, w_p=0.7)
    assert isinstance(model.judge, PooledJudge)
    np.testing.assert_allclose(
        model.judge.opponency(model.pathways), expected, atol=1e-5 * max(1, expected.max())
    )
    assert answer is not None
    assert answer.opponency == pytest.approx(expected.max(), rel=1e-4)
    assert answer.response == pytest.approx(2.5 * expected.max() ** 2, rel=1e-4)


def test_pathways_agree_with_the_literal_reference() -> None:
    rng = np.random.default_rng(6)
    frames = [rng.random((25, 31), dtype=np.float32) for _ in range(4)]
    model = Opplod((25, 31))
    for frame in frames:
        model.step(frame)
    p = reference.photoreceptors(frames)
    for phi in (45, 135, 225, 315):
        np.testing.assert_allclose(model.pathways[phi], reference.pathway(p, phi), atol=1e-5)


@pytest.fixture(scope="module")
def centre_loom(each_arithmetic: None) -> tuple[float, int, float, float]:
    return strongest(looming(600, 300, 300, 26), FIELD_OF_200)


def test_looming_disk_peaks_where_the_edge_leaves_the_field(
    centre_loom: tuple[float, int, float, float],
) -> None:
    assert abs(centre_loom[1] - 22) <= 1


def test_receding_disk(centre_loom: tuple[float, int, float, float]) -> None:
    receding = strongest(looming(600, 300, 300, 26)[::-1], FIELD_OF_200)
    assert receding[0] <= 0.01 * centre_loom[0]


def test_translating_disk(centre_loom: tuple[float, int, float, float]) -> None:
    moving = [disk(600, 200 + 4 * t, 300, 50) for t in range(20)]
    assert strongest(moving, FIELD_OF_200)[0] <= 0.02 * centre_loom[0]


def test_drifting_texture(centre_loom: tuple[float, int, float, float]) -> None:
    image = texture(600, 680, 1)
    drift = [np.ascontiguousarray(image[:, 4 * t : 4 * t + 600]) for t in range(12)]
    assert strongest(drift, FIELD_OF_200)[0] <= 0.001 * centre_loom[0]


def constancy(count: int) -> tuple[float, float, float]:
    rng = np.random.default_rng(11)
    peaks, errors = [], []
    for x, y in rng.uniform(150, 450, (count, 2)):
        # The peak is near frame 22 wherever the disk is; earlier frames are only warm-up.
        frames = [disk(600, x, y, 5 + 4 * t) for t in range(16, 26)]
        peak, _, found_x, found_y = strongest(frames, FIELD_OF_200)
        peaks.append(peak)
        errors.append(max(abs(found_x - x), abs(found_y - y)))
    values = np.array(peaks)
    return (
        float(values.std() / values.mean()),
        float(values.min() / values.max()),
        float(max(errors)),
    )


def check_constancy(count: int) -> None:
    variation, smallest, error = constancy(count)
    assert variation <= 0.05
    assert smallest >= 0.85
    assert error <= 10


def test_peak_and_place_do_not_depend_on_the_position() -> None:
    check_constancy(12)


@pytest.mark.slow
def test_peak_and_place_do_not_depend_on_the_position_of_a_hundred() -> None:
    check_constancy(100)


def test_units_of_a_grid_are_the_only_ones_that_answer() -> None:
    params = FIELD_OF_200.replaced(units="1x1")
    _, _, x, y = strongest(looming(600, 380, 300, 20), params)
    assert (abs(x - 300), abs(y - 300)) == (5, 5)


def test_threshold_and_gain_act_on_the_opponency() -> None:
    frames = looming(240, 120, 120, 12)
    silent = Opplod((240, 240), OpplodParams(threshold=1e3))
    loud = Opplod((240, 240), OpplodParams(gain=3))
    for frame in frames:
        off, on = silent.step(frame), loud.step(frame)
    assert off is not None
    assert (off.response, off.box) == (0, None)
    assert off.opponency > 0
    assert on is not None
    assert on.response == pytest.approx(3 * on.opponency**2)


def test_defaults_follow_the_height() -> None:
    assert [OpplodParams().resolved(h).receptive_field for h in (240, 600, 1)] == [100, 250, 2]
    assert [OpplodParams().resolved(h).cell for h in (240, 600, 1)] == [8, 20, 1]


def test_cells_lie_centred_in_the_frame() -> None:
    np.testing.assert_allclose(cell_centres(427, 8)[[0, -1]], [1.5 + 4, 427 - 5.5])
    np.testing.assert_allclose(cell_centres(3, 8), [1.5])


def pooled(values: np.ndarray, cell: int, sigma: float) -> np.ndarray:
    pooling = Pooling(values.shape, cell, sigma)
    out = np.zeros(pooling.shape, np.float32)
    pooling(values, out)
    return out


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


def test_pooling_errs_most_on_stripes_of_four_pixels() -> None:
    x = np.arange(200)
    for frequency in np.arange(0.2, 0.3, 0.01):
        row = (0.5 + 0.5 * np.cos(2 * np.pi * frequency * x + 0.8)).astype(np.float32)
        values = np.repeat(row[None], 120, axis=0)
        np.testing.assert_allclose(
            pooled(values, 8, 12.0), reference.pooled(values, 8, 1.5), atol=3e-5
        )


def test_a_map_whose_rows_stand_apart_is_pooled_as_any_other() -> None:
    values = np.random.default_rng(3).random((64, 90), dtype=np.float32)
    apart = np.full((64, 113), np.nan, np.float32)[:, 5:95]
    apart[:] = values
    for cell, sigma in ((8, 12.0), (7, 3.0)):
        np.testing.assert_array_equal(pooled(apart, cell, sigma), pooled(values, cell, sigma))


def test_pooling_keeps_a_constant_inside_and_loses_what_lies_outside() -> None:
    means = pooled(np.ones((400, 400), np.float32), 8, 12.0)
    np.testing.assert_allclose(means[10:-10, 10:-10], 1, atol=1e-6)
    assert means[0, 25] == pytest.approx(0.63, abs=0.01)


def test_pooling_without_spread_takes_the_pixel_at_the_centre() -> None:
    values = np.arange(20 * 20, dtype=np.float32).reshape(20, 20)
    np.testing.assert_array_equal(pooled(values, 5, 0.0), values[2::5, 2::5])
