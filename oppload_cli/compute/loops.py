"""The compiled loops, and the one switch that lets them replace the plain functions.

A plain function of the models or of motion that is decorated by :func:`with_twin` has a compiled
twin in this module, which calls the loops in C. The twin takes the same arguments and returns the
same values up to rounding. The plain function runs if the package has no compiled loops, or if the
environment variable ``OPPLOAD_PORTABLE`` is 1.
"""

from __future__ import annotations

import ctypes
import math
import os
import sys
import zlib
from concurrent.futures import Future, ThreadPoolExecutor
from functools import cache, wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar, cast
from weakref import WeakKeyDictionary

import cv2
import numpy as np

from oppload_cli.errors import shortage

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from typing import Protocol

    from numpy.typing import NDArray

    Arguments = ParamSpec("Arguments")
    Returned = TypeVar("Returned")

    Floats = NDArray[np.float32]
    Kernel = NDArray[np.float64]
    Points = NDArray[np.float64]

    class Kernels(Protocol):
        """Square kernels of side 2 r + 1, and M_phi - 1/2 by the direction phi of each axis."""

        excitation: Kernel
        inhibition: Sequence[Kernel]
        odd_masks: Mapping[int, Kernel]

    class Sums(Protocol):
        """The maps into which S and the S_phi are written."""

        presynaptic: Floats
        pathways: Mapping[int, Floats]


INTERFACE = 13  # the number in maps.c; a build with another number is out of date
SUFFIX = {"darwin": ".dylib", "win32": ".dll"}.get(sys.platform, ".so")

_BAND = 120  # rows that one thread computes at a time: their data stay in the cache
_LARGE = 1 << 18  # pixels; in smaller frames, several threads cost more time than they save
# The types of the arguments of each loop, in the order of its signature in C.
_KINDS = {
    "p": ctypes.c_void_p,
    "i": ctypes.c_int,
    "n": ctypes.c_ssize_t,  # ptrdiff_t
    "f": ctypes.c_float,
    "d": ctypes.c_double,
}
_SIGNATURES = {
    "folded": "",
    "presynaptic_sums": "ppp ii pi pi pp ii ppppp ii pp",
    "group": "piii ff pp ii",
    "pool": "pii pi pi pp",
    "opponent_products": "pp iii pi p",
    "rmo_sums": "ppi dd d pp",
}

portable = os.environ.get("OPPLOAD_PORTABLE", "0") not in ("", "0")  # True: plain functions run


def with_twin(plain: Callable[Arguments, Returned]) -> Callable[Arguments, Returned]:
    """Replace a function by its compiled twin where compiled loops run.

    The plain function stays available as ``__wrapped__``.
    """

    @wraps(plain)
    def chosen(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Returned:
        if portable or _loaded()[1] is None:
            return plain(*args, **kwargs)
        twin: Callable[Arguments, Returned] = _TWINS[plain.__name__]
        return twin(*args, **kwargs)

    return chosen


def arithmetic() -> str:
    """Return the arithmetic that runs: ``compiled, wide vectors``, ``compiled`` or ``portable``."""
    name, library = _loaded()
    return "portable" if portable or library is None else name


def why_portable() -> str | None:
    """Return why the plain functions run; None if the compiled loops run."""
    if portable:
        return "OPPLOAD_PORTABLE is set"
    reason, library = _loaded()
    return reason if library is None else None


def why_not_wide() -> str | None:
    """Return why the build for wide vectors does not load; None if it runs or is not needed."""
    library = _loaded()[1]
    if portable or library is None or not library.runs_wide() or not _path("wide").exists():
        return None
    wide = _opened("wide")
    return wide if isinstance(wide, str) else None


def is_large(shape: tuple[int, int]) -> bool:
    """Return whether frames of a height and width are large enough for several threads."""
    return shape[0] * shape[1] >= _LARGE


# ---- The twins ------------------------------------------------------------------------------
# Each has the name of its plain function, with an underscore before it.


class _Plan:
    """The kernels in the form that presynaptic.c takes, and memory for its intermediate maps.

    The kernels are even functions across and down. Their directional parts are sums of one part
    that is odd across and one that is odd down. So one quadrant of each kernel is enough.
    """

    def __init__(self, kernels: Kernels) -> None:
        quadrants = [_quadrants(kernels.excitation, {})]
        quadrants += [_quadrants(kernel, kernels.odd_masks) for kernel in kernels.inhibition]
        stages, taps, offsets = [], [], []
        # E, I by P(t-1) and I by P(t-2) are summed in 1, 1 and 2 parts.
        for age, (quadrant, parts) in enumerate(zip(quadrants, (1, 1, 2), strict=True)):
            # The nearest values first, which inhibit most; each part takes every n-th of them.
            nearest = sorted(np.argwhere(quadrant[0]).tolist(), key=np.hypot.reduce)
            for stage in (nearest[part::parts] for part in range(parts)):
                stages.append((age, len(stage)))
                taps += [quadrant[:, dy, dx] for dy, dx in stage]
                offsets += [(age, dy, dx) for dy, dx in stage]
        ages, dy, dx = np.array(offsets, np.intc).reshape(-1, 3).T
        reach = np.zeros(len(quadrants), np.intc)
        np.maximum.at(reach, ages, np.maximum(dy, dx))
        self.slots = 1 << int(2 * reach.max()).bit_length()
        # The scratch memory holds zeros, then for each age a ring of `slots` folded rows.
        folded = _library().folded()
        rows = folded * (reach + 1)
        starts = folded + self.slots * (np.cumsum(rows) - rows)
        slot = np.arange(self.slots)[:, None]
        above, below = (
            starts[ages] + (other & (self.slots - 1)) * rows[ages] + folded * dx
            for other in (slot - dy, slot + dy)
        )
        self.stages = np.array(stages, np.intc)
        self.taps = np.array(taps, np.float32)
        self.places = np.stack([above, np.where(dy, below, 0)], -1).astype(np.intc)
        self.rings = np.stack([starts, reach], -1).astype(np.intc)
        self.axes = tuple(kernels.odd_masks)
        self.arguments = (
            *(_address(self.stages), len(stages), _address(self.taps), len(taps)),
            *(_address(self.places), _address(self.rings), self.slots, 45 in self.axes),
        )
        self._floats = folded + self.slots * int(rows.sum())
        self._scratch: Floats = np.zeros((0, 0), np.float32)

    def scratch(self, bands: int) -> list[int]:
        """Return the address of each band's memory for intermediate maps."""
        if len(self._scratch) < bands:
            self._scratch = np.zeros((bands, self._floats), np.float32)
        return _addresses(self._scratch)


class _Outputs:
    """The addresses of the maps of sums, and a mark for each strip of a row that is not all 0.

    With these marks the loops need not write zeros over zeros.
    """

    def __init__(self, sums: Sums, axes: tuple[int, ...]) -> None:
        self.axes = axes
        pathways = [sums.pathways[phi] for phi in (*axes, *(phi + 180 for phi in axes))]
        none = [None] * (4 - len(pathways))
        self.arguments = *map(_address, (sums.presynaptic, *pathways)), *none
        self._filled = np.ones(sums.presynaptic.shape, np.uint8)  # new maps may hold any values
        self.filled = _address(self._filled)


_plans: WeakKeyDictionary[Kernels, _Plan] = WeakKeyDictionary()
_outputs: WeakKeyDictionary[Sums, _Outputs] = WeakKeyDictionary()


def _presynaptic_sums(photoreceptors: Sequence[Floats], kernels: Kernels, out: Sums) -> None:
    if kernels not in _plans:
        _plans[kernels] = _Plan(kernels)
    plan = _plans[kernels]
    outputs = _outputs.get(out)
    if outputs is None or outputs.axes != plan.axes:
        outputs = _outputs[out] = _Outputs(out, plan.axes)
    shape = photoreceptors[0].shape[0], photoreceptors[0].shape[1]
    maps = [_address(photoreceptor) for photoreceptor in photoreceptors]
    arguments = *maps, *shape, *plan.arguments, *outputs.arguments
    scratch, filled = plan.scratch(len(_bands_of(shape))), outputs.filled
    compute = _library().presynaptic_sums
    _in_bands(shape, lambda n, *rows: compute(*arguments, *rows, scratch[n], filled))


def _group(
    presynaptic: Floats, side: int, least: float, limit: float, out: Floats
) -> tuple[float, float]:
    shape = presynaptic.shape[0], presynaptic.shape[1]
    totals = np.empty((shape[0], 2))
    maps = _address(out), _address(totals)
    arguments = _address(presynaptic), *shape, side, least, limit, *maps
    compute = _library().group
    _in_bands(shape, lambda _, first, last: compute(*arguments, first, last))
    s, g = (totals.sum(axis=0) / presynaptic.size).tolist()
    return s, g


def _pool(maps: Sequence[Floats], down: Floats, across: Floats) -> Floats:
    (height, width), rows, columns = maps[0].shape, len(down), len(across)
    half = np.empty((rows, width), np.float32)
    out = np.empty((len(maps), rows, columns), np.float32)
    shared = height, width, _address(down), rows, _address(across), columns, _address(half)
    for source, to in zip(maps, _addresses(out), strict=True):
        _library().pool(_address(source), *shared, to)
    return out


def _opponent_products(pooled: Floats, weights: Floats) -> Floats:
    axes, rows, columns = len(weights), *pooled.shape[1:]
    stride, reach = columns + 8, weights.shape[-1] // 2  # zeros follow each row of cells
    padded = np.zeros((2 * axes, rows, stride), np.float32)
    padded[..., :columns] = pooled
    out = np.empty((axes, rows, stride), np.float32)
    inputs = _addresses(padded)
    for passing, opposite, weight, to in zip(
        inputs[:axes], inputs[axes:], _addresses(weights), _addresses(out), strict=True
    ):
        _library().opponent_products(passing, opposite, rows, columns, stride, weight, reach, to)
    return out[..., :columns]


def _rmo_sums(
    starts: Points, vectors: Points, opposite_tolerance: float, outward_tolerance: float, sides: int
) -> tuple[int, float, float, float, float, int]:
    motion, origin = np.ascontiguousarray(vectors), np.ascontiguousarray(starts)
    # A vector of rmo.c has at most 4 doubles.
    rows, sums = np.empty(5 * (len(motion) + 4)), np.empty(6)
    _library().rmo_sums(
        *(_address(motion), _address(origin), len(motion)),
        math.tan(math.radians(opposite_tolerance)),
        math.tan(math.radians(outward_tolerance)),
        *(sides, _address(rows), _address(sums)),
    )
    count, opposite, outward, inward, largest, pairs = sums.tolist()
    return int(count), opposite, outward, inward, largest, int(pairs)


_TWINS: dict[str, Callable[..., Any]] = {
    twin.__name__.removeprefix("_"): twin
    for twin in (_presynaptic_sums, _group, _pool, _opponent_products, _rmo_sums)
}


def _address(array: NDArray[Any]) -> int:
    """Return the address of the first value of an array; the caller must keep the array."""
    return int(array.__array_interface__["data"][0])


def _addresses(maps: Floats) -> list[int]:
    first, size = _address(maps), maps[0].nbytes
    return [first + size * number for number in range(len(maps))]


def _quadrants(kernel: Kernel, masks: Mapping[int, Kernel]) -> Kernel:
    """Return the quadrant dx, dy >= 0 of a kernel and of its odd parts, shape (3, r+1, r+1).

    On the diagonals J_45 is the sum of both odd parts and J_135 their difference; on the axes
    J_0 is the part that is odd across and J_90 the one that is odd down.
    """
    across = down = np.zeros_like(kernel)
    if masks:
        first, second = (kernel * mask for mask in masks.values())
        across, down = first, second
        if 0 not in masks:
            across, down = (first - second) / 2, (first + second) / 2
    radius = len(kernel) // 2
    return np.stack([kernel, across, down])[:, radius:, radius:]


# ---- Bands of rows --------------------------------------------------------------------------


def _in_bands(shape: tuple[int, int], compute: Callable[[int, int, int], object]) -> None:
    """Compute the rows of a frame; if the frame is large, in bands on several threads.

    `compute` takes the number of a band, its first row, and the row after its last one. The number
    of threads is that of OpenCV, which follows the affinity mask or ``cv2.setNumThreads``. One
    thread computes a row, so that any number of threads gives the same bytes.
    """
    bands = _bands_of(shape)
    threads = min(cv2.getNumThreads(), len(bands))
    futures: list[Future[object]] = []
    for band in bands:
        try:
            if threads > 1:
                futures.append(_band_threads(threads).submit(compute, *band))
                continue
        except RuntimeError as error:
            # Once the main thread has ended, pools take no new work: this thread does it itself.
            if shortage(error):
                raise
        compute(*band)
    for future in futures:
        future.result()


def _bands_of(shape: tuple[int, int]) -> list[tuple[int, int, int]]:
    """Return the number of each band of a frame, its first row, and the row after its last one."""
    band = _BAND if is_large(shape) else max(1, shape[0])
    firsts = range(0, shape[0], band)
    return [(number, first, min(first + band, shape[0])) for number, first in enumerate(firsts)]


@cache
def _band_threads(threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(threads, "oppload-bands")


if hasattr(os, "register_at_fork"):  # a forked child inherits the pools without their threads
    os.register_at_fork(after_in_child=_band_threads.cache_clear)


# ---- The library ----------------------------------------------------------------------------


def _library() -> ctypes.CDLL:
    """Return the compiled loops; only twins call this, which run only if the loops are loaded."""
    return cast("ctypes.CDLL", _loaded()[1])


@cache
def _loaded() -> tuple[str, ctypes.CDLL | None]:
    """Return the name and the library of the best build; if none loads, the reason and None."""
    baseline = _opened("baseline")
    if isinstance(baseline, str):
        return baseline, None
    wide = _opened("wide") if baseline.runs_wide() else ""
    if isinstance(wide, str):
        return "compiled", baseline
    return "compiled, wide vectors", wide


def _opened(build: str) -> ctypes.CDLL | str:
    """Return the library of a build, or why it does not load."""
    path = _path(build)
    if not path.exists():
        return "this installation has no compiled loops; install a wheel, or build with a compiler"
    if _is_damaged(path):
        return f"{path} is damaged; install oppload again"
    try:
        library = ctypes.CDLL(str(path))
        if library.interface() != INTERFACE:
            return f"{path} belongs to another version; install oppload again"
    except (OSError, AttributeError):
        return f"{path} does not load on this system; install the wheel of this platform"
    for name, signature in _SIGNATURES.items():
        getattr(library, name).argtypes = [_KINDS[kind] for kind in signature.replace(" ", "")]
    return library


def _path(build: str) -> Path:
    return Path(__file__).with_name(f"loops.{build}{SUFFIX}")


def _is_damaged(path: Path) -> bool:
    """Return whether the checksum is wrong: to load a truncated library can end the process."""
    try:
        checksum = Path(f"{path}.sum").read_text(encoding="ascii").strip()
        return checksum != f"{zlib.crc32(path.read_bytes()):08x}"
    except (OSError, UnicodeDecodeError):
        return False
