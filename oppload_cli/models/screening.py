"""Bounds of 8 bits that tell early where every S is 0.

Where ``E <= I_phi`` in all directions S is 0, and in most places W_I1 alone shows that.
To find them, E is rounded up, and the inhibition down: by sums over boxes of 2 x 2 pixels
of P(t-1), each with the least weight that it has in the box. So a place that is passed over
is never one with an S above 0.
"""

from __future__ import annotations

import ctypes
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from oppload_cli.models.kernels import Kernel

    Weights = NDArray[np.float64]  # shape (PATHWAYS, 2 r + 1, 2 r + 1)
    Place = Sequence[int]  # dy, dx: of a pixel, or of the left top one of a box

# Those of screening.h.
SCREENED = 32
PATHWAYS = 4
MOST = 127  # weight
LARGEST = 64  # of what inhibits: the sum of two boxes fits 16 bits


class _Bounded(ctypes.Structure):
    """``struct bounded`` of screening.h."""

    _fields_ = (("places", ctypes.c_int32 * 2), ("weights", ctypes.c_int8 * 4 * PATHWAYS))


class _Bound(ctypes.Structure):
    """``struct bound`` of screening.h."""

    _fields_ = (("pairs", ctypes.POINTER(_Bounded)), ("count", ctypes.c_int))


class Screening(ctypes.Structure):
    """``struct screening`` of screening.h: what a frame is screened by.

    Attributes
    ----------
    excitation, inhibition
        Bounds of E from above and of the I_phi from below.
    reach : int
        How far the boxes lie from the pixel that is looked at.
    """

    _fields_ = (("excitation", _Bound), ("inhibition", _Bound), ("reach", ctypes.c_int))

    @classmethod
    def of(cls, kernels: list[Kernel], stride: int, *, diagonal: bool) -> Screening:
        """Return that of some kernels.

        Parameters
        ----------
        kernels : list of ndarray, shape (3, r + 1, r + 1)
            W_E and W_I1, as :func:`oppload_cli.models.taps.quadrants` has them.
        stride : int
            Distance of two rows of P, in values.
        diagonal : bool
            Whether the axes are the diagonals.

        Returns
        -------
        Screening
        """
        excitation = np.stack([_mirrored(kernels[0][0])] * PATHWAYS)
        inhibition = _least_in_boxes(_of_pathways(kernels[1], diagonal=diagonal))
        # Without a kernel any scale will do.
        limits = [(MOST, excitation.max()), (LARGEST, inhibition.max())]
        scale = min((limit / largest for limit, largest in limits if largest > 0), default=1.0)
        boxes = list(_boxes(inhibition))
        reach = max((abs(side) for box in boxes for side in box), default=0)
        pixels = (np.argwhere(excitation[0] > 0) - excitation.shape[-1] // 2).tolist()
        return cls(
            _bound(np.ceil(scale * excitation), pixels, stride),
            _bound(np.floor(scale * inhibition), boxes, stride),
            reach,
        )


def _bound(weights: Weights, places: list[Place], stride: int) -> _Bound:
    """Return the values at some places and their weights, two by two."""
    reach = weights.shape[-1] // 2
    pairs = (_Bounded * -(-len(places) // 2))()
    for n, (dy, dx) in enumerate(places):
        pair, which = pairs[n // 2], n % 2
        pair.places[which] = dy * stride + dx
        for pathway, weight in enumerate(weights[:, reach + dy, reach + dx]):
            pair.weights[pathway][which] = pair.weights[pathway][which + 2] = int(weight)
    return _Bound(pairs, len(pairs))


def _boxes(weights: Weights) -> Iterator[Place]:
    """Cut a kernel into boxes that weigh something: each side from its middle row on."""
    reach = weights.shape[-1] // 2
    for dy in (*range(1, reach, 2), *range(-2, -reach - 1, -2)):
        dx = -reach
        while dx < reach:
            if weights[:, reach + dy, reach + dx].max() > 0:
                yield dy, dx
                dx += 1
            dx += 1


def _least_in_boxes(weights: Weights) -> Weights:
    """Return the least weight in the box whose left top pixel is each one."""
    padded = np.pad(weights, ((0, 0), (0, 1), (0, 1)))
    parts = (padded[:, y : y - 1 or None, x : x - 1 or None] for y in (0, 1) for x in (0, 1))
    return np.asarray(np.minimum.reduce(list(parts)))


def _of_pathways(quadrant: Kernel, *, diagonal: bool) -> Weights:
    """Return the inhibition of each pathway from its even and odd parts."""
    even, across, down = quadrant
    half, across, down = _mirrored(even) / 2, _mirrored(across, x=-1), _mirrored(down, y=-1)
    one, other = (down + across, down - across) if diagonal else (across, down)
    return np.stack([half + one, half - one, half + other, half - other])


def _mirrored(quadrant: Kernel, x: int = 1, y: int = 1) -> NDArray[np.float64]:
    """Return a kernel that is even (1) or odd (-1) across and down, from its quadrant."""
    right = np.concatenate([x * quadrant[:, :0:-1], quadrant], axis=1, dtype=np.float64)
    return np.concatenate([y * right[:0:-1], right])
