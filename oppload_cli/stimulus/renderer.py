"""The renderer: from a protocol to frames of luminance with their ground truth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from oppload_cli.stimulus.figures import Painter, PatchPainter
from oppload_cli.stimulus.kinematics import pose_of
from oppload_cli.stimulus.objects import GRATINGS
from oppload_cli.stimulus.patterns import (
    DotsPainter,
    GratingPainter,
    PatternPainter,
    TexturePainter,
)
from oppload_cli.stimulus.truth import FrameTruth, frame_truth

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from oppload_cli.stimulus.kinematics import Pose
    from oppload_cli.stimulus.objects import Object
    from oppload_cli.stimulus.protocol import Protocol

# v / 255 in single precision, rounded once
LUMINANCE = np.arange(256, dtype=np.float32) / np.float32(255)


@dataclass(frozen=True)
class StimulusFrame:
    """One frame of a stimulus.

    Attributes
    ----------
    index : int
        0-based.
    time_s : float
        Seconds from the first frame.
    grey : ndarray
        uint8 (h, w): what a file of it holds.
    luma : ndarray
        float32 (h, w), luminance 0 to 1: exactly ``grey / 255``.
    truth : FrameTruth
        What the frame shows.
    """

    index: int
    time_s: float
    grey: NDArray[np.uint8]
    luma: NDArray[np.float32]
    truth: FrameTruth


class Renderer:
    """Draws any frame of a protocol, each on its own, in any order.

    Parameters
    ----------
    protocol : Protocol
        The stimulus.
    """

    def __init__(self, protocol: Protocol) -> None:
        self.protocol = protocol
        self._painters = [(thing, painter_of(protocol, thing)) for thing in protocol.objects]
        self._last: tuple[list[Pose], NDArray[np.float32]] | None = None

    def grey(self, frame: int) -> NDArray[np.uint8]:
        """Return a frame as a file holds it: luminance times 255, rounded half to even.

        Parameters
        ----------
        frame : int
            0-based.

        Returns
        -------
        ndarray
            uint8 (h, w).
        """
        picture = self.luminance(frame)
        return np.asarray(np.clip(np.rint(picture * np.float32(255)), 0, 255), dtype=np.uint8)

    def luminance(self, frame: int) -> NDArray[np.float32]:
        """Return a frame's luminance before it is rounded to 8 bits.

        Parameters
        ----------
        frame : int
            0-based.

        Returns
        -------
        ndarray
            float32 (h, w), 0 to 1.
        """
        effects = self.protocol.effects
        time = self.protocol.time_of(frame)
        picture = self._blurred(time) if effects.shutter else self._picture(time)
        if effects.invert:
            picture = 1 - picture
        if effects.noise:
            random = np.random.default_rng([self.protocol.seed, frame])
            noise = random.standard_normal(picture.shape, dtype=np.float32)
            picture = np.clip(picture + np.float32(effects.noise) * noise, 0.0, 1.0)
        return picture

    def _blurred(self, time: float) -> NDArray[np.float32]:
        """Average over the open shutter; its middle is the frame's time."""
        effects, rate = self.protocol.effects, float(self.protocol.display.frame_rate)
        count = effects.shutter_samples
        shifts = ((np.arange(count) + 0.5) / count - 0.5) * effects.shutter / rate
        display = self.protocol.display
        total = np.zeros((display.height, display.width), dtype=np.float32)
        for shift in shifts:
            total += self._picture(time + float(shift))
        return total / np.float32(count)

    def _picture(self, time: float) -> NDArray[np.float32]:
        """Draw the scene; while nothing changes, the last picture is drawn already."""
        poses = [pose_of(self.protocol, thing, time) for thing, _ in self._painters]
        if self._last is not None and _same_look(self._last[0], poses):
            return self._last[1]
        display = self.protocol.display
        picture = np.full((display.height, display.width), display.background, dtype=np.float32)
        for (_, painter), pose in zip(self._painters, poses, strict=True):
            if pose.visible:
                painter.paint(picture, pose)
        self._last = (poses, picture)
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
        The luminance is exactly what its lossless file gives when it is read back.
    """
    renderer = Renderer(protocol)
    for index in range(protocol.frame_count):
        grey = renderer.grey(index)
        truth = frame_truth(protocol, index)
        yield StimulusFrame(index, truth.time_s, grey, LUMINANCE[grey], truth)


def painter_of(protocol: Protocol, thing: Object) -> Painter:
    """Return the painter of an object.

    Parameters
    ----------
    protocol : Protocol
        The stimulus.
    thing : Object
        One of its objects.

    Returns
    -------
    Painter
    """
    if thing.kind in GRATINGS:
        return GratingPainter(protocol, thing)
    others: dict[str, type[Painter]] = {
        "field": PatternPainter,
        "texture": TexturePainter,
        "dots": DotsPainter,
        "patch": PatchPainter,
    }
    return others.get(thing.kind, Painter)(protocol, thing)


def _same_look(first: list[Pose], second: list[Pose]) -> bool:
    return [one.look for one in first] == [one.look for one in second]
