"""Courses: how an object moves in three dimensions, as a table and in closed form.

Positions are ``(right, up, ahead)`` in metres from the camera, along the world's axes.
A moving camera takes these axes with it: speeds are those towards the camera.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from oppload_cli.errors import StimulusError
from oppload_cli.schema import REQUIRED, Table, parameter

Vector = tuple[float, float, float]

_COURSES = (
    *("collision", "near-miss", "crossing", "overtaking", "receding", "hovering", "straight"),
)
_TOWARDS = ("collision", "near-miss")
_PASSING = ("near-miss", "crossing", "overtaking")
_MOVING = (*_TOWARDS, "crossing", "overtaking", "receding")
_FROM = ("crossing", "receding", "hovering")
_SIDES = {"left": (-1.0, 0.0, 0.0), "right": (1.0, 0.0, 0.0), "above": (0.0, 1.0, 0.0)}
HIT_SIZES = 0.5  # an object whose middle passes nearer than half its size hits the camera


@dataclass(frozen=True, kw_only=True)
class Course(Table):
    """How a picture moves in three dimensions; times count from the start of its motion."""

    kind: str = parameter(
        REQUIRED,
        "collision: straight at the camera; near-miss: past it; crossing: from side to side; "
        "overtaking: past the camera from behind; receding; hovering: stays where it is; "
        "straight: as start_m and velocity_m_s say",
        choices=_COURSES,
    )
    speed_m_s: float | None = parameter(
        None, "speed", unit="m/s", above=0, high=1000, kinds=_MOVING, needed_by=_MOVING
    )
    contact_s: float | None = parameter(
        None,
        "when it is at the camera (collision, near-miss, overtaking) or in the middle of its way "
        "(crossing), if it does not brake; default: the end of its motion",
        unit="s",
        above=0,
        high=3600,
        kinds=(*_TOWARDS, "crossing", "overtaking"),
    )
    distance_m: float | None = parameter(
        None,
        "distance of its start (receding), of its place (hovering) or of the middle of its way "
        "(crossing)",
        unit="m",
        above=0,
        high=10_000,
        kinds=_FROM,
        needed_by=_FROM,
    )
    bearing_deg: tuple[float, float] = parameter(
        (0.0, 0.0),
        "direction [right, up] from which it comes, in which it recedes or hovers, or in which "
        "the middle of its way lies",
        unit="deg",
        low=-85,
        high=85,
        kinds=(*_TOWARDS, *_FROM),
    )
    miss_sizes: float | None = parameter(
        None,
        "least distance of its middle from the camera, in its own sizes",
        above=0,
        high=1000,
        kinds=("near-miss", "overtaking"),
        needed_by=("near-miss", "overtaking"),
    )
    side: str = parameter(
        "left",
        "side on which it passes (near-miss, overtaking) or from which it comes (crossing)",
        choices=tuple(_SIDES),
        kinds=_PASSING,
    )
    braking_m_s2: float = parameter(
        0.0, "how fast its speed falls, until it stands", unit="m/s2", low=0, high=1000
    )
    sway_m: float = parameter(
        0.0, "how far it sways to each side", unit="m", low=0, high=1000, kinds=("hovering",)
    )
    sway_hz: float = parameter(
        0.5, "how often it sways", unit="Hz", above=0, high=100, kinds=("hovering",)
    )
    start_m: tuple[float, float, float] | None = parameter(
        None,
        "position [right, up, ahead] at the start",
        unit="m",
        low=-10_000,
        high=10_000,
        kinds=("straight",),
        needed_by=("straight",),
    )
    velocity_m_s: tuple[float, float, float] | None = parameter(
        None,
        "velocity [right, up, ahead]; negative ahead: it comes nearer",
        unit="m/s",
        low=-1000,
        high=1000,
        kinds=("straight",),
        needed_by=("straight",),
    )


class Line(NamedTuple):
    """A straight way in three dimensions, driven at a speed that may fall to 0.

    Attributes
    ----------
    start : tuple of float
        Position at the start in metres.
    heading : tuple of float
        Direction of length 1; 0 of an object that stays where it is.
    speed, braking : float
        Speed at the start in m/s and how fast it falls in m/s2.
    sway : tuple of float
        How far in metres, and how often per second, it sways to each side.
    """

    start: Vector
    heading: Vector
    speed: float
    braking: float = 0.0
    sway: tuple[float, float] = (0.0, 1.0)

    @classmethod
    def of(cls, course: Course, size_m: float, lasts_s: float) -> Line:
        """Return the way of an object.

        Parameters
        ----------
        course : Course
            Table of the course.
        size_m : float
            Size of the object in metres.
        lasts_s : float
            Duration of its motion, the default of ``contact_s``.

        Raises
        ------
        StimulusError
            If it stands still although its course is straight.
        """
        bearing = _direction(course.bearing_deg)
        speed, distance = course.speed_m_s or 0.0, course.distance_m or 0.0
        way = speed * (lasts_s if course.contact_s is None else course.contact_s)
        side, brake = _SIDES[course.side], course.braking_m_s2
        missed = _scaled(side, (course.miss_sizes or 0.0) * size_m)
        back = _scaled(bearing, -1.0)
        if course.kind in _TOWARDS:
            return cls(_sum(_across(missed, bearing), _scaled(bearing, way)), back, speed, brake)
        if course.kind == "overtaking":
            return cls(_sum(missed, (0.0, 0.0, -way)), (0.0, 0.0, 1.0), speed, brake)
        middle = _scaled(bearing, distance)
        if course.kind == "crossing":
            return cls(_sum(middle, _scaled(side, way)), _scaled(side, -1.0), speed, brake)
        if course.kind == "receding":
            return cls(middle, bearing, speed, brake)
        if course.kind == "hovering":
            return cls(middle, (0.0, 0.0, 0.0), 0.0, 0.0, (course.sway_m, course.sway_hz))
        velocity = course.velocity_m_s or (0.0, 0.0, 0.0)
        speed = math.hypot(*velocity)
        if not speed:
            raise StimulusError("velocity_m_s is 0; use kind 'hovering' for an object at rest")
        return cls(course.start_m or (0.0, 0.0, 0.0), _scaled(velocity, 1 / speed), speed, brake)

    def position(self, elapsed: float) -> Vector:
        """Return the position after some seconds."""
        driven, (far, rate) = self._driven(elapsed), self.sway
        right, up, ahead = (
            at + driven * along for at, along in zip(self.start, self.heading, strict=True)
        )
        return right + far * math.sin(2 * math.pi * rate * elapsed), up, ahead

    def velocity(self, elapsed: float) -> Vector:
        """Return the velocity in m/s after some seconds."""
        speed, (far, rate) = max(0.0, self.speed - self.braking * elapsed), self.sway
        right, up, ahead = (speed * along for along in self.heading)
        turn = 2 * math.pi * rate
        return right + far * turn * math.cos(turn * elapsed), up, ahead

    def closest(self) -> tuple[float | None, float]:
        """Return when the object is nearest to the camera, and its distance then in metres.

        The time counts from the start of the motion; None where it comes no nearer, or where it
        comes to rest before.
        """
        way = -sum(at * along for at, along in zip(self.start, self.heading, strict=True))
        if way <= 0 or not self.speed:
            return None, math.hypot(*self.start)
        if not self.braking:
            time: float | None = way / self.speed
        elif self.speed**2 < 2 * self.braking * way:
            time, way = None, self.speed**2 / (2 * self.braking)
        else:
            time = (self.speed - math.sqrt(self.speed**2 - 2 * self.braking * way)) / self.braking
        return time, math.dist(self.start, [-way * along for along in self.heading])

    def _driven(self, elapsed: float) -> float:
        if self.braking:
            elapsed = min(elapsed, self.speed / self.braking)
        return self.speed * elapsed - self.braking * elapsed**2 / 2


def _direction(bearing_deg: tuple[float, float]) -> Vector:
    """Return the direction, of length 1, that lies so many degrees right and up in the picture."""
    right, up = (math.tan(math.radians(angle)) for angle in bearing_deg)
    length = math.hypot(right, up, 1.0)
    return right / length, up / length, 1 / length


def _across(offset: Vector, heading: Vector) -> Vector:
    """Turn an offset so that it is at right angles to the heading, its length kept."""
    length = math.hypot(*offset)
    if not length:
        return offset
    along = sum(a * b for a, b in zip(offset, heading, strict=True))
    plain = _sum(offset, _scaled(heading, -along))
    return _scaled(plain, length / math.hypot(*plain))


def _scaled(vector: Vector, factor: float) -> Vector:
    right, up, ahead = vector
    return right * factor, up * factor, ahead * factor


def _sum(first: Vector, second: Vector) -> Vector:
    return first[0] + second[0], first[1] + second[1], first[2] + second[2]
