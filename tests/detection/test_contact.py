from __future__ import annotations

import math
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
import pytest

from oppload_cli.detection.contact import Contact, PlaceParams
from oppload_cli.motion.growth import LocalMotion
from tests.detection.showing import LENGTH, SIZE, approaching, remaining, shown
from tests.media import disk

if TYPE_CHECKING:
    from oppload_cli.detection.places import Track

RATE = 30
SURE = 0.002
# The numbers below are worked out for these values.
PARAMS = PlaceParams(memory_s=0.4, least_frames=4, least_growth=1.15, largest_error=0.2)


def growth(grown: float, error: float) -> LocalMotion:
    """A motion with a growth, and with a shift and a turn, which do not count."""
    return LocalMotion(3 - 2j, grown + 0.1j, error)


def test_the_error_is_that_of_one_growth() -> None:
    """The growths of one object err alike, so that their mean is hardly better."""
    contact = Contact(PARAMS)
    for t in range(1, 7):  # contact after 20 frames; the error of T is passed * error / k^2
        k = 1 / (20 - t)
        contact.add(t / RATE, 1 / RATE, growth(k, 0.1 * k**2))
    left = contact.remaining(6 / RATE)
    assert left == pytest.approx((14 / RATE, 0.1 / RATE), rel=1e-9)


def test_the_error_of_one_growth_is_a_mean_of_inverse_squares() -> None:
    contact = Contact(PARAMS)
    for t in range(1, 7):
        k = 1 / (20 - t)
        contact.add(t / RATE, 1 / RATE, growth(k, (0.1 if t % 2 else 0.2) * k**2))
    left = contact.remaining(6 / RATE)
    assert left == pytest.approx((14 / RATE, math.sqrt(2 / (10**2 + 5**2)) / RATE), rel=1e-9)


@pytest.mark.parametrize(("scatter", "known"), [(4.19, True), (4.2, False)])
def test_the_error_has_the_scatter_and_is_at_most_a_fifth_of_the_time(
    scatter: float, known: bool
) -> None:
    """Every third frame shows growth; contact in 30 frames -+ scatter, after frame 9 in 21."""
    contact = Contact(PARAMS)
    for t in range(0, 10, 3):
        left = 30 + scatter * (-1) ** t - t
        contact.add(t / RATE, 1 / RATE, growth(1 / left, 0.1 / left**2))
    expected = 21 / RATE, math.hypot(scatter, 0.1) / RATE
    assert contact.remaining(9 / RATE) == (pytest.approx(expected) if known else None)


def after(
    sizes: list[float], params: PlaceParams | None = None, error: float = SURE
) -> float | None:
    """The estimate at the last of these sizes."""
    contact = Contact(params or PARAMS)
    for t, (before, now) in enumerate(pairwise(sizes), 1):
        contact.add(t / RATE, 1 / RATE, growth(now / before - 1, error))
    left = contact.remaining((len(sizes) - 1) / RATE)
    return left and left[0]


def growing(frames: int, contact: int, noise: float = 0.0) -> list[float]:
    rng = np.random.default_rng(3)
    sizes = 12 * RATE / (contact - np.arange(frames)) + noise * rng.standard_normal(frames)
    return [float(size) for size in sizes]


@pytest.mark.parametrize("contact", [12, 20, 30])
def test_growth_at_constant_speed_gives_the_contact(contact: int) -> None:
    assert after(growing(9, contact)) == pytest.approx((contact - 8) / RATE, rel=1e-9)


def test_one_growth_too_small_counts_little_and_one_too_large_gives_none() -> None:
    """Too large a growth seems to be the best known one, so that the times disagree."""
    sizes = growing(15, 24)
    small, large = ([*sizes[:9], *(by * size for size in sizes[9:])] for by in (0.97, 1.1))
    assert after(small) == pytest.approx(10 / RATE, rel=0.01)
    assert after(large) is None


def test_growth_counts_from_the_first_that_was_measured() -> None:
    """Contact after frame 30: from frame 1 to frame 10 the size grows by 29 / 20."""
    contact, strict = (Contact(PARAMS.replaced(least_growth=least)) for least in (1.449, 1.451))
    for t in range(1, 11):
        for each in (contact, strict):
            each.add(t / RATE, 1 / RATE, growth(1 / (30 - t), SURE))
    assert contact.remaining(10 / RATE) is not None
    assert strict.remaining(10 / RATE) is None


def test_better_known_growth_counts_more() -> None:
    """Contact in 10 or 20 frames, with errors of 1 and 2: (10 + 20 / 4) / 1.25 is 12."""
    contact = Contact(PARAMS.replaced(least_growth=1, largest_error=10))
    for t in (1, 2):
        for ahead, error in ((10, 1.0), (20, 2.0)):
            left = ahead - t
            contact.add(t / RATE, 1 / RATE, growth(1 / left, error / left**2))
    estimate = contact.remaining(2 / RATE)
    assert estimate
    assert estimate[0] == pytest.approx((12 - 2) / RATE, rel=1e-9)


def test_what_was_known_is_forgotten_where_growth_ends() -> None:
    """An object that stood still before it came, or stops."""
    sizes = [*growing(14, 24)]
    assert after([10.0] * 60 + sizes) == pytest.approx(11 / RATE, rel=1e-6)
    assert after([*sizes, sizes[-1]]) is None
    assert after([*sizes, sizes[-1] * (1 + SURE / 2)]) is None


def test_what_is_known_lasts_while_nothing_new_is_seen() -> None:
    contact = Contact(PARAMS.replaced(memory_s=0.3))
    for t in range(1, 8):
        contact.add(t / RATE, 1 / RATE, growth(1 / (24 - t), SURE))
    left = contact.remaining(10 / RATE)
    assert left
    assert left[0] == pytest.approx(14 / RATE, rel=1e-9)
    assert contact.remaining(14 / RATE) is None  # fewer than four are 0.3 s old at most


@pytest.mark.parametrize("rate", [25, 30, 30 / 1.001, 50, 60])
def test_the_zero_of_the_clock_changes_no_time_to_contact(rate: float) -> None:
    """`memory_s`, 0.4 s, is a whole number of frames, and times are rounded."""
    rng = np.random.default_rng(5)
    growths = [growth(rng.uniform(1, 1.1) / (40 - t), SURE) for t in range(1, 31)]
    zeros_s = (0.0, 0.1, 7.77, 1000.0, 1e5)
    estimates = []
    for zero_s in zeros_s:
        contact = Contact(PARAMS)
        for t, each in enumerate(growths, 1):
            contact.add(zero_s + t / rate, 1 / rate, each)
            estimates.append(contact.remaining(zero_s + t / rate))
    for t in range(30):
        first, *others = estimates[t::30]
        assert others == [first and pytest.approx(first, rel=1e-6)] * (len(zeros_s) - 1)


@pytest.mark.parametrize(
    ("sizes", "error"),
    [
        (growing(4, 20), SURE),  # too few frames
        (growing(6, 90), SURE),  # too little growth
        ([20.0] * 12, SURE),
        (growing(12, 20)[::-1], SURE),
        (growing(12, 40, noise=1.0), SURE),  # known too badly
        (growing(12, 24), 0.03),  # each of them too
    ],
)
def test_a_contact_that_is_not_determined_is_none(sizes: list[float], error: float) -> None:
    assert after(sizes, error=error) is None


def test_the_parameters_say_what_is_determined() -> None:
    assert after(growing(4, 20), PARAMS.replaced(least_frames=3, least_growth=1))
    assert after(growing(3, 20), PARAMS.replaced(least_frames=3, least_growth=1)) is None
    assert after(growing(6, 90), PARAMS.replaced(least_growth=1)) is not None
    assert after(growing(12, 24), PARAMS.replaced(largest_error=10), error=0.03) is not None


def determined(rate: int, scatter: float) -> list[float]:
    """When the contact after 1 s is determined, from growth over 1/30 s at some frame rate.

    The scatter is that of each interval: more frames within it tell nothing new.
    """
    contact, found = Contact(PARAMS), []
    for t in range(rate * 2 // 3, rate):
        time_s = t / rate
        left = max(1e-3, 1 + scatter * (-1) ** int(time_s * 30 + 1e-6) - time_s)
        contact.add(time_s, 1 / 30, growth(1 / (30 * left), SURE / 5))
        if contact.remaining(time_s) is not None:
            found.append(time_s)
    return found


@pytest.mark.parametrize("scatter", [0.0, 0.02, 0.06, 0.1])
def test_a_contact_is_determined_at_about_the_same_time_at_any_frame_rate(scatter: float) -> None:
    usual = determined(30, scatter)
    assert usual[0] < 0.9
    for rate in (60, 90, 120, 240):
        found = determined(rate, scatter)
        assert found[0] == pytest.approx(usual[0], abs=0.06), rate
        assert len(found) / rate == pytest.approx(len(usual) / 30, abs=1.8 / 30), rate


def errors_of(found: list[list[Track]], contact: int, rate: int = RATE) -> dict[int, float]:
    """The relative error of the first object's time to contact, by frame."""
    return {
        t: tracks[0].time_to_contact_s * rate / (contact - t) - 1
        for t, tracks in enumerate(found)
        if tracks and tracks[0].time_to_contact_s is not None
    }


@pytest.mark.parametrize("place", [(120, 120), (84, 143)])
def test_time_to_contact_of_a_disk(place: tuple[int, int]) -> None:
    """A plain disk moves at its edge only, and then its contact seems nearer than it is."""
    errors = errors_of(shown(approaching(*place, 28, 25)), 28)
    assert set(errors) >= set(range(15, 25))
    assert np.abs([errors[t] for t in range(15, 21)]).max() < 0.27
    assert min(errors.values()) > -0.4


def test_a_disk_cut_off_by_the_frame_has_a_time_to_contact() -> None:
    """Its left edge is out of the frame: the rest of the outline tells it."""
    errors = errors_of(shown(approaching(30, 120, 26, 22)), 26)
    assert set(errors) >= set(range(13, 22))
    assert np.abs([errors[t] for t in range(13, 22)]).max() < 0.2


@pytest.mark.parametrize("rate", [15, 60, 120])
def test_time_to_contact_at_other_rates(rate: int) -> None:
    """At 60 and 120 frames/s growth is that of 1/30 s."""
    contact = 28 * rate // 30
    frames = [disk(SIZE, 120, 120, LENGTH / (contact - t) * rate) for t in range(contact * 9 // 10)]
    errors = errors_of(shown(frames, rate=rate, interval_s=1 / 30), contact, rate)
    assert len(errors) >= {15: 2, 60: 14, 120: 28}[rate]
    assert -0.42 < min(errors.values()) <= max(errors.values()) < 0.08
    assert np.median(list(errors.values())) == pytest.approx(-0.2, abs=0.1)


def test_an_object_with_a_pattern_has_a_time_to_contact_until_it_fills_the_frame() -> None:
    across = np.arange(SIZE) + 0.5 - 120
    frames = []
    for t in range(27):
        radius = LENGTH / remaining(t, 28)
        x, y = across[None, :] / radius, across[:, None] / radius
        inside = np.clip((1 - np.hypot(x, y)) * radius + 0.5, 0, 1)
        pattern = 0.3 + 0.15 * np.sin(9 * x + 1) + 0.15 * np.cos(8 * y)
        frames.append((1 - inside * (1 - pattern)).astype(np.float32))
    errors = errors_of(shown(frames), 28)
    assert set(errors) >= set(range(17, 27))
    assert np.abs(list(errors.values())).max() < 0.2


def test_an_object_that_stops_has_none() -> None:
    frames = approaching(120, 120, 24, 18)
    found = shown([*frames, *frames[-1:] * 6])
    assert found[17][0].time_to_contact_s is not None
    assert not any(track.time_to_contact_s for tracks in found[18:] for track in tracks)


def test_the_first_frames_of_a_disk_give_none() -> None:
    found = [tracks for tracks in shown(approaching(120, 120, 24, 20)) if tracks]
    assert [tracks[0].time_to_contact_s for tracks in found[:2]] == [None] * 2
    assert all(tracks[0].time_to_contact_s for tracks in found[3:])
