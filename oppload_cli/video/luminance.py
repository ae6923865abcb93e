"""Converts coded luma to luminance at the working size."""

from __future__ import annotations

from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from oppload_cli.video.frames import InputFacts, Picture, WorkingSize
    from oppload_cli.video.planes import Resizing


_TURNS = {90: cv2.ROTATE_90_COUNTERCLOCKWISE, 180: cv2.ROTATE_180, 270: cv2.ROTATE_90_CLOCKWISE}


class Luminance:
    """Converts pictures to luminance at the working size.

    The luma plane is resized first (area averaging), then mirrored and turned as `facts` say, and
    last converted to luminance. So the last two steps have few pixels to work on.
    """

    def __init__(self, size: WorkingSize, facts: InputFacts | None = None) -> None:
        self._coded = size.coded(facts.rotation if facts else 0)
        self._facts = facts

    def __call__(self, picture: Picture) -> NDArray[np.float32]:
        """Return the luminance of a picture, 0 to 1: float32, shape (height, width)."""
        plane = picture.plane
        if plane.shape[::-1] != self._coded:
            plane = self._resizing(plane)
        if self._facts:
            plane = as_displayed(plane, self._facts)
        table = luminance_table(picture.bits, picture.full_range)
        if plane.dtype != np.uint8:
            return np.asarray(table[plane], np.float32)
        return np.asarray(cv2.LUT(plane, table), np.float32)

    @cached_property
    def _resizing(self) -> Resizing:
        from oppload_cli.video.planes import Resizing  # imports PyAV, rarely needed here

        return Resizing(*self._coded)


def as_displayed(picture: NDArray[Any], facts: InputFacts) -> NDArray[Any]:
    """Return a coded picture, grey or in colour, mirrored and turned as `facts` say.

    The result is `picture` itself, not a copy, if it needs no change.
    """
    if facts.mirrored:
        picture = np.asarray(cv2.flip(picture, 1))
    turn = _TURNS.get(facts.rotation)
    return picture if turn is None else np.asarray(cv2.rotate(picture, turn))


@lru_cache(maxsize=16)
def luminance_table(bits: int, full_range: bool) -> NDArray[np.float32]:
    """Return the luminance, 0 to 1, of every code: float32, shape (256,) or (65536,).

    A sample has 8 to 16 `bits`. In a full range white is ``2^bits - 1``. In a limited range of 8
    bits black is 16 and white 235, and luminance ``(Y - 16) / 219``, clipped to 0 to 1; for more
    bits the three numbers are multiplied by ``2^(bits - 8)``.
    """
    codes = np.arange(256 if bits == 8 else 65536, dtype=np.float64)
    if full_range:
        luminance = codes / (2**bits - 1)
    else:
        step = 2 ** (bits - 8)
        luminance = (codes - 16 * step) / (219 * step)
    return np.asarray(np.clip(luminance, 0, 1), np.float32)
