"""P(t) by compiled loops, in floats and, where it is whole, in code levels at once."""

from __future__ import annotations

import ctypes
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from oppload_cli.models.crew import bands_of
from oppload_cli.native.library import address, aligned, compiled, rows_of

if TYPE_CHECKING:
    from collections.abc import Callable

    from oppload_cli.models.crew import Crew
    from oppload_cli.models.kernels import Map
    from oppload_cli.models.whole import WholeSums


class _Job(ctypes.Structure):
    """``struct change`` of presynaptic.c."""

    _fields_ = (
        ("luma", ctypes.c_void_p),
        ("stride", ctypes.c_ssize_t),
        ("before", ctypes.c_void_p),
        ("kept", ctypes.c_void_p),
        ("photoreceptors", ctypes.c_void_p),
        ("photoreceptor_stride", ctypes.c_ssize_t),
        ("codes", ctypes.c_void_p),
        ("code_stride", ctypes.c_ssize_t),
        ("totals", ctypes.c_void_p),
        ("width", ctypes.c_int),
        ("levels", ctypes.c_int),
        ("whole", ctypes.c_int),
    )


class Change:
    """The change of luminance from each frame of a video to the next.

    Parameters
    ----------
    shape : tuple of int
        Height and width of the frames.
    stride : int
        Distance of two rows of P, in values.
    crew : Crew
        Shares out the work.
    """

    def __init__(self, shape: tuple[int, int], stride: int, crew: Crew) -> None:
        loops = compiled()
        self._crew = crew
        self._luma: list[Map] = list(aligned((2, *shape)))
        self._totals = np.zeros(shape[0])
        self._job = _Job(photoreceptor_stride=stride, totals=address(self._totals), width=shape[1])
        job = ctypes.addressof(self._job)
        self._bands: list[Callable[[], object]] = [
            partial(loops.change, job, *band) for band in bands_of(shape)
        ]

    @property
    def levels(self) -> int:
        """In how many code levels the latest P is whole; 0 for one that is not."""
        return int(self._job.levels)

    def begin(self, luma: Map) -> None:
        """Keep L of the first frame."""
        np.copyto(self._luma[0], luma)

    def compute(self, luma: Map, photoreceptors: int, whole: WholeSums | None) -> float:
        """Compute P(t) from L(t) and the L that was kept; return its mean.

        Parameters
        ----------
        luma : ndarray of float32, shape (height, width)
            L(t), 0 to 1.
        photoreceptors : int
            Address that takes P(t).
        whole : WholeSums or None
            Takes P(t) in levels.

        Returns
        -------
        float
        """
        if luma.strides[1] != luma.itemsize:
            luma = np.ascontiguousarray(luma)
        job = self._job
        job.luma, job.stride = rows_of(luma)
        job.before, job.kept = (address(each) for each in self._luma)
        job.photoreceptors = photoreceptors
        if whole:
            job.codes, job.code_stride = whole.following
        for levels in [*whole.possible(), 0] if whole else [0]:
            job.levels, job.whole = levels, True
            self._crew(*self._bands)
            if job.whole:
                break
        return float(self._totals.sum()) / luma.size

    def take(self) -> None:
        """Keep the L that `compute` has seen."""
        self._luma.reverse()
