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
        masks: Mapping[int, Kernel]

    class Sums(Protocol):
        """The maps into which S and the S_phi are written."""

        presynaptic: Floats
        pathways: Mapping[int, Floats]


# Rows dy of the inhibition that is one frame late. They are summed first: with few values
# they inhibit most, and in all directions.
_FIRST_ROWS = 1, 2
_CHANNELS = 4  # that are averaged over a cell: x, y, change and a spare one
_LANES = 4  # doubles of a vector of rmo.c


class _Plan:
    """The kernels as presynaptic.c takes them, and room for its intermediate maps.

    The kernels are even across and down, and their directional parts are sums of one part that is
    odd across and one that is odd down. So one quadrant of each kernel is enough.
    """

    def __init__(self, kernels: Kernels) -> None:
        quadrants = [_quadrants(kernels.excitation, {})]
        quadrants += [_quadrants(each, kernels.masks) for each in kernels.inhibition]
        runs, taps = _runs(quadrants)
        self.runs, self.taps = np.array(runs, np.intc).reshape(-1, 5), np.array(taps, np.float32)
        reach = [0] * len(quadrants)
        for _, age, dy, dx, count in runs:
            reach[age] = max(reach[age], dy, dx + count - 1)
        self.reach = np.array(reach, np.intc)
        self.axes = tuple(kernels.masks)
        self.arguments = (
            *(address(self.runs), len(self.runs), address(self.taps)),
            *(address(self.reach), 45 in self.axes),
        )
        self._scratch: Floats = np.zeros((0, 0), np.float32)

    def scratch(self, bands: int) -> list[int]:
        """Return where each band has room."""
        if len(self._scratch) < bands:
            floats = loops().presynaptic_scratch(address(self.reach))
            self._scratch = np.zeros((bands, floats), np.float32)
        return _addresses(self._scratch)


class _Outputs:
    """Where the maps of sums stand, and where the sums that were computed last are not 0.

    Those that are 0 stay, and only the others are written.
    """

    def __init__(self, sums: Sums, axes: tuple[int, ...]) -> None:
        self.axes = axes
        pathways = [sums.pathways[phi] for phi in (*axes, *(phi + 180 for phi in axes))]
        maps = [address(each) for each in (sums.presynaptic, *pathways)]
        self.arguments = *maps, *([None] * (5 - len(maps)))
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
    out = np.empty((axes, rows, columns), np.float32)
    at = _addresses(pooled)
    for passing, opposite, weight, to in zip(
        at[:axes], at[axes:], _addresses(weights), _addresses(out), strict=True
    ):
        loops().opponent_products(
            passing, opposite, rows, columns, weight, weights.shape[-1] // 2, to
        )
    return out


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


def _runs(
    quadrants: list[Kernel],
) -> tuple[list[tuple[int, int, int, int, int]], list[list[float]]]:
    """Return the kernel values as runs and taps of presynaptic.c, in the order of their stage.

    A run is (stage, age, dy, first dx, count). Stage 0 is the excitation; after each later
    stage the sums end where no S above 0 remains.
    """
    runs: list[tuple[int, int, int, int, int]] = []
    taps: list[list[float]] = []
    rows = [(age, dy) for age, kernel in enumerate(quadrants) for dy in range(kernel.shape[1])]
    stages = {(age, dy): _stage(age, dy) for age, dy in rows}
    for age, dy in sorted(rows, key=stages.__getitem__):
        values = quadrants[age][:, dy]
        edges = np.diff((values[0] != 0).astype(np.int8), prepend=0, append=0)
        for first, last in zip(np.flatnonzero(edges > 0), np.flatnonzero(edges < 0), strict=True):
            runs.append((stages[age, dy], age, dy, int(first), int(last - first)))
            taps += values[:, first:last].T.tolist()
    return runs, taps


def _stage(age: int, dy: int) -> int:
    if age == 1:
        return 1 if dy in _FIRST_ROWS else 2
    return 0 if age == 0 else 3
