"""Optical flow (dense inverse search): motion vectors on a grid, and pictures between frames."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import cv2
import numpy as np

from oppload_cli.errors import FrameError
from oppload_cli.motion.rmo import RmoMetrics, RmoParams, length, rmo_metrics

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator

    from numpy.typing import NDArray

    Grey = NDArray[np.uint8]
    Luma = NDArray[np.float32]  # 0 to 1
    Points = NDArray[np.float64]  # shape (..., 2): x, y


# Least side in px of a reduced frame for which flow is computed. OpenCV's inverse search refuses
# sides below 8 to 12 px, and its patches of 8 px have no meaning in such small frames.
SHORTEST_SIDE = 16
# Height below which, and width from which on, OpenCV takes too coarse a scale (`inverse_search`).
_LOW, _WIDE = 32, 80
# Frames that are more than 6.7 intervals apart differ too much for pictures in between.
_MOST_INTERVALS = 6
# A step of n - 0.3 to n + 0.7 intervals becomes n steps of 0.85 to 1.35 intervals.
_ROUNDED_UP = 0.3
# Margin around the part of the frame that changed, in samples of the reduced frame.
_MARGIN = 2


class MotionVectors(NamedTuple):
    """Motion vectors of one frame, in px of the working frame; y grows downwards.

    Attributes
    ----------
    starts : ndarray of float, shape (n, 2)
        Start (x, y) of each vector: the centre of its grid cell.
    vectors : ndarray of float, shape (n, 2)
        Motion since the frame before (x, y), px/frame.
    """

    starts: Points
    vectors: Points


class Cells(NamedTuple):
    """A grid of cells over a part of the frame."""

    rows: int
    columns: int
    reduction: int  # pixels per sample of the reduced part
    left: int  # left top corner of the part, in pixels
    top: int


def _reduce(frame: Grey, reduction: int) -> Grey:
    """Return the means of squares of 1 x 1, 2 x 2 or 4 x 4 pixels.

    The sides of the frame must be multiples of the squares' side. The frame may be a slice.
    """
    rows, columns = (side // reduction for side in frame.shape)
    return np.asarray(cv2.resize(frame, (columns, rows), interpolation=cv2.INTER_AREA), np.uint8)


def sampled(
    before: Grey, now: Grey, flow: NDArray[np.float32], cells: Cells, params: RmoParams
) -> MotionVectors:
    """Average the flow over each cell, and keep the vectors of cells that move and change enough.

    `before` and `now` are reduced frames, uint8, shape (h, w). `flow`, float32, shape (h, w, 2),
    is the motion (x, y) between them in their pixels. `params` has the minimum speed and change.
    """
    height, width = (side * cells.reduction for side in now.shape)
    x = (np.arange(cells.columns) + 0.5) * width / cells.columns - 0.5 + cells.left
    y = (np.arange(cells.rows) + 0.5) * height / cells.rows - 0.5 + cells.top
    starts = np.stack(np.meshgrid(x, y), axis=-1)
    vectors = _cell_means(flow, cells) * cells.reduction
    change = _cell_means(cv2.absdiff(before, now).astype(np.float32), cells)
    kept = (length(vectors) >= params.minimum_speed) & (change >= 255.0 * params.minimum_change)
    return MotionVectors(starts[kept], vectors[kept])


def _cell_means(image: NDArray[np.float32], cells: Cells) -> NDArray[np.float64]:
    size = cells.columns, cells.rows
    return cv2.resize(image, size, interpolation=cv2.INTER_AREA).astype(np.float64)


def inverse_search(shape: tuple[int, int], preset: int) -> cv2.DISOpticalFlow:
    """Return OpenCV's dense inverse search with one of its presets, for frames of a shape.

    In low frames OpenCV takes the coarsest scale from the width alone. If the frame at that scale
    is lower than a patch, 8 px, OpenCV reads beyond it and crashes (seen with 5.0.0). A finest
    scale of 0 makes OpenCV take both sides into account.
    """
    search = cv2.DISOpticalFlow.create(preset)
    if shape[0] < _LOW and shape[1] >= _WIDE:
        search.setFinestScale(0)
    return search


class DenseFlow:
    """Motion vectors and RMO of a video, frame by frame (``docs/rmo.md``).

    Parameters
    ----------
    params : RmoParams, optional
        Grid, minimum speed and tolerances; the defaults if left out.

    Notes
    -----
    Dense inverse search: Kroeger, Timofte, Dai and Van Gool (2016), "Fast optical
    flow using dense inverse search", as implemented by OpenCV.
    """

    def __init__(self, params: RmoParams | None = None) -> None:
        self.params = params or RmoParams()
        self.reset()

    def reset(self) -> None:
        """Forget all frames: the next frame is frame 0."""
        self._shape: tuple[int, int] | None = None
        # The latest two frames in grey levels, and the same two frames reduced.
        self._frames: list[Grey] = []
        self._reduced: list[Grey] = []

    def step(self, luma: NDArray[np.float32] | NDArray[np.uint8]) -> RmoMetrics | None:
        """Take the next frame and measure its radial motion opponency.

        The result is None for the first frame, and zeros for frames that are too small for flow.

        Parameters
        ----------
        luma : ndarray, shape (h, w)
            Luminance: float32 in [0, 1], or uint8.

        Raises
        ------
        FrameError
            If `luma` is not such an array, or differs in shape from the frame before.
        """
        motion = self.motion(luma)
        if motion is None:
            return None
        return rmo_metrics(motion.starts, motion.vectors, self.params)

    def motion(self, luma: NDArray[np.float32] | NDArray[np.uint8]) -> MotionVectors | None:
        """Take the next frame and return its motion vectors, without computing RMO.

        The result is None for the first frame. It has only vectors with at least the minimum speed
        and change. The errors are those of :meth:`step`, which calls this method.
        """
        _check(luma, self._shape)
        if self._shape is None:
            self._prepare(luma.shape[0], luma.shape[1])
        height, width = (side - side % self._reduction for side in luma.shape)
        part = luma[:height, :width]
        frame = np.array(part, np.uint8) if part.dtype == np.uint8 else _grey_levels(part)
        self._frames = [*self._frames[-1:], frame]
        self._reduced = [*self._reduced[-1:], _reduce(frame, self._reduction)]
        return self._vectors_where_changed() if len(self._frames) > 1 else None

    def _prepare(self, height: int, width: int) -> None:
        reduction = self.params.reduction
        while reduction > 1 and min(height, width) // reduction < SHORTEST_SIDE:
            reduction //= 2
        self._shape = (height, width)
        self._reduction = reduction
        self._spacing = self.params.grid or max(4, round(min(height, width) / 17))
        self._search = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_ULTRAFAST)
        self._search.setFinestScale(0)  # OpenCV need not reduce the frames further
        self._search.setPatchStride(6)  # denser patches take twice the time without a better result

    def _vectors_where_changed(self) -> MotionVectors:
        """Return the motion vectors; a part that changed is reduced less if it is small."""
        if min(self._reduced[1].shape) < SHORTEST_SIDE:
            return _no_vectors()
        change = cv2.absdiff(*self._reduced)
        # A cell with a large enough mean change has at least one sample with such a change.
        _, moved = cv2.threshold(change, 255.0 * self.params.minimum_change, 255, cv2.THRESH_BINARY)
        left, top, width, height = cv2.boundingRect(moved)
        if not width:
            return _no_vectors()
        sides = self._reduced[1].shape
        part = self._with_margin(top, height, sides[0]), self._with_margin(left, width, sides[1])
        reduction = self._reduction_in(part)
        if reduction == self._reduction:
            return self._vectors(self._reduced, reduction, (0, 0))
        reduced = [_reduce(frame[part], reduction) for frame in self._frames]
        return self._vectors(reduced, reduction, (part[1].start, part[0].start))

    def _with_margin(self, first: int, extent: int, side: int) -> slice:
        """Return the pixels of a range of samples with a margin at both ends, along one side."""
        margin = max(_MARGIN, (SHORTEST_SIDE - extent + 1) // 2)
        start, stop = max(0, first - margin), min(side, first + extent + margin)
        return slice(start * self._reduction, stop * self._reduction)

    def _reduction_in(self, part: tuple[slice, slice]) -> int:
        """Return the least reduction at which a part takes at most half of a frame's time."""
        height, width = (side.stop - side.start for side in part)
        most = self._reduced[1].size // 2
        reduction = 1
        while reduction < self._reduction and height * width > most * reduction**2:
            reduction *= 2
        return reduction

    def _vectors(
        self, reduced: list[Grey], reduction: int, corner: tuple[int, int]
    ) -> MotionVectors:
        before, now = reduced
        spacing = self._spacing / self._reduction  # in samples
        rows, columns = (max(1, round(side / spacing)) for side in now.shape)
        # The search tries the initial flow at every scale: with zeros, parts at rest stay at rest.
        flow = np.zeros((*now.shape, 2), np.float32)
        self._search.calc(before, now, flow)
        return sampled(before, now, flow, Cells(rows, columns, reduction, *corner), self.params)


def _no_vectors() -> MotionVectors:
    return MotionVectors(np.empty((0, 2)), np.empty((0, 2)))


def _check(luma: NDArray[np.float32] | NDArray[np.uint8], shape: tuple[int, int] | None) -> None:
    if luma.ndim != 2 or luma.dtype not in (np.float32, np.uint8) or not luma.size:
        raise FrameError(
            f"the frame is {luma.dtype} of shape {luma.shape}; "
            "give float32 luminance in [0, 1] or uint8, of shape (height, width)"
        )
    if shape is not None and luma.shape != shape:
        raise FrameError(
            f"the frame is of shape {luma.shape} after one of {shape}; call reset() between videos"
        )


def _grey_levels(luma: NDArray[np.float32] | Grey) -> Grey:
    return np.asarray(cv2.convertScaleAbs(luma, alpha=255.0), np.uint8)


# ---- Pictures between frames ---------------------------------------------------------------


class Interpolation:
    """Adds pictures between frames, so that edges move as little between them as at 30 frames/s.

    At low frame rates, and where frames are missing, a fast edge moves so far in one step that S
    does not show its direction. Optical flow tells where each pixel is between two frames. Frames
    are shifted to that place: ``earlier`` is the earlier frame alone, and ``both`` is the average
    of both frames with weights by time.

    Parameters
    ----------
    kinds : collection of str
        The pictures that are wanted: ``earlier``, ``both``, or none.

    Source: ``docs/time.md``; Kroeger et al. 2016 for the flow (dense inverse search).
    """

    def __init__(self, kinds: Collection[str]) -> None:
        self._kinds = kinds
        self._before: Luma | None = None

    def step(self, luma: Luma, intervals: float) -> Iterator[tuple[float, str, Luma]]:
        """Take the next frame; yield the pictures between it and the frame before.

        `luma` is float32, 0 to 1, and is kept, not copied. `intervals` is the time since the frame
        before. Each picture comes with its place in this time, between 0 and 1, and its kind.
        """
        before, self._before = self._before, luma
        if before is None:
            self._search = inverse_search(luma.shape, cv2.DISOPTICAL_FLOW_PRESET_FAST)
            self._flow = np.zeros((*luma.shape, 2), np.float32)
            self._places = np.mgrid[: luma.shape[0], : luma.shape[1]].astype(np.float32)
        count = int(intervals + _ROUNDED_UP) if intervals < _MOST_INTERVALS + 1 - _ROUNDED_UP else 1
        if before is None or count < 2 or min(luma.shape) < SHORTEST_SIDE or not self._kinds:
            return
        first, second = (_grey_levels(each) for each in (before, luma))
        self._flow[:] = 0  # where the search begins
        self._search.calc(first, second, self._flow)
        y, x = self._places

        def shifted(frame: Luma, passed: float) -> Luma:
            dx, dy = (np.float32(passed) * each for each in cv2.split(self._flow))
            picture = cv2.remap(
                frame, x + dx, y + dy, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
            )
            return np.asarray(picture, np.float32)

        for share in (number / count for number in range(1, count)):
            earlier = shifted(before, -share)
            if "earlier" in self._kinds:
                yield share, "earlier", earlier
            if "both" in self._kinds:
                later = shifted(luma, 1 - share)
                # In `(1 - share) * earlier + share * later` rounding would change a scene at rest.
                yield share, "both", earlier + np.float32(share) * (later - earlier)
