"""``report.json``: every statement, measurement and verdict."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

from oppload_cli.environment import environment

if TYPE_CHECKING:
    from collections.abc import Sequence

    from oppload_cli.reproduction.claims import Built

SCHEMA = "oppload.reproduction/1"
PAPER = (
    "OppLoD: the Opponency based Looming Detector, Model Extension of Looming Sensitivity from "
    "LGMD to LPLC2"
)


def report_of(figures: Sequence[Built], wall_s: float) -> dict[str, Any]:
    """Gather the report.

    Parameters
    ----------
    figures : sequence of Built
        In the order of the page.
    wall_s : float
        How long it took, in seconds.

    Returns
    -------
    dict
        Ready for JSON.
    """
    return {
        "schema": SCHEMA,
        "paper": PAPER,
        "tool": environment(),
        "wall_s": round(wall_s, 1),
        "figures": [figure.as_dict() for figure in figures],
    }


def report_json(report: dict[str, Any]) -> str:
    """Return the report as text; what is not a number is null.

    Parameters
    ----------
    report : dict
        From :func:`report_of`.

    Returns
    -------
    str
    """
    return json.dumps(_finite(report), indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(one) for key, one in value.items()}
    if isinstance(value, list):
        return [_finite(one) for one in value]
    if isinstance(value, float) and value - value != 0:  # NaN or infinite
        return None
    return value
