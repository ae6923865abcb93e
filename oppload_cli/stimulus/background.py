"""The ground behind the objects: an even luminance, drawn surroundings or a video."""

from __future__ import annotations

import math
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, Protocol

import cv2
import numpy as np

from oppload_cli.errors import OpploadError, StimulusError
from oppload_cli.stimulus.staging import camera_of, view_of
from oppload_cli.stimulus.surroundings import surroundings
from oppload_cli.video.source import open_video

if TYPE_CHECKING:
    from fractions import Fraction

    from numpy.typing import NDArray

    from oppload_cli.stimulus import protocol as protocols
    from oppload_cli.stimulus.staging import View
    from oppload_cli.stimulus.surroundings import Surroundings

    Picture = NDArray[np.float32]
    Footage = tuple[tuple[float, ...], NDArray[np.uint8], float]

_MOST_BYTES = 1 << 30  # of a video's part that is used


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
        If its video cannot be read, or does not fit the display.
    """
    if protocol.scene.background is None:
        return _Even(protocol)
    return _Video(protocol) if protocol.scene.has_footage else Drawn(protocol)


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

    def at(self, time: float) -> tuple[Surroundings, View]:
        """Return the surroundings and the camera at a time."""
        protocol = self._protocol
        cut = protocol.scene.cut_s
        # a second place, of which no other protocol with a near seed has the first
        seed = protocol.seed + (1_000_003 if cut is not None and time >= cut else 0)
        kind = str(protocol.scene.background)
        return surroundings(kind, seed, camera_of(protocol).height_m), view_of(protocol, time)

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
        # its own shutter has been open already, so that all times of a frame show one picture
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
    if wanted.fit == "exact" and (native.width, native.height) != wanted.size:
        raise StimulusError(
            f"its pictures are {native.width} x {native.height} px and the display has {width} x "
            f"{height}; change display.width and display.height, or write background_fit = 'cover'"
        )
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
