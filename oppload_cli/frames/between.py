"""Pictures between frames that are far apart, which the optical flow makes of the earlier one."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator

    from oppload_cli.motion.flow import Flow, Luma

# Frames that are more than 6.7 intervals apart differ too much for pictures in between.
_MOST_INTERVALS = 6
# A step of n - 0.3 to n + 0.7 intervals becomes n steps of 0.85 to 1.35 intervals.
_ROUNDED_UP = 0.3


class Interpolation:
    """Adds pictures between frames, so that edges move as little between them as at 30 frames/s.

    At low frame rates, and where frames are missing, a fast edge moves so far in one step that S
    does not show its direction. The flow tells where each pixel of the earlier frame is between two
    frames, and the earlier frame is shifted to that place.

    Source: ``docs/time.md``.
    """

    def __init__(self) -> None:
        self._before: Luma | None = None

    def step(self, luma: Luma, intervals: float, flow: Flow | None) -> Iterator[tuple[float, Luma]]:
        """Take the next frame; yield the pictures between it and the frame before.

        `luma` is float32, 0 to 1, and is kept, not copied. `intervals` is the time since the frame
        before, and `flow` the motion since then. Each picture comes with its place in this time,
        between 0 and 1.
        """
        before, self._before = self._before, luma
        count = int(intervals + _ROUNDED_UP) if intervals < _MOST_INTERVALS + 1 - _ROUNDED_UP else 1
        if before is None or count < 2 or flow is None or not flow.vectors.size:
            return
        y, x = np.mgrid[: luma.shape[0], : luma.shape[1]].astype(np.float32)
        # The samples do not reach the last rows and columns where these do not fill a square.
        column, row = ((positions + 0.5) / np.float32(flow.side) - 0.5 for positions in (x, y))
        vectors = cv2.remap(
            flow.vectors, column, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )
        dx, dy = cv2.split(vectors)
        for share in (number / count for number in range(1, count)):
            passed = np.float32(share)
            picture = cv2.remap(
                before, x - passed * dx, y - passed * dy,
                cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE,
            )  # fmt: skip
            yield share, np.asarray(picture, np.float32)
