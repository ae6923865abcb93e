"""Published measurements of neurons that respond to approaching objects.

Response peaks of LPLC2 neurons: Klapoetke et al. 2017, *Ultra-selective looming detection from
radial motion opponency*, Nature 551, 237; digitised from the replot in Zhou et al. 2022, *Shallow
neural networks trained to detect collisions recover features of visual loom-selective neurons*,
eLife 11, e72067. Error about 0.01. The looming disk (radius 10 to 30 degrees at 10 degrees/s)
is 1.

Angular thresholds and delays: a neuron whose response peaks a delay d after an object is seen
under the angle A peaks ``(l/v) / tan(A / 2) - d`` before contact. The numbers stand in the texts
of the papers or in a program of their authors, so that their error is that of rounding. The fly's
giant fibre has an input that depends on the size alone, besides the input of LC4 neurons. Its
excitation is largest at a certain angle; its inhibition comes later and is left out here. Ache et
al. 2019 (Curr Biol 29:1073) attribute this input to LPLC2 neurons.
"""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass
from functools import cache
from importlib import resources
from operator import itemgetter

SOURCE = "Klapoetke et al. 2017, digitised from the replot in Zhou et al. 2022; error about 0.01"
BAR_WIDTHS = (10, 60)
# Bars that grow at both ends give 0.23 of the loom, at one end 0.05 to 0.08 (error 0.01 each).
BOTH_ENDS_OVER_ONE = (0.23 / 0.08, 0.23 / 0.05)


@dataclass(frozen=True)
class _PublishedPeak:
    """One response peak."""

    stimulus: str  # such as ``bar_expand``
    axis_deg: float | None  # axis or direction of the stimulus, counter-clockwise, 0 = right
    width_deg: float | None  # of the bar
    relative: float  # to the peak for the looming disk


@cache
def lplc2_peaks() -> tuple[_PublishedPeak, ...]:
    """Return the peaks of LPLC2 neurons, in the order of the file."""

    def number(cell: str) -> float | None:
        return float(cell) if cell else None

    return tuple(
        _PublishedPeak(stimulus, number(axis_deg), number(width_deg), float(relative))
        for stimulus, axis_deg, width_deg, relative in _cells(
            "lplc2_klapoetke2017.csv", "stimulus", "axis_deg", "width_deg", "peak_relative_to_loom"
        )
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
    peaks = {
        peak.axis_deg: peak.relative
        for peak in lplc2_peaks()
        if peak.stimulus == "bar_expand" and peak.width_deg == width_deg
        if peak.axis_deg is not None
    }
    return dict(sorted(peaks.items()))


@dataclass(frozen=True)
class AngularThreshold:
    """The angular threshold of one neuron, with its delay."""

    neuron: str  # animal and neuron
    kind: str  # ``lower limit`` or ``upper limit`` of a range over animals, or what was measured
    angle_deg: float
    delay_ms: float  # from the threshold to the peak
    source: str

    @property
    def slope(self) -> float:
        """Time of the peak before contact over l/v, for large l/v."""
        return 1 / math.tan(math.radians(self.angle_deg / 2))


@cache
def angular_thresholds() -> tuple[AngularThreshold, ...]:
    """Return all published thresholds, in the order of the file."""
    return tuple(
        AngularThreshold(neuron, kind, float(angle_deg), float(delay_ms), source)
        for neuron, kind, angle_deg, delay_ms, source in _cells(
            "looming_peak_times.csv", "neuron", "kind", "angle_deg", "delay_ms", "source"
        )
    )


def _cells(file: str, *columns: str) -> list[tuple[str, ...]]:
    """Return the cells of some columns of a table in this package, row by row."""
    text = resources.files(__package__).joinpath(file).read_text(encoding="utf-8")
    return list(map(itemgetter(*columns), csv.DictReader(text.splitlines())))
