"""Optical flow: one field of motion per picture, which all measurements of motion read."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, Any, NamedTuple

import cv2
import numpy as np

from oppload_cli.errors import FrameError
from oppload_cli.frame_times import seconds_of, ticks
from oppload_cli.motion.rmo import RmoMetrics, RmoParams, length, rmo_metrics

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Grey = NDArray[np.uint8]
    Luma = NDArray[np.float32]  # 0 to 1
    Points = NDArray[np.float64]  # shape (..., 2): x, y


# The shorter side of a frame is reduced to about this number of samples. At half of 240 rows the
# search takes four times as long, and growth is not measured better (``docs/footage.md``).
_SAMPLES = 60
# Least side of a frame in px for which flow is computed: the patches of the search have 8 px.
SHORTEST_SIDE = 16


class Flow(NamedTuple):
    """The motion from an earlier picture to the latest one, in square samples of the frame.

    Attributes
    ----------
    vectors : ndarray of float32, shape (rows, columns, 2)
        Motion (x, y) between both pictures, in px of the working frame; y grows downwards. No rows
        if the frame is too small.
    change : ndarray of float32, shape (rows, columns)
        Absolute change of the mean luminance of each sample, 0 to 1.
    side : float
        Side of a sample in px of the working frame.
    passed_s : float
        Time between both pictures in seconds, above 0.
    """

    vectors: Luma
    change: Luma
    side: float
    passed_s: float

    def scaled(self, factor: float) -> Flow:
        """Return the same flow in px of a frame that is `factor` times as large."""
        if factor == 1:
            return self
        return self._replace(vectors=self.vectors * np.float32(factor), side=self.side * factor)


class MotionVectors(NamedTuple):
    """Motion vectors of one frame, in px of the working frame; y grows downwards.

    Attributes
    ----------
    starts : ndarray of float, shape (n, 2)
        Start (x, y) of each vector: the centre of its grid cell.
    vectors : ndarray of float, shape (n, 2)
        Motion (x, y) between both pictures.
    """

    starts: Points
    vectors: Points


class DenseFlow:
    """Measures the flow of a video, frame by frame.

    A frame is compared with the earlier frame whose age is nearest to an interval, which is the
    frame before at up to 45 frames/s: at higher rates a step shows too little motion.

    Parameters
    ----------
    interval_s : float
        Time in seconds between the pictures that are compared; 0: each with the one before.

    Notes
    -----
    Dense inverse search with variational refinement: Kroeger, Timofte, Dai and Van Gool (2016),
    "Fast optical flow using dense inverse search", OpenCV's preset "fast".
    """

    def __init__(self, interval_s: float = 1 / 30) -> None:
        self._interval = ticks(interval_s)
        # Any: OpenCV's types demand an initial flow, which would be tried again at every scale.
        self._search: Any = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_FAST)
        # The frames are reduced already. In low frames another value makes OpenCV read beyond them.
        self._search.setFinestScale(0)
        self.reset()

    def reset(self) -> None:
        """Forget all frames: the next frame is frame 0."""
        self._shape: tuple[int, ...] | None = None
        self._earlier: deque[tuple[int, Grey]] = deque()  # time in ticks, picture

    def step(self, luma: Luma | Grey, time_s: float) -> Flow | None:
        """Take the next frame and return its flow; None for the first frame.

        Parameters
        ----------
        luma : ndarray, shape (h, w)
            Luminance: float32 in [0, 1], or uint8.
        time_s : float
            Time in seconds at which the picture was taken, above that of the frame before.

        Raises
        ------
        FrameError
            If `luma` is not such an array, or differs in shape from the frame before.
        """
        _check(luma, self._shape)
        self._shape = luma.shape
        side = max(1, min(round(min(luma.shape) / _SAMPLES), min(luma.shape) // SHORTEST_SIDE))
        now = _reduced(luma, side)
        earlier = self._earlier
        time = ticks(time_s)
        while len(earlier) > 1 and self._is_nearer(time - earlier[1][0], time - earlier[0][0]):
            earlier.popleft()
        before = earlier[0] if earlier else None
        earlier.append((time, now))
        if before is None:
            return None
        passed_s = seconds_of(max(time - before[0], 1))
        change = cv2.absdiff(before[1], now).astype(np.float32) / np.float32(255)
        if min(now.shape) < SHORTEST_SIDE:
            return Flow(np.zeros((0, 0, 2), np.float32), change, side, passed_s)
        vectors: Luma = self._search.calc(before[1], now, None)
        return Flow(vectors * np.float32(side), change, side, passed_s)

    def stand_still(self, time_s: float) -> None:
        """Take a frame that shows the latest picture again: motion begins after it."""
        if self._earlier:
            self._earlier[-1] = ticks(time_s), self._earlier[-1][1]

    def _is_nearer(self, age: int, other: int) -> bool:
        return abs(age - self._interval) <= abs(other - self._interval)


def motion_vectors(flow: Flow, params: RmoParams) -> MotionVectors:
    """Average the flow over the cells of a grid; keep the cells that move and change enough.

    `params` has the grid and the minimum speed and change.
    """
    if not flow.vectors.size:
        return MotionVectors(np.empty((0, 2)), np.empty((0, 2)))
    height, width = (side * flow.side for side in flow.change.shape)
    spacing = params.grid or max(4, round(min(height, width) / 17))
    rows, columns = (max(1, round(side / spacing)) for side in (height, width))
    x = (np.arange(columns) + 0.5) * width / columns - 0.5
    y = (np.arange(rows) + 0.5) * height / rows - 0.5
    starts = np.stack(np.meshgrid(x, y), axis=-1)
    vectors, change = (
        cv2.resize(values, (columns, rows), interpolation=cv2.INTER_AREA).astype(np.float64)
        for values in (flow.vectors, flow.change)
    )
    kept = (length(vectors) >= params.minimum_speed) & (change >= params.minimum_change)
    return MotionVectors(starts[kept], vectors[kept])


def rmo_of(flow: Flow, params: RmoParams) -> RmoMetrics:
    """Return the radial motion opponency of a flow; zeros if nothing moves (``docs/rmo.md``)."""
    motion = motion_vectors(flow, params)
    return rmo_metrics(motion.starts, motion.vectors, params)


def _reduced(luma: Luma | Grey, side: int) -> Grey:
    """Return the means of squares in grey levels; what does not fill a square is cut off."""
    rows, columns = (length // side for length in luma.shape)
    part = luma[: rows * side, : columns * side]
    small = cv2.resize(part, (columns, rows), interpolation=cv2.INTER_AREA)
    if small.dtype == np.uint8:
        return np.asarray(small, np.uint8)
    return np.asarray(cv2.convertScaleAbs(small, alpha=255.0), np.uint8)


def _check(luma: Luma | Grey, shape: tuple[int, ...] | None) -> None:
    if luma.ndim != 2 or luma.dtype not in (np.float32, np.uint8) or not luma.size:
        raise FrameError(
            f"the frame is {luma.dtype} of shape {luma.shape}; "
            "give float32 luminance in [0, 1] or uint8, of shape (height, width)"
        )
    if shape is not None and luma.shape != shape:
        raise FrameError(
            f"the frame is of shape {luma.shape} after one of {shape}; call reset() between videos"
        )
