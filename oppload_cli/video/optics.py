"""Converts between source pixels and degrees of the field of view."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

from oppload_cli.errors import ParameterError

if TYPE_CHECKING:
    from collections.abc import Mapping

_PINHOLE, _FLAT = "pinhole", "flat"
FOV = "--fov"  # origin of a field of view that the user states


class View(NamedTuple):
    """The direction of an object, its angular size, and the growth of this size."""

    # Direction of the focus of expansion, -90 to 90: to the right of the middle of the frame, and
    # above the horizontal plane through the middle.
    azimuth_deg: float
    elevation_deg: float
    angular_width_deg: float  # angle that the box spans
    angular_height_deg: float
    angular_size_deg: float  # the larger of these two angles
    angular_speed_deg_s: float | None  # growth of this size; None without a time to contact


@dataclass(frozen=True)
class Optics:
    """Converts source pixels to directions, and lengths in pixels to angles.

    Pinhole: a point at the angle e from the middle of the frame is ``f tan(e)`` pixels away from
    the middle, where ``f`` is the focal length in pixels. Flat: the number of pixels per degree is
    constant, as in stimuli with ``projection = "flat"``.
    """

    width: int  # of the displayed frame, in source pixels
    height: int
    per_radian: float  # pixels per radian in the middle: the focal length of a pinhole camera
    projection: str = _PINHOLE  # or `_FLAT`
    origin: str = FOV  # of the field of view; or ``stimulus``

    @classmethod
    def of_fov(cls, width: int, height: int, fov_deg: float) -> Optics:
        """Return a pinhole camera with a field of view across the width of the frame."""
        return cls(width, height, width / 2 / math.tan(math.radians(fov_deg) / 2))

    @classmethod
    def of_display(cls, display: Mapping[str, Any], width: int, height: int) -> Optics:
        """Return the optics of a stimulus, whose video may have been scaled to another size.

        `display` has the entries ``width``, ``pixels_per_degree`` and ``projection`` of its ground
        truth; `width` and `height` are the size of the video in pixels. Raises KeyError, TypeError,
        ValueError or ZeroDivisionError if an entry is missing, or if the scale is not a finite
        number above 0.
        """
        scale = float(display["pixels_per_degree"]) * width / float(display["width"])
        if not 0 < scale < math.inf:
            raise ValueError(f"{scale} pixels per degree")
        projection = _PINHOLE if display["projection"] == "perspective" else _FLAT
        return cls(width, height, math.degrees(scale), projection, "stimulus")

    def degrees(self, pixels: float) -> float:
        """Return the angle of a length in pixels whose middle is that of the frame."""
        half = pixels / 2 / self.per_radian
        return 2 * math.degrees(half if self.projection == _FLAT else math.atan(half))

    def pixels(self, degrees: float) -> float:
        """Return the length in pixels of an angle below 180 degrees: the inverse of `degrees`."""
        half = math.radians(degrees / 2)
        return 2 * self.per_radian * (half if self.projection == _FLAT else math.tan(half))

    def direction(self, x: float, y: float) -> tuple[float, float]:
        """Return azimuth and elevation in degrees of a point in source pixels."""
        right = (x - self.width / 2) / self.per_radian
        up = (self.height / 2 - y) / self.per_radian
        if self.projection == _FLAT:
            return math.degrees(right), math.degrees(up)
        return math.degrees(math.atan(right)), math.degrees(math.atan(up / math.hypot(1, right)))

    def between(self, start: tuple[float, float], end: tuple[float, float]) -> float:
        """Return the angle in degrees between two points in source pixels."""
        if self.projection == _FLAT:
            return math.degrees(math.dist(start, end) / self.per_radian)
        a, b = ((x - self.width / 2, y - self.height / 2, self.per_radian) for x, y in (start, end))
        across = math.hypot(
            a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
        )
        ahead = math.fsum(p * q for p, q in zip(a, b, strict=True))
        return math.degrees(math.atan2(across, ahead))

    def view(
        self,
        box: tuple[float, float, float, float],
        centre: tuple[float, float],
        time_to_contact_s: float | None,
    ) -> View:
        """Return an object's direction and angular size, and the growth of this size.

        `box` is left, top, width and height, and `centre` the focus of expansion (x, y), both in
        source pixels; a time to contact is above 0. If an object approaches at constant speed,
        ``tan(size / 2) = (l/v) / t`` at the time t before contact. So its angular size grows by
        ``sin(size) / t`` per second.
        """
        left, top, width, height = box
        x, y = left + width / 2, top + height / 2
        across = self.between((left, y), (left + width, y))
        down = self.between((x, top), (x, top + height))
        size = max(across, down)
        speed = None
        if time_to_contact_s:
            speed = math.degrees(math.sin(math.radians(size))) / time_to_contact_s
        return View(*self.direction(*centre), across, down, size, speed)

    def as_dict(self) -> dict[str, Any]:
        """Return the facts for the sidecar."""
        return {
            "origin": self.origin,
            "projection": self.projection,
            "horizontal_deg": self.degrees(self.width),
            "vertical_deg": self.degrees(self.height),
            "px_per_degree_in_the_middle": math.radians(self.per_radian),
        }


def parse_fov(value: str | float) -> float:
    """Return a field of view in degrees across the width of the frame.

    A text may end in ``deg`` or a degree sign. Raises ParameterError unless `value` is a number
    above 0 and below 180.
    """
    number = value
    if isinstance(value, str):
        number = value.strip().removesuffix("\N{DEGREE SIGN}").removesuffix("deg")
    try:
        degrees = math.nan if isinstance(value, bool) else float(number)
    except (TypeError, ValueError, OverflowError):
        degrees = math.nan
    if not 0 < degrees < 180:
        raise ParameterError(
            f"fov must be above 0 and below 180 degrees, the horizontal field of view of the "
            f"camera, not '{value}'"
        )
    return degrees
