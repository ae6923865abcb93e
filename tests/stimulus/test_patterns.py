"""Patterns: gratings averaged over pixels, and textures that are seamless and seeded."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from oppload_cli import stimulus
from oppload_cli.stimulus.kinematics import pose_of
from oppload_cli.stimulus.patterns import (
    DotField,
    Tile,
    generator,
    noise_tile,
    sine_wave,
    square_wave,
)
from tests.stimulus.measuring import made

if TYPE_CHECKING:
    from collections.abc import Callable


@pytest.mark.parametrize("angle", [0, 10, 45, 90, 133])
@pytest.mark.parametrize("wave", [square_wave, sine_wave])
def test_average_over_the_pixel(wave: object, angle: float) -> None:
    assert callable(wave)
    period, fine = 7.3, 64
    u = np.array([np.cos(np.radians(angle)), np.sin(np.radians(angle))]) / period
    samples = (np.arange(20 * fine) + 0.5) / fine
    phase = samples[None, :] * u[0] + samples[:, None] * u[1]
    sharp = np.sign(np.sin(2 * np.pi * phase)) if wave is square_wave else np.sin(2 * np.pi * phase)
    expected = sharp.reshape(20, fine, 20, fine).mean(axis=(1, 3))
    centres = np.arange(20) + 0.5
    centre_phase = centres[None, :] * u[0] + centres[:, None] * u[1]
    measured = wave(centre_phase, np.array(u[0]), np.array(u[1]))
    assert np.abs(measured - expected).max() < 0.02
    assert np.abs(measured - expected).mean() < 0.002


@pytest.mark.parametrize("kind", ["square-grating", "sine-grating"])
@pytest.mark.parametrize("axis", [0, 45, 90, 200])
def test_drift_is_as_the_ground_truth_says(kind: str, axis: float) -> None:
    motion = stimulus.Motion(speed_deg_s=20)
    obj = stimulus.Object(id="g", kind=kind, period_deg=10, axis_deg=axis, motion=motion)
    display = {"width": 120, "height": 120, "pixels_per_degree": 4}
    protocol = made(obj, seconds=0.5, display=display)
    rows, columns = np.mgrid[0:120, 0:120] + 0.5
    along = columns * np.cos(np.radians(axis)) - rows * np.sin(np.radians(axis))
    window = np.hanning(120)[:, None] * np.hanning(120)
    probe = window * np.exp(-2j * np.pi * along / 40)
    frames = list(stimulus.frames(protocol))
    phases = [np.angle(np.sum((frame.luma - 0.5) * probe)) for frame in frames]
    moved = -np.diff(np.unwrap(phases)) / (2 * np.pi) * 40
    stated = frames[0].truth.objects[0].edge_speed_px_frame
    assert stated == pytest.approx(20 * 4 / 30)
    np.testing.assert_allclose(moved, stated, atol=0.02)


def grating(**keys: Any) -> stimulus.Renderer:
    obj = stimulus.Object(id="g", **{"kind": "sine-grating", "period_deg": 10, **keys})
    display = {"width": 80, "height": 60, "pixels_per_degree": 2}
    return stimulus.Renderer(made(obj, display=display))


def test_the_phase_is_that_at_the_centre() -> None:
    for phase, luminance in ((90, 1.0), (270, 0.0)):
        for kind in ("sine-grating", "plaid"):
            shown = grating(kind=kind, phase_deg=phase).luminance(0)
            assert shown[30, 40] == pytest.approx(luminance, abs=0.02)


@pytest.mark.parametrize("kind", ["sine-grating", "square-grating"])
@pytest.mark.parametrize("axis", [0, 30])
def test_a_zoomed_grating_is_one_of_a_longer_period(kind: str, axis: float) -> None:
    look = {"kind": kind, "axis_deg": axis, "centre_deg": (3, -2)}
    zoomed = grating(**look, motion=stimulus.Motion(zoom_per_s=0.8)).luminance(15)
    longer = grating(**look | {"period_deg": 10 * math.exp(0.4)}).luminance(0)
    np.testing.assert_allclose(zoomed, longer, atol=1e-5)


@pytest.mark.parametrize("projection", ["flat", "perspective"])
@pytest.mark.parametrize("kind", ["sine-grating", "square-grating", "plaid"])
@pytest.mark.parametrize("axis", [0, 90, 207])
def test_gratings_are_those_of_their_formula(kind: str, projection: str, axis: float) -> None:
    """The mean of 16 x 16 samples in each pixel; luminance, contrast and phase are no defaults."""
    look: dict[str, Any] = {"axis_deg": axis, "phase_deg": 40, "centre_deg": (3, -2)}
    look |= {"period_deg": 6, "luminance": 0.3, "contrast": 0.8}
    turns = [0.0] if kind != "plaid" else [-25.0, 25.0]
    obj = stimulus.Object(id="g", kind=kind, **look | ({"plaid_deg": 50} if turns[1:] else {}))
    display = {"width": 50, "height": 40, "pixels_per_degree": 2, "projection": projection}
    shown = stimulus.Renderer(made(obj, display=display)).luminance(0)
    x = ((np.arange(50 * 16) + 0.5) / 16 - 25)[None, :]
    y = (20 - (np.arange(40 * 16) + 0.5) / 16)[:, None]
    away, eye = np.hypot(x, y), 2 * 180 / math.pi
    degrees = np.degrees(np.arctan(away / eye)) / away if projection == "perspective" else 0.5
    right, up = x * degrees - 3, y * degrees + 2
    waves = np.zeros((40 * 16, 50 * 16))
    for turn in np.radians(np.add(turns, axis)):
        wave = np.sin(2 * np.pi * ((right * np.cos(turn) + up * np.sin(turn)) / 6 + 40 / 360))
        waves += (np.sign(wave) if kind == "square-grating" else wave) / len(turns)
    expected = (0.3 * (1 + 0.8 * waves)).reshape(40, 16, 50, 16).mean(axis=(1, 3))
    assert np.abs(shown - expected).max() < (0.03 if kind == "square-grating" else 0.002)


def wavelengths(picture: np.ndarray) -> Callable[[float, float], float]:
    """Return a function: the share of the variance at wavelengths between two limits in px."""
    side = picture.shape[0]
    window = np.hanning(side)[:, None] * np.hanning(side)
    power = np.abs(np.fft.fft2((picture - picture.mean()) * window)) ** 2
    frequency = np.hypot(np.fft.fftfreq(side)[:, None], np.fft.fftfreq(side)[None, :])
    return lambda low, high: float(
        power[(frequency > 1 / high) & (frequency <= 1 / low)].sum() / power.sum()
    )


@pytest.mark.parametrize(("finest_deg", "finest_px"), [(None, 4), (1.25, 2.5)])
def test_the_finest_wavelength_of_a_texture(finest_deg: float | None, finest_px: float) -> None:
    ground = stimulus.Object(id="t", kind="texture", contrast=0.1, finest_deg=finest_deg)
    display = {"width": 256, "height": 128, "pixels_per_degree": 2}
    picture = stimulus.Renderer(made(ground, display=display)).luminance(0)
    share = wavelengths(picture[:, :128])
    assert share(1, 0.9 * finest_px) < 0.001
    assert share(finest_px, 1.6 * finest_px) > 0.02
    # Its tile is as wide as the display, and does not repeat before.
    assert np.abs(picture[:, :128] - picture[:, 128:]).max() > 0.1


def test_a_texture_has_no_wavelength_below_two_samples() -> None:
    """Samples hold shorter wavelengths along the diagonals only; 0.2 deg are two samples here."""
    display = {"width": 32, "height": 32}
    grounds = (
        stimulus.Object(id="t", kind="texture", finest_deg=finest) for finest in (0.19, 0.01)
    )
    first, second = (
        stimulus.Renderer(made(ground, display=display)).luminance(0) for ground in grounds
    )
    np.testing.assert_array_equal(first, second)


def test_a_textured_disk_is_a_disk_whose_texture_grows_with_it() -> None:
    display = {"width": 260, "height": 260, "pixels_per_degree": 2}

    def shown(**keys: Any) -> np.ndarray:
        obj = stimulus.Object(id="p", **{"kind": "patch", "luminance": 0.5, **keys})
        return stimulus.Renderer(made(obj, display=display)).luminance(0)

    plain = shown(kind="disk", size_deg=120)
    np.testing.assert_array_equal(shown(size_deg=120, contrast=0), plain)
    large, small = shown(size_deg=120, contrast=0.2), shown(size_deg=10, contrast=0.2)
    share = wavelengths(large[50:210, 50:210])
    assert share(1, 0.7 * 240 / 8) < 0.005  # the finest wavelength is an eighth of the size
    assert share(240 / 8, 240 / 5) > 0.05
    # A pixel of the small disk has the mean of 12 x 12 pixels of the large one.
    means = large[46:214, 46:214].reshape(14, 12, 14, 12).mean(axis=(1, 3))
    assert np.abs(small[123:137, 123:137] - means).max() < 0.02


def test_a_textured_disk_turns_counter_clockwise() -> None:
    motion = stimulus.Motion(rotation_deg_s=90)
    patch = stimulus.Object(id="p", kind="patch", size_deg=20, contrast=0.3, motion=motion)
    display = {"width": 60, "height": 60, "pixels_per_degree": 2}
    renderer = stimulus.Renderer(made(patch, seconds=2, display=display))
    turned = np.rot90(renderer.luminance(0))
    assert turned.std() > 0.1
    np.testing.assert_allclose(renderer.luminance(30), turned, atol=1e-4)


def test_mean_and_contrast() -> None:
    protocol = stimulus.load("controls/sine-grating/axis-45")
    luma = next(iter(stimulus.frames(protocol))).luma
    assert luma.mean() == pytest.approx(0.5, abs=0.01)
    assert luma.min() < 0.02
    assert luma.max() > 0.98


def test_tile_is_standardised_seeded_and_seamless() -> None:
    tile = noise_tile(128, 1.0, 8.0, generator(3, "ground"))
    assert tile.mean() == pytest.approx(0, abs=1e-6)
    assert tile.std() == pytest.approx(1, abs=1e-6)
    np.testing.assert_array_equal(tile, noise_tile(128, 1.0, 8.0, generator(3, "ground")))
    for other in (generator(4, "ground"), generator(3, "other")):
        assert not np.array_equal(tile, noise_tile(128, 1.0, 8.0, other))
    # the step over the border is no larger than the steps inside
    inside = np.abs(np.diff(tile, axis=1)).max()
    assert np.abs(tile[:, 0] - tile[:, -1]).max() <= inside * 1.2


def test_shortest_wavelength() -> None:
    spectrum = np.abs(np.fft.rfft2(noise_tile(128, 1.0, 16.0, generator(3, "ground"))))
    frequency = np.hypot(np.fft.fftfreq(128)[:, None], np.fft.rfftfreq(128)[None, :])
    assert spectrum[frequency > 1 / 16 + 1e-9].max() < 1e-3 * spectrum.max()


def shortest(ways: np.ndarray, side: float, turn_deg: float) -> np.ndarray:
    """Return ways on a square that repeats and is turned, each by the shortest way."""
    turn = math.radians(turn_deg)
    axes = np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])
    along = ways @ axes
    return np.asarray((along - side * np.round(along / side)) @ axes.T)


@pytest.mark.parametrize(("coherence", "together"), [(0.0, 0.0), (0.25, 0.25), (1.0, 1.0)])
def test_dots_move_equally_far_together_or_each_in_its_own_direction(
    coherence: float, together: float
) -> None:
    dots = stimulus.Object(
        id="dots",
        kind="dots",
        dot_deg=1,
        dots_per_100deg2=10,
        coherence=coherence,
        axis_deg=35,
        motion=stimulus.Motion(speed_deg_s=5, direction_deg=90),
    )
    protocol = made(dots)
    field = DotField(dots, 0, 60.0)
    before, after = (field.positions(pose_of(protocol, dots, time)) for time in (0.0, 0.4))
    moved = shortest(after - before, field.side, 35)
    np.testing.assert_allclose(np.hypot(*moved.T), 5 * 0.4)
    up = np.isclose(moved[:, 1], 5 * 0.4) & np.isclose(moved[:, 0], 0)
    assert up.mean() == pytest.approx(together, abs=0.01)
    # A pattern that grows lays its dots apart, but does not make their own ways longer.
    grows = replace(dots, motion=stimulus.Motion(speed_deg_s=5, direction_deg=90, zoom_per_s=0.5))
    grown = math.exp(0.5 * 0.4)
    ways = field.positions(pose_of(protocol, grows, 0.4)) - grown * before
    np.testing.assert_allclose(shortest(ways, grown * field.side, 35), moved, atol=1e-9)
    # A turn of the scene turns each movement.
    turned = replace(protocol, scene=stimulus.Scene(rotation_deg=90))
    before, after = (field.positions(pose_of(turned, dots, time)) for time in (0.0, 0.4))
    aside = np.stack([-moved[:, 1], moved[:, 0]], axis=1)
    np.testing.assert_allclose(shortest(after - before, field.side, 125), aside, atol=1e-9)
    # However far the pattern has moved, and however it is turned, its square lies on the display.
    scene = stimulus.Scene(centre_deg=(100, 30), rotation_deg=90)
    for one, side in ((dots, field.side), (grows, grown * field.side)):
        places = field.positions(pose_of(replace(protocol, scene=scene), one, 0.4))
        np.testing.assert_allclose(shortest(places, side, 125), places, atol=1e-9)


def test_grid_and_scattered_positions_are_read_alike() -> None:
    tile = Tile(noise_tile(64, 1.0, 4.0, generator(1, "a")))
    u, v = np.linspace(-0.7, 1.3, 23)[None, :], np.linspace(0.1, 0.9, 17)[:, None]
    spread = np.broadcast_arrays(u, v)
    np.testing.assert_allclose(tile.at(u, v, 2.5), tile.at(spread[0], spread[1], 2.5), atol=1e-6)


def test_smaller_copies_lie_where_the_tile_does() -> None:
    """Half a sample off, and a shrinking texture would creep."""
    tile = Tile(noise_tile(256, 1.0, 64.0, generator(1, "a")))
    u, v = np.linspace(0, 1, 50)[None, :], np.linspace(0, 1, 50)[:, None]
    full = tile.at(u, v, 1.0)
    for per_pixel in (4.0, 8.0, 11.0):
        assert np.abs(tile.at(u, v, per_pixel) - full).max() < 0.06
