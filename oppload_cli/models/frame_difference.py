"""Frame difference, the plainest baseline: the mean of P over the frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from oppload_cli.models.detector import AlarmRule, Detector, Response
from oppload_cli.schema import Parameters

if TYPE_CHECKING:
    from typing import Any

    from oppload_cli.models.dpc import Map


@dataclass(frozen=True, kw_only=True)
class FrameDifferenceParams(Parameters):
    """Frame difference has no parameters.

    Examples
    --------
    >>> import oppload_cli as oppload
    >>> isinstance(oppload.parameters_of("frame_difference"), oppload.FrameDifferenceParams)
    True
    """


class FrameDifference(Detector):
    """The mean of ``P(t) = |L(t) - L(t-1)|`` over the frame (``docs/model.md``, section 1).

    It distinguishes motion from rest, but not the directions of motion.

    Examples
    --------
    >>> import numpy as np, oppload_cli as oppload
    >>> model = oppload.FrameDifference((2, 2))
    >>> black, white = np.zeros((2, 2), np.float32), np.ones((2, 2), np.float32)
    >>> model.step(black), model.step(white).response
    (None, 1.0)
    """

    name = "frame_difference"
    label = "frame difference"
    colour = "#56B4E9"
    reference = "defined here"
    answers_to = "every change of luminance"
    made_for = "any size and rate"
    cost_ms = 0.04
    meaning = "frame difference: mean of P over the frame"
    unit = "mean of P"
    response_column = "0 to 1", "mean over the frame of P, the absolute luminance change"
    parameters = FrameDifferenceParams
    alarm: ClassVar = AlarmRule(0.05)

    def __init__(
        self, shape: tuple[int, int], params: FrameDifferenceParams | None = None, **others: Any
    ) -> None:
        super().__init__(shape, params, **others)
        self._photoreceptors = self.layers.photoreceptors()

    def reset(self) -> None:
        """Forget all frames: the next frame is frame 0."""
        self._photoreceptors.reset()

    def step(self, luma: Map) -> Response | None:
        """Take the next frame; None for the first one."""
        self._photoreceptors.step(luma)
        change = self._photoreceptors.layer.luma_change
        return None if change is None else Response(change)
