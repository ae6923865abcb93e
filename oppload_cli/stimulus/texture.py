"""Random textures with a 1/f spectrum, sampled at any place and scale."""

from __future__ import annotations

import zlib
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float32]

LARGEST_TILE = 2048


def generator(seed: int, name: str) -> np.random.Generator:
    """Return a random generator that depends on the seed and on a name only.

    Parameters
    ----------
    seed : int
        Of the protocol.
    name : str
        What it is for.

    Returns
    -------
    numpy.random.Generator
    """
    return np.random.default_rng([seed, zlib.crc32(name.encode())])


def noise_tile(side: int, exponent: float, finest: float, random: np.random.Generator) -> Floats:
    """Return a random texture that repeats seamlessly.

    Parameters
    ----------
    side : int
        Samples along each side.
    exponent : float
        Amplitudes fall as frequency to the power of minus this.
    finest : float
        Shortest wavelength, in samples.
    random : numpy.random.Generator
        Draws the phases.

    Returns
    -------
    ndarray
        float32 (side, side), mean 0, standard deviation 1.
    """
    x, y = np.fft.rfftfreq(side), np.fft.fftfreq(side)
    frequency = np.hypot(x[None, :], y[:, None])
    passed = (frequency > 0) & (frequency <= 1 / finest)
    amplitude = np.where(passed, np.where(passed, frequency, 1.0) ** -exponent, 0.0)
    phases = random.uniform(0, 2 * np.pi, amplitude.shape)
    tile = np.fft.irfft2(amplitude * np.exp(1j * phases), s=(side, side))
    spread = float(tile.std())
    tile = (tile - tile.mean()) / (spread if spread > 0 else 1.0)
    return np.asarray(tile, dtype=np.float32)


class Texture:
    """A tile and its smaller copies, read at any position by linear interpolation.

    Parameters
    ----------
    tile : ndarray
        float32 (side, side), side a power of 2; it repeats in both directions.
    """

    def __init__(self, tile: Floats) -> None:
        self.levels = [tile]
        while self.levels[-1].shape[0] > 4:
            last = self.levels[-1]
            half = (last[0::2, 0::2] + last[1::2, 0::2] + last[0::2, 1::2] + last[1::2, 1::2]) / 4
            self.levels.append(half.astype(np.float32))

    def at(self, u: NDArray[np.float64], v: NDArray[np.float64], per_pixel: float) -> Floats:
        """Return the texture at positions.

        Parameters
        ----------
        u, v : ndarray
            Column and row position in tiles (1 = one tile). (1, w) and (h, 1) are read
            as a grid, which is faster; otherwise both are (h, w).
        per_pixel : float
            Samples of the full tile per pixel of the display: from 2 on, smaller copies
            are read, so that nothing flickers.

        Returns
        -------
        ndarray
            float32 (h, w).
        """
        depth = min(max(np.log2(max(per_pixel, 1e-9)) - 1.0, 0.0), len(self.levels) - 1.0)
        level, share = int(depth), depth - int(depth)
        near = self._sampled(level, u, v)
        if share < 1e-6:
            return near
        return near * np.float32(1 - share) + self._sampled(level + 1, u, v) * np.float32(share)

    def _sampled(self, level: int, u: NDArray[np.float64], v: NDArray[np.float64]) -> Floats:
        tile = self.levels[level]
        side = tile.shape[0]
        # sample k stands for the middle of its cell
        (left, right, fx), (top, low, fy) = (_between(w * side - 0.5, side) for w in (u, v))
        if u.shape[0] == 1 and v.shape[1] == 1:
            rows = tile[top[:, 0]] * (1 - fy) + tile[low[:, 0]] * fy
            return np.asarray(rows[:, left[0]] * (1 - fx) + rows[:, right[0]] * fx, np.float32)
        upper = tile[top, left] * (1 - fx) + tile[top, right] * fx
        lower = tile[low, left] * (1 - fx) + tile[low, right] * fx
        return np.asarray(upper * (1 - fy) + lower * fy, np.float32)


def shaded(mean: float, contrast: float, values: Floats) -> Floats:
    """Return a texture's luminance.

    Parameters
    ----------
    mean : float
        Mean luminance.
    contrast : float
        RMS contrast.
    values : ndarray
        Texture of mean 0 and standard deviation 1.

    Returns
    -------
    ndarray
        float32, cut to 0 to 1.
    """
    picture = np.float32(mean) * (1 + np.float32(contrast) * values)
    return np.asarray(np.clip(picture, 0.0, 1.0), dtype=np.float32)


def _between(
    position: NDArray[np.float64], side: int
) -> tuple[NDArray[np.intp], NDArray[np.intp], Floats]:
    """Find the two samples around a position, and the weight of the second."""
    floor = np.floor(position)
    first = floor.astype(np.intp) % side
    return first, (first + 1) % side, (position - floor).astype(np.float32)
