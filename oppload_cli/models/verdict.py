"""What a judge of opposing motion is, and what it says."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, Protocol

if TYPE_CHECKING:
    from collections.abc import Mapping

    from oppload_cli.models.kernels import Map
    from oppload_cli.models.presynaptic import Live
    from oppload_cli.models.units import UnitMaps


class Verdict(NamedTuple):
    """What a judge says of one frame.

    Attributes
    ----------
    response : float
        The enhanced response of the frame, at least 0.
    opponency : float
        R of the winning unit before enhancing, at least 0.
    centre_x, centre_y : float
        Centre of the winning unit in working pixels (pixel i covers [i, i + 1)).
    """

    response: float
    opponency: float
    centre_x: float
    centre_y: float


class Judge(Protocol):
    """The opposing motion judgement of one preset.

    Attributes
    ----------
    maps : UnitMaps
        What it saw in the latest frame.
    """

    maps: UnitMaps

    def judge(self, pathways: Mapping[int, Map], live: Live | None = None) -> Verdict:
        """Judge the S maps of the four pathways, by direction in degrees.

        `live` tells where they may be above 0.
        """

    def reset(self) -> None:
        """Forget the frames that have passed."""
