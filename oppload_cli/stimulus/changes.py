"""What changes an object has: growth of its size, change of its brightness."""

from __future__ import annotations

from dataclasses import dataclass

from oppload_cli.errors import StimulusError
from oppload_cli.stimulus.declare import Table, key
from oppload_cli.stimulus.tables import check_times


@dataclass(frozen=True, kw_only=True)
class Growth(Table):
    """How the size of a figure changes."""

    kind: str = key(
        "edge-speed: constant speed of the edge; approach: constant approach speed; "
        "steps: sudden sizes",
        choices=("edge-speed", "approach", "steps"),
    )
    speed_deg_s: float | None = key(
        "speed of each moving edge",
        default=None,
        unit="deg/s",
        above=0,
        high=100_000,
        kinds=("edge-speed",),
        needed_by=("edge-speed",),
    )
    end_deg: float | None = key(
        "size to grow (or shrink) to, then held; without it the figure grows throughout",
        default=None,
        unit="deg",
        low=0,
        high=360,
        kinds=("edge-speed",),
    )
    sides: str = key(
        "the ends of a bar that move: both, forward (along the axis) or backward",
        default="both",
        choices=("both", "forward", "backward"),
        kinds=("edge-speed",),
    )
    l_over_v_ms: float | None = key(
        "half size over approach speed: size = 2 atan((l/v) / (contact - t))",
        default=None,
        unit="ms",
        above=0,
        high=1e6,
        kinds=("approach",),
        needed_by=("approach",),
    )
    contact_s: float | None = key(
        "time of contact, in seconds of the clip; default: the end of the motion",
        default=None,
        unit="s",
        low=0,
        high=10_000,
        kinds=("approach",),
    )
    least_deg: float = key(
        "shown at least at this size (the time course is cut, not shifted)",
        default=0.0,
        unit="deg",
        low=0,
        high=180,
        kinds=("approach",),
    )
    most_deg: float = key(
        "shown at most at this size (the time course is cut, not shifted)",
        default=180.0,
        unit="deg",
        above=0,
        high=180,
        kinds=("approach",),
    )
    sizes_deg: tuple[float, ...] = key(
        "sizes to step to", default=(), unit="deg", low=0, high=360, kinds=("steps",)
    )
    times_s: tuple[float, ...] = key(
        "when it steps, after the start of the motion",
        default=(),
        unit="s",
        low=0,
        high=3600,
        kinds=("steps",),
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.least_deg >= self.most_deg:
            raise StimulusError("least_deg must be below most_deg")
        if self.kind == "steps":
            check_times(self.times_s, self.sizes_deg, "times_s", "sizes_deg")


@dataclass(frozen=True, kw_only=True)
class Brightness(Table):
    """How the luminance of an object changes; times count from the start of its motion."""

    kind: str = key(
        "step: at once; ramp: evenly; flicker: to and fro", choices=("step", "ramp", "flicker")
    )
    to: float = key("the other luminance", low=0, high=1)
    start_s: float = key("when the change starts", default=0.0, unit="s", low=0, high=3600)
    duration_s: float | None = key(
        "how long the ramp takes; default: the rest of the motion",
        default=None,
        unit="s",
        above=0,
        high=3600,
        kinds=("ramp",),
    )
    frequency_hz: float | None = key(
        "cycles per second",
        default=None,
        unit="Hz",
        above=0,
        high=5000,
        kinds=("flicker",),
        needed_by=("flicker",),
    )
    waveform: str = key(
        "square or sine",
        default="square",
        choices=("square", "sine"),
        kinds=("flicker",),
    )
