"""The units of OppLoD: cells of the frame that pool the motion about them.

All OppLoD detectors but ``opplod_paper`` have a unit at every cell (``docs/model.md``, section 5).
They pool S_phi over the cells, so that the two sides of an object need not match pixel by pixel.
"""

from __future__ import annotations

import math
import re
from copy import deepcopy
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Self

import cv2
import numpy as np

from oppload_cli.compute.loops import with_twin
from oppload_cli.errors import ParameterError
from oppload_cli.models.detector import Detector, UnitMaps
from oppload_cli.models.dpc import DpcParams
from oppload_cli.schema import parameter

if TYPE_CHECKING:
    from collections.abc import Sequence
    from typing import Any

    from numpy.typing import NDArray

    from oppload_cli.models.dpc import Map
    from oppload_cli.models.layers import Dpc, SharedLayer

    Floats = NDArray[np.float64]
    Maps = NDArray[np.float32]  # several maps of cells, as one array


_NEIGHBOURS, _WITHIN_6 = np.ones((3, 3), np.uint8), np.ones((13, 13), np.uint8)
_POOLED_SIGMAS = 5  # reach of pooling in sigmas: pixels further away weigh less than a millionth
_LEAST_SIGMA = 0.01  # cells; with a smaller sigma no cell is pooled with its neighbours


@dataclass(frozen=True, kw_only=True)
class UnitParams(DpcParams):
    """DPC constants, and the parameters of the cells and units."""

    # Sides of the receptive field and of a cell as shares of the working height, if left to auto.
    _field_share: ClassVar[float] = 5 / 12
    _cell_share: ClassVar[float] = 1 / 30

    receptive_field: int | None = parameter(
        None,
        "side of a unit's square receptive field; auto: 5/12 of the working height, in "
        "opplod_lplc2 5/6",
        unit="px",
        low=2,
        high=8192,
    )
    cell: int | None = parameter(
        None,
        "side of a cell, and spacing of the cells; auto: 1/30 of the working height, in "
        "opplod_lplc2 11/240",
        unit="px",
        low=1,
        high=1024,
    )
    units: str = parameter("every", "grid of units such as 5x5 (columns x rows), or 'every' cell")
    pool_sigma: float = parameter(
        1.5, "sigma of the pooling over cells; 0: no pooling", unit="cells", low=0, high=10
    )
    history: float = parameter(
        0.125,
        "S of a cell counts only if the change near the cell was, both one and two intervals ago, "
        "at least this share of the present change; a smaller change means that motion has only "
        "just begun; 0: S always counts",
        low=0,
        high=1,
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.units != "every":
            check_grid(self._label("units"), self.units, ", or 'every'")
        if 0 < self.pool_sigma < _LEAST_SIGMA:
            raise ParameterError(
                f"{self._label('pool_sigma')} must be 0 or at least {_LEAST_SIGMA:g}, "
                f"not {self.pool_sigma:g}"
            )

    def resolved(self, height: int) -> Self:
        """Return these parameters with the values that depend on the working height filled in.

        If `receptive_field` and `cell` are None they become shares of the working height, at least
        2 and 1 px: 100 and 8 px at 240 px.
        """
        return self.replaced(
            receptive_field=self.receptive_field
            or max(2, min(8192, round(height * self._field_share))),
            cell=self.cell or max(1, min(1024, round(height * self._cell_share))),
        )

    @property
    def cell_px(self) -> int:
        """`cell` of resolved parameters; a ParameterError if it is still None."""
        return self._in_px("cell")

    @property
    def field_px(self) -> int:
        """`receptive_field` of resolved parameters; a ParameterError if it is still None."""
        return self._in_px("receptive_field")

    def _in_px(self, name: str) -> int:
        value: int | None = getattr(self, name)
        if value is None:
            raise ParameterError(
                f"{self._label(name)} depends on the working height; call resolved(height)"
            )
        return value

    @property
    def grid(self) -> tuple[int, int] | None:
        """The grid of units as (columns, rows); None if every cell is a unit."""
        return None if self.units == "every" else grid_of(self.units)


def check_grid(label: str, text: str, or_word: str = "") -> None:
    """Raise a ParameterError unless a text is a grid of units such as ``5x5``."""
    if not re.fullmatch(r"[1-9]\d{0,2}x[1-9]\d{0,2}", text):
        raise ParameterError(f"{label} must be columns x rows such as 5x5{or_word}, not '{text}'")


def grid_of(text: str) -> tuple[int, int]:
    """Return the columns and rows of a grid such as ``5x5``."""
    columns, rows = text.split("x")
    return int(columns), int(rows)


# ---- Cells and pooling ---------------------------------------------------------------------


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
        return np.asarray([down @ layer @ across.T for layer in maps], np.float32)


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
    history = np.minimum(*(cv2.dilate(change, _WITHIN_6) for change in before))
    return np.asarray(history >= needed)


def unit_starts(last: int, count: int) -> list[int]:
    """Return the first pixels of the receptive fields of `count` units, evenly from 0 to `last`.

    `last`, in pixels, is the side of the frame minus the side of a field. A single unit is centred.
    """
    if count == 1:
        return [last // 2]
    return [round(index * last / (count - 1)) for index in range(count)]


# ---- Units over one video ------------------------------------------------------------------


class Units:
    """The units of a detector whose units are cells of the frame.

    Parameters
    ----------
    shape : tuple of int
        Height and width of the working frames.
    params : UnitParams
        Resolved parameters.

    Attributes
    ----------
    maps : UnitMaps
        The responses of all cells to the latest frame; 0 at cells that are no units.
    selected : ndarray of float32, shape (rows, columns)
        1 at the cells that are units, and 0 elsewhere.
    """

    def __init__(self, shape: tuple[int, int], params: UnitParams) -> None:
        cell, columns_rows = params.cell_px, params.grid or (None, None)
        y, x = (
            cell_centres(side, cell, count)
            for side, count in zip(shape, columns_rows[::-1], strict=True)
        )
        zeros = np.zeros((len(y), len(x)), np.float32)
        self.maps = UnitMaps(zeros, y, x, float(params.field_px))
        self.selected = self._selected(shape, params.grid)
        sigma = params.pool_sigma * cell
        self._down = pooling_weights(shape[0], y, sigma)
        self._across = pooling_weights(shape[1], x, sigma)

    def _selected(self, shape: tuple[int, int], grid: tuple[int, int] | None) -> Map:
        maps = self.maps
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
        """Forget the responses."""
        self.maps = self.maps._replace(responses=np.zeros_like(self.maps.responses))

    def pool(self, maps: Sequence[Map]) -> Maps:
        """Pool maps of the frame over the cells; arrays as for :func:`pool`."""
        return pool(maps, self._down, self._across)

    def respond(self, responses: Map) -> None:
        """Set the responses of all units to the latest frame."""
        self.maps = self.maps._replace(responses=responses)


class CellDetector(Detector):
    """Base of the detectors with units at cells; a subclass sets `_dpc` and defines `step`."""

    params: UnitParams
    places = True
    interpolates = True
    warm_up = 3  # S needs P now, one and two intervals ago

    _dpc: SharedLayer[Dpc]

    def __init__(
        self, shape: tuple[int, int], params: UnitParams | None = None, **others: Any
    ) -> None:
        super().__init__(shape, params, **others)
        self._units = Units(self.shape, self.params)

    def separate(self) -> None:
        """Replace shared layers by copies of its own."""
        clock = self.layers.clock
        self._dpc = deepcopy(self._dpc, {id(clock): clock})  # all layers keep the same clock

    @property
    def units(self) -> UnitMaps:
        """The units at the latest frame."""
        return self._units.maps

    @property
    def maps(self) -> dict[str, Map]:
        """P, E, I, S and S_phi (``S_45`` ...) of the latest frame, shape (height, width)."""
        return self._dpc.layer.maps

    def reset(self) -> None:
        """Forget all frames: the next frame is frame 0."""
        self._dpc.reset()
        self._units.reset()
