"""Patterns (random textures, gratings, fields of dots), and pictures with transparency."""

from __future__ import annotations

import math
import zlib
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

import cv2
import numpy as np

from oppload_cli.errors import StimulusError, faults_at
from oppload_cli.stimulus.surfaces import Texture, bounds
from oppload_cli.video.images import read_transparent

if TYPE_CHECKING:
    from collections.abc import Callable

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
        (left, right, fx), (top, bottom, fy) = (_between(w * side - 0.5, side) for w in (u, v))
        if u.shape[0] == 1 and v.shape[1] == 1:
            rows = tile[top[:, 0]] * (1 - fy) + tile[bottom[:, 0]] * fy
            return np.asarray(rows[:, left[0]] * (1 - fx) + rows[:, right[0]] * fx, np.float32)
        upper = tile[top, left] * (1 - fx) + tile[top, right] * fx
        lower = tile[bottom, left] * (1 - fx) + tile[bottom, right] * fx
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
        long = np.maximum(long, _FLAT)
        return (_integrated(phase + long / 2) - _integrated(phase - long / 2)) / long
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


# ---- Pictures with transparency: drawn by the package, or read from an image ------------------


_SIDE = 512  # texels of the longer side of a drawing
# The longer side of an image is scaled to lie between these numbers of texels.
_SMALLEST, _LARGEST = 256, 2048


class _Cutout(NamedTuple):
    """A picture with transparency, cut to its opaque part."""

    texture: Texture  # luminance times opacity, and opacity
    width: float  # divided by the longer side, like the height
    height: float
    mean: float  # luminance, weighted by opacity


def cutout_of(obj: Object, seed: int) -> _Cutout:
    """Return the picture of an object.

    Raises
    ------
    StimulusError
        If its file cannot be read, has no transparency, or is transparent everywhere.
    """
    if obj.file is not None:
        return _from_file(obj.id, obj.file)
    return _drawn(str(obj.drawing), zlib.crc32(f"{seed}/{obj.id}".encode()))


@lru_cache(maxsize=32)
def _drawn(drawing: str, seed: int) -> _Cutout:
    return _cut(*_DRAWINGS[drawing](np.random.default_rng(seed)))


@lru_cache(maxsize=32)
def _from_file(object_id: str, path: str) -> _Cutout:
    where = f"object '{object_id}': file = '{path}'"
    with faults_at(where, StimulusError):
        luminance, opacity = read_transparent(path)
    if opacity is None or opacity.min() == 1:
        raise StimulusError(
            f"{where} has no transparency, so that its outline is not known; save it with an "
            "alpha channel"
        )
    if opacity.max() < 0.5:
        raise StimulusError(f"{where} is transparent everywhere; give an image with an opaque part")
    return _cut(luminance, opacity)


def _cut(luminance: Picture, opacity: Picture) -> _Cutout:
    """Cut a picture to the rectangle around the part that is at least half opaque."""
    layers = np.stack([luminance * opacity, opacity], axis=-1)[bounds(opacity >= 0.5)]
    longer = max(layers.shape[:2])
    scale = _SMALLEST / longer if longer < _SMALLEST else min(1.0, _LARGEST / longer)
    height, width = layers.shape[0] / longer, layers.shape[1] / longer
    if scale != 1:
        size = tuple(max(1, round(side * scale)) for side in (layers.shape[1], layers.shape[0]))
        method = cv2.INTER_LINEAR if scale > 1 else cv2.INTER_AREA
        layers = cv2.resize(layers, size, interpolation=method)
    layers = np.ascontiguousarray(layers, np.float32)
    mean = float(layers[..., 0].sum(dtype=np.float64) / layers[..., 1].sum(dtype=np.float64))
    return _Cutout(Texture(layers, repeats=False), width, height, mean)


# ---- Drawings: luminance and opacity, _SIDE texels along the longer side --------------------


def _grid(height: float) -> tuple[Floats, Floats]:
    """Return x (right) and y (up) of the texels: x from -1 to 1, y from -`height` to `height`."""
    rows = round(_SIDE * height)
    x = (np.arange(_SIDE) + 0.5 - _SIDE / 2) / (_SIDE / 2)
    y = (rows / 2 - np.arange(rows) - 0.5) / (_SIDE / 2)
    return np.asarray(x[None, :]), np.asarray(y[:, None])


def _texture(random: np.random.Generator, shape: tuple[int, ...], finest: float) -> Picture:
    return noise_tile(_SIDE, 1.0, finest, random)[: shape[0], : shape[1]]


def _ellipse(x: Floats, y: Floats, wide: float, high: float) -> Picture:
    """Return the opacity of an ellipse about the origin with these half axes."""
    radius = np.hypot(x / wide, y / high)
    return np.asarray(np.clip((1 - radius) * min(wide, high) * _SIDE / 2 + 0.5, 0, 1), np.float32)


def _block(x: Floats, y: Floats, wide: float, high: float) -> Picture:
    """Return the opacity of a rectangle about the origin with these half sides."""
    inside = np.minimum(wide - np.abs(x), high - np.abs(y))
    return np.asarray(np.clip(inside * _SIDE / 2 + 0.5, 0, 1), np.float32)


def _over(ground: Picture, share: Picture, luminance: float | Picture) -> Picture:
    return np.asarray(ground + share * (luminance - ground), np.float32)


def _ball(random: np.random.Generator) -> tuple[Picture, Picture]:
    x, y = _grid(1)
    depth = np.sqrt(np.clip(1 - x**2 - y**2, 0, 1))
    light = 0.55 + 0.45 * np.clip(0.8 * depth + 0.5 * y - 0.3 * x, 0, 1)
    texture = 1 + 0.25 * _texture(random, (_SIDE, _SIDE), 24)
    stripe = np.where(np.abs(y + 0.3 * x) < 0.12, 0.45, 1.0)
    luminance = np.clip(0.55 * light * texture * stripe, 0.02, 1)
    return np.asarray(luminance, np.float32), _ellipse(x, y, 1, 1)


def _box(random: np.random.Generator) -> tuple[Picture, Picture]:
    x, y = _grid(0.9)
    luminance = 0.5 * (1 + 0.12 * _texture(random, (y.size, x.size), 12))
    luminance = _over(luminance, _block(x, y, 0.12, 1), 0.62)
    luminance = _over(luminance, _block(x - 0.5, y + 0.45, 0.3, 0.2), 0.85)
    luminance = _over(luminance, _block(x - 0.5, y + 0.45, 0.2, 0.03), 0.1)
    rim = 1 - _block(x, y, 0.95, 0.85)
    opaque = np.ones((y.size, x.size), np.float32)
    return np.clip(_over(luminance, rim, 0.3), 0.02, 1), opaque


def _car(random: np.random.Generator) -> tuple[Picture, Picture]:
    x, y = _grid(0.8)
    cabin = _block(x / (0.78 - 0.22 * np.clip((y - 0.1) / 0.6, 0, 1)), y - 0.4, 1, 0.4)
    body = _block(x, y + 0.24, 0.97, 0.4)
    wheels = np.maximum(_block(x - 0.74, y + 0.6, 0.16, 0.2), _block(x + 0.74, y + 0.6, 0.16, 0.2))
    opacity = np.maximum(np.maximum(cabin, body), wheels)
    paint = 0.45 * (1 + 0.06 * _texture(random, (y.size, x.size), 40)) + 0.1 * y
    luminance = _over(np.asarray(paint, np.float32), wheels, 0.05)
    luminance = _over(luminance, body, np.asarray(paint, np.float32))
    window = _block(x / (0.66 - 0.2 * np.clip((y - 0.1) / 0.6, 0, 1)), y - 0.42, 1, 0.27)
    luminance = _over(luminance, window, 0.12)
    for side in (-1, 1):
        luminance = _over(luminance, _ellipse(x - side * 0.74, y + 0.1, 0.15, 0.09), 0.95)
    luminance = _over(luminance, _block(x, y + 0.14, 0.4, 0.08), 0.1)
    luminance = _over(luminance, _block(x, y + 0.42, 0.25, 0.06), 0.9)
    return np.clip(luminance, 0.02, 1), opacity


def _bird(random: np.random.Generator) -> tuple[Picture, Picture]:
    x, y = _grid(0.45)
    body = _ellipse(x, y, 0.2, 0.26)
    head = _ellipse(x, y - 0.25, 0.11, 0.13)
    wings = np.maximum(
        _ellipse(x - 0.5, y - 0.12 - 0.3 * (x - 0.5), 0.5, 0.12),
        _ellipse(x + 0.5, y - 0.12 + 0.3 * (x + 0.5), 0.5, 0.12),
    )
    opacity = np.maximum(np.maximum(body, head), wings)
    plumage = 0.35 * (1 + 0.3 * _texture(random, (y.size, x.size), 10))
    luminance = _over(np.asarray(plumage, np.float32), body, 0.5)
    luminance = _over(luminance, head, 0.25)
    return np.clip(luminance, 0.02, 1), opacity


_DRAWINGS: dict[str, Callable[[np.random.Generator], tuple[Picture, Picture]]] = {
    "ball": _ball,
    "box": _box,
    "car": _car,
    "bird": _bird,
}


@lru_cache(maxsize=1)
def shadow_of() -> Texture:
    """Return a soft round shadow: a black texture with opacity."""
    x, y = _grid(1)
    share = np.clip(1.3 * (1 - np.hypot(x, y)), 0, 1) ** 0.7
    layers = np.stack([np.zeros_like(share), share], axis=-1)
    return Texture(np.asarray(layers, np.float32), repeats=False)
