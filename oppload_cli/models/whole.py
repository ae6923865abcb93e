"""The presynaptic sums of frames of 8 bits, in whole numbers.

The luminance of such frames has 219 levels (limited range) or 255 (full range): P times
that is whole, and 16 bits hold the sums of it. Processors multiply twice as many such
numbers at once as floats. The kernels are rounded to 16 bits, which keeps S to 1e-5.
"""

from __future__ import annotations

import ctypes
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from oppload_cli.models.screening import SCREENED, Screening
from oppload_cli.models.taps import AGES, OUTPUTS, runs, with_zeros
from oppload_cli.native.library import address, aligned, compiled

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from oppload_cli.models.crew import Crew
    from oppload_cli.models.kernels import Kernel, Map
    from oppload_cli.models.presynaptic import Live

LEVELS = (219, 255)  # from black to white: of limited range, and of full range
# Those of whole.c, in values of 16 bits.
STRIP = 16
PAIR = 4 * STRIP
MOST = 4  # pairs of a group


class _Kernel(ctypes.Structure):
    """``struct kernel`` of whole.c."""

    _fields_ = (
        ("pairs", ctypes.c_void_p),
        ("rows", ctypes.c_void_p),
        ("of_count", ctypes.c_int * MOST),
        ("groups", ctypes.c_int),
    )


class _Job(ctypes.Structure):
    """``struct whole_sums`` of whole.c."""

    _fields_ = (
        ("photoreceptors", ctypes.c_void_p * AGES),
        ("stride", ctypes.c_ssize_t),
        ("outputs", ctypes.c_void_p * OUTPUTS),
        ("output_stride", ctypes.c_ssize_t),
        ("live", ctypes.c_void_p),
        ("screening", Screening),
        ("kernels", _Kernel * AGES),
        ("first_dx", ctypes.c_int * AGES),
        ("pairs", ctypes.c_int * AGES),
        ("reach", ctypes.c_int * AGES),
        ("slots", ctypes.c_int),
        ("width", ctypes.c_int),
        ("diagonal", ctypes.c_int),
        ("units", ctypes.c_float * 3),
    )


class WholeSums:
    """S and the S_phi of one video, where P has whole code levels.

    Parameters
    ----------
    kernels : list of ndarray
        Of :func:`oppload_cli.models.taps.quadrants`.
    outputs : sequence of ndarray of float32, shape (height, padded)
        S, or S and the pathways in the order of presynaptic.h; `padded` is a multiple
        of `STRIP`.
    live : ndarray of uint8, shape (height, padded // LANES)
        Takes where the outputs may be above 0.
    width : int
        Of the frame.
    diagonal : bool
        Whether the axes are the diagonals.
    rows : list of (int, int)
        The bands that are computed at once: first row, and the one after the last.
    """

    def __init__(
        self,
        kernels: list[Kernel],
        outputs: Sequence[Map],
        live: Live,
        width: int,
        *,
        diagonal: bool,
        rows: list[tuple[int, int]],
    ) -> None:
        loops = compiled()
        codes, self._units = _rounded(kernels)
        layouts = [_in_pairs(age, values) for age, values in enumerate(codes)]
        reach = [max((group.dy for group in each.groups), default=0) for each in layouts]
        pairs = [each.pairs for each in layouts]
        slots = 1 << (2 * max(reach)).bit_length()
        height, padded = outputs[0].shape
        furthest = max(2 * max(pairs), *reach) + 1  # boxes reach one further
        stride, self._inside = with_zeros(height, padded, furthest, width, np.uint8)
        self._addresses = [address(each) for each in self._inside]
        self._tables = [_Tables(each.groups, pairs, slots) for each in layouts]
        of_excitation, of_inhibition, of_directions = self._units
        even, *odd = codes[1]
        exact = [
            codes[0] * of_excitation,
            np.stack([even * of_inhibition, *(each * of_directions for each in odd)]),
        ]
        self._job = _Job(
            stride=stride,
            outputs=(ctypes.c_void_p * OUTPUTS)(*(address(each) for each in outputs)),
            output_stride=padded,
            live=address(live),
            screening=Screening.of(exact, stride, diagonal=diagonal),
            kernels=(_Kernel * AGES)(*(each.kernel for each in self._tables)),
            first_dx=(ctypes.c_int * AGES)(*(each.first_dx for each in layouts)),
            pairs=(ctypes.c_int * AGES)(*pairs),
            reach=(ctypes.c_int * AGES)(*reach),
            slots=slots,
            width=width,
            diagonal=diagonal,
        )
        self._scratch = aligned((len(rows), (MOST + slots * sum(pairs)) * PAIR // 2))
        self._screening = [self._room_to_screen(last - first) for first, last in rows]
        job = ctypes.addressof(self._job)
        self._bands: list[Callable[[], object]] = [
            partial(loops.whole_sums, job, *band, address(scratch), address(room))
            for band, scratch, room in zip(rows, self._scratch, self._screening, strict=True)
        ]
        self.reset()

    def reset(self) -> None:
        """Forget all maps."""
        for each in self._inside:
            each[:] = 0
        self._latest = 0
        self._levels = LEVELS[0]  # 0 for frames that have none
        self._levels_of = [0] * AGES  # of each map that was taken

    def _room_to_screen(self, height: int) -> NDArray[np.uint8]:
        """Return room for what is said of the strips of a band, and for its boxes."""
        verdicts = 2 * height * -(-self._job.width // SCREENED)
        rows = height + 2 * self._job.screening.reach
        return np.zeros(verdicts + rows * self._job.stride + 2 * SCREENED, np.uint8)

    @property
    def ready(self) -> bool:
        """Whether the last three maps are whole in the same levels."""
        return self._levels > 0 and self._levels_of == [self._levels] * AGES

    @property
    def following(self) -> tuple[int, int]:
        """Where the codes of the next map belong: address, and distance of two rows."""
        return self._addresses[(self._latest + 1) % AGES], self._job.stride

    def possible(self) -> list[int]:
        """Return how many levels the next frame may have, the likeliest number first.

        A video in which P was not whole once is not one of 8 bits: it has none.
        """
        return sorted(LEVELS, key=self._levels.__ne__) if self._levels else []

    def take(self, levels: int) -> None:
        """Take what stands at `following`, a map of so many levels; 0 if it is not whole."""
        self._latest = (self._latest + 1) % AGES
        self._levels = self._levels_of[self._latest] = levels

    def compute(self, crew: Crew) -> None:
        """Compute the outputs; only where `ready`."""
        for age in range(AGES):
            self._job.photoreceptors[age] = self._addresses[(self._latest - age) % AGES]
        self._job.units = tuple(unit / self._levels for unit in self._units)
        crew(*self._bands)


class _Group(NamedTuple):
    """Pairs of kernel values side by side."""

    age: int
    dy: int
    first: int  # pair in a folded row
    values: NDArray[np.int16]  # ``struct pair`` of whole.c, shape (n, 3, 2)


class _Layout(NamedTuple):
    """The kernel of one age, cut into pairs."""

    first_dx: int
    pairs: int  # in a folded row, at least 1
    groups: list[_Group]


class _Tables:
    """A ``struct kernel`` of whole.c, with what it points to."""

    def __init__(self, groups: list[_Group], pairs: list[int], slots: int) -> None:
        # The widest first; the order of whole numbers in a sum does not matter.
        groups = sorted(groups, key=lambda group: -len(group.values))
        begins = np.cumsum([0, *pairs]) * slots + MOST
        slot = np.arange(slots)
        rows = np.zeros((slots, len(groups), 2), np.int32)
        for place, group in enumerate(groups):
            for side, dy in enumerate((-group.dy, group.dy) if group.dy else (0,)):
                row = begins[group.age] + (slot + dy) % slots * pairs[group.age]
                rows[:, place, side] = (row + group.first) * PAIR
        self._rows = rows
        self._pairs = np.concatenate([np.empty((0, 3, 2), np.int16), *(g.values for g in groups)])
        counts = [len(group.values) for group in groups]
        self.kernel = _Kernel(
            pairs=address(self._pairs),
            rows=address(self._rows),
            of_count=(ctypes.c_int * MOST)(*(counts.count(n + 1) for n in range(MOST))),
            groups=len(groups),
        )


def _in_pairs(age: int, values: NDArray[np.int16]) -> _Layout:
    """Cut the quadrants of one age, shape (3, r + 1, r + 1), into as few pairs as may be."""
    layouts = []
    for first_dx in (0, -1):
        width = values.shape[2] - first_dx
        padded = np.pad(values, ((0, 0), (0, 0), (-first_dx, width % 2)))
        pairs = padded.reshape(*values.shape[:2], -1, 2)
        groups = [
            _Group(age, dy, place, pairs[:, dy, place : min(place + MOST, first + count)])
            for dy in range(values.shape[1])
            for first, count in runs(np.asarray(pairs[:, dy].any(axis=(0, 2))))
            for place in range(first, first + count, MOST)
        ]
        groups = [group._replace(values=group.values.swapaxes(0, 1)) for group in groups]
        in_row = max((group.first + len(group.values) for group in groups), default=1)
        layouts.append(_Layout(first_dx, in_row, groups))
    return min(layouts, key=lambda each: sum(len(group.values) for group in each.groups))


def _rounded(kernels: list[Kernel]) -> tuple[list[NDArray[np.int16]], tuple[float, ...]]:
    """Round the quadrants of the three ages to 16 bits.

    Returns
    -------
    codes : list of ndarray, shape (3, r + 1, r + 1)
        Of each age.
    units : tuple of float
        What one stands for in E, in I and in the odd parts.
    """
    values = np.stack(kernels)
    # On an axis two mirror images are one.
    side = np.where(np.arange(values.shape[-1]) > 0, 2, 1)
    copies = side[:, None] * side
    codes = np.zeros(values.shape, np.int16)
    units = []
    for part in (np.s_[:1, 0], np.s_[1:, 0], np.s_[1:, 1:]):
        scale = _scale(values[part], copies)
        codes[part] = _diffused(values[part] * scale, copies)
        units.append(1 / scale)
    return list(codes), tuple(units)


def _scale(values: Kernel, copies: NDArray[np.int_]) -> float:
    """Return the largest scale at which no value and no sum of P overflows."""
    value = np.abs(values).max() / (2**15 - 2)
    total = (np.abs(values) * copies).sum() * max(LEVELS) / (2**31 - 2**24)
    return float(1 / max(value, total, np.finfo(np.float32).tiny))


def _diffused(values: Kernel, copies: NDArray[np.int_]) -> NDArray[np.int16]:
    """Round so that the errors cancel in the sum over all mirror images."""
    codes = np.zeros(values.shape, np.int16)
    left = 0.0
    for place in zip(*np.nonzero(values), strict=True):
        count = copies[place[-2:]]
        codes[place] = round(values[place] + left / count)
        left += count * (values[place] - codes[place])
    return codes
