from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from oppload_cli.evaluation.metrics.clips import Window, curves_of
from tests.evaluation.make import NAME, clip, peaks


@pytest.mark.parametrize("rate", [10, 12.5, 16.667, 25, 29.97, 30, 60])
def test_a_window_holds_one_second_of_frames(rate: float) -> None:
    seen = clip([0.0] * 200, rate=rate)
    window = seen.windows(3, 150)[0]
    assert window.stop == 150
    assert abs(len(range(*window)) - rate) <= 0.5


def test_windows_tile_backwards_and_the_rest_counts_from_half_a_second() -> None:
    assert clip([0.0] * 30).windows(3, 28) == [(18, 28), (8, 18), (3, 8)]
    assert clip([0.0] * 30).windows(4, 28) == [(18, 28), (8, 18)]


def test_a_frame_lasts_from_the_one_before_it() -> None:
    """Before the first frame, a frame of the mean duration."""
    seen = clip([0.0] * 11)
    spans = [(0, 11), (0, 5), (3, 8), (8, 3)]
    assert [seen.seconds(*span) for span in spans] == pytest.approx([1.1, 0.5, 0.5, 0])


def test_the_lead_counts_to_the_next_contact_and_is_0_at_it() -> None:
    seen = clip([0.0] * 30, 5, 25)
    label = replace(seen.label, contact_times=(1.0, 2.0))
    leads = [replace(seen, label=label).lead(frame) for frame in (8, 10, 11, 20, 25)]
    assert leads == pytest.approx([0.2, 0, 0.9, 0, 0])
    assert seen.lead(24) == pytest.approx(0.1)


def test_frames_that_a_clip_does_not_have_make_no_window() -> None:
    assert Window(1, 3).score(np.array([9.0, 1, 2, 9])) == 2
    assert clip([0.0] * 60, 1, 50).approach == (3, 51)
    assert clip([0.0] * 60, 50, 70).window_before_contact() is None
    assert clip([0.0] * 5, 3, 4).window_before_contact(12) is None
    assert clip([0.0]).seconds(0, 1) == 0


def test_windows_about_an_approach() -> None:
    seen = clip([0.0] * 60, 38, 45)
    assert seen.window_before_contact() == (36, 46)
    assert seen.window_before_contact(4) == (32, 42)
    # The last second before contact begins before onset: its frames are not negative too.
    assert seen.windows_without_approach() == [(26, 36), (16, 26), (6, 16)]
    assert clip([0.0] * 23).windows_without_approach() == [(13, 23), (3, 13)]
    assert clip([0.0] * 23).window_before_contact() is None
    # Under half a second after warm-up.
    assert clip([0.0] * 60, 3, 6).window_before_contact() is None


def test_pairs_are_ordered_by_their_largest_responses() -> None:
    # Windows before contact at 45: 36-45, then 26-35, 16-25, 6-15.
    seen = clip(peaks(60, {40: 2.0, 30: 3.0, 20: 2.0, 10: 1.0, 50: 99.0}), 38, 45)
    assert seen.ordered_pairs(NAME, 0) == ((0 + 0.5 + 1) / 3, 3)
    # Four frames earlier the windows are 32-41, 22-31, 12-21 and a rest of 3-11.
    assert seen.ordered_pairs(NAME, 4) == ((0 + 0.5 + 1) / 3, 3)
    # Eight earlier the frame of the peak is in none: 28-37 holds the 3.
    assert seen.ordered_pairs(NAME, 8) == (1.0, 3)
    share, pairs = clip([0.0] * 60).ordered_pairs(NAME, 0)
    assert np.isnan(share)
    assert pairs == 0


def test_areas_are_those_of_all_pairs_and_of_the_definition() -> None:
    random = np.random.default_rng(3)
    score = random.integers(0, 6, 60).astype(float)  # many ties
    positive = random.random(60) < 0.3
    found = curves_of(score, positive)
    assert found is not None
    above, below = score[positive], score[~positive]
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
    found = curves_of(score, positive)
    assert found is not None
    assert found.false_rate.tolist() == [0, 0, 0.5, 0.5, 1]
    assert found.true_rate.tolist() == [0, 0.5, 0.5, 1, 1]
    assert found.precision.tolist() == pytest.approx([1, 1, 1 / 2, 2 / 3, 1 / 2])
    assert found.auc == 0.75
    assert found.average_precision == pytest.approx((1 + 2 / 3) / 2)


def test_one_kind_of_windows_has_no_curve() -> None:
    assert curves_of(np.array([1.0, 2.0]), np.array([True, True])) is None
    assert curves_of(np.empty(0), np.empty(0, bool)) is None
