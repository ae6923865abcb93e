"""E, I, J and S by compiled loops: each kernel value once for all its mirror images.

What lies dx to the left and right, and dy above and below, is added or subtracted
first, and multiplied once. Once so much inhibits that every S is 0, the rest is left
alone, as it is at nearly every pixel of most videos.
"""

from __future__ import annotations

import ctypes
import math
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from oppload_cli.models.change import Change
from oppload_cli.models.crew import bands_of
from oppload_cli.models.presynaptic import Layers
from oppload_cli.models.taps import AGES, OUTPUTS, quadrants, runs, with_zeros
from oppload_cli.models.whole import WholeSums
from oppload_cli.native.library import LANES, address, aligned, compiled

if TYPE_CHECKING:
    from collections.abc import Callable

    from oppload_cli.models.crew import Crew
    from oppload_cli.models.kernels import Kernel, Map
    from oppload_cli.models.parameters import DpcParams
    from oppload_cli.models.presynaptic import Live

FIRST_ROWS = 1, 2  # of W_I1: with few values they inhibit most, and in all directions
STAGES = 3  # of the inhibition: that of presynaptic.c
AGES_OF_STAGES = 1, 1, 2
LAYERS = 5  # of the outputs, from here on: what the models need no more once they have S


class _Job(ctypes.Structure):
    """``struct sums`` of presynaptic.c."""

    _fields_ = (
        ("photoreceptors", ctypes.c_void_p * AGES),
        ("stride", ctypes.c_ssize_t),
        ("outputs", ctypes.c_void_p * OUTPUTS),
        ("output_stride", ctypes.c_ssize_t),
        ("live", ctypes.c_void_p),
        ("groups", ctypes.c_void_p),
        ("taps", ctypes.c_void_p),
        ("groups_of_excitation", ctypes.c_int),
        ("groups_of_inhibition", ctypes.c_int * STAGES),
        ("ages", ctypes.c_int * STAGES),
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
    presynaptic, pathways, live
        As :class:`oppload_cli.models.presynaptic.Presynaptic` has them.
    """

    def __init__(
        self, shape: tuple[int, int], params: DpcParams, axes: tuple[int, ...], crew: Crew
    ) -> None:
        loops = compiled()
        self._crew = crew
        kernels = quadrants(params, axes)
        groups, taps, reach = _taps(kernels)
        stages = [_stage_of(age, dy) for age, dy, *_ in groups]
        of_stage = tuple(stages.count(n) for n in range(1 + STAGES))
        self._groups, self._values = np.array(groups, np.intc), np.array(taps, np.float32)
        strip = int(loops.strip())
        height, width = shape
        of_whole = int(loops.whole_strip())
        strips = math.lcm(strip, of_whole or 1)
        padded = -(-width // strips) * strips
        stride, self._inside = with_zeros(height, padded, max(reach), width)
        live = np.zeros((height, padded // LANES), np.uint8)
        self.live: Live | None = live
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
            groups_of_excitation=of_stage[0],
            groups_of_inhibition=of_stage[1:],
            ages=AGES_OF_STAGES,
            reach=(ctypes.c_int * AGES)(*reach),
            slots=slots,
            width=width,
            diagonal=45 in axes,
        )
        everything = [address(each) for each in maps]
        wanted = everything[: 1 + 2 * len(axes)]
        self._of_models = (ctypes.c_void_p * OUTPUTS)(*wanted)
        self._live = address(live)
        self._of_layers = (ctypes.c_void_p * OUTPUTS)(*([None] * LAYERS), *everything[LAYERS:])
        folded = slots * 2 * strip * (sum(reach) + AGES)
        rows = bands_of(shape)
        self._scratch = aligned((len(rows), folded + LANES))
        job = ctypes.addressof(self._job)
        self._bands: list[Callable[[], object]] = [
            partial(loops.sums, job, first, last, address(scratch))
            for (first, last), scratch in zip(rows, self._scratch, strict=True)
        ]
        self._addresses = [address(each) for each in self._inside]
        self._change = Change(shape, stride, crew)
        self._latest = 0
        self._whole = None
        if of_whole:
            models = list(maps[: 1 + 2 * len(axes)])
            self._whole = WholeSums(kernels, models, live, width, diagonal=45 in axes, rows=rows)

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
        self._change.begin(luma)

    def change(self, luma: Map) -> float:
        """Compute P(t) from L(t) and the L that was kept; return its mean."""
        following = self._addresses[(self._latest + 1) % AGES]
        return self._change.compute(luma, following, self._whole)

    def take(self, *, ready: bool) -> None:
        """Take what `change` has computed; compute the sums too if they are valid."""
        self._change.take()
        self._latest = (self._latest + 1) % AGES
        if self._whole:
            self._whole.take(self._change.levels)
        if ready and self._whole and self._whole.ready:
            self._whole.compute(self._crew)
        elif ready:
            self._compute(self._of_models, self._live)

    def layers(self) -> Layers:
        """Return E, I and the J_phi of the latest map, computed now."""
        self._compute(self._of_layers, None)
        return self._layers

    def _compute(self, outputs: ctypes.Array[ctypes.c_void_p], live: int | None) -> None:
        for age in range(AGES):
            self._job.photoreceptors[age] = self._addresses[(self._latest - age) % AGES]
        self._job.outputs, self._job.live = outputs, live
        self._crew(*self._bands)


def _stage_of(age: int, dy: int) -> int:
    """Return when a row of a kernel is summed: 0 for W_E, 1 to `STAGES` for the inhibition.

    No kernel has a value below 0: once as much inhibits in every direction as excites,
    every S is 0, and what is left of the kernels is left alone.
    """
    if age == 1 and dy not in FIRST_ROWS:
        return 2
    return (0, 1, 3)[age]


def _taps(
    kernels: list[Kernel],
) -> tuple[list[tuple[int, int, int, int]], list[list[float]], list[int]]:
    """Return the kernels as ``struct group`` and ``struct tap``, and how far each reaches."""
    groups, taps, reach = [], [], [0] * AGES
    rows = [(age, dy) for age, kernel in enumerate(kernels) for dy in range(kernel.shape[1])]
    for age, dy in sorted(rows, key=lambda row: _stage_of(*row)):
        for first, count in runs(kernels[age][0, dy] != 0):
            groups.append((age, dy, first, count))
            reach[age] = max(reach[age], dy, first + count - 1)
            taps += kernels[age][:, dy, first : first + count].T.tolist()
    return groups, taps, reach
