"""Pictures with transparency: drawn by the package, or read from an image."""

from __future__ import annotations

import zlib
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

import cv2
import numpy as np

from oppload_cli.errors import StimulusError, faults_at
from oppload_cli.stimulus.patterns import noise_tile
from oppload_cli.stimulus.surfaces import Texture, bounds
from oppload_cli.video.images import read_transparent

if TYPE_CHECKING:
    from collections.abc import Callable

    from oppload_cli.stimulus.coverage import Floats, Picture
    from oppload_cli.stimulus.objects import Object


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
    both = np.stack([luminance * opacity, opacity], axis=-1)[bounds(opacity >= 0.5)]
    longer = max(both.shape[:2])
    scale = _SMALLEST / longer if longer < _SMALLEST else min(1.0, _LARGEST / longer)
    height, width = both.shape[0] / longer, both.shape[1] / longer
    if scale != 1:
        size = tuple(max(1, round(side * scale)) for side in (both.shape[1], both.shape[0]))
        way = cv2.INTER_LINEAR if scale > 1 else cv2.INTER_AREA
        both = cv2.resize(both, size, interpolation=way)
    both = np.ascontiguousarray(both, np.float32)
    mean = float(both[..., 0].sum(dtype=np.float64) / both[..., 1].sum(dtype=np.float64))
    return _Cutout(Texture(both, repeats=False), width, height, mean)


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
    """Return the opacity of a soft round shadow: (h, w, 2), black."""
    x, y = _grid(1)
    share = np.clip(1.3 * (1 - np.hypot(x, y)), 0, 1) ** 0.7
    both = np.stack([np.zeros_like(share), share], axis=-1)
    return Texture(np.asarray(both, np.float32), repeats=False)
