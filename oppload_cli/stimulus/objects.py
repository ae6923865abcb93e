"""The objects of a protocol: figures and patterns."""

from __future__ import annotations

from dataclasses import dataclass

from oppload_cli.errors import StimulusError

# the annotations are resolved at run time
from oppload_cli.stimulus.changes import Brightness, Growth  # noqa: TC001
from oppload_cli.stimulus.declare import Table, key
from oppload_cli.stimulus.tables import Motion  # noqa: TC001

GRATINGS = ("square-grating", "sine-grating", "plaid")
PATTERNS = (*GRATINGS, "texture", "dots")
FIELDS = ("field", *PATTERNS)
SIZED = ("disk", "square", "bar", "cross", "ring", "patch")
FIGURES = (*SIZED, "edge")
KINDS = (*FIGURES, *FIELDS)
TEXTURED = ("texture", "patch")
# A figure looms where its whole outline grows; a bar or a cross grows along lines only.
LOOMING = ("disk", "square", "ring", "patch")


@dataclass(frozen=True, kw_only=True)
class Object(Table):
    """One object: a figure (disk, bar, ...) or a pattern that fills the display."""

    id: str = key("its name in the ground truth, in sweeps and in --set")
    kind: str = key("what it is", choices=KINDS)
    luminance: float | None = key(
        "luminance; of a pattern the mean; default 0, of a pattern 0.5",
        default=None,
        low=0,
        high=1,
    )
    size_deg: float | None = key(
        "diameter (disk, ring, patch), side (square), length along the axis (bar, cross); "
        "of a pattern the diameter of a round aperture",
        default=None,
        unit="deg",
        low=0,
        high=360,
        kinds=(*SIZED, *FIELDS),
    )
    width_deg: float | None = key(
        "size across the axis (bar), width of the arms (cross), thickness (ring)",
        default=None,
        unit="deg",
        above=0,
        high=360,
        kinds=("bar", "cross", "ring"),
        needed_by=("bar", "cross", "ring"),
    )
    axis_deg: float = key(
        "orientation: the line along which a bar grows, an edge or a grating moves",
        default=0.0,
        unit="deg",
    )
    centre_deg: tuple[float, float] = key(
        "position [right, up] at the start; of an edge a point on it",
        default=(0.0, 0.0),
        unit="deg",
        low=-360,
        high=360,
    )
    onset_s: float = key(
        "how long its motion starts after the pause", default=0.0, unit="s", low=0, high=3600
    )
    duration_s: float | None = key(
        "how long its motion lasts; default: until the motion's end",
        default=None,
        unit="s",
        above=0,
        high=3600,
    )
    appears: str = key(
        "visible from the start of the clip, or from the onset of its motion",
        default="start",
        choices=("start", "onset"),
    )
    vanishes: str = key(
        "never, or at the end of its motion", default="never", choices=("never", "end")
    )
    reverse: bool = key("play its growth and motion backwards (receding)", default=False)
    contrast: float = key(
        "grating, plaid: Michelson contrast; texture, patch: RMS contrast; dots: luminance "
        "of the dots over that of the ground, minus 1 (negative: dark dots)",
        default=1.0,
        low=-1,
        high=10,
        kinds=(*PATTERNS, "patch"),
    )
    period_deg: float | None = key(
        "length of a cycle",
        default=None,
        unit="deg",
        low=0.001,
        high=360,
        kinds=GRATINGS,
        needed_by=GRATINGS,
    )
    phase_deg: float = key(
        "phase at the centre, 360 to a cycle", default=0.0, unit="deg", kinds=GRATINGS
    )
    plaid_deg: float = key(
        "angle between the two gratings",
        default=90.0,
        unit="deg",
        above=0,
        high=180,
        kinds=("plaid",),
    )
    exponent: float = key(
        "amplitude of the texture falls as 1/f to this power",
        default=1.0,
        low=0,
        high=4,
        kinds=TEXTURED,
    )
    finest_deg: float | None = key(
        "shortest wavelength in the texture; default: 4 px (patch: an eighth of its size)",
        default=None,
        unit="deg",
        low=0.001,
        high=360,
        kinds=("texture",),
    )
    dot_deg: float | None = key(
        "diameter of a dot",
        default=None,
        unit="deg",
        low=0.001,
        high=90,
        kinds=("dots",),
        needed_by=("dots",),
    )
    dots_per_100deg2: float | None = key(
        "number of dots in 100 square degrees",
        default=None,
        above=0,
        high=10_000,
        kinds=("dots",),
        needed_by=("dots",),
    )
    coherence: float = key(
        "share of the dots that move together; the others go their own ways",
        default=1.0,
        low=0,
        high=1,
        kinds=("dots",),
    )
    growth: Growth | None = key(  # noqa: RUF009
        "how its size changes", default=None, kinds=SIZED
    )
    motion: Motion | None = key("how it moves", default=None)  # noqa: RUF009
    brightness: Brightness | None = key(  # noqa: RUF009
        "how its luminance changes", default=None
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.luminance is None:
            shaded = self.kind in PATTERNS or self.kind == "patch"
            object.__setattr__(self, "luminance", 0.5 if shaded else 0.0)
        self._check_size()
        self._check_contrast()
        if self.motion is not None and self.motion.zoom_per_s and self.kind not in PATTERNS:
            raise StimulusError(
                f"motion: zoom_per_s is for patterns, not for kind '{self.kind}'; use growth"
            )

    @property
    def base_luminance(self) -> float:
        """The luminance, which is never None once the object is made."""
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

    def _check_contrast(self) -> None:
        if self.kind in GRATINGS and not 0 <= self.contrast * self.base_luminance <= 1 - (
            self.base_luminance
        ):
            raise StimulusError(
                f"contrast = {self.contrast:g} takes luminance = {self.base_luminance:g} out of "
                "0 to 1; lower one of them"
            )
        if self.kind == "dots" and self.base_luminance * (1 + self.contrast) > 1:
            raise StimulusError(
                f"contrast = {self.contrast:g} makes the dots brighter than 1 at luminance = "
                f"{self.base_luminance:g}; lower one of them"
            )
        if self.kind in TEXTURED and self.contrast < 0:
            raise StimulusError(f"contrast of a {self.kind} must be at least 0")
