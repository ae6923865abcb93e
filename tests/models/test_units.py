from __future__ import annotations

import numpy as np
import pytest

from oppload_cli.models.opplod import Opplod
from oppload_cli.models.parameters import OpplodParams
from oppload_cli.models.pooling import Pooling
from tests.media import looming


@pytest.mark.parametrize("axes", [0, 45])
def test_the_maps_are_what_the_winning_unit_was_chosen_from(axes: int) -> None:
    params = OpplodParams(axes=axes, gain=2.0)
    model = Opplod((240, 240), params)
    answer = [model.step(frame) for frame in looming(240, 100, 130, 12)][-1]
    maps = model.judge.maps
    assert answer is not None
    assert answer.box is not None
    assert maps.responses.max() == pytest.approx(answer.response, rel=1e-6)
    row, column = np.unravel_index(maps.responses.argmax(), maps.responses.shape)
    assert maps.centres_x[column] == answer.box.x + 50
    assert maps.centres_y[row] == answer.box.y + 50
    assert (maps.field, maps.spread) == (100, 12)
    pooling = Pooling((240, 240), 8, 12.0)
    for phi in (axes, axes + 90, axes + 180, axes + 270):
        expected = np.zeros(pooling.shape, np.float32)
        pooling(model.pathways[phi], expected)
        assert expected.max() > 0
        np.testing.assert_array_equal(maps.pathways[phi], expected)


def test_units_below_the_threshold_and_beside_the_grid_answer_zero() -> None:
    frames = looming(240, 120, 120, 12)
    answers = {}
    for params in (OpplodParams(), OpplodParams(threshold=0.1), OpplodParams(units="3x3")):
        model = Opplod((240, 240), params)
        for frame in frames:
            model.step(frame)
        answers[params.threshold, params.units] = model.judge.maps.responses
    every = answers[0.0, "every"]
    expected = np.where(every > 0.1**2, every, 0)
    assert 0 < (expected > 0).sum() < (every > 0).sum()
    np.testing.assert_array_equal(answers[0.1, "every"], expected)
    grid = answers[0.0, "3x3"]
    assert (grid > 0).sum() <= 9
    np.testing.assert_array_equal(grid[grid > 0], every[grid > 0])
