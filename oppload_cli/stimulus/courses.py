"""Courses: the path of a picture in three dimensions, as a table and as formulas of time.

Positions are ``(right, up, ahead)`` in metres from the camera, along the world's axes, and speeds
are relative to the camera, also while the camera moves.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from oppload_cli.errors import StimulusError
from oppload_cli.schema import REQUIRED, DeclaredTable, parameter

Vector = tuple[float, float, float]
RIGHT, UP, AHEAD = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)  # the world's axes

_TOWARDS = ("collision", "near-miss")
_MOVING = (*_TOWARDS, "crossing", "overtaking", "receding")
_FROM = ("crossing", "receding", "hovering")
_SIDES = {"left": (-1.0, 0.0, 0.0), "right": RIGHT, "above": UP}
HIT_SIZES = 0.5  # a picture hits the camera if its miss distance is at most this, in its sizes


@dataclass(frozen=True, kw_only=True)
class Course(DeclaredTable):
    """How a picture moves in three dimensions; times count from the start of its motion."""

    kind: str = parameter(
        REQUIRED,
        "collision: straight at the camera; near-miss: past it; crossing: from side to side; "
        "overtaking: past the camera from behind; receding; hovering: stays where it is; "
        "straight: as start_m and velocity_m_s say",
        choices=(*_TOWARDS, "crossing", "overtaking", "receding", "hovering", "straight"),
    )
    speed_m_s: float | None = parameter(None, "speed", above=0, high=1000, needed_by=_MOVING)
    contact_s: float | None = parameter(
        None,
        "when it is at the camera (collision, near-miss, overtaking) or in the middle of its way "
        "(crossing), from the start of its motion, if it does not brake; default: the end of its "
        "motion",
        above=0,
        high=3600,
        kinds=(*_TOWARDS, "crossing", "overtaking"),
    )
    distance_m: float | None = parameter(
        None,
        "distance of its start (receding), of its place (hovering) or of the middle of its way "
        "(crossing)",
        above=0,
        high=10_000,
        needed_by=_FROM,
    )
    bearing_deg: tuple[float, float] = parameter(
        (0.0, 0.0),
        "direction [right, up] from which it comes, in which it recedes or hovers, or in which "
        "the middle of its way lies",
        low=-85,
        high=85,
        kinds=(*_TOWARDS, *_FROM),
    )
    miss_sizes: float | None = parameter(
        None,
        "least distance of its middle from the camera, in its own sizes",
        above=0,
        high=1000,
        needed_by=("near-miss", "overtaking"),
    )
    side: str = parameter(
        "left",
        "side on which it passes (near-miss, overtaking) or from which it comes (crossing)",
        choices=tuple(_SIDES),
        kinds=("near-miss", "crossing", "overtaking"),
    )
    braking_m_s2: float = parameter(0.0, "deceleration, until it stands still", low=0, high=1000)
    sway_m: float = parameter(
        0.0, "how far it sways to each side", low=0, high=1000, kinds=("hovering",)
    )
    sway_hz: float = parameter(0.5, "how often it sways", above=0, high=100, kinds=("hovering",))
    start_m: tuple[float, float, float] | None = parameter(
        None,
        "position [right, up, ahead] at the start",
        low=-10_000,
        high=10_000,
        needed_by=("straight",),
    )
    velocity_m_s: tuple[float, float, float] | None = parameter(
        None,
        "velocity [right, up, ahead]; negative ahead: it comes nearer",
        low=-1000,
        high=1000,
        needed_by=("straight",),
    )


class Line(NamedTuple):
    """A straight path in three dimensions, with a speed that may fall to 0."""

    start: Vector  # position at the start in metres
    heading: Vector  # direction of length 1; (0, 0, 0) for an object that hovers
    speed: float  # at the start, in m/s
    braking: float = 0.0  # deceleration in m/s2
    sway: tuple[float, float] = (0.0, 1.0)  # amplitude in metres and rate in Hz, to both sides

    @classmethod
    def of(cls, course: Course, size_m: float, duration_s: float) -> Line:
        """Return the path of a picture of this size; `duration_s` is that of its motion.

        Raises
        ------
        StimulusError
            If the course is straight and its velocity is 0.
        """
        bearing, side = _direction(course.bearing_deg), _SIDES[course.side]
        speed, braking = course.speed_m_s or 0.0, course.braking_m_s2
        length = speed * (duration_s if course.contact_s is None else course.contact_s)
        miss = _scaled(side, (course.miss_sizes or 0.0) * size_m)
        middle = _scaled(bearing, course.distance_m or 0.0)
        match course.kind:
            case "overtaking":
                start, heading = _sum(miss, (0.0, 0.0, -length)), AHEAD
            case "crossing":
                start, heading = _sum(middle, _scaled(side, length)), _scaled(side, -1.0)
            case "receding":
                start, heading = middle, bearing
            case "hovering":
                return cls(middle, (0.0, 0.0, 0.0), 0.0, sway=(course.sway_m, course.sway_hz))
            case "straight":
                velocity = course.velocity_m_s or (0.0, 0.0, 0.0)
                speed = math.hypot(*velocity)
                if not speed:
                    raise StimulusError(
                        "velocity_m_s is 0; use kind 'hovering' for an object at rest"
                    )
                start, heading = course.start_m or (0.0, 0.0, 0.0), _scaled(velocity, 1 / speed)
            case _:  # collision, near-miss
                start = _sum(_across(miss, bearing), _scaled(bearing, length))
                heading = _scaled(bearing, -1.0)
        return cls(start, heading, speed, braking)

    def position(self, elapsed: float) -> Vector:
        """Return the position in metres, `elapsed` seconds after the start of the motion."""
        moving = min(elapsed, self.speed / self.braking) if self.braking else elapsed
        path = _scaled(self.heading, self.speed * moving - self.braking * moving**2 / 2)
        (right, up, ahead), (amplitude, rate) = _sum(self.start, path), self.sway
        return right + amplitude * math.sin(2 * math.pi * rate * elapsed), up, ahead

    def velocity(self, elapsed: float) -> Vector:
        """Return the velocity in m/s, `elapsed` seconds after the start of the motion."""
        right, up, ahead = _scaled(self.heading, max(0.0, self.speed - self.braking * elapsed))
        amplitude, rate = self.sway
        turn = 2 * math.pi * rate
        return right + amplitude * turn * math.cos(turn * elapsed), up, ahead

    def closest(self) -> tuple[float | None, float]:
        """Return when the object is nearest to the camera, and its distance then in metres.

        The time counts in seconds from the start of the motion. It is None if the object never
        comes nearer, or if it stops before the nearest point of its line.
        """
        length = -_product(self.start, self.heading)
        if length <= 0 or not self.speed:
            return None, math.hypot(*self.start)
        if not self.braking:
            time: float | None = length / self.speed
        elif self.speed**2 < 2 * self.braking * length:
            time, length = None, self.speed**2 / (2 * self.braking)
        else:
            root = math.sqrt(self.speed**2 - 2 * self.braking * length)
            time = (self.speed - root) / self.braking
        return time, math.dist(self.start, _scaled(self.heading, -length))


def _direction(bearing_deg: tuple[float, float]) -> Vector:
    """Return the direction, of length 1, at these angles right and up from ahead."""
    right, up = (math.tan(math.radians(angle)) for angle in bearing_deg)
    length = math.hypot(right, up, 1.0)
    return right / length, up / length, 1 / length


def _across(offset: Vector, heading: Vector) -> Vector:
    """Turn an offset so that it is at right angles to the heading and keeps its length."""
    length = math.hypot(*offset)
    if not length:
        return offset
    across = _sum(offset, _scaled(heading, -_product(offset, heading)))
    return _scaled(across, length / math.hypot(*across))


def _product(first: Vector, second: Vector) -> float:
    # The plain `sum` of floats rounds in another way since Python 3.12.
    return math.fsum(a * b for a, b in zip(first, second, strict=True))


def _scaled(vector: Vector, factor: float) -> Vector:
    right, up, ahead = vector
    return right * factor, up * factor, ahead * factor


def _sum(first: Vector, second: Vector) -> Vector:
    return first[0] + second[0], first[1] + second[1], first[2] + second[2]
