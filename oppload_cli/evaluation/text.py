"""Figures and names as the page of an evaluation shows them."""

from __future__ import annotations

import math
from html import escape
from typing import TYPE_CHECKING, Any

from oppload_cli.evaluation.definitions import displayed

if TYPE_CHECKING:
    from collections.abc import Mapping

NOTHING = "\N{EN DASH}"


def number(value: float | None) -> str:
    """Return a figure as the page shows it.

    Parameters
    ----------
    value : float or None
        None, and what is not a number, is a dash.

    Returns
    -------
    str
        Two significant digits below 1, three above.
    """
    if value is None or math.isnan(value):
        return NOTHING
    if math.isinf(value):
        return "∞"
    if abs(value) >= 99.95:
        return f"{value:.0f}"
    return f"{value:.3g}" if abs(value) >= 0.995 else f"{value:.2g}"


def cell(figure: Mapping[str, Any], *, counted: bool = False) -> str:
    """Return a figure with its interval, as HTML.

    Parameters
    ----------
    figure : mapping
        One of the report's.
    counted : bool
        Whether n is shown.

    Returns
    -------
    str
        A table's cell.
    """
    value = f'<span class="value">{number(figure["value"])}</span>'
    low, high = number(figure["low"]), number(figure["high"])
    parts = [] if low == high == NOTHING else [f"{low} to {high}"]
    parts += [f"n {figure['n']}"] if counted else []
    return f'<td>{value} <span class="spread">{", ".join(parts)}</span></td>'


def duration(minutes: float) -> str:
    """Return a duration with its unit.

    Parameters
    ----------
    minutes : float
        In minutes.

    Returns
    -------
    str
        In seconds if it is short.
    """
    return f"{number(minutes)} minutes" if minutes >= 1.5 else f"{number(60 * minutes)} s"


def named(contender: str) -> str:
    """Return what a reader sees for a contender, as HTML.

    Parameters
    ----------
    contender : str
        Its name.

    Returns
    -------
    str
    """
    return escape(displayed(contender))


def marked_up(text: str) -> str:
    """Return a text as HTML, with what stands in back quotes as code.

    Parameters
    ----------
    text : str
        Plain.

    Returns
    -------
    str
    """
    parts = escape(text).split("`")
    return "".join(f"<code>{part}</code>" if at % 2 else part for at, part in enumerate(parts))
