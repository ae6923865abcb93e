"""The objects of a protocol: shapes, patterns and pictures, with their motion and changes."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Any

from oppload_cli.errors import StimulusError
from oppload_cli.schema import REQUIRED, DeclaredTable, parameter
from oppload_cli.stimulus.courses import Course

GRATINGS = ("square-grating", "sine-grating", "plaid")
_PATTERNS = (*GRATINGS, "texture", "dots")
FIELDS = ("field", *_PATTERNS)  # fill the display or an aperture
SIZED = ("disk", "square", "bar", "cross", "ring", "patch")  # shapes that have a size
PICTURE = "picture"
KINDS = (*SIZED, "edge", *FIELDS, PICTURE)
DRAWINGS = ("ball", "box", "car", "bird")
# These shapes loom when they grow. A bar or a cross grows along lines, not as a complete outline.
LOOMING = ("disk", "square", "ring", "patch")
_TEXTURED = ("texture", "patch")


@dataclass(frozen=True, kw_only=True)
class Motion(DeclaredTable):
    """How a shape, a pattern or the complete scene moves."""

    speed_deg_s: float = parameter(0.0, "speed", low=0, high=100_000)
    direction_deg: float | None = parameter(None, "direction of the movement; default: the axis")
    rotation_deg_s: float = parameter(
        0.0, "speed of turning, counter-clockwise", low=-100_000, high=100_000
    )
    zoom_per_s: float = parameter(
        0.0,
        "growth rate of a pattern's scale: exp(zoom_per_s t); dots keep their size, so that their "
        "density changes; patterns only",
        low=-20,
        high=20,
    )
    shake_deg: float = parameter(0.0, "RMS distance of a shake from its middle", low=0, high=90)
    shake_hz: float = parameter(4.0, "middle frequency of the shake", above=0, high=500)
    path_deg: tuple[tuple[float, float], ...] = parameter(
        (), "points [right, up] of a path, added to centre_deg, joined by straight lines"
    )
    path_s: tuple[float, ...] = parameter(
        (), "when each point is reached, from the start of the motion", low=0, high=3600
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.path_deg or self.path_s:
            _check_times(self.path_s, self.path_deg, "path_s", "path_deg")


@dataclass(frozen=True, kw_only=True)
class Growth(DeclaredTable):
    """How the size of a shape changes."""

    kind: str = parameter(
        REQUIRED,
        "edge-speed: constant speed of the edge; approach: constant approach speed; "
        "steps: sudden sizes; path: sizes joined by straight lines, from size_deg on",
        choices=("edge-speed", "approach", "steps", "path"),
    )
    speed_deg_s: float | None = parameter(
        None, "speed of each moving edge", above=0, high=100_000, needed_by=("edge-speed",)
    )
    end_deg: float | None = parameter(
        None,
        "size to grow (or shrink) to, then held; without it the shape grows until the motion ends",
        low=0,
        high=360,
        kinds=("edge-speed",),
    )
    sides: str = parameter(
        "both",
        "the ends of a bar that move: both, forward (along the axis) or backward",
        choices=("both", "forward", "backward"),
        kinds=("edge-speed",),
    )
    l_over_v_ms: float | None = parameter(
        None,
        "half size over approach speed: size = 2 atan((l/v) / (contact - t))",
        above=0,
        high=1e6,
        needed_by=("approach",),
    )
    contact_s: float | None = parameter(
        None,
        "time of contact, in seconds of the clip; default: the end of the motion",
        low=0,
        high=10_000,
        kinds=("approach",),
    )
    least_deg: float = parameter(
        0.0,
        "smallest size shown; a smaller size is shown as this one, and times stay the same",
        low=0,
        high=180,
        kinds=("approach",),
    )
    most_deg: float = parameter(
        180.0,
        "largest size shown; a larger size is shown as this one, and times stay the same",
        above=0,
        high=180,
        kinds=("approach",),
    )
    sizes_deg: tuple[float, ...] = parameter(
        (), "sizes to step to, or to reach", low=0, high=360, kinds=("steps", "path")
    )
    times_s: tuple[float, ...] = parameter(
        (),
        "when the size steps, or is reached, from the start of the motion",
        low=0,
        high=3600,
        kinds=("steps", "path"),
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.least_deg >= self.most_deg:
            raise StimulusError("least_deg must be below most_deg")
        if self.kind in {"steps", "path"}:
            _check_times(self.times_s, self.sizes_deg, "times_s", "sizes_deg")
        if self.kind == "path" and self.times_s[0] == 0:
            raise StimulusError("times_s of a path must begin after 0; its first size is size_deg")


@dataclass(frozen=True, kw_only=True)
class Brightness(DeclaredTable):
    """How the luminance of an object changes; times count from the start of its motion."""

    kind: str = parameter(
        REQUIRED,
        "step: at once; ramp: evenly; flicker: back and forth; approach: as the mean over an area "
        "in which an object of the luminance `to` approaches",
        choices=("step", "ramp", "flicker", "approach"),
    )
    to: float = parameter(REQUIRED, "luminance to which it changes", low=0, high=1)
    start_s: float = parameter(
        0.0, "when the change starts", low=0, high=3600, kinds=("step", "ramp", "flicker")
    )
    duration_s: float | None = parameter(
        None,
        "duration of the ramp; default: the rest of the motion",
        above=0,
        high=3600,
        kinds=("ramp",),
    )
    frequency_hz: float | None = parameter(
        None, "cycles per second", above=0, high=5000, needed_by=("flicker",)
    )
    waveform: str = parameter(
        "square", "square or sine", choices=("square", "sine"), kinds=("flicker",)
    )
    l_over_v_ms: float | None = parameter(
        None, "half size over speed of the approach", above=0, high=1e6, needed_by=("approach",)
    )
    contact_s: float | None = parameter(
        None,
        "time of contact, in seconds of the clip; default: the end of the motion",
        low=0,
        high=10_000,
        kinds=("approach",),
    )
    least_deg: float = parameter(
        0.0, "smallest size of the approach", low=0, high=180, kinds=("approach",)
    )
    most_deg: float | None = parameter(
        None,
        "largest size of the approach, at which the luminance is `to`; usually size_deg",
        above=0,
        high=180,
        needed_by=("approach",),
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.most_deg is not None and self.least_deg >= self.most_deg:
            raise StimulusError("least_deg must be below most_deg")


@dataclass(frozen=True, kw_only=True)
class Object(DeclaredTable):
    """One object: a shape (disk, bar, ...) or a pattern that fills the display."""

    id: str = parameter(REQUIRED, "its name in the ground truth, in sweeps and in --change")
    kind: str = parameter(REQUIRED, "its shape or pattern", choices=KINDS)
    luminance: float | None = parameter(
        None, "luminance; of a pattern the mean; default 0, of a pattern 0.5", low=0, high=1
    )
    size_deg: float | None = parameter(
        None,
        "diameter (disk, ring, patch), side (square), length along the axis (bar, cross); "
        "of a pattern the diameter of a round aperture, which stays while the pattern moves",
        low=0,
        high=360,
        kinds=(*SIZED, *FIELDS),
    )
    width_deg: float | None = parameter(
        None,
        "size across the axis (bar), width of the arms (cross), thickness (ring)",
        above=0,
        high=360,
        needed_by=("bar", "cross", "ring"),
    )
    axis_deg: float = parameter(
        0.0, "orientation: the line along which a bar grows, an edge or a grating moves"
    )
    centre_deg: tuple[float, float] = parameter(
        (0.0, 0.0),
        "position [right, up] at the start; of an edge a point on it",
        low=-360,
        high=360,
    )
    onset_s: float = parameter(
        0.0, "delay from the end of the pause to the start of its motion", low=0, high=3600
    )
    duration_s: float | None = parameter(
        None,
        "duration of its motion; default: until the end of the clip's motion",
        above=0,
        high=3600,
    )
    appears: str = parameter(
        "start",
        "visible from the start of the clip, or from the onset of its motion",
        choices=("start", "onset"),
    )
    vanishes: str = parameter(
        "never", "never, or at the end of its motion", choices=("never", "end")
    )
    reverse: bool = parameter(False, "play its growth and motion backwards (receding)")
    contrast: float = parameter(
        1.0,
        "grating, plaid: Michelson contrast; texture, patch: RMS contrast; dots: luminance "
        "of the dots divided by that of the ground, minus 1 (negative: dark dots)",
        low=-1,
        high=10,
        kinds=(*_PATTERNS, "patch"),
    )
    period_deg: float | None = parameter(
        None, "length of a cycle", low=0.001, high=360, needed_by=GRATINGS
    )
    phase_deg: float = parameter(
        0.0,
        "phase at the centre, 360 to a cycle; at 0 the luminance rises through the mean, along "
        "the axis",
        kinds=GRATINGS,
    )
    plaid_deg: float = parameter(
        90.0, "angle between the two gratings", above=0, high=180, kinds=("plaid",)
    )
    exponent: float = parameter(
        1.0, "amplitude of the texture falls as 1/f to this power", low=0, high=4, kinds=_TEXTURED
    )
    finest_deg: float | None = parameter(
        None,
        "shortest wavelength in the texture; default: 4 px (patch: an eighth of its size)",
        low=0.001,
        high=360,
        kinds=("texture",),
    )
    dot_deg: float | None = parameter(
        None, "diameter of a dot", low=0.001, high=90, needed_by=("dots",)
    )
    dots_per_100deg2: float | None = parameter(
        None, "number of dots in 100 square degrees", above=0, high=10_000, needed_by=("dots",)
    )
    coherence: float = parameter(
        1.0,
        "share of the dots that move together; each other dot moves as far in a direction of its "
        "own, but takes part in a zoom and a turn",
        low=0,
        high=1,
        kinds=("dots",),
    )
    file: str | None = parameter(
        None, "image with transparency; give this or drawing", kinds=(PICTURE,)
    )
    drawing: str | None = parameter(
        None, "drawn by the package; give this or file", choices=DRAWINGS, kinds=(PICTURE,)
    )
    size_m: float | None = parameter(
        None, "longer side of the opaque part", above=0, high=1000, needed_by=(PICTURE,)
    )
    relative_luminance: float | None = parameter(
        None,
        "mean luminance divided by that of the background in the first frame; default: the "
        "picture's own luminance",
        low=0,
        high=100,
        kinds=(PICTURE,),
    )
    shadow: float | None = parameter(
        None,
        "share of light that its shadow takes from the ground below it; default 0",
        low=0,
        high=1,
        kinds=(PICTURE,),
    )
    course: Course | None = parameter(
        None, "how it moves in three dimensions", needed_by=(PICTURE,)
    )
    growth: Growth | None = parameter(None, "how its size changes", kinds=SIZED)
    motion: Motion | None = parameter(None, "how it moves")
    brightness: Brightness | None = parameter(None, "how its luminance changes")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.luminance is None:
            patterned = self.kind in (*_PATTERNS, "patch")
            object.__setattr__(self, "luminance", 0.5 if patterned else 0.0)
        self._check_size()
        self._check_contrast()
        if self.kind == PICTURE:
            self._check_picture()
        if self.motion is not None and self.motion.zoom_per_s and self.kind not in _PATTERNS:
            raise StimulusError(
                f"motion: zoom_per_s is for patterns, not for kind '{self.kind}'; use growth"
            )

    @property
    def base_luminance(self) -> float:
        """The luminance; never None, because an object without one has a default."""
        return self.luminance if self.luminance is not None else 0.0

    def _check_size(self) -> None:
        approaching = self.growth is not None and self.growth.kind == "approach"
        if approaching and self.size_deg is not None:
            raise StimulusError(
                "size_deg does not go with growth kind 'approach', which sets the size; remove it"
            )
        if self.kind in SIZED and self.size_deg is None and not approaching:
            raise StimulusError(f"kind '{self.kind}' needs size_deg; add it")
        if self.growth is not None and self.growth.sides != "both" and self.kind != "bar":
            raise StimulusError(
                f"growth: sides = '{self.growth.sides}' is for kind 'bar', not '{self.kind}'"
            )

    def _check_picture(self) -> None:
        if (self.file is None) == (self.drawing is None):
            raise StimulusError("kind 'picture' needs either file or drawing, and only one")
        others = dict.fromkeys(("motion", "brightness", "reverse", "axis_deg"), "course")
        others |= {"centre_deg": "course", "luminance": "relative_luminance"}
        for key, other in others.items():
            if getattr(self, key) not in {None, 0, (0.0, 0.0)}:
                raise StimulusError(f"{key} does not go with kind 'picture'; use {other}")

    def _check_contrast(self) -> None:
        mean, contrast = self.base_luminance, self.contrast
        if self.kind in (*GRATINGS, *_TEXTURED) and contrast < 0:
            raise StimulusError(f"contrast of a {self.kind} must be at least 0, not {contrast:g}")
        # 1e-9: the products and differences of these numbers are rounded.
        if self.kind in GRATINGS and contrast * mean > min(mean, 1 - mean) + 1e-9:
            raise StimulusError(
                f"contrast = {contrast:g} takes luminance = {mean:g} out of 0 to 1; lower one of "
                "them"
            )
        if self.kind == "dots" and mean * (1 + contrast) > 1:
            raise StimulusError(
                f"contrast = {contrast:g} makes the dots brighter than 1 at luminance = {mean:g}; "
                "lower one of them"
            )


def _check_times(
    times: tuple[float, ...], values: tuple[Any, ...], times_key: str, values_key: str
) -> None:
    """Check that times rise, and that there is one value for each time."""
    if not times or len(times) != len(values):
        raise StimulusError(
            f"{times_key} and {values_key} must be lists of the same length, of at least one "
            f"value, not {len(times)} and {len(values)} values"
        )
    if any(after <= before for before, after in itertools.pairwise(times)):
        raise StimulusError(f"{times_key} must rise from value to value")
