"""Scenes that change as films do, given to an analysis without a file."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING

import cv2
import numpy as np

from oppload_cli.detection.alarm import alarm_params
from oppload_cli.frame_times import ticks
from oppload_cli.pipeline.analysis import analyse
from oppload_cli.video.frames import Frame, InputFacts, WorkingSize
from tests.media import disk, texture

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from oppload_cli.video.frames import FrameSource
    from tests.media import Luma

SIZE = 240
RATE = 30
STILL, BEFORE, AFTER = 20, 36, 24  # frames


@dataclass(frozen=True)
class Film:
    """Frames as an open video would give them."""

    frames: Sequence[Luma]

    @property
    def facts(self) -> InputFacts:
        return InputFacts("film", "images", SIZE, SIZE, Fraction(RATE), len(self.frames))

    @property
    def working(self) -> WorkingSize:
        return WorkingSize.of(self.facts, None)

    def __iter__(self) -> Iterator[Frame]:
        for index, luma in enumerate(self.frames):
            yield Frame(index, ticks(index / RATE), luma)


def pan(frames: int, speed: int = 2, seed: int = 1) -> list[Luma]:
    """A texture moving left."""
    wide = texture(SIZE, SIZE + speed * frames, seed)
    return [np.ascontiguousarray(wide[:, speed * t : speed * t + SIZE]) for t in range(frames)]


def patches(
    frames: int, speed: int = 2, sigma: int = 6, seed: int = 1, rise: int = 1
) -> list[Luma]:
    """Black patches on white, as many as they leave free, moving left.

    The motion reaches its speed after `rise` frames.
    """
    from scipy.ndimage import gaussian_filter

    shape = (SIZE, SIZE + speed * frames)
    smooth = gaussian_filter(np.random.default_rng(seed).random(shape), sigma, mode="wrap")
    wide = gaussian_filter((smooth > np.median(smooth)).astype(np.float32), 0.7)
    steps = np.minimum(np.arange(frames) / rise, 1) * speed
    lefts = np.rint(np.cumsum(steps)).astype(int)
    return [np.ascontiguousarray(wide[:, left : left + SIZE]) for left in lefts]


def shaken(ground: Luma, frames: int, sigma: float, seed: int) -> list[Luma]:
    """A picture before a shaking camera; `sigma` is that of its jerks in px, across and down."""
    random, place = np.random.default_rng(seed), np.zeros(3)
    size = ground.shape[::-1]
    film = []
    for _ in range(frames):
        place = 0.6 * place + random.normal(0, (sigma, sigma, 0.15 * sigma))
        move = cv2.getRotationMatrix2D((size[0] / 2, size[1] / 2), place[2], 1)
        move[:, 2] = move[:, 2] + place[:2]
        seen = cv2.warpAffine(ground, move, size, borderMode=cv2.BORDER_REFLECT)
        film.append(np.asarray(seen, np.float32))
    return film


def cut() -> list[Luma]:
    """From a faint texture that moves left to patches that do."""
    return [*(frame * np.float32(0.1) for frame in pan(BEFORE)), *patches(AFTER, seed=5)]


def cut_between_textures() -> list[Luma]:
    """From a texture that moves left to another one that moves up, twice as fast."""
    return [*pan(BEFORE), *(np.ascontiguousarray(frame.T) for frame in pan(AFTER, 4, seed=2))]


def dark_flash(frames: int) -> list[Luma]:
    """Moving patches, a tenth as bright for some frames."""
    moving = patches(BEFORE + AFTER)
    return [
        frame * np.float32(0.1 if BEFORE <= t < BEFORE + frames else 1)
        for t, frame in enumerate(moving)
    ]


def bright_flash(frames: int) -> list[Luma]:
    """Moving patches, near to white for some frames."""
    moving = patches(BEFORE + AFTER)
    return [
        frame * np.float32(0.3) + np.float32(0.7) if BEFORE <= t < BEFORE + frames else frame
        for t, frame in enumerate(moving)
    ]


def copied(times: int) -> list[Luma]:
    """A moving texture of which each frame comes several times."""
    return [frame for frame in pan(BEFORE) for _ in range(times)]


def one_copied() -> list[Luma]:
    """A moving texture with one frame twice, as a recorder that has lost one writes it."""
    moving = pan(BEFORE + AFTER)
    return [*moving[:BEFORE], moving[BEFORE - 1], *moving[BEFORE + 1 :]]


def out_of_rest(moving: list[Luma]) -> list[Luma]:
    """A scene that begins to move after frame 20."""
    return [*([moving[0]] * STILL), *moving]


def noisy(frames: list[Luma]) -> list[Luma]:
    """The same with the noise of a camera: no frame is an exact copy."""
    rng = np.random.default_rng(4)
    return [frame + rng.normal(0, 3e-4, frame.shape).astype(np.float32) for frame in frames]


def looming_over(ground: list[Luma]) -> list[Luma]:
    """A black disk that approaches over the ground, in contact after the last frame; l/v 60 ms."""
    shown = []
    for t, behind in enumerate(ground):
        radius = 12.0 * RATE / (len(ground) - t)
        shown.append(np.minimum(behind, disk(SIZE, 125, 110, radius)))
    return shown


def alarms(video: FrameSource, name: str, **changes: float) -> list[int]:
    """Return the frames in which a detector's alarm is on."""
    records = analyse(video, [name], alarm=alarm_params(**changes), rmo=None)
    return [record.frame for record in records if record[name].alarm]
