from __future__ import annotations

import numpy as np
import pytest

from oppload_cli.detection.evaluation.windows import (
    before_contact,
    ordered_pairs,
    tiled,
    window_to,
    without_approach,
)
from tests.detection.evaluation.make import NAME, clip, peaks


@pytest.mark.parametrize("rate", [10, 12.5, 16.667, 25, 29.97, 30, 60])
def test_a_window_holds_one_second_of_frames(rate: float) -> None:
    seen = clip([0.0] * 200, rate=rate)
    window = window_to(seen, 150, 3)
    assert window is not None
    assert window.stop == 150
    assert abs(len(range(*window)) - rate) <= 0.5


def test_windows_tile_backwards_and_the_rest_counts_from_half_a_second() -> None:
    assert tiled(clip([0.0] * 30), 3, 28) == [(18, 28), (8, 18), (3, 8)]
    assert tiled(clip([0.0] * 30), 4, 28) == [(18, 28), (8, 18)]


def test_windows_about_an_approach() -> None:
    seen = clip([0.0] * 60, 38, 45)
    assert before_contact(seen) == (36, 46)
    assert before_contact(seen, 4) == (32, 42)
    # The last second before contact begins before onset: its frames are not negative too.
    assert without_approach(seen) == [(26, 36), (16, 26), (6, 16)]
    assert without_approach(clip([0.0] * 23)) == [(13, 23), (3, 13)]
    assert before_contact(clip([0.0] * 23)) is None
    assert before_contact(clip([0.0] * 60, 3, 6)) is None  # under half a second after warm-up


def test_pairs_are_ordered_by_their_largest_responses() -> None:
    # Windows before contact at 45: 36-45, then 26-35, 16-25, 6-15.
    seen = clip(peaks(60, {40: 2.0, 30: 3.0, 20: 2.0, 10: 1.0, 50: 99.0}), 38, 45)
    assert ordered_pairs(seen, NAME, 0) == ((0 + 0.5 + 1) / 3, 3)
    # Four frames earlier the windows are 32-41, 22-31, 12-21 and a rest of 3-11.
    assert ordered_pairs(seen, NAME, 4) == ((0 + 0.5 + 1) / 3, 3)
    # Eight earlier the frame of the peak is in none: 28-37 holds the 3.
    assert ordered_pairs(seen, NAME, 8) == (1.0, 3)
    share, pairs = ordered_pairs(clip([0.0] * 60), NAME, 0)
    assert np.isnan(share)
    assert pairs == 0
