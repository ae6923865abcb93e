"""Opposing motion judgement (OMJ), with changes that make it work (``docs/model.md``, section 5).

:class:`PooledJudgement` pools the S maps over cells, multiplies opposite motion on opposite sides
of each unit, and subtracts the inward products from the outward ones. :class:`PixelwiseJudgement`
follows the paper's text literally instead.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import cv2
import numpy as np

from oppload_cli.compute.loops import with_twin
from oppload_cli.models.detector import UnitMaps
from oppload_cli.models.dpc import referred
from oppload_cli.models.opplod_parameters import OpplodResponse

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from oppload_cli.models.dpc import Map
    from oppload_cli.models.layers import Dpc
    from oppload_cli.models.opplod_parameters import OpplodParams

    Floats = NDArray[np.float64]
    Maps = NDArray[np.float32]  # several maps of cells, as one array


_NEIGHBOURS, _WITHIN_6 = np.ones((3, 3), np.uint8), np.ones((13, 13), np.uint8)
_POOLED_SIGMAS = 5  # reach of pooling in sigmas: pixels further away weigh less than a millionth


# ---- The equations -------------------------------------------------------------------------


def cell_centres(length: int, cell: int, units: int | None = None) -> Floats:
    """Return the centres of the cells along one side of the frame, in pixels.

    The row of cells has as many complete cells as fit, at least one, and is centred in the frame.
    If the number of units is odd, the number of cells is odd too: the middle unit needs a cell.
    `length` and `cell`, the sides of the frame and of a cell, are in pixels. `units` is the number
    of cells that are units; None if every cell is a unit.
    """
    count = max(1, length // cell)
    if units and units % 2 and count % 2 == 0:
        count -= 1
    return np.asarray((length - count * cell) / 2 + (np.arange(count) + 0.5) * cell, np.float64)


def pooling_weights(length: int, centres: Floats, sigma: float) -> Map:
    """Return the weights with which each cell pools the pixels along one side of the frame.

    Parameters
    ----------
    length : int
        Side of the frame in pixels.
    centres : ndarray, shape (n,)
        Centres of the cells in pixels; pixel i covers [i, i + 1).
    sigma : float
        Sigma of the Gaussian in pixels; with 0 each cell takes only the pixel at its centre.

    Returns
    -------
    ndarray of float32, shape (n, length)
        Gaussian weights; the sum of a cell's weights is 1 if its Gaussian lies within the side.
    """
    distance = np.arange(length) + 0.5 - centres[:, None]
    if sigma > 0:
        reach = math.ceil(_POOLED_SIGMAS * sigma)
        offsets = np.arange(-reach, reach + 1)
        weights = np.exp(-((distance / sigma) ** 2) / 2)
        weights /= np.exp(-((offsets / sigma) ** 2) / 2).sum()
        weights[np.abs(distance) > reach] = 0
    else:
        weights = (np.floor(centres)[:, None] == np.arange(length)).astype(np.float64)
    return np.asarray(weights, np.float32)


@with_twin
def pool(maps: Sequence[Map], down: Map, across: Map) -> Maps:
    """Pool maps over the cells: the matrix product ``down S_phi across'``, step 1 of section 5.

    Parameters
    ----------
    maps : sequence of ndarray of float32, shape (height, width)
        S_phi, each contiguous.
    down, across : ndarray of float32, shapes (rows, height) and (columns, width)
        :func:`pooling_weights` along the height and along the width.

    Returns
    -------
    ndarray of float32, shape (maps, rows, columns)
    """
    with np.errstate(all="ignore"):  # a processor with SME sets every flag after a product
        return np.asarray([down @ each @ across.T for each in maps], np.float32)


def offset_weights(reach: int, axis: int, periphery: float) -> Map:
    """Return the weights of the offsets u of the opponent products, steps 2 and 3 of section 5.

    Parameters
    ----------
    reach : int
        Largest offset in cells, across and down.
    axis : int
        Direction phi of the passing pathway in degrees: 0, 45, 90 or 135.
    periphery : float
        w_p, the weight with which inward motion is subtracted.

    Returns
    -------
    ndarray of float32, shape (2 reach + 1, 2 reach + 1)
        By row and column of u: 1 where ``u . u_phi > 0`` (outward), -w_p where it is below 0
        (inward), else 0.
    """
    # For these directions both components of u_phi, times a common factor, are -1, 0 or 1.
    right = round(math.cos(math.radians(axis)) * math.sqrt(2))
    up = round(math.sin(math.radians(axis)) * math.sqrt(2))
    y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    along = x * right - y * up
    return np.asarray((along > 0) - periphery * (along < 0), np.float32)


@with_twin
def opponent_products(pooled: Maps, weights: Maps) -> Maps:
    """Return the weighted sums of ``O(c, u) = S_phi(c + u) S_(phi+180)(c - u)`` over offsets u.

    Parameters
    ----------
    pooled : ndarray of float32, shape (2 axes, rows, columns)
        The pooled S_phi of each axis, followed by the pooled S_(phi+180), contiguous. Outside the
        frame they count as 0.
    weights : ndarray of float32, shape (axes, 2 reach + 1, 2 reach + 1)
        :func:`offset_weights` of each axis, contiguous.

    Returns
    -------
    ndarray of float32, shape (axes, rows, columns)
        ``out(c) - w_p in(c)`` of the unit at every cell c.
    """
    axes, reach = len(weights), weights.shape[-1] // 2
    sums = np.zeros_like(pooled[:axes])
    rows, columns = sums.shape[1:]
    for axis, dy, dx in np.argwhere(weights) - (0, reach, reach):
        y, x = abs(dy), abs(dx)  # for units nearer to the edge, c + u or c - u is outside
        if 2 * y < rows and 2 * x < columns:
            ahead = pooled[axis, y + dy : rows - y + dy, x + dx : columns - x + dx]
            behind = pooled[axes + axis, y - dy : rows - y - dy, x - dx : columns - x - dx]
            products = weights[axis, reach + dy, reach + dx] * ahead * behind
            sums[axis, y : rows - y, x : columns - x] += products
    return sums


def has_history(changes: Sequence[Map], least: float) -> NDArray[np.bool_]:
    """Return in which cells motion has lasted long enough for inhibition to be complete.

    The first edges that move after a rest meet no inhibition in any direction, so that they excite
    all pathways equally. The history of a cell is the largest change within 6 cells of it.

    Parameters
    ----------
    changes : sequence of ndarray of float32, shape (rows, columns)
        P over cells, now and one and two intervals ago.
    least : float
        Least history, both one and two intervals ago, as a share of the largest present change in
        the cell and its neighbours.

    Source: ``docs/time.md``.
    """
    now, *before = changes
    needed = np.float32(least) * cv2.dilate(now, _NEIGHBOURS)
    history = np.minimum(*(cv2.dilate(each, _WITHIN_6) for each in before))
    return np.asarray(history >= needed)


def enhanced(opponency: Map, gain: float, threshold: float) -> Map:
    """Return ``c2 R^2`` where R is above T_o, and 0 elsewhere, step 4 of section 5."""
    return np.where(opponency > threshold, np.float32(gain) * opponency**2, np.float32(0))


def unit_starts(last: int, count: int) -> list[int]:
    """Return the first pixels of the receptive fields of `count` units, evenly from 0 to `last`.

    `last`, in pixels, is the side of the frame minus the side of a field. A single unit is centred.
    """
    if count == 1:
        return [last // 2]
    return [round(index * last / (count - 1)) for index in range(count)]


# ---- The judgement over one video ----------------------------------------------------------


class CellJudgement:
    """Base of the judgements that pool motion over cells: their units are cells of the frame.

    Parameters
    ----------
    shape : tuple of int
        Height and width of the working frames.
    params : OpplodParams
        Resolved parameters.
    per_second : float
        Intervals per second.

    Attributes
    ----------
    maps : UnitMaps
        The responses of all cells to the latest frame; 0 at cells that are no units.
    """

    def __init__(
        self, shape: tuple[int, int], params: OpplodParams, per_second: float = 30.0
    ) -> None:
        self._params, self._per_second = params, per_second
        cell, field = params.cell_px, params.field_px
        counts = params.grid() or (None, None)  # of columns and rows
        y, x = (cell_centres(*each) for each in zip(shape, (cell, cell), counts[::-1], strict=True))
        zeros = np.zeros((len(y), len(x)), np.float32)
        self.maps = UnitMaps(zeros, {}, y, x, float(field))
        self._selected = self._selected_units(shape)
        self._down, self._across = self._pooling_weights(shape)
        self.reset()

    def _selected_units(self, shape: tuple[int, int]) -> Map:
        """Return a map with 1 at the cells that are units, and 0 elsewhere."""
        grid, maps = self._params.grid(), self.maps
        if grid is None:
            return np.ones_like(maps.responses)
        field = min(int(maps.field), *shape)

        def nearest_cells(centres: Floats, side: int, count: int) -> list[int]:
            starts = unit_starts(side - field, count)
            return [int(np.abs(centres - (start + field / 2)).argmin()) for start in starts]

        rows = nearest_cells(maps.centres_y, shape[0], grid[1])
        columns = nearest_cells(maps.centres_x, shape[1], grid[0])
        selected = np.zeros_like(maps.responses)
        selected[np.ix_(rows, columns)] = 1
        return selected

    def reset(self) -> None:
        """Forget all frames."""
        self.maps = self.maps._replace(responses=np.zeros_like(self.maps.responses), pathways={})

    def _pooling_weights(self, shape: tuple[int, int]) -> tuple[Map, Map]:
        """Return the weights, down and across, for maps of the frame."""
        maps, sigma = self.maps, self._params.pool_sigma * self._params.cell_px
        down = pooling_weights(shape[0], maps.centres_y, sigma)
        return down, pooling_weights(shape[1], maps.centres_x, sigma)


class PooledJudgement(CellJudgement):
    """OMJ at every cell: pool, subtract inward from outward motion, enhance the best unit."""

    def __init__(
        self, shape: tuple[int, int], params: OpplodParams, per_second: float = 30.0
    ) -> None:
        super().__init__(shape, params, per_second)
        reach = int(self.maps.field / 2 // params.cell_px)
        self._weights = np.array(
            [offset_weights(reach, axis, params.periphery) for axis in params.both_axes]
        )

    def opponency(self, dpc: Dpc) -> Map:
        """Return R(c), outward minus inward opponency, of the unit at every cell.

        Cells where motion has only just begun are left out (`history`).

        Parameters
        ----------
        dpc : Dpc
            S_phi of the frame.

        Returns
        -------
        ndarray of float32, shape (rows, columns)
            ``max(0, out - w_p in)``, summed over both axes.
        """
        params, photoreceptors = self._params, dpc.photoreceptors
        directions = *params.both_axes, *(axis + 180 for axis in params.both_axes)
        pooled = pool([dpc.sums.pathways[phi] for phi in directions], self._down, self._across)
        if photoreceptors.share != 1:
            p = pool(photoreceptors.maps[:1], self._down, self._across)
            e = np.float32(dpc.kernels.excitation.sum()) * p
            pooled = referred(pooled, e, photoreceptors.share, directional=True)
        if params.history:
            pooled *= has_history(photoreceptors.coarse(pooled.shape[1:]), params.history)
        self.maps = self.maps._replace(pathways=dict(zip(directions, pooled, strict=True)))
        return np.asarray(np.maximum(opponent_products(pooled, self._weights), 0).sum(axis=0))

    def judge(self, dpc: Dpc) -> OpplodResponse:
        """Judge the motion of one frame.

        If `history` is not 0, motion begins anew after a rest of the complete scene, as at the
        start of a video (``docs/time.md``).

        Parameters
        ----------
        dpc : Dpc
            S_phi of the frame.

        Returns
        -------
        OpplodResponse
            The response of the unit with the largest R: ``c2 R^2`` if R is above T_o, else 0.
        """
        params = self._params
        if dpc.photoreceptors.motion_lasts or not params.history:
            opponency = self.opponency(dpc) * self._selected
        else:
            opponency = np.zeros_like(self._selected)
        responses = enhanced(opponency, params.gain, params.threshold)
        self.maps = self.maps._replace(responses=responses)
        row, column = divmod(int(opponency.argmax()), opponency.shape[1])
        best = float(opponency[row, column])
        response = params.gain * best**2 if best > params.threshold else 0.0
        box = self.maps.box(row, column) if response else None
        return OpplodResponse(response, box, best)


# ---- The paper to the letter ---------------------------------------------------------------


class PixelwiseJudgement:
    """The paper's OMJ: products pixel by pixel in the receptive fields of a grid of units.

    Parameters and attributes are those of :class:`CellJudgement`; `params` has a grid of units.
    """

    def __init__(self, shape: tuple[int, int], params: OpplodParams) -> None:
        self._params = params
        self._field = min(params.field_px, *shape)
        columns, rows = params.grid() or (1, 1)
        self.lefts = unit_starts(shape[1] - self._field, columns)
        self.tops = unit_starts(shape[0] - self._field, rows)
        responses = np.zeros((rows, columns), np.float32)
        y, x = (np.array(each) + self._field / 2 for each in (self.tops, self.lefts))
        self.maps = UnitMaps(responses, {}, y, x, float(self._field))

    def reset(self) -> None:
        """Forget the responses to the latest frame."""
        self.maps.responses[:] = 0

    def judge(self, dpc: Dpc) -> OpplodResponse:
        """Judge the motion of one frame.

        The response is the sum of S_E over all units; the box is that of the unit with the largest
        S_E. S is multiplied by the wanted interval and divided by the actual interval.
        """
        pathways, share = dpc.sums.pathways, dpc.photoreceptors.share
        if share != 1:
            pathways = {phi: s * np.float32(share) for phi, s in pathways.items()}
        values = np.array(
            [[self._unit(pathways, top, left) for left in self.lefts] for top in self.tops]
        )
        enhanced_sums, sums = values[..., 0], values[..., 1]
        self.maps.responses[:] = enhanced_sums
        row, column = divmod(int(enhanced_sums.argmax()), values.shape[1])
        response = float(enhanced_sums.sum())
        box = self.maps.box(row, column) if response else None
        return OpplodResponse(response, box, float(sums[row, column]))

    def _unit(self, pathways: Mapping[int, Map], top: int, left: int) -> tuple[float, float]:
        """Return one unit's sum of ``S_E = c2 S_e^2``, and the sum of the products S_e."""
        field = np.s_[top : top + self._field, left : left + self._field]
        s_enhanced = s_e = 0.0
        for phi in self._params.both_axes:
            product = pathways[phi][field] * pathways[phi + 180][field][::-1, ::-1]
            selected = product[product > self._params.threshold].astype(np.float64)
            # Exchanging phi and phi + 180 gives the same products, rotated: hence the factor 2.
            s_enhanced += 2 * self._params.gain * float(selected @ selected)
            s_e += 2 * float(selected.sum())
        return s_enhanced, s_e
