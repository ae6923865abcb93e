"""The ground behind the objects: an even luminance, drawn surroundings, a video or a still picture.

Drawn surroundings are flat surfaces with random textures, drawn back to front; all of it follows
from a seed. A surface is far (the sky), endless (the ground), or ends (a wall, a post, a trunk);
what lies further away is paler, as in haze.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, Protocol

import cv2
import numpy as np

from oppload_cli.errors import OpploadError, StimulusError
from oppload_cli.stimulus.patterns import noise_tile
from oppload_cli.stimulus.staging import camera_of, view_of
from oppload_cli.stimulus.surfaces import Placed, Surface, Texture
from oppload_cli.video.images import read_transparent
from oppload_cli.video.inputs import IMAGE_SUFFIXES
from oppload_cli.video.source import open_video

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from fractions import Fraction

    from numpy.typing import NDArray

    from oppload_cli.stimulus import protocol as protocols
    from oppload_cli.stimulus.courses import Vector
    from oppload_cli.stimulus.staging import View

    Picture = NDArray[np.float32]
    Footage = tuple[tuple[float, ...], NDArray[np.uint8], float]
    Floats = NDArray[np.float64]
    Random = np.random.Generator


_MOST_BYTES = 1 << 30  # of a video's part that is used
_SIDE = 512  # texels of a texture
_RIGHT, _UP, _AHEAD = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
_BACKDROP_M = 4000.0
_CLEAR_M = 80.0  # haze takes most of a wall that far away


class _Background(Protocol):
    """The ground behind the objects."""

    def look(self, time: float, frame_s: float) -> object:
        """Return all that the picture depends on."""

    def picture(self, time: float, frame_s: float) -> Picture:
        """Return a new picture, float32 (h, w), luminance 0 to 1.

        Parameters
        ----------
        time : float
            Seconds of the clip.
        frame_s : float
            The time of the frame to which `time`, in its open shutter, belongs.
        """


def background_of(protocol: protocols.Protocol) -> _Background:
    """Return the background of a protocol.

    Raises
    ------
    StimulusError
        If its video or picture cannot be read, or does not fit the display.
    """
    if protocol.scene.background is None:
        return _Even(protocol)
    if not protocol.scene.has_file:
        return Drawn(protocol)
    path = Path(protocol.scene.background)
    # Of a pattern such as frame_%03d.png there is no such file.
    still = path.suffix.lower() in IMAGE_SUFFIXES and path.is_file()
    return _Still(protocol) if still else _Video(protocol)


class _Even:
    """An even luminance."""

    def __init__(self, protocol: protocols.Protocol) -> None:
        display = protocol.display
        self._shape, self._luminance = (display.height, display.width), display.background

    def look(self, _time: float, _frame_s: float) -> object:
        return None

    def picture(self, _time: float, _frame_s: float) -> Picture:
        return np.full(self._shape, self._luminance, dtype=np.float32)


class Drawn:
    """Surroundings drawn by the package."""

    def __init__(self, protocol: protocols.Protocol) -> None:
        self._protocol = protocol
        self._shape = protocol.display.height, protocol.display.width
        self._last: tuple[object, Picture] | None = None

    def at(self, time: float) -> tuple[_Surroundings, View]:
        """Return the surroundings and the camera at a time."""
        protocol = self._protocol
        cut = protocol.scene.cut_s
        # a second place, which no protocol with a nearby seed has as its first
        seed = protocol.seed + (1_000_003 if cut is not None and time >= cut else 0)
        kind = str(protocol.scene.background)
        return _surroundings(kind, seed, camera_of(protocol).height_m), view_of(protocol, time)

    def look(self, time: float, _frame_s: float) -> object:
        """Return all that the picture depends on."""
        cut = self._protocol.scene.cut_s
        return view_of(self._protocol, time), cut is not None and time >= cut

    def picture(self, time: float, frame_s: float) -> Picture:
        """Return a new picture, float32 (h, w), luminance 0 to 1."""
        look = self.look(time, frame_s)
        if self._last is None or self._last[0] != look:
            place, view = self.at(time)
            self._last = look, place.picture(view, *self._shape)
        return self._last[1].copy()


class _Still:
    """A picture that is the same in all frames."""

    def __init__(self, protocol: protocols.Protocol) -> None:
        scene, display = protocol.scene, protocol.display
        where = f"scene: background = '{scene.background}'"
        for key in ("background_start_s", "background_end", "background_rate"):
            if getattr(scene, key) is not None:
                raise StimulusError(f"{where} is a still picture; {key} goes with a video")
        try:
            luma, opacity = read_transparent(str(scene.background))
            if opacity is not None:
                luma = display.background + (luma - display.background) * opacity
            rows, columns = luma.shape
            _check_size((columns, rows), (display.width, display.height), scene.background_fit)
        except OpploadError as problem:
            raise StimulusError(f"{where}: {problem}") from None
        grey = _covering(luma, display.width, display.height)
        self._picture = grey.astype(np.float32) / np.float32(255)

    def look(self, _time: float, _frame_s: float) -> object:
        return None

    def picture(self, _time: float, _frame_s: float) -> Picture:
        return self._picture.copy()


class _Video:
    """A video, each picture of which is shown from its time on."""

    def __init__(self, protocol: protocols.Protocol) -> None:
        self._scene, display = protocol.scene, protocol.display
        self._first = self._scene.background_start_s or 0.0
        path, fit = str(self._scene.background), self._scene.background_fit or "exact"
        self._where = f"scene: background = '{path}'"
        last = self._first + protocol.timing.total_s
        try:
            stamp = Path(path).stat().st_mtime_ns
            rate = display.frame_rate if self._scene.background_rate != "own" else None
            size = display.width, display.height
            wanted = _Wanted(path, size, fit, rate, last)
            self._times, self._pictures, self._end = _footage(wanted, stamp)
        except (OpploadError, OSError) as problem:
            raise StimulusError(f"{self._where}: {problem}") from None
        shown = protocol.time_of(protocol.frame_count - 1) + self._first
        if self._scene.background_end != "loop" and shown >= self._end:
            raise StimulusError(
                f"{self._where} ends at {self._end:.3g} s, before the last frame, which shows "
                f"{shown:.3g} s of it; shorten timing, or write background_end = 'loop'"
            )

    def look(self, _time: float, frame_s: float) -> object:
        return self._index(frame_s)

    def picture(self, _time: float, frame_s: float) -> Picture:
        # the video's own camera has blurred its motion: all times of a frame show one picture
        picture = self._pictures[self._index(frame_s)].astype(np.float32)
        return np.asarray(picture / np.float32(255))

    def _index(self, time: float) -> int:
        shown = math.fmod(time + self._first, self._end) + 1e-6
        return max(int(np.searchsorted(self._times, shown, side="right")) - 1, 0)


class _Wanted(NamedTuple):
    """A part of a video: up to a time, as it fits a display."""

    path: str
    size: tuple[int, int]
    fit: str
    rate: Fraction | None
    last_s: float


@lru_cache(maxsize=2)
def _footage(wanted: _Wanted, stamp: int) -> Footage:  # noqa: ARG001 - it tells of changes
    """Read a video up to a time.

    Returns the times of its pictures, the pictures in grey, and where the last one ends.
    """
    path, (width, height), rate = wanted.path, wanted.size, wanted.rate
    times: list[float] = []
    pictures: list[NDArray[np.uint8]] = []
    with open_video(path, height=None) as probe:
        facts, native = probe.facts, probe.working
    _check_size((native.width, native.height), wanted.size, wanted.fit)
    found = facts.frame_rate
    if rate is not None and (found is None or abs(found / rate - 1) > 1e-3):
        said = "no constant rate" if found is None else f"{float(found):g} frames/s"
        raise StimulusError(
            f"it has {said} and the display {float(rate):g}; change display.frame_rate, or write "
            "background_rate = 'own'"
        )
    tall = max(height, math.ceil(width * native.height / native.width))
    with open_video(path, height=tall) as video:
        for frame in video:
            times.append(frame.time_s)
            pictures.append(_covering(frame.luma, width, height))
            if frame.time_s > wanted.last_s:
                break
            if len(pictures) * width * height > _MOST_BYTES:
                raise StimulusError("it is too large to be kept; shorten timing")
    if not times:
        raise StimulusError("it has no frame that can be read; give another video")
    step = (times[-1] - times[0]) / (len(times) - 1) if len(times) > 1 else 1 / float(found or 30)
    return tuple(times), np.stack(pictures), times[-1] + step


def _check_size(size: tuple[int, int], display: tuple[int, int], fit: str | None) -> None:
    """Raise StimulusError for pictures of another size than the display, unless they cover it."""
    if fit != "cover" and size != display:
        raise StimulusError(
            f"its pictures are {size[0]} x {size[1]} px and the display has {display[0]} x "
            f"{display[1]}; change display.width and display.height, or write "
            "background_fit = 'cover'"
        )


def _covering(luma: Picture, width: int, height: int) -> NDArray[np.uint8]:
    """Scale a picture so that it covers the display, and cut its middle out."""
    scale = max(width / luma.shape[1], height / luma.shape[0])
    if abs(scale - 1) > 1e-9:
        size = max(width, round(luma.shape[1] * scale)), max(height, round(luma.shape[0] * scale))
        way = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
        luma = np.asarray(cv2.resize(luma, size, interpolation=way), np.float32)
    top, left = (luma.shape[0] - height) // 2, (luma.shape[1] - width) // 2
    part = luma[top : top + height, left : left + width]
    return np.asarray(np.rint(part * np.float32(255)), np.uint8)


class _Piece(NamedTuple):
    """A surface, and the distance in metres over which haze takes most of it (0: no haze)."""

    surface: Surface
    clear_m: float


@dataclass(frozen=True)
class _Surroundings:
    """A place, drawn back to front.

    Attributes
    ----------
    pieces : tuple of _Piece
        Surfaces of the place.
    haze : float
        Luminance of the haze, and of all that is too far away.
    """

    pieces: tuple[_Piece, ...]
    haze: float

    def picture(self, view: View, height: int, width: int) -> Picture:
        """Return the place as a camera sees it, float32 (h, w), luminance 0 to 1."""
        picture = np.full((height, width), self.haze, np.float32)
        for piece, placed, covered in self._seen(view, height, width):
            colours = piece.surface.values(placed)
            if piece.clear_m:
                clear = np.exp(-placed.depth / piece.clear_m).astype(np.float32)
                colours = self.haze + (colours - np.float32(self.haze)) * clear
            part = picture[placed.window.slices]
            part += (colours - part) * covered
        return np.clip(picture, 0, 1)

    def flow(self, view: View, later: View, height: int, width: int) -> Floats:
        """Return the exact optical flow from one view to another.

        Parameters
        ----------
        view, later : View
            The camera at the two times.
        height, width : int
            The display in pixels.

        Returns
        -------
        ndarray
            float64 (h, w, 2): displacement of the content of each pixel, right and down, in pixels;
            NaN where nothing is drawn, or where the content leaves the space before the camera.
        """
        x = np.arange(width)[None, :] + 0.5
        y = np.arange(height)[:, None] + 0.5
        moved = np.full((height, width, 2), np.nan)
        for piece, placed, covered in self._seen(view, height, width):
            to_x, to_y = piece.surface.to_px(later, placed.u, placed.v)
            rows, columns = placed.window.slices
            flow = np.stack([to_x - x[:, columns], to_y - y[rows]], axis=-1)
            moved[rows, columns][covered >= 0.5] = flow[covered >= 0.5]
        return moved

    def _seen(
        self, view: View, height: int, width: int
    ) -> Iterator[tuple[_Piece, Placed, Picture]]:
        """Yield the surfaces on the display, with their places and their share of each pixel."""
        for piece in self.pieces:
            seen = piece.surface.seen(view, height, width)
            if seen is not None:
                yield piece, *seen


@lru_cache(maxsize=8)
def _surroundings(kind: str, seed: int, camera_m: float) -> _Surroundings:
    """Return drawn surroundings.

    Parameters
    ----------
    kind : str
        ``plane``, ``street``, ``forest``, ``room`` or ``sky``.
    seed : int
        Everything random follows from it.
    camera_m : float
        Height of the camera above the ground.
    """
    random = np.random.default_rng([seed, *kind.encode()])
    return _KINDS[kind](random, -camera_m)


# ---- Surfaces ------------------------------------------------------------------------------


def _noise(random: Random, exponent: float = 1.0, finest: float = 3.0) -> Picture:
    return noise_tile(_SIDE, exponent, finest, random)


def _repeated(values: Floats | Picture) -> Texture:
    return Texture(np.clip(values, 0, 1).astype(np.float32), repeats=True)


def _backdrop(values: Floats | Picture, wide_m: float) -> tuple[_Piece, ...]:
    """Return a picture very far away, ahead and on both sides, `wide_m` wide before it repeats."""
    texture, far = _repeated(values), _BACKDROP_M
    sides: tuple[tuple[Vector, Vector], ...] = (
        ((0.0, 0.0, far), _RIGHT),
        ((-far, 0.0, 0.0), _AHEAD),
        ((far, 0.0, 0.0), _AHEAD),
    )
    extent = (-far, -far, far, far)
    return tuple(
        _Piece(Surface(at, along, _UP, texture, _SIDE / wide_m, (0.0, wide_m / 2), extent), 0.0)
        for at, along in sides
    )


def _ground(values: Floats | Picture, down: float, tile_m: float, clear_m: float) -> _Piece:
    """Return an endless ground whose texture repeats; its middle lies before the camera."""
    corner = (-tile_m / 2, 0.0)
    texture = _repeated(values)
    return _Piece(Surface((0, down, 0), _RIGHT, _AHEAD, texture, _SIDE / tile_m, corner), clear_m)


def _wall(
    values: Floats | Picture, at: Vector, along: Vector, size: tuple[float, float, float]
) -> _Piece:
    """Return an upright wall from its lower corner `at`; `size` is its length, height and tile."""
    long, high, tile_m = size
    extent = (0.0, 0.0, long, high)
    surface = Surface(at, along, _UP, _repeated(values), _SIDE / tile_m, (0.0, high), extent)
    return _Piece(surface, _CLEAR_M)


def _sky(random: Random, horizon: float = 0.8) -> Picture:
    """Return clouds over low hills: 1 unit of height is the width of the picture."""
    clouds = np.clip(0.72 + 0.12 * _noise(random, 1.4), 0.45, 1)
    rise = (np.arange(_SIDE)[::-1, None] - _SIDE / 2) / _SIDE
    hills = 0.012 * (1.2 + _noise(random, 1.5)[0][None, :])
    sky = horizon + (clouds - horizon) * np.clip(rise / 0.1, 0, 1)
    return np.where(rise < hills, 0.45, sky).astype(np.float32)


# ---- Places --------------------------------------------------------------------------------


def _plane(random: Random, down: float) -> _Surroundings:
    ground = 0.45 * (1 + 0.35 * _noise(random, 1.0))
    return _Surroundings((_ground(ground, down, 8.0, 0.0),), 0.8)


def _facade(random: Random) -> Floats:
    """Return four by four windows on plaster."""
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
    return np.asarray(wall, np.float64)


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
    pieces = [*_backdrop(_sky(random), 6000), _ground(road, down, tile, 90)]
    houses = [_facade(random) for _ in range(4)]
    for side in (-1.0, 1.0):
        for number in range(7):
            high = float(random.uniform(7, 14))
            at = (side * 7.5, down, 16.0 * (number - 1))
            values = houses[int(random.integers(len(houses)))]
            pieces.append(_wall(values, at, _AHEAD, (16.0, high, 14.0)))
    posts = [(side * 4.6, float(at)) for at in range(4, 88, 12) for side in (-1, 1)]
    iron = 0.2 * (1 + 0.2 * _noise(random))
    for right, ahead in sorted(posts, key=lambda post: -post[1]):
        pieces.append(_wall(iron, (right - 0.08, down, ahead), _RIGHT, (0.16, 4.5, 4.0)))
    return _Surroundings(tuple(pieces), 0.75)


def _forest(random: Random, down: float) -> _Surroundings:
    """Return leaves on the ground, trunks, and foliage behind them."""
    leaves = 0.3 * (1 + 0.5 * _noise(random, 0.8))
    foliage = 0.38 * (1 + 0.55 * _noise(random, 0.9))
    pieces = [*_backdrop(foliage, 3000), _ground(leaves, down, 6.0, 60)]
    bark = [0.2 * (1 + 0.45 * _noise(random, 0.6)) for _ in range(3)]
    trunks = [
        (side * random.uniform(2.2, 16), random.uniform(3, 70), random.uniform(0.2, 0.6))
        for _ in range(30)
        for side in (-1, 1)
    ]
    for right, ahead, wide in sorted(trunks, key=lambda trunk: -trunk[1]):
        values = bark[int(random.integers(3))] * random.uniform(0.7, 1.6)
        at = (right - wide / 2, down, ahead)
        pieces.append(_wall(values, at, _RIGHT, (wide, 14.0, 2.0)))
    return _Surroundings(tuple(pieces), 0.45)


def _room(random: Random, down: float) -> _Surroundings:
    """Return a hall of 6 m by 2.8 m, 18 m long."""
    planks = 0.42 * (1 + 0.14 * _noise(random, 0.8))
    planks[:, :: _SIDE // 16] *= 0.55
    planks[:: _SIDE // 4] *= 0.7
    ceiling = 0.8 * (1 + 0.03 * _noise(random))
    ceiling[:: _SIDE // 4] = ceiling[:, :: _SIDE // 4] = 0.6
    top, far = down + 2.8, 18.0
    pieces = [
        _ground(planks, down, 4.0, 0.0),
        _Piece(
            Surface((0, top, 0), _RIGHT, _AHEAD, _repeated(ceiling), _SIDE / 4, (-2.0, 0.0)), 0.0
        ),
    ]
    for at, along, long in (
        ((-3.0, down, -6.0), _AHEAD, far + 6),
        ((3.0, down, -6.0), _AHEAD, far + 6),
        ((-3.0, down, far), _RIGHT, 6.0),
    ):
        wall = 0.62 * (1 + 0.05 * _noise(random))
        for _ in range(5):  # frames, shelves, doors
            y, x = random.integers(40, 300), random.integers(0, 400)
            high, wide = random.integers(60, 180), random.integers(50, 110)
            wall[y : y + high, x : x + wide] = random.uniform(0.15, 0.9)
            inner = wall[y + 6 : y + high - 6, x + 6 : x + wide - 6]
            inner[:] = (0.45 * (1 + 0.5 * _noise(random, 1.2)))[: inner.shape[0], : inner.shape[1]]
        pieces.append(_wall(wall, at, along, (long, 2.8, 5.0)))
    return _Surroundings(tuple(pieces), 0.6)


def _open_sky(random: Random, down: float) -> _Surroundings:
    """Return clouds, and fields below."""
    fields = 0.4 * (1 + 0.3 * _noise(random, 1.2))
    for _ in range(24):
        y, x = random.integers(0, _SIDE, 2)
        high, wide = random.integers(40, 160, 2)
        fields[y : y + high, x : x + wide] *= random.uniform(0.6, 1.5)
    return _Surroundings(
        (*_backdrop(_sky(random, 0.85), 5000), _ground(fields, down, 60.0, 500)), 0.8
    )


_KINDS: dict[str, Callable[[Random, float], _Surroundings]] = {
    "plane": _plane,
    "street": _street,
    "forest": _forest,
    "room": _room,
    "sky": _open_sky,
}
