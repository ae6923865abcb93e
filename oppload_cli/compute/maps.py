"""The compiled twins of grouping, pooling and opponent products (maps.c)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from oppload_cli.compute.loops import address, in_bands, loops

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float32]


def group(
    presynaptic: Floats, side: int, threshold: float, limit: float, out: Floats
) -> tuple[float, float]:
    """Compute G, as :func:`oppload_cli.models.dlgmd.group` does."""
    height, width = shape = presynaptic.shape[0], presynaptic.shape[1]
    totals = np.empty((height, 2))
    arguments = (
        *(address(presynaptic), height, width, side, threshold, limit),
        *(address(out), address(totals)),
    )
    compute = loops().group
    in_bands(shape, lambda _, first, last: compute(*arguments, first, last))
    s, g = (totals.sum(axis=0) / presynaptic.size).tolist()
    return s, g


def pool(values: Floats, down: Floats, across: Floats) -> Floats:
    """Pool a map, as :func:`oppload_cli.models.opposing_motion.pool` does."""
    (height, width), rows, columns = values.shape, len(down), len(across)
    half, out = np.empty((rows, width), np.float32), np.empty((rows, columns), np.float32)
    loops().pool(
        *(address(values), height, width, address(down), rows, address(across), columns),
        *(address(half), address(out)),
    )
    return out


def opponent_products(passing: Floats, opposite: Floats, weights: Floats) -> Floats:
    """Add up opponent products, as the function of the same name in the models does."""
    out = np.empty_like(passing)
    loops().opponent_products(
        *(address(passing), address(opposite), *passing.shape),
        *(address(weights), len(weights) // 2, address(out)),
    )
    return out
