"""Grouping of D-LGMD: C = ones * S, G = S C, kept from T on (``docs/model.md``, section 3)."""

from __future__ import annotations

import ctypes
from functools import partial
from typing import TYPE_CHECKING, Protocol

import cv2
import numpy as np

from oppload_cli.models.crew import Crew, bands_of
from oppload_cli.native.library import LANES, LiveOf, address, aligned, compiled, library

if TYPE_CHECKING:
    from collections.abc import Callable

    from oppload_cli.models.kernels import Map
    from oppload_cli.models.layers import Dpc
    from oppload_cli.models.parameters import DlgmdParams


class Grouping(Protocol):
    """Groups a map of S.

    Attributes
    ----------
    grouped : ndarray of float32, shape (height, width)
        G.
    """

    grouped: Map

    def __call__(self, threshold: float) -> tuple[float, float]:
        """Compute G with T = `threshold`; return the means of S and of G over the frame."""


def grouping_of(dpc: Dpc, params: DlgmdParams) -> Grouping:
    """Return the grouping of S, by whichever arithmetic runs here.

    Parameters
    ----------
    dpc : Dpc
        Holds S, which every frame overwrites.
    params : DlgmdParams
        Gives `group_size` and `grouped_limit`.

    Returns
    -------
    Grouping
    """
    return (CompiledGrouping if library() else PortableGrouping)(dpc, params)


class PortableGrouping:
    """Grouping by OpenCV.

    Parameters
    ----------
    dpc : Dpc
        Holds S.
    params : DlgmdParams
        Gives `group_size` and `grouped_limit`.
    """

    def __init__(self, dpc: Dpc, params: DlgmdParams) -> None:
        self._presynaptic, self._params = dpc.presynaptic, params
        self.grouped: Map = np.zeros(dpc.shape, np.float32)

    def __call__(self, threshold: float) -> tuple[float, float]:
        """Compute G with T = `threshold`; return the means of S and of G over the frame."""
        side = self._params.group_size
        anchor = (side - 1) // 2  # of MATLAB's conv2(..., 'same')
        grouped = self.grouped
        cv2.boxFilter(
            self._presynaptic,
            cv2.CV_32F,
            (side, side),
            dst=grouped,
            anchor=(anchor, anchor),
            normalize=False,
            borderType=cv2.BORDER_CONSTANT,
        )
        cv2.multiply(grouped, self._presynaptic, dst=grouped)
        # THRESH_TOZERO keeps what is strictly above; the model keeps T itself too.
        below = float(np.nextafter(np.float32(threshold), np.float32(-np.inf)))
        cv2.threshold(grouped, below, 0, cv2.THRESH_TOZERO, dst=grouped)
        limit = self._params.grouped_limit
        cv2.threshold(grouped, limit, limit, cv2.THRESH_TRUNC, dst=grouped)
        return cv2.mean(self._presynaptic)[0], cv2.mean(grouped)[0]


class _Job(ctypes.Structure):
    """``struct group`` of models.c."""

    _fields_ = (
        ("presynaptic", ctypes.c_void_p),
        ("grouped", ctypes.c_void_p),
        ("stride", ctypes.c_ssize_t),
        ("live", LiveOf),
        ("height", ctypes.c_int),
        ("side", ctypes.c_int),
        ("threshold", ctypes.c_float),
        ("limit", ctypes.c_float),
        ("totals", ctypes.c_void_p),
    )


class CompiledGrouping:
    """Grouping by compiled loops, in one pass.

    Parameters
    ----------
    dpc : Dpc
        Holds S, with zeros beyond the frame up to its stride.
    params : DlgmdParams
        Gives `group_size` and `grouped_limit`.
    """

    def __init__(self, dpc: Dpc, params: DlgmdParams) -> None:
        loops = compiled()
        self._params = params
        presynaptic, (height, width) = dpc.presynaptic, dpc.shape
        stride = presynaptic.strides[0] // presynaptic.itemsize
        grouped = aligned((height, stride))
        self.grouped: Map = grouped[:, :width]
        self._totals = np.zeros((height, 2))
        bands = bands_of(dpc.shape)
        columns = aligned((len(bands), stride + 2 * params.group_size + LANES))
        alive = np.zeros((len(bands), stride // LANES), np.uint8)
        self._maps = presynaptic, dpc.live, grouped, columns, alive
        self._crew = Crew(dpc.shape)
        self._job = _Job(
            presynaptic=address(presynaptic),
            grouped=address(grouped),
            stride=stride,
            live=LiveOf.known(dpc.live),
            height=height,
            side=params.group_size,
            limit=params.grouped_limit,
            totals=address(self._totals),
        )
        job = ctypes.addressof(self._job)
        self._bands: list[Callable[[], object]] = [
            partial(loops.group, job, *band, address(sums), address(there))
            for band, sums, there in zip(bands, columns, alive, strict=True)
        ]

    def __call__(self, threshold: float) -> tuple[float, float]:
        """Compute G with T = `threshold`; return the means of S and of G over the frame."""
        self._job.threshold = threshold
        self._crew(*self._bands)
        s, g = (self._totals.sum(axis=0) / self.grouped.size).tolist()
        return s, g
