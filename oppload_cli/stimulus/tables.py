"""The tables of a protocol around its objects: display, timing, motion, scene, effects."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

from oppload_cli.errors import StimulusError
from oppload_cli.stimulus.declare import Table, key


def check_times(times: tuple[float, ...], values: tuple[Any, ...], first: str, second: str) -> None:
    """Check a list of times that goes with a list of values.

    Parameters
    ----------
    times : tuple of float
        In seconds.
    values : tuple
        What is reached at each of them.
    first, second : str
        The keys of the two lists.

    Raises
    ------
    StimulusError
        If a list is empty, if they differ in length or if the times do not rise.
    """
    if not times or len(times) != len(values):
        raise StimulusError(
            f"{first} and {second} must be lists of the same length, not {len(times)} and "
            f"{len(values)} values"
        )
    if any(after <= before for before, after in itertools.pairwise(times)):
        raise StimulusError(f"{first} must rise from value to value")


@dataclass(frozen=True, kw_only=True)
class Display(Table):
    """The screen: its size, its angle of view and its frame rate."""

    width: int = key("width of the picture", unit="px", low=8, high=8192)
    height: int = key("height of the picture", unit="px", low=8, high=8192)
    frame_rate: Fraction = key(  # noqa: RUF009
        "frames per second, a number or a fraction as text",
        default=Fraction(30),
        unit="Hz",
        above=0,
        high=10_000,
    )
    pixels_per_degree: float | None = key(
        "scale in the middle of the field; give this or field_of_view_deg",
        default=None,
        unit="px/deg",
        low=0.001,
        high=10_000,
    )
    field_of_view_deg: float | None = key(
        "angle that the width spans; give this or pixels_per_degree",
        default=None,
        unit="deg",
        low=0.001,
        high=360,
    )
    projection: str = key(
        "flat: pixels per degree constant; perspective: pixels as the tangent of the angle",
        default="flat",
        choices=("flat", "perspective"),
    )
    background: float = key("luminance where there is no object", default=1.0, low=0, high=1)

    def __post_init__(self) -> None:
        super().__post_init__()
        if (self.pixels_per_degree is None) == (self.field_of_view_deg is None):
            raise StimulusError("give either pixels_per_degree or field_of_view_deg, and only one")
        wide = self.field_of_view_deg is not None and self.field_of_view_deg >= 179
        if self.projection == "perspective" and wide:
            raise StimulusError(
                "field_of_view_deg must be below 179 deg with projection = 'perspective'"
            )

    @property
    def scale(self) -> float:
        """Pixels per degree in the middle of the field."""
        if self.pixels_per_degree is not None:
            return self.pixels_per_degree
        view = self.field_of_view_deg or 0.0
        if self.projection == "flat":
            return self.width / view
        return self.width / 2 / math.tan(math.radians(view / 2)) * math.pi / 180


@dataclass(frozen=True, kw_only=True)
class Timing(Table):
    """The clip's time: a pause, the motion, a pause."""

    before_s: float = key("pause before the motion", default=0.0, unit="s", low=0, high=3600)
    motion_s: float = key("time of the motion", unit="s", above=0, high=3600)
    after_s: float = key("pause after the motion", default=0.0, unit="s", low=0, high=3600)

    @property
    def end_s(self) -> float:
        """When the motion ends, in seconds of the clip."""
        return self.before_s + self.motion_s

    @property
    def total_s(self) -> float:
        """The clip's duration in seconds."""
        return self.end_s + self.after_s


@dataclass(frozen=True, kw_only=True)
class Motion(Table):
    """How a figure, a pattern or the whole scene moves."""

    speed_deg_s: float = key("speed", default=0.0, unit="deg/s", low=0, high=100_000)
    direction_deg: float | None = key(
        "direction of the movement; default: the axis", default=None, unit="deg"
    )
    rotation_deg_s: float = key(
        "speed of turning, counter-clockwise",
        default=0.0,
        unit="deg/s",
        low=-100_000,
        high=100_000,
    )
    zoom_per_s: float = key(
        "growth rate of a pattern's scale: exp(zoom_per_s t); patterns only",
        default=0.0,
        unit="1/s",
        low=-20,
        high=20,
    )
    shake_deg: float = key(
        "RMS distance of a shake from its middle", default=0.0, unit="deg", low=0, high=90
    )
    shake_hz: float = key(
        "middle frequency of the shake", default=4.0, unit="Hz", above=0, high=500
    )
    path_deg: tuple[tuple[float, float], ...] = key(
        "points [right, up] of a path, added to centre_deg, joined by straight lines",
        default=(),
        unit="deg",
    )
    path_s: tuple[float, ...] = key(
        "when each point is reached, after the start of the motion",
        default=(),
        unit="s",
        low=0,
        high=3600,
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.path_deg or self.path_s:
            check_times(self.path_s, self.path_deg, "path_s", "path_deg")


@dataclass(frozen=True, kw_only=True)
class Scene(Table):
    """A shift and a turn of all objects together, and their common motion (the camera's)."""

    centre_deg: tuple[float, float] = key(
        "shift [right, up] of the whole scene", default=(0.0, 0.0), unit="deg", low=-360, high=360
    )
    rotation_deg: float = key(
        "turn of the whole scene about its middle, counter-clockwise", default=0.0, unit="deg"
    )
    motion: Motion | None = key(  # noqa: RUF009
        "common motion of all objects", default=None
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.motion is not None and self.motion.zoom_per_s:
            raise StimulusError("motion: zoom_per_s is for patterns, not for the scene")


@dataclass(frozen=True, kw_only=True)
class Effects(Table):
    """What happens to the finished picture."""

    invert: bool = key("swap dark and light (contrast polarity)", default=False)
    noise: float = key("standard deviation of additive Gaussian noise", default=0.0, low=0, high=1)
    shutter: float = key(
        "motion blur: open shutter as a share of the frame time, centred on it",
        default=0.0,
        low=0,
        high=1,
    )
    shutter_samples: int = key("pictures averaged for the blur", default=8, low=2, high=64)
