"""The background of a stimulus: an even luminance, drawn surroundings, a video or a still picture.

Drawn surroundings are flat surfaces with random textures that follow from a seed: a sky very far
away, an endless ground, walls, posts and trunks. Haze makes distant surfaces paler.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from oppload_cli.errors import StimulusError, faults_at, nearest, reason_of
from oppload_cli.files.reading import is_file
from oppload_cli.stimulus.courses import AHEAD, RIGHT, UP
from oppload_cli.stimulus.patterns import noise_tile
from oppload_cli.stimulus.protocol_tables import SURROUNDINGS, Display, Scene
from oppload_cli.stimulus.staging import CameraView, camera_of, view_of
from oppload_cli.stimulus.surfaces import Placed, Surface, Texture
from oppload_cli.video.images import read_transparent
from oppload_cli.video.inputs import IMAGE_SUFFIXES, NUMBER
from oppload_cli.video.source import open_video

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from oppload_cli.stimulus.courses import Vector
    from oppload_cli.stimulus.coverage import Floats, Grey, Picture
    from oppload_cli.stimulus.protocol import Protocol

    Footage = tuple[tuple[float, ...], Grey, float]
    Random = np.random.Generator


_MOST_BYTES = 1 << 30  # of a video's decoded pictures in memory
_ROUNDED_S = 0.501e-3  # Matroska rounds the times of pictures to milliseconds
_SIDE = 512  # texels along each side of a texture


def background_of(protocol: Protocol) -> _Constant | Drawn | _Video:
    """Return the background of a protocol.

    Its method `picture` takes a time at which the shutter is open, and the time of the frame, in
    seconds of the clip. It returns a new picture, float32 (h, w), luminance 0 to 1.

    Raises
    ------
    StimulusError
        If its video or picture cannot be read, or does not fit the display.
    """
    scene, display = protocol.scene, protocol.display
    if scene.background is None:
        even = np.full((display.height, display.width), display.background, np.float32)
        return _Constant(even)
    if not scene.has_file:
        return Drawn(protocol)
    path = Path(scene.background)
    # A pattern of image names, such as frame_%03d.png, is a video.
    if path.suffix.lower() in IMAGE_SUFFIXES and is_file(path):
        return _Constant(_still_picture(scene, display))
    return _Video(protocol)


class _Constant:
    """A picture that is the same in all frames."""

    def __init__(self, picture: Picture) -> None:
        self._picture = picture

    def picture(self, _time: float, _frame_s: float) -> Picture:
        return self._picture.copy()


class Drawn:
    """Surroundings drawn by the package."""

    def __init__(self, protocol: Protocol) -> None:
        self._protocol = protocol
        self._last: tuple[object, Picture] | None = None

    def seen_at(self, time: float) -> tuple[_Surroundings, CameraView]:
        """Return the surroundings and the view of the camera at a time."""
        protocol = self._protocol
        cut = protocol.scene.cut_s
        # The seed after a cut is far away, so that no other protocol is likely to use it.
        seed = protocol.seed + (1_000_003 if cut is not None and time >= cut else 0)
        kind = str(protocol.scene.background)
        return _surroundings(kind, seed, camera_of(protocol).height_m), view_of(protocol, time)

    def picture(self, time: float, _frame_s: float) -> Picture:
        """Return a new picture; while the camera rests, the surroundings are drawn only once."""
        surroundings, view = seen = self.seen_at(time)
        if self._last is None or self._last[0] != seen:
            self._last = seen, surroundings.picture(view)
        return self._last[1].copy()


def _still_picture(scene: Scene, display: Display) -> Picture:
    where = f"scene: background = '{scene.background}'"
    for key in ("background_start_s", "background_end", "background_rate"):
        if getattr(scene, key) is not None:
            raise StimulusError(f"{where} is a still picture; {key} goes with a video")
    with faults_at(where, StimulusError):
        luma, opacity = read_transparent(str(scene.background))
        if opacity is not None:
            luma = display.background + (luma - display.background) * opacity
        rows, columns = luma.shape
        _check_size(columns, rows, scene, display)
    grey = _covering(luma, display.width, display.height)
    return np.asarray(grey.astype(np.float32) / np.float32(255))


class _Video:
    """A video; the stimulus shows each of its pictures until the time of the next one."""

    def __init__(self, protocol: Protocol) -> None:
        scene = protocol.scene
        self._first = scene.background_start_s or 0.0
        where = f"scene: background = '{scene.background}'"
        end_s = self._first + protocol.timing.total_s
        path = Path(str(scene.background))
        try:
            # A pattern of image names is no file; its folder changes with its images.
            changed = (path.parent if NUMBER.search(path.name) else path).stat().st_mtime_ns
            with faults_at(where, StimulusError):
                footage = _footage(scene, protocol.display, end_s, changed)
        except OSError as error:
            near = nearest(path.name, SURROUNDINGS)
            hint = f"did you mean '{near}'?" if near else "check the path"
            raise StimulusError(f"{where}: cannot be read ({reason_of(error)}); {hint}") from None
        self._times, self._pictures, self._end = footage
        last_s = protocol.time_of(protocol.frame_count - 1) + self._first
        if scene.background_end != "loop" and last_s >= self._end:
            raise StimulusError(
                f"{where} ends at {self._end:.3g} s, before the last frame, which shows the video "
                f"at {last_s:.3g} s; shorten timing, or write background_end = 'loop'"
            )

    def picture(self, _time: float, frame_s: float) -> Picture:
        # The video has its own motion blur: it shows one picture while the shutter is open.
        video_s = math.fmod(frame_s + self._first + _ROUNDED_S, self._end)
        index = int(np.searchsorted(self._times, video_s, side="right")) - 1
        return np.asarray(self._pictures[index].astype(np.float32) / np.float32(255))


@lru_cache(maxsize=2)
def _footage(scene: Scene, display: Display, until_s: float, changed: int) -> Footage:  # noqa: ARG001
    """Read the video of a scene up to the time `until_s`.

    Returns the times of its pictures, the pictures in grey, and the end of the last picture.
    `changed` is the time at which the file was changed: a changed file is read again.
    """
    path, width, height = str(scene.background), display.width, display.height
    times: list[float] = []
    pictures: list[Grey] = []
    with open_video(path, height=None) as probe:
        rate, native = probe.facts.frame_rate, probe.working
    _check_size(native.width, native.height, scene, display)
    same_rate = rate is not None and abs(rate / display.frame_rate - 1) <= 1e-3
    if scene.background_rate != "own" and not same_rate:
        native_rate = "no constant rate" if rate is None else f"{float(rate):g} frames/s"
        raise StimulusError(
            f"it has {native_rate} and the display {float(display.frame_rate):g}; change "
            "display.frame_rate, or write background_rate = 'own'"
        )
    working_height = max(height, math.ceil(width * native.height / native.width))
    with open_video(path, height=working_height) as video:
        for frame in video:
            times.append(frame.time_s)
            pictures.append(_covering(frame.luma, width, height))
            if frame.time_s > until_s:
                break
            if len(pictures) * width * height > _MOST_BYTES:
                raise StimulusError("it does not fit into memory; shorten timing")
    if not times:
        raise StimulusError("it has no frame that can be read; give another video")
    last_s, steps = times[-1], len(times) - 1  # the first time is 0
    if rate and abs(last_s - steps / rate) <= 2 * _ROUNDED_S:  # the times are even, but rounded
        end_s = len(times) / float(rate)
    else:
        end_s = last_s + (last_s / steps if steps else 1 / 30)
    return tuple(times), np.stack(pictures), end_s


def _check_size(width: int, height: int, scene: Scene, display: Display) -> None:
    """Refuse pictures of another size than the display, unless they may be scaled."""
    if scene.background_fit != "cover" and (width, height) != (display.width, display.height):
        raise StimulusError(
            f"its pictures are {width} x {height} px and the display has {display.width} x "
            f"{display.height}; change display.width and display.height, or write "
            "background_fit = 'cover'"
        )


def _covering(luma: Picture, width: int, height: int) -> Grey:
    """Scale a picture until it covers the display, and return the part in its middle."""
    scale = max(width / luma.shape[1], height / luma.shape[0])
    if abs(scale - 1) > 1e-9:
        size = max(width, round(luma.shape[1] * scale)), max(height, round(luma.shape[0] * scale))
        method = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
        luma = np.asarray(cv2.resize(luma, size, interpolation=method), np.float32)
    top, left = (luma.shape[0] - height) // 2, (luma.shape[1] - width) // 2
    part = luma[top : top + height, left : left + width]
    return np.asarray(np.rint(part * np.float32(255)), np.uint8)


@dataclass(frozen=True)
class _Surroundings:
    surfaces: Sequence[Surface]  # in the order in which they are drawn
    haze: float  # luminance of the haze, and of pixels that show no surface

    def picture(self, view: CameraView) -> Picture:
        """Return the surroundings as a camera sees them, float32 (h, w), luminance 0 to 1."""
        picture = np.full(view.projection.shape, self.haze, np.float32)
        for surface, placed in self._seen_surfaces(view):
            colours = surface.values(placed)
            if surface.clear_m:
                clear = np.exp(-placed.depth / surface.clear_m).astype(np.float32)
                colours = self.haze + (colours - np.float32(self.haze)) * clear
            part = picture[placed.window.slices]
            part += (colours - part) * placed.covered
        return np.clip(picture, 0, 1)

    def flow(self, view: CameraView, later: CameraView) -> Floats:
        """Return the exact optical flow from one view to another.

        Returns
        -------
        ndarray
            float64 (h, w, 2): displacement of the content of each pixel, right and down, in pixels.
            NaN if the pixel shows no surface, or if its content comes to lie behind the camera.
        """
        height, width = view.projection.shape
        x = np.arange(width)[None, :] + 0.5
        y = np.arange(height)[:, None] + 0.5
        moved = np.full((height, width, 2), np.nan)
        for surface, placed in self._seen_surfaces(view):
            to_x, to_y = surface.to_px(later, placed.u, placed.v)
            rows, columns = placed.window.slices
            flow = np.stack([to_x - x[:, columns], to_y - y[rows]], axis=-1)
            shown = placed.covered >= 0.5
            moved[rows, columns][shown] = flow[shown]
        return moved

    def _seen_surfaces(self, view: CameraView) -> Iterator[tuple[Surface, Placed]]:
        """Yield each surface that is seen, with its points."""
        for surface in self.surfaces:
            placed = surface.seen(view)
            if placed is not None:
                yield surface, placed


@lru_cache(maxsize=8)
def _surroundings(kind: str, seed: int, camera_m: float) -> _Surroundings:
    """Return drawn surroundings; `camera_m` is the height of the camera above the ground."""
    random = np.random.default_rng([seed, *kind.encode()])
    return _KINDS[kind](random, -camera_m)


# ---- Textures and surfaces -----------------------------------------------------------------


def _noise(random: Random, exponent: float = 1.0) -> Picture:
    return noise_tile(_SIDE, exponent, 3.0, random)


def _repeated(values: Picture) -> Texture:
    return Texture(np.clip(values, 0, 1).astype(np.float32), repeats=True)


def _backdrop(values: Picture, wide_m: float) -> list[Surface]:
    """Return a picture very far away, ahead and on both sides; it repeats every `wide_m` metres."""
    texture, far = _repeated(values), 4000.0
    corner, extent = (0.0, wide_m / 2), (-far, -far, far, far)
    sides = [((0.0, 0.0, far), RIGHT), ((-far, 0.0, 0.0), AHEAD), ((far, 0.0, 0.0), AHEAD)]
    return [Surface(point, along, UP, texture, wide_m, corner, extent) for point, along in sides]


def _level(values: Picture, up: float, tile_m: float, clear_m: float) -> Surface:
    """Return an endless ground or ceiling, `up` metres above the camera.

    The middle column of its repeating texture lies straight ahead.
    """
    texture, corner = _repeated(values), (-tile_m / 2, 0.0)
    return Surface((0, up, 0), RIGHT, AHEAD, texture, tile_m, corner, clear_m=clear_m)


def _wall(values: Picture, at: Vector, along: Vector, size: tuple[float, float, float]) -> Surface:
    """Return an upright wall.

    `at` is its lower corner, `along` its direction, `size` its length, its height and the side of
    its texture, in metres.
    """
    long, high, tile_m = size
    extent = (0.0, 0.0, long, high)
    texture, corner = _repeated(values), (0.0, high)
    # Haze hides 63 % of a wall at a distance of 80 m.
    return Surface(at, along, UP, texture, tile_m, corner, extent, 80.0)


def _sky(random: Random, horizon: float = 0.8) -> Picture:
    """Return clouds over low hills."""
    clouds = np.clip(0.72 + 0.12 * _noise(random, 1.4), 0.45, 1)
    rise = (np.arange(_SIDE)[::-1, None] - _SIDE / 2) / _SIDE
    hills = 0.012 * (1.2 + _noise(random, 1.5)[0][None, :])
    sky = horizon + (clouds - horizon) * np.clip(rise / 0.1, 0, 1)
    return np.where(rise < hills, 0.45, sky).astype(np.float32)


# ---- Kinds of surroundings -----------------------------------------------------------------


def _plane(random: Random, down: float) -> _Surroundings:
    ground = 0.45 * (1 + 0.35 * _noise(random, 1.0))
    return _Surroundings([_level(ground, down, 8.0, 0.0)], 0.8)


def _facade(random: Random) -> Picture:
    """Return a plastered wall with four rows of four windows."""
    wall = 0.4 * (1 + 0.1 * _noise(random)) * random.uniform(0.8, 1.4)
    cell = _SIDE // 4
    for row in range(4):
        for column in range(4):
            top, left = row * cell + cell // 5, column * cell + cell // 4
            high, wide = int(cell * random.uniform(0.4, 0.6)), cell // 2
            pane = wall[top : top + high, left : left + wide]
            wall[top - 4 : top + high + 4, left - 4 : left + wide + 4] = random.uniform(0.5, 0.8)
            pane[:] = random.uniform(0.08, 0.35)
            pane[high // 2 - 1 : high // 2 + 2] = 0.6
    return wall


def _street(random: Random, down: float) -> _Surroundings:
    """Return a road of 7 m between pavements, houses and posts."""
    tile = 16.0
    metres = tile / _SIDE
    road = 0.32 * (1 + 0.16 * _noise(random, 0.7))
    x = np.abs((np.arange(_SIDE) + 0.5) * metres - tile / 2)
    dash = (np.arange(_SIDE) + 0.5) * metres % 8 < 3
    road[:, x > 3.7] = 0.5 * (1 + 0.12 * _noise(random))[:, x > 3.7]
    road[:, np.abs(x - 3.5) < 0.1] = 0.85
    road[np.ix_(dash, x < 0.08)] = 0.85
    surfaces = [*_backdrop(_sky(random), 6000), _level(road, down, tile, 90)]
    houses = [_facade(random) for _ in range(4)]
    for side in (-1.0, 1.0):
        for number in range(7):
            high = float(random.uniform(7, 14))
            foot = (side * 7.5, down, 16.0 * (number - 1))
            values = houses[int(random.integers(len(houses)))]
            surfaces.append(_wall(values, foot, AHEAD, (16.0, high, 14.0)))
    posts = [(side * 4.6, float(ahead)) for ahead in range(4, 88, 12) for side in (-1, 1)]
    iron = 0.2 * (1 + 0.2 * _noise(random))
    for right, ahead in sorted(posts, key=lambda post: -post[1]):
        surfaces.append(_wall(iron, (right - 0.08, down, ahead), RIGHT, (0.16, 4.5, 4.0)))
    return _Surroundings(surfaces, 0.75)


def _forest(random: Random, down: float) -> _Surroundings:
    """Return leaves on the ground, trunks, and foliage behind them."""
    leaves = 0.3 * (1 + 0.5 * _noise(random, 0.8))
    foliage = 0.38 * (1 + 0.55 * _noise(random, 0.9))
    surfaces = [*_backdrop(foliage, 3000), _level(leaves, down, 6.0, 60)]
    bark = [0.2 * (1 + 0.45 * _noise(random, 0.6)) for _ in range(3)]
    trunks = [
        (side * random.uniform(2.2, 16), random.uniform(3, 70), random.uniform(0.2, 0.6))
        for _ in range(30)
        for side in (-1, 1)
    ]
    for right, ahead, wide in sorted(trunks, key=lambda trunk: -trunk[1]):
        values = bark[int(random.integers(3))] * random.uniform(0.7, 1.6)
        foot = (right - wide / 2, down, ahead)
        surfaces.append(_wall(values, foot, RIGHT, (wide, 14.0, 2.0)))
    return _Surroundings(surfaces, 0.45)


def _room(random: Random, down: float) -> _Surroundings:
    """Return a hall of 6 m by 2.8 m, 18 m long."""
    planks = 0.42 * (1 + 0.14 * _noise(random, 0.8))
    planks[:, :: _SIDE // 16] *= 0.55
    planks[:: _SIDE // 4] *= 0.7
    ceiling = 0.8 * (1 + 0.03 * _noise(random))
    ceiling[:: _SIDE // 4] = ceiling[:, :: _SIDE // 4] = 0.6
    surfaces = [_level(planks, down, 4.0, 0.0), _level(ceiling, down + 2.8, 4.0, 0.0)]
    far = 18.0
    for at, along, long in (
        ((-3.0, down, -6.0), AHEAD, far + 6),
        ((3.0, down, -6.0), AHEAD, far + 6),
        ((-3.0, down, far), RIGHT, 6.0),
    ):
        wall = 0.62 * (1 + 0.05 * _noise(random))
        for _ in range(5):  # frames, shelves, doors
            y, x = random.integers(40, 300), random.integers(0, 400)
            high, wide = random.integers(60, 180), random.integers(50, 110)
            wall[y : y + high, x : x + wide] = random.uniform(0.15, 0.9)
            inner = wall[y + 6 : y + high - 6, x + 6 : x + wide - 6]
            inner[:] = (0.45 * (1 + 0.5 * _noise(random, 1.2)))[: inner.shape[0], : inner.shape[1]]
        surfaces.append(_wall(wall, at, along, (long, 2.8, 5.0)))
    return _Surroundings(surfaces, 0.6)


def _open_sky(random: Random, down: float) -> _Surroundings:
    """Return clouds above fields."""
    fields = 0.4 * (1 + 0.3 * _noise(random, 1.2))
    for _ in range(24):
        y, x = random.integers(0, _SIDE, 2)
        high, wide = random.integers(40, 160, 2)
        fields[y : y + high, x : x + wide] *= random.uniform(0.6, 1.5)
    surfaces = [*_backdrop(_sky(random, 0.85), 5000), _level(fields, down, 60.0, 500)]
    return _Surroundings(surfaces, 0.8)


_KINDS: dict[str, Callable[[Random, float], _Surroundings]] = {
    "plane": _plane,
    "street": _street,
    "forest": _forest,
    "room": _room,
    "sky": _open_sky,
}
