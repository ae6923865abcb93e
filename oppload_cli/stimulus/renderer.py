"""The renderer: from a protocol to frames of luminance with their ground truth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np

from oppload_cli.errors import StimulusError
from oppload_cli.stimulus.background import Drawn, background_of
from oppload_cli.stimulus.painters import painter_of
from oppload_cli.stimulus.truth import FrameTruth, frame_truth

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from oppload_cli.stimulus.protocol import Protocol


# v / 255 in single precision, rounded once
_LUMINANCE = np.arange(256, dtype=np.float32) / np.float32(255)


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
    """Draws any frame of a protocol, each by itself, in any order."""

    def __init__(self, protocol: Protocol) -> None:
        self.protocol = protocol
        self._background = background_of(protocol)
        self._painters = [painter_of(protocol, obj) for obj in protocol.objects]
        self._last: tuple[list[object], NDArray[np.float32]] | None = None

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
            float64 (h, w, 2): pixels right and down; NaN where nothing is drawn.

        Raises
        ------
        StimulusError
            If the protocol has no drawn surroundings.
        """
        if not isinstance(self._background, Drawn):
            raise StimulusError(
                "flow is known of drawn surroundings only; set scene.background to one of them"
            )
        display = self.protocol.display
        place, view = self._background.at(self.protocol.time_of(frame))
        _, later = self._background.at(self.protocol.time_of(frame + 1))
        return place.flow(view, later, display.height, display.width)

    def luminance(self, frame: int) -> NDArray[np.float32]:
        """Return the luminance of a frame (0-based) before it is rounded to 8 bits.

        Returns
        -------
        ndarray
            float32 (h, w), 0 to 1.
        """
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

    def _blurred(self, time: float) -> NDArray[np.float32]:
        """Average over the open shutter; its middle is the frame's time."""
        effects, rate = self.protocol.effects, float(self.protocol.display.frame_rate)
        count = effects.shutter_samples
        shifts = ((np.arange(count) + 0.5) / count - 0.5) * effects.shutter / rate
        display = self.protocol.display
        total = np.zeros((display.height, display.width), dtype=np.float32)
        for shift in shifts:
            total += self._picture(time + float(shift), time)
        return total / np.float32(count)

    def _picture(self, time: float, frame_s: float) -> NDArray[np.float32]:
        """Draw the scene, or return the picture drawn last where nothing has changed since.

        `frame_s` is the time of the frame, which the shutter surrounds.
        """
        poses = [painter.pose(time) for painter in self._painters]
        looks = [self._background.look(time, frame_s), *(pose.look for pose in poses)]
        if self._last is not None and self._last[0] == looks:
            return self._last[1]
        picture = self._background.picture(time, frame_s)
        for painter, pose in zip(self._painters, poses, strict=True):
            if pose.visible:
                painter.paint(picture, pose)
        self._last = (looks, picture)
        return picture


def frames(protocol: Protocol) -> Iterator[StimulusFrame]:
    """Draw a stimulus, frame by frame.

    Yields
    ------
    StimulusFrame
        The luminance is exactly that of the lossless file when it is read back.
    """
    renderer = Renderer(protocol)
    for index in range(protocol.frame_count):
        grey = renderer.grey(index)
        truth = frame_truth(protocol, index)
        yield StimulusFrame(index, truth.time_s, grey, _LUMINANCE[grey], truth)
