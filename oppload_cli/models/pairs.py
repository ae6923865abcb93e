"""Opponent products of a pair of opposite pathways (``docs/model.md``, section 5)."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import cv2
import numpy as np
from numpy.lib.stride_tricks import as_strided

if TYPE_CHECKING:
    from oppload_cli.models.kernels import Map
    from oppload_cli.models.parameters import OpplodParams
    from oppload_cli.models.pooling import Pooling

MOST_PRODUCTS = 1 << 19  # held at once, so that they stay in the cache


class Pair:
    """Outward minus inward opponency of one pair of opposite pathways, at every unit.

    Parameters
    ----------
    pool : Pooling
        Pools their S maps.
    weights : ndarray of float32, shape (side, side)
        By offset: 1 outward, -w_p inward.
    compression : float
        Exponent of the pooled S.
    """

    def __init__(self, pool: Pooling, weights: Map, compression: float) -> None:
        self.pool = pool
        self._compression = compression
        self._weights = weights
        rows, columns = pool.shape
        margin = len(weights) // 2
        # Zeros around the maps: beyond the frame there is no motion.
        self._one, self._other = (
            np.zeros((rows + 2 * margin, columns + 2 * margin), np.float32) for _ in range(2)
        )
        inside = np.s_[margin : margin + rows, margin : margin + columns]
        self.passing, self.opposite = self._one[inside], self._other[inside]
        # By offset and unit: S_phi at c + u, and S_(phi+180) at c - u. The units of all rows
        # stand in one line, with what lies between them: long lines are added fastest.
        self._ahead = _by_offset(self._one, margin)
        self._behind = _by_offset(self._other, margin)[::-1, ::-1]
        side, line = self._ahead.shape[1:]
        most = max(1, MOST_PRODUCTS // (side * line))
        self._products = np.zeros((min(side, most), side, line), np.float32)
        lines = np.zeros((rows, columns + 2 * margin), np.float32)
        self._sum = lines.ravel()[:line]
        self.difference: Map = lines[:, :columns]

    def __call__(self, passing: Map, opposite: Map) -> None:
        """Sum O(c, u) = S_phi(c + u) S_(phi+180)(c - u) over u, weighted, into `difference`."""
        for values, pooled in ((passing, self.passing), (opposite, self.opposite)):
            self.pool(values, pooled)
            if self._compression != 1:
                cv2.pow(pooled, self._compression, dst=pooled)
        self._sum[:] = 0
        step = len(self._products)
        for first in range(0, len(self._weights), step):
            rows = slice(first, first + step)
            products = self._products[: len(self._weights[rows])]
            np.multiply(self._ahead[rows], self._behind[rows], out=products)
            self._sum += np.einsum("yx,yxi->i", self._weights[rows], products)


def offset_weights(reach: int, phi: int, params: OpplodParams) -> Map:
    """Weigh the offsets of an opponent product.

    Parameters
    ----------
    reach : int
        Largest offset in cells, across and down.
    phi : int
        Direction of the pathway in degrees: 0, 45, 90 or 135.
    params : OpplodParams
        Gives `cone` and `periphery`, w_p.

    Returns
    -------
    ndarray of float32, shape (2 reach + 1, 2 reach + 1)
        By row and column of the offset u: 1 within the cone about u_phi (outward),
        -w_p within that about -u_phi (inward), else 0.

    Source: ``docs/model.md``, section 5, and ``docs/robust.md``.
    """
    # Along an axis or a diagonal each component of u_phi is -1, 0 or 1 times one length.
    across = round(math.cos(math.radians(phi)) * math.sqrt(2))
    up = round(math.sin(math.radians(phi)) * math.sqrt(2))
    y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    along = x * across - y * up
    least = math.cos(math.radians(params.cone)) * math.hypot(across, up) * np.hypot(x, y)
    within = np.abs(along) > least - 1e-9
    return np.asarray(((along > 0) - params.periphery * (along < 0)) * within, np.float32)


def _by_offset(padded: Map, margin: int) -> Map:
    """View a padded map by the rows and columns of offsets, and all units in one line."""
    side = 2 * margin + 1
    line = padded.size - 2 * margin * (padded.shape[1] + 1)
    strides = (*padded.strides, padded.itemsize)
    return as_strided(padded, (side, side, line), strides, writeable=False)
