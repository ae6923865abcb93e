"""Flat textured surfaces in three dimensions, seen by a pinhole camera in exact perspective.

A point of a surface is ``origin + u right + v up``. A matrix of 3 x 3 maps pixels to u and v. The
derivatives of u and v by the pixel's position follow from the same matrix; they give the exact
number of texels (pixels of the texture) that a pixel covers and over which it is averaged.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import cv2
import numpy as np

from oppload_cli.stimulus.coverage import PixelWindow

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from oppload_cli.stimulus.courses import Vector
    from oppload_cli.stimulus.coverage import Floats, Picture
    from oppload_cli.stimulus.staging import CameraView

    Rectangle = tuple[float, float, float, float]

_TAPS = 4  # samples along the longer side of the area that a pixel covers
_NEAREST_M, _FARTHEST_M = 1e-6, 1e4


class Texture:
    """A picture and its smaller copies.

    Parameters
    ----------
    values : ndarray
        float32 (h, w): luminance; or (h, w, 2): luminance times opacity, and opacity.
    repeats : bool
        Whether the picture repeats in both directions; its sides must then be powers of 2.
    """

    def __init__(self, values: Picture, *, repeats: bool) -> None:
        self.repeats = repeats
        self.height, self.width = values.shape[:2]
        if not repeats:
            rows, columns = (1 << math.ceil(math.log2(side + 2)) for side in values.shape[:2])
            padded = np.zeros((rows, columns, *values.shape[2:]), np.float32)
            padded[1 : self.height + 1, 1 : self.width + 1] = values
            values = padded
        self._margin = 0.0 if repeats else 1.0
        self.levels = [values]
        while min(self.levels[-1].shape[:2]) > 2:
            last = self.levels[-1]
            size = last.shape[1] // 2, last.shape[0] // 2
            half = cv2.resize(last, size, interpolation=cv2.INTER_AREA)
            self.levels.append(np.asarray(half, np.float32))

    def at(self, x: Picture, y: Picture, texels: Picture) -> Picture:
        """Return the texture at positions.

        Parameters
        ----------
        x, y : ndarray
            float32 (h, w): column and row in texels of the picture, 0 at its left and upper edge,
            at most 32767 (a limit of OpenCV).
        texels : ndarray
            float32 (h, w): side of the square of texels to average, at least 0.

        Returns
        -------
        ndarray
            float32 (h, w) or (h, w, 2).
        """
        depth = np.log2(np.clip(texels, np.float32(1), np.float32(1 << (len(self.levels) - 1))))
        total = np.zeros((*x.shape, *self.levels[0].shape[2:]), np.float32)
        for level in range(int(depth.min()), math.ceil(float(depth.max())) + 1):
            weight = np.maximum(1 - np.abs(depth - np.float32(level)), 0)
            part = bounds(weight > 1e-3)  # elsewhere the level is not read
            if part is None:
                continue
            weight = weight[part][..., None] if total.ndim == 3 else weight[part]
            total[part] += weight * self._read(level, x[part], y[part])
        return total

    def _read(self, level: int, x: Picture, y: Picture) -> Picture:
        values, scale = self.levels[level], np.float32(0.5**level)
        # Sample k is the value at the middle of texel k.
        column = (x + np.float32(self._margin)) * scale - np.float32(0.5)
        row = (y + np.float32(self._margin)) * scale - np.float32(0.5)
        border = cv2.BORDER_WRAP if self.repeats else cv2.BORDER_CONSTANT
        return np.asarray(cv2.remap(values, column, row, cv2.INTER_LINEAR, borderMode=border))


class Placed(NamedTuple):
    """The points of a surface that the pixels of a window show."""

    window: PixelWindow
    u: Floats  # float64 (h, w), like v: position on the surface in metres
    v: Floats
    depth: Floats  # float64 (h, w): metres along the camera's axis; 0 if the surface is not seen
    # float64 (4, h, w): derivatives of u and v by x, then of u and v by y, in metres per pixel.
    steps: Floats
    covered: Picture  # float32 (h, w): share of each pixel that the surface covers, 0 to 1


@dataclass(frozen=True)
class Surface:
    """A flat textured surface."""

    origin: Vector  # the point u = v = 0 in the world, in metres
    right: Vector  # direction of u, of length 1
    up: Vector  # direction of v, of length 1 and at right angles to `right`
    texture: Texture
    texture_m: float  # width of the texture
    corner: tuple[float, float] = (0.0, 0.0)  # u and v of the texture's upper left corner
    extent: Rectangle | None = None  # least u, least v, largest u, largest v; None: endless
    clear_m: float = 0.0  # haze hides 63 % of the surface at this distance; 0: no haze

    def _matrix(self, view: CameraView) -> Floats:
        """Return the matrix from ``(x, y, 1)`` in pixels to ``(u, v, 1) / depth``."""
        offset = np.subtract(self.origin, view.place)
        on_surface = np.stack([self.right, self.up, offset], axis=1)
        camera = np.array(view.axes).T
        eye, (x, y) = view.projection.eye_px, view.projection.middle
        rays = camera @ np.array([[1 / eye, 0, -x / eye], [0, -1 / eye, y / eye], [0, 0, 1.0]])
        return np.asarray(np.linalg.solve(on_surface, rays))

    def _window(self, view: CameraView) -> PixelWindow:
        """Return the part of the display that the surface may touch.

        The part is empty if the camera lies in the plane of the surface, or if the surface lies
        behind the camera.
        """
        distance = np.subtract(self.origin, view.place) @ np.cross(self.right, self.up)
        if abs(distance) < _NEAREST_M:
            return PixelWindow(0, 0, 0, 0)
        height, width = view.projection.shape
        if self.extent is None:
            return PixelWindow(0, height, 0, width)
        u0, v0, u1, v1 = self.extent
        corners = np.array([(u, v, 1.0) for u in (u0, u1) for v in (v0, v1)])
        x, y, over = np.linalg.solve(self._matrix(view), corners.T)
        if over.max() <= 0:
            return PixelWindow(0, 0, 0, 0)
        if over.min() <= 0:  # a corner beside or behind the camera
            return PixelWindow(0, height, 0, width)
        x, y = x / over, y / over
        # Averaging spreads transparent edges over a few more pixels.
        low, high = (x.min() - 3, y.min() - 3), (x.max() + 3, y.max() + 3)
        return PixelWindow.around(low, high, height, width)

    def _points(
        self, view: CameraView, window: PixelWindow
    ) -> tuple[Floats, Floats, Floats, Floats]:
        """Return u, v, depth and steps as of :class:`Placed`, for each pixel of a window."""
        m = self._matrix(view)
        x = np.arange(window.left, window.right)[None, :] + 0.5
        y = np.arange(window.top, window.bottom)[:, None] + 0.5
        over = m[2, 0] * x + m[2, 1] * y + m[2, 2]
        depth = 1 / np.maximum(over, 1 / _FARTHEST_M)
        u, v = ((m[i, 0] * x + m[i, 1] * y + m[i, 2]) * depth for i in (0, 1))
        steps = [(m[i, j] - at * m[2, j]) * depth for j in (0, 1) for i, at in ((0, u), (1, v))]
        # A pixel that looks behind the camera or beyond the horizon does not show the surface.
        depth = np.where(over > 1 / _FARTHEST_M, depth, 0.0)
        return u, v, depth, np.stack(steps)

    def seen(self, view: CameraView) -> Placed | None:
        """Return the part of a picture that shows the surface; None if the surface is not seen.

        Returns
        -------
        Placed or None
            The points of the surface in the smallest window with all pixels that it covers.
        """
        window = self._window(view)
        if 0 in window.shape:
            return None
        u, v, depth, steps = self._points(view, window)
        covered = self._coverage(u, v, depth, steps)
        part = bounds(covered > 0)
        if part is None:
            return None
        rows, columns = part
        top, left = window.top, window.left
        inner = PixelWindow(
            top + rows.start, top + rows.stop, left + columns.start, left + columns.stop
        )
        steps = steps[:, rows, columns]
        return Placed(inner, u[part], v[part], depth[part], steps, covered[part])

    def _coverage(self, u: Floats, v: Floats, depth: Floats, steps: Floats) -> Picture:
        ahead = depth > 0
        # The opacity of a texture already gives soft edges.
        if self.extent is None or self.texture.levels[0].ndim == 3:
            return np.asarray(ahead, np.float32)
        u0, v0, u1, v1 = self.extent
        ux, vx, uy, vy = steps
        wide = _inside(u, u0, u1, np.hypot(ux, uy))
        high = _inside(v, v0, v1, np.hypot(vx, vy))
        return np.asarray(wide * high * ahead, np.float32)

    def values(self, placed: Placed) -> Picture:
        """Return the texture, averaged over each pixel: float32 (h, w) or (h, w, 2)."""
        scale = self.texture.width / self.texture_m
        x, y = (placed.u - self.corner[0]) * scale, (self.corner[1] - placed.v) * scale
        if self.texture.repeats:
            x -= self.texture.width * np.floor(x / self.texture.width)
            y -= self.texture.height * np.floor(y / self.texture.height)
        column, row = x.astype(np.float32), y.astype(np.float32)
        ux, vx, uy, vy = placed.steps * scale
        by_x, by_y = np.hypot(ux, vx), np.hypot(uy, vy)
        longer = by_x >= by_y
        long, short = np.where(longer, by_x, by_y), np.where(longer, by_y, by_x)
        if float(np.max(long, initial=0.0)) <= 1.5 * float(np.max(short, initial=1e-9)):
            return self.texture.at(column, row, long.astype(np.float32))
        du = np.where(longer, ux, uy).astype(np.float32)
        dv = -np.where(longer, vx, vy).astype(np.float32)
        texels = np.maximum(short, long / _TAPS).astype(np.float32)
        shifts = (np.arange(_TAPS, dtype=np.float32) + 0.5) / _TAPS - 0.5
        taps = [self.texture.at(column + shift * du, row + shift * dv, texels) for shift in shifts]
        return np.asarray(sum(taps[1:], taps[0]) / np.float32(_TAPS), np.float32)

    def to_px(self, view: CameraView, u: Floats, v: Floats) -> tuple[Floats, Floats]:
        """Return the pixel positions x and y of points (u, v); NaN for points behind the camera."""
        back = np.linalg.inv(self._matrix(view))
        over = back[2, 0] * u + back[2, 1] * v + back[2, 2]
        over = np.where(over > 0, over, np.nan)
        x, y = ((back[i, 0] * u + back[i, 1] * v + back[i, 2]) / over for i in (0, 1))
        return x, y


def _inside(at: Floats, low: float, high: float, pixel: Floats) -> Floats:
    """Return the share of each pixel, `pixel` metres wide, that lies between `low` and `high`."""
    wide = np.maximum(pixel, 1e-12)
    ends = np.minimum(at + wide / 2, high) - np.maximum(at - wide / 2, low)
    return np.asarray(np.clip(ends / wide, 0.0, 1.0))


def bounds(mask: NDArray[np.bool_]) -> tuple[slice, slice] | None:
    """Return the rows and columns that contain all True pixels; None if no pixel is True."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if not len(rows):
        return None
    return slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)
