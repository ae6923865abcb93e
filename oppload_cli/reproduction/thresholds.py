"""Figure of first crossings of a threshold at equal false alarms, which peaks do not show."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from oppload_cli.models.registry import detector_named
from oppload_cli.plots.style import FAINT, INK, styled_figure
from oppload_cli.reproduction.claims import (
    NO_PAUSE,
    PRESETS,
    TITLES,
    WIDE,
    Built,
    Claim,
    Finding,
    at_least,
    described_settings,
    peak_of,
    plain,
    presented,
    settings_of,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from oppload_cli.tuning.present import Responses

    Shown = dict[str, dict[str, Responses]]  # by stimulus and detector
    First = dict[str, dict[str, float | None]]
    Changes = dict[str, dict[str, list[int]]]


_CONTROLS = {
    "controls/receding-disk": {"disk.growth.l_over_v_ms": [10, 100]},
    "controls/translating-disk-speed": {"disk.motion.speed_deg_s": [20, 40]},
    "controls/translating-disk-direction": {"scene.rotation_deg": [45]},
    "controls/texture-pan": {"ground.motion.direction_deg": [0, 45]},
    "controls/texture-rotation": {"ground.motion.rotation_deg_s": [45]},
    "controls/square-grating": {"grating.axis_deg": [0, 45]},
    "controls/rotating-bar": {"bar.motion.rotation_deg_s": [90]},
    "klapoetke2017/bar-sweep": {"scene.rotation_deg": [0]},
    "klapoetke2017/edge": {"scene.rotation_deg": [0]},
}
_LOOMING = {
    "opplod2023/looming-disk-centre": {},
    "opplod2023/looming-disk-off-centre": {},
    "opplod2023/approaching-block": {},
    "klapoetke2017/loom": {},
    "klapoetke2017/loom-speed": {"disk.growth.speed_deg_s": [20, 40, 80]},
    "klapoetke2017/loom-l-over-v": {"disk.growth.l_over_v_ms": [10, 40, 100]},
}
# Shorter than in the catalogue: a slow beginning, a crossing or a full disk adds nothing.
_SHORT = {
    "controls/receding-disk": {"timing.motion_s": 1.0},
    "controls/rotating-bar": {"timing.motion_s": 1.0},
    "klapoetke2017/bar-sweep": {"timing.motion_s": 1.5},
    "klapoetke2017/edge": {"timing.motion_s": 1.5},
    "klapoetke2017/loom-speed": {"timing.motion_s": 1.3},
    "klapoetke2017/loom-l-over-v": {"timing.motion_s": 1.0},
}
_DETECTORS = ("opplod", "dlgmd")


def thresholds() -> Built:
    """Set each detector's threshold by the controls, and compare first crossings."""
    controls, looming = (
        {preset: _shown(preset, stimuli) for preset in PRESETS} for stimuli in (_CONTROLS, _LOOMING)
    )
    worst = {preset: _worst(controls[preset]) for preset in PRESETS}
    limits = {
        preset: {detector: value for detector, (_, value) in each.items()}
        for preset, each in worst.items()
    }
    first = {preset: _crossings(looming[preset], limits[preset]) for preset in PRESETS}
    claim = Claim(
        "OppLoD responds to looming objects stronger and earlier than D-LGMD, which leaves more "
        "time to avoid them.",
        "each detector's threshold is its largest response to any control, so that neither alarms "
        "falsely; share of looming stimuli in which OppLoD crosses its own first, or alone; "
        "holds: at least 90 %, in part: at least 50 %",
        {preset: _finding(first[preset], limits[preset]) for preset in PRESETS},
        "\u201cour model responds to the looming objects stronger and earlier, which means that "
        "can attain more time avoiding obstacles\u201d (looming disk)",
    )
    return Built(
        "thresholds",
        "First crossing of a threshold at equal false alarms",
        "For each looming stimulus, when each detector first exceeds its largest response to any "
        "control stimulus; in the grey strip: never.",
        (claim,),
        _draw(first),
        tuple(
            {
                "preset": preset, "detector": detector, "stimulus": name, "kind": kind,
                "peak": peak_of(each[detector]), "threshold": limits[preset][detector],
                "first_crossing_s": first[preset].get(name, {}).get(detector),
            }
            for preset in PRESETS
            for kind, shown in (("looming", looming[preset]), ("control", controls[preset]))
            for name, each in shown.items()
            for detector in _DETECTORS
        ),
        (
            "Peaks alone flatter OppLoD: they come when the edge leaves its field, which is "
            "smaller than the frame that D-LGMD sees. This figure compares first crossings, on "
            "which an alarm depends.",
            f"Controls: {len(controls[PRESETS[0]])} stimuli of {len(_CONTROLS)} kinds (receding, "
            "translating, panning, rotating, gratings, edges), none of which looms, at each "
            "preset's own working height and without a pause before the motion. They are a part "
            "of the catalogue's sweeps: not all of its directions, sizes and speeds.",
            *(
                f"{TITLES[preset].capitalize()}: the threshold of {detector_named(detector).label} "
                f"is set by {name} ({plain(value)})."
                for preset, each in worst.items()
                for detector, (name, value) in each.items()
            ),
        ),
        {preset: described_settings(settings_of(preset)) for preset in PRESETS},
    )  # fmt: skip


def _shown(preset: str, stimuli: Changes) -> Shown:
    settings = settings_of(preset)
    made: Shown = {}
    for name, changes in stimuli.items():
        made.update(presented(name, settings, {**NO_PAUSE, **_SHORT.get(name, {}), **changes}))
    return made


def _worst(controls: Shown) -> dict[str, tuple[str, float]]:
    """Return the control with the largest response, and that response, by detector."""
    return {
        detector: max(
            ((name, peak_of(each[detector])) for name, each in controls.items()),
            key=lambda pair: pair[1],
        )
        for detector in _DETECTORS
    }


def _crossings(looming: Shown, limits: dict[str, float]) -> First:
    """Return when each detector first exceeds its limit, in seconds; None where it never does."""
    first: First = {}
    for name, each in looming.items():
        first[name] = {}
        for detector, limit in limits.items():
            above = np.flatnonzero(each[detector].response > limit)
            time = each[detector].time_s
            first[name][detector] = float(time[above[0]]) if above.size else None
    return first


def _finding(first: First, limits: dict[str, float]) -> Finding:
    pairs = [(each["opplod"], each["dlgmd"]) for each in first.values()]
    earlier = sum(o is not None and (d is None or o < d) for o, d in pairs)
    later = sum(d is not None and (o is None or d < o) for o, d in pairs)
    missed = [sum(pair[side] is None for pair in pairs) for side in (0, 1)]
    share = earlier / len(pairs)
    neither = [_short(name) for name, each in first.items() if not any(each.values())]
    both = f" Both miss: {'; '.join(neither)}." if neither else ""
    return Finding(
        f"OppLoD is first in {earlier}, D-LGMD in {later} of {len(pairs)} looming stimuli; "
        f"OppLoD misses {missed[0]}, D-LGMD {missed[1]}.{both}",
        at_least(share, 0.9, 0.5),
        {
            "opplod_first": earlier,
            "dlgmd_first": later,
            "stimuli": len(pairs),
            "opplod_missed": missed[0],
            "dlgmd_missed": missed[1],
            **{f"{name}_threshold": limit for name, limit in limits.items()},
        },
    )


def _draw(first: dict[str, First]) -> Figure:
    names = list(next(iter(first.values())))
    with styled_figure(WIDE, 0.9 + 0.21 * len(names)) as figure:
        axes = figure.subplots(1, len(first), sharey=True)
        for panel, (preset, each) in zip(axes, first.items(), strict=True):
            _draw_crossings(panel, each)
            panel.set(title=TITLES[preset], xlabel="first crossing (s)")
        axes[0].set_yticks(range(len(names)), [_short(name) for name in names])
        axes[0].invert_yaxis()
        handles, labels = axes[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=2)
    return figure


def _short(name: str) -> str:
    short = name.partition("/")[2].replace("looming-disk-", "disk of the paper, ")
    return short.replace("loom-speed/speed-", "loom, speed ").replace(
        "loom-l-over-v/l-over-v-", "loom, l/v "
    )


def _draw_crossings(axes: Axes, first: First) -> None:
    times = [time for each in first.values() for time in each.values() if time is not None]
    last = 1.05 * max(times, default=1.0)
    end = 1.2 * last
    for name, marker, shift in zip(_DETECTORS, "os", (-0.12, 0.12), strict=True):
        crossings = [each[name] for each in first.values()]
        seen = [(time, row) for row, time in enumerate(crossings) if time is not None]
        missed = [row for row, time in enumerate(crossings) if time is None]
        colour = detector_named(name).colour
        axes.plot([time for time, _ in seen], [row + shift for _, row in seen], marker,
                  color=colour, markersize=4, label=detector_named(name).label)  # fmt: skip
        # A strip of their own, without a time: at the end of the axis they would look like late
        # alarms.
        axes.plot([(last + end) / 2] * len(missed), [row + shift for row in missed], "x",
                  color=colour, ms=4)  # fmt: skip
    axes.axvspan(last, end, color=FAINT, alpha=0.25, lw=0)
    axes.annotate("no alarm", ((last + end) / 2, 1), xycoords=("data", "axes fraction"),
                  ha="center", va="bottom", fontsize=6, color=INK)  # fmt: skip
    axes.grid(axis="y", color=FAINT, lw=0.3)
    axes.set_xlim(0, end)
    axes.set_xticks([tick for tick in axes.get_xticks() if 0 <= tick <= last])
