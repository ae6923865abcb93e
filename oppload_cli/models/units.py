"""The units of OppLoD: where they are, and what they saw in a frame."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Mapping

    from oppload_cli.models.kernels import Map
    from oppload_cli.models.parameters import OpplodParams
    from oppload_cli.models.pooling import Floats


class UnitMaps(NamedTuple):
    """What a judge saw in the latest frame, by unit: views that the next frame overwrites.

    Attributes
    ----------
    responses : ndarray of float32, shape (rows, columns)
        The enhanced response of every unit, at least 0.
    pathways : mapping of int to ndarray of float32, shape (rows, columns)
        The pooled S_phi at the units, by direction phi in degrees; empty where
        products are not pooled.
    centres_y, centres_x : ndarray, shapes (rows,) and (columns,)
        Centres of the units in working pixels.
    field : float
        Side of a unit's receptive field in working pixels.
    spread : float
        Sigma in working pixels of the pooled S of a thin edge.
    """

    responses: Map
    pathways: Mapping[int, Map]
    centres_y: Floats
    centres_x: Floats
    field: float
    spread: float


def evenly(room: int, count: int) -> list[int]:
    """Return starts that are evenly spread.

    Parameters
    ----------
    room : int
        Side of the frame less that of a field, in pixels.
    count : int
        How many fields there are, at least 1.

    Returns
    -------
    list of int
        In pixels, the first 0 and the last `room`; the middle for one field.
    """
    if count == 1:
        return [room // 2]
    return [round(index * room / (count - 1)) for index in range(count)]


def selected_units(
    shape: tuple[int, int], centres_y: Floats, centres_x: Floats, params: OpplodParams
) -> Map:
    """Choose the cells that are units.

    Parameters
    ----------
    shape : tuple of int
        Height and width of the working frames.
    centres_y, centres_x : ndarray, shapes (rows,) and (columns,)
        Centres of the cells in working pixels.
    params : OpplodParams
        Resolved parameters; gives the grid of units.

    Returns
    -------
    ndarray of float32, shape (rows, columns)
        1 at the cells that are units, 0 elsewhere.
    """
    selected = np.ones((len(centres_y), len(centres_x)), np.float32)
    grid = params.grid()
    if grid is not None:
        field = min(params.receptive_field or 0, *shape)
        columns = _nearest(centres_x, evenly(shape[1] - field, grid[0]), field)
        rows = _nearest(centres_y, evenly(shape[0] - field, grid[1]), field)
        selected[:] = 0
        selected[np.ix_(rows, columns)] = 1
    return selected


def _nearest(centres: Floats, starts: list[int], field: int) -> list[int]:
    return [int(np.abs(centres - (start + field / 2)).argmin()) for start in starts]
