"""Opposing motion judgement (OMJ), made to work (``docs/model.md``, section 5).

It pools the S maps over cells, multiplies opposite motion on opposite sides of each unit, and
subtracts the inward products from the outward ones. :class:`PixelwiseJudgement` follows the paper
to the letter instead.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import cv2
import numpy as np

from oppload_cli.compute.loops import with_twin
from oppload_cli.models.camera import NO_BARS, Widths, leave_out_entering
from oppload_cli.models.detector import UnitMaps
from oppload_cli.models.dpc import referred
from oppload_cli.models.opplod_parameters import OpplodResponse
from oppload_cli.models.timebase import Background

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from oppload_cli.models.dpc import Map
    from oppload_cli.models.layers import Dpc, Photoreceptors
    from oppload_cli.models.opplod_parameters import OpplodParams

    Floats = NDArray[np.float64]
    Maps = NDArray[np.float32]  # several maps of cells, as one array


_BESIDE, _NEARBY = np.ones((3, 3), np.uint8), np.ones((13, 13), np.uint8)
_MOST_ELAPSED = 1.3  # intervals that one picture counts at most: at 24 frames/s, 1.25 in full
_POOLED_SIGMAS = 5  # pixels further from a cell's centre weigh less than a millionth


# ---- The equations -------------------------------------------------------------------------


def cell_centres(length: int, cell: int, units: int | None = None) -> Floats:
    """Return where the centres of the cells lie along one side of the frame.

    As many complete cells as fit, at least one, stand centred in the frame. For an odd number of
    units the number of cells is odd too, so that the unit in the middle has a cell there.

    Parameters
    ----------
    length : int
        Side of the frame in pixels.
    cell : int
        Spacing of the cells in pixels.
    units : int, optional
        How many of the cells are units; None where each is one.
    """
    count = max(1, length // cell)
    if units and units % 2 and count % 2 == 0:
        count -= 1
    return np.asarray((length - count * cell) / 2 + (np.arange(count) + 0.5) * cell, np.float64)


def pooling_weights(
    length: int, centres: Floats, sigma: float, border: tuple[int, int] = (0, 0)
) -> Map:
    """Return the weights with which each cell pools the pixels along one side of the frame.

    Parameters
    ----------
    length : int
        Side of the frame in pixels.
    centres : ndarray, shape (n,)
        Centres of the cells in pixels; pixel i covers [i, i + 1).
    sigma : float
        Spread of the Gaussian in pixels; 0 takes the pixel at the centre alone.
    border : tuple of int
        Pixels at the start and at the end of the side that do not count.

    Returns
    -------
    ndarray of float32, shape (n, length)
        A Gaussian whose sum is 1 on an endless side.
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
    weights[:, : border[0]] = weights[:, max(0, length - border[1]) :] = 0
    return np.asarray(weights, np.float32)


@with_twin
def pool(maps: Sequence[Map], down: Map, across: Map) -> Maps:
    """Pool maps over the cells: ``down S_phi across'`` of each, step 1 of section 5.

    Parameters
    ----------
    maps : sequence of ndarray of float32, shape (height, width)
        S_phi, each contiguous.
    down, across : ndarray of float32, shapes (rows, height) and (columns, width)
        :func:`pooling_weights` of either side.

    Returns
    -------
    ndarray of float32, shape (maps, rows, columns)
    """
    return np.asarray([down @ each @ across.T for each in maps], np.float32)


def offset_weights(reach: int, axis: int, cone: float, periphery: float) -> Map:
    """Return the weights of the offsets u of the opponent products, steps 2 and 3 of section 5.

    Parameters
    ----------
    reach : int
        Largest offset in cells, across and down.
    axis : int
        Direction phi of the passing pathway in degrees: 0, 45, 90 or 135.
    cone : float
        Largest angle in degrees between an offset and the axis, up to 90.
    periphery : float
        w_p, the weight of inward against outward motion.

    Returns
    -------
    ndarray of float32, shape (2 reach + 1, 2 reach + 1)
        By row and column of u: 1 within the cone about u_phi (outward), -w_p within that about
        -u_phi (inward), else 0. The cone is that of ``docs/presets.md``.
    """
    # Along an axis or a diagonal each component of u_phi is -1, 0 or 1 times one length.
    right = round(math.cos(math.radians(axis)) * math.sqrt(2))
    up = round(math.sin(math.radians(axis)) * math.sqrt(2))
    y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    along = x * right - y * up
    least = math.cos(math.radians(cone)) * math.hypot(right, up) * np.hypot(x, y)
    within = np.abs(along) > least - 1e-9
    return np.asarray(((along > 0) - periphery * (along < 0)) * within, np.float32)


@with_twin
def opponent_products(pooled: Maps, weights: Maps) -> Maps:
    """Sum ``O(c, u) = S_phi(c + u) S_(phi+180)(c - u)`` over the offsets u, weighted.

    Parameters
    ----------
    pooled : ndarray of float32, shape (2 axes, rows, columns)
        The pooled S_phi of each axis, and then the S_(phi+180), contiguous; beyond the frame
        they are 0.
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
        y, x = abs(dy), abs(dx)  # beyond these margins one of the two places is outside
        if 2 * y < rows and 2 * x < columns:
            ahead = pooled[axis, y + dy : rows - y + dy, x + dx : columns - x + dx]
            behind = pooled[axes + axis, y - dy : rows - y - dy, x - dx : columns - x - dx]
            products = weights[axis, reach + dy, reach + dx] * ahead * behind
            sums[axis, y : rows - y, x : columns - x] += products
    return sums


def has_history(changes: Sequence[Map], least: float) -> NDArray[np.bool_]:
    """Tell in which cells motion has lasted for long enough that S has its inhibition.

    The first edges that move after a rest meet no inhibition, in no direction, and excite all
    pathways alike. The history of a cell is the largest change within 6 cells.

    Parameters
    ----------
    changes : sequence of ndarray of float32, shape (rows, columns)
        P over cells, now and one and two intervals ago.
    least : float
        Least history, one and two intervals ago, over the largest change now in the cell or
        beside it.

    Source: ``docs/time.md``.
    """
    now, *before = changes
    needed = np.float32(least) * cv2.dilate(now, _BESIDE)
    found = np.minimum(*(cv2.dilate(each, _NEARBY) for each in before))
    return np.asarray(found >= needed)


def enhanced(opponency: Map, gain: float, threshold: float) -> Map:
    """Return ``c2 R^2`` where R is above T_o, else 0, step 4 of section 5."""
    return np.where(opponency > threshold, np.float32(gain) * opponency**2, np.float32(0))


def unit_starts(room: int, count: int) -> list[int]:
    """Spread a row of units evenly.

    Parameters
    ----------
    room : int
        Side of the frame less that of a receptive field, in pixels.
    count : int
        How many units there are, at least 1.

    Returns
    -------
    list of int
        Where their fields start: from 0 to `room`; in the middle for one unit.
    """
    if count == 1:
        return [room // 2]
    return [round(index * room / (count - 1)) for index in range(count)]


def _selected_units(maps: UnitMaps, grid: tuple[int, int] | None, shape: tuple[int, int]) -> Map:
    """Return 1 at the cells that are units, 0 elsewhere, in frames of a height and width.

    `grid` holds the columns and rows of the units, spread evenly; None where every cell is a unit.
    """
    if grid is None:
        return np.ones_like(maps.responses)
    field = min(int(maps.field), *shape)

    def nearest(centres: Floats, side: int, count: int) -> list[int]:
        starts = unit_starts(side - field, count)
        return [int(np.abs(centres - (start + field / 2)).argmin()) for start in starts]

    rows = nearest(maps.centres_y, shape[0], grid[1])
    columns = nearest(maps.centres_x, shape[1], grid[0])
    selected = np.zeros_like(maps.responses)
    selected[np.ix_(rows, columns)] = 1
    return selected


# ---- The judgement over one video ----------------------------------------------------------


class CellJudgement:
    """Units at the cells of the frame, for the judgements that pool motion over cells.

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
        The units at the latest frame, one at every cell.
    """

    def __init__(
        self, shape: tuple[int, int], params: OpplodParams, per_second: float = 30.0
    ) -> None:
        self._params, self._per_second = params, per_second
        cell, grid = params.cell_px, params.grid()
        columns, rows = grid or (None, None)
        centres_y, centres_x = (
            cell_centres(shape[0], cell, rows),
            cell_centres(shape[1], cell, columns),
        )
        none = np.zeros((len(centres_y), len(centres_x)), np.float32)
        field, spread = float(params.field_px), params.pool_sigma * cell
        self.maps = UnitMaps(none, {}, centres_y, centres_x, field, spread)
        self._selected = _selected_units(self.maps, grid, shape)
        self._down, self._across = self._pooling_weights(shape)
        self.reset()

    def reset(self) -> None:
        """Forget the frames that have passed."""
        self.maps = self.maps._replace(responses=np.zeros_like(self.maps.responses), pathways={})

    def _pooling_weights(
        self, shape: tuple[int, ...], reduction: int = 1, bars: Widths = NO_BARS
    ) -> tuple[Map, Map]:
        """Return the weights, down and across, that pool maps smaller than the frame."""
        maps, params = self.maps, self._params
        sigma = params.pool_sigma * params.cell_px / reduction
        left, right, top, bottom = ((params.border + bar) // reduction for bar in bars)
        return (
            pooling_weights(shape[0], maps.centres_y / reduction, sigma, (top, bottom)),
            pooling_weights(shape[1], maps.centres_x / reduction, sigma, (left, right)),
        )


class PooledJudgement(CellJudgement):
    """OMJ at every cell: pool, outward minus inward, enhance the best unit."""

    def __init__(
        self, shape: tuple[int, int], params: OpplodParams, per_second: float = 30.0
    ) -> None:
        super().__init__(shape, params, per_second)
        self._bars = NO_BARS
        self._pooling = {1: (self._down, self._across)}  # by the reduction of the maps
        # A power of a Gaussian is a Gaussian, wider where the power is below 1.
        self.maps = self.maps._replace(spread=self.maps.spread / math.sqrt(params.compression))
        reach = int(self.maps.field / 2 // params.cell_px)
        cone, periphery = params.cone, params.periphery
        self._weights = np.array(
            [offset_weights(reach, axis, cone, periphery) for axis in params.both_axes]
        )

    def reset(self) -> None:
        """Forget the frames that have passed."""
        super().reset()
        params = self._params
        self._kept = np.zeros((2, *self.maps.responses.shape), np.float32)
        self._moving = 0.0  # intervals
        # Times of frames add up with rounding: a hundredth of an interval decides no comparison.
        self._background = Background(
            params.adaptation_s * self._per_second + 0.01,
            params.adaptation_guard_s * self._per_second + 0.01,
        )

    def _answers_to(self, photoreceptors: Photoreceptors) -> bool:
        """Tell whether motion has lasted for long enough to be judged.

        With `history`, a rest of the complete scene is like the start of a video
        (``docs/time.md``).
        """
        return photoreceptors.motion_lasts if self._params.history else photoreceptors.ready

    def opponency(self, dpc: Dpc, reduction: int = 1) -> Maps:
        """Return R(c), outward minus inward opponency, of the unit at every cell.

        Parameters
        ----------
        dpc : Dpc
            S_phi of the working frame or of a smaller one. With `entering` they are set to 0 in
            place where motion may have come from outside.
        reduction : int
            Side of the working frame over that of the maps, at least 1.

        Returns
        -------
        ndarray of float32, shape (2, rows, columns)
            Two maps of ``max(0, out - w_p in)``, summed over both axes: first without cells where
            motion has only just begun (`history`), then of all cells, which the adaptation uses. S
            over several intervals is divided by their number.
        """
        params, photoreceptors = self._params, dpc.photoreceptors
        one, other = params.both_axes
        directions = one, other, one + 180, other + 180
        maps = [dpc.sums.pathways[phi] for phi in directions]
        if reduction not in self._pooling:
            weights = self._pooling_weights(maps[0].shape, reduction, self._bars)
            self._pooling[reduction] = weights
        down, across = self._pooling[reduction]
        if params.entering:
            reach, border = params.entering // reduction, max(1, params.border // reduction)
            bars = Widths(*(bar // reduction for bar in self._bars))
            leave_out_entering(maps, photoreceptors.maps[0], reach, border, bars)
        pooled = pool(maps, down, across)
        if photoreceptors.share != 1:
            p = pool(photoreceptors.maps[:1], down, across)
            e = np.float32(dpc.kernels.excitation.sum()) * p
            pooled = referred(pooled, e, photoreceptors.share, directional=True)
        if params.compression != 1:
            pooled **= params.compression
        everything = counted = self._outward(pooled)
        if params.history:
            known = has_history(photoreceptors.coarse(everything.shape), params.history)
            if not known.all():
                pooled *= known
                counted = self._outward(pooled)
        self.maps = self.maps._replace(pathways=dict(zip(directions, pooled, strict=True)))
        both = np.stack((counted, everything))
        if photoreceptors.stride != 1:
            both *= np.float32(photoreceptors.stride ** (-2 * params.compression))
        return both

    def _outward(self, pooled: Maps) -> Map:
        return np.asarray(np.maximum(opponent_products(pooled, self._weights), 0).sum(axis=0))

    def judge(
        self, dpc: Dpc, smaller: tuple[Dpc, int] | None = None, bars: Widths = NO_BARS
    ) -> OpplodResponse:
        """Judge the motion of one frame.

        Parameters
        ----------
        dpc : Dpc
            S_phi of the frame.
        smaller : tuple of Dpc and int, optional
            S_phi of the frame made smaller, and by how much. R in it is added with the weight
            `halved_weight`, once its motion has lasted.
        bars : Widths
            Bars beside the picture, in which S is set to 0, and in the `border` along them.

        Returns
        -------
        OpplodResponse
            Of the best unit; its response is ``c2 R^2``, 0 unless R is above T_o.
        """
        params, photoreceptors = self._params, dpc.photoreceptors
        if bars != self._bars:
            self._bars, self._pooling = bars, {}
        added = None
        if smaller and self._answers_to(smaller[0].photoreceptors):
            added = np.float32(params.halved_weight) * self.opponency(*smaller)
        both = np.zeros_like(self._kept)
        if self._answers_to(photoreceptors):
            both += self.opponency(dpc)
        elif added is None:
            self._kept[:] = 0  # as before the first response
        if added is not None:
            both += added
        if params.persistence:
            rows = -1, both.shape[-1]  # OpenCV takes maps of two dimensions
            # At low frame rates one picture counts for less than its full time, so that a single
            # chance response cannot pass.
            most = min(_MOST_ELAPSED, max(1.0, photoreceptors.usual_step))
            weight = 1 - params.persistence ** min(photoreceptors.elapsed, most)
            cv2.accumulateWeighted(both.reshape(rows), self._kept.reshape(rows), weight)
            both = self._kept.copy()
        both *= self._selected
        opponency, everything = both
        if params.adaptation_level:
            factor = self._adaptation(float(everything.max()), photoreceptors.elapsed)
            opponency *= np.float32(factor)
        responses = enhanced(opponency, params.gain, params.threshold)
        self.maps = self.maps._replace(responses=responses)
        row, column = divmod(int(opponency.argmax()), opponency.shape[1])
        best = float(opponency[row, column])
        response = params.gain * best**2 if best > params.threshold else 0.0
        return OpplodResponse(response, self.maps.box(row, column) if response else None, best)

    def _adaptation(self, best: float, elapsed: float) -> float:
        """Return the factor of R: 1, or less in a scene full of opponent motion.

        ``min(1, level / B)``, with B the background of the best unit's R (``docs/presets.md``).
        """
        if not best:  # a scene at rest is no background
            return 1.0
        self._moving += elapsed
        background = self._background.step(best, self._moving)
        return min(1.0, self._params.adaptation_level / background) if background else 1.0


# ---- The paper to the letter ---------------------------------------------------------------


class PixelwiseJudgement:
    """Products pixel by pixel in the receptive fields of a grid of units.

    Parameters
    ----------
    shape : tuple of int
        Height and width of the working frames.
    params : OpplodParams
        Resolved parameters with a grid of units.

    Attributes
    ----------
    maps : UnitMaps
        The units at the latest frame.
    """

    def __init__(self, shape: tuple[int, int], params: OpplodParams) -> None:
        self._params = params
        self._field = min(params.field_px, *shape)
        columns, rows = params.grid() or (1, 1)
        self.lefts = unit_starts(shape[1] - self._field, columns)
        self.tops = unit_starts(shape[0] - self._field, rows)
        self.maps = UnitMaps(
            np.zeros((rows, columns), np.float32),
            {},
            np.asarray(self.tops, np.float64) + self._field / 2,
            np.asarray(self.lefts, np.float64) + self._field / 2,
            float(self._field),
            0.0,
        )

    def reset(self) -> None:
        """Forget the latest frame, the only one that it remembers."""
        self.maps.responses[:] = 0

    def judge(self, dpc: Dpc) -> OpplodResponse:
        """Judge the motion of one frame.

        The response is the sum of S_E over all units, the place that of the unit with the largest
        S_E. S is multiplied by the reference interval over the actual one.
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
            # The products in the other order are the same ones, rotated by 180 degrees.
            s_enhanced += 2 * self._params.gain * float(selected @ selected)
            s_e += 2 * float(selected.sum())
        return s_enhanced, s_e
