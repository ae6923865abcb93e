"""Opposing motion judgement (OMJ) and enhancing (``docs/model.md``, section 5).

Two judges: :class:`PooledJudge` sums opponent products over cells,
:class:`PixelwiseJudge` is the paper to the letter. Both take the four S maps and
return the winning unit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Protocol

import cv2
import numpy as np
from numpy.lib.stride_tricks import as_strided

from oppload_cli.models.background import Background
from oppload_cli.models.crew import Crew
from oppload_cli.models.parameters import axes_of
from oppload_cli.models.pooling import Pooling
from oppload_cli.models.units import UnitMaps

if TYPE_CHECKING:
    from collections.abc import Mapping

    from oppload_cli.models.kernels import Map
    from oppload_cli.models.parameters import OpplodParams
    from oppload_cli.models.pooling import Floats

MOST_PRODUCTS = 1 << 19  # held at once, so that they stay in the cache


@dataclass(frozen=True)
class Verdict:
    """What a judge says of one frame.

    Attributes
    ----------
    response : float
        The enhanced response of the frame, at least 0.
    opponency : float
        R of the winning unit before enhancing, at least 0.
    centre_x, centre_y : float
        Centre of the winning unit in working pixels (pixel i covers [i, i + 1)).
    """

    response: float
    opponency: float
    centre_x: float
    centre_y: float


class Judge(Protocol):
    """The opposing motion judgement of one preset.

    Attributes
    ----------
    maps : UnitMaps
        What it saw in the latest frame.
    """

    maps: UnitMaps

    def map(self, direction: int) -> Map:
        """Return a new map of zeros for a pathway, of the kind that is judged fastest."""

    def judge(self, pathways: Mapping[int, Map]) -> Verdict:
        """Judge the S maps of the four pathways, by direction in degrees."""

    def reset(self) -> None:
        """Forget the frames that have passed."""


class PooledJudge:
    """OMJ of presets `default` and `robust`: pool, outward minus inward, enhance the best.

    Parameters
    ----------
    shape : tuple of int
        Height and width of the working frames.
    params : OpplodParams
        Resolved parameters (`receptive_field` and `cell` are numbers).
    """

    def __init__(self, shape: tuple[int, int], params: OpplodParams) -> None:
        self._params = params
        cell = params.cell or 1
        reach = int((params.receptive_field or 0) / 2 // cell)
        self._pairs = {
            phi: _Pair(
                Pooling(shape, cell, params.pool_sigma * cell),
                _offset_weights(reach, phi, params),
                params.compression,
            )
            for phi in axes_of(params)
        }
        pool = self._pairs[params.axes].pool
        self.centres_y, self.centres_x = pool.centres_y, pool.centres_x
        self.maps = UnitMaps(
            np.zeros(pool.shape, np.float32),
            {
                direction: pooled
                for phi, pair in self._pairs.items()
                for direction, pooled in ((phi, pair.passing), (phi + 180, pair.opposite))
            },
            self.centres_y,
            self.centres_x,
            float(params.receptive_field or 0),
            # A power of a Gaussian is a Gaussian, wider where the power is below 1.
            params.pool_sigma * cell / math.sqrt(params.compression),
        )
        self._crew = Crew(shape)
        self._further = np.zeros(pool.shape, np.float32)
        self._kept = np.zeros(pool.shape, np.float32)
        self._gain = np.float32(params.rate_gain())
        self._frames = 0
        self._background = Background(
            params.frames(params.adaptation_s), params.frames(params.adaptation_guard_s)
        )
        self._selected = _selected_units(shape, self.centres_y, self.centres_x, params)

    def map(self, direction: int) -> Map:
        """Return a new map of zeros for a pathway, which is pooled without being copied.

        Parameters
        ----------
        direction : int
            phi in degrees.

        Returns
        -------
        ndarray of float32, shape (height, width)
        """
        return self._pairs[direction % 180].pool.map()

    def reset(self) -> None:
        """Forget the frames that have passed."""
        self._frames = 0
        self._kept[:] = 0
        self._background.reset()

    def add(self, pathways: Mapping[int, Map], share: float) -> None:
        """Take frames several apart: their R counts in the next frame judged.

        Parameters
        ----------
        pathways : mapping of int to ndarray of float32, shape (height, width)
            S_phi by direction phi in degrees.
        share : float
            What R is multiplied by.
        """
        self._further += np.float32(share) * self.opponency(pathways)

    def judge(self, pathways: Mapping[int, Map]) -> Verdict:
        """Judge the S maps of the four pathways.

        Parameters
        ----------
        pathways : mapping of int to ndarray of float32, shape (height, width)
            S_phi by direction phi in degrees.

        Returns
        -------
        Verdict
            The best unit's; its response is ``c2 R^2``, 0 unless R is above T_o.
        """
        opponency = self.opponency(pathways)
        opponency += self._further
        self._further[:] = 0
        if self._params.persistence:
            cv2.accumulateWeighted(opponency, self._kept, 1 - self._params.persistence)
            opponency = self._kept.copy()
        opponency *= self._selected
        opponency *= self._gain
        opponency *= self._adaptation(float(opponency.max()))
        best = int(opponency.argmax())
        row, column = divmod(best, opponency.shape[1])
        value = float(opponency[row, column])
        responses = self.maps.responses
        np.multiply(opponency, self._params.gain * opponency, out=responses)
        responses[opponency <= self._params.threshold] = 0
        above = value > self._params.threshold
        return Verdict(
            response=self._params.gain * value**2 if above else 0.0,
            opponency=value,
            centre_x=float(self.centres_x[column]),
            centre_y=float(self.centres_y[row]),
        )

    def _adaptation(self, best: float) -> np.float32:
        """Return what R is multiplied by: 1, or less in a scene full of opponent motion.

        ``min(1, level / B)``, B the background of the best unit's R (``docs/robust.md``).
        """
        level = self._params.adaptation_level
        if not level or not best:  # rest is no background
            return np.float32(1)
        self._frames += 1
        background = self._background.step(best, self._frames)
        return np.float32(min(1, level / background) if background else 1)

    def opponency(self, pathways: Mapping[int, Map]) -> Map:
        """Return R(c), outward minus inward opponency, of the unit at every cell.

        Parameters
        ----------
        pathways : mapping of int to ndarray of float32, shape (height, width)
            S_phi by direction phi in degrees.

        Returns
        -------
        ndarray of float32, shape (rows, columns)
            Sum over both axis pairs of ``max(0, out - w_p in)``.
        """
        self._crew(
            *(
                partial(pair, pathways[phi], pathways[phi + 180])
                for phi, pair in self._pairs.items()
            )
        )
        one, other = self._pairs.values()
        return np.maximum(one.difference, 0) + np.maximum(other.difference, 0)


class _Pair:
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


class PixelwiseJudge:
    """OMJ of preset `paper`: products pixel by pixel in the fields of a grid of units.

    Parameters
    ----------
    shape : tuple of int
        Height and width of the working frames.
    params : OpplodParams
        Resolved parameters with a grid of units.
    """

    def __init__(self, shape: tuple[int, int], params: OpplodParams) -> None:
        self._params = params
        self._shape = shape
        self._field = min(params.receptive_field or 0, *shape)
        columns, rows = params.grid() or (1, 1)
        self.lefts = _evenly(shape[1] - self._field, columns)
        self.tops = _evenly(shape[0] - self._field, rows)
        self.maps = UnitMaps(
            np.zeros((rows, columns), np.float32),
            {},
            np.asarray(self.tops, np.float64) + self._field / 2,
            np.asarray(self.lefts, np.float64) + self._field / 2,
            float(self._field),
            0.0,
        )

    def map(self, direction: int) -> Map:  # noqa: ARG002 - all are alike
        """Return a new map of zeros for a pathway.

        Parameters
        ----------
        direction : int
            phi in degrees.

        Returns
        -------
        ndarray of float32, shape (height, width)
        """
        return np.zeros(self._shape, np.float32)

    def reset(self) -> None:
        """Forget the frames that have passed: it remembers none."""

    def judge(self, pathways: Mapping[int, Map]) -> Verdict:
        """Judge the S maps of the four pathways.

        Parameters
        ----------
        pathways : mapping of int to ndarray of float32, shape (height, width)
            S_phi by direction phi in degrees.

        Returns
        -------
        Verdict
            The response is the sum of S_E over all units; the place is the unit
            of the largest part of it.
        """
        values = np.array(
            [[self._unit(pathways, top, left) for left in self.lefts] for top in self.tops]
        )
        row, column = divmod(int(values[..., 0].argmax()), values.shape[1])
        self.maps.responses[:] = values[..., 0]
        return Verdict(
            response=float(values[..., 0].sum()),
            opponency=float(values[row, column, 1]),
            centre_x=self.lefts[column] + self._field / 2,
            centre_y=self.tops[row] + self._field / 2,
        )

    def _unit(self, pathways: Mapping[int, Map], top: int, left: int) -> tuple[float, float]:
        """Return one unit's sum of S_E, and of the products that it is made from."""
        field = np.s_[top : top + self._field, left : left + self._field]
        enhanced = opponency = 0.0
        for phi in axes_of(self._params):
            product = pathways[phi][field] * pathways[phi + 180][field][::-1, ::-1]
            selected = product[product > self._params.threshold].astype(np.float64)
            # The products in the other order are the same ones, rotated by 180 degrees.
            enhanced += 2 * self._params.gain * float(selected @ selected)
            opponency += 2 * float(selected.sum())
        return enhanced, opponency


def judge_for(shape: tuple[int, int], params: OpplodParams) -> Judge:
    """Return the judge that the parameters ask for.

    Parameters
    ----------
    shape : tuple of int
        Height and width of the working frames.
    params : OpplodParams
        Resolved parameters.

    Returns
    -------
    Judge
    """
    kind = PooledJudge if params.judgement == "pooled" else PixelwiseJudge
    return kind(shape, params)


def _offset_weights(reach: int, phi: int, params: OpplodParams) -> Map:
    """Return 1 at the offsets u within the cone of u_phi, -w_p within that of -u_phi, else 0."""
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


def _evenly(room: int, count: int) -> list[int]:
    if count == 1:
        return [room // 2]
    return [round(index * room / (count - 1)) for index in range(count)]


def _selected_units(
    shape: tuple[int, int], centres_y: Floats, centres_x: Floats, params: OpplodParams
) -> Map:
    """Return 1 at the cells that are units, 0 elsewhere."""
    selected = np.ones((len(centres_y), len(centres_x)), np.float32)
    grid = params.grid()
    if grid is not None:
        field = min(params.receptive_field or 0, *shape)
        columns = _nearest(centres_x, _evenly(shape[1] - field, grid[0]), field)
        rows = _nearest(centres_y, _evenly(shape[0] - field, grid[1]), field)
        selected[:] = 0
        selected[np.ix_(rows, columns)] = 1
    return selected


def _nearest(centres: Floats, starts: list[int], field: int) -> list[int]:
    return [int(np.abs(centres - (start + field / 2)).argmin()) for start in starts]
