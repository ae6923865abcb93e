"""Published angular thresholds and delays of neurons that respond to approaching objects.

A neuron whose response peaks a delay d after an object is seen under the angle A peaks
``(l/v) / tan(A / 2) - d`` before contact. The numbers stand in the texts of the papers or in a
program of their authors, so that their error is that of rounding. The response of the fly's giant
fibre to size alone, without the input of LC4 neurons, is excitation that is largest at an angle
and inhibition that comes later and is left out here; Ache et al. 2019 (Curr Biol 29:1073)
attribute this input to LPLC2 neurons.
"""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass
from functools import cache
from importlib import resources

FILE = "looming_peak_times.csv"


@dataclass(frozen=True)
class PublishedPeak:
    """One published threshold with its delay.

    Attributes
    ----------
    neuron : str
        Animal and neuron.
    kind : str
        ``lower limit`` or ``upper limit`` of a range over animals, or what was measured.
    angle_deg, delay_ms : float
        Angular threshold, and delay from it to the peak.
    error_deg, error_ms : float
        How far each may be off, because of its rounding.
    place, source : str
        Where in the source, and the source.
    """

    neuron: str
    kind: str
    angle_deg: float
    delay_ms: float
    error_deg: float
    error_ms: float
    place: str
    source: str

    @property
    def slope(self) -> float:
        """Time of the peak before contact over l/v, for large l/v."""
        return 1 / math.tan(math.radians(self.angle_deg / 2))


@cache
def published_peaks() -> tuple[PublishedPeak, ...]:
    """Return all published thresholds, in the order of the file."""
    text = resources.files("oppload_cli.reference").joinpath(FILE).read_text(encoding="utf-8")
    return tuple(
        PublishedPeak(
            neuron=row["neuron"],
            kind=row["kind"],
            angle_deg=float(row["angle_deg"]),
            delay_ms=float(row["delay_ms"]),
            error_deg=float(row["error_deg"]),
            error_ms=float(row["error_ms"]),
            place=row["place"],
            source=row["source"],
        )
        for row in csv.DictReader(text.splitlines())
    )
