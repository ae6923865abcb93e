from __future__ import annotations

import numpy as np
import pytest

from oppload_cli.detection.parameters import PlaceParams
from oppload_cli.detection.places import Contact
from tests.detection.showing import approaching, remaining, shown

RATE = 30


def after(sizes: list[float], params: PlaceParams | None = None) -> float | None:
    """The estimate at the last of these sizes."""
    contact = Contact(params or PlaceParams())
    for t, size in enumerate(sizes):
        contact.add(t / RATE, size)
    return contact.remaining((len(sizes) - 1) / RATE)


def growing(frames: int, contact: int, noise: float = 0.0) -> list[float]:
    rng = np.random.default_rng(3)
    sizes = 12 * RATE / (contact - np.arange(frames)) + noise * rng.standard_normal(frames)
    return [float(size) for size in sizes]


@pytest.mark.parametrize("contact", [12, 20, 30])
def test_the_line_through_the_inverse_sizes_meets_zero_at_contact(contact: int) -> None:
    assert after(growing(9, contact)) == pytest.approx((contact - 8) / RATE, rel=1e-9)


def test_one_size_far_off_is_left_out() -> None:
    sizes = growing(11, 20)
    sizes[6] *= 1.5
    assert after(sizes) == pytest.approx(10 / RATE, rel=0.02)


def test_old_sizes_are_forgotten() -> None:
    """An object that stood still before it came."""
    assert after([10.0] * 60 + growing(14, 24)) == pytest.approx(11 / RATE, rel=1e-6)


@pytest.mark.parametrize(
    "sizes",
    [
        growing(3, 20),  # too few frames
        growing(5, 90),  # too little growth
        [20.0] * 12,
        growing(12, 20)[::-1],
        growing(12, 40, noise=4.0),  # known too badly
    ],
)
def test_a_contact_that_is_not_determined_is_none(sizes: list[float]) -> None:
    assert after(sizes) is None


def test_the_parameters_say_what_is_determined() -> None:
    assert after(growing(3, 20), PlaceParams(least_frames=3, least_growth=1)) is not None
    assert after(growing(5, 90), PlaceParams(least_growth=1)) is not None
    noisy = growing(12, 40, noise=4.0)
    assert after(noisy, PlaceParams(largest_error=10, least_growth=1)) is not None


def test_times_that_stand_still_give_none() -> None:
    contact = Contact(PlaceParams())
    for size in growing(400, 900):
        contact.add(1.0, size)
    assert contact.remaining(1.0) is None


@pytest.mark.parametrize("place", [(120, 120), (84, 143)])
def test_time_to_contact_of_a_disk(place: tuple[int, int]) -> None:
    found = shown(approaching(*place, 28, 25))
    errors = [
        tracks[0].time_to_contact_s / remaining(t, 28) - 1
        for t, tracks in enumerate(found)
        if tracks and tracks[0].time_to_contact_s is not None
    ]
    assert len(errors) >= 7
    assert np.median(np.abs(errors)) < 0.05
    assert np.abs(errors).max() < 0.1


def test_a_disk_cut_off_by_the_frame_gives_none() -> None:
    """Its left edge is out of the frame: the right one is no measure of its size."""
    found = [tracks[0] for tracks in shown(approaching(30, 120, 26, 22)) if tracks]
    assert len(found) == 10
    assert all(track.extent.limited for track in found[:7])
    assert not any(track.time_to_contact_s for track in found)


def test_the_first_frames_of_a_disk_give_none() -> None:
    found = [tracks for tracks in shown(approaching(120, 120, 24, 20)) if tracks]
    assert [tracks[0].time_to_contact_s for tracks in found[:3]] == [None] * 3
    assert found[4][0].time_to_contact_s is not None
