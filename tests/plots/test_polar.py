from __future__ import annotations

import numpy as np
import pytest

from oppload_cli.plots.polar import full_circle, selectivity

EIGHT = np.arange(0, 360, 45.0)


def test_one_direction_only() -> None:
    numbers = selectivity(EIGHT, np.array([0, 0, 2.0, 0, 0, 0, 0, 0]))
    assert (numbers.peak, numbers.preferred_deg, numbers.least) == (2, 90, 0)
    assert numbers.direction_index == 1
    assert numbers.axis_index == pytest.approx(1)


def test_the_opposite_direction_counts() -> None:
    numbers = selectivity(EIGHT, np.array([1, 1, 4.0, 1, 1, 1, 2, 1]))
    assert numbers.direction_index == pytest.approx((4 - 2) / (4 + 2))
    # The vector sum of 1, 1, 4, 1, 1, 1, 2, 1 at twice the angle: (1 - 4 + 1 - 2, 0) / 12.
    assert numbers.axis_index == pytest.approx(4 / 12)


def test_all_directions_alike() -> None:
    numbers = selectivity(EIGHT, np.ones(8))
    assert numbers.direction_index == 0
    assert numbers.axis_index == pytest.approx(0, abs=1e-12)
    assert numbers.least == 1


def test_where_nothing_responds_there_is_no_index() -> None:
    numbers = selectivity(EIGHT, np.zeros(8))
    assert (numbers.direction_index, numbers.axis_index) == (None, None)


def test_a_half_circle_has_no_opposite_direction() -> None:
    numbers = selectivity(np.array([0.0, 45, 90]), np.array([1.0, 4, 2]))
    assert (numbers.direction_index, numbers.least) == (None, 0.25)


def test_a_half_circle_is_repeated_half_a_turn_on() -> None:
    angles, values = full_circle(np.array([0.0, 45, 90, 135]), np.array([1.0, 2, 3, 4]))
    np.testing.assert_array_equal(angles, EIGHT)
    np.testing.assert_array_equal(values, [1, 2, 3, 4, 1, 2, 3, 4])
    again, same = full_circle(angles, values)
    np.testing.assert_array_equal(again, angles)
    np.testing.assert_array_equal(same, values)


def test_axes_that_are_not_spread_evenly_have_no_index() -> None:
    quarter, one = np.array([0.0, 30, 60, 90]), np.array([45.0])
    assert selectivity(quarter, np.ones(4)).axis_index is None
    assert selectivity(one, np.ones(1)).axis_index is None
    assert selectivity(np.array([0.0, 60, 120]), np.ones(3)).axis_index == pytest.approx(0)


def test_rounding_prefers_no_direction() -> None:
    assert selectivity(EIGHT, np.array([0, 2, 0, 2 + 1e-9, 0, 0, 0, 0])).preferred_deg == EIGHT[1]
