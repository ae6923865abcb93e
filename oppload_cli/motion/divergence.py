"""Divergence of dense optical flow: a plain baseline for looming."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np

from oppload_cli.errors import FrameError

if TYPE_CHECKING:
    from numpy.typing import NDArray

# Inverse search refuses smaller frames.
SHORTEST_SIDE = 16
# Side of a window over the height: 100 px at 240, as OppLoD's receptive field.
WINDOW = 5 / 12


class FlowDivergence:
    """The largest mean divergence of the flow over any window of the frame.

    Dense inverse search flow (OpenCV's preset "ultrafast") between consecutive
    frames; its divergence du/dx + dv/dy by central differences, averaged with its
    sign over every square window that lies within the frame. By Gauss's theorem the
    mean is the flow out of the window over its area, so that rotation, shear and
    translation cancel and an expanding surface remains.

    Source: Kroeger et al. 2016 for the flow; ``docs/evaluation.md`` for the measure.
    """

    def __init__(self) -> None:
        self._search = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_ULTRAFAST)
        self._last: NDArray[np.uint8] | None = None

    def step(self, luma: NDArray[np.float32]) -> float | None:
        """Take the next frame.

        Parameters
        ----------
        luma : ndarray of float32, shape (height, width)
            Luminance, 0 to 1.

        Returns
        -------
        float or None
            Rate of expansion of areas, 1/frame, at least 0; None for the first frame,
            0 for a frame under 16 px on a side.

        Raises
        ------
        FrameError
            If the frame is not of the shape of the one before.
        """
        now = cv2.convertScaleAbs(luma, alpha=255.0).astype(np.uint8)
        before, self._last = self._last, now
        if before is None:
            return None
        if before.shape != now.shape:
            raise FrameError(
                f"the frame is of shape {now.shape} after one of {before.shape}; "
                "use a new FlowDivergence for each video"
            )
        if min(now.shape) < SHORTEST_SIDE:
            return 0.0
        flow = np.zeros((*now.shape, 2), np.float32)
        self._search.calc(before, now, flow)
        return largest_divergence(flow, round(WINDOW * now.shape[0]))


def largest_divergence(flow: NDArray[np.float32], side: int) -> float:
    """Return the largest mean divergence over the windows within a frame.

    Parameters
    ----------
    flow : ndarray of float32, shape (height, width, 2)
        Motion (x, y) in px/frame.
    side : int
        Of a window in px; at most the frame's shorter side is used.

    Returns
    -------
    float
        In 1/frame, at least 0.
    """
    divergence = np.gradient(flow[..., 0], axis=1) + np.gradient(flow[..., 1], axis=0)
    height, width = divergence.shape
    side = max(1, min(side, height, width))
    sums = cv2.integral(divergence.astype(np.float64))
    windows = sums[side:, side:] - sums[:-side, side:] - sums[side:, :-side] + sums[:-side, :-side]
    return max(0.0, float(windows.max()) / side**2)
