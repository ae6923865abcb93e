"""First crossing of a threshold at equal false alarms: what peaks do not tell."""

from __future__ import annotations

from typing import TYPE_CHECKING

import matplotlib as mpl
import numpy as np

from oppload_cli.plots.style import COLOURS, FAINT, NAMES, STYLE, new_figure, png_bytes
from oppload_cli.reproduction.claims import Built, Claim, Finding, at_least
from oppload_cli.reproduction.material import (
    DPI,
    NO_PAUSE,
    PRESET_NAMES,
    TITLES,
    WIDE,
    peak_of,
    plain,
    presented,
    settings_of,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from oppload_cli.tuning.present import Responses

    Shown = dict[str, dict[str, Responses]]

TWO = [0, 45]
CONTROLS = {
    "controls/receding-disk": {"disk.growth.l_over_v_ms": [10, 100]},
    "controls/translating-disk-speed": {"disk.motion.speed_deg_s": [20, 40]},
    "controls/translating-disk-direction": {"scene.rotation_deg": [45]},
    "controls/texture-pan": {"ground.motion.direction_deg": TWO},
    "controls/texture-rotation": {"ground.motion.rotation_deg_s": [45]},
    "controls/square-grating": {"grating.axis_deg": TWO},
    "controls/rotating-bar": {"bar.motion.rotation_deg_s": [90]},
    "klapoetke2017/bar-sweep": {"scene.rotation_deg": [0]},
    "klapoetke2017/edge": {"scene.rotation_deg": [0]},
}
LOOMING = {
    "opplod2023/looming-disk-centre": {},
    "opplod2023/looming-disk-off-centre": {},
    "opplod2023/approaching-block": {},
    "klapoetke2017/loom": {},
    "klapoetke2017/loom-speed": {"disk.growth.speed_deg_s": [20, 40, 80]},
    "klapoetke2017/loom-l-over-v": {"disk.growth.l_over_v_ms": [10, 40, 100]},
}
# Less of what says nothing new: of a slow beginning, of a crossing, of a full disk.
SHORT = {
    "controls/receding-disk": {"timing.motion_s": 1.0},
    "controls/rotating-bar": {"timing.motion_s": 1.0},
    "klapoetke2017/bar-sweep": {"timing.motion_s": 1.5},
    "klapoetke2017/edge": {"timing.motion_s": 1.5},
    "klapoetke2017/loom-speed": {"timing.motion_s": 1.3},
    "klapoetke2017/loom-l-over-v": {"timing.motion_s": 1.0},
}
MODELS = ("opplod", "dlgmd")


def thresholds() -> Built:
    """Set each model's threshold by the controls, and compare first crossings.

    Returns
    -------
    Built
    """
    controls, looming = (
        {preset: _shown(preset, stimuli) for preset in PRESET_NAMES}
        for stimuli in (CONTROLS, LOOMING)
    )
    limits = {preset: _limits(controls[preset]) for preset in PRESET_NAMES}
    first = {preset: _crossings(looming[preset], limits[preset]) for preset in PRESET_NAMES}
    claim = Claim(
        "OppLoD responds to looming objects stronger and earlier than D-LGMD, which leaves more "
        "time to avoid them.",
        "each model's threshold is its largest response to any control, so that neither alarms "
        "falsely; share of looming stimuli in which OppLoD crosses its own first, or alone; "
        "holds: at least 90 %, in part: at least 50 %",
        {preset: _finding(first[preset], limits[preset]) for preset in PRESET_NAMES},
    )
    worst = {preset: _worst(controls[preset]) for preset in PRESET_NAMES}
    return Built(
        "thresholds",
        "First crossing of a threshold at equal false alarms",
        "For each looming stimulus, when each model first exceeds its largest response to any "
        "control stimulus; a cross at the right is a stimulus that the model misses.",
        (claim,),
        png_bytes(_draw(first), DPI),
        (
            "Peaks alone flatter OppLoD: they come when the edge leaves its field, which is "
            "smaller than the frame that D-LGMD sees. This figure compares what a warning needs.",
            f"Controls: {_count(CONTROLS)} stimuli of {len(CONTROLS)} kinds (receding, "
            "translating, panning, rotating, gratings, edges), none of which looms, at each "
            "preset's own working height and without a pause before the motion.",
            *(
                f"{TITLES[preset].capitalize()}: the threshold of {NAMES[model]} is set by "
                f"{name} ({plain(value)})."
                for preset, each in worst.items()
                for model, (name, value) in each.items()
            ),
        ),
    )


def _shown(preset: str, stimuli: dict[str, dict[str, list[int]]]) -> Shown:
    settings = settings_of(preset)
    made: Shown = {}
    for name, changes in stimuli.items():
        made.update(presented(name, settings, {**NO_PAUSE, **SHORT.get(name, {}), **changes}))
    return made


def _count(stimuli: dict[str, dict[str, list[int]]]) -> int:
    return sum(len(next(iter(changes.values()), [0])) for changes in stimuli.values())


def _worst(controls: Shown) -> dict[str, tuple[str, float]]:
    """Return the control of the largest response, and that, by model."""
    return {
        model: max(
            ((name, peak_of(each[model])) for name, each in controls.items()),
            key=lambda pair: pair[1],
        )
        for model in MODELS
    }


def _limits(controls: Shown) -> dict[str, float]:
    return {model: value for model, (_, value) in _worst(controls).items()}


def _crossings(looming: Shown, limits: dict[str, float]) -> dict[str, dict[str, float | None]]:
    """Return when each model first exceeds its limit, in seconds; None where it never does."""
    first: dict[str, dict[str, float | None]] = {}
    for name, each in looming.items():
        first[name] = {}
        for model in MODELS:
            above = np.flatnonzero(each[model].response > limits[model])
            first[name][model] = float(each[model].time_s[above[0]]) if above.size else None
    return first


def _finding(first: dict[str, dict[str, float | None]], limits: dict[str, float]) -> Finding:
    pairs = [(each["opplod"], each["dlgmd"]) for each in first.values()]
    earlier = sum(o is not None and (d is None or o < d) for o, d in pairs)
    later = sum(d is not None and (o is None or d < o) for o, d in pairs)
    missed = [sum(pair[side] is None for pair in pairs) for side in (0, 1)]
    share = earlier / len(pairs)
    return Finding(
        f"OppLoD is first in {earlier}, D-LGMD in {later} of {len(pairs)} looming stimuli; "
        f"OppLoD misses {missed[0]}, D-LGMD {missed[1]}.",
        at_least(share, 0.9, 0.5),
        {
            "opplod_first": earlier,
            "dlgmd_first": later,
            "stimuli": len(pairs),
            "opplod_missed": missed[0],
            "dlgmd_missed": missed[1],
            **{f"{model}_threshold": limit for model, limit in limits.items()},
        },
    )


def _draw(first: dict[str, dict[str, dict[str, float | None]]]) -> Figure:
    names = list(next(iter(first.values())))
    with mpl.rc_context(STYLE):
        figure = new_figure(WIDE, 0.9 + 0.21 * len(names))
        axes = figure.subplots(1, len(first), sharey=True)
        for panel, (preset, each) in zip(axes, first.items(), strict=True):
            _draw_crossings(panel, each)
            panel.set(title=TITLES[preset], xlabel="first crossing (s); cross: missed")
        short = [name.partition("/")[2].replace("looming-disk", "disk") for name in names]
        axes[0].set_yticks(range(len(names)), short)
        axes[0].invert_yaxis()
        handles, labels = axes[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=2)
    return figure


def _draw_crossings(axes: Axes, first: dict[str, dict[str, float | None]]) -> None:
    times = [time for each in first.values() for time in each.values() if time is not None]
    end = 1.12 * max(times, default=1.0)
    for model, marker, shift in (("opplod", "o", -0.12), ("dlgmd", "s", 0.12)):
        seen = [(time, row) for row, each in enumerate(first.values())
                if (time := each[model]) is not None]  # fmt: skip
        missed = [row for row, each in enumerate(first.values()) if each[model] is None]
        colour = COLOURS[model]
        axes.plot([time for time, _ in seen], [row + shift for _, row in seen], marker,
                  color=colour, markersize=4, label=NAMES[model])  # fmt: skip
        axes.plot([end] * len(missed), [row + shift for row in missed], "x", color=colour, ms=4)
    axes.grid(axis="y", color=FAINT, lw=0.3)
    axes.set_xlim(0, 1.04 * end)
