"""The pose of an object in degrees of the field, and its outline in pixels of the display."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from oppload_cli.stimulus.objects import Object
    from oppload_cli.stimulus.protocol_tables import Display

    Point = tuple[float, float]


# A shape of this half size fills every display; the tangent of more is too large to draw.
_WIDEST_DEG = 89.9


@dataclass(frozen=True)
class Extent:
    """The reach of a shape to both sides of its anchor point, along its axis."""

    forward: float  # degrees
    backward: float
    forward_speed: float = 0.0  # growth of `forward`, in deg/s
    backward_speed: float = 0.0

    @property
    def size(self) -> float:
        """The full size in degrees."""
        return self.forward + self.backward

    def with_speeds_times(self, sign: float) -> Extent:
        """Return a copy whose speeds are multiplied by `sign`: 1, -1 (backwards) or 0 (still)."""
        return Extent(
            self.forward, self.backward, sign * self.forward_speed, sign * self.backward_speed
        )


@dataclass(frozen=True)
class Pose:
    """An object at one time; points are [right, up] in degrees."""

    visible: bool  # whether the object is drawn
    centre_deg: tuple[float, float]  # the anchor point
    velocity_deg_s: tuple[float, float]
    orientation_deg: float  # of the axis
    extent: Extent
    luminance: float  # 0 to 1
    zoom: float  # scale of a pattern
    travel_deg: tuple[float, float]  # own displacement, without turn and motion of the scene
    scene_turn_deg: float  # turn of the scene, which is part of `orientation_deg`
    contact_in_s: float | None  # time to contact while it approaches and does not pass
    looming: bool  # whether its complete outline grows, and it does not pass


@dataclass(frozen=True)
class Projection:
    """The map from angles to pixels; pixel i covers [i, i + 1), y grows down.

    Flat: pixels per degree are constant. Perspective: a point at the eccentricity e lies
    ``f tan(e)`` pixels from the middle, where f is the distance of the eye in pixels. Shapes are
    parallel to the screen, and their size is the angle that they would span in the middle.
    """

    shape: tuple[int, int]  # height and width of the display in pixels
    scale: float  # pixels per degree in the middle
    perspective: bool

    @classmethod
    def of(cls, display: Display) -> Projection:
        """Return the projection of a display."""
        shape = display.height, display.width
        return cls(shape, display.scale, display.projection == "perspective")

    @property
    def middle(self) -> Point:
        """The middle of the display in pixels, (x, y)."""
        return self.shape[1] / 2, self.shape[0] / 2

    @property
    def eye_px(self) -> float:
        """Distance of the eye from the screen, in pixels."""
        return self.scale * 180 / math.pi

    def reach(self, angle_deg: float) -> float:
        """Return the length in pixels that an angle from the middle, in degrees, spans."""
        if not self.perspective:
            return self.scale * angle_deg
        capped = min(max(angle_deg, -_WIDEST_DEG), _WIDEST_DEG)
        return self.eye_px * math.tan(math.radians(capped))

    def reach_speed(self, angle_deg: float, speed_deg_s: float) -> float:
        """Return the growth of :meth:`reach` in pixels/s while the angle grows at `speed_deg_s`."""
        if not self.perspective:
            return self.scale * speed_deg_s
        if abs(angle_deg) >= _WIDEST_DEG:
            return 0.0
        return self.scale * speed_deg_s / math.cos(math.radians(angle_deg)) ** 2

    def to_px(self, x_deg: float, y_deg: float) -> Point:
        """Return the pixel position (x, y), y down, of a point given in degrees right and up."""
        eccentricity = math.hypot(x_deg, y_deg)
        scale = self.scale
        if self.perspective and eccentricity > 0:
            scale = self.reach(eccentricity) / eccentricity
        x, y = self.middle
        return x + scale * x_deg, y - scale * y_deg

    def middle_of(self, pose: Pose) -> tuple[Point, tuple[float, float]]:
        """Return the middle of a shape in pixels, and its reach from its anchor point in pixels.

        Returns
        -------
        tuple of float
            (x, y) of the middle, y down.
        tuple of float
            Reach along the axis, and against it.
        """
        x, y = self.to_px(*pose.centre_deg)
        ahead, behind = self.reach(pose.extent.forward), self.reach(pose.extent.backward)
        shift = (ahead - behind) / 2
        if shift:
            angle = math.radians(pose.orientation_deg)
            x, y = x + shift * math.cos(angle), y - shift * math.sin(angle)
        return (x, y), (ahead, behind)


def corners_of(projection: Projection, obj: Object, pose: Pose) -> list[Point]:
    """Return the corners (x, y) in pixels of a square, bar, cross or edge, in order around it."""
    (x, y), (ahead, behind) = projection.middle_of(pose)
    half = (ahead + behind) / 2
    if obj.kind == "edge":
        # The covered half plane of an edge reaches beyond every corner of the display.
        far = 2.0 * (sum(projection.shape) + math.hypot(x, y))
        outline = [(0.0, far), (-far, far), (-far, -far), (0.0, -far)]
    elif obj.kind == "cross":
        arm = min(projection.reach((obj.width_deg or 0.0) / 2), half)
        quarter = [(half, arm), (arm, arm), (arm, half)]
        outline = []
        for _ in range(4):
            outline += quarter
            quarter = [(-v, u) for u, v in quarter]
    else:
        across = projection.reach((obj.width_deg or 0.0) / 2) if obj.kind == "bar" else half
        outline = [(half, across), (-half, across), (-half, -across), (half, -across)]
    angle = math.radians(pose.orientation_deg)
    cosine, sine = exact(math.cos(angle)), exact(math.sin(angle))
    return [(x + u * cosine - v * sine, y - u * sine - v * cosine) for u, v in outline]


def exact(value: float) -> float:
    """Remove the rounding error from the sine or cosine of a multiple of 90 degrees."""
    return float(round(value)) if abs(value - round(value)) < 1e-12 else value
