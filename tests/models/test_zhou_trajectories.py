"""The trained receptive field distinguishes hits from misses, retreats and rotations.

As in its training, 32 units around the head see random trajectories of balls
(``docs/detectors.md``).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from oppload_cli.models.published.zhou_lrf import HIT_BIAS, ZhouLrf, ZhouLrfParams

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

pytestmark = pytest.mark.slow

STEP_S, SAMPLED = 0.01, 3  # the units see every third step
ELEMENT, SIDE, DEGREES = 4, 48, 5  # px, px, degrees per element
UNITS = 32


@pytest.fixture(autouse=True, scope="module")
def each_arithmetic() -> None:
    """Run these tests once: no compiled loops are used."""


def direction(rng: np.random.Generator) -> Floats:
    vector = rng.normal(size=3)
    return np.asarray(vector / np.linalg.norm(vector))


def retreat(rng: np.random.Generator) -> Floats:
    """Return the path of a ball that leaves in a straight line; reversed in time it is a hit."""
    while True:
        start, velocity = direction(rng) * rng.uniform(0, 1), direction(rng) * rng.uniform(2, 10)
        times = STEP_S * np.arange(int(12 / np.linalg.norm(velocity) / STEP_S) + 2)
        path = start + velocity * times[:, None]
        distance = np.linalg.norm(path, axis=1)
        path = path[(distance > 1) & (np.arange(len(path)) < np.argmax(distance > 5.01))]
        if len(path) > 6:
            return np.asarray(path)


def miss(rng: np.random.Generator) -> Floats:
    """Return the path of a ball that passes, up to its nearest point."""
    while True:
        start = direction(rng) * rng.uniform(5, 5.01)
        velocity = -np.sign(start) * np.abs(direction(rng) * rng.uniform(2, 10))
        times = STEP_S * np.arange(int(12 / np.linalg.norm(velocity) / STEP_S))
        path = start + velocity * times[:, None]
        distance = np.linalg.norm(path, axis=1)
        nearest = int(distance.argmin())
        if distance[nearest] > 1 and nearest > 6:
            return np.asarray(path[: nearest + 1])


def rotation(rng: np.random.Generator, balls: int) -> Floats:
    """Return the paths of balls that turn about one random axis, by steps back and forth."""
    places = np.array([direction(rng) * rng.uniform(5, 15) for _ in range(balls)])
    axis, shown = direction(rng), []
    for _ in range(50):
        angle = np.deg2rad(rng.normal(0, 200 * STEP_S))
        along = np.outer(places @ axis, axis) * (1 - np.cos(angle))
        places = places * np.cos(angle) + np.cross(axis, places) * np.sin(angle) + along
        shown.append(places)
    return np.array(shown)


def eyes() -> tuple[Floats, Floats]:
    """Return the axes of the units, and the direction that each of their pixels sees."""
    count = np.arange(UNITS) + 0.5
    polar, turn = np.arccos(1 - 2 * count / UNITS), np.pi * (1 + 5**0.5) * count
    axes = np.stack([np.cos(turn) * np.sin(polar), np.sin(turn) * np.sin(polar), np.cos(polar)], 1)
    grid = (np.arange(SIDE) - SIDE / 2 + 0.5) * DEGREES / ELEMENT
    x, y = np.meshgrid(grid, -grid)
    away, around = np.deg2rad(np.hypot(x, y))[..., None], np.arctan2(y, x)[..., None]
    rays = []
    for axis in axes:
        one = np.cross(axis, [0, 0, 1])
        one /= np.linalg.norm(one)
        other = np.cross(one, axis)
        ring = np.cos(around) * one + np.sin(around) * other
        rays.append(axis * np.cos(away) + np.sin(away) * ring)
    return axes, np.array(rays)


def probability(path: Floats, radii: Floats, axes: Floats, rays: Floats) -> float:
    """Return the mean probability of a hit over a trajectory, shape (steps, balls, 3)."""
    model = [ZhouLrf((SIDE, SIDE), ZhouLrfParams(element=ELEMENT)) for _ in axes]
    found = []
    for places in path[SAMPLED - 1 :: SAMPLED]:
        seen = np.zeros((UNITS, SIDE, SIDE), bool)
        distance = np.linalg.norm(places, axis=1)
        half_angle = np.arcsin(np.minimum(radii / distance, 1))
        for place, angle in zip(places / distance[:, None], half_angle, strict=True):
            near = np.flatnonzero(axes @ place > np.cos(min(np.pi, angle + np.deg2rad(45))))
            seen[near] |= rays[near] @ place >= np.cos(angle)
        answers = [
            each.step(1 - image.astype(np.float32)) for each, image in zip(model, seen, strict=True)
        ]
        total = sum(each.response for each in answers if each is not None)
        found.append(1 / (1 + np.exp(-(total + HIT_BIAS))))
    return float(np.mean(found[1:]))


def area_under_curve(ones: Sequence[float], others: Sequence[float]) -> float:
    """Return the probability that a random one of `ones` is larger than one of `others`."""
    return float(np.mean([(a > b) + 0.5 * (a == b) for a in ones for b in others]))


def test_hits_are_told_from_the_rest() -> None:
    rng = np.random.default_rng(11)
    axes, rays = eyes()
    one, many = np.ones(1), rng.uniform(0, 1, 100)

    def of_ball(path: Floats) -> float:
        return probability(path[:, None], one, axes, rays)

    hits = [of_ball(retreat(rng)[::-1]) for _ in range(30)]
    others = [of_ball(miss(rng)) for _ in range(15)] + [of_ball(retreat(rng)) for _ in range(15)]
    others += [probability(rotation(rng, 100), many, axes, rays) for _ in range(12)]
    assert area_under_curve(hits, others) >= 0.98
