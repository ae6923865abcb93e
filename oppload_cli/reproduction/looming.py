"""Figures of looming: disks with the winning unit, and first crossings of a threshold."""

from __future__ import annotations

import functools
import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.patches import Rectangle

from oppload_cli.models.presets import STUDY_PRESET
from oppload_cli.models.registry import detector_named
from oppload_cli.plots.style import DASHES, FAINT, INK, styled_figure
from oppload_cli.reproduction.claims import (
    PAPER_PRESETS,
    TITLES,
    WIDE,
    Built,
    Claim,
    Finding,
    Verdict,
    described_settings,
    faint_note,
    presented,
    settings_of,
    short,
)
from oppload_cli.stimulus.catalogue import load
from oppload_cli.stimulus.geometry import Projection
from oppload_cli.stimulus.renderer import Renderer
from oppload_cli.tuning.present import Responses, present

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from oppload_cli.pipeline.settings import Settings
    from oppload_cli.stimulus.protocol import Protocol

    Shown = dict[str, dict[str, Responses]]  # by preset or stimulus, and by detector
    Judge = Callable[[dict[str, Responses]], Finding]
    First = dict[str, dict[str, float]]  # by stimulus and detector, in s; infinite for never
    Changes = Mapping[str, Mapping[str, float | list[int]]]  # by stimulus and key


_CENTRE, _OFF_CENTRE = "opplod2023/looming-disk-centre", "opplod2023/looming-disk-off-centre"
# The paper's field of 200 px, as the disk is shown at its native size.
_FIELD = ("opplod.receptive_field=200", "opplod.cell=10")
_PAPER = {"opplod": 22, "dlgmd": 43}  # frames of the peaks, which the paper gives for one disk
_SPEED = 4.0  # px/frame of the disk's edge; chosen here, because the paper gives no speed
_SPEEDS = 3.0, 3.5, _SPEED, 4.25, 4.5, 5.0, 6.0
_EARLY = 0.1  # a response begins at this share of its peak
# Some stimuli are shorter than in the catalogue, without the parts in which nothing new happens.
_CONTROLS: Changes = {
    "controls/receding-disk": {"disk.growth.l_over_v_ms": [10, 100], "timing.motion_s": 1.0},
    "controls/translating-disk-speed": {"disk.motion.speed_deg_s": [20, 40]},
    "controls/translating-disk-direction": {"scene.rotation_deg": [45]},
    "controls/texture-pan": {"ground.motion.direction_deg": [0, 45]},
    "controls/texture-rotation": {"ground.motion.rotation_deg_s": [45]},
    "controls/square-grating": {"grating.axis_deg": [0, 45]},
    "controls/rotating-bar": {"bar.motion.rotation_deg_s": [90], "timing.motion_s": 1.0},
    "klapoetke2017/bar-sweep": {"scene.rotation_deg": [0], "timing.motion_s": 1.5},
    "klapoetke2017/edge": {"scene.rotation_deg": [0], "timing.motion_s": 1.5},
}
_LOOMING: Changes = {
    _CENTRE: {},
    _OFF_CENTRE: {},
    "opplod2023/approaching-block": {},
    "klapoetke2017/loom": {},
    "klapoetke2017/loom-speed": {"disk.growth.speed_deg_s": [20, 40, 80], "timing.motion_s": 1.3},
    "klapoetke2017/loom-l-over-v": {
        "disk.growth.l_over_v_ms": [10, 40, 100],
        "timing.motion_s": 1.0,
    },
}
_DETECTORS = ("opplod", "dlgmd")


def _figure(name: str, stimulus: str) -> Built:
    settings = {preset: settings_of(preset, _FIELD, height="native") for preset in PAPER_PRESETS}
    by_speed = {speed: _shown_at(stimulus, speed, settings) for speed in _SPEEDS}
    shown = by_speed[_SPEED]
    protocol = load(stimulus)
    return Built.of(
        name,
        _claims(protocol, by_speed, settings),
        _draw(protocol, shown, _PAPER if stimulus == _CENTRE else {}),
        (
            {
                "preset": preset, "detector": detector, "frame": frame, "time_s": time,
                "response": response,
            }
            for preset, each in shown.items()
            for detector, responses in each.items()
            for frame, time, response in zip(
                responses.frame, responses.time_s, responses.response, strict=True
            )
        ),
        settings={preset: described_settings(each, _FIELD) for preset, each in settings.items()},
        shared="looming-disk",
        speed=_SPEED,
    )  # fmt: skip


looming_centre = functools.partial(_figure, "looming-centre", _CENTRE)
looming_off_centre = functools.partial(_figure, "looming-off-centre", _OFF_CENTRE)


def _claims(
    protocol: Protocol, by_speed: dict[float, Shown], settings: dict[str, Settings]
) -> Iterator[Claim]:
    """Yield the statements on the disk; only that in the middle has peaks in the paper."""

    def claim(name: str, judge: Judge, detectors: Iterable[str], **values: object) -> Claim:
        findings = {
            preset: _finding_at(judge, detectors, preset, by_speed, settings[preset])
            for preset in PAPER_PRESETS
        }
        return Claim.of(name, findings, **values)

    for name, frame in _PAPER.items() if protocol.name == _CENTRE else ():
        label = detector_named(name).label
        near = functools.partial(_near, name)
        yield claim("disk-peak", near, [name], label=label, frame=frame, speed=_SPEED)
    yield claim("disk-earlier", _earlier, _PAPER)
    yield claim("disk-stronger", _stronger, _PAPER)
    centre = Projection.of(protocol.display).to_px(*protocol.objects[0].centre_deg)
    yield claim("disk-place", functools.partial(_place, centre), ["opplod"])


def _shown_at(stimulus: str, speed: float, settings: dict[str, Settings]) -> Shown:
    """Show the disk at a speed of its edge in px/frame."""
    protocol = load(stimulus)
    per_second = speed * float(protocol.display.frame_rate) / protocol.display.scale
    protocol = load(stimulus, {"disk.growth.speed_deg_s": per_second})
    return {preset: present(protocol, each) for preset, each in settings.items()}


def _finding_at(
    judge: Judge,
    detectors: Iterable[str],
    preset: str,
    by_speed: dict[float, Shown],
    settings: Settings,
) -> Finding:
    """Return the finding at the chosen speed; its text has the verdicts at other speeds."""
    chosen = by_speed[_SPEED][preset]
    finding = judge(chosen)
    speeds: dict[Verdict, list[str]] = {verdict: [] for verdict in Verdict}
    for speed, shown in by_speed.items():
        if speed != _SPEED:
            speeds[judge(shown[preset]).verdict].append(f"{speed:g}")
    others = "; ".join(f"{verdict} at {', '.join(at)}" for verdict, at in speeds.items() if at)
    faint = (faint_note(name, [chosen[name]], settings, "to the disk") for name in detectors)
    return replace(
        finding,
        text=f"{finding.text} At other speeds of the disk: {others} px/frame.",
        faint=" ".join(filter(None, faint)),
    )


def _frame_of_peak(responses: Responses) -> int:
    return int(responses.frame[responses.peak or 0])


def _near(detector: str, by_detector: dict[str, Responses]) -> Finding:
    paper, peak = _PAPER[detector], _frame_of_peak(by_detector[detector])
    last = ", the last one" * (peak == int(by_detector[detector].frame[-1]))
    return Finding(
        f"{detector_named(detector).label} peaks at frame {peak}{last}; the paper says {paper}.",
        Verdict.at_most(abs(peak - paper), 1, 3),
        {"peak_frame": peak, "paper_frame": paper},
    )


def _earlier(by_detector: dict[str, Responses]) -> Finding:
    onset = {
        name: int(shown.frame[np.argmax(shown.response >= _EARLY * shown.largest)])
        for name, shown in by_detector.items()
    }
    peak = {name: _frame_of_peak(responses) for name, responses in by_detector.items()}
    known = {name: shown.frame[np.isfinite(shown.response)] for name, shown in by_detector.items()}
    words = {
        name: "at or before frame" if frame == known[name][0] else "at frame"
        for name, frame in onset.items()
    }
    earlier = sum(at["opplod"] < at["dlgmd"] for at in (onset, peak))
    return Finding(
        f"OppLoD reaches 10 % of its peak {words['opplod']} {onset['opplod']}, D-LGMD "
        f"{words['dlgmd']} {onset['dlgmd']}; they peak at {peak['opplod']} and {peak['dlgmd']}.",
        (Verdict.DOES_NOT, Verdict.IN_PART, Verdict.HOLDS)[earlier],
        {f"{name}_onset_frame": frame for name, frame in onset.items()},
    )


def _stronger(by_detector: dict[str, Responses]) -> Finding:
    until = (by_detector["opplod"].peak or 0) + 1
    opplod, dlgmd = (
        by_detector[name].response[:until] / (by_detector[name].largest or 1.0)
        for name in ("opplod", "dlgmd")
    )
    known = np.isfinite(opplod) & np.isfinite(dlgmd)
    share = float(np.mean(opplod[known] > dlgmd[known])) if known.any() else np.nan
    return Finding(
        f"Divided by its own peak, OppLoD's response is above that of D-LGMD in "
        f"{100 * share:.0f} % of the frames up to OppLoD's peak.",
        Verdict.at_least(share, 0.9, 0.5),
        {"share_above": share},
    )


def _place(centre: tuple[float, float], by_detector: dict[str, Responses]) -> Finding:
    responses = by_detector["opplod"]
    distance = float(np.hypot(*(responses.centre[responses.peak or 0] - centre)))
    return Finding(
        f"At the peak the winning unit is {distance:.0f} px from the disk's centre.",
        Verdict.at_most(distance, 10, 50),
        {"distance_px": distance},
    )


def _draw(protocol: Protocol, shown: Shown, paper: dict[str, int]) -> Figure:
    renderer = Renderer(protocol)
    with styled_figure(WIDE, 4.3) as figure:
        axes = figure.subplots(2, 2, width_ratios=[2, 1])
        for (curves, still), (preset, each) in zip(axes, shown.items(), strict=True):
            for (name, responses), dash in zip(each.items(), DASHES, strict=False):
                peak, colour = responses.peak or 0, detector_named(name).colour
                over = responses.response[peak]
                label = f"{detector_named(name).label}, peak {over:.3g}"
                look = {"color": colour, "linestyle": dash, "label": label}
                curves.plot(responses.frame, responses.response / over, **look)
                curves.plot(responses.frame[peak], 1, "o", mfc="none", mec=colour, clip_on=False)
            for name, frame in paper.items():
                curves.axvline(frame, color=detector_named(name).colour, lw=0.8, linestyle=":")
            curves.set(
                title=TITLES[preset], xlabel="frame" + " (dotted: the paper's peaks)" * bool(paper)
            )
            curves.set(ylabel="response / peak", ylim=(-0.03, 1.08))
            curves.legend(loc="upper left")
            responses = each["opplod"]
            frame = _frame_of_peak(responses)
            still.imshow(renderer.grey(frame), cmap="gray", vmin=-80, vmax=255)
            left, top, width, height = responses.box[responses.peak or 0]
            still.add_patch(Rectangle((left, top), width, height, fill=False, ec="red", lw=1.4))
            still.set_title(f"frame {frame}, winning field")
            still.set(xlabel="x (px)", ylabel="y (px)")
    return figure


def thresholds() -> Built:
    """Compare when the detectors first exceed their largest response to the controls."""
    controls, looming = (
        {preset: _shown(preset, stimuli) for preset in PAPER_PRESETS}
        for stimuli in (_CONTROLS, _LOOMING)
    )
    worst = {preset: _worst(controls[preset]) for preset in PAPER_PRESETS}
    threshold = {
        preset: {detector: value for detector, (_, value) in each.items()}
        for preset, each in worst.items()
    }
    first = {preset: _crossings(looming[preset], threshold[preset]) for preset in PAPER_PRESETS}
    findings = {preset: _finding(first[preset], threshold[preset]) for preset in PAPER_PRESETS}
    return Built.of(
        "thresholds",
        [Claim.of("first-crossing", findings)],
        _draw_first(first),
        (
            {
                "preset": preset, "detector": detector, "stimulus": name, "kind": kind,
                "peak": each[detector].largest, "threshold": threshold[preset][detector],
                "first_crossing_s": first[preset].get(name, {}).get(detector),
            }
            for preset in PAPER_PRESETS
            for kind, shown in (("looming", looming[preset]), ("control", controls[preset]))
            for name, each in shown.items()
            for detector in _DETECTORS
        ),
        settings={preset: described_settings(settings_of(preset)) for preset in PAPER_PRESETS},
        notes=(
            f"{TITLES[preset].capitalize()}: the threshold of {detector_named(detector).label} "
            f"is its response to {name} ({short(value)})."
            for preset, each in worst.items()
            for detector, (name, value) in each.items()
        ),
        controls=len(controls[STUDY_PRESET]),
        kinds=len(_CONTROLS),
    )  # fmt: skip


def _shown(preset: str, stimuli: Changes) -> Shown:
    settings = settings_of(preset)
    made: Shown = {}
    for name, changes in stimuli.items():
        made |= presented(name, settings, changes)
    return made


def _worst(controls: Shown) -> dict[str, tuple[str, float]]:
    """Return the control with the largest response, and that response, by detector."""
    return {
        detector: max(
            ((name, each[detector].largest) for name, each in controls.items()),
            key=lambda pair: pair[1],
        )
        for detector in _DETECTORS
    }


def _crossings(looming: Shown, threshold: dict[str, float]) -> First:
    """Return the time at which each detector first exceeds its threshold, in s."""
    first: First = {}
    for name, each in looming.items():
        first[name] = {}
        for detector, least in threshold.items():
            times = each[detector].time_s[each[detector].response > least]
            first[name][detector] = float(times[0]) if times.size else math.inf
    return first


def _finding(first: First, threshold: dict[str, float]) -> Finding:
    pairs = [(each["opplod"], each["dlgmd"]) for each in first.values()]
    earlier = sum(opplod < dlgmd for opplod, dlgmd in pairs)
    later = sum(dlgmd < opplod for opplod, dlgmd in pairs)
    missed = [times.count(math.inf) for times in zip(*pairs, strict=True)]
    share = earlier / len(pairs)
    neither = [_short(name) for name, each in first.items() if min(each.values()) == math.inf]
    both = f" Both miss: {'; '.join(neither)}." if neither else ""
    return Finding(
        f"OppLoD is first in {earlier}, D-LGMD in {later} of {len(pairs)} looming stimuli; "
        f"OppLoD misses {missed[0]}, D-LGMD {missed[1]}.{both}",
        Verdict.at_least(share, 0.9, 0.5),
        {
            "opplod_first": earlier,
            "dlgmd_first": later,
            "stimuli": len(pairs),
            "opplod_missed": missed[0],
            "dlgmd_missed": missed[1],
            **{f"{name}_threshold": value for name, value in threshold.items()},
        },
    )


def _draw_first(first: dict[str, First]) -> Figure:
    names = list(next(iter(first.values())))
    with styled_figure(WIDE, 0.9 + 0.21 * len(names)) as figure:
        axes = figure.subplots(1, len(first), sharey=True)
        for panel, (preset, each) in zip(axes, first.items(), strict=True):
            _draw_crossings(panel, each)
            panel.set(title=TITLES[preset], xlabel="first crossing (s)")
        axes[0].set_yticks(range(len(names)), [_short(name) for name in names])
        axes[0].invert_yaxis()
        figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=2)
    return figure


def _short(name: str) -> str:
    short = name.partition("/")[2].replace("looming-disk-", "disk of the paper, ")
    return short.replace("loom-speed/speed-", "loom, speed ").replace(
        "loom-l-over-v/l-over-v-", "loom, l/v "
    )


def _draw_crossings(axes: Axes, first: First) -> None:
    table = np.array([[each[name] for name in _DETECTORS] for each in first.values()])
    last = 1.05 * (np.max(table, where=np.isfinite(table), initial=0) or 1.0)
    end = 1.2 * last
    for times, name, marker, shift in zip(table.T, _DETECTORS, "os", (-0.12, 0.12), strict=True):
        detector, places = detector_named(name), np.arange(len(times)) + shift
        crossed = np.isfinite(times)
        axes.plot(times[crossed], places[crossed], marker,
                  color=detector.colour, markersize=4, label=detector.label)  # fmt: skip
        # In a strip of their own: at the end of the time axis they would look like late alarms.
        axes.plot(np.full(np.sum(~crossed), (last + end) / 2), places[~crossed], "x",
                  color=detector.colour, ms=4)  # fmt: skip
    axes.axvspan(last, end, color=FAINT, alpha=0.25, lw=0)
    axes.annotate("no alarm", ((last + end) / 2, 1), xycoords=("data", "axes fraction"),
                  ha="center", va="bottom", fontsize=6, color=INK)  # fmt: skip
    axes.grid(axis="y", color=FAINT, lw=0.3)
    axes.set_xlim(0, end)
    axes.set_xticks([tick for tick in axes.get_xticks() if 0 <= tick <= last])
