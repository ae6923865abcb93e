"""Area coverage is exact: no tolerance but that of floating point."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from oppload_cli.stimulus.coverage import PixelWindow, disk_coverage, polygon_coverage

place = st.floats(20, 60)


@pytest.mark.long
@settings(max_examples=60)
@given(x=place, y=place, radius=st.floats(0.05, 19))
def test_area_of_a_disk(x: float, y: float, radius: float) -> None:
    _, coverage = disk_coverage(x, y, radius, 80, 80)
    assert coverage.sum() == pytest.approx(np.pi * radius**2, rel=1e-9)


@pytest.mark.long
@settings(max_examples=60)
@given(x=place, y=place, angle=st.floats(0, 7), length=st.floats(0.1, 13), width=st.floats(0.1, 13))
def test_area_of_a_turned_bar(
    x: float, y: float, angle: float, length: float, width: float
) -> None:
    along = np.array([np.cos(angle), np.sin(angle)]) * length
    across = np.array([-np.sin(angle), np.cos(angle)]) * width
    middle = np.array([x, y])
    corners = [middle + a * along + b * across for a, b in ((1, 1), (-1, 1), (-1, -1), (1, -1))]
    _, coverage = polygon_coverage(corners, 80, 80)
    assert coverage.sum() == pytest.approx(4 * length * width, rel=1e-9)


@pytest.mark.parametrize(
    ("x", "y", "radius"),
    [(10.3, 5.2, 30.7), (-20.0, -20.0, 60.3), (50.0, 50.0, 500.0), (60.5, 30.5, 20.0)],
)
def test_disk_pixel_by_pixel(x: float, y: float, radius: float) -> None:
    """Also where the display cuts it, or lies wholly within it."""
    window, coverage = disk_coverage(x, y, radius, 60, 100)
    picture = np.zeros((60, 100))
    picture[window.slices] = coverage
    fine = 20
    rows, columns = ((np.arange(n * fine) + 0.5) / fine for n in (60, 100))
    inside = (columns[None, :] - x) ** 2 + (rows[:, None] - y) ** 2 < radius**2
    sampled = inside.reshape(60, fine, 100, fine).mean(axis=(1, 3))
    assert np.abs(picture - sampled).max() < 0.02


@pytest.mark.parametrize("middle", [(0.3, 30.2), (100.4, 29.8), (50.1, -0.4), (49.7, 60.2)])
def test_polygon_pixel_by_pixel_where_the_display_cuts_it(middle: tuple[float, float]) -> None:
    corners = np.add(middle, [(14, 16), (-8, 4), (-17, -2), (5, -17)])
    window, coverage = polygon_coverage(corners, 60, 100)
    assert 0 in {window.left, window.right - 100, window.top, window.bottom - 60}
    picture = np.zeros((60, 100))
    picture[window.slices] = coverage
    fine = 20
    y, x = np.mgrid[: 60 * fine, : 100 * fine] / fine + 0.5 / fine
    inside = np.ones(x.shape, np.bool_)
    for (x0, y0), (x1, y1) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        inside &= (x1 - x0) * (y - y0) > (y1 - y0) * (x - x0)
    sampled = inside.reshape(60, fine, 100, fine).mean(axis=(1, 3))
    assert np.abs(picture - sampled).max() < 0.04


def test_several_disks_at_once() -> None:
    x, y = np.array([10.2, 30.7, 45.1]), np.array([12.0, 33.3, 8.8])
    window, together = disk_coverage(x, y, 4.3, 50, 60)
    picture = np.zeros((50, 60))
    for one in zip(x, y, strict=True):
        part, coverage = disk_coverage(*one, 4.3, 50, 60)
        picture[part.slices] += coverage
    np.testing.assert_allclose(together, picture[window.slices], atol=1e-12)


def test_outside_of_the_display_there_is_nothing() -> None:
    window, coverage = disk_coverage(-50, 20, 10, 40, 40)
    assert coverage.sum() == 0
    _, coverage = polygon_coverage([(50, 50), (60, 50), (60, 60)], 40, 40)
    assert coverage.sum() == 0
    assert window.shape[1] == 0
    assert disk_coverage(20, 20, 0, 40, 40)[1].sum() == 0
    # The window is the smallest one, also where the display is higher than wide.
    window, _ = disk_coverage(20.5, 70.2, 3, 80, 40)
    assert window == PixelWindow(67, 74, 17, 24)
