"""What the units of OppLoD saw in a frame, for those who look for objects in it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping

    from oppload_cli.models.kernels import Map
    from oppload_cli.models.pooling import Floats


@dataclass(frozen=True)
class UnitMaps:
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
