"""Pictures with transparency: what the drawings show, and how an image is cut and scaled."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest

from oppload_cli.stimulus import Object
from oppload_cli.stimulus.courses import Course
from oppload_cli.stimulus.patterns import cutout_of

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

HOVERING = Course(kind="hovering", distance_m=1.0)


def drawn(drawing: str, name: str = "a", seed: int = 0) -> NDArray[np.float32]:
    """Return luminance times opacity, and opacity, without the margin of the texture."""
    obj = Object(id=name, kind="picture", drawing=drawing, size_m=1.0, course=HOVERING)
    texture = cutout_of(obj, seed).texture
    return texture.levels[0][1 : texture.height + 1, 1 : texture.width + 1]


# Places x and y in a drawing and the luminance there, None where the drawing is transparent.
# Random textures change the luminance by up to 25 %.
Places = list[tuple[float, float, float | None]]
WHEELS: Places = [(-0.74, -0.75, 0.05), (0.74, -0.75, 0.05), (0, -0.75, None)]
LIGHTS: Places = [(-0.74, -0.1, 0.95), (0.74, -0.1, 0.95), (0, -0.14, 0.1)]
CABIN: Places = [(-0.9, 0.7, None), (0.9, 0.7, None), (0, 0.42, 0.12)]
PLATE: Places = [(0, -0.42, 0.9), (0.4, -0.55, 0.4)]
WINGS: Places = [(-0.7, 0.18, 0.35), (0.7, 0.18, 0.35), (-0.7, -0.1, None), (0.7, -0.1, None)]
HEAD: Places = [(0, 0.32, 0.25), (0.25, 0.3, None), (0, -0.1, 0.5)]
TAPE: Places = [(0, -0.8, 0.62), (0, 0.8, 0.62), (-0.97, 0, 0.3), (0.97, 0, 0.3)]
LABEL: Places = [(0.5, -0.3, 0.85), (0.5, -0.45, 0.1), (0.5, 0.5, 0.5), (-0.5, -0.3, 0.5)]
ROUND: Places = [(-0.8, -0.8, None), (0.8, -0.8, None), (-0.8, 0.8, None), (0.8, 0.8, None)]


@pytest.mark.parametrize(
    ("drawing", "half", "low", "high", "places"),
    [
        ("car", 0.97, -0.8, 0.8, [*WHEELS, *LIGHTS, *CABIN, *PLATE]),
        ("bird", 1.0, -0.26, 0.38, [*WINGS, *HEAD]),
        ("box", 1.0, -0.9, 0.9, [*TAPE, *LABEL]),
        ("ball", 1.0, -1.0, 1.0, ROUND),
    ],
)
def test_drawings_show_their_parts_upright(
    drawing: str, half: float, low: float, high: float, places: Places
) -> None:
    picture = drawn(drawing)
    rows, columns = picture.shape[:2]
    assert rows / columns == pytest.approx((high - low) / (2 * half), abs=2 / columns)
    for x, y, luminance in places:
        row, column = int((high - y) / (high - low) * rows), int((x + half) / (2 * half) * columns)
        wanted = (0, 0) if luminance is None else (pytest.approx(luminance, rel=0.25), 1)
        assert tuple(picture[row, column]) == wanted, (x, y)


def test_the_ball_is_lit_from_the_upper_left_and_has_a_dark_stripe() -> None:
    """Its light is (0.8, 0.5, -0.3) towards the eye, up and right, on 0.55 of even light."""
    luminance = np.mean([drawn("ball", seed=seed)[..., 0] for seed in range(6)], axis=0)
    depth = np.sqrt(0.5)
    lit, shaded = (0.55 + 0.45 * (0.8 * depth + side * 0.4) for side in (1, -1))
    upper_left, lower_right = luminance[108:148, 108:148], luminance[364:404, 364:404]
    assert upper_left.mean() / lower_right.mean() == pytest.approx(lit / shaded, rel=0.25)
    above, stripe, below = (luminance[256 - y, 256] for y in (40, 0, -40))  # |y| < 0.12 of 256
    assert stripe == pytest.approx(0.45 * (above + below) / 2, rel=0.15)


def test_the_texture_of_a_drawing_follows_from_the_seed_and_the_name() -> None:
    first, again = drawn("box"), drawn("box")
    np.testing.assert_array_equal(first, again)
    for other in (drawn("box", name="b"), drawn("box", seed=1)):
        assert np.abs(first - other)[..., 0].mean() > 0.02


def write(path: Path, grey: NDArray[np.uint8], opacity: NDArray[np.uint8]) -> Object:
    cv2.imwrite(str(path), np.dstack([grey, grey, grey, opacity]))
    return Object(id="a", kind="picture", file=str(path), size_m=1.0, course=HOVERING)


def test_an_image_is_cut_to_its_opaque_part_and_scaled(tmp_path: Path) -> None:
    """Of 30 x 10 px, the left half is opaque and dark, the right half half opaque and bright."""
    grey, opacity = np.full((20, 40), 255, np.uint8), np.full((20, 40), 100, np.uint8)
    grey[5:15, 5:20], grey[5:15, 20:35] = 51, 204
    opacity[5:15, 5:20], opacity[5:15, 20:35] = 255, 128
    cut = cutout_of(write(tmp_path / "small.png", grey, opacity), 0)
    assert (cut.width, cut.height) == pytest.approx((1, 1 / 3))
    assert (cut.texture.width, cut.texture.height) == (256, 85)
    # Weighted by opacity: half a picture of 0.2, and half of it by 128 / 255 of 0.8.
    assert cut.mean == pytest.approx((0.2 * 255 + 0.8 * 128) / (255 + 128), abs=0.005)
    left, right = (cut.texture.levels[0][43, column] for column in (64, 192))
    assert left == pytest.approx((0.2, 1), abs=1e-6)
    assert right == pytest.approx((0.8 * 128 / 255, 128 / 255), abs=1e-6)


def test_a_large_image_is_reduced_to_2048_texels(tmp_path: Path) -> None:
    grey, opacity = np.full((6144, 13), 255, np.uint8), np.full((6144, 13), 255, np.uint8)
    grey[1::3] = 0
    opacity[0, 0] = 0
    cut = cutout_of(write(tmp_path / "large.png", grey, opacity), 0)
    assert (cut.width, cut.height) == pytest.approx((13 / 6144, 1))
    assert (cut.texture.width, cut.texture.height) == (4, 2048)
    # Each texel is the mean of the rows that it replaces.
    assert cut.texture.levels[0][9:2000, 2, 0] == pytest.approx(2 / 3, abs=0.01)
