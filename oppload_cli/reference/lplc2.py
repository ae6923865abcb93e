"""Response peaks of LPLC2 neurons.

Klapoetke et al. 2017, *Ultra-selective looming detection from radial motion
opponency*, Nature 551, 237; digitised from the replot in Zhou et al. 2022, *Shallow
neural networks trained to detect collisions recover features of visual
loom-selective neurons*, eLife 11, e72067. Error about 0.01. The looming disk (radius
10 to 30 degrees at 10 degrees/s) is 1.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass
from functools import cache
from importlib import resources

FILE = "lplc2_klapoetke2017.csv"
SOURCE = "Klapoetke et al. 2017, digitised from the replot in Zhou et al. 2022; error about 0.01"
BAR_WIDTHS = (10, 60)
# Bars that grow at both ends give 0.23 of the loom, at one end 0.05 to 0.08 (error 0.01 each).
BOTH_ENDS_OVER_ONE = (0.23 / 0.08, 0.23 / 0.05)


@dataclass(frozen=True)
class _Peak:
    """One response peak.

    Attributes
    ----------
    stimulus : str
        E.g. ``bar_expand``.
    axis_deg : float or None
        Axis or direction of the stimulus, counter-clockwise, 0 = right.
    width_deg : float or None
        Width of the bar.
    relative : float
        Peak relative to that of the looming disk.
    """

    stimulus: str
    axis_deg: float | None
    width_deg: float | None
    relative: float


@cache
def peaks() -> tuple[_Peak, ...]:
    """Return all published peaks."""
    text = resources.files("oppload_cli.reference").joinpath(FILE).read_text(encoding="utf-8")
    return tuple(
        _Peak(
            row["stimulus"],
            float(row["axis_deg"]) if row["axis_deg"] else None,
            float(row["width_deg"]) if row["width_deg"] else None,
            float(row["peak_relative_to_loom"]),
        )
        for row in csv.DictReader(text.splitlines())
    )


def bar_tuning(width_deg: float) -> dict[float, float]:
    """Return the tuning to an expanding bar over its axis.

    Parameters
    ----------
    width_deg : float
        10 or 60.

    Returns
    -------
    dict of float to float
        Relative peak by axis in degrees, 0 to 180, in rising order; both ends of the
        bar grow, so that axis + 180 is the same. Empty for any other width.
    """
    found = {
        peak.axis_deg: peak.relative
        for peak in peaks()
        if peak.stimulus == "bar_expand" and peak.width_deg == width_deg
        if peak.axis_deg is not None
    }
    return dict(sorted(found.items()))
