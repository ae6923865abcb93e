"""E, I, J and S by compiled loops: each kernel value once for all its mirror images.

What lies dx to the left and right, and dy above and below, is added or subtracted
first, and multiplied once. Where E is 0 every S is, and the inhibition is left alone.
"""

from __future__ import annotations

import ctypes
import math
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from oppload_cli.models.crew import bands_of
from oppload_cli.models.presynaptic import Layers
from oppload_cli.models.taps import AGES, OUTPUTS, quadrants, runs, with_zeros
from oppload_cli.models.whole import WholeSums
from oppload_cli.native.library import LANES, address, aligned, compiled, row_at, rows_of

if TYPE_CHECKING:
    from collections.abc import Callable

    from oppload_cli.models.crew import Crew
    from oppload_cli.models.kernels import Kernel, Map
    from oppload_cli.models.parameters import DpcParams

LAYERS = 5  # of the outputs, from here on: what the models need no more once they have S


class _Job(ctypes.Structure):
    """``struct sums`` of presynaptic.c."""

    _fields_ = (
        ("photoreceptors", ctypes.c_void_p * AGES),
        ("stride", ctypes.c_ssize_t),
        ("outputs", ctypes.c_void_p * OUTPUTS),
        ("output_stride", ctypes.c_ssize_t),
        ("groups", ctypes.c_void_p),
        ("taps", ctypes.c_void_p),
        ("groups_of_excitation", ctypes.c_int),
        ("groups_of_inhibition", ctypes.c_int),
        ("reach", ctypes.c_int * AGES),
        ("slots", ctypes.c_int),
        ("width", ctypes.c_int),
        ("diagonal", ctypes.c_int),
    )


class DirectSums:
    """The presynaptic sums of one video, by compiled loops.

    Parameters
    ----------
    shape : tuple of int
        Height and width of the maps.
    params : DpcParams
        The DPC constants.
    axes : tuple of int
        Directions phi in degrees of the pathways' axes: none, or two at a right angle.
    crew : Crew
        Shares out the work.

    Attributes
    ----------
    presynaptic, pathways
        As :class:`oppload_cli.models.presynaptic.Presynaptic` has them.
    """

    def __init__(
        self, shape: tuple[int, int], params: DpcParams, axes: tuple[int, ...], crew: Crew
    ) -> None:
        loops = compiled()
        self._crew = crew
        kernels = quadrants(params, axes)
        groups, taps, reach = _taps(kernels)
        self._groups, self._values = np.array(groups, np.intc), np.array(taps, np.float32)
        strip = int(loops.strip())
        height, width = shape
        of_whole = int(loops.whole_strip())
        strips = math.lcm(strip, of_whole or 1)
        padded = -(-width // strips) * strips
        stride, self._inside = with_zeros(height, padded, max(reach), width)
        self._luma: list[Map] = list(aligned((2, height, width)))
        self._change = loops.change
        maps = aligned((OUTPUTS, height, padded))
        self.presynaptic: Map = maps[0, :, :width]
        both = [*axes, *(phi + 180 for phi in axes)]
        self.pathways: dict[int, Map] = {
            phi: maps[1 + place, :, :width] for place, phi in enumerate(both)
        }
        self._layers = Layers(
            maps[LAYERS, :, :width],
            maps[LAYERS + 1, :, :width],
            {phi: maps[LAYERS + 2 + place, :, :width] for place, phi in enumerate(axes)},
        )
        slots = 1 << (2 * max(reach)).bit_length()
        self._job = _Job(
            stride=stride,
            output_stride=padded,
            groups=address(self._groups),
            taps=address(self._values),
            groups_of_excitation=sum(group[0] == 0 for group in groups),
            groups_of_inhibition=sum(group[0] != 0 for group in groups),
            reach=(ctypes.c_int * AGES)(*reach),
            slots=slots,
            width=width,
            diagonal=45 in axes,
        )
        everything = [address(each) for each in maps]
        wanted = everything[: 1 + 2 * len(axes)]
        self._of_models = (ctypes.c_void_p * OUTPUTS)(*wanted)
        self._of_layers = (ctypes.c_void_p * OUTPUTS)(*([None] * LAYERS), *everything[LAYERS:])
        folded = slots * 2 * strip * (sum(reach) + AGES)
        self._rows = bands_of(height)
        self._scratch = aligned((len(self._rows), folded + LANES))
        job = ctypes.addressof(self._job)
        self._bands: list[Callable[[], object]] = [
            partial(loops.sums, job, first, last, address(scratch))
            for (first, last), scratch in zip(self._rows, self._scratch, strict=True)
        ]
        self._addresses = [address(each) for each in self._inside]
        self._latest = 0
        self._whole = None
        if of_whole:
            models = list(maps[: 1 + 2 * len(axes)])
            self._whole = WholeSums(kernels, models, width, diagonal=45 in axes, rows=self._rows)

    @property
    def photoreceptors(self) -> Map:
        """P(t), the latest map taken."""
        return self._inside[self._latest]

    def reset(self) -> None:
        """Forget all maps."""
        for each in self._inside:
            each[:] = 0
        if self._whole:
            self._whole.reset()

    def begin(self, luma: Map) -> None:
        """Keep L of the first frame."""
        np.copyto(self._luma[0], luma)

    def change(self, luma: Map) -> float:
        """Compute P(t) from L(t) and the L that was kept; return its mean."""
        if luma.strides[1] != luma.itemsize:
            luma = np.ascontiguousarray(luma)
        rows, width = rows_of(luma), luma.shape[1]
        kept, spare = (address(each) for each in self._luma)
        before, after = (kept, width), (spare, width)
        following = self._addresses[(self._latest + 1) % AGES], self._job.stride
        totals: dict[int, float] = {}

        def see(first: int, last: int) -> None:
            totals[first] = self._change(
                *row_at(rows, first),
                *(row_at(before, first)[0], row_at(after, first)[0]),
                *(*row_at(following, first), last - first, width),
            )

        self._crew(*(partial(see, *band) for band in self._rows))
        if self._whole:
            self._whole.change(rows, before, self._crew)
        # In the order of the rows, whichever thread came first.
        return sum(totals[first] for first, _ in self._rows) / luma.size

    def take(self, *, ready: bool) -> None:
        """Take what `change` has computed; compute the sums too if they are valid."""
        self._luma.reverse()
        self._latest = (self._latest + 1) % AGES
        if self._whole:
            self._whole.take()
        if ready and self._whole and self._whole.ready:
            self._whole.compute(self._crew)
        elif ready:
            self._compute(self._of_models)

    def layers(self) -> Layers:
        """Return E, I and the J_phi of the latest map, computed now."""
        self._compute(self._of_layers)
        return self._layers

    def _compute(self, outputs: ctypes.Array[ctypes.c_void_p]) -> None:
        for age in range(AGES):
            self._job.photoreceptors[age] = self._addresses[(self._latest - age) % AGES]
        self._job.outputs = outputs
        self._crew(*self._bands)


def _taps(
    kernels: list[Kernel],
) -> tuple[list[tuple[int, int, int, int]], list[list[float]], list[int]]:
    """Return the kernels as ``struct group`` and ``struct tap``, and how far each reaches."""
    groups, taps, reach = [], [], [0] * AGES
    for age, kernel in enumerate(kernels):
        for dy in range(kernel.shape[1]):
            for first, count in runs(kernel[0, dy] != 0):
                groups.append((age, dy, first, count))
                reach[age] = max(reach[age], dy, first + count - 1)
                taps += kernel[:, dy, first : first + count].T.tolist()
    return groups, taps, reach
