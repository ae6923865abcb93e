"""Colour pictures of frames, as they are displayed."""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING

import av
import cv2
import numpy as np
from av.video.reformatter import ColorRange, Colorspace, Interpolation, VideoReformatter

from oppload_cli.video.frames import turned
from oppload_cli.video.luminance import as_displayed, luminance_table
from oppload_cli.video.planes import convertible, resized

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from oppload_cli.video.frames import InputFacts, Picture

    Bgr = NDArray[np.uint8]  # rows x columns x 3: blue, green, red


LONGEST_SIDE = 1920  # px; larger pictures are reduced
_EXACTLY = Interpolation.BILINEAR | Interpolation.ACCURATE_RND | Interpolation.BITEXACT
_UNSPECIFIED = 2  # AVCOL_SPC_UNSPECIFIED
_STANDARD_LINES = 576  # pictures with more lines that state no colour space use BT.709


def colour_size(facts: InputFacts, longest: int = LONGEST_SIDE) -> tuple[int, int]:
    """Return width and height of an input's colour pictures: no side is above `longest` px."""
    scale = min(1.0, longest / max(facts.width, facts.height))
    return max(1, round(facts.width * scale)), max(1, round(facts.height * scale))


def as_yuv420p(
    frame: av.VideoFrame,
    converter: VideoReformatter,
    size: tuple[int | None, int | None] = (None, None),
    colour_space: int | None = None,
) -> av.VideoFrame:
    """Return a frame in the format that the H.264 encoder takes: yuv420p, BT.709, limited range.

    `converter` keeps its tables for the next frame of the same size. If left out, `size` (width and
    height) is that of `frame`, and `colour_space` the one that `frame` states.
    """
    return converter.reformat(
        frame, *size, "yuv420p", colour_space, Colorspace.ITU709,
        dst_color_range=ColorRange.MPEG, interpolation=_EXACTLY, threads=1,
    )  # fmt: skip


class Colour:
    """Makes the colour pictures of one input, all of the same size.

    `size` is the width and height of the pictures; that of :func:`colour_size` if left out.
    """

    def __init__(self, facts: InputFacts, size: tuple[int, int] | None = None) -> None:
        self._facts = facts
        self._coded = turned(*(size or colour_size(facts)), facts.rotation)
        self._converter = VideoReformatter()

    def __call__(self, picture: Picture) -> Bgr:
        """Return the displayed picture: uint8, shape (height, width, 3), blue, green and red.

        It is grey if the source is grey, or if a damaged colour space cannot be converted.
        """
        return as_displayed(self._converted(picture), self._facts)

    def planes(self, picture: Picture) -> av.VideoFrame:
        """Return a picture in the format that the H.264 encoder takes.

        A picture that need not be mirrored or turned is scaled in its own planes, which takes a
        quarter of the time.
        """
        original, facts = picture.original, self._facts
        if isinstance(original, av.VideoFrame) and not (facts.mirrored or facts.rotation):
            with suppress(av.error.FFmpegError, ValueError):
                space = self._assumed(original)
                return as_yuv420p(original, self._converter, self._coded, space)
        return as_yuv420p(av.VideoFrame.from_ndarray(self(picture), "bgr24"), self._converter)

    def _converted(self, picture: Picture) -> Bgr:
        original = picture.original
        if isinstance(original, np.ndarray):
            return resized(original, self._coded)
        if original is not None and not original.format.name.startswith("gray"):
            with suppress(av.error.FFmpegError, ValueError):
                space = self._assumed(original)
                frame = convertible(original)
                converted = self._converter.reformat(
                    frame, *self._coded, "bgr24", space, interpolation=_EXACTLY, threads=1
                )
                return np.asarray(converted.to_ndarray(), np.uint8)
        table = np.rint(luminance_table(picture.bits, picture.full_range) * 255).astype(np.uint8)
        grey = np.asarray(cv2.cvtColor(table[picture.plane], cv2.COLOR_GRAY2BGR))
        return resized(grey, self._coded)

    def _assumed(self, frame: av.VideoFrame) -> int | None:
        """Return the colour space to assume for a frame; None: use the one that it states."""
        large = min(frame.width, frame.height) > _STANDARD_LINES
        return Colorspace.ITU709 if large and frame.colorspace == _UNSPECIFIED else None
