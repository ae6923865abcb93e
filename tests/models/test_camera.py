"""Effects of cameras: light that flickers, noise, a view that moves, bars, edges of the frame."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from oppload_cli.models import camera
from oppload_cli.models.camera import (
    NO_BARS,
    Bars,
    NoiseFilter,
    SteadyLight,
    SteadyView,
    Widths,
    change_of_light,
    fitted_motion,
    leave_out_entering,
    reduced,
    seen_from,
    view_motion,
)
from oppload_cli.models.layers import Photoreceptors
from tests.media import texture

Luma = NDArray[np.float32]
HEIGHT, WIDTH = 120, 160
RANDOM = np.random.default_rng(1)


def scene(seed: int = 0) -> Luma:
    """Return a texture of luminance 0.2 to 0.8."""
    return np.asarray(0.2 + 0.6 * texture(HEIGHT, WIDTH, seed), np.float32)


def bands(share: float) -> Luma:
    """Return a gain for each row, of one and a half periods."""
    rows = np.arange(HEIGHT)[:, None] / HEIGHT
    return np.asarray(1 + share * np.sin(2 * np.pi * 1.5 * rows), np.float32)


@pytest.mark.parametrize("gain", [0.8, 0.97, 0.995, 1.1])
def test_one_gain_of_all_cells_is_the_change_of_the_light(gain: float) -> None:
    found = change_of_light(scene(), scene() * np.float32(gain))
    assert found.shape == (1, 1)
    assert found.item() == pytest.approx(np.log(gain), abs=1e-5)


def test_each_row_has_a_gain_of_its_own_where_the_shutter_rolls() -> None:
    before = scene()
    before[:, :5] = 0
    found = change_of_light(before, before * bands(0.1))
    np.testing.assert_allclose(found, np.log(bands(0.1)), atol=1e-5)
    # A single column of cells has no contrast, which would tell the light from motion.
    assert not change_of_light(scene()[:, :1], (scene() * bands(0.1))[:, :1]).any()


def test_an_object_may_change_a_quarter_of_the_cells() -> None:
    before, now = scene(), scene() * np.float32(0.9)
    now[: HEIGHT // 2, : WIDTH // 2] = scene(3)[: HEIGHT // 2, : WIDTH // 2]
    assert change_of_light(before, now).item() == pytest.approx(np.log(0.9), abs=1e-3)
    now[:, : WIDTH * 2 // 5] = scene(3)[:, : WIDTH * 2 // 5]
    assert not change_of_light(before, now).any()


def test_saturated_and_black_cells_do_not_count() -> None:
    before, now = scene(), scene() * np.float32(0.9)
    before[:, :50] = now[:, :50] = 1.0
    before[:, 50:60] = now[:, 50:60] = 0.0
    before[:, 60:65] = now[:, 65:70] = 0.0
    assert change_of_light(before, now).item() == pytest.approx(np.log(0.9), abs=1e-3)


def test_too_few_cells_say_nothing_about_the_light() -> None:
    before, now = scene(), scene() * np.float32(0.9)
    assert not change_of_light(before[:19, :1], now[:19, :1]).any()
    assert change_of_light(before[:20, :1], now[:20, :1]).any()
    before[:, :125] = now[:, :125] = 1.0  # 35 of 160 columns are less than a quarter
    assert not change_of_light(before, now).any()


def test_a_gain_above_the_largest_is_no_change_of_the_light() -> None:
    """The limit of the logarithm is 0.5: log 0.59 is -0.53, and log 0.55 -0.6."""
    assert not change_of_light(scene(), scene() * np.float32(0.59)).any()
    before = np.random.default_rng(1).uniform(0.2, 0.8, (HEIGHT, WIDTH)).astype(np.float32)
    assert change_of_light(before, before * bands(0.3)).any()
    assert not change_of_light(before, before * bands(0.45)).any()


@pytest.mark.parametrize(
    ("low", "high", "gain", "counts"),
    [(0.05, 0.07, 0.9, True), (0.03, 0.039, 0.9, False), (0.93, 0.99, 0.97, True)],
)
def test_light_is_measured_in_a_range_of_luminance(
    low: float, high: float, gain: float, counts: bool
) -> None:
    """The darker one of the two luminances of a cell must be above 0.04 and below 0.997."""
    before = np.asarray(low + (high - low) * texture(HEIGHT, WIDTH, 0), np.float32)
    assert change_of_light(before, before * np.float32(gain)).any() == counts


@pytest.mark.parametrize(
    ("by_rows", "left", "explained"),
    [(False, 0.45, True), (False, 0.55, False), (True, 0.22, True), (True, 0.28, False)],
)
def test_a_gain_leaves_half_of_the_change_at_most_and_gains_of_rows_a_quarter(
    by_rows: bool, left: float, explained: bool
) -> None:
    """In 35 of 100 cells this share of the change is left."""
    before = np.random.default_rng(1).uniform(0.2, 0.8, (20, 100)).astype(np.float32)
    gains = np.full((20, 1), 0.1)
    if by_rows:
        gains[::2] *= -1
    logarithms = gains + 0.1 * left * (np.arange(100) % 20 < 7)
    found = change_of_light(before, before * np.exp(logarithms).astype(np.float32))
    np.testing.assert_allclose(found, (gains if by_rows else 0.1) if explained else 0, atol=1e-5)


@pytest.mark.parametrize(("saturated", "others", "explained"), [(28, 5, True), (35, 0, False)])
def test_gains_of_rows_need_most_of_the_cells(saturated: int, others: int, explained: bool) -> None:
    """Of 100 cells in each row some are saturated, and some change otherwise."""
    before = np.random.default_rng(1).uniform(0.2, 0.8, (20, 100)).astype(np.float32)
    gains = np.where(np.arange(20) % 2, 1.1, 0.9).astype(np.float32)[:, None]
    now = before * gains
    before[:, :saturated] = now[:, :saturated] = 1.0
    now[:, 100 - others :] *= np.float32(1.3)
    found = change_of_light(before, now)
    np.testing.assert_allclose(found, np.log(gains) if explained else 0, atol=1e-5)


@pytest.mark.parametrize(("contrast", "explained"), [(0.02, False), (0.03, True)])
def test_gains_of_rows_need_a_contrast_of_a_quarter_of_the_change(
    contrast: float, explained: bool
) -> None:
    before = np.full((20, 30), 0.5, np.float32)
    before[:, ::2] *= np.float32(1 + contrast)
    gains = np.where(np.arange(20) % 2, 0.1, -0.1)[:, None]
    found = change_of_light(before, before * np.exp(gains).astype(np.float32))
    np.testing.assert_allclose(found, gains if explained else 0, atol=1e-5)


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("shift", [1, 3, 8])
def test_a_scene_that_moves_is_no_change_of_the_light(axis: int, shift: int) -> None:
    assert not change_of_light(scene(), np.roll(scene(), shift, axis)).any()


def test_another_scene_and_noise_are_no_change_of_the_light() -> None:
    assert not change_of_light(scene(), scene(5)).any()
    noisy = scene() + RANDOM.normal(0, 0.01, scene().shape).astype(np.float32)
    assert not change_of_light(scene(), noisy).any()


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("period", [12, 16, 20, 24, 40])
def test_a_grating_that_moves_is_no_change_of_the_light(axis: int, period: int) -> None:
    lines = np.indices((30, 40))[axis]
    for shift in (0.3, 1, 2, 5):
        before, now = (
            np.asarray(0.5 + 0.3 * np.sin(2 * np.pi * (lines * 4 - t) / period), np.float32)
            for t in (0.0, shift)
        )
        assert not change_of_light(before, now).any()


def test_a_video_in_steady_light_passes_as_it_is() -> None:
    light = SteadyLight(120.0)
    for shift in range(5):
        luma = np.roll(scene(), shift, 1)
        assert light.step(luma, 1.0) is luma


@pytest.mark.parametrize("gain", [np.float32(1.0), bands(0.1)])
def test_light_that_flickers_is_made_steady(gain: Luma) -> None:
    light = SteadyLight(120.0)
    before = light.step(scene(), 1.0)
    for t in range(1, 12):
        now = light.step(scene() * gain ** np.float32(t % 3 - 1), 1.0)
        np.testing.assert_allclose(now[4:-4], before[4:-4], rtol=0.02)
        before = now


def test_a_row_without_a_change_does_not_hide_that_of_the_other_rows() -> None:
    gains = np.repeat(np.linspace(0.8, 1.2, 15, dtype=np.float32), 8)[:, None]
    light = SteadyLight(1e9)
    light.step(scene(), 1.0)
    shown = light.step(scene() * gains, 1.0)
    # The gain is interpolated between the middles of the rows of cells.
    np.testing.assert_allclose(shown[4:-4], scene()[4:-4], rtol=0.02)


@pytest.mark.parametrize("elapsed", [1.0, 2.0])
def test_a_lasting_change_of_the_light_passes_through_in_time(elapsed: float) -> None:
    """After one time constant, the share 1 / e of the gain's logarithm is still removed."""
    light = SteadyLight(60.0)
    light.step(scene(), elapsed)
    darker = scene() * np.float32(0.7)
    shown = [light.step(darker, elapsed) for _ in range(1 + round(60 / elapsed))]
    np.testing.assert_allclose(shown[0], scene(), rtol=1e-4)
    removed = np.log(shown[-1] / darker)
    np.testing.assert_allclose(removed, -np.log(0.7) / np.e, rtol=1e-3)


def test_at_most_a_factor_of_2_is_removed_from_light_that_falls_steadily() -> None:
    light = SteadyLight(1e9)
    for t in range(7):
        luma = scene() * np.float32(0.8**t)
        shown = light.step(luma, 1.0)
        gain = min(-t * np.log(0.8), 0.7)
        np.testing.assert_allclose(shown / luma, np.exp(gain), rtol=1e-3)


def noise(standard_deviation: float, random: np.random.Generator) -> Luma:
    return np.asarray(random.normal(0, standard_deviation, (HEIGHT, WIDTH)), np.float32)


@pytest.mark.parametrize("amount", [0.015, 0.03])
@pytest.mark.parametrize("step", [0.0, 0.7])
@pytest.mark.parametrize("elapsed", [1.0, 0.25])
def test_a_noisy_frame_is_blurred_until_little_noise_is_left(
    amount: float, step: float, elapsed: float
) -> None:
    """On a texture at rest or in slow motion, at 30 and at 120 frames/s."""
    random, filtering = np.random.default_rng(3), NoiseFilter(0.004)
    ground = np.asarray(0.2 + 0.6 * cv2.GaussianBlur(texture(HEIGHT, WIDTH + 40, 1), (0, 0), 2))
    for frame in range(30):
        move = np.array([[1, 0, -frame * step * elapsed], [0, 1, 0]])
        clean = np.asarray(cv2.warpAffine(ground, move, (WIDTH, HEIGHT)), np.float32)
        blurred = filtering.step(clean + noise(amount, random), elapsed)
    blur = amount / (2 * np.sqrt(np.pi) * 0.004)
    left = blurred - cv2.GaussianBlur(clean, (0, 0), blur)
    assert left[12:-12, 12:-12].std() == pytest.approx(0.004, rel=0.25)


def test_the_blur_has_a_limit() -> None:
    random, filtering = np.random.default_rng(3), NoiseFilter(0.004)
    half = np.full((HEIGHT, WIDTH), 0.5, np.float32)
    for _ in range(8):
        luma = half + noise(0.2, random)
        blurred = filtering.step(luma, 1.0)
    np.testing.assert_array_equal(blurred, cv2.GaussianBlur(luma, (0, 0), 3.0))


def test_frames_with_hardly_any_noise_pass_as_they_are() -> None:
    random, filtering = np.random.default_rng(3), NoiseFilter(0.004)
    for frame in range(20):  # motion of 1 px per frame, and noise of one grey level
        luma = np.roll(scene(), frame, 1) + noise(1 / 255, random)
        assert filtering.step(luma, 1.0) is luma


def test_the_noise_is_averaged_over_a_second() -> None:
    """The first values count alike; then the variance falls by 1 / e in 30 intervals."""
    random, filtering = np.random.default_rng(3), NoiseFilter(0.02)
    for _ in range(40):
        filtering.step(scene() + noise(0.1, random), 1.0)
    variance = filtering._variance
    assert variance == pytest.approx(0.01, rel=0.2)
    for _ in range(62):  # at twice the rate; the noise is in the first two changes
        filtering.step(scene(), 0.5)
    assert filtering._variance == pytest.approx(variance * (1 - 1 / 60) ** 60, rel=0.1)
    filtering.step(scene(), 60.0)
    assert filtering._variance == 0  # of frames far apart, the latest one counts alone


def views(motions: list[tuple[float, float, float]]) -> list[Luma]:
    """Return what a camera sees of a texture: shifts right and down in px, and turns in degrees."""
    ground = np.asarray(0.2 + 0.6 * texture(2 * HEIGHT, 2 * WIDTH, 0), np.float32)
    middle, frames = np.array([WIDTH - 0.5, HEIGHT - 0.5]), []
    for right, down, degrees in motions:
        move = cv2.getRotationMatrix2D(tuple(middle), degrees, 1)
        move[:, 2] += np.array([right, down])
        seen = cv2.warpAffine(ground, move, ground.shape[::-1], flags=cv2.INTER_CUBIC)
        part = seen[HEIGHT // 2 : -HEIGHT // 2, WIDTH // 2 : -WIDTH // 2]
        frames.append(np.asarray(part, np.float32))
    return frames


@pytest.mark.parametrize("rate", [1, 4])
@pytest.mark.parametrize("motion", [(3.0, 0, 0), (0, -1.3, 0), (0, 0, 2), (2.2, 3.1, -1.5)])
def test_the_view_of_a_camera_is_followed(motion: tuple[float, float, float], rate: int) -> None:
    """The same motion per interval is found at any frame rate, to a pixel in three."""
    view = SteadyView()
    right, down, degrees = motion
    shares = [frame / rate for frame in range(3 * rate + 1)]
    for luma in views([(share * right, share * down, share * degrees) for share in shares]):
        found = view.step(luma, 1 / rate)
    check_view(found, (3 * right, 3 * down, 3 * degrees), 1)


def check_view(found: NDArray[np.float64], motion: tuple[float, float, float], atol: float) -> None:
    """Compare a motion of the view with one of `views`, in three corners and in the middle."""
    middle = (WIDTH - 1) / 2, (HEIGHT - 1) / 2
    expected = cv2.getRotationMatrix2D(middle, motion[2], 1)
    expected[:, 2] += np.array(motion[:2])
    corners = np.array([[0, 0, 1], [WIDTH - 1, 0, 1], [0, HEIGHT - 1, 1], [*middle, 1]])
    first = (found @ corners.T)[:2]  # the places in the first frame
    np.testing.assert_allclose(expected @ [*first, np.ones(4)], corners[:, :2].T, atol=atol)


@pytest.mark.parametrize("motions", [[(8.0, 0, 4)], [(0, 0, 6), (8, 0, 6)]])
def test_the_view_turns_about_its_middle_and_is_shifted_then(
    motions: list[tuple[float, float, float]],
) -> None:
    view = SteadyView()
    for luma in views([(0, 0, 0), *motions]):
        found = view.step(luma, 1.0)
    check_view(found, motions[-1], 0.5)


@pytest.mark.parametrize(
    ("shape", "reduction", "elapsed", "back"),
    [
        ((170, 200), 1, 1, 1),
        ((190, 200), 2, 1.25, 1),
        ((298, 660), 2, 3, 1),
        ((330, 660), 3, 0.6, 2),
        ((20, 30), 1, 0.7, 1),
        ((20, 30), 1, 0.25, 4),
        ((20, 30), 1, 0.04, 16),
    ],
)
def test_frames_of_about_120_px_are_compared_over_an_interval(
    monkeypatch: pytest.MonkeyPatch,
    shape: tuple[int, int],
    reduction: int,
    elapsed: float,
    back: int,
) -> None:
    """The grey level of a frame is its number; the motion found is always a reduced pixel."""
    compared = []

    def view_motion(*frames: NDArray[np.uint8]) -> NDArray[np.float64]:
        assert {each.shape for each in frames} == {(shape[0] // reduction, shape[1] // reduction)}
        compared.append(tuple(int(each[0, 0]) for each in frames))
        return np.array([[1.0, 0, 1], [0, 1, 0], [0, 0, 1]])

    monkeypatch.setattr(camera, "view_motion", view_motion)
    view = SteadyView()
    for t in range(19):
        found = view.step(np.full(shape, t / 255, np.float32), elapsed)
    assert compared == [(max(0, t - back), t) for t in range(1, 19)]
    steps = -(-18 // back)  # from frame 18 to frame 0
    np.testing.assert_allclose(found[:2], np.array([[1, 0, steps * reduction], [0, 1, 0]]))


def grey(luma: Luma) -> NDArray[np.uint8]:
    return np.asarray(255 * np.clip(luma, 0, 1) + 0.5, np.uint8)


def test_the_motion_of_a_picture_that_grows_too_is_found_without_its_growth() -> None:
    """The change would not be explained without the growth."""
    move = cv2.getRotationMatrix2D(((WIDTH - 1) / 2, (HEIGHT - 1) / 2), 0, 1.1)
    move[0, 2] -= 2
    now = cv2.warpAffine(scene(), move, (WIDTH, HEIGHT), borderMode=cv2.BORDER_REFLECT)
    found = view_motion(grey(scene()), grey(np.asarray(now, np.float32)))
    assert found is not None
    np.testing.assert_allclose(found[:2], np.array([[1, 0, 2 / 1.1], [0, 1, 0]]), atol=0.15)
    assert np.hypot(*found[0, :2]) == pytest.approx(1, abs=1e-9)


@pytest.mark.parametrize(("shift", "moves"), [(0.1, False), (0.5, True)])
def test_less_than_a_quarter_of_a_pixel_is_no_motion(shift: float, moves: bool) -> None:
    """A growth of 2 % explains the change anyway."""
    for growth in (1, 1.02):
        move = cv2.getRotationMatrix2D(((WIDTH - 1) / 2, (HEIGHT - 1) / 2), 0, growth)
        move[0, 2] += shift
        now = cv2.warpAffine(scene(), move, (WIDTH, HEIGHT), flags=cv2.INTER_CUBIC)
        found = view_motion(grey(scene()), grey(np.asarray(now, np.float32)))
        assert (found is not None) == moves


@pytest.mark.parametrize(
    ("contrast", "plain", "noise", "other", "share"),
    [
        (0.25, 0, 0, 0, 1),  # half of the cells have texture
        (0.2, 0, 0, 0, 0),  # a fifth of them
        (0.6, 0.65, 0, 0, 1),
        (0.6, 0.85, 0, 0, 0),
        (0.6, 0, 0.02, 0, 1),  # the motion leaves two thirds of the change, as a median
        (0.6, 0, 0.028, 0, 0.63),
        (0.6, 0, 0.03, 0, 0.43),  # it leaves 0.8
        (0.6, 0, 0.05, 0, 0),
        (0.6, 0, 0, 0.4, 0.8),
    ],
)
def test_the_share_of_the_motion_follows_from_the_cells_that_it_explains(
    contrast: float, plain: float, noise: float, other: float, share: float
) -> None:
    """The view moves by 2 px; shares of the width are plain, or show an object that moves by 6."""
    random, shown = np.random.default_rng(1), []
    for t, seen in enumerate(views([(0, 0, 0), (2, 0, 0)])):
        luma = 0.5 + contrast / 0.6 * (seen - 0.5) + random.normal(0, noise, seen.shape)
        luma[:, : round(plain * WIDTH)] = 0.5
        width = round(other * WIDTH)
        luma[:, :width] = np.roll(scene(3), -6 * t, 1)[:, :width]
        shown.append(grey(np.asarray(luma, np.float32)))
    found = view_motion(*shown)
    assert (found is not None) == (share > 0)
    if found is not None:
        expected = np.array([[1, 0, -2 * share], [0, 1, 0]])
        np.testing.assert_allclose(found[:2], expected, atol=0.2)


@pytest.mark.parametrize(("noise", "degrees"), [(0.02, 2.8), (0.04, 1.6), (0.05, 0.67), (0.08, 0)])
def test_a_turn_of_3_degrees_has_the_share_that_it_explains(noise: float, degrees: float) -> None:
    random = np.random.default_rng(1)
    frames = [
        grey(np.asarray(each + random.normal(0, noise, each.shape), np.float32))
        for each in views([(0, 0, 0), (0, 0, 3)])
    ]
    found = view_motion(*frames)
    assert (found is not None) == (degrees > 0)
    if found is not None:
        assert np.degrees(np.arctan2(found[1, 0], found[0, 0])) == pytest.approx(degrees, abs=0.1)
        assert np.hypot(*found[0, :2]) == pytest.approx(1, abs=1e-9)


def test_p_leaves_the_motion_of_the_view_out() -> None:
    """The view moves right by 3 px per frame; from frame 2 on the ground has a bright spot."""
    ground = 0.2 + 0.6 * texture(HEIGHT, 2 * WIDTH, 0)
    photoreceptors = Photoreceptors((HEIGHT, WIDTH))
    for t in range(4):
        if t == 2:
            ground[60:64, 76:80] = 1
        seen = ground[:, 3 * t : 3 * t + WIDTH].copy()
        photoreceptors.view = np.array([[1, 0, 3.0 * t], [0, 1, 0], [0, 0, 1]])
        photoreceptors.step(seen)
    now, before, two_ago = photoreceptors.maps
    spot = np.zeros((HEIGHT, WIDTH), np.bool_)
    spot[60:64, 67:71] = True  # as the latest frame shows its place
    inner = np.s_[:, :-12]  # the earlier frames do not show the rest
    assert before[spot].min() > 0.1
    for p in (now, np.where(spot, 0, before), two_ago):
        assert p[inner].max() < 1e-4  # OpenCV 4 rounds by 3e-5, next to -1000 beyond the frame
    for p, shifted in ((before, 3), (two_ago, 6)):
        assert p[:, -shifted:].max() == 0
    # Where the frame before does not show the place, its motion is not known, and P is the change.
    np.testing.assert_array_equal(now[:, -3:], np.abs(seen - ground[:, 6 : 6 + WIDTH])[:, -3:])
    # P is never larger than without a view: what stays in the picture does not change.
    photoreceptors.view = np.array([[1, 0, 20.0], [0, 1, 0], [0, 0, 1]])
    photoreceptors.step(seen)
    assert photoreceptors.maps[0].max() == 0


def test_places_that_the_earlier_frame_does_not_show_change_as_they_did() -> None:
    """White turns to black, also in the three columns that come into view."""
    photoreceptors = Photoreceptors((4, 20))
    for shift, level in ((0, 1), (3, 0)):
        photoreceptors.view = np.array([[1, 0, shift], [0, 1, 0], [0, 0, 1.0]])
        photoreceptors.step(np.full((4, 20), level, np.float32))
    np.testing.assert_array_equal(photoreceptors.maps[0], 1)


def test_luminance_is_interpolated_well_enough_for_fine_textures() -> None:
    """A grating of 6 px moves by 2.5 px; linear interpolation would leave a P of 0.04."""
    photoreceptors = Photoreceptors((20, 60))
    for shift in (0, 2.5):
        photoreceptors.view = np.array([[1, 0, shift], [0, 1, 0], [0, 0, 1]])
        row = 0.5 + 0.3 * np.sin(2 * np.pi * (np.arange(60) + shift) / 6)
        photoreceptors.step(np.tile(row, (20, 1)).astype(np.float32))
    assert photoreceptors.maps[0][:, 2:-5].max() < 0.01


def test_earlier_p_is_interpolated_and_a_reset_forgets_the_view() -> None:
    photoreceptors = Photoreceptors((4, 20))
    for t in range(4):
        if t == 3:  # the view moves by half a pixel
            photoreceptors.view = np.array([[1, 0, 0.5], [0, 1, 0], [0, 0, 1]])
        luma = np.zeros((4, 20), np.float32)
        luma[:, 10] = t == 2
        photoreceptors.step(luma)
    np.testing.assert_allclose(photoreceptors.maps[1][0, 8:12], [0, 0.5, 0.5, 0])
    photoreceptors.reset()
    np.testing.assert_array_equal(photoreceptors.view, np.eye(3))


def test_an_object_before_a_ground_at_rest_does_not_move_the_view() -> None:
    ground, moving = scene(), scene(3)
    view = SteadyView()
    for left in range(0, 40, 4):
        luma = ground.copy()
        luma[20:100, left : left + 60] = moving[20:100, :60]
        np.testing.assert_array_equal(view.step(luma, 1.0), np.eye(3))


def test_neither_growth_nor_noise_nor_a_grating_moves_the_view() -> None:
    x = np.arange(WIDTH) + np.zeros((HEIGHT, 1))
    middle, size = ((WIDTH - 1) / 2, (HEIGHT - 1) / 2), (WIDTH, HEIGHT)
    films: list[list[Any]] = [
        [cv2.warpAffine(scene(), cv2.getRotationMatrix2D(middle, 0, g), size) for g in (1, 1.02)],
        [scene() + RANDOM.normal(0, 0.02, (HEIGHT, WIDTH)) for _ in range(3)],
        [0.5 + 0.3 * np.sin((x + 3 * t) / 4) for t in range(3)],
        [np.full((HEIGHT, WIDTH), 0.5), np.full((HEIGHT, WIDTH), 0.6)],
        [np.full((8, 12), 0.5), texture(8, 12, 0)],
        [np.full((4, 40), 0.5), texture(4, 40, 0)],
    ]
    for film in films:
        view = SteadyView()
        for luma in film:
            np.testing.assert_allclose(
                view.step(np.asarray(luma, np.float32), 1.0), np.eye(3), atol=0.06
            )


def test_most_places_decide_about_the_motion() -> None:
    places = RANDOM.uniform(-50, 50, 200) + 1j * RANDOM.uniform(-50, 50, 200)
    flow = 1.5 - 2j + (1.02 * np.exp(0.01j) - 1) * places
    flow[:80] += 7  # an object moves otherwise
    shift, factor = fitted_motion(places, flow)
    assert shift == pytest.approx(1.5 - 2j, abs=0.02)
    assert factor == pytest.approx(1.02 * np.exp(0.01j), abs=5e-4)


def test_a_small_majority_decides_about_the_motion() -> None:
    """47 % of the places are at rest, as a dashboard, and the others move by 4 px."""
    places = RANDOM.uniform(-50, 50, 200) + 1j * RANDOM.uniform(-50, 50, 200)
    shift, factor = fitted_motion(places, np.where(np.arange(200) < 95, 0, 4.0 + 0j))
    assert [shift, factor] == pytest.approx([4, 1], abs=1e-4)
    # Errors of a tenth of a pixel are those of the flow, so that all places count.
    shift, _ = fitted_motion(places, np.where(np.arange(200) < 80, 0.1, 0j))
    assert shift == pytest.approx(0.034, abs=0.004)
    assert fitted_motion(places[:1], np.array([3 - 1j])) == (3 - 1j, 1)


def test_a_motion_in_a_reduced_frame_is_the_same_motion() -> None:
    motion = np.array([[1, 0, 4.0], [0, 1, -2], [0, 0, 1]])
    np.testing.assert_allclose(reduced(motion, 2), [[1, 0, 2], [0, 1, -1], [0, 0, 1]])
    turn = np.array([[0, -1, 7.0], [1, 0, 0], [0, 0, 1]])  # about the middle of 8 x 8 px
    np.testing.assert_allclose(reduced(turn, 2), [[0, -1, 3], [1, 0, 0], [0, 0, 1]], atol=1e-12)
    np.testing.assert_allclose(reduced(reduced(turn, 2), 0.5), turn, atol=1e-12)


def test_places_outside_the_earlier_frame_have_a_value_of_their_own() -> None:
    values = np.arange(12, dtype=np.float32).reshape(3, 4)
    motion = np.array([[1, 0, 1.0], [0, 1, 0], [0, 0, 1]])  # from x to x + 1 in the earlier frame
    for interpolation in (cv2.INTER_LINEAR, cv2.INTER_CUBIC):
        seen = seen_from(values, motion, -1, interpolation)
        np.testing.assert_array_equal(seen, [[1, 2, 3, -1], [5, 6, 7, -1], [9, 10, 11, -1]])


def shown(widths: Widths, frames: int, luminance: float = 0.06) -> list[Luma]:
    """Return a texture that moves between bars of these widths, with little noise."""
    made = []
    for t in range(frames):
        luma = np.roll(scene(2), 3 * t, 1)
        luma[: widths.top] = luma[HEIGHT - widths.bottom :] = luminance
        luma[:, : widths.left] = luma[:, WIDTH - widths.right :] = luminance
        noise = np.asarray(RANDOM.uniform(-1, 1, luma.shape) / 255, np.float32)
        made.append(np.clip(luma + noise, 0, 1))
    return made


@pytest.mark.parametrize(
    "widths", [Widths(left=40, right=40), Widths(top=15, bottom=16), Widths(12, 9, 9, 10)]
)
def test_bars_are_known_after_a_quarter_of_a_second(widths: Widths) -> None:
    bars = Bars()
    found = []
    for luma in shown(widths, 12):
        bars.step(luma, 1.0)
        found.append(bars.widths)
    assert found[7] == NO_BARS
    assert found[9:] == [widths] * 3
    bars, found = Bars(), []
    for luma in shown(widths, 18):
        bars.step(luma, 0.5)
        found.append(bars.widths)
    assert found == [NO_BARS] * 15 + [widths] * 3  # 15 steps after the first one are 7.5 intervals


def test_bars_end_at_the_first_frame_without_them() -> None:
    bars = Bars()
    for luma in [*shown(Widths(left=40, right=30), 12), *shown(Widths(right=30), 1)]:
        bars.step(luma, 1.0)
    assert bars.widths == Widths(right=30)


@pytest.mark.parametrize(("wide", "left"), [(3, 0), (4, 10)])
def test_a_bar_ends_in_an_edge_and_not_in_a_thin_line(wide: int, left: int) -> None:
    """The line 3 px beyond the first one after the strip counts."""
    bars = Bars()
    luma = np.zeros((HEIGHT, WIDTH), np.float32)
    luma[:, 10 : 10 + wide] = 1
    for _ in range(12):
        bars.step(luma, 1.0)
    assert bars.widths.left == left


def test_a_plain_ground_around_an_object_is_no_bar() -> None:
    """The lines beside the object are plain, but most of the line with its edge is ground too."""
    bars = Bars()
    luma = np.ones((HEIGHT, WIDTH), np.float32)
    luma[30:80, 50:100] = 0
    for _ in range(30):
        bars.step(luma, 1.0)
    assert bars.widths == NO_BARS


@pytest.mark.parametrize(("levels", "left"), [(7, 0), (5, 40)])
def test_a_strip_with_a_pattern_is_no_bar(levels: int, left: int) -> None:
    """A bar varies by 6 grey levels at most."""
    bars = Bars()
    for t in range(12):
        luma = np.roll(scene(2), 3 * t, 1)
        luma[:, :40] = 0.06
        luma[::2, :40] += levels / 255
        bars.step(luma, 1.0)
    assert bars.widths == Widths(left=left)


@pytest.mark.parametrize(("rows", "left"), [(0.79, 0), (0.81, 40)])
def test_most_of_the_side_is_an_edge_of_a_bar(rows: float, left: int) -> None:
    luma = np.full((HEIGHT, WIDTH), 0.06, np.float32)
    luma[: round(rows * HEIGHT), 40:] = 0.5
    bars = Bars()
    for _ in range(12):
        bars.step(luma, 1.0)
    assert bars.widths == Widths(left=left)


def test_a_step_of_8_levels_is_no_edge_of_a_bar() -> None:
    bars = Bars()
    luma = np.full((HEIGHT, WIDTH), 0.06, np.float32)
    luma[:, 40:] += 8 / 255
    for step in (0.0, 3 / 255):
        luma[:, 40:] += step
        for _ in range(12):
            bars.step(luma, 1.0)
        assert bars.widths == (Widths(left=40) if step else NO_BARS)


def test_a_bar_is_at_most_45_percent_of_the_frame_and_may_have_a_blurred_edge() -> None:
    """The three columns beside it differ from it by 8 of 255."""
    for width, expected in ((72, Widths(left=72)), (73, NO_BARS)):
        bars = Bars()
        for luma in shown(Widths(left=width + 3), 12):
            luma[:, width : width + 3] += 8 / 255
            bars.step(luma, 1.0)
        assert bars.widths == expected


def test_a_strip_that_becomes_narrower_was_ground_and_no_bar() -> None:
    """A wide band rests, and then grows."""
    bars = Bars()
    for size in [*[45] * 12, *range(46, 55)]:
        luma = np.ones((HEIGHT, WIDTH), np.float32)
        luma[60 - size : 60 + size, :] = 0.3
        bars.step(luma, 1.0)
        if size == 45:
            before = bars.widths
        else:  # one px more may be noise
            assert bars.widths == (before if size == 46 else NO_BARS)
    assert before == Widths(top=15, bottom=15)


def test_widths_may_vary_by_a_pixel() -> None:
    bars = Bars()
    for t in range(12):
        [luma] = shown(Widths(left=40 + t % 2), 1)
        bars.step(luma, 1.0)
    assert bars.widths == Widths(left=40)
    # A scene that seems to be part of the bar does not replace it at once.
    for left in (60, 60, 39, 60):
        [luma] = shown(Widths(left=left), 1)
        bars.step(luma, 1.0)
        assert bars.widths == Widths(left=40)


def test_a_frame_of_five_pixels_may_have_a_bar() -> None:
    bars = Bars()
    luma = np.zeros((5, 5), np.float32)
    luma[:, 2:] = 1
    for _ in range(9):
        bars.step(luma, 1.0)
    assert bars.widths == Widths(left=2)


def test_a_plain_frame_says_nothing_about_bars() -> None:
    bars = Bars()
    for luma in [*shown(Widths(top=15), 12), *[np.full((HEIGHT, WIDTH), 0.06, np.float32)] * 5]:
        bars.step(luma, 1.0)
    assert bars.widths == Widths(top=15)


def test_motion_beside_each_side_of_the_picture_is_left_out() -> None:
    maps = [np.ones((20, 40), np.float32) for _ in range(4)]
    leave_out_entering(maps, np.ones((20, 40), np.float32), 4, 2, Widths(6, 2, 3, 1))
    expected = np.ones((20, 40))
    expected[3:19, 6:38] = 0
    expected[7:15, 10:34] = 1  # further than 4 px from the edges of the picture
    for each in maps:
        np.testing.assert_array_equal(each, expected)


def test_motion_reaches_the_edge_of_the_frame_without_a_break() -> None:
    """A pixel moves if its P is at least 0.02, and 0.3 of the largest P in the first two pixels."""
    changes = np.array(
        [
            [1, 0.4, 0.31, 0.29, 1, 1],
            [0.03, 0.021, 0.019, 1, 1, 1],
            [0.5, 0.1, 1, 1, 1, 1],
            [0.1, 0.1, 1, 0.05, 0.04, 0.029],
            [0.01, 1, 1, 1, 1, 1],
        ],
        np.float32,
    )
    change = np.zeros((9, 30), np.float32)
    change[2:7, :6] = changes
    maps = [np.ones_like(change) for _ in range(4)]
    leave_out_entering(maps, change, 8, 2)
    expected = np.ones_like(change)
    for row, count in enumerate((3, 2, 1, 5, 0), 2):
        expected[row, :count] = 0
    for each in maps:
        np.testing.assert_array_equal(each, expected)
