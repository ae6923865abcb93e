"""The compiled twins of the steps around optical flow, and of RMO (flow.c, rmo.c)."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from oppload_cli.compute.loops import address, loops

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Grey = NDArray[np.uint8]
    Points = NDArray[np.float64]

_CHANNELS = 4  # that are averaged over a cell: x, y, change and a spare one
_LANES = 4  # doubles of a vector of rmo.c


def reduce(frame: Grey, reduction: int, out: Grey) -> None:
    """Average squares of pixels, as :func:`oppload_cli.motion.flow.reduce` does."""
    rows, columns = out.shape
    if reduction == 1:
        np.copyto(out, frame)
        return
    line = np.empty(reduction * columns, np.uint16)
    loops().reduce(
        *(address(frame), frame.strides[0], reduction, rows, columns),
        *(address(out), address(line)),
    )


def sample(
    before: Grey,
    now: Grey,
    flow: NDArray[np.float32],
    cells: tuple[int, int, int, int, int],
    least: tuple[float, float],
) -> tuple[Points, Points]:
    """Sample flow on a grid, as :func:`oppload_cli.motion.flow.sample` does."""
    rows, columns = now.shape
    cell_rows, cell_columns, *_ = cells
    starts, vectors = np.empty((2, cell_rows * cell_columns, 2))
    shares = np.empty((2 * (rows + columns + cell_rows + cell_columns), 2))
    means = np.empty((2 * cell_columns, _CHANNELS), np.float32)
    kept = loops().sample(
        *(address(before), address(now), address(flow), rows, columns, *cells),
        *(least[0], 255.0 * least[1]),
        *(address(starts), address(vectors), address(shares), address(means)),
    )
    return starts[:kept], vectors[:kept]


def rmo_sums(
    starts: Points, vectors: Points, opposite_tolerance: float, outward_tolerance: float, sides: int
) -> tuple[int, float, float, float, float, int]:
    """Sum RMO over all pairs, as :func:`oppload_cli.motion.rmo.rmo_sums` does."""
    motion, origin = np.ascontiguousarray(vectors), np.ascontiguousarray(starts)
    rows, sums = np.empty(5 * (len(motion) + _LANES)), np.empty(6)
    loops().rmo_sums(
        *(address(motion), address(origin), len(motion)),
        math.tan(math.radians(opposite_tolerance)),
        math.tan(math.radians(outward_tolerance)),
        *(sides, address(rows), address(sums)),
    )
    count, opposite, outward, inward, largest, pairs = sums.tolist()
    return int(count), opposite, outward, inward, largest, int(pairs)
