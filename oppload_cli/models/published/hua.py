"""A bio-inspired LPLC2 network about the centre of view (after Hua et al. 2022)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from oppload_cli.models.detector import Column, Detector, Response
from oppload_cli.models.presets import DEFAULT_PRESET
from oppload_cli.models.published.hua_motion import FIRST_FRAME, HuaMotion
from oppload_cli.models.published.parts import USUAL_RATE
from oppload_cli.schema import Parameters, parameter

if TYPE_CHECKING:
    from typing import Any

    from oppload_cli.models.dpc import Map

LOW_PASS_MS = 30.0
QUADRANTS = "right_down", "left_down", "left_up", "right_up"


@dataclass(frozen=True, kw_only=True)
class HuaFixedParams(Parameters):
    """Parameters of the network after Hua et al."""

    low_pass_ms: float = parameter(LOW_PASS_MS, "time constant of the delay", unit="ms", low=0)


@dataclass(frozen=True, kw_only=True)
class HuaLiteralParams(HuaFixedParams):
    """Parameters of the network after Hua et al., as its authors coded it."""


@dataclass(frozen=True)
class HuaResponse(Response):
    """The answer of the network to one frame; see `HuaFixed.details`."""

    q_right_down: float = 0.0
    q_left_down: float = 0.0
    q_left_up: float = 0.0
    q_right_up: float = 0.0
    product: float = 0.0


class HuaFixed(Detector):
    """Motion out of the middle of the frame in all four quadrants at once.

    Nine functions of the authors' code were never published: the assumptions that stand for
    them are listed in ``docs/detectors.md``. This variant takes the vertical difference the
    right way round, and each frame by itself.

    Source: after Hua et al. 2022 and the published part of the authors' code.
    """

    name = "hua_fixed"
    label = "Hua et al."
    colour = "#B2182B"
    meaning = "LPLC2 network about the centre of view (after Hua et al. 2022), corrected"
    response_column = "", "geometric mean of the four quadrants, each at least 0"
    details = (
        *(Column(f"q_{each}", "", f"quadrant {each.replace('_', ' ')}") for each in QUADRANTS),
        Column("product", "", "product of the four quadrants, each at least 0"),
    )
    year: ClassVar[int | None] = 2022
    reference = "after Hua et al. 2022"
    answers_to = "motion out of the middle of the frame on all four sides"
    made_for = "an object in the middle of view, 30 frames/s"
    cost_ms = 4.5
    least_size = (8, 8)
    evaluated = False
    answers = HuaResponse
    parameters: ClassVar[type[Parameters]] = HuaFixedParams
    alarm_floors: ClassVar = {DEFAULT_PRESET: 7000.0}
    warm_up = FIRST_FRAME

    params: HuaFixedParams

    way_below: ClassVar[int] = 0  # of vertical motion, rewarded below the middle: downwards

    def __init__(
        self, shape: tuple[int, int], params: Parameters | None = None, **others: Any
    ) -> None:
        super().__init__(shape, params, **others)
        interval_ms = 1000 / (self.frame_rate or USUAL_RATE)
        constants = shape, self.params.low_pass_ms, interval_ms
        self._motion = self.layers.other(("hua", *constants), lambda: HuaMotion(*constants))
        self._sums = np.zeros(4)

    def reset(self) -> None:
        """Forget all frames: the next frame is frame 0."""
        self._motion.reset()
        self._sums = np.zeros(4)

    def step(self, luma: Map) -> HuaResponse | None:
        """Take the next frame; None for the first two."""
        if not self._motion.step(luma):
            return None
        self._sums = self._quadrants()
        product = float(np.prod(np.maximum(self._sums, 0)))
        named = {f"q_{name}": float(each) for name, each in zip(QUADRANTS, self._sums, strict=True)}
        return HuaResponse(product**0.25, None, product=product, **named)

    def _quadrants(self) -> Any:
        """Return the sums of the outward motion over the quadrants of `QUADRANTS`."""
        across, down = self._motion.layer.sums
        below, above = self.way_below, 1 - self.way_below
        return np.array(
            [
                across[1, 1, 0] + down[1, 1, below],
                across[1, 0, 1] + down[1, 0, below],
                across[0, 0, 1] + down[0, 0, above],
                across[0, 1, 0] + down[0, 1, above],
            ]
        )


class HuaLiteral(HuaFixed):
    """The network as its authors coded it: vertical motion rewarded inward, sums never reset."""

    name = "hua_literal"
    label = "Hua et al. (literal)"
    colour = "#FDAE61"
    meaning = "LPLC2 network about the centre of view (after Hua et al. 2022), as coded"
    parameters: ClassVar[type[Parameters]] = HuaLiteralParams
    alarm_floors: ClassVar = {DEFAULT_PRESET: 100_000.0}

    way_below: ClassVar[int] = 1

    def _quadrants(self) -> Any:
        return self._sums + super()._quadrants()
