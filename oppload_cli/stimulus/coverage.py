"""Exact area coverage: which share of each pixel a disk or a polygon covers.

The outline is cut at every pixel border, so that each piece lies in one pixel. A formula gives the
area between the piece, straight or an arc, and the right border of the pixel. Cumulative sums along
the rows then cover the inside.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from oppload_cli.stimulus.geometry import Pose, Projection, corners_of

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from oppload_cli.stimulus.objects import Object

    Floats = NDArray[np.float64]
    Picture = NDArray[np.float32]
    Grey = NDArray[np.uint8]


@dataclass(frozen=True)
class PixelWindow:
    """A rectangle of pixels of the display: rows top to bottom, columns left to right."""

    top: int
    bottom: int
    left: int
    right: int

    @classmethod
    def around(cls, low: ArrayLike, high: ArrayLike, height: int, width: int) -> PixelWindow:
        """Return the pixels of the display that the box between two corners (x, y) touches."""
        left, top = np.clip(np.floor(low), 0, (width, height)).astype(int).tolist()
        right, bottom = np.clip(np.ceil(high), 0, (width, height)).astype(int).tolist()
        return cls(top, bottom, left, right)

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width in pixels."""
        return self.bottom - self.top, self.right - self.left

    @property
    def slices(self) -> tuple[slice, slice]:
        """The rows and columns of the window, as an index of a picture."""
        return slice(self.top, self.bottom), slice(self.left, self.right)


def shape_coverage(projection: Projection, obj: Object, pose: Pose) -> tuple[PixelWindow, Floats]:
    """Return the area coverage of a shape in a pose, as :func:`polygon_coverage` does."""
    if obj.kind not in {"disk", "patch", "ring"}:
        return polygon_coverage(corners_of(projection, obj, pose), *projection.shape)
    (x, y), (ahead, behind) = projection.middle_of(pose)
    window, coverage = disk_coverage(x, y, (ahead + behind) / 2, *projection.shape)
    inner = pose.extent.size / 2 - (obj.width_deg or 0.0)
    if obj.kind == "ring" and inner > 0:
        hole, open_share = disk_coverage(x, y, projection.reach(inner), *projection.shape)
        rows = slice(hole.top - window.top, hole.bottom - window.top)
        columns = slice(hole.left - window.left, hole.right - window.left)
        coverage[rows, columns] -= open_share
    return window, np.maximum(coverage, 0.0)


def polygon_coverage(corners: ArrayLike, height: int, width: int) -> tuple[PixelWindow, Floats]:
    """Return the area coverage of a simple polygon.

    Parameters
    ----------
    corners : array_like
        (n, 2), x and y in pixels, in order around the polygon.
    height, width : int
        Size of the display in pixels.

    Returns
    -------
    PixelWindow
        The pixels of the display that the polygon may touch.
    ndarray
        float64 of the window's shape, 0 to 1.
    """
    points = np.asarray(corners, dtype=np.float64)
    window = PixelWindow.around(points.min(axis=0), points.max(axis=0), height, width)
    pieces = [
        _line_pieces(start, stop, window)
        for start, stop in zip(points, np.roll(points, -1, axis=0), strict=True)
    ]
    dy, x_dy, column, row = (np.concatenate(part) for part in zip(*pieces, strict=True))
    return window, _filled(window, dy, x_dy, column, row)


def disk_coverage(
    x: ArrayLike, y: ArrayLike, radius: float, height: int, width: int
) -> tuple[PixelWindow, Floats]:
    """Return the area coverage of disks of one size, as :func:`polygon_coverage` does.

    The coverages of overlapping disks are added, up to 1.

    Parameters
    ----------
    x, y : array_like
        Centres in pixels, scalars or of the shape (n,).
    radius : float
        In pixels.
    height, width : int
        Size of the display in pixels.
    """
    cx, cy = (np.atleast_1d(np.asarray(v, dtype=np.float64)) for v in (x, y))
    low, high = (cx.min() - radius, cy.min() - radius), (cx.max() + radius, cy.max() + radius)
    window = PixelWindow.around(low, high, height, width)
    angles = _crossing_angles(cx, cy, radius, window)
    first, last = angles[:, :-1], angles[:, 1:]
    dy = radius * (np.sin(last) - np.sin(first))
    arc = (last - first) / 2 + (np.sin(2 * last) - np.sin(2 * first)) / 4
    x_dy = cx[:, None] * dy + radius**2 * arc
    middle = (first + last) / 2
    column = np.floor(cx[:, None] + radius * np.cos(middle))
    row = np.floor(cy[:, None] + radius * np.sin(middle))
    return window, _filled(window, dy.ravel(), x_dy.ravel(), column.ravel(), row.ravel())


def _crossing_angles(cx: Floats, cy: Floats, radius: float, window: PixelWindow) -> Floats:
    """Return the sorted angles at which circles cross pixel borders: (n, pieces + 1)."""
    by_column = np.arccos(_border_offsets(cx, radius, window.left, window.right))
    by_row = np.arcsin(_border_offsets(cy, radius, window.top, window.bottom))
    angles = np.concatenate(
        [by_column, 2 * np.pi - by_column, by_row % (2 * np.pi), np.pi - by_row], axis=1
    )
    angles.sort(axis=1)
    return np.concatenate([angles, angles[:, :1] + 2 * np.pi], axis=1)


def _border_offsets(centre: Floats, radius: float, low: int, high: int) -> Floats:
    """Return the distances from the centre to the borders that a circle may cross, in radii."""
    first = np.maximum(np.floor(centre - radius), low)
    count = min(int(np.ceil(2 * radius)) + 2, high - low + 1)
    borders = first[:, None] + np.arange(count)
    # A border beyond the circle becomes the end of the circle and adds a piece of length 0.
    return np.clip((borders - centre[:, None]) / max(radius, 1e-12), -1.0, 1.0)


def _line_pieces(start: Floats, stop: Floats, window: PixelWindow) -> tuple[Floats, ...]:
    """Cut a line at pixel borders; return dy, integral of x dy, column and row of each piece."""
    step = stop - start
    cuts = [np.array([0.0, 1.0])]
    for axis, low, high in ((0, window.left, window.right), (1, window.top, window.bottom)):
        if step[axis]:
            ends = sorted((start[axis], stop[axis]))
            borders = np.arange(
                np.clip(np.ceil(ends[0]), low, high), np.clip(np.floor(ends[1]), low, high) + 1
            )
            cuts.append((borders - start[axis]) / step[axis])
    shares = np.unique(np.clip(np.concatenate(cuts), 0.0, 1.0))
    x, y = (start[axis] + shares * step[axis] for axis in (0, 1))
    middle_x, middle_y = (x[:-1] + x[1:]) / 2, (y[:-1] + y[1:]) / 2
    dy = np.diff(y)
    return dy, middle_x * dy, np.floor(middle_x), np.floor(middle_y)


def _filled(window: PixelWindow, dy: Floats, x_dy: Floats, column: Floats, row: Floats) -> Floats:
    """Add up the areas to the right of all pieces; `dy` gives them their signs."""
    height, width = window.shape
    if not height or not width:
        return np.zeros((height, width))
    column, row = column - window.left, row - window.top
    x_dy = x_dy - window.left * dy
    inside = (row >= 0) & (row < height) & (column < width)
    dy, x_dy, column, row = dy[inside], x_dy[inside], column[inside], row[inside]
    # A piece left of the window has all columns of the window on its right: only dy counts.
    outside = column < 0
    x_dy, column = np.where(outside, 0.0, x_dy), np.where(outside, 0.0, column)
    cell = (row * (width + 1) + column).astype(np.intp)
    size = height * (width + 1)
    total = np.bincount(cell, weights=dy * (column + 1) - x_dy, minlength=size)
    total += np.bincount(cell + 1, weights=x_dy - dy * column, minlength=size + 1)[:size]
    area = np.cumsum(total.reshape(height, width + 1)[:, :width], axis=1)
    return np.clip(np.abs(area), 0.0, 1.0)
