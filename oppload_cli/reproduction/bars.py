"""Figures of directional tuning: expanding bars of 10 and 60 degrees, beside LPLC2."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import matplotlib as mpl
import numpy as np
from matplotlib.lines import Line2D

from oppload_cli.plots.polar import draw_polar, spread, symmetric_tuning
from oppload_cli.plots.style import CYCLE, FAINT, LPLC2, styled_figure
from oppload_cli.reference import BAR_WIDTHS, SOURCE, bar_tuning
from oppload_cli.reproduction.claims import (
    NO_PAUSE,
    NO_RESPONSE,
    PAPER_DETECTORS,
    REFERENCE,
    WIDE,
    Built,
    Claim,
    ClaimVerdict,
    Finding,
    described_settings,
    faint_note,
    presented,
    settings_of,
    short,
)
from oppload_cli.stimulus.catalogue import load, load_all
from oppload_cli.stimulus.truth import frame_truth

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from matplotlib.figure import Figure
    from matplotlib.projections.polar import PolarAxes
    from numpy.typing import NDArray

    from oppload_cli.pipeline.settings import Settings
    from oppload_cli.stimulus.protocol import Protocol
    from oppload_cli.tuning.present import Responses


# A field of 60 degrees, as that of LPLC2: 5 px/deg at a height of 360, so 200 px at 240.
_FIELD = {f"{REFERENCE}.receptive_field": 200}
_BAR, _LOOM = "klapoetke2017/bar-expand-{}", "klapoetke2017/loom"
_END_DEG = 35.0  # largest distance of each end of the bar from its middle
# The bar of the catalogue stops at the edge of the largest field. A longer bar shows what the
# response does beyond the edge.
_LONGER = {"bar.growth.end_deg": 2 * _END_DEG, "timing.motion_s": 1.5}
_BEYOND = 1.1  # a distance from the middle beyond the edge, divided by that of the edge
_OFF_DIAGONAL = [0, 15, 30, 45]  # angle between an axis and the nearest diagonal, in degrees
_LIGHTEST = 0.8  # end of the colour map, so that the lightest line can be seen on white
_FIELD_NOTE = (
    "The receptive field of opplod_reference is set to 60 degrees here, as that of LPLC2. The "
    "stimuli start without a pause: after a pause, the first moving frames have no delayed "
    "inhibition yet."
)


@dataclass(frozen=True)
class _Tunings:
    """The responses of one detector to both bars, and its peak for the looming disk."""

    bars: dict[int, dict[int, Responses]]  # by width and axis in degrees
    loom: float
    edge_deg: float  # from the middle of a receptive field to its edge
    # Distance of the ends of the bars from the middle by frame, in degrees; NaN after the growth.
    reach: NDArray[np.float64]
    settings: Settings

    def peaks(self, width: int) -> dict[int, float]:
        return {axis: shown.largest for axis, shown in self.bars[width].items()}

    def over_loom(self, width: int) -> dict[int, float]:
        """Return the peak divided by that for the disk, by axis in degrees."""
        loom = self.loom or math.nan
        return {axis: peak / loom for axis, peak in self.peaks(width).items()}

    def finding(
        self, text: str, verdict: ClaimVerdict, numbers: dict[str, float], *widths: int
    ) -> Finding:
        """Return a finding on the bars of some widths; a NaN number means that none responded."""
        if any(map(math.isnan, numbers.values())):
            return Finding(NO_RESPONSE, verdict, numbers)
        (detector,) = self.settings.models
        shown = {width: self.bars[width].values() for width in widths}
        faint = (
            faint_note(detector, responses, self.settings, f"to the {width} degree bar")
            for width, responses in shown.items()
        )
        return Finding(text, verdict, numbers, " ".join(filter(None, faint)))


def bar_figures() -> list[Built]:
    """Show both bars along several axes to both detectors; return the figures of time and peaks."""
    longer = {detector: _tunings(detector, _LONGER) for detector in PAPER_DETECTORS}
    usual = {detector: _tunings(detector, {}) for detector in PAPER_DETECTORS}
    return [_over_time(longer), _polar(usual)]


def _tunings(detector: str, changes: Mapping[str, float]) -> _Tunings:
    settings = settings_of(detector, _FIELD)
    bars = {}
    for width in BAR_WIDTHS:
        # Along all axes of the catalogue: with few axes, a curve can look like a needle.
        shown = presented(_BAR.format(width), settings, changes)
        bars[width] = {
            int(name.rpartition("-")[2]): by_detector[detector]
            for name, by_detector in shown.items()
        }
    loom = presented(_LOOM, settings, {})[_LOOM][detector]
    display = load(_LOOM).display
    height = settings.pixels or display.height
    field = settings.resolved(height)[detector].as_dict()["receptive_field"]
    edge_deg = field / 2 * display.height / height / display.scale
    reach = _reach(load_all(_BAR.format(BAR_WIDTHS[0]), {**NO_PAUSE, **changes})[0])
    return _Tunings(bars, loom.largest, edge_deg, reach, settings)


def _described(tunings: dict[str, _Tunings]) -> dict[str, str]:
    return {detector: described_settings(tuned.settings) for detector, tuned in tunings.items()}


def _over_time(tunings: dict[str, _Tunings]) -> Built:
    claims = (
        Claim.of("bar-middle", _judged(_middle, tunings)),
        Claim.of("bar-edge", _judged(_edge, tunings)),
    )
    return Built.of(
        "bar-time",
        claims,
        _draw_over_time(tunings),
        (
            {
                "detector": detector, "width_deg": width, "axis_deg": axis, "time_s": time,
                "reach_deg": reach, "response": response,
            }
            for detector, tuned in tunings.items()
            for width, by_axis in tuned.bars.items()
            for axis, shown in by_axis.items()
            for time, reach, response in zip(
                shown.time_s, tuned.reach, shown.response, strict=True
            )
        ),
        settings=_described(tunings),
        notes=[_FIELD_NOTE],
        end_deg=_END_DEG,
    )  # fmt: skip


def _judged(
    judge: Callable[[_Tunings], Finding], tunings: Mapping[str, _Tunings]
) -> dict[str, Finding]:
    """Return the finding on each detector."""
    return {detector: judge(tuned) for detector, tuned in tunings.items()}


def _middle(tunings: _Tunings) -> Finding:
    ends = np.array([tunings.reach[shown.peak or 0] for shown in _responding(tunings)])
    count = sum(len(bars) for bars in tunings.bars.values())
    edge = tunings.edge_deg
    good = int(np.sum((ends >= 0.25 * edge) & (ends <= 0.75 * edge)))
    low, high = (float(np.quantile(ends, q)) if ends.size else math.nan for q in (0.25, 0.75))
    return tunings.finding(
        f"{good} of {count}; at half of the peaks the ends are {low:.0f} to {high:.0f} degrees "
        "from the middle.",
        ClaimVerdict.at_least(good / count, 0.9, 0.5),
        {"share": good / count, "lower_quartile_deg": low, "upper_quartile_deg": high},
        *BAR_WIDTHS,
    )


def _edge(tunings: _Tunings) -> Finding:
    remaining = [
        float(shown.response[tunings.reach >= _BEYOND * tunings.edge_deg][0]) / shown.largest
        for shown in _responding(tunings)
    ]
    median = float(np.median(remaining)) if remaining else math.nan
    return tunings.finding(
        # Three digits: with two, 25.4 % would read as the 25 % at which the statement still holds.
        f"{100 * median:.3g} % of the peak remains beyond the edge.",
        ClaimVerdict.at_most(median, 0.05, 0.25),
        {"median_beyond_edge_over_peak": median},
        *BAR_WIDTHS,
    )


def _responding(tunings: _Tunings) -> list[Responses]:
    every = (shown for by_axis in tunings.bars.values() for shown in by_axis.values())
    return [shown for shown in every if shown.largest > 0]


def _reach(protocol: Protocol) -> NDArray[np.float64]:
    """Return half the length of the bar in each frame, in degrees; NaN after the growth."""
    truths = [frame_truth(protocol, frame) for frame in range(protocol.frame_count)]
    reach = np.array([truth.objects[0].angular_size_deg for truth in truths], float) / 2
    grows = [truth.time_s <= protocol.timing.end_s + 1e-9 for truth in truths]
    return np.where(grows, reach, np.nan)


def _polar(tunings: dict[str, _Tunings]) -> Built:
    claims = (
        Claim.of("bar-even", _judged(_evenness, tunings)),
        Claim.of("bar-diagonals", _judged(_diagonal, tunings)),
        Claim.of("bar-neurons", _judged(_likeness, tunings)),
    )
    ratio, _ = _diagonal_ratios(bar_tuning(60))
    enhanced = _likeness(tunings[REFERENCE]).numbers["largest_over_loom"]
    return Built.of(
        "bar-polar",
        claims,
        _draw_polar(tunings),
        (
            {"detector": name, "width_deg": width, "axis_deg": axis, "peak_over_loom": peak}
            for name, width, peaks in _relative(tunings)
            for axis, peak in peaks.items()
        ),
        settings=_described(tunings),
        notes=[_FIELD_NOTE],
        source=SOURCE,
        ratio=ratio,
        enhanced=short(enhanced),
        before_squaring=short(enhanced**0.5),
    )


def _relative(tunings: dict[str, _Tunings]) -> Iterator[tuple[str, int, Mapping[Any, float]]]:
    """Yield a detector, a bar's width, and its peaks divided by that for the loom, by axis."""
    for width in BAR_WIDTHS:
        for detector, tuned in tunings.items():
            yield detector, width, tuned.over_loom(width)
        yield "LPLC2 neurons", width, bar_tuning(width)


def _evenness(tunings: _Tunings) -> Finding:
    peaks = tunings.peaks(10).values()
    share = min(peaks) / max(peaks) if max(peaks) > 0 else math.nan
    return tunings.finding(
        f"The smallest peak is {short(100 * share)} % of the largest (LPLC2: 78 %).",
        ClaimVerdict.at_least(share, 0.75, 0.5),
        {"least_over_largest": share},
        10,
    )


def _diagonal(tunings: _Tunings) -> Finding:
    mean, largest = _diagonal_ratios(tunings.peaks(60))
    partly = ClaimVerdict.IN_PART if mean > 1 else ClaimVerdict.DOES_NOT
    return tunings.finding(
        f"The mean peak of the diagonals is {short(mean)} times the mean peak and "
        f"{short(largest)} times the largest peak of the other axes.",
        ClaimVerdict.HOLDS if largest > 1 else partly,
        {"diagonal_over_mean": mean, "diagonal_over_largest": largest},
        60,
    )


def _diagonal_ratios(peaks: Mapping[int, float] | Mapping[float, float]) -> tuple[float, float]:
    """Return the diagonals' mean peak, divided by the mean and by the largest of other axes."""
    diagonal = float(np.mean([value for axis, value in peaks.items() if axis in {45, 135}]))
    others = np.array([value for axis, value in peaks.items() if axis not in {45, 135}])
    if not others.max() > 0:
        return math.nan, math.nan
    return diagonal / float(others.mean()), diagonal / float(others.max())


def _likeness(tunings: _Tunings) -> Finding:
    pairs = [
        (tunings.over_loom(width)[int(axis)], value)
        for width in BAR_WIDTHS
        for axis, value in bar_tuning(width).items()
    ]
    model, neurons = np.array(pairs).T
    difference = float(np.sqrt(np.mean((model - neurons) ** 2)))
    return tunings.finding(
        f"Root mean square difference {short(difference)}; the bars give {short(model.min())} to "
        f"{short(model.max())} times the looming disk's response (LPLC2: {short(neurons.min())} "
        f"to {short(neurons.max())}).",
        ClaimVerdict.at_most(difference, 0.1, 0.25),
        {
            "rms_difference": difference,
            "least_over_loom": float(model.min()),
            "largest_over_loom": float(model.max()),
        },
        *BAR_WIDTHS,
    )


def _draw_over_time(tunings: dict[str, _Tunings]) -> Figure:
    with styled_figure(WIDE, 4.4) as figure:
        axes = figure.subplots(2, 2, sharex=True)
        shades = mpl.colormaps["viridis"](np.linspace(0, _LIGHTEST, len(_OFF_DIAGONAL)))
        for row, (detector, tuned) in zip(axes, tunings.items(), strict=True):
            for panel, width in zip(row, BAR_WIDTHS, strict=True):
                largest = max(tuned.peaks(width).values()) or 1.0
                for axis, responses in tuned.bars[width].items():
                    panel.plot(
                        tuned.reach, responses.response / largest,
                        color=shades[_OFF_DIAGONAL.index(abs(axis % 90 - 45))], lw=0.9,
                    )  # fmt: skip
                panel.axvline(tuned.edge_deg, color=FAINT, lw=0.7, linestyle="--")
                panel.set_title(f"{detector}, {width} deg bar (largest {short(largest)})")
                panel.set_xlim(tuned.reach[0], _END_DEG)
            row[0].set_ylabel("response / largest")
        for panel in axes[1]:
            panel.set_xlabel("reach of the bar's ends (deg)")
        names = [f"{off} deg" for off in _OFF_DIAGONAL]
        figure.legend(
            [Line2D([], [], color=shade) for shade in shades], names, ncols=len(names),
            loc="outside lower center", title="axis of the bar, from the nearest diagonal",
        )  # fmt: skip
    return figure


def _draw_polar(tunings: dict[str, _Tunings]) -> Figure:
    with styled_figure(WIDE, 4.4) as figure:
        axes = figure.subplots(1, 2, subplot_kw={"projection": "polar"})
        for panel, width in zip(axes, BAR_WIDTHS, strict=True):
            curves = {detector: tuned.peaks(width) for detector, tuned in tunings.items()}
            draw_beside_neurons(panel, width, curves, "arbitrary unit")
        spread(figure)
    return figure


def draw_beside_neurons(
    panel: PolarAxes, width: int, models: Mapping[str, Mapping[Any, float]], unit: str
) -> None:
    """Draw the peaks for an expanding bar in polar form, beside those of LPLC2 neurons.

    The bar has a `width` of 10 or 60 degrees. `models` has two curves by their names in the legend:
    peaks in `unit` by axis in degrees, 0 to 180.
    """
    shown = [(name, peaks, unit) for name, peaks in models.items()]
    shown.append(("LPLC2", bar_tuning(width), "of the loom"))
    looks = (CYCLE[0], "-"), (CYCLE[2], "--"), (LPLC2, ":")
    curves = [
        symmetric_tuning(
            *curve, {"color": colour, "linestyle": dash, "marker": "o", "markersize": 2}
        )
        for curve, (colour, dash) in zip(shown, looks, strict=True)
    ]
    draw_polar(panel, curves)
    panel.set_title(f"{width} deg bar", loc="center", pad=8)
