"""Figure of inward motion: no response to it, and its suppression of outward motion."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from oppload_cli.plots.style import CYCLE, png_bytes, styled_figure
from oppload_cli.reproduction.claims import (
    DPI,
    NO_PAUSE,
    PRESETS,
    TITLES,
    WIDE,
    Built,
    Claim,
    Finding,
    Verdict,
    at_most,
    peak_of,
    presented,
    settings_of,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from oppload_cli.tuning.present import Responses

    Shown = dict[str, dict[int, Responses]]


_STIMULI = {
    "outward": "opplod2023/bar-10",
    "outward, inward at the periphery": "opplod2023/periphery-inhibition",
    "inward": "opplod2023/inward-motion",
}
_OUTWARD, _BOTH, _INWARD = _STIMULI
_ANGLES = [0, 45]
# 60 degrees across, as LPLC2's: 8 px/deg at a height of 600, so 192 px at 240.
_FIELD = ("opplod.receptive_field=192",)
_FILTERS = {"reference": -1, "paper": 1}  # weight of inward motion


def inward_motion() -> Built:
    """Show outward motion, inward motion and both to both presets."""
    shown = {preset: _shown(preset) for preset in PRESETS}
    claims = (
        Claim(
            "The model does not respond to inward motion.",
            "peak for two bars growing inward over that for one growing outward, the worse of two "
            "axes; holds: at most 5 %, in part: at most 25 %",
            {preset: _inward(each) for preset, each in shown.items()},
        ),
        Claim(
            "Inward motion at the periphery suppresses the response to outward motion.",
            "mean response with inward motion at the periphery over that without; holds: at most "
            "50 % along both axes, in part: at most 90 % along one",
            {preset: _suppression(each) for preset, each in shown.items()},
        ),
    )
    return Built(
        "inward",
        "Inward motion, periphery inhibition and the inhibitory filter",
        "Responses over time to outward, inward and both motions, the axis of the bar along a "
        "cardinal and a diagonal direction; and the weights of the filter.",
        claims,
        png_bytes(_draw(shown), DPI),
        (
            "The paper shows a filter with negative weights but gives no equation. Preset "
            "reference subtracts, at every unit and axis, inward from outward opponency; preset "
            "paper has no filter, and a product of opposite motions is the same for both.",
            "Per axis the difference is cut off at zero before the axes are summed. So inward "
            "motion across the outward motion's axis suppresses nothing: suppression across axes "
            "is missing.",
            "Preset reference has its receptive field set to 60 degrees here, that of LPLC2.",
        ),
    )


def _shown(preset: str) -> Shown:
    settings = settings_of(preset, _FIELD, detector="opplod")
    made: Shown = {}
    for label, name in _STIMULI.items():
        key = "bar.axis_deg" if label == _OUTWARD else "scene.rotation_deg"
        members = presented(name, settings, {**NO_PAUSE, key: _ANGLES})
        made[label] = dict(zip(_ANGLES, (each["opplod"] for each in members.values()), strict=True))
    return made


def _inward(shown: Shown) -> Finding:
    ratios = {
        angle: peak_of(shown[_INWARD][angle]) / max(peak_of(shown[_OUTWARD][angle]), 1e-30)
        for angle in _ANGLES
    }
    return Finding(
        f"Inward motion gives {_stated(ratios)}.",
        at_most(max(ratios.values()), 0.05, 0.25),
        {f"ratio_{angle}_deg": ratio for angle, ratio in ratios.items()},
    )


def _suppression(shown: Shown) -> Finding:
    ratios = {
        angle: float(
            np.nanmean(shown[_BOTH][angle].response) / np.nanmean(shown[_OUTWARD][angle].response)
        )
        for angle in _ANGLES
    }
    worse, better = max(ratios.values()), min(ratios.values())
    return Finding(
        f"With inward motion there remain {_stated(ratios)}.",
        at_most(worse, 0.5, np.inf) if better <= 0.9 else Verdict.DOES_NOT,
        {f"mean_ratio_{angle}_deg": ratio for angle, ratio in ratios.items()},
    )


def _stated(ratios: dict[int, float]) -> str:
    return " and ".join(f"{100 * each:.3g} % along {at} degrees" for at, each in ratios.items())


def _draw(shown: dict[str, Shown]) -> Figure:
    with styled_figure(WIDE, 4.8) as figure:
        axes = figure.subplots(2, 3, width_ratios=[1, 1, 0.72])
        for row, (preset, each) in zip(axes, shown.items(), strict=True):
            for panel, angle in zip(row, _ANGLES, strict=False):
                largest = max(peak_of(each[label][angle]) for label in _STIMULI) or 1.0
                for label, colour, dash in zip(_STIMULI, CYCLE, ("-", "--", "-."), strict=False):
                    responses = each[label][angle]
                    panel.plot(
                        responses.time_s, responses.response / largest, color=colour,
                        linestyle=dash, label=label,
                    )  # fmt: skip
                panel.set(title=f"{TITLES[preset]}, axis {angle}°", xlabel="time (s)")
                panel.set_ylim(-0.03, 1.08)
            row[0].set_ylabel("response / largest")
        handles, labels = axes[0, 0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=3)
        for panel, (preset, weight) in zip(axes[:, 2], _FILTERS.items(), strict=True):
            _draw_filter(figure, panel, preset, weight)
    return figure


def _draw_filter(figure: Figure, panel: Axes, preset: str, weight: int) -> None:
    x, y = np.meshgrid(np.linspace(-1, 1, 101), np.linspace(1, -1, 101))
    along = x + y
    weights = np.where(np.abs(along) < 1e-9, 0, np.where(along > 0, 1, weight))
    image = panel.imshow(weights, extent=(-1, 1, -1, 1), cmap="RdBu_r", vmin=-1.6, vmax=1.6)
    panel.set(title=f"filter of {preset}", xlabel="offset x / half field")
    panel.set_ylabel("offset y / half field")
    panel.annotate("passes 45°", (0.1, 0.15), fontsize=6)
    bar = figure.colorbar(image, ax=panel, ticks=[-1, 0, 1], shrink=0.8)
    bar.set_label("weight of $S_{45}S_{225}$")
    bar.ax.set_ylim(-1, 1)
