"""Radial opponent motion (ROM) pairs and radial motion opponency (RMO).

This module contains only the metric: it takes arrays of motion vectors and returns numbers. The
vectors may come from any program and be in any unit. x grows to the right and y downwards, as in
images. Only lengths and angles matter, so that the direction of y does not change results.
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
    """Parameters of motion vectors and of radial motion opponency (``docs/rmo.md``).

    The first three are used where vectors are taken from a video; the others belong to the metric.

    Examples
    --------
    >>> import oppload_cli as oppload
    >>> oppload.RmoParams().names()[:2]
    ('grid', 'minimum_speed')
    """

    grid: int | None = parameter(
        None,
        "distance between motion vectors; auto: 1/17 of the working height",
        unit="px",
        low=4,
    )
    minimum_speed: float = parameter(
        0.2, "slower motion vectors are dropped", unit="px/frame", low=0.0
    )
    minimum_change: float = parameter(
        0.004,
        "vectors of cells with a smaller mean change are dropped: their flow is only a guess from "
        "neighbouring cells",
        unit="luminance",
        low=0.0,
        high=1.0,
    )
    opposite_tolerance: float = parameter(
        30.0,
        "two vectors are opposite if the angle between one and the negative of the other is below "
        "this (theta_T)",
        unit="deg",
        low=0,
        high=90,
    )
    outward_tolerance: float = parameter(
        45.0,
        "a pair is outward if the angle between its common line and the line through its starts is "
        "below this (theta_R); the paper's text means 90",
        unit="deg",
        low=0,
        high=90,
    )
    sides: int = parameter(
        2,
        "number of sides of the centre on which the symmetric length is counted; the paper's "
        "integral has 1",
        choices=(1, 2),
    )


class RmoMetrics(NamedTuple):
    """Radial motion opponency of one set of motion vectors (``docs/rmo.md``).

    Attributes
    ----------
    flow_vectors : int
        Number of motion vectors that are not zero.
    rom_pairs : int
        Number of ROM pairs: opposite vectors that point outward.
    rom_share : float
        Share of ROM pairs among all pairs of vectors, 0 to 1.
    rmo_mean, rmo_max : float
        Mean and largest RMO of the ROM pairs, 0 to 1; 0 without a ROM pair.
    rmo_index : float
        Sum of RMO over outward pairs minus that over inward pairs, divided by the sum over all
        opposite pairs: 1 for pure expansion, -1 for contraction; 0 without an opposite pair.

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
    """Return the radial motion opponency of pairs of opposite vectors; 0 if one of them is zero.

    RMO is ``sides * min(|v1|, |v2|) / (|v1| + |v2|)``, the closed form of the paper's projection
    and integral (equations "degree of RMO" and "length of symmetric part"; see ``docs/rmo.md``).
    The function does not check that the vectors are opposite.

    Parameters
    ----------
    v1, v2 : array_like, shape (..., 2)
        Motion vectors (x, y), in any one unit.
    sides : int
        2 counts the symmetric length on both sides of the centre (the result is 0 to 1). 1 counts
        it on one side, as the paper's integral does (0 to 0.5).

    Raises
    ------
    ParameterError
        If `sides` is neither 1 nor 2, if the vectors are not pairs of finite numbers, or if there
        are more of one than of the other.
    """
    RmoParams(sides=sides)  # checks the value
    first, second = length(_points("v1", v1)), length(_points("v2", v2))
    try:
        first, second = np.broadcast_arrays(first, second)
    except ValueError:
        raise ParameterError(
            f"v1 and v2 hold {first.shape} and {second.shape} vectors; give as many of both"
        ) from None
    return _rmo_of_lengths(first, second, sides)


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
    RmoParams(opposite_tolerance=tolerance)  # checks the value
    moving = _Moving(vectors, vectors)
    first, second = _joined(moving.opposite(tolerance))
    return moving.rows[first], moving.rows[second]


def rom_pairs(
    starts: ArrayLike, vectors: ArrayLike, params: RmoParams | None = None
) -> tuple[Rows, Rows]:
    """Return the ROM pairs: opposite vectors that point away from each other.

    The common line of a pair has the direction u, that of ``v1/|v1| - v2/|v2|``. The pair is
    outward if the angle between ``start1 - start2`` and u is below `params.outward_tolerance`.
    Parameters and errors are those of :func:`rmo_metrics`, and the two arrays that it returns are
    like those of :func:`opposite_pairs`.
    """
    params = params or RmoParams()
    moving = _Moving(starts, vectors)
    first, second = _joined(moving.opposite(params.opposite_tolerance))
    outward, _ = moving.radial(first, second, params.outward_tolerance)
    return moving.rows[first[outward]], moving.rows[second[outward]]


def rmo_metrics(
    starts: ArrayLike, vectors: ArrayLike, params: RmoParams | None = None
) -> RmoMetrics:
    """Measure the radial motion opponency of a set of motion vectors; zeros if there is no pair.

    All pairs are examined. ``docs/rmo.md`` has the definition. Units, shifts and rotations of the
    plane do not change the result.

    Parameters
    ----------
    starts, vectors : array_like, shape (n, 2)
        Start (x, y) of each motion vector, and the vector (x, y). Zero vectors are left out; there
        is no minimum speed.
    params : RmoParams, optional
        Tolerances and sides; the defaults if left out.

    Raises
    ------
    ParameterError
        If the two arrays do not have the same shape (n, 2), or hold numbers that are not finite.
    """
    params = params or RmoParams()
    motion, origin = _matching(starts, vectors)
    tolerances = params.opposite_tolerance, params.outward_tolerance
    count, opposite, outward, inward, largest, pairs = rmo_sums(
        origin, motion, *tolerances, params.sides
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
        Starts and vectors (x, y), finite.
    opposite_tolerance, outward_tolerance : float
        theta_T and theta_R in degrees.
    sides : int
        Number of sides of the centre on which the symmetric length is counted, 1 or 2.

    Returns
    -------
    vectors : int
        Number of vectors that are not zero.
    opposite, outward, inward : float
        Sums of RMO over all opposite pairs, over the outward and over the inward ones.
    largest : float
        The largest RMO of an outward pair; 0 without one.
    pairs : int
        Number of outward pairs: the ROM pairs.
    """
    moving = _Moving(starts, vectors)
    pairs = 0
    outward_sum = inward_sum = opposite_sum = largest = 0.0
    for first, second in moving.opposite(opposite_tolerance):
        outward, inward = moving.radial(first, second, outward_tolerance)
        values = _rmo_of_lengths(moving.speeds[first], moving.speeds[second], sides)
        # RMO of pairs that are not outward is set to 0, and not left out. So both sums have the
        # same additions, and the index of a pure expansion is exactly 1.
        kept = values * outward
        pairs += int(outward.sum())
        outward_sum += float(kept.sum())
        inward_sum += float((values * inward).sum())
        opposite_sum += float(values.sum())
        largest = max(largest, float(kept.max()))
    return moving.speeds.size, opposite_sum, outward_sum, inward_sum, largest, pairs


_BLOCK = 1 << 16  # approximate number of pairs that are examined at a time, which bounds the memory


class _Moving:
    """The vectors that are not zero, and their starts, as complex numbers x + iy."""

    def __init__(self, starts: ArrayLike, vectors: ArrayLike) -> None:
        motion, origin = _matching(starts, vectors)
        speeds = length(motion)
        self.rows = np.flatnonzero(speeds)
        self.speeds = speeds[self.rows]
        self.unit_vectors = _complex(motion[self.rows]) / self.speeds
        self.starts = _complex(origin[self.rows])

    def opposite(self, tolerance: float) -> Iterator[tuple[Rows, Rows]]:
        """Yield the opposite pairs in blocks, as positions in these arrays, in ascending order."""
        tangent, count = math.tan(math.radians(tolerance)), len(self.unit_vectors)
        rows = _BLOCK // (count + 1) + 1
        for start in range(0, count, rows):
            product = self.unit_vectors[start : start + rows, None] * self.unit_vectors.conj()
            # This compares the angle between one vector and the negative of the other.
            opposite = np.abs(product.imag) < -tangent * product.real
            first, second = np.nonzero(np.triu(opposite, start + 1))
            if first.size:
                yield first + start, second

    def radial(
        self, first: Rows, second: Rows, tolerance: float
    ) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Return which of some pairs are outward, and which inward."""
        line = self.unit_vectors[first] - self.unit_vectors[second]
        distance = self.starts[first] - self.starts[second]
        along = line.real * distance.real + line.imag * distance.imag
        across = np.abs(line.real * distance.imag - line.imag * distance.real)
        # This compares the angle between `line` and `distance` with the tolerance.
        along *= math.tan(math.radians(tolerance))
        return along > across, -along > across


def _matching(starts: ArrayLike, vectors: ArrayLike) -> tuple[Points, Points]:
    """Return vectors and their starts as finite arrays of the same shape (n, 2)."""
    motion, origin = _points("vectors", vectors), _points("starts", starts)
    if motion.ndim != 2 or origin.shape != motion.shape:
        raise ParameterError(
            f"starts and vectors are of shapes {origin.shape} and {motion.shape}; "
            "give two arrays of one shape (n, 2)"
        )
    return motion, origin


def _points(name: str, values: ArrayLike) -> Points:
    """Return points (x, y) as a finite array of shape (..., 2)."""
    try:
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ParameterError(
            f"{name} holds something other than pairs of numbers ({error})"
        ) from error
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
    no_rows = np.empty(0, dtype=np.intp)
    first, second = zip((no_rows, no_rows), *blocks, strict=True)
    return np.concatenate(first), np.concatenate(second)


def _rmo_of_lengths(length1: Lengths, length2: Lengths, sides: int) -> Lengths:
    total = length1 + length2
    symmetric = np.minimum(length1, length2) * sides
    return symmetric / np.where(total > 0, total, 1.0)
