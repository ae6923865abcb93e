"""Opponent products of a pair of opposite pathways (``docs/model.md``, section 5)."""

from __future__ import annotations

import math
from functools import partial
from typing import TYPE_CHECKING, Protocol

import cv2
import numpy as np
from numpy.lib.stride_tricks import as_strided

from oppload_cli.native.library import LANES, address, aligned, compiled, library

if TYPE_CHECKING:
    from oppload_cli.models.kernels import Map
    from oppload_cli.models.parameters import OpplodParams
    from oppload_cli.models.pooling import Pooling
    from oppload_cli.models.presynaptic import Live

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
        rows, columns = pool.shape
        margin = len(weights) // 2
        # Zeros around the maps: beyond the frame there is no motion.
        one, other = (aligned((rows + 2 * margin, columns + 2 * margin + LANES)) for _ in range(2))
        inside = np.s_[margin : margin + rows, margin : margin + columns]
        self.passing, self.opposite = one[inside], other[inside]
        kind = _CompiledProducts if library() else _PortableProducts
        self._products: _Products = kind(one, other, weights, pool.shape)
        self.difference: Map = self._products.sums

    def __call__(self, passing: Map, opposite: Map, live: Live | None = None) -> None:
        """Sum O(c, u) = S_phi(c + u) S_(phi+180)(c - u) over u, weighted, into `difference`.

        `live` is as for :class:`oppload_cli.models.pooling.Pooling`.
        """
        for values, pooled in ((passing, self.passing), (opposite, self.opposite)):
            self.pool(values, pooled, live)
            if self._compression != 1:
                cv2.pow(pooled, self._compression, dst=pooled)
        self._products()


class _Products(Protocol):
    """Sums the weighted products of two padded maps into `sums`, shape (rows, columns)."""

    sums: Map

    def __call__(self) -> None: ...


class _PortableProducts:
    """The products by NumPy.

    The units of all rows stand in one line, with what lies between them: long lines are
    added fastest.
    """

    def __init__(self, one: Map, other: Map, weights: Map, units: tuple[int, int]) -> None:
        margin = len(weights) // 2
        self._weights = weights
        # By offset and unit: S_phi at c + u, and S_(phi+180) at c - u.
        self._ahead = _by_offset(one, margin)
        self._behind = _by_offset(other, margin)[::-1, ::-1]
        side, line = self._ahead.shape[1:]
        most = max(1, MOST_PRODUCTS // (side * line))
        self._products = np.zeros((min(side, most), side, line), np.float32)
        lines = np.zeros((units[0], one.shape[1]), np.float32)
        self._sum = lines.ravel()[:line]
        self.sums: Map = lines[:, : units[1]]

    def __call__(self) -> None:
        self._sum[:] = 0
        step = len(self._products)
        for first in range(0, len(self._weights), step):
            rows = slice(first, first + step)
            products = self._products[: len(self._weights[rows])]
            np.multiply(self._ahead[rows], self._behind[rows], out=products)
            self._sum += np.einsum("yx,yxi->i", self._weights[rows], products)


class _CompiledProducts:
    """The products by compiled loops."""

    def __init__(self, one: Map, other: Map, weights: Map, units: tuple[int, int]) -> None:
        margin = len(weights) // 2
        rows, columns = units
        stride = one.shape[1]
        down, across = np.nonzero(weights)
        offsets = np.asarray((down - margin) * stride + across - margin, np.intp)
        values = np.ascontiguousarray(weights[down, across])
        sums = aligned((rows, -(-columns // LANES) * LANES))
        self.sums: Map = sums[:, :columns]
        self._held = one, other, offsets, values, sums
        centre = one.itemsize * (margin * stride + margin)
        self._oppose = partial(
            compiled().oppose,
            *(address(one) + centre, address(other) + centre, stride, rows, columns),
            *(address(offsets), address(values), len(values), address(sums), sums.shape[1]),
        )

    def __call__(self) -> None:
        self._oppose()


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
    line = padded.size - 2 * margin * (padded.shape[1] + 1) - LANES
    strides = (*padded.strides, padded.itemsize)
    return as_strided(padded, (side, side, line), strides, writeable=False)
