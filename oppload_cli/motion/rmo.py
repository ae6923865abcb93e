"""Radial opponent motion (ROM) pairs and radial motion opponency (RMO).

The metric alone: arrays of motion vectors in, numbers out. Vectors may come from
anywhere and be in any unit. x grows right and y grows down, as in images; only
angles between vectors matter, so that the direction of y changes no result.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from oppload_cli.motion.parameters import RmoParams
from oppload_cli.motion.vectors import Moving, length, matching, points
from oppload_cli.native.library import LANES, address, compiled, library

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import ArrayLike, NDArray

_DEFAULTS = RmoParams()


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
    """

    flow_vectors: int = 0
    rom_pairs: int = 0
    rom_share: float = 0.0
    rmo_mean: float = 0.0
    rmo_max: float = 0.0
    rmo_index: float = 0.0


def rmo(v1: ArrayLike, v2: ArrayLike, sides: int = 2) -> NDArray[np.float64]:
    """Return the radial motion opponency of pairs of opposite vectors.

    ``sides * min(|v1|, |v2|) / (|v1| + |v2|)``: the closed form of the paper's
    projection and integral (equations "degree of RMO" and "length of symmetric
    part"; see ``docs/rmo.md``). That the two are opposite is not checked here.

    Parameters
    ----------
    v1, v2 : array_like, shape (..., 2)
        Motion vectors (x, y), in any one unit.
    sides : int
        2 counts the symmetric length on both sides of the centre (0 to 1), 1 on
        one side, as the paper's integral literally does (0 to 0.5).

    Returns
    -------
    ndarray, shape (...)
        0 where one of the two is zero.

    Raises
    ------
    ParameterError
        If `sides` is neither 1 nor 2, or the vectors are not pairs of finite numbers.
    """
    RmoParams(sides=sides)
    one, other = points("v1", v1), points("v2", v2)
    return _opponency(length(one), length(other), sides)


def opposite_pairs(
    vectors: ArrayLike, tolerance: float = 30.0
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
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
    moving = Moving(vectors, vectors)
    return moving.named(*_joined(moving.opposite(tolerance)))


def rom_pairs(
    starts: ArrayLike, vectors: ArrayLike, params: RmoParams | None = None
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
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
    params = params or _DEFAULTS
    moving = Moving(starts, vectors)
    first, second = _joined(moving.opposite(params.opposite_tolerance))
    outward, _ = moving.radial(first, second, params.outward_tolerance)
    return moving.named(first[outward], second[outward])


def rmo_metrics(
    starts: ArrayLike, vectors: ArrayLike, params: RmoParams | None = None
) -> RmoMetrics:
    """Measure the radial motion opponency of a set of motion vectors.

    Every pair is looked at. The definition is in ``docs/rmo.md``; units, shifts and
    rotations of the plane do not matter.

    Parameters
    ----------
    starts, vectors : array_like, shape (n, 2)
        Where each motion vector starts, and the vector (x, y). Zero vectors are
        left out; no minimum speed is applied.
    params : RmoParams, optional
        Tolerances and sides; the default ones if omitted.

    Returns
    -------
    RmoMetrics
        Zeros where there is no pair.

    Raises
    ------
    ParameterError
        If the two arrays are not of one shape (n, 2) with finite numbers.
    """
    motion, origin = matching(starts, vectors)
    return metrics_of(origin, motion, params or _DEFAULTS)


def metrics_of(
    starts: NDArray[np.float64], vectors: NDArray[np.float64], params: RmoParams
) -> RmoMetrics:
    """Measure as :func:`rmo_metrics` does, without checking what is given.

    Parameters
    ----------
    starts, vectors : ndarray of float64, shape (n, 2)
        Finite.
    params : RmoParams
        Tolerances and sides.

    Returns
    -------
    RmoMetrics

    Source: ``docs/rmo.md``.
    """
    sums = (_compiled_sums if library() else _portable_sums)(starts, vectors, params)
    count, outward_pairs = sums.vectors, sums.outward_pairs
    return RmoMetrics(
        flow_vectors=count,
        rom_pairs=outward_pairs,
        rom_share=outward_pairs / (count * (count - 1) // 2) if outward_pairs else 0.0,
        rmo_mean=sums.outward / outward_pairs if outward_pairs else 0.0,
        rmo_max=sums.largest,
        rmo_index=(sums.outward - sums.inward) / sums.opposite if sums.opposite > 0 else 0.0,
    )


class _Sums(NamedTuple):
    """Vectors that are not zero, and the RMO of their pairs, summed."""

    vectors: int
    opposite: float
    outward: float
    inward: float
    largest: float
    outward_pairs: int


def _portable_sums(
    starts: NDArray[np.float64], vectors: NDArray[np.float64], params: RmoParams
) -> _Sums:
    moving = Moving(starts, vectors)
    outward_pairs = 0
    outward_sum = inward_sum = opposite_sum = largest = 0.0
    for first, second in moving.opposite(params.opposite_tolerance):
        outward, inward = moving.radial(first, second, params.outward_tolerance)
        values = _opponency(moving.speeds[first], moving.speeds[second], params.sides)
        # Products rather than selections: the sum of all and of the outward ones are then
        # the same additions, and the index of a pure expansion is exactly 1.
        kept = values * outward
        outward_pairs += int(outward.sum())
        outward_sum += float(kept.sum())
        inward_sum += float((values * inward).sum())
        opposite_sum += float(values.sum())
        largest = max(largest, float(kept.max()))
    return _Sums(moving.speeds.size, opposite_sum, outward_sum, inward_sum, largest, outward_pairs)


def _compiled_sums(
    starts: NDArray[np.float64], vectors: NDArray[np.float64], params: RmoParams
) -> _Sums:
    motion, origin = np.ascontiguousarray(vectors), np.ascontiguousarray(starts)
    rows = np.empty(5 * (len(motion) + LANES))
    sums = np.empty(6)
    compiled().opponency(
        *(address(motion), address(origin), len(motion)),
        math.tan(math.radians(params.opposite_tolerance)),
        math.tan(math.radians(params.outward_tolerance)),
        *(params.sides, address(rows), address(sums)),
    )
    count, opposite, outward, inward, largest, outward_pairs = sums.tolist()
    return _Sums(int(count), opposite, outward, inward, largest, int(outward_pairs))


def _joined(
    blocks: Iterable[tuple[NDArray[np.intp], NDArray[np.intp]]],
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    none = np.empty(0, dtype=np.intp)
    first, second = zip((none, none), *blocks, strict=True)
    return np.concatenate(first), np.concatenate(second)


def _opponency(
    speed1: NDArray[np.float64], speed2: NDArray[np.float64], sides: int
) -> NDArray[np.float64]:
    total = speed1 + speed2
    symmetric = np.minimum(speed1, speed2) * sides
    return symmetric / np.where(total > 0, total, 1.0)
