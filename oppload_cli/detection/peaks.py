"""The units where objects loom: peaks of the responses over all units."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import cv2
import numpy as np

if TYPE_CHECKING:
    from oppload_cli.detection.parameters import PlaceParams
    from oppload_cli.models.kernels import Map
    from oppload_cli.models.pooling import Floats
    from oppload_cli.models.units import UnitMaps

NEIGHBOURS = np.ones((3, 3), np.uint8)


class Peak(NamedTuple):
    """A unit that answers more than those around it."""

    row: int
    column: int
    response: float


def peaks(maps: UnitMaps, params: PlaceParams) -> list[Peak]:
    """Find the units that answer more than every other one in their receptive field.

    Parameters
    ----------
    maps : UnitMaps
        Of the frame.
    params : PlaceParams
        Their floor, share and number.

    Returns
    -------
    list of Peak
        The largest response first: the winning unit of the frame, if it is above
        the floor. None lies in the receptive field of one before it.
    """
    responses = maps.responses
    largest = float(responses.max())
    least = max(params.floor, params.share * largest)
    if largest == 0 or largest < least:
        return []
    tops = (responses >= cv2.dilate(responses, NEIGHBOURS)) & (responses >= least) & (responses > 0)
    rows, columns = np.nonzero(tops)
    order = np.argsort(-responses[rows, columns], kind="stable")
    found: list[Peak] = []
    for row, column in zip(rows[order].tolist(), columns[order].tolist(), strict=True):
        if len(found) == params.most:
            break
        if not any(_shares_field(maps, row, column, each) for each in found):
            found.append(Peak(row, column, float(responses[row, column])))
    return found


def focus(maps: UnitMaps, row: int, column: int) -> tuple[float, float]:
    """Refine a peak to less than a cell: the top of a parabola through log R.

    Parameters
    ----------
    maps : UnitMaps
        Of the frame.
    row, column : int
        The peak.

    Returns
    -------
    tuple of float
        (x, y) in working pixels; within half a cell of the unit.
    """
    x = _top(maps.responses[row], maps.centres_x, column)
    y = _top(maps.responses[:, column], maps.centres_y, row)
    return x, y


def _shares_field(maps: UnitMaps, row: int, column: int, peak: Peak) -> bool:
    apart_x = abs(maps.centres_x[column] - maps.centres_x[peak.column])
    apart_y = abs(maps.centres_y[row] - maps.centres_y[peak.row])
    return bool(max(apart_x, apart_y) < maps.field / 2)


def _top(values: Map, centres: Floats, index: int) -> float:
    here = float(centres[index])
    if not 0 < index < len(centres) - 1 or not (values[index - 1 : index + 2] > 0).all():
        return here
    before, top, after = np.log(values[index - 1 : index + 2].astype(np.float64))
    bend = before - 2 * top + after
    if bend >= 0:
        return here
    shift = min(0.5, max(-0.5, 0.5 * float((before - after) / bend)))
    return here + shift * float(centres[1] - centres[0])
