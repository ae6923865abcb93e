"""Which swept parameter is a direction."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable

DIRECTIONS = ("axis_deg", "rotation_deg", "direction_deg")


def direction_of(parameters: Iterable[str]) -> str | None:
    """Return the parameter that is an axis or a direction, if there is one.

    Parameters
    ----------
    parameters : iterable of str
        Dotted keys such as ``bar.axis_deg``.

    Returns
    -------
    str or None
    """
    return next((key for key in parameters if key.rpartition(".")[2] in DIRECTIONS), None)
