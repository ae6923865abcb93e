from __future__ import annotations

import numpy as np
import pytest

from oppload_cli.detection.evaluation.curves import curve


def test_areas_are_those_of_all_pairs_and_of_the_definition() -> None:
    random = np.random.default_rng(3)
    score = random.integers(0, 6, 60).astype(float)  # many ties
    positive = random.random(60) < 0.3
    weight = random.integers(0, 4, 60)
    found = curve(score, positive, weight.astype(float))
    assert found is not None
    above, below = (
        np.repeat(score[positive], weight[positive]),
        np.repeat(score[~positive], weight[~positive]),
    )
    pairs = (above[:, None] > below) + 0.5 * (above[:, None] == below)
    assert found.auc == pytest.approx(pairs.mean())
    average = 0.0
    for value in np.unique(above)[::-1]:
        step = (above == value).sum() / len(above)
        hits, false = (above >= value).sum(), (below >= value).sum()
        average += step * hits / (hits + false)
    assert found.average_precision == pytest.approx(average)


def test_a_curve_by_hand() -> None:
    score, positive = np.array([4.0, 3.0, 2.0, 1.0]), np.array([True, False, True, False])
    found = curve(score, positive, np.ones(4))
    assert found is not None
    assert found.false_rate.tolist() == [0, 0, 0.5, 0.5, 1]
    assert found.true_rate.tolist() == [0, 0.5, 0.5, 1, 1]
    assert found.auc == 0.75
    assert found.average_precision == pytest.approx((1 + 2 / 3) / 2)


def test_one_kind_of_windows_has_no_curve() -> None:
    assert curve(np.array([1.0, 2.0]), np.array([True, True]), np.ones(2)) is None
    assert curve(np.empty(0), np.empty(0, bool), np.empty(0)) is None
