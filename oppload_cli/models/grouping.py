"""Grouping of D-LGMD: C = ones * S, G = S C, kept from T on (``docs/model.md``, section 3)."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Protocol

import cv2
import numpy as np

from oppload_cli.models.crew import Crew, bands_of
from oppload_cli.native.library import LANES, address, aligned, compiled, library

if TYPE_CHECKING:
    from oppload_cli.models.kernels import Map
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


def grouping_of(presynaptic: Map, params: DlgmdParams) -> Grouping:
    """Return the grouping of a map, by whichever arithmetic runs here.

    Parameters
    ----------
    presynaptic : ndarray of float32, shape (height, width)
        S, as :class:`oppload_cli.models.layers.Dpc` holds it.
    params : DlgmdParams
        Gives `group_size` and `grouped_limit`.

    Returns
    -------
    Grouping
    """
    return (CompiledGrouping if library() else PortableGrouping)(presynaptic, params)


class PortableGrouping:
    """Grouping by OpenCV.

    Parameters
    ----------
    presynaptic : ndarray of float32, shape (height, width)
        S, overwritten by every frame.
    params : DlgmdParams
        Gives `group_size` and `grouped_limit`.
    """

    def __init__(self, presynaptic: Map, params: DlgmdParams) -> None:
        self._presynaptic, self._params = presynaptic, params
        self.grouped: Map = np.zeros(presynaptic.shape, np.float32)

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


class CompiledGrouping:
    """Grouping by compiled loops, in one pass.

    Parameters
    ----------
    presynaptic : ndarray of float32, shape (height, width)
        S, with zeros beyond the frame up to its stride.
    params : DlgmdParams
        Gives `group_size` and `grouped_limit`.
    """

    def __init__(self, presynaptic: Map, params: DlgmdParams) -> None:
        loops = compiled()
        self._group = loops.group
        self._params = params
        (height, width), stride = presynaptic.shape, presynaptic.strides[0] // 4
        grouped = aligned((height, stride))
        self.grouped: Map = grouped[:, :width]
        self._totals = np.zeros((height, 2))
        self._maps = presynaptic, grouped
        self._maps_and_size = address(presynaptic), address(grouped), stride, height
        self._crew = Crew(presynaptic.shape)
        bands = bands_of(height)
        self._columns = aligned((len(bands), stride + 2 * params.group_size + LANES))
        self._bands = list(zip(bands, map(address, self._columns), strict=True))

    def __call__(self, threshold: float) -> tuple[float, float]:
        """Compute G with T = `threshold`; return the means of S and of G over the frame."""
        params = self._params
        limits = params.group_size, threshold, params.grouped_limit
        totals = address(self._totals)
        self._crew(
            *(
                partial(self._group, *self._maps_and_size, *band, *limits, columns, totals)
                for band, columns in self._bands
            )
        )
        s, g = self._totals.sum(axis=0) / self.grouped.size
        return float(s), float(g)
