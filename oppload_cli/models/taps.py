"""The DPC kernels as the compiled sums take them: one value for all its mirror images.

The kernels are even across and down (W_E, W_I1, W_I2), and their directional parts are
sums of one that is odd across and one that is odd down. So a quadrant of each is enough.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from oppload_cli.models.kernels import direction_mask, excitation_kernel, inhibition_kernels
from oppload_cli.native.library import LANES, aligned

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import DTypeLike, NDArray

    from oppload_cli.models.kernels import Kernel
    from oppload_cli.models.parameters import DpcParams

# Those of presynaptic.h.
AGES = 3  # P(t), P(t-1) and P(t-2)
OUTPUTS = 9  # S, the pathways of one axis and of the other, those opposite, E, I, both J


def quadrants(params: DpcParams, axes: tuple[int, ...]) -> list[Kernel]:
    """Return the kernels of the three ages where dx and dy are at least 0.

    Parameters
    ----------
    params : DpcParams
        The DPC constants.
    axes : tuple of int
        Directions phi in degrees of the pathways' axes: none, or two at a right angle.

    Returns
    -------
    list of ndarray, shape (3, r + 1, r + 1)
        Of W_E, W_I1 and W_I2 each: the kernel, and the parts of its directional kernels
        that are odd across and odd down. On the diagonals J_45 is the sum of both and
        J_135 their difference; on the axes J_0 is the one and J_90 the other.
    """
    kernels = [excitation_kernel(params), *inhibition_kernels(params)]
    radius = params.kernel_radius
    return [
        np.stack([kernel, *_odd_parts(kernel, params, axes if age else ())])[:, radius:, radius:]
        for age, kernel in enumerate(kernels)
    ]


def runs(there: NDArray[np.bool_]) -> Iterator[tuple[int, int]]:
    """Say where values stand side by side.

    Parameters
    ----------
    there : ndarray of bool, shape (n,)
        Whether there is a value.

    Yields
    ------
    int, int
        The first place of a run, and how long it is.
    """
    steps = np.diff(there.astype(np.int8), prepend=0, append=0)
    for first, last in zip(np.flatnonzero(steps > 0), np.flatnonzero(steps < 0), strict=True):
        yield int(first), int(last - first)


def with_zeros(
    height: int, padded: int, reach: int, width: int, kind: DTypeLike = np.float32
) -> tuple[int, list[NDArray[Any]]]:
    """Make one map for each age, with zeros around it.

    Parameters
    ----------
    height, padded : int
        Of the maps; `padded` is the width in whole strips.
    reach : int
        How far the kernels reach.
    width : int
        Of the frame.
    kind : dtype
        float32 or uint8.

    Returns
    -------
    stride : int
        Distance of two rows, in values.
    inside : list of ndarray, shape (height, width)
        Views of the frame's part of each map.
    """
    margin = (reach // LANES + 1) * LANES  # a value more than the reach: values come in pairs
    stride = margin + padded + margin + LANES
    floats = stride * np.dtype(kind).itemsize // 4
    whole = aligned((AGES, height + 2 * reach, floats)).view(kind)
    return stride, [each[reach : reach + height, margin : margin + width] for each in whole]


def _odd_parts(kernel: Kernel, params: DpcParams, axes: tuple[int, ...]) -> tuple[Kernel, Kernel]:
    if not axes:
        return np.zeros_like(kernel), np.zeros_like(kernel)
    one, other = (kernel * (direction_mask(params, phi) - 0.5) for phi in axes)
    if 0 in axes:
        return one, other
    return (one - other) / 2, (one + other) / 2
