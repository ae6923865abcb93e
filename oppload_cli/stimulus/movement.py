"""Displacement, turn and luminance after some time: closed forms, never steps."""

from __future__ import annotations

import math
import random
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from oppload_cli.stimulus.changes import Brightness
    from oppload_cli.stimulus.tables import Motion

Vector = tuple[float, float]
STILL: Vector = (0.0, 0.0)


def movement(
    motion: Motion | None, elapsed: float, axis_deg: float, seed: str
) -> tuple[Vector, Vector, float]:
    """Return what a motion has done after some time.

    Parameters
    ----------
    motion : Motion or None
        The motion; None does nothing.
    elapsed : float
        Seconds since its start.
    axis_deg : float
        The direction where the motion names none.
    seed : str
        Of the shake.

    Returns
    -------
    tuple of float
        Displacement [right, up] in degrees.
    tuple of float
        Velocity in deg/s.
    float
        Turn in degrees, counter-clockwise.
    """
    if motion is None:
        return STILL, STILL, 0.0
    heading = math.radians(axis_deg if motion.direction_deg is None else motion.direction_deg)
    x_speed, y_speed = (
        motion.speed_deg_s * math.cos(heading),
        motion.speed_deg_s * math.sin(heading),
    )
    x, y = x_speed * elapsed, y_speed * elapsed
    for (dx, dy), (vx, vy) in (_path(motion, elapsed), _shake(motion, elapsed, seed)):
        x, y, x_speed, y_speed = x + dx, y + dy, x_speed + vx, y_speed + vy
    return (x, y), (x_speed, y_speed), motion.rotation_deg_s * elapsed


def luminance_at(
    brightness: Brightness | None, base: float, elapsed: float, duration: float
) -> float:
    """Return an object's luminance.

    Parameters
    ----------
    brightness : Brightness or None
        How it changes.
    base : float
        The object's luminance, 0 to 1.
    elapsed, duration : float
        Seconds since its motion's start (negative before), and how long it lasts.

    Returns
    -------
    float
        0 to 1.
    """
    if brightness is None or elapsed < brightness.start_s:
        return base
    since = elapsed - brightness.start_s
    if brightness.kind == "step":
        share = 1.0
    elif brightness.kind == "ramp":
        length = brightness.duration_s or max(duration - brightness.start_s, 1e-9)
        share = min(since / length, 1.0)
    else:
        cycle = since * (brightness.frequency_hz or 0.0)
        sine = brightness.waveform == "sine"
        # a cycle starts at the base; 1e-9 keeps a frame on the switch on one side of it
        share = (
            (1 - math.cos(2 * math.pi * cycle)) / 2 if sine else float((cycle + 1e-9) % 1 >= 0.5)
        )
    return base + (brightness.to - base) * share


def _path(motion: Motion, elapsed: float) -> tuple[Vector, Vector]:
    points, times = motion.path_deg, motion.path_s
    if not points:
        return STILL, STILL
    for index in range(1, len(points)):
        if times[index - 1] <= elapsed < times[index]:
            (x0, y0), (x1, y1) = points[index - 1], points[index]
            length = times[index] - times[index - 1]
            vx, vy = (x1 - x0) / length, (y1 - y0) / length
            since = elapsed - times[index - 1]
            return (x0 + vx * since, y0 + vy * since), (vx, vy)
    return points[0] if elapsed < times[0] else points[-1], STILL


def _shake(motion: Motion, elapsed: float, seed: str) -> tuple[Vector, Vector]:
    """Sum of seeded sinusoids: random to the eye, but a function of time."""
    if not motion.shake_deg:
        return STILL, STILL
    # a generator of its own for each object; text seeds are the same in every process
    chance = random.Random(f"{seed}/shake")  # noqa: S311
    waves = 6
    amplitude = motion.shake_deg / math.sqrt(waves)
    place, speed = [0.0, 0.0], [0.0, 0.0]
    for axis in (0, 1):
        for _ in range(waves):
            rate = 2 * math.pi * motion.shake_hz * chance.uniform(0.5, 1.5)
            phase = chance.uniform(0, 2 * math.pi)
            place[axis] += amplitude * (math.sin(rate * elapsed + phase) - math.sin(phase))
            speed[axis] += amplitude * rate * math.cos(rate * elapsed + phase)
    return (place[0], place[1]), (speed[0], speed[1])
