"""Pictures between frames that are more than an interval apart (``docs/time.md``)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np

from oppload_cli.models.dpc import grey_levels

if TYPE_CHECKING:
    from collections.abc import Iterator

    from oppload_cli.models.dpc import Map

_MOST = 6  # largest number of intervals in a step; frames that are further apart differ too much
_ROUNDED_UP = 0.3  # a step of n - 0.3 to n + 0.7 intervals becomes n steps of 0.85 to 1.35
_LEAST_SIDE = 16  # px; OpenCV's inverse search refuses smaller frames


class Interpolation:
    """Adds pictures between frames, so that edges move as little between them as at 30 frames/s.

    At low frame rates, and where frames are missing, a fast edge moves so far in one step that S
    does not show its direction. Optical flow tells where each pixel is between two frames. Both
    frames are shifted to that place, and averaged with weights by time.

    Source: ``docs/time.md``; Kroeger et al. 2016 for the flow (dense inverse search).
    """

    def __init__(self) -> None:
        self._search = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_FAST)
        self._before: Map | None = None

    def step(self, luma: Map, intervals: float) -> Iterator[tuple[float, Map]]:
        """Take the next frame; yield the pictures between it and the frame before.

        `luma` is float32, 0 to 1, and is kept, not copied. `intervals` is the time since the frame
        before. Each picture comes with its place in this time, between 0 and 1.
        """
        before, self._before = self._before, luma
        count = int(intervals + _ROUNDED_UP) if intervals < _MOST + 1 - _ROUNDED_UP else 1
        if before is None or count < 2 or min(luma.shape) < _LEAST_SIDE:
            return
        flow = np.zeros((*luma.shape, 2), np.float32)
        first, second = (grey_levels(each, luma.shape) for each in (before, luma))
        self._search.calc(first, second, flow)
        y, x = np.mgrid[: luma.shape[0], : luma.shape[1]].astype(np.float32)
        for share in (number / count for number in range(1, count)):
            picture = np.zeros_like(luma)
            for frame, passed, weight in (before, -share, 1 - share), (luma, 1 - share, share):
                dx, dy = np.float32(passed) * flow[..., 0], np.float32(passed) * flow[..., 1]
                shifted = cv2.remap(
                    frame, x + dx, y + dy, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
                )
                picture += np.float32(weight) * shifted
            yield share, picture
