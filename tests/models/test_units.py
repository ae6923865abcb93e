"""The cells that are units of OppLoD: their places, their pooling, their parameters."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from oppload_cli.errors import ParameterError
from oppload_cli.models.opplod import OpplodParams
from oppload_cli.models.opplod_lplc2 import OpplodLplc2Params
from oppload_cli.models.opplod_reference import OpplodReferenceParams
from oppload_cli.models.units import (
    Units,
    cell_centres,
    pool,
    pooling_weights,
    unit_starts,
)
from tests import reference

if TYPE_CHECKING:
    from oppload_cli.models.units import UnitParams


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


def test_a_row_of_units_spans_the_room() -> None:
    assert unit_starts(600, 5) == [0, 150, 300, 450, 600]
    assert unit_starts(600, 1) == [300]
    assert unit_starts(0, 3) == [0, 0, 0]


def test_a_grid_has_its_own_numbers_of_columns_and_rows() -> None:
    """An odd number of units needs an odd number of cells."""
    units = Units((32, 48), OpplodReferenceParams(receptive_field=8, cell=8, units="3x2"))
    assert units.maps.responses.shape == (4, 5)
    rows, columns = (axis.tolist() for axis in np.nonzero(units.selected))
    assert (rows, columns) == ([0] * 3 + [3] * 3, [0, 2, 4] * 2)


@pytest.mark.parametrize(
    ("params", "fields", "cells"),
    [
        (OpplodReferenceParams(), [100, 200, 2], [8, 16, 1]),
        (OpplodParams(), [100, 200, 2], [8, 16, 1]),
        (OpplodLplc2Params(), [200, 400, 2], [11, 22, 1]),
    ],
)
def test_fields_and_cells_follow_the_height(
    params: UnitParams, fields: list[int], cells: list[int]
) -> None:
    of_heights = [params.resolved(height) for height in (240, 480, 1)]
    assert [resolved.receptive_field for resolved in of_heights] == fields
    assert [resolved.cell for resolved in of_heights] == cells
    assert [resolved.resolved(600) for resolved in of_heights] == of_heights


def test_parameters_that_are_not_resolved_have_no_cell() -> None:
    said = "'cell' of opplod_reference depends on the working height; call resolved"
    with pytest.raises(ParameterError, match=said):
        Units((60, 80), OpplodReferenceParams())
