"""Values of patterns: random textures, gratings averaged over pixels, fields of dots."""

from __future__ import annotations

import math
import zlib
from typing import TYPE_CHECKING

import numpy as np

from oppload_cli.errors import StimulusError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from oppload_cli.stimulus.coverage import Floats, Picture
    from oppload_cli.stimulus.geometry import Pose
    from oppload_cli.stimulus.objects import Object


_MOST_DOTS = 1_000_000
# A phase that changes by less than this across a pixel counts as constant in the pixel.
_FLAT = 1e-6


def generator(seed: int, name: str) -> np.random.Generator:
    """Return a random generator for an object; its numbers follow from the seed and the name."""
    return np.random.default_rng([seed, zlib.crc32(name.encode())])


def noise_tile(side: int, exponent: float, finest: float, random: np.random.Generator) -> Picture:
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


class Tile:
    """A tile that repeats in both directions, read at any position by linear interpolation.

    Parameters
    ----------
    tile : ndarray
        float32 (side, side), side a power of 2.
    """

    def __init__(self, tile: Picture) -> None:
        self.levels = [tile]
        while self.levels[-1].shape[0] > 4:
            last = self.levels[-1]
            half = (last[0::2, 0::2] + last[1::2, 0::2] + last[0::2, 1::2] + last[1::2, 1::2]) / 4
            self.levels.append(half.astype(np.float32))

    def at(self, u: Floats, v: Floats, per_pixel: float) -> Picture:
        """Return the texture at positions.

        Parameters
        ----------
        u, v : ndarray
            Column and row, in sides of the tile: both (h, w), or (1, w) and (h, 1) for a grid,
            which is faster.
        per_pixel : float
            Samples of the tile per pixel of the display. Above 2, the values come from smaller
            copies of the tile, so that the texture does not flicker when it moves.

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

    def _sampled(self, level: int, u: Floats, v: Floats) -> Picture:
        tile = self.levels[level]
        side = tile.shape[0]
        # Sample k is the value at k + 0.5.
        (left, right, fx), (top, low, fy) = (_between(w * side - 0.5, side) for w in (u, v))
        if u.shape[0] == 1 and v.shape[1] == 1:
            rows = tile[top[:, 0]] * (1 - fy) + tile[low[:, 0]] * fy
            return np.asarray(rows[:, left[0]] * (1 - fx) + rows[:, right[0]] * fx, np.float32)
        upper = tile[top, left] * (1 - fx) + tile[top, right] * fx
        lower = tile[low, left] * (1 - fx) + tile[low, right] * fx
        return np.asarray(upper * (1 - fy) + lower * fy, np.float32)


def shaded(mean: float, contrast: float, values: Picture) -> Picture:
    """Return the luminance, clipped to 0 to 1, of a texture of mean 0 and standard deviation 1.

    `mean` and `contrast` are its mean luminance and its RMS contrast.
    """
    picture = np.float32(mean) * (1 + np.float32(contrast) * values)
    return np.asarray(np.clip(picture, 0.0, 1.0), dtype=np.float32)


def square_wave(phase: Floats, width: Floats, depth: Floats) -> Floats:
    """Return the mean of a square wave over each pixel.

    The wave is 1 in the first half of a cycle and -1 in the second. Projected onto the grating's
    axis, a pixel is the convolution of two boxes; the mean is therefore a second difference of the
    wave's second integral.

    Parameters
    ----------
    phase : ndarray
        Phase at the pixels' centres, in cycles.
    width, depth : ndarray
        Change of the phase across a pixel along x and along y, in cycles. They broadcast against
        `phase`.

    Returns
    -------
    ndarray
        -1 to 1.
    """
    width, depth = np.broadcast_arrays(np.abs(width), np.abs(depth))
    long, short = np.maximum(width, depth), np.minimum(width, depth)
    if np.max(short) < _FLAT:
        return _box(phase, np.maximum(long, _FLAT))
    short = np.maximum(short, _FLAT)
    # With two boxes as small as _FLAT, the difference would consist of rounding errors.
    long = np.maximum(long, 1e-4)
    outer, inner = (long + short) / 2, (long - short) / 2
    second = (
        _twice_integrated(phase + outer)
        - _twice_integrated(phase + inner)
        - _twice_integrated(phase - inner)
        + _twice_integrated(phase - outer)
    )
    return np.asarray(np.clip(second / (long * short), -1.0, 1.0))


def sine_wave(phase: Floats, width: Floats, depth: Floats) -> Floats:
    """Return the mean of a sine wave over each pixel, with arguments as of :func:`square_wave`."""
    return np.asarray(np.sin(2 * np.pi * phase) * np.sinc(width) * np.sinc(depth))


def _box(phase: Floats, width: Floats) -> Floats:
    return (_integrated(phase + width / 2) - _integrated(phase - width / 2)) / width


def _integrated(phase: Floats) -> Floats:
    """Return the integral of the square wave: a periodic triangle from 0 to 1/2."""
    cycle = phase - np.floor(phase)
    return 0.5 - np.abs(cycle - 0.5)


def _twice_integrated(phase: Floats) -> Floats:
    """Return the integral of the triangle minus its mean 1/4, so that the integral is periodic.

    The second difference removes the effect of the subtracted mean.
    """
    cycle = phase - np.floor(phase)
    second_half = cycle - 0.5
    return np.where(cycle < 0.5, cycle * (cycle / 2 - 0.25), second_half * (0.25 - second_half / 2))


class DotField:
    """Random dots in a square that repeats and is larger than the display.

    `view_deg` is the diameter of the display in degrees of the pattern, at its smallest scale.
    """

    def __init__(self, obj: Object, seed: int, view_deg: float) -> None:
        self.side = view_deg + 2 * (obj.dot_deg or 0.0)
        number = max(1, round((obj.dots_per_100deg2 or 0.0) / 100 * self.side**2))
        if number > _MOST_DOTS:
            raise StimulusError(
                f"object '{obj.id}': dots_per_100deg2 = {obj.dots_per_100deg2:g} makes "
                f"{number} dots, and the most is {_MOST_DOTS}; lower it, or its motion's zoom"
            )
        random = generator(seed, obj.id)
        self.places = random.uniform(-self.side / 2, self.side / 2, (number, 2))
        directions = random.uniform(0, 2 * math.pi, number)
        incoherent = round((1 - obj.coherence) * number)
        self.headings = np.stack([np.cos(directions), np.sin(directions)], axis=1)[:incoherent]

    def positions(self, pose: Pose) -> Floats:
        """Return the positions of the dots, float64 (n, 2): degrees right and up."""
        turn = _turn(pose.orientation_deg)
        places = self.places.copy()
        # An incoherent dot moves as far as the coherent dots, but in its own direction.
        common = np.array(pose.travel_deg)
        own = np.hypot(*common) * self.headings - common
        own_turn = _turn(pose.orientation_deg - pose.scene_turn_deg)
        places[: len(self.headings)] += own @ own_turn / pose.zoom
        centre = np.array(pose.centre_deg)
        middle = -centre @ turn / pose.zoom
        places += self.side * np.round((middle - places) / self.side)
        return np.asarray(centre + pose.zoom * (places @ turn.T))


def _turn(angle_deg: float) -> Floats:
    """Return the matrix, float64 (2, 2), that turns a column [right, up] counter-clockwise."""
    angle = math.radians(angle_deg)
    return np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])


def _between(position: Floats, side: int) -> tuple[NDArray[np.intp], NDArray[np.intp], Picture]:
    """Return the two samples around a position, and the weight of the second one."""
    floor = np.floor(position)
    first = floor.astype(np.intp) % side
    return first, (first + 1) % side, (position - floor).astype(np.float32)
