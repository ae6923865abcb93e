"""From degrees of the field to pixels of the display."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from oppload_cli.stimulus.tables import Display

# tan() beyond this is too large to draw, and a figure that large fills every display
WIDEST_DEG = 89.9


@dataclass(frozen=True)
class Projection:
    """The map from angles to pixels; pixel i covers [i, i + 1), y grows down.

    Flat: pixels per degree are constant. Perspective: a point at the eccentricity e lies
    ``f tan(e)`` from the middle, in its direction, with ``f`` the distance of the eye in
    pixels; figures are parallel to the screen, and their size is the angle that they
    would span in the middle of the field.

    Attributes
    ----------
    middle : tuple of float
        The middle of the display in pixels, (x, y).
    scale : float
        Pixels per degree in the middle.
    perspective : bool
        Whether the projection is the tangent.
    """

    middle: tuple[float, float]
    scale: float
    perspective: bool

    @classmethod
    def of(cls, display: Display) -> Projection:
        """Return the projection of a display.

        Parameters
        ----------
        display : Display
            The screen.

        Returns
        -------
        Projection
        """
        middle = (display.width / 2, display.height / 2)
        return cls(middle, display.scale, display.projection == "perspective")

    @property
    def eye_px(self) -> float:
        """Distance of the eye from the screen, in pixels."""
        return self.scale * 180 / math.pi

    def reach(self, angle_deg: float) -> float:
        """Return the length that an angle from the middle spans.

        Parameters
        ----------
        angle_deg : float
            Degrees.

        Returns
        -------
        float
            Pixels.
        """
        if not self.perspective:
            return self.scale * angle_deg
        capped = min(max(angle_deg, -WIDEST_DEG), WIDEST_DEG)
        return self.eye_px * math.tan(math.radians(capped))

    def reach_speed(self, angle_deg: float, speed_deg_s: float) -> float:
        """Return how fast :meth:`reach` grows.

        Parameters
        ----------
        angle_deg : float
            Degrees.
        speed_deg_s : float
            How fast the angle grows.

        Returns
        -------
        float
            Pixels per second.
        """
        if not self.perspective:
            return self.scale * speed_deg_s
        if abs(angle_deg) >= WIDEST_DEG:
            return 0.0
        return self.scale * speed_deg_s / math.cos(math.radians(angle_deg)) ** 2

    def to_px(self, x_deg: float, y_deg: float) -> tuple[float, float]:
        """Return the pixel position of a point of the field.

        Parameters
        ----------
        x_deg, y_deg : float
            Degrees right and up from the middle.

        Returns
        -------
        tuple of float
            (x, y) in pixels, y down.
        """
        eccentricity = math.hypot(x_deg, y_deg)
        scale = self.scale
        if self.perspective and eccentricity > 0:
            scale = self.reach(eccentricity) / eccentricity
        return self.middle[0] + scale * x_deg, self.middle[1] - scale * y_deg
