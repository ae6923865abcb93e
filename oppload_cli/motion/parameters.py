"""Parameters of radial motion opponency (RMO)."""

from __future__ import annotations

from dataclasses import dataclass

from oppload_cli.parameters import Parameters, parameter


@dataclass(frozen=True, kw_only=True)
class RmoParams(Parameters):
    """What counts as motion, as opposite and as outward (``docs/rmo.md``).

    The first four concern the vectors taken from a video, the others the metric.
    """

    grid: int | None = parameter(
        None,
        "distance between motion vectors; default 1/17 of the working height",
        unit="px",
        low=4,
    )
    reduction: int = parameter(
        4, "the flow is computed on frames reduced by this factor", choices=(1, 2, 4)
    )
    minimum_speed: float = parameter(
        0.2, "slower motion vectors are dropped", unit="px/frame", low=0.0
    )
    minimum_change: float = parameter(
        0.004,
        "a vector is dropped where its cell changes less on average: there the flow is guessed "
        "from its neighbours",
        unit="luminance",
        low=0.0,
        high=1.0,
    )
    opposite_tolerance: float = parameter(
        30.0,
        "largest departure of two vectors from antiparallel (theta_T)",
        unit="deg",
        low=0,
        high=90,
    )
    outward_tolerance: float = parameter(
        45.0,
        "largest angle between a pair's common line and the line through its starts (theta_R); "
        "90 is the paper's literal reading",
        unit="deg",
        low=0,
        high=90,
    )
    sides: int = parameter(
        2,
        "sides of the centre over which the symmetric length is counted; "
        "1 is the paper's literal integral",
        choices=(1, 2),
    )
