"""Radial opponent motion (ROM) pairs and radial motion opponency (RMO).

This module holds the metric alone: it takes arrays of motion vectors and returns numbers. Vectors
may come from anywhere and be in any unit. x grows right and y grows down, as in images; only angles
between vectors matter, so that the direction of y changes no result.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from oppload_cli.compute.loops import with_twin
from oppload_cli.errors import ParameterError
from oppload_cli.schema import Parameters, parameter

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from numpy.typing import ArrayLike, NDArray

    Points = NDArray[np.float64]  # shape (..., 2): x, y
    Lengths = NDArray[np.float64]
    Rows = NDArray[np.intp]


@dataclass(frozen=True, kw_only=True)
class RmoParams(Parameters):
    """The bounds of motion, of opposite and of outward vectors (``docs/rmo.md``).

    The first four concern the vectors taken from a video, the others the metric.

    Examples
    --------
    >>> import oppload_cli as oppload
    >>> oppload.RmoParams().names()[:2]
    ('grid', 'reduction')
    """

    grid: int | None = parameter(
        None,
        "distance between motion vectors; default 1/17 of the working height",
        unit="px",
        low=4,
    )
    reduction: int = parameter(
        4, "the flow is computed on frames reduced by this factor", choices=(1, 2, 4)
    )
    minimum_speed: float = parameter(
        0.2, "slower motion vectors are dropped", unit="px/frame", low=0.0
    )
    minimum_change: float = parameter(
        0.004,
        "a vector is dropped where its cell changes less on average: there the flow is guessed "
        "from its neighbours",
        unit="luminance",
        low=0.0,
        high=1.0,
    )
    opposite_tolerance: float = parameter(
        30.0,
        "largest departure of two vectors from antiparallel (theta_T)",
        unit="deg",
        low=0,
        high=90,
    )
    outward_tolerance: float = parameter(
        45.0,
        "largest angle between a pair's common line and the line through its starts (theta_R); "
        "90 is the paper's literal reading",
        unit="deg",
        low=0,
        high=90,
    )
    sides: int = parameter(
        2,
        "sides of the centre over which the symmetric length is counted; "
        "1 is the paper's literal integral",
        choices=(1, 2),
    )


DEFAULT_RMO = RmoParams()


class RmoMetrics(NamedTuple):
    """Radial motion opponency of one set of motion vectors (``docs/rmo.md``).

    Attributes
    ----------
    flow_vectors : int
        Motion vectors that are not zero.
    rom_pairs : int
        Opposite outward pairs.
    rom_share : float
        ROM pairs over all pairs of vectors, 0 to 1.
    rmo_mean, rmo_max : float
        Mean and largest RMO of the ROM pairs, 0 to 1; 0 without a ROM pair.
    rmo_index : float
        RMO of the outward less that of the inward pairs, over that of all opposite
        pairs: 1 for pure expansion, -1 for contraction; 0 without an opposite pair.

    Examples
    --------
    >>> import oppload_cli as oppload
    >>> records = list(oppload.analyse("controls/looming-perspective"))
    >>> records[0].rmo is None, isinstance(records[60].rmo, oppload.RmoMetrics)
    (True, True)
    >>> records[60].rmo.rmo_index > 0.5
    True
    """

    flow_vectors: int = 0
    rom_pairs: int = 0
    rom_share: float = 0.0
    rmo_mean: float = 0.0
    rmo_max: float = 0.0
    rmo_index: float = 0.0


def rmo(v1: ArrayLike, v2: ArrayLike, sides: int = 2) -> NDArray[np.float64]:
    """Return the radial motion opponency of pairs of opposite vectors; 0 where one of them is zero.

    ``sides * min(|v1|, |v2|) / (|v1| + |v2|)``: the closed form of the paper's projection and
    integral (equations "degree of RMO" and "length of symmetric part"; see ``docs/rmo.md``). That
    the two are opposite is not checked here.

    Parameters
    ----------
    v1, v2 : array_like, shape (..., 2)
        Motion vectors (x, y), in any one unit.
    sides : int
        2 counts the symmetric length on both sides of the centre (0 to 1), 1 on one side, as the
        paper's integral literally does (0 to 0.5).

    Raises
    ------
    ParameterError
        If `sides` is neither 1 nor 2, or the vectors are not pairs of finite numbers.
    """
    RmoParams(sides=sides)
    one, other = _points("v1", v1), _points("v2", v2)
    return _opponency(length(one), length(other), sides)


def opposite_pairs(vectors: ArrayLike, tolerance: float = 30.0) -> tuple[Rows, Rows]:
    """Return which pairs of vectors are opposite, each pair once.

    Two vectors are opposite if the angle between one and the negative of the other
    is below `tolerance` (the paper's first equation). A zero vector is in no pair.

    Parameters
    ----------
    vectors : array_like, shape (n, 2)
        Motion vectors (x, y).
    tolerance : float
        theta_T, in degrees, 0 to 90.

    Returns
    -------
    first, second : ndarray of int, shape (pairs,)
        Row numbers, ``first < second``, in ascending order.

    Raises
    ------
    ParameterError
        If `tolerance` is out of range, or the vectors are not pairs of finite numbers.
    """
    RmoParams(opposite_tolerance=tolerance)
    moving = _Moving(vectors, vectors)
    return moving.named(*_joined(moving.opposite(tolerance)))


def rom_pairs(
    starts: ArrayLike, vectors: ArrayLike, params: RmoParams | None = None
) -> tuple[Rows, Rows]:
    """Return the ROM pairs: opposite vectors that point away from each other.

    With u the line that the two share, a pair is outward if the angle between
    ``start1 - start2`` and u is below `params.outward_tolerance`.

    Parameters
    ----------
    starts, vectors : array_like, shape (n, 2)
        Where each motion vector starts, and the vector (x, y).
    params : RmoParams, optional
        Tolerances; the default ones if omitted.

    Returns
    -------
    first, second : ndarray of int, shape (pairs,)
        Row numbers, ``first < second``, in ascending order.

    Raises
    ------
    ParameterError
        If the two arrays are not of one shape (n, 2) with finite numbers.
    """
    params = params or DEFAULT_RMO
    moving = _Moving(starts, vectors)
    first, second = _joined(moving.opposite(params.opposite_tolerance))
    outward, _ = moving.radial(first, second, params.outward_tolerance)
    return moving.named(first[outward], second[outward])


def rmo_metrics(
    starts: ArrayLike, vectors: ArrayLike, params: RmoParams | None = None
) -> RmoMetrics:
    """Measure the radial motion opponency of a set of motion vectors; zeros where there is no pair.

    Every pair is looked at. The definition is in ``docs/rmo.md``; units, shifts and rotations of
    the plane do not matter.

    Parameters
    ----------
    starts, vectors : array_like, shape (n, 2)
        Where each motion vector starts, and the vector (x, y). Zero vectors are left out; no
        minimum speed is applied.
    params : RmoParams, optional
        Tolerances and sides; the default ones if omitted.

    Raises
    ------
    ParameterError
        If the two arrays are not of one shape (n, 2) with finite numbers.
    """
    motion, origin = _matching(starts, vectors)
    return metrics_of(origin, motion, params or DEFAULT_RMO)


def metrics_of(
    starts: NDArray[np.float64], vectors: NDArray[np.float64], params: RmoParams
) -> RmoMetrics:
    """Measure as :func:`rmo_metrics` does, without checking the arrays of float64, shape (n, 2)."""
    count, opposite, outward, inward, largest, pairs = rmo_sums(
        starts, vectors, params.opposite_tolerance, params.outward_tolerance, params.sides
    )
    return RmoMetrics(
        flow_vectors=count,
        rom_pairs=pairs,
        rom_share=pairs / (count * (count - 1) // 2) if pairs else 0.0,
        rmo_mean=outward / pairs if pairs else 0.0,
        rmo_max=largest,
        rmo_index=(outward - inward) / opposite if opposite > 0 else 0.0,
    )


@with_twin
def rmo_sums(
    starts: Points, vectors: Points, opposite_tolerance: float, outward_tolerance: float, sides: int
) -> tuple[int, float, float, float, float, int]:
    """Sum the RMO of all pairs of vectors.

    Parameters
    ----------
    starts, vectors : ndarray of float64, shape (n, 2)
        Finite.
    opposite_tolerance, outward_tolerance : float
        theta_T and theta_R in degrees.
    sides : int
        Of the centre over which the symmetric length is counted, 1 or 2.

    Returns
    -------
    vectors : int
        Vectors that are not zero.
    opposite, outward, inward : float
        RMO of the opposite pairs, and of those that are outward and inward, summed.
    largest : float
        The largest RMO of an outward pair; 0 without one.
    pairs : int
        Outward pairs: the ROM pairs.
    """
    moving = _Moving(starts, vectors)
    pairs = 0
    outward_sum = inward_sum = opposite_sum = largest = 0.0
    for first, second in moving.opposite(opposite_tolerance):
        outward, inward = moving.radial(first, second, outward_tolerance)
        values = _opponency(moving.speeds[first], moving.speeds[second], sides)
        # Products rather than selections: the sum of all and of the outward ones are then
        # the same additions, and the index of a pure expansion is exactly 1.
        kept = values * outward
        pairs += int(outward.sum())
        outward_sum += float(kept.sum())
        inward_sum += float((values * inward).sum())
        opposite_sum += float(values.sum())
        largest = max(largest, float(kept.max()))
    return moving.speeds.size, opposite_sum, outward_sum, inward_sum, largest, pairs


# Pairs handled at once: bounds the memory, and keeps the temporary arrays in the cache.
_BLOCK = 4096


class _Moving:
    """The vectors that are not zero, sorted by direction.

    So the opposites of a vector stand in one run, and no other pair is ever formed.
    """

    def __init__(self, starts: ArrayLike, vectors: ArrayLike) -> None:
        motion, origin = _matching(starts, vectors)
        speeds = length(motion)
        rows = np.flatnonzero(speeds)
        angles = np.arctan2(motion[rows, 1], motion[rows, 0])
        order = np.argsort(angles, kind="stable")
        self.rows = rows[order]
        self.angles = angles[order]
        self.speeds = speeds[self.rows]
        # As complex numbers x + iy: one gather per pair for both.
        self.units = _complex(motion[self.rows]) / self.speeds
        self.starts = _complex(origin[self.rows])

    def opposite(self, tolerance: float) -> Iterator[tuple[Rows, Rows]]:
        """Yield the opposite pairs in blocks, as positions in the sorted arrays."""
        wide = math.radians(tolerance)
        if self.angles.size < 2 or self.angles[-1] - self.angles[0] <= math.pi - wide:
            return
        low = np.searchsorted(self.angles, self.angles + (math.pi - wide), side="right")
        high = np.searchsorted(self.angles, self.angles + (math.pi + wide), side="left")
        counts = np.maximum(high - low, 0)
        block = np.cumsum(counts) // _BLOCK
        for some in np.split(np.arange(counts.size), np.flatnonzero(np.diff(block)) + 1):
            run = counts[some]
            first = np.repeat(some, run)
            offset = low[some] - (np.cumsum(run) - run)
            second = np.arange(first.size) + np.repeat(offset, run)
            if first.size:
                yield first, second

    def radial(
        self, first: Rows, second: Rows, tolerance: float
    ) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Return which of some pairs are outward, and which inward."""
        line = self.units[first] - self.units[second]
        distance = self.starts[first] - self.starts[second]
        along = line.real * distance.real + line.imag * distance.imag
        across = np.abs(line.real * distance.imag - line.imag * distance.real)
        # Compares the angle between the two with the tolerance, without computing it.
        along *= math.tan(math.radians(tolerance))
        return along > across, -along > across

    def named(self, first: Rows, second: Rows) -> tuple[Rows, Rows]:
        """Turn positions into the caller's row numbers, in ascending order."""
        pairs = np.sort([self.rows[first], self.rows[second]], axis=0)
        smaller, larger = pairs[:, np.lexsort(pairs[::-1])]
        return smaller, larger


def _matching(starts: ArrayLike, vectors: ArrayLike) -> tuple[Points, Points]:
    """Return vectors and their starts, of one shape (n, 2) and finite."""
    motion, origin = _points("vectors", vectors), _points("starts", starts)
    if motion.ndim != 2 or origin.shape != motion.shape:
        raise ParameterError(
            f"starts and vectors are of shapes {origin.shape} and {motion.shape}; "
            "give two arrays of one shape (n, 2)"
        )
    return motion, origin


def _points(name: str, values: ArrayLike) -> Points:
    """Return points of the plane, shape (..., 2), that are finite."""
    array = np.asarray(values, dtype=np.float64)
    if array.ndim == 0 or array.shape[-1] != 2:
        raise ParameterError(f"{name} is of shape {array.shape}; its last axis must be (x, y)")
    if not np.isfinite(array).all():
        raise ParameterError(f"{name} holds numbers that are not finite; leave those rows out")
    return array


def length(points: Points) -> Lengths:
    """Return the lengths of vectors (x, y), shape (..., 2)."""
    return np.asarray(np.hypot(points[..., 0], points[..., 1]), np.float64)


def _complex(points: Points) -> NDArray[np.complex128]:
    return points[:, 0] + 1j * points[:, 1]


def _joined(blocks: Iterable[tuple[Rows, Rows]]) -> tuple[Rows, Rows]:
    none = np.empty(0, dtype=np.intp)
    first, second = zip((none, none), *blocks, strict=True)
    return np.concatenate(first), np.concatenate(second)


def _opponency(speed1: Lengths, speed2: Lengths, sides: int) -> Lengths:
    total = speed1 + speed2
    symmetric = np.minimum(speed1, speed2) * sides
    return symmetric / np.where(total > 0, total, 1.0)
