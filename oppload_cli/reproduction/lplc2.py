"""The stimuli of an LPLC2 study: detectors compared with neurons (``docs/lplc2.md``)."""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING, NamedTuple, cast

import numpy as np

from oppload_cli.models.opplod_lplc2 import OpplodLplc2, OpplodLplc2Params
from oppload_cli.plots.style import CYCLE, FAINT, LPLC2, styled_figure
from oppload_cli.reference import SOURCE, lplc2_peaks
from oppload_cli.reproduction.bars import draw_beside_neurons
from oppload_cli.reproduction.claims import (
    NO_RESPONSE,
    PAPER,
    REFERENCE,
    WIDE,
    Built,
    Claim,
    ClaimVerdict,
    Finding,
    described_settings,
    settings_of,
)
from oppload_cli.stimulus.catalogue import load_all
from oppload_cli.tuning.present import present

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.projections.polar import PolarAxes
    from numpy.typing import NDArray

    from oppload_cli.pipeline.settings import Settings
    from oppload_cli.stimulus.protocol import Protocol

    Series = NDArray[np.float64]

_FITTED = OpplodLplc2.name
_DETECTORS = _FITTED, REFERENCE, PAPER, "mlplc2", "emd_lplc2_gf", "zhou_lrf"
_ASSIGNMENTS = {
    f"{_FITTED}.units": "1x1",
    f"{REFERENCE}.units": "1x1",
    f"{REFERENCE}.receptive_field": 200,  # 60 degrees, as that of opplod_lplc2
}


class _Family(NamedTuple):
    """Stimuli of the catalogue that differ only in their axis."""

    name: str  # in the catalogue, without the folder
    width_deg: int | None = None  # of the bars
    published: str = ""  # name in the table of published peaks; empty if none were published


LOOM = "loom"
BATTERY = (
    _Family(LOOM, None, "loom"),
    *(_Family(f"bar-expand-{width}", width, "bar_expand") for width in (10, 20, 60)),
    *(_Family(f"bar-expand-{width}-one-end", width) for width in (10, 20, 60)),
    _Family("bar-expand-inward-corners", 10),
    _Family("bar-expand-inward-periphery", 10),
    _Family("cross-outward", 10, "cross_outward"),
    _Family("cross-inward", 10, "cross_inward"),
    _Family("bar-sweep", 10, "bar_sweep"),
    _Family("edge", None, "edge"),
    _Family("grating", None, "grating"),
)
_NAMED_DIRECTIONS = "right", "down"  # ends of published names; the table also has the axis


class Row(NamedTuple):
    """A row of ``lplc2.csv``: the peak of one detector for one stimulus."""

    stimulus: str
    axis_deg: float | None
    width_deg: int | None
    detector: str
    peak_over_loom: float
    published: float | None


class _Shown(NamedTuple):
    """The responses of one detector, in the order of the stimuli."""

    rows: tuple[Row, ...]
    # Times in s and calcium signals divided by the peak for the loom, by stimulus, for a figure.
    courses: dict[str, tuple[Series, Series]]


def axis_of(name: str) -> float | None:
    """Return the axis in degrees at the end of a stimulus's name; None without an axis."""
    end = name.rpartition("/")[2].rpartition("-")[2]
    return float(end) if end.isdigit() else None


def _published() -> dict[tuple[str, float | None], float]:
    """Return the published peaks divided by that for the loom, by stimulus and axis."""
    published = {}
    for peak in lplc2_peaks():
        kind, _, word = peak.stimulus.rpartition("_")
        name = kind if word in _NAMED_DIRECTIONS else peak.stimulus
        for family in BATTERY:
            same_width = name != "bar_expand" or family.width_deg == peak.width_deg
            if family.published == name and same_width:
                published[family.name, peak.axis_deg] = peak.relative
    return published


def show(name: str, families: Iterable[_Family] = BATTERY) -> _Shown:
    """Show stimuli of the battery to a detector.

    Parameters
    ----------
    name : str
        Name of the detector, such as ``opplod_lplc2``.
    families : iterable of _Family
        The families to show; the loom must be one of them.

    Returns
    -------
    _Shown
        The peaks of the calcium signal, divided by the peak for the loom. The calcium signal always
        has the time constant of ``opplod_lplc2``.
    """
    settings = settings_of(name, _ASSIGNMENTS)
    signals = {
        (family, axis_of(protocol.name)): _signal(protocol, settings)
        for family in families
        for protocol in load_all(f"klapoetke2017/{family.name}")
    }
    loom = next(
        float(signal.max()) for (family, _), (_, signal) in signals.items() if family.name == LOOM
    )
    known = _published()
    rows = tuple(
        Row(
            family.name, axis, family.width_deg, name,
            float(signal.max()) / loom if loom > 0 else math.nan,
            known.get((family.name, axis)),
        )
        for (family, axis), (_, signal) in signals.items()
    )  # fmt: skip
    courses = {
        f"{family.name} {axis:g} deg" if axis else family.name: (time, signal / loom)
        for (family, axis), (time, signal) in signals.items()
        if loom > 0 and axis in {None, 0, 45}
    }
    return _Shown(rows, courses)


def _signal(protocol: Protocol, settings: Settings) -> tuple[Series, Series]:
    """Return times in s and the calcium signal of the only detector in the settings."""
    indicator_s = OpplodLplc2Params().calcium_s
    (responses,) = present(protocol, settings, indicator_s=indicator_s).values()
    return responses.time_s, np.nan_to_num(responses.response)


def phenomena(rows: Sequence[Row]) -> dict[str, tuple[float, float, float]]:
    """Return ratios of peaks by name, each with its least and largest value in LPLC2 neurons.

    ``docs/lplc2.md`` explains the ratios and the values in neurons.
    """
    peak = {(row.stimulus, row.axis_deg): row.peak_over_loom for row in rows}

    def over(one: str, other: str, axes: Iterable[int]) -> list[float]:
        return [_ratio(peak[one, axis], peak[other, axis]) for axis in axes]

    axes = range(0, 180, 15)
    ends = [
        ratio
        for width in (10, 20, 60)
        for ratio in over(f"bar-expand-{width}", f"bar-expand-{width}-one-end", range(0, 180, 30))
    ]
    bars = [peak["bar-expand-10", axis] for axis in axes]
    wide = [peak["bar-expand-60", axis] for axis in (0, 15, 30, 45)]
    steps = [_ratio(after, before) for before, after in itertools.pairwise(wide)]
    fields = [
        peak[name, axis] for name in ("bar-sweep", "edge", "grating") for axis in range(0, 360, 45)
    ]
    corners = over("bar-expand-inward-corners", "bar-expand-10", axes)
    periphery = over("bar-expand-inward-periphery", "bar-expand-10", axes)
    return {  # unlike min and max, np.min and np.max give NaN if any value is NaN
        "both ends over one end, least": (np.min(ends), 2.5, math.inf),
        "outward cross": (peak["cross-outward", None], 0.35, 0.6),
        "inward cross": (peak["cross-inward", None], 0, 0.05),
        "inward corners over the bar, largest": (np.max(corners), 0, 0.4),
        "inward periphery over the bar, largest": (np.max(periphery), 0, 0.4),
        "60 deg bar, diagonal over cardinal": (_ratio(wide[3], wide[0]), 0, 1 / 3),
        "60 deg bar, largest step up towards the diagonal": (np.max(steps), 0, 1),
        "10 deg bar, least over largest": (_ratio(np.min(bars), np.max(bars)), 0.8, 1),
        "sweeps, edges, gratings, least": (np.min(fields), 0.01, 0.12),
        "sweeps, edges, gratings, largest": (np.max(fields), 0.01, 0.12),
    }


def _ratio(one: float, other: float) -> float:
    """Return the ratio of two peaks; NaN, which is in no range, if both are 0 or one is NaN."""
    if other > 0:
        return one / other
    return math.inf if one > 0 and other == 0 else math.nan


def battery() -> Built:
    """Show the complete battery to three versions of OppLoD and to the other LPLC2 models."""
    shown = {name: show(name) for name in _DETECTORS}
    claims = (
        Claim.of("battery-peaks", {name: _alike(own.rows) for name, own in shown.items()}),
        Claim.of("battery-effects", {name: _effects(own.rows) for name, own in shown.items()}),
    )
    return Built.of(
        "lplc2",
        claims,
        _draw(shown),
        (row._asdict() for own in shown.values() for row in own.rows),
        settings={name: described_settings(settings_of(name, _ASSIGNMENTS)) for name in shown},
        source=SOURCE,
        ranges=_ranges(shown[_FITTED].rows),
    )


def _ranges(rows: Sequence[Row]) -> str:
    """Return in words the ranges of the ratios of peaks in LPLC2 neurons."""
    return "; ".join(
        f"{name}: at least {low:.2g}" if math.isinf(high) else f"{name}: {low:.2g} to {high:.2g}"
        for name, (_, low, high) in phenomena(rows).items()
    )


def _alike(rows: Sequence[Row]) -> Finding:
    """Compare the peaks with published ones: r without the loom, rms difference with the loom."""
    known = [row for row in rows if row.published is not None]
    model, neurons = np.array([(row.peak_over_loom, row.published) for row in known], float).T
    others = np.array([row.stimulus != LOOM for row in known])
    rms = float(np.sqrt(np.mean((model - neurons) ** 2)))
    if math.isnan(rms):
        r, text = math.nan, NO_RESPONSE
    elif np.ptp(model[others]) == 0:  # r of equal values is not defined
        r, text = math.nan, f"All peaks are equal: no r; rms {rms:.3g}."
    else:
        r = float(np.corrcoef(model[others], neurons[others])[0, 1])
        text = f"r {r:.3f}, rms {rms:.3g}."
    verdict = ClaimVerdict.DOES_NOT
    if r >= 0.5 and rms <= 0.25:
        verdict = ClaimVerdict.HOLDS if r >= 0.95 and rms <= 0.08 else ClaimVerdict.IN_PART
    return Finding(text, verdict, {"r": r, "rms": rms})


def _effects(rows: Sequence[Row]) -> Finding:
    ratios = phenomena(rows)
    in_range = [low <= value <= high for value, low, high in ratios.values()]
    parts = "; ".join(f"{name}: {_in_words(value)}" for name, (value, _, _) in ratios.items())
    return Finding(
        f"{sum(in_range)} of {len(in_range)}. {parts}.",
        ClaimVerdict.at_least(sum(in_range) / len(in_range), 1, 0.5),
        {name: value for name, (value, _, _) in ratios.items()},
    )


def _in_words(value: float) -> str:
    """Return the text of a ratio of peaks, which may be NaN or infinite."""
    if math.isnan(value):
        return "no response to compare"
    if math.isinf(value):
        return "infinite, because the second stimulus gives no response"
    return f"{value:.2g}"


def _draw(shown: Mapping[str, _Shown]) -> Figure:
    with styled_figure(WIDE, 7.4) as figure:
        grid = figure.add_gridspec(2, 2, height_ratios=(1, 1.05))
        for column, width in enumerate((10, 60)):
            curves = {
                name: {
                    row.axis_deg: row.peak_over_loom
                    for row in shown[name].rows
                    if row.stimulus == f"bar-expand-{width}"
                }
                for name in (_FITTED, REFERENCE)
            }
            panel = figure.add_subplot(grid[0, column], projection="polar")
            draw_beside_neurons(cast("PolarAxes", panel), width, curves, "of the loom")
        _others(figure.add_subplot(grid[1, 0]), shown[_FITTED].rows)
        _courses(figure.add_subplot(grid[1, 1]), shown[_FITTED])
    return figure


def _others(axes: Axes, rows: Sequence[Row]) -> None:
    other = [
        row for row in rows
        if row.published is not None and not row.stimulus.startswith(("bar-expand", LOOM))
    ]  # fmt: skip
    place = np.arange(len(other))
    # The axis is inverted below, so that the bars have the order of the legend.
    axes.barh(place - 0.2, [row.peak_over_loom for row in other], 0.4, color=CYCLE[0],
              label=_FITTED)  # fmt: skip
    axes.barh(place + 0.2, [row.published or 0 for row in other], 0.4, color=LPLC2, label="LPLC2")
    names = [
        row.stimulus if row.axis_deg is None else f"{row.stimulus} {row.axis_deg:g} deg"
        for row in other
    ]
    axes.set_yticks(place, names)
    axes.invert_yaxis()
    axes.set_xlabel("peak / peak for the loom")
    axes.legend(frameon=False)


def _courses(axes: Axes, shown: _Shown) -> None:
    chosen = LOOM, "cross-outward", "bar-expand-10", "bar-expand-60", "bar-expand-60 45 deg", "edge"
    for name, colour in zip(chosen, CYCLE, strict=False):
        time, signal = shown.courses[name]
        axes.plot(time, signal, color=colour, lw=1, label=name)
    axes.axhline(1, color=FAINT, lw=0.7, linestyle="--")
    axes.set_xlabel("time (s)")
    axes.set_ylabel(f"calcium signal of {_FITTED} / loom")
    axes.legend(frameon=False, fontsize="small")
