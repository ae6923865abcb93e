"""Textures: seamless, seeded, and the same at every scale."""

from __future__ import annotations

import numpy as np
import pytest

from oppload_cli.stimulus.texture import Texture, generator, noise_tile


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


def test_grid_and_scattered_positions_are_read_alike() -> None:
    texture = Texture(noise_tile(64, 1.0, 4.0, generator(1, "a")))
    u, v = np.linspace(-0.7, 1.3, 23)[None, :], np.linspace(0.1, 0.9, 17)[:, None]
    spread = np.broadcast_arrays(u, v)
    np.testing.assert_allclose(
        texture.at(u, v, 2.5), texture.at(spread[0], spread[1], 2.5), atol=1e-6
    )


def test_smaller_copies_lie_where_the_tile_does() -> None:
    """Half a sample off, and a shrinking texture would creep."""
    texture = Texture(noise_tile(256, 1.0, 64.0, generator(1, "a")))
    u, v = np.linspace(0, 1, 50)[None, :], np.linspace(0, 1, 50)[:, None]
    full = texture.at(u, v, 1.0)
    for per_pixel in (4.0, 8.0, 11.0):
        assert np.abs(texture.at(u, v, per_pixel) - full).max() < 0.06
