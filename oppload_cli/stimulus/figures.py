"""Painters of figures: each puts one object of a protocol onto the picture."""

from __future__ import annotations

import math
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from oppload_cli.stimulus.coverage import Window, disk_coverage, polygon_coverage
from oppload_cli.stimulus.geometry import Projection
from oppload_cli.stimulus.outline import corners_of, middle_of
from oppload_cli.stimulus.texture import Texture, generator, noise_tile, shaded

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from oppload_cli.stimulus.kinematics import Pose
    from oppload_cli.stimulus.objects import Object
    from oppload_cli.stimulus.protocol import Protocol

    Floats = NDArray[np.float64]
    Picture = NDArray[np.float32]


class Painter:
    """Paints an object of one colour; the base of the others.

    Parameters
    ----------
    protocol : Protocol
        The stimulus.
    thing : Object
        The object to paint.
    """

    def __init__(self, protocol: Protocol, thing: Object) -> None:
        self.protocol, self.thing = protocol, thing
        self.projection = Projection.of(protocol.display)
        self.height, self.width = protocol.display.height, protocol.display.width

    def paint(self, picture: Picture, pose: Pose) -> None:
        """Paint the object over what is there.

        Parameters
        ----------
        picture : ndarray
            float32 (h, w), luminance; changed in place.
        pose : Pose
            Where the object is.
        """
        window, coverage = self.coverage(pose)
        if not coverage.size:
            return
        part = picture[window.slices]
        part += (self.colours(pose, window) - part) * coverage.astype(np.float32)

    def coverage(self, pose: Pose) -> tuple[Window, Floats]:
        """Return which share of each pixel the object covers.

        Parameters
        ----------
        pose : Pose
            Where the object is.

        Returns
        -------
        Window
            The pixels it touches.
        ndarray
            float64 of the window's shape, 0 to 1.
        """
        return figure_coverage(self.projection, self.thing, pose, self.height, self.width)

    def colours(self, pose: Pose, window: Window) -> Picture | np.float32:  # noqa: ARG002
        """Return the luminance of the object's pixels.

        Parameters
        ----------
        pose : Pose
            Where the object is.
        window : Window
            The pixels wanted.

        Returns
        -------
        ndarray or numpy.float32
            One value for all, or float32 of the window's shape.
        """
        return np.float32(pose.luminance)


class PatchPainter(Painter):
    """Paints a textured disk; the texture grows with it."""

    SIDE = 256

    @cached_property
    def texture(self) -> Texture:
        """One tile spans the disk."""
        random = generator(self.protocol.seed, self.thing.id)
        return Texture(noise_tile(self.SIDE, self.thing.exponent, self.SIDE / 8, random))

    def colours(self, pose: Pose, window: Window) -> Picture:
        """Return the texture, turned and scaled as the disk is."""
        (x, y), (ahead, behind) = middle_of(self.projection, pose)
        size = max(ahead + behind, 1e-9)
        angle = math.radians(pose.orientation_deg)
        u: Floats = (np.arange(window.left + 0.5, window.right)[None, :] - x) / size
        v: Floats = (np.arange(window.top + 0.5, window.bottom)[:, None] - y) / size
        if angle:
            u, v = (
                u * math.cos(angle) - v * math.sin(angle),
                u * math.sin(angle) + v * math.cos(angle),
            )
        return shaded(pose.luminance, self.thing.contrast, self.texture.at(u, v, self.SIDE / size))


def figure_coverage(
    projection: Projection, thing: Object, pose: Pose, height: int, width: int
) -> tuple[Window, Floats]:
    """Return which share of each pixel a figure covers.

    Parameters
    ----------
    projection : Projection
        From degrees to pixels.
    thing : Object
        The figure.
    pose : Pose
        Where it is.
    height, width : int
        The display in pixels.

    Returns
    -------
    Window
        The pixels it touches.
    ndarray
        float64 of the window's shape, 0 to 1.
    """
    if thing.kind in {"disk", "patch", "ring"}:
        (x, y), (ahead, behind) = middle_of(projection, pose)
        window, coverage = disk_coverage(x, y, (ahead + behind) / 2, height, width)
        inner = pose.extent.size / 2 - (thing.width_deg or 0.0)
        if thing.kind == "ring" and inner > 0:
            hole, open_share = disk_coverage(x, y, projection.reach(inner), height, width)
            rows = slice(hole.top - window.top, hole.bottom - window.top)
            columns = slice(hole.left - window.left, hole.right - window.left)
            coverage[rows, columns] -= open_share
        return window, np.maximum(coverage, 0.0)
    return polygon_coverage(corners_of(projection, thing, pose, height, width), height, width)
