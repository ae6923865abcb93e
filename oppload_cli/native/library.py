"""The compiled inner loops: which build of them runs here, if any.

Where there is none, the same is done by OpenCV and NumPy: slower, and equal but for
the last digits.
"""

from __future__ import annotations

import ctypes
import os
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

FOLDER = Path(__file__).parent
INTERFACE = 9  # of the C files: another number is that of a build gone stale
LANES = 8  # of a vector
ALIGNMENT = 64  # bytes of a cache line

# Set to 1, the compiled loops are left alone.
portable = os.environ.get("OPPLOAD_PORTABLE", "0") not in ("", "0")

_pointer, _distance, _count = ctypes.c_void_p, ctypes.c_ssize_t, ctypes.c_int
_double = ctypes.c_double
_SIGNATURES: dict[str, tuple[Any, ...]] = {
    "luminance": (_pointer, _distance, *4 * (_count,), _pointer),
    "change": (_pointer, _count, _count),
    "sums": (_pointer, _count, _count, _pointer),
    "whole_sums": (_pointer, _count, _count, _pointer, _pointer),
    "group": (_pointer, _count, _count, _pointer, _pointer),
    "pool": (_pointer,),
    "oppose": (
        *(_pointer, _pointer, _distance, _count, _count),
        *(_pointer, _pointer, _count, _pointer, _distance),
    ),
    "reduce": (_pointer, _distance, _count, _count, _count, _pointer, _pointer),
    "sample": (_pointer, _pointer, _pointer),
    "opponency": (
        *(_pointer, _pointer, _count),
        *(_double, _double, _double, _pointer, _pointer),
    ),
}


class LiveOf(ctypes.Structure):
    """``struct live`` of models.c: where a map may have values other than 0."""

    _fields_ = (("at", ctypes.c_void_p), ("stride", ctypes.c_ssize_t))

    @classmethod
    def known(cls, live: NDArray[np.uint8] | None) -> LiveOf:
        """Return it for an array that must outlive it; None: anywhere."""
        return cls() if live is None else cls(address(live), live.strides[0])


class MapOf(ctypes.Structure):
    """``struct map`` of models.c."""

    _fields_ = (
        ("values", ctypes.c_void_p),
        ("stride", ctypes.c_ssize_t),
        ("height", ctypes.c_int),
        ("width", ctypes.c_int),
        ("live", LiveOf),
    )

    @classmethod
    def of(cls, values: NDArray[np.float32], live: NDArray[np.uint8] | None) -> MapOf:
        """Return it for arrays that must outlive it."""
        return cls(*rows_of(values), *values.shape, LiveOf.known(live))


def library() -> ctypes.CDLL | None:
    """Return the compiled loops for this processor.

    Returns
    -------
    ctypes.CDLL or None
        None if they were not built, or if the environment variable
        ``OPPLOAD_PORTABLE`` was 1 at the start.
    """
    return None if portable else _loaded()[1]


def compiled() -> ctypes.CDLL:
    """Return the compiled loops where `library` has said that they are there.

    Returns
    -------
    ctypes.CDLL

    Raises
    ------
    RuntimeError
        If they are not.
    """
    loops = library()
    if loops is None:
        raise RuntimeError("the compiled loops were not built")
    return loops


def arithmetic() -> str:
    """Say what the inner loops are computed by.

    Returns
    -------
    str
        ``compiled, wide vectors``, ``compiled`` or ``portable``.
    """
    return "portable" if library() is None else _loaded()[0]


def aligned(shape: tuple[int, ...]) -> NDArray[np.float32]:
    """Return zeros that begin on a cache line, as the vectors of the loops like them.

    Parameters
    ----------
    shape : tuple of int
        Any shape.

    Returns
    -------
    ndarray of float32
    """
    size = int(np.prod(shape))
    room = np.zeros(size + ALIGNMENT // 4, np.float32)
    start = -room.ctypes.data % ALIGNMENT // 4
    return room[start : start + size].reshape(shape)


def address(array: NDArray[Any]) -> int:
    """Return where an array's first value stands in memory.

    Parameters
    ----------
    array : ndarray
        It must outlive the address.

    Returns
    -------
    int
    """
    return int(array.__array_interface__["data"][0])


def rows_of(values: NDArray[Any]) -> tuple[int, int]:
    """Return where a map stands in memory, and how far apart its rows do.

    Parameters
    ----------
    values : ndarray, shape (height, width)
        It must outlive the address; its rows may stand apart.

    Returns
    -------
    int, int
        Address, and distance in values.
    """
    return address(values), values.strides[0] // values.itemsize


@cache
def _loaded() -> tuple[str, ctypes.CDLL | None]:
    baseline = _load("baseline")
    if baseline is not None and baseline.runs_wide():
        wide = _load("wide")
        if wide is not None:
            return "compiled, wide vectors", wide
    return "compiled", baseline


def _load(build: str) -> ctypes.CDLL | None:
    path = FOLDER / f"loops.{build}.so"
    try:
        loaded = ctypes.CDLL(str(path))
        if loaded.interface() != INTERFACE:
            return None
    except (OSError, AttributeError):  # not built, or built for another system
        return None
    for name, signature in _SIGNATURES.items():
        function = getattr(loaded, name)
        function.argtypes, function.restype = signature, None
    return loaded
