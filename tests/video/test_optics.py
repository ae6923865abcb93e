"""Directions and angles of a pinhole camera, and of a display with constant pixels per degree."""

from __future__ import annotations

import math

import pytest

from oppload_cli.errors import ParameterError
from oppload_cli.video.optics import Optics, parse_fov

WIDE = Optics.of_fov(400, 200, 90)  # a focal length of 200 px
FLAT = Optics.of_display({"width": 360, "pixels_per_degree": 5, "projection": "flat"}, 720, 720)


@pytest.mark.parametrize("text", ["60", "60.0", "60deg", "60\N{DEGREE SIGN}", " 60 deg"])
def test_a_field_of_view_may_have_a_unit(text: str) -> None:
    assert parse_fov(text) == 60


def test_the_width_spans_the_field_of_view() -> None:
    assert WIDE.degrees(400) == pytest.approx(90)
    assert WIDE.pixels(90) == pytest.approx(400)
    assert WIDE.degrees(200) == pytest.approx(2 * math.degrees(math.atan(0.5)))
    assert FLAT.degrees(100) == pytest.approx(10)
    assert FLAT.pixels(30) == pytest.approx(300)


@pytest.mark.parametrize(
    ("x", "y", "azimuth", "elevation"),
    [
        (200, 100, 0, 0),
        (400, 100, 45, 0),
        (0, 100, -45, 0),
        (200, 0, 0, math.degrees(math.atan(0.5))),
        (400, 200, 45, -math.degrees(math.atan(100 / math.hypot(200, 200)))),
    ],
)
def test_directions_are_to_the_right_and_up(
    x: float, y: float, azimuth: float, elevation: float
) -> None:
    assert WIDE.direction(x, y) == pytest.approx((azimuth, elevation))


def test_a_flat_display_has_the_same_degrees_everywhere() -> None:
    assert FLAT.direction(460, 160) == pytest.approx((10, 20))
    assert FLAT.between((0, 0), (30, 40)) == pytest.approx(5)


def test_the_angle_between_points_is_that_of_their_directions() -> None:
    assert WIDE.between((0, 100), (400, 100)) == pytest.approx(90)
    assert WIDE.between((200, 100), (400, 100)) == pytest.approx(45)
    # 1 px far from the middle spans a smaller angle: by cos^2, and by cos across.
    assert WIDE.between((399.5, 100), (400.5, 100)) == pytest.approx(
        math.degrees(0.5 / 200), rel=1e-5
    )
    across = WIDE.between((400, 99.5), (400, 100.5))
    assert across == pytest.approx(math.degrees(math.sqrt(0.5) / 200), rel=1e-5)


def test_the_size_of_a_box_is_that_through_its_middle() -> None:
    """The direction is that of the focus of expansion, which need not be the middle."""
    view = WIDE.view((300, 0, 60, 150), (340, 50), None)

    # Vectors from the eye to the ends of the middle row, 25 px above the middle of the frame, and
    # of the middle column, 130 px to the right of it.
    def apart(one: tuple[int, int, int], other: tuple[int, int, int]) -> float:
        product = sum(a * b for a, b in zip(one, other, strict=True))
        return math.degrees(math.acos(product / math.hypot(*one) / math.hypot(*other)))

    across, down = apart((100, 25, 200), (160, 25, 200)), apart((130, 100, 200), (130, -50, 200))
    assert view == (
        *WIDE.direction(340, 50),
        *(pytest.approx(each) for each in (across, down, down)),
        None,
    )
    wider = WIDE.view((150, 80, 100, 40), (200, 100), None)
    assert wider.angular_size_deg == wider.angular_width_deg == pytest.approx(WIDE.degrees(100))


def test_the_size_of_an_approach_grows_as_its_derivative() -> None:
    l_over_v, time = 0.06, 0.4

    def size(t: float) -> float:
        return 2 * math.degrees(math.atan(l_over_v / t))

    half = l_over_v / time * WIDE.per_radian
    view = WIDE.view((200 - half, 100 - half, 2 * half, 2 * half), (200, 100), time)
    assert view.angular_size_deg == pytest.approx(size(time))
    slope = (size(time - 1e-4) - size(time + 1e-4)) / 2e-4
    assert view.angular_speed_deg_s == pytest.approx(slope, rel=1e-4)


@pytest.mark.parametrize("text", ["0", "180", "360", "-5", "wide", "", "nan", "inf", "1e400"])
def test_a_field_of_view_that_no_camera_has(text: str) -> None:
    with pytest.raises(ParameterError, match=f"above 0 and below 180 degrees.*not '{text}'"):
        parse_fov(text)


@pytest.mark.parametrize("value", [True, [90], None, 10**400])
def test_a_field_of_view_that_is_no_number(value: object) -> None:
    with pytest.raises(ParameterError, match="above 0 and below 180 degrees"):
        parse_fov(value)  # type: ignore[arg-type]


@pytest.mark.parametrize("scale", [0, -1, math.inf, math.nan])
def test_a_display_without_a_scale(scale: float) -> None:
    with pytest.raises(ValueError, match="pixels per degree"):
        Optics.of_display({"width": 1, "pixels_per_degree": scale, "projection": "flat"}, 1, 1)
