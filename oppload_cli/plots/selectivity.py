"""Numbers of a directional tuning."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Series = NDArray[np.float64]


@dataclass(frozen=True)
class Selectivity:
    """How strongly responses depend on direction (``docs/plots.md``).

    Attributes
    ----------
    peak : float
        Largest response.
    preferred_deg : float
        Its direction.
    direction_index : float or None
        (R_p - R_o) / (R_p + R_o), with R_o the response to the opposite direction;
        None where that was not shown or nothing responded.
    axis_index : float or None
        |sum R exp(2 i theta)| / sum R: 1 for one axis, 0 for none; None where nothing
        responded.
    least : float
        Smallest response over the largest.
    """

    peak: float
    preferred_deg: float
    direction_index: float | None
    axis_index: float | None
    least: float


def selectivity(angles_deg: Series, responses: Series) -> Selectivity:
    """Measure directional tuning.

    Parameters
    ----------
    angles_deg : ndarray, shape (n,)
        Directions, evenly spread over the circle or a half of it.
    responses : ndarray, shape (n,)
        At least 0.

    Returns
    -------
    Selectivity
    """
    best = int(responses.argmax())
    peak, preferred = float(responses[best]), float(angles_deg[best])
    if peak <= 0:
        return Selectivity(peak, preferred, None, None, 0.0)
    turned = (angles_deg - preferred) % 360
    opposite = np.flatnonzero(np.abs(turned - 180) < 1e-6)
    index = None
    if opposite.size:
        other = float(responses[opposite[0]])
        index = (peak - other) / (peak + other)
    least = float(responses.min()) / peak
    vector = np.sum(responses * np.exp(2j * np.deg2rad(angles_deg)))
    return Selectivity(peak, preferred, index, float(abs(vector) / responses.sum()), least)


def whole_circle(angles_deg: Series, responses: Series) -> tuple[Series, Series]:
    """Repeat a half circle of directions half a turn on.

    Parameters
    ----------
    angles_deg, responses : ndarray, shape (n,)
        Of a stimulus that half a turn does not change.

    Returns
    -------
    angles_deg, responses : ndarray
        Each direction once, in rising order, 0 to 360.
    """
    angles = np.concatenate([angles_deg % 360, (angles_deg + 180) % 360])
    values = np.concatenate([responses, responses])
    _, first = np.unique(np.round(angles, 6), return_index=True)
    return angles[first], values[first]
