"""The compiled twin of the presynaptic sums (presynaptic.c).

The kernels are even across and down, and their directional parts are sums of one part that is
odd across and one that is odd down. So one quadrant of each kernel is enough.
"""

from __future__ import annotations

from typing import TYPE_CHECKING
from weakref import WeakKeyDictionary

import numpy as np

from oppload_cli.compute.loops import address, bands_of, in_bands, loops

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from typing import Protocol

    from numpy.typing import NDArray

    Floats = NDArray[np.float32]
    Kernel = NDArray[np.float64]

    class Kernels(Protocol):
        """Square kernels of side 2 r + 1, and M_phi - 1/2 by the direction of each axis."""

        excitation: Kernel
        inhibition: Sequence[Kernel]
        masks: Mapping[int, Kernel]

    class Sums(Protocol):
        """Where S and the S_phi go."""

        presynaptic: Floats
        pathways: Mapping[int, Floats]


# Rows dy of the inhibition that is one frame late. They are summed first: with few values
# they inhibit most, and in all directions.
_FIRST_ROWS = 1, 2


class _Plan:
    """The kernels as presynaptic.c takes them, and room for its intermediate maps."""

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
        self._scratch: Floats = np.zeros((0, 0), np.float32)

    def scratch(self, bands: int) -> Floats:
        """Return room for each band."""
        if len(self._scratch) < bands:
            floats = loops().presynaptic_scratch(address(self.reach))
            self._scratch = np.zeros((bands, floats), np.float32)
        return self._scratch


_plans: WeakKeyDictionary[Kernels, _Plan] = WeakKeyDictionary()
# Where the sums that were computed last are not 0: those stay, and only these are written.
_filled: WeakKeyDictionary[Sums, NDArray[np.uint8]] = WeakKeyDictionary()


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
    height, width = shape = photoreceptors[0].shape[0], photoreceptors[0].shape[1]
    pathways = [*plan.axes, *(phi + 180 for phi in plan.axes)]
    outputs = [address(out.presynaptic), *(address(out.pathways[phi]) for phi in pathways)]
    arguments = (
        *(address(each) for each in photoreceptors),
        *(height, width, address(plan.runs), len(plan.runs), address(plan.taps)),
        *(address(plan.reach), 45 in plan.axes),
        *(*outputs, *([None] * (5 - len(outputs)))),
    )
    if out not in _filled:  # it may hold anything
        _filled[out] = np.ones(shape, np.uint8)
    scratch, filled = plan.scratch(len(bands_of(shape))), address(_filled[out])
    compute = loops().presynaptic_sums
    in_bands(shape, lambda n, *rows: compute(*arguments, *rows, address(scratch[n]), filled))


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
