"""Painters of patterns, which fill the display or a round aperture."""

from __future__ import annotations

import math
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from oppload_cli.stimulus.coverage import Window, disk_coverage
from oppload_cli.stimulus.dots import DotField
from oppload_cli.stimulus.figures import Painter
from oppload_cli.stimulus.geometry import WIDEST_DEG
from oppload_cli.stimulus.gratings import sine_wave, square_wave
from oppload_cli.stimulus.texture import LARGEST_TILE, Texture, generator, noise_tile, shaded

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from oppload_cli.stimulus.kinematics import Pose

    Floats = NDArray[np.float64]
    Picture = NDArray[np.float32]


class PatternPainter(Painter):
    """Base of what covers the display, or a round aperture of it."""

    def coverage(self, pose: Pose) -> tuple[Window, Floats]:  # noqa: ARG002
        """Return the aperture, or the whole display."""
        size = self.thing.size_deg
        if size is None:
            return Window(0, self.height, 0, self.width), np.ones((1, 1))
        shift = self.protocol.scene.centre_deg
        x, y = (a + b for a, b in zip(self.thing.centre_deg, shift, strict=True))
        centre = self.projection.to_px(x, y)
        return disk_coverage(*centre, self.projection.reach(size / 2), self.height, self.width)

    @cached_property
    def grid_deg(self) -> tuple[Floats, Floats]:
        """Degrees right and up of the pixels' centres: (1, w) and (h, 1), or both (h, w)."""
        middle_x, middle_y = self.projection.middle
        x: Floats = (np.arange(0.5, self.width)[None, :] - middle_x) / self.projection.scale
        y: Floats = (middle_y - np.arange(0.5, self.height)[:, None]) / self.projection.scale
        if not self.projection.perspective:
            return x, y
        # the eccentricity of a pixel is the arctangent of its distance from the middle
        distance = np.radians(np.hypot(x, y))
        ratio = np.where(distance > 0, np.arctan(distance) / np.maximum(distance, 1e-12), 1.0)
        return x * ratio, y * ratio

    def pattern_grid(self, pose: Pose, window: Window) -> tuple[Floats, Floats]:
        """Return the pattern's own coordinates of the pixels, in degrees.

        Parameters
        ----------
        pose : Pose
            Of the pattern.
        window : Window
            The pixels wanted.

        Returns
        -------
        tuple of ndarray
            Along the axis and across it; (1, w) and (h, 1) where nothing turns.
        """
        x, y = self.grid_deg
        rows, columns = window.slices
        x = x[:, columns] if x.shape[0] == 1 else x[rows, columns]
        y = y[rows] if y.shape[1] == 1 else y[rows, columns]
        x, y = (x - pose.centre_deg[0]) / pose.zoom, (y - pose.centre_deg[1]) / pose.zoom
        angle = math.radians(pose.orientation_deg)
        if angle == 0:
            return x, y
        cosine, sine = math.cos(angle), math.sin(angle)
        return x * cosine + y * sine, y * cosine - x * sine


class GratingPainter(PatternPainter):
    """Paints square and sine gratings and plaids."""

    def colours(self, pose: Pose, window: Window) -> Picture:
        """Return the mean luminance times 1 plus the contrast times the wave."""
        thing = self.thing
        if thing.kind != "plaid":
            wave = self._wave(pose, window, 0.0)
        else:
            turned = (self._wave(pose, window, sign * thing.plaid_deg / 2) for sign in (-1, 1))
            wave = sum(turned, start=np.zeros(window.shape)) / 2
        luminance = pose.luminance * (1 + thing.contrast * wave)
        return np.broadcast_to(luminance, window.shape).astype(np.float32)

    def _wave(self, pose: Pose, window: Window, turn_deg: float) -> Floats:
        x, y = self.pattern_grid(pose, window)
        turn, period = math.radians(turn_deg), self.thing.period_deg or 1.0
        phase = (x * math.cos(turn) + y * math.sin(turn)) / period
        if self.projection.perspective:
            across, down = np.abs(np.gradient(phase, axis=1)), np.abs(np.gradient(phase, axis=0))
        else:
            heading = math.radians(pose.orientation_deg) + turn
            pixel = 1 / (self.projection.scale * pose.zoom * period)
            across = np.array(_clean(math.cos(heading)) * pixel)
            down = np.array(_clean(math.sin(heading)) * pixel)
        wave = square_wave if self.thing.kind == "square-grating" else sine_wave
        if across.size == 1 and not down.any():
            phase = phase[:1]
        elif down.size == 1 and not across.any():
            phase = phase[:, :1]
        return wave(phase + self.thing.phase_deg / 360, across, down)


class TexturePainter(PatternPainter):
    """Paints a 1/f texture over the display."""

    @cached_property
    def tile_deg(self) -> float:
        """Side of the tile that repeats."""
        return max(self.height, self.width) / self.projection.scale

    @cached_property
    def texture(self) -> Texture:
        """The texture, at least two samples to a pixel where the tile is not too large."""
        pixels = max(self.height, self.width)
        side = min(2 ** math.ceil(math.log2(2 * pixels)), LARGEST_TILE)
        finest = self.thing.finest_deg or 4 / self.projection.scale
        random = generator(self.protocol.seed, self.thing.id)
        wavelength = max(finest / self.tile_deg * side, 2.0)
        return Texture(noise_tile(side, self.thing.exponent, wavelength, random))

    def colours(self, pose: Pose, window: Window) -> Picture:
        """Return the mean luminance times 1 plus the contrast times the texture."""
        x, y = self.pattern_grid(pose, window)
        per_pixel = self.texture.levels[0].shape[0] / self.tile_deg
        per_pixel /= self.projection.scale * pose.zoom
        values = self.texture.at(x / self.tile_deg, -y / self.tile_deg, per_pixel)
        return shaded(pose.luminance, self.thing.contrast, values)


class DotsPainter(PatternPainter):
    """Paints random dots on an even ground."""

    @cached_property
    def dots(self) -> DotField:
        """The dots of the whole clip."""
        x, y = self.grid_deg
        view = 2 * float(np.hypot(np.abs(x).max(), np.abs(y).max()))
        motion = self.thing.motion
        lasts = self.protocol.timing.motion_s
        smallest = min(1.0, math.exp(motion.zoom_per_s * lasts)) if motion else 1.0
        return DotField(self.thing, self.protocol.seed, view / smallest)

    def colours(self, pose: Pose, window: Window) -> Picture:
        """Return the ground, with the dots on it."""
        places = self.dots.positions(pose)
        x, y = self._to_px(places)
        radius = self.projection.reach((self.thing.dot_deg or 0.0) / 2)
        near = (np.abs(x - self.width / 2) < self.width / 2 + radius) & (
            np.abs(y - self.height / 2) < self.height / 2 + radius
        )
        picture = np.full((self.height, self.width), pose.luminance, dtype=np.float32)
        if near.any():
            part, covered = disk_coverage(x[near], y[near], radius, self.height, self.width)
            picture[part.slices] *= (1 + self.thing.contrast * covered).astype(np.float32)
        return picture[window.slices]

    def _to_px(self, places: Floats) -> tuple[Floats, Floats]:
        scale = np.full(len(places), self.projection.scale)
        if self.projection.perspective:
            away = np.minimum(np.hypot(places[:, 0], places[:, 1]), WIDEST_DEG)
            scale = self.projection.eye_px * np.tan(np.radians(away)) / np.maximum(away, 1e-12)
        middle_x, middle_y = self.projection.middle
        return middle_x + scale * places[:, 0], middle_y - scale * places[:, 1]


def _clean(value: float) -> float:
    """Make the cosine of 90 degrees 0."""
    return 0.0 if abs(value) < 1e-12 else value
