"""Parts of mLPLC2: fields cut at the edge, correlators of neighbours, and fields of attention.

Source: Liu and Fu 2025 and the authors' published code; ``docs/detectors.md``.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import cv2
import numpy as np

from oppload_cli.models.published.parts import ZERO, low_pass_share, spread

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from oppload_cli.models.published.parts import Plane

    Places = NDArray[np.intp]  # numbers of pixels, in the order of rows

BAND = 5  # px at the frame's edge without motion
DELAYS_MS = 80.0, 70.0, 60.0, 50.0, 40.0  # at distances of 1 to 5 px
NULL_WEIGHT, MOTION_MS = 1.5, 30.0  # of motion the other way; low-pass of motion
NEIGHBOURS = (0, 1), (0, -1), (1, 0), (-1, 0)  # to the right, left, below, above: rows, columns
HALF_FIELD, SUMMED_FRAMES = 75, 5  # px, frames
FAINTEST_MOTION = 1e-12  # of which a power is taken


def corner_line(size: int, used: int, sigma: float) -> Plane:
    """Return the first part of a Gaussian of sum 1, whose square the authors apply centred."""
    line = np.exp(-((np.arange(size) - size // 2) ** 2) / (2 * sigma**2))
    return np.asarray(line[:used] / line.sum(), np.float64)


def cut(p: Plane, line: Plane) -> Plane:
    """Return P convolved with the square of a line, as the authors' loop computes it.

    Their running sum is set to 0 after every tap that lies in the outer band, in the order of
    rows. So a pixel whose last tap lies there gets 0. Near the upper edge only the rows below
    the band count, and near the left edge only the part of the last row beyond it.
    """
    reach = len(line) // 2
    inner, last_row = p.copy(), np.zeros((len(line), len(line)))
    inner[:BAND], inner[:, :BAND], last_row[-1] = 0, 0, line[-1] * line
    out = np.asarray(cv2.sepFilter2D(inner, -1, line, line, borderType=ZERO))
    side = BAND + reach
    out[:, :side] = spread(inner[:, : side + reach], last_row, ZERO)[:, :side]
    out[: BAND - reach], out[-side:], out[:, : BAND - reach], out[:, -side:] = 0, 0, 0, 0
    return np.asarray(out, np.float64)


def correlate(
    motion: Plane, here: Places, signals: tuple[Plane, Plane], width: int, interval_ms: float
) -> None:
    """Add the low-passed correlation of some pixels with their neighbours in four directions.

    Parameters
    ----------
    motion : ndarray of float64, shape (4, pixels)
        Is changed in place.
    here : ndarray of int
        The pixels, outside the band at the edge: those whose signal is above 0.
    signals : tuple of ndarray of float64, shape (pixels,)
        The compressed signal of this frame and of the one before.
    width : int
        Of the frame in px.
    interval_ms : float
        Between two frames.
    """
    share = low_pass_share(interval_ms, MOTION_MS)
    now, before = signals
    now_here, before_here = now[here], before[here]
    for distance, tau in enumerate(DELAYS_MS, 1):
        late = low_pass_share(interval_ms, tau)
        d_here = late * now_here + (1 - late) * before_here
        for own, (dy, dx) in zip(motion, NEIGHBOURS, strict=True):
            there = here + distance * (dy * width + dx)
            now_there = now[there]
            d_there = late * now_there + (1 - late) * before[there]
            e = d_here * d_there * (now_there - NULL_WEIGHT * now_here)
            e[(e < 0) | (e > 1)] = 0
            own[here] += share * e


def powered(motion: Plane, exponent: float) -> Plane:
    """Return a power of the motion, 0 where it has all but decayed."""
    if exponent == 0.5:
        return np.sqrt(motion)
    return np.where(motion > FAINTEST_MOTION, np.maximum(motion, FAINTEST_MOTION) ** exponent, 0)


@dataclass
class Attention:
    """A field of attention: its number, place and first frame, and its latest sums."""

    number: int
    y: int
    x: int
    birth: int = 0
    quadrants: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    sums: deque[float] = field(default_factory=lambda: deque(maxlen=SUMMED_FRAMES))
    outputs: deque[float] = field(default_factory=lambda: deque([0.0], SUMMED_FRAMES))

    def take(self, y: Places, x: Places, net: Plane) -> None:
        """Sum the outward part of the motion in each quadrant.

        Parameters
        ----------
        y, x : ndarray of int, shape (n,)
            The pixels that move.
        net : ndarray of float64, shape (2, n)
            Their net motion to the right and downwards.
        """
        dy, dx = y - self.y, x - self.x
        inside = np.abs(2 * dy + 1) < 2 * HALF_FIELD
        inside &= np.abs(2 * dx + 1) < 2 * HALF_FIELD
        dy, dx, (across, downward) = dy[inside], dx[inside], net[:, inside]
        right, left = np.maximum(across, 0), np.maximum(-across, 0)
        down, up = np.maximum(downward, 0), np.maximum(-downward, 0)
        middle = (dy == 0) & (dx == 0)
        self.quadrants = (
            float((right + up)[(dy <= 0) & (dx > 0)].sum()),
            float((left + up)[(dy < 0) & (dx <= 0)].sum()),
            float((left + down)[(dy >= 0) & (dx < 0)].sum()),
            float((right + down)[((dy > 0) & (dx >= 0)) | middle].sum()),
        )
        self.sums.append(sum(self.quadrants) if all(self.quadrants) else 0.0)
        self.outputs.append(sum(self.sums))
