"""The compiled twins of functions of the models and of motion: they hand arrays to the loops in C.

Each has the name of its plain function, whose docstring says what it computes.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING
from weakref import WeakKeyDictionary

import numpy as np

from oppload_cli.compute.loops import address, bands_of, in_bands, loops

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from typing import Protocol

    from numpy.typing import NDArray

    Floats = NDArray[np.float32]
    Grey = NDArray[np.uint8]
    Kernel = NDArray[np.float64]
    Points = NDArray[np.float64]

    class Kernels(Protocol):
        """Square kernels of side 2 r + 1, and M_phi - 1/2 by the direction of each axis."""

        excitation: Kernel
        inhibition: Sequence[Kernel]
        odd_masks: Mapping[int, Kernel]

    class Sums(Protocol):
        """The maps into which S and the S_phi are written."""

        presynaptic: Floats
        pathways: Mapping[int, Floats]
        only_pathways: bool


_STAGES = 1, 1, 2  # parts in which E and the inhibition by P(t-1) and by P(t-2) are summed
_MOST_PATHWAYS = 4
_CHANNELS = 4  # that are averaged over a cell: x, y, change and a spare one
_ZEROS = 8  # after each row of cells
_LANES = 4  # doubles of a vector of rmo.c


class _Plan:
    """The kernels as presynaptic.c takes them, and room for its intermediate maps.

    The kernels are even across and down, and their directional parts are sums of one part that is
    odd across and one that is odd down. So one quadrant of each kernel is enough.
    """

    def __init__(self, kernels: Kernels) -> None:
        quadrants = [_quadrants(kernels.excitation, {})]
        quadrants += [_quadrants(each, kernels.odd_masks) for each in kernels.inhibition]
        stages, taps, offsets = [], [], []
        for number, (quadrant, parts) in enumerate(zip(quadrants, _STAGES, strict=True)):
            # The nearest values first, which inhibit most; each part takes every n-th of them.
            nearest = sorted(np.argwhere(quadrant[0]).tolist(), key=np.hypot.reduce)
            for some in (nearest[part::parts] for part in range(parts)):
                stages.append((number, len(some)))
                taps += [quadrant[:, dy, dx] for dy, dx in some]
                offsets += [(number, dy, dx) for dy, dx in some]
        age, dy, dx = np.array(offsets, np.intc).reshape(-1, 3).T
        reach = np.zeros(len(quadrants), np.intc)
        np.maximum.at(reach, age, np.maximum(dy, dx))
        self.slots = 1 << int(2 * reach.max()).bit_length()
        # In the scratch: zeros, then for each age a ring of `slots` folded rows.
        folded = loops().folded()
        rows = folded * (reach + 1)
        begins = folded + self.slots * (np.cumsum(rows) - rows)
        slot = np.arange(self.slots)[:, None]
        above, below = (
            begins[age] + (other & (self.slots - 1)) * rows[age] + folded * dx
            for other in (slot - dy, slot + dy)
        )
        self.stages = np.array(stages, np.intc)
        self.taps = np.array(taps, np.float32)
        self.places = np.stack([above, np.where(dy, below, 0)], -1).astype(np.intc)
        self.rings = np.stack([begins, reach], -1).astype(np.intc)
        self.axes = tuple(kernels.odd_masks)
        self.arguments = (
            *(address(self.stages), len(stages), address(self.taps), len(taps)),
            *(address(self.places), address(self.rings), self.slots, 45 in self.axes),
        )
        self._floats = folded + self.slots * int(rows.sum())
        self._scratch: Floats = np.zeros((0, 0), np.float32)

    def scratch(self, bands: int) -> list[int]:
        """Return the address of each band's room for intermediate maps."""
        if len(self._scratch) < bands:
            self._scratch = np.zeros((bands, self._floats), np.float32)
        return _addresses(self._scratch)


class _Outputs:
    """The addresses of the maps of sums, and which strips of their rows hold only zeros.

    The loops do not write zeros over zeros.
    """

    def __init__(self, sums: Sums, axes: tuple[int, ...]) -> None:
        self.axes = axes
        pathways = [sums.pathways[phi] for phi in (*axes, *(phi + 180 for phi in axes))]
        presynaptic = None if sums.only_pathways else address(sums.presynaptic)
        self.arguments = (
            *(presynaptic, *map(address, pathways)),
            *[None] * (_MOST_PATHWAYS - len(pathways)),
        )
        self._filled = np.ones(sums.presynaptic.shape, np.uint8)  # at first they may hold anything
        self.filled = address(self._filled)


_plans: WeakKeyDictionary[Kernels, _Plan] = WeakKeyDictionary()
_outputs: WeakKeyDictionary[Sums, _Outputs] = WeakKeyDictionary()


def presynaptic_sums(photoreceptors: Sequence[Floats], kernels: Kernels, out: Sums) -> None:
    """Compute S and S_phi, as :func:`oppload_cli.models.dpc.presynaptic_sums` does.

    Parameters
    ----------
    photoreceptors : sequence of ndarray of float32, shape (height, width)
        P(t), P(t-1) and P(t-2), contiguous.
    kernels : Kernels
        Of no axis, or of two axes at a right angle.
    out : Sums
        Takes the sums, contiguous.
    """
    if kernels not in _plans:
        _plans[kernels] = _Plan(kernels)
    plan = _plans[kernels]
    outputs = _outputs.get(out)
    if outputs is None or outputs.axes != plan.axes:
        outputs = _outputs[out] = _Outputs(out, plan.axes)
    height, width = shape = photoreceptors[0].shape[0], photoreceptors[0].shape[1]
    maps = [address(each) for each in photoreceptors]
    arguments = *maps, height, width, *plan.arguments, *outputs.arguments
    scratch, filled = plan.scratch(len(bands_of(shape))), outputs.filled
    compute = loops().presynaptic_sums
    in_bands(shape, lambda n, *rows: compute(*arguments, *rows, scratch[n], filled))


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


def pool(maps: Sequence[Floats], down: Floats, across: Floats) -> Floats:
    """Pool maps, as :func:`oppload_cli.models.opposing_motion.pool` does."""
    (height, width), rows, columns = maps[0].shape, len(down), len(across)
    half, out = (
        np.empty((rows, width), np.float32),
        np.empty((len(maps), rows, columns), np.float32),
    )
    shared = height, width, address(down), rows, address(across), columns, address(half)
    for each, to in zip(maps, _addresses(out), strict=True):
        loops().pool(address(each), *shared, to)
    return out


def opponent_products(pooled: Floats, weights: Floats) -> Floats:
    """Add up opponent products, as the function of the same name in the models does."""
    axes, rows, columns = len(weights), *pooled.shape[1:]
    stride, reach = columns + _ZEROS, weights.shape[-1] // 2
    padded = np.zeros((2 * axes, rows, stride), np.float32)
    padded[..., :columns] = pooled
    out = np.empty((axes, rows, stride), np.float32)
    at = _addresses(padded)
    for passing, opposite, weight, to in zip(
        at[:axes], at[axes:], _addresses(weights), _addresses(out), strict=True
    ):
        loops().opponent_products(
            *(passing, opposite, rows, columns, stride, weight, reach, to),
        )
    return out[..., :columns]


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


def _addresses(maps: Floats) -> list[int]:
    """Return where each map of a contiguous array stands in memory."""
    first, size = address(maps), maps[0].nbytes
    return [first + size * number for number in range(len(maps))]


def _quadrants(kernel: Kernel, masks: Mapping[int, Kernel]) -> Kernel:
    """Return the quadrant dx, dy >= 0 of a kernel and of its odd parts, shape (3, r+1, r+1).

    On the diagonals J_45 is the sum of both odd parts and J_135 their difference; on the axes
    J_0 is the part that is odd across and J_90 the one that is odd down.
    """
    across = down = np.zeros_like(kernel)
    if masks:
        one, other = (kernel * mask for mask in masks.values())
        across, down = (one, other) if 0 in masks else ((one - other) / 2, (one + other) / 2)
    radius = len(kernel) // 2
    return np.stack([kernel, across, down])[:, radius:, radius:]
