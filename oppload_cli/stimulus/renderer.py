"""The renderer: from a protocol to frames of luminance with their ground truth.

A painter puts one object of the protocol, a shape or a pattern, onto the picture.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, reduce
from typing import TYPE_CHECKING

import cv2
import numpy as np

from oppload_cli.errors import StimulusError
from oppload_cli.stimulus.background import Drawn, background_of
from oppload_cli.stimulus.courses import AHEAD, RIGHT, UP
from oppload_cli.stimulus.coverage import PixelWindow, disk_coverage, shape_coverage
from oppload_cli.stimulus.geometry import Pose, Projection, exact
from oppload_cli.stimulus.kinematics import aperture_centre, pose_of
from oppload_cli.stimulus.objects import GRATINGS, PICTURE, Object
from oppload_cli.stimulus.patterns import (
    DotField,
    Tile,
    cutout_of,
    generator,
    noise_tile,
    shaded,
    shadow_of,
    sine_wave,
    square_wave,
)
from oppload_cli.stimulus.protocol import Protocol, check_frame, check_protocol
from oppload_cli.stimulus.staging import CameraView, camera_of, sight_of
from oppload_cli.stimulus.surfaces import Surface
from oppload_cli.stimulus.truth import FrameTruth, frame_truth

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from oppload_cli.stimulus.coverage import Floats, Picture


# The luminance of each grey value, as reading a lossless file gives it.
_LUMINANCE = np.arange(256, dtype=np.float32) / np.float32(255)


@dataclass(frozen=True, eq=False)  # arrays cannot be compared as a whole
class StimulusFrame:
    """One frame of a stimulus.

    Attributes
    ----------
    index : int
        0-based.
    time_s : float
        Seconds from the first frame.
    grey : ndarray
        uint8 (h, w), as a file holds it.
    luma : ndarray
        float32 (h, w), luminance 0 to 1: exactly ``grey / 255``.
    truth : FrameTruth
        The ground truth of the frame.
    """

    index: int
    time_s: float
    grey: NDArray[np.uint8]
    luma: NDArray[np.float32]
    truth: FrameTruth


class Renderer:
    """Draws the frames of a protocol, in any order."""

    def __init__(self, protocol: Protocol) -> None:
        check_protocol(protocol)
        self.protocol = protocol
        self._background = background_of(protocol)
        self._painters = [
            _PAINTERS.get(obj.kind, _Painter)(protocol, obj) for obj in protocol.objects
        ]

    def grey(self, frame: int) -> NDArray[np.uint8]:
        """Return a frame (0-based) as a file holds it.

        Returns
        -------
        ndarray
            uint8 (h, w): luminance times 255, rounded half to even, then compressed where
            the effects say so.
        """
        picture = self.luminance(frame)
        grey = np.asarray(np.clip(np.rint(picture * np.float32(255)), 0, 255), dtype=np.uint8)
        quality = self.protocol.effects.jpeg
        if quality is None:
            return grey
        coded = cv2.imencode(".jpg", grey, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
        return np.asarray(cv2.imdecode(coded, cv2.IMREAD_GRAYSCALE), dtype=np.uint8)

    def flow(self, frame: int) -> NDArray[np.float64]:
        """Return the exact optical flow of drawn surroundings from a frame to the next one.

        Returns
        -------
        ndarray
            float64 (h, w, 2): pixels right and down. NaN for pixels that show no surface, and for
            all pixels if the surroundings change between the two frames (``scene.cut_s``).

        Raises
        ------
        StimulusError
            If the protocol has no drawn surroundings, or if there is no such frame.
        """
        if not isinstance(self._background, Drawn):
            raise StimulusError(
                "the flow is known for drawn surroundings only; set scene.background to one of them"
            )
        check_frame(self.protocol, frame)
        times = [self.protocol.time_of(index) for index in (frame, frame + 1)]
        (surroundings, view), (next_surroundings, later) = map(self._background.seen_at, times)
        if next_surroundings is not surroundings:
            return np.full((*view.projection.shape, 2), np.nan)
        return surroundings.flow(view, later)

    def luminance(self, frame: int) -> NDArray[np.float32]:
        """Return the luminance of a frame (0-based) before it is rounded to 8 bits.

        Returns
        -------
        ndarray
            float32 (h, w), 0 to 1.

        Raises
        ------
        StimulusError
            If there is no such frame.
        """
        check_frame(self.protocol, frame)
        effects = self.protocol.effects
        time = self.protocol.time_of(frame)
        picture = self._blurred(time) if effects.shutter else self._picture(time, time)
        if effects.invert:
            picture = 1 - picture
        if effects.noise:
            random = np.random.default_rng([self.protocol.seed, frame])
            noise = random.standard_normal(picture.shape, dtype=np.float32)
            picture = np.clip(picture + np.float32(effects.noise) * noise, 0.0, 1.0)
        return picture

    def _blurred(self, time: float) -> Picture:
        """Return the mean of pictures from the time while the shutter is open around `time`."""
        effects, rate = self.protocol.effects, float(self.protocol.display.frame_rate)
        count = effects.shutter_samples
        shifts = ((np.arange(count) + 0.5) / count - 0.5) * effects.shutter / rate
        pictures = (self._picture(time + float(shift), time) for shift in shifts)
        return reduce(np.add, pictures) / np.float32(count)

    def _picture(self, time: float, frame_s: float) -> Picture:
        """Draw the scene at a time at which the shutter is open; `frame_s` is that of the frame."""
        picture = self._background.picture(time, frame_s)
        for painter in self._painters:
            painter.paint(picture, time)
        return picture


def frames(protocol: Protocol) -> Iterator[StimulusFrame]:
    """Draw a stimulus, frame by frame.

    Parameters
    ----------
    protocol : Protocol
        The stimulus.

    Yields
    ------
    StimulusFrame
        The picture as grey levels and as luminance, both of shape (height, width), and its ground
        truth. Its luminance equals that of the lossless file that :func:`write` makes.

    Raises
    ------
    StimulusError
        If a picture or a video of the stimulus cannot be read.

    Examples
    --------
    >>> from oppload_cli import stimulus
    >>> protocol = stimulus.load("controls/looming-perspective")
    >>> frame = next(stimulus.frames(protocol))
    >>> frame.luma.shape, round(frame.truth.objects[0].angular_size_deg, 2)
    ((300, 400), 4.58)
    """
    renderer = Renderer(protocol)
    for index in range(protocol.frame_count):
        grey = renderer.grey(index)
        truth = frame_truth(protocol, index)
        yield StimulusFrame(index, truth.time_s, grey, _LUMINANCE[grey], truth)


class _Painter:
    """Paints a shape of one luminance; the base class of the painters of patterns."""

    def __init__(self, protocol: Protocol, obj: Object) -> None:
        self.protocol, self.obj = protocol, obj
        self.projection = Projection.of(protocol.display)
        self.height, self.width = self.projection.shape

    def paint(self, picture: Picture, time: float) -> None:
        """Paint the object as it is at a time, in seconds of the clip, onto a picture."""
        pose = pose_of(self.protocol, self.obj, time)
        if not pose.visible:
            return
        window, coverage = self._coverage(pose)
        if coverage.size:
            part, colours = picture[window.slices], self._colours(pose, window)
            share = coverage.astype(np.float32)
            part += (colours - part) * share
            # In float32, 0.5 + (0.1 - 0.5) is less than 0.1, and becomes another grey level.
            np.copyto(part, colours, where=share == 1)

    def _colours(self, pose: Pose, _window: PixelWindow) -> Picture:
        """Return the luminance of the object's pixels, float32; a shape of one luminance has ()."""
        return np.array(pose.luminance, dtype=np.float32)

    def _coverage(self, pose: Pose) -> tuple[PixelWindow, Floats]:
        """Return the share of each pixel that the object covers."""
        return shape_coverage(self.projection, self.obj, pose)


class _PatchPainter(_Painter):
    """Paints a textured disk. One tile of the texture spans the disk and grows with it."""

    _SIDE = 256

    @cached_property
    def _tile(self) -> Tile:
        random = generator(self.protocol.seed, self.obj.id)
        tile = noise_tile(self._SIDE, self.obj.exponent, self._SIDE / 8, random)
        # The mean and the contrast are those of the disk, not of the square around it. The middle
        # of the disk is the corner of the tile, which repeats.
        offsets = (np.arange(self._SIDE) + 0.5) / self._SIDE
        offsets -= np.round(offsets)
        disk = tile[np.hypot(offsets, offsets[:, None]) < 0.5]
        return Tile((tile - disk.mean()) / disk.std())

    def _colours(self, pose: Pose, window: PixelWindow) -> Picture:
        (x, y), (ahead, behind) = self.projection.middle_of(pose)
        size = max(ahead + behind, 1e-9)
        angle = math.radians(pose.orientation_deg)
        u: Floats = (np.arange(window.left + 0.5, window.right)[None, :] - x) / size
        v: Floats = (np.arange(window.top + 0.5, window.bottom)[:, None] - y) / size
        if angle:
            cosine, sine = math.cos(angle), math.sin(angle)
            u, v = u * cosine - v * sine, u * sine + v * cosine
        return shaded(pose.luminance, self.obj.contrast, self._tile.at(u, v, self._SIDE / size))


class _PatternPainter(_Painter):
    """Paints an even field; the base class of painters that fill the display or an aperture."""

    def _coverage(self, _pose: Pose) -> tuple[PixelWindow, Floats]:
        return self._aperture

    @cached_property
    def _aperture(self) -> tuple[PixelWindow, Floats]:
        size = self.obj.size_deg
        if size is None:
            return PixelWindow(0, self.height, 0, self.width), np.ones((1, 1))
        centre = self.projection.to_px(*aperture_centre(self.protocol, self.obj))
        return disk_coverage(*centre, self.projection.reach(size / 2), self.height, self.width)

    @cached_property
    def _grid_deg(self) -> tuple[Floats, Floats]:
        """The pixels' centres in degrees right and up: (1, w) and (h, 1), or both (h, w)."""
        middle_x, middle_y = self.projection.middle
        x: Floats = (np.arange(0.5, self.width)[None, :] - middle_x) / self.projection.scale
        y: Floats = (middle_y - np.arange(0.5, self.height)[:, None]) / self.projection.scale
        if not self.projection.perspective:
            return x, y
        # The eccentricity of a pixel is the arctangent of its distance from the middle.
        distance = np.radians(np.hypot(x, y))
        ratio = np.where(distance > 0, np.arctan(distance) / np.maximum(distance, 1e-12), 1.0)
        return x * ratio, y * ratio

    def _pattern_grid(self, pose: Pose, window: PixelWindow) -> tuple[Floats, Floats]:
        """Return the pixels' positions on the pattern, in degrees along its axis and across it.

        The arrays are (1, w) and (h, 1) if the axis is 0 degrees and the projection flat.
        """
        x, y = self._grid_deg
        rows, columns = window.slices
        x = x[:, columns] if x.shape[0] == 1 else x[rows, columns]
        y = y[rows] if y.shape[1] == 1 else y[rows, columns]
        x, y = (x - pose.centre_deg[0]) / pose.zoom, (y - pose.centre_deg[1]) / pose.zoom
        angle = math.radians(pose.orientation_deg)
        if angle == 0:
            return x, y
        cosine, sine = math.cos(angle), math.sin(angle)
        return x * cosine + y * sine, y * cosine - x * sine


class _GratingPainter(_PatternPainter):
    """Paints square and sine gratings and plaids."""

    def _colours(self, pose: Pose, window: PixelWindow) -> Picture:
        obj = self.obj
        if obj.kind != "plaid":
            wave = self._wave(pose, window, 0.0)
        else:
            turned = (self._wave(pose, window, sign * obj.plaid_deg / 2) for sign in (-1, 1))
            wave = sum(turned, start=np.zeros(window.shape)) / 2
        luminance = pose.luminance * (1 + obj.contrast * wave)
        return np.broadcast_to(luminance, window.shape).astype(np.float32)

    def _wave(self, pose: Pose, window: PixelWindow, turn_deg: float) -> Floats:
        # A gradient needs neighbours, and a window may be one pixel wide.
        display = PixelWindow(0, self.height, 0, self.width)
        x, y = self._pattern_grid(pose, display if self.projection.perspective else window)
        turn, period = math.radians(turn_deg), self.obj.period_deg or 1.0
        phase = (x * math.cos(turn) + y * math.sin(turn)) / period
        if self.projection.perspective:
            across, down = (np.abs(np.gradient(phase, axis=axis))[window.slices] for axis in (1, 0))
            phase = phase[window.slices]
        else:
            heading = math.radians(pose.orientation_deg) + turn
            pixel = 1 / (self.projection.scale * pose.zoom * period)
            across = np.array(exact(math.cos(heading)) * pixel)
            down = np.array(exact(math.sin(heading)) * pixel)
        wave = square_wave if self.obj.kind == "square-grating" else sine_wave
        if across.size == 1 and not down.any():
            phase = phase[:1]
        elif down.size == 1 and not across.any():
            phase = phase[:, :1]
        return wave(phase + self.obj.phase_deg / 360, across, down)


class _TexturePainter(_PatternPainter):
    """Paints a 1/f texture, whose tile repeats over the display."""

    @cached_property
    def _tile_deg(self) -> float:
        return max(self.height, self.width) / self.projection.scale

    @cached_property
    def _tile(self) -> Tile:
        # At least two samples per pixel, unless the tile would be too large.
        pixels = max(self.height, self.width)
        side = min(2 ** math.ceil(math.log2(2 * pixels)), 2048)
        finest = self.obj.finest_deg or 4 / self.projection.scale
        random = generator(self.protocol.seed, self.obj.id)
        wavelength = max(finest / self._tile_deg * side, 2.0)
        return Tile(noise_tile(side, self.obj.exponent, wavelength, random))

    def _colours(self, pose: Pose, window: PixelWindow) -> Picture:
        x, y = self._pattern_grid(pose, window)
        per_pixel = self._tile.levels[0].shape[0] / self._tile_deg
        per_pixel /= self.projection.scale * pose.zoom
        values = self._tile.at(x / self._tile_deg, -y / self._tile_deg, per_pixel)
        return shaded(pose.luminance, self.obj.contrast, values)


class _DotsPainter(_PatternPainter):
    """Paints random dots on an even ground."""

    @cached_property
    def _dots(self) -> DotField:
        x, y = self._grid_deg
        view = 2 * float(np.hypot(np.abs(x).max(), np.abs(y).max()))
        motion, duration = self.obj.motion, self.protocol.timing.motion_s
        smallest = min(1.0, math.exp(motion.zoom_per_s * duration)) if motion else 1.0
        return DotField(self.obj, self.protocol.seed, view / smallest)

    def _colours(self, pose: Pose, window: PixelWindow) -> Picture:
        places = self._dots.positions(pose)
        x, y = np.transpose([self.projection.to_px(*place) for place in places])
        radius = self.projection.reach((self.obj.dot_deg or 0.0) / 2)
        near = (np.abs(x - self.width / 2) < self.width / 2 + radius) & (
            np.abs(y - self.height / 2) < self.height / 2 + radius
        )
        picture = np.full((self.height, self.width), pose.luminance, dtype=np.float32)
        if near.any():
            part, covered = disk_coverage(x[near], y[near], radius, self.height, self.width)
            picture[part.slices] *= (1 + self.obj.contrast * covered).astype(np.float32)
        return picture[window.slices]


class _PicturePainter:
    """Paints a picture with transparency in exact perspective, and its shadow."""

    def __init__(self, protocol: Protocol, obj: Object) -> None:
        self._protocol, self._obj = protocol, obj
        self._cutout = cutout_of(obj, protocol.seed)
        self._down = -camera_of(protocol).height_m

    def paint(self, picture: Picture, time: float) -> None:
        sight = sight_of(self._protocol, self._obj, time)
        if not sight.visible:
            return
        (right_m, up_m, ahead_m), offset = sight.view.place, sight.offset
        place = right_m + offset[0], up_m + offset[1], ahead_m + offset[2]
        size = self._obj.size_m or 0.0
        wide, high = self._cutout.width * size / 2, self._cutout.height * size / 2
        if self._obj.shadow:
            # A circle that lies on the ground; only its middle part is shown.
            ground, corner = (place[0], self._down, place[2]), (-1.1 * wide, 1.1 * wide)
            extent = -1.1 * wide, -0.4 * wide, 1.1 * wide, 0.4 * wide
            shadow = Surface(ground, RIGHT, AHEAD, shadow_of(), 2.2 * wide, corner, extent)
            self._blend(picture, shadow, sight.view, 0.0, self._obj.shadow)
        texture, extent = self._cutout.texture, (-wide, -high, wide, high)
        upright = Surface(place, RIGHT, UP, texture, 2 * wide, (-wide, high), extent)
        self._blend(picture, upright, sight.view, self._gain, 1.0)

    def _blend(
        self, picture: Picture, surface: Surface, view: CameraView, gain: float, share: float
    ) -> None:
        placed = surface.seen(view)
        if placed is None:
            return
        values = surface.values(placed) * (placed.covered * np.float32(share))[..., None]
        part = picture[placed.window.slices]
        part *= 1 - values[..., 1]
        part += np.minimum(values[..., 0] * np.float32(gain), values[..., 1])

    @cached_property
    def _gain(self) -> float:
        """The factor by which the luminance of the picture is multiplied."""
        relative = self._obj.relative_luminance
        if relative is None:
            return 1.0
        background = background_of(self._protocol).picture(0.0, 0.0)
        return relative * float(background.mean(dtype=np.float64)) / max(self._cutout.mean, 1e-6)


# Every other kind is a shape of one luminance.
_PAINTERS: dict[str, type[_Painter | _PicturePainter]] = {
    "patch": _PatchPainter,
    "field": _PatternPainter,
    **dict.fromkeys(GRATINGS, _GratingPainter),
    "texture": _TexturePainter,
    "dots": _DotsPainter,
    PICTURE: _PicturePainter,
}
