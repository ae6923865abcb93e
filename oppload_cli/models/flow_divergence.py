"""Divergence of dense optical flow, an engineering baseline."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import cv2
import numpy as np

from oppload_cli.models.detector import AlarmRule, Detector, Response
from oppload_cli.models.dpc import check_frame
from oppload_cli.schema import Parameters, parameter

if TYPE_CHECKING:
    from typing import Any

    from numpy.typing import NDArray

    from oppload_cli.models.dpc import Map


@dataclass(frozen=True, kw_only=True)
class FlowDivergenceParams(Parameters):
    """Parameters of flow divergence.

    Examples
    --------
    >>> import oppload_cli as oppload
    >>> isinstance(oppload.parameters_of("flow_divergence"), oppload.FlowDivergenceParams)
    True
    """

    window: float = parameter(
        5 / 12,
        "side of the windows over which divergence is averaged, as a share of the working height",
        low=0.01,
        high=1,
    )


def largest_divergence(flow: NDArray[np.float32], side: int) -> float:
    """Return the largest mean divergence over all windows within a frame, at least 0.

    The divergence du/dx + dv/dy (central differences) is averaged, with its sign, over every
    square window within the frame. By Gauss's theorem this mean is the flow out of the window,
    divided by the window's area. Rotation, shear and translation cancel; expansion remains.

    Parameters
    ----------
    flow : ndarray of float32, shape (height, width, 2)
        Motion (x, y) between two pictures, in samples.
    side : int
        Side of a window in samples; it is limited to the frame's shorter side.
    """
    divergence = np.gradient(flow[..., 0], axis=1) + np.gradient(flow[..., 1], axis=0)
    height, width = divergence.shape
    side = max(1, min(side, height, width))
    sums = cv2.integral(divergence.astype(np.float64))
    windows = sums[side:, side:] - sums[:-side, side:] - sums[side:, :-side] + sums[:-side, :-side]
    return max(0.0, float(windows.max()) / side**2)


class FlowDivergence(Detector):
    """The largest mean divergence of the flow over any window of the frame.

    The flow is that of :mod:`oppload_cli.motion.flow`. The response is the expansion of areas
    between two pictures.

    Source: Kroeger et al. 2016 for the flow; ``docs/evaluation.md`` for the measure.

    Examples
    --------
    >>> import oppload_cli as oppload
    >>> oppload.FlowDivergence.meaning == oppload.detectors()["flow_divergence"].meaning
    True
    """

    name = "flow_divergence"
    label = "flow divergence"
    colour = "#E69F00"
    year = 2016
    reference = "Kroeger et al. for the flow; the divergence is defined here"
    answers_to = "expansion of textured surfaces"
    made_for = "frames from 16 px on a side, any rate"
    cost_ms = 1.1
    meaning = "optical flow: largest mean divergence over any window of the frame"
    unit = "1/frame"
    response_column = "1/frame", "largest mean divergence of optical flow over a window"
    parameters = FlowDivergenceParams
    alarm: ClassVar = AlarmRule(0.3)
    least_size = 16, 16  # inverse search refuses smaller frames

    params: FlowDivergenceParams

    def __init__(
        self, shape: tuple[int, int], params: FlowDivergenceParams | None = None, **others: Any
    ) -> None:
        super().__init__(shape, params, **others)
        self._flow = self.layers.flow()
        self.reset()

    def reset(self) -> None:
        """Forget all frames: the next frame is frame 0."""
        self._frames = 0
        self._flow.reset()

    def step(self, luma: Map) -> Response | None:
        """Take the next frame; None for the first one."""
        check_frame(luma, self.shape)
        flow, self._frames = self._flow.of(luma, self._frames), self._frames + 1
        if flow is None:
            return None
        side = round(self.params.window * min(self.shape) / flow.side)
        return Response(largest_divergence(flow.vectors / np.float32(flow.side), side))
