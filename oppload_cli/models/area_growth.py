"""Growth of the changed area, an engineering baseline for cameras that stand still."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import cv2
import numpy as np

from oppload_cli.models.detector import AlarmRule, Detector, Response, inner
from oppload_cli.models.dpc import grey_levels
from oppload_cli.schema import Parameters, parameter

if TYPE_CHECKING:
    from typing import Any

    from numpy.typing import NDArray

    from oppload_cli.models.dpc import Map

_SPAN = 3  # frames over which growth is measured


@dataclass(frozen=True, kw_only=True)
class AreaGrowthParams(Parameters):
    """Parameters of area growth."""

    least: float = parameter(
        0.1, "luminance difference from frame 0 above which a pixel counts", low=0, high=1
    )


@dataclass(frozen=True)
class AreaGrowthResponse(Response):
    """The response of area growth, with its inner values."""

    area: int = inner(0, "px", "count of the pixels that differ from frame 0")
    size: float = inner(0.0, "px", "square root of the area")
    dsize: float = inner(0.0, "px/frame", "growth of the size over 3 frames")
    growth: float = inner(0.0, "1/frame", "growth of the size, divided by the size")
    frame_diff: float = inner(0.0, "0 to 1", "mean absolute difference from the frame before")


class AreaGrowth(Detector):
    """The relative growth of the area that differs from frame 0.

    The area is the number of pixels with ``|L(t) - L(0)| > least`` (0.1), and ``size =
    sqrt(area)``. The response is ``(size(t) - size(t-3)) / 3``, divided by the size: 1 / (time to
    contact in frames). The camera must stand still, and the scene must be empty in frame 0.

    Source: ``docs/detectors.md``.
    """

    name = "area_growth"
    label = "area growth"
    colour = "#997225"
    meaning = "relative growth of the area that differs from the first frame"
    unit = "1/frame"
    response_column = "1/frame", "growth of the size, divided by the size, at least 0"
    responses = AreaGrowthResponse
    parameters = AreaGrowthParams
    alarm: ClassVar = AlarmRule(0.1)
    evaluated = False
    reference = "defined here"
    answers_to = "areas that grow before a still camera, by light or by approach"
    made_for = "any size and rate, a still camera"
    cost_ms = 0.03
    warm_up = 0

    params: AreaGrowthParams

    def __init__(
        self, shape: tuple[int, int], params: AreaGrowthParams | None = None, **others: Any
    ) -> None:
        super().__init__(shape, params, **others)
        self.reset()

    def reset(self) -> None:
        """Forget all frames: the next frame is frame 0."""
        self._start: NDArray[np.uint8] | None = None
        self._area = 0

    def at_rest(self) -> AreaGrowthResponse:
        """Return the response, 0, to a frame in which nothing changed; the area stays."""
        return AreaGrowthResponse(0.0, area=self._area, size=math.sqrt(self._area))

    def step(self, luma: Map) -> AreaGrowthResponse:
        """Take the next frame."""
        now = grey_levels(luma, self.shape)
        if self._start is None:
            self._start = self._before = now
            self._sizes: deque[float] = deque(maxlen=_SPAN + 1)
        # Grey levels are integers: a level is above the threshold if it is above its integer part.
        least = math.floor(self.params.least * 255)
        self._area = int(np.count_nonzero(cv2.absdiff(now, self._start) > least))
        difference = float(cv2.norm(now, self._before, cv2.NORM_L1)) / (255 * now.size)
        self._before = now
        size = math.sqrt(self._area)
        self._sizes.append(size)
        before = self._sizes[0] if len(self._sizes) > _SPAN else size
        dsize = (size - before) / _SPAN
        # Not dsize / size: from a size of 0 the growth is the same for each size, without a
        # rounding error that would rank approaches and controls.
        growth = (1 - before / size) / _SPAN if size else 0.0
        values = self._area, size, dsize, growth, difference
        return AreaGrowthResponse(max(growth, 0.0), None, *values)
