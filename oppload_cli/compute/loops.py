"""Loads the compiled loops; one switch decides whether they replace the plain functions.

A plain function says with :func:`with_twin` that :mod:`oppload_cli.compute.twins` holds its
compiled twin. The twin has the same name, takes the same arguments and returns the same values,
but for the last digits. Where no compiled loops were built, or where the environment variable
``OPPLOAD_PORTABLE`` is 1, the plain function runs.
"""

from __future__ import annotations

import ctypes
import os
import sys
import zlib
from concurrent.futures import ThreadPoolExecutor
from functools import cache, wraps
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

import cv2

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Taken = ParamSpec("Taken")
    Returned = TypeVar("Returned")

INTERFACE = 11  # that of maps.c; a build with another number is out of date
SUFFIX = {"darwin": ".dylib", "win32": ".dll"}.get(sys.platform, ".so")

_BAND = 120  # rows that one thread computes at a time: their data stay in the cache
_LARGE = 1 << 18  # pixels; below, handing work to other threads costs more than it saves
_pointer, _count, _float, _double = ctypes.c_void_p, ctypes.c_int, ctypes.c_float, ctypes.c_double
_NOTHING: dict[str, tuple[Any, ...]] = {
    "presynaptic_sums": (
        *(3 * [_pointer]),
        *(_count, _count, _pointer, _count, _pointer, _count, _pointer, _pointer, _count, _count),
        *(5 * [_pointer]),
        *(_count, _count, _pointer, _pointer),
    ),
    "group": (
        *(_pointer, _count, _count, _count, _float, _float),
        *(_pointer, _pointer, _count, _count),
    ),
    "pool": (_pointer, _count, _count, _pointer, _count, _pointer, _count, _pointer, _pointer),
    "opponent_products": (_pointer, _pointer, _count, _count, _count, _pointer, _count, _pointer),
    "reduce": (_pointer, ctypes.c_ssize_t, _count, _count, _count, _pointer, _pointer),
    "rmo_sums": (_pointer, _pointer, _count, _double, _double, _double, _pointer, _pointer),
}
_NUMBER: dict[str, tuple[Any, ...]] = {
    "folded": (),
    "sample": (
        *(_pointer, _pointer, _pointer),
        *(5 * [_count]),
        *(4 * [_double]),
        *(4 * [_pointer]),
    ),
}

_Byte = ctypes.c_char

# True: the plain functions run.
portable = os.environ.get("OPPLOAD_PORTABLE", "0") not in ("", "0")


def with_twin(plain: Callable[Taken, Returned]) -> Callable[Taken, Returned]:
    """Replace a function by its compiled twin wherever compiled loops run.

    The plain function stays available as ``__wrapped__``.
    """

    @wraps(plain)
    def chosen(*args: Taken.args, **kwargs: Taken.kwargs) -> Returned:
        if portable or _loaded()[1] is None:
            return plain(*args, **kwargs)
        twin: Callable[Taken, Returned] = _twin(plain.__name__)
        return twin(*args, **kwargs)

    return chosen


def loops() -> ctypes.CDLL:
    """Return the compiled loops for this processor.

    Raises
    ------
    RuntimeError
        If they were not built.
    """
    library = _loaded()[1]
    if library is None:
        raise RuntimeError("the compiled loops were not built")
    return library


def arithmetic() -> str:
    """Say which arithmetic runs: ``compiled, wide vectors``, ``compiled`` or ``portable``."""
    name, library = _loaded()
    return "portable" if portable or library is None else name


def why_portable() -> str | None:
    """Say why the plain functions run; None where the compiled loops do."""
    if portable:
        return "OPPLOAD_PORTABLE is set"
    if _loaded()[1] is not None:
        return None
    found = _opened("baseline")
    return found if isinstance(found, str) else "the compiled loops were switched off"


def why_not_wide() -> str | None:
    """Say why the processor's wide vectors are not used by compiled loops; None where they are."""
    library = _loaded()[1]
    if portable or library is None or not library.runs_wide() or not _path("wide").exists():
        return None
    found = _opened("wide")
    return found if isinstance(found, str) else None


def address(array: NDArray[Any]) -> int:
    """Return where the first value of an array stands in memory; the array must outlive it."""
    try:  # half as long as by the array interface; a frame needs some 40 addresses
        return ctypes.addressof(_Byte.from_buffer(array.data))
    except (TypeError, ValueError):  # not contiguous, or for reading only
        return int(array.__array_interface__["data"][0])


def is_large(shape: tuple[int, int]) -> bool:
    """Tell whether frames of a height and width are large enough for several threads."""
    return shape[0] * shape[1] >= _LARGE


def in_bands(shape: tuple[int, int], compute: Callable[[int, int, int], object]) -> None:
    """Compute the rows of a frame, in bands on several threads where the frame is large.

    The threads are as many as OpenCV's, whose number follows the affinity mask or
    ``cv2.setNumThreads``. Each row is computed by one thread: the result has the same bytes
    for any number of threads.

    Parameters
    ----------
    shape : tuple of int
        Height and width of the frame.
    compute : callable
        Takes the number of a band, its first row, and the row after its last one.
    """
    bands = bands_of(shape)
    threads = min(cv2.getNumThreads(), len(bands)) if len(bands) > 1 else 1
    if threads <= 1:
        for number, band in enumerate(bands):
            compute(number, *band)
        return
    firsts, lasts = zip(*bands, strict=True)
    for _ in _pool(threads).map(compute, range(len(bands)), firsts, lasts):
        pass


def bands_of(shape: tuple[int, int]) -> list[tuple[int, int]]:
    """Return the first row of each band of a frame, and the row after its last one."""
    band = _BAND if is_large(shape) else max(1, shape[0])
    return [(first, min(first + band, shape[0])) for first in range(0, shape[0], band)]


@cache
def _pool(threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(threads, "oppload-bands")


@cache
def _twin(name: str) -> Any:
    return getattr(import_module("oppload_cli.compute.twins"), name)


@cache
def _loaded() -> tuple[str, ctypes.CDLL | None]:
    baseline = _load("baseline")
    if baseline is not None and baseline.runs_wide():
        wide = _load("wide")
        if wide is not None:
            return "compiled, wide vectors", wide
    return "compiled", baseline


def _load(build: str) -> ctypes.CDLL | None:
    found = _opened(build)
    return None if isinstance(found, str) else found


def _opened(build: str) -> ctypes.CDLL | str:
    """Return the library of a build, or why it is not used."""
    path = _path(build)
    if not path.exists():
        return "this installation has no compiled loops; install a wheel, or with a C compiler"
    if _is_damaged(path):
        return f"{path} is damaged; install oppload again"
    try:
        library = ctypes.CDLL(str(path))
        if library.interface() != INTERFACE:
            return f"{path} belongs to another version; install oppload again"
    except (OSError, AttributeError):
        return f"{path} does not load on this system; install the wheel of this platform"
    for signatures, returned in ((_NOTHING, None), (_NUMBER, ctypes.c_int)):
        for name, signature in signatures.items():
            function = getattr(library, name)
            function.argtypes, function.restype = signature, returned
    return library


def _path(build: str) -> Path:
    return Path(__file__).with_name(f"loops.{build}{SUFFIX}")


def _is_damaged(path: Path) -> bool:
    """Tell whether a library is not the one that was built: a truncated one can end the process."""
    try:
        stated = Path(f"{path}.sum").read_text(encoding="ascii").strip()
        return stated != f"{zlib.crc32(path.read_bytes()):08x}"
    except (OSError, UnicodeDecodeError):
        return False
