"""Figures of looming: disks with the winning unit, and first crossings of a threshold."""

from __future__ import annotations

import functools
import math
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from matplotlib.patches import Rectangle

from oppload_cli.models.registry import detector_named
from oppload_cli.plots.style import DASHES, FAINT, INK, styled_figure
from oppload_cli.reproduction.claims import (
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
from oppload_cli.stimulus.catalogue import load
from oppload_cli.stimulus.geometry import Projection
from oppload_cli.stimulus.renderer import Renderer
from oppload_cli.tuning.present import Responses, present

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping

    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from oppload_cli.pipeline.settings import Settings
    from oppload_cli.stimulus.protocol import Protocol

    Shown = dict[str, dict[str, Responses]]  # by stimulus and detector
    Pairs = dict[str, "_Pair"]  # by version of OppLoD
    Judge = Callable[["_Pair"], Finding]
    First = dict[str, dict[str, float]]  # by stimulus and detector, in s; infinite for never
    Changes = Mapping[str, Mapping[str, float | list[int]]]  # by stimulus and key


_CENTRE, _OFF_CENTRE = "opplod2023/looming-disk-centre", "opplod2023/looming-disk-off-centre"
# The paper's field of 200 px, as the disk is shown at its native size.
_FIELD = {f"{REFERENCE}.receptive_field": 200, f"{REFERENCE}.cell": 10}
_MODELS = _OPPLOD, _BASELINE = "OppLoD", "D-LGMD"  # which the paper compares
_DLGMD = "dlgmd"  # the detector beside each version of OppLoD
# Frames of the peaks, which the paper gives for one disk.
_PAPER_PEAKS = {_OPPLOD: 22, _BASELINE: 43}
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


class _Pair(NamedTuple):
    """The responses of a version of OppLoD, and of D-LGMD beside it, to one stimulus."""

    detector: str  # the version of OppLoD
    opplod: Responses
    dlgmd: Responses

    def of(self, model: str) -> tuple[str, Responses]:
        """Return the detector of one of `_MODELS`, and its responses."""
        return (self.detector, self.opplod) if model == _OPPLOD else (_DLGMD, self.dlgmd)

    @property
    def label(self) -> str:
        """The label of the version of OppLoD."""
        return detector_named(self.detector).label


def _figure(name: str, stimulus: str) -> Built:
    settings = {
        detector: settings_of(detector, _FIELD, height="native", beside=_DLGMD)
        for detector in PAPER_DETECTORS
    }
    by_speed = {speed: _pairs_at(stimulus, speed, settings) for speed in _SPEEDS}
    pairs, protocol = by_speed[_SPEED], load(stimulus)
    return Built.of(
        name,
        _claims(protocol, by_speed, settings),
        _draw(protocol, pairs, _PAPER_PEAKS if stimulus == _CENTRE else {}),
        (
            {
                "detector": detector, "frame": frame, "time_s": time, "response": response,
                "dlgmd_response": beside,
            }
            for detector, pair in pairs.items()
            for frame, time, response, beside in zip(
                pair.opplod.frame, pair.opplod.time_s, pair.opplod.response, pair.dlgmd.response,
                strict=True,
            )
        ),
        settings={detector: described_settings(own) for detector, own in settings.items()},
        shared="looming-disk",
        speed=_SPEED,
    )  # fmt: skip


looming_centre = functools.partial(_figure, "looming-centre", _CENTRE)
looming_off_centre = functools.partial(_figure, "looming-off-centre", _OFF_CENTRE)


def _claims(
    protocol: Protocol, by_speed: dict[float, Pairs], settings: dict[str, Settings]
) -> Iterator[Claim]:
    """Yield the statements on the disk; only that in the middle has peaks in the paper."""

    def claim(name: str, judge: Judge, models: Iterable[str], **values: object) -> Claim:
        findings = {
            detector: _finding_at(judge, models, detector, by_speed, own)
            for detector, own in settings.items()
        }
        return Claim.of(name, findings, **values)

    for model, frame in _PAPER_PEAKS.items() if protocol.name == _CENTRE else ():
        near = functools.partial(_near, model)
        yield claim("disk-peak", near, [model], model=model, frame=frame, speed=_SPEED)
    yield claim("disk-earlier", _earlier, _MODELS)
    yield claim("disk-stronger", _stronger, _MODELS)
    centre = Projection.of(protocol.display).to_px(*protocol.objects[0].centre_deg)
    yield claim("disk-place", functools.partial(_place, centre), [_OPPLOD])


def _pairs_at(stimulus: str, speed: float, settings: dict[str, Settings]) -> Pairs:
    """Show the disk at a speed of its edge in px/frame."""
    protocol = load(stimulus)
    per_second = speed * float(protocol.display.frame_rate) / protocol.display.scale
    protocol = load(stimulus, {"disk.growth.speed_deg_s": per_second})
    pairs = {}
    for detector, own in settings.items():
        shown = present(protocol, own)
        pairs[detector] = _Pair(detector, shown[detector], shown[_DLGMD])
    return pairs


def _finding_at(
    judge: Judge,
    models: Iterable[str],
    detector: str,
    by_speed: dict[float, Pairs],
    settings: Settings,
) -> Finding:
    """Return the finding at the chosen speed; its text has the verdicts at other speeds."""
    chosen = by_speed[_SPEED][detector]
    finding = judge(chosen)
    speeds: dict[ClaimVerdict, list[str]] = {verdict: [] for verdict in ClaimVerdict}
    for speed, pairs in by_speed.items():
        if speed != _SPEED:
            speeds[judge(pairs[detector]).verdict].append(f"{speed:g}")
    others = "; ".join(f"{verdict} at {', '.join(at)}" for verdict, at in speeds.items() if at)
    faint = (
        faint_note(name, [responses], settings, "to the disk")
        for name, responses in map(chosen.of, models)
    )
    return replace(
        finding,
        text=f"{finding.text} At other speeds of the disk: {others} px/frame.",
        faint=" ".join(filter(None, faint)),
    )


def _frame_of_peak(responses: Responses) -> int:
    return int(responses.frame[responses.peak or 0])


def _near(model: str, pair: _Pair) -> Finding:
    name, responses = pair.of(model)
    paper, peak = _PAPER_PEAKS[model], _frame_of_peak(responses)
    last = ", the last one" * (peak == int(responses.frame[-1]))
    return Finding(
        f"{detector_named(name).label} peaks at frame {peak}{last}; the paper says {paper}.",
        ClaimVerdict.at_most(abs(peak - paper), 1, 3),
        {"peak_frame": peak, "paper_frame": paper},
    )


def _earlier(pair: _Pair) -> Finding:
    both = pair.opplod, pair.dlgmd
    onset = [
        int(shown.frame[np.argmax(shown.response >= _EARLY * shown.largest)]) for shown in both
    ]
    peak = [_frame_of_peak(shown) for shown in both]
    known = [shown.frame[np.isfinite(shown.response)] for shown in both]
    at = [
        f"{'at or before' if frame == frames[0] else 'at'} frame {frame}"
        for frame, frames in zip(onset, known, strict=True)
    ]
    earlier = (onset[0] < onset[1]) + (peak[0] < peak[1])
    return Finding(
        f"{pair.label} reaches 10 % of its peak {at[0]}, D-LGMD {at[1]}; they peak at {peak[0]} "
        f"and {peak[1]}.",
        (ClaimVerdict.DOES_NOT, ClaimVerdict.IN_PART, ClaimVerdict.HOLDS)[earlier],
        {"onset_frame": onset[0], "dlgmd_onset_frame": onset[1]},
    )


def _stronger(pair: _Pair) -> Finding:
    until = (pair.opplod.peak or 0) + 1
    opplod, dlgmd = (
        shown.response[:until] / (shown.largest or 1.0) for shown in (pair.opplod, pair.dlgmd)
    )
    known = np.isfinite(opplod) & np.isfinite(dlgmd)
    share = float(np.mean(opplod[known] > dlgmd[known])) if known.any() else np.nan
    return Finding(
        f"Divided by its own peak, the response of {pair.label} is above that of D-LGMD in "
        f"{100 * share:.0f} % of the frames up to this peak.",
        ClaimVerdict.at_least(share, 0.9, 0.5),
        {"share_above": share},
    )


def _place(centre: tuple[float, float], pair: _Pair) -> Finding:
    distance = float(np.hypot(*(pair.opplod.centre[pair.opplod.peak or 0] - centre)))
    return Finding(
        f"At the peak the winning unit is {distance:.0f} px from the disk's centre.",
        ClaimVerdict.at_most(distance, 10, 50),
        {"distance_px": distance},
    )


def _draw(protocol: Protocol, pairs: Pairs, paper: dict[str, int]) -> Figure:
    renderer = Renderer(protocol)
    with styled_figure(WIDE, 4.3) as figure:
        axes = figure.subplots(2, 2, width_ratios=[2, 1])
        for (curves, still), (detector, pair) in zip(axes, pairs.items(), strict=True):
            for (name, responses), dash in zip(map(pair.of, _MODELS), DASHES, strict=False):
                peak, colour = responses.peak or 0, detector_named(name).colour
                over = responses.response[peak]
                label = f"{detector_named(name).label}, peak {over:.3g}"
                look = {"color": colour, "linestyle": dash, "label": label}
                curves.plot(responses.frame, responses.response / over, **look)
                curves.plot(responses.frame[peak], 1, "o", mfc="none", mec=colour, clip_on=False)
            for model, frame in paper.items():
                colour = detector_named(pair.of(model)[0]).colour
                curves.axvline(frame, color=colour, lw=0.8, linestyle=":")
            curves.set(
                title=detector, xlabel="frame" + " (dotted: the paper's peaks)" * bool(paper)
            )
            curves.set(ylabel="response / peak", ylim=(-0.03, 1.08))
            curves.legend(loc="upper left")
            frame = _frame_of_peak(pair.opplod)
            still.imshow(renderer.grey(frame), cmap="gray", vmin=-80, vmax=255)
            left, top, width, height = pair.opplod.box[pair.opplod.peak or 0]
            still.add_patch(Rectangle((left, top), width, height, fill=False, ec="red", lw=1.4))
            still.set_title(f"frame {frame}, winning field")
            still.set(xlabel="x (px)", ylabel="y (px)")
    return figure


def thresholds() -> Built:
    """Compare when the detectors first exceed their largest response to the controls."""
    settings = {detector: settings_of(detector, beside=_DLGMD) for detector in PAPER_DETECTORS}
    controls, looming = (
        {detector: _shown(own, stimuli) for detector, own in settings.items()}
        for stimuli in (_CONTROLS, _LOOMING)
    )
    worst = {detector: _worst(shown) for detector, shown in controls.items()}
    threshold = {
        detector: {name: value for name, (_, value) in own.items()}
        for detector, own in worst.items()
    }
    first = {detector: _crossings(looming[detector], own) for detector, own in threshold.items()}
    findings = {detector: _finding(own, threshold[detector]) for detector, own in first.items()}
    return Built.of(
        "thresholds",
        [Claim.of("first-crossing", findings)],
        _draw_first(first),
        (
            {
                "detector": detector, "stimulus": stimulus, "kind": kind,
                **_cells(shown, threshold[detector], first[detector].get(stimulus, {})),
            }
            for detector in PAPER_DETECTORS
            for kind, by_stimulus in (("looming", looming), ("control", controls))
            for stimulus, shown in by_stimulus[detector].items()
        ),
        settings={detector: described_settings(own) for detector, own in settings.items()},
        notes=map(_note, worst.values()),
        controls=len(controls[REFERENCE]),
        kinds=len(_CONTROLS),
    )  # fmt: skip


def _cells(
    shown: dict[str, Responses], threshold: dict[str, float], first: dict[str, float]
) -> dict[str, float | None]:
    """Return the cells of a row of the table: those of D-LGMD have its name."""
    cells: dict[str, float | None] = {}
    for name, responses in shown.items():
        prefix = f"{_DLGMD}_" * (name == _DLGMD)
        cells[f"{prefix}peak"] = responses.largest
        cells[f"{prefix}threshold"] = threshold[name]
        cells[f"{prefix}first_crossing_s"] = first.get(name)
    return cells


def _note(worst: dict[str, tuple[str, float]]) -> str:
    """Return a sentence on the thresholds of a version of OppLoD and of D-LGMD beside it."""
    (label, own), (other, beside) = (
        (detector_named(name).label, f"its response to {control} ({short(value)})")
        for name, (control, value) in worst.items()
    )
    return f"The threshold of {label} is {own}. That of {other} beside it is {beside}."


def _shown(settings: Settings, stimuli: Changes) -> Shown:
    made: Shown = {}
    for name, changes in stimuli.items():
        made |= presented(name, settings, changes)
    return made


def _worst(controls: Shown) -> dict[str, tuple[str, float]]:
    """Return the control with the largest response, and that response, by detector."""
    return {
        detector: max(
            ((name, shown[detector].largest) for name, shown in controls.items()),
            key=lambda pair: pair[1],
        )
        for detector in next(iter(controls.values()))
    }


def _crossings(looming: Shown, threshold: dict[str, float]) -> First:
    """Return the time at which each detector first exceeds its threshold, in s."""
    first: First = {}
    for name, shown in looming.items():
        first[name] = {}
        for detector, least in threshold.items():
            times = shown[detector].time_s[shown[detector].response > least]
            first[name][detector] = float(times[0]) if times.size else math.inf
    return first


def _finding(first: First, threshold: dict[str, float]) -> Finding:
    """Return the finding on the first detector of `threshold`; the second one is D-LGMD."""
    (detector, own), (other, beside) = threshold.items()
    label, baseline = detector_named(detector).label, detector_named(other).label
    pairs = [(times[detector], times[other]) for times in first.values()]
    earlier = sum(opplod < dlgmd for opplod, dlgmd in pairs)
    later = sum(dlgmd < opplod for opplod, dlgmd in pairs)
    missed = [times.count(math.inf) for times in zip(*pairs, strict=True)]
    share = earlier / len(pairs)
    neither = [_short(name) for name, times in first.items() if min(times.values()) == math.inf]
    both = f" Both miss: {'; '.join(neither)}." if neither else ""
    return Finding(
        f"{label} is first in {earlier}, {baseline} in {later} of {len(pairs)} looming stimuli; "
        f"{label} misses {missed[0]}, {baseline} {missed[1]}.{both}",
        ClaimVerdict.at_least(share, 0.9, 0.5),
        {
            "first": earlier,
            "dlgmd_first": later,
            "stimuli": len(pairs),
            "missed": missed[0],
            "dlgmd_missed": missed[1],
            "threshold": own,
            "dlgmd_threshold": beside,
        },
    )


def _draw_first(first: dict[str, First]) -> Figure:
    names = list(next(iter(first.values())))
    with styled_figure(WIDE, 0.9 + 0.21 * len(names)) as figure:
        axes = figure.subplots(1, len(first), sharey=True)
        handles: dict[str, Artist] = {}
        for panel, (detector, own) in zip(axes, first.items(), strict=True):
            _draw_crossings(panel, own)
            panel.set(title=detector, xlabel="first crossing (s)")
            lines, labels = panel.get_legend_handles_labels()
            handles |= dict(zip(labels, lines, strict=True))
        axes[0].set_yticks(range(len(names)), [_short(name) for name in names])
        axes[0].invert_yaxis()
        figure.legend(
            list(handles.values()), list(handles), loc="outside lower center", ncols=len(handles)
        )
    return figure


def _short(name: str) -> str:
    short = name.partition("/")[2].replace("looming-disk-", "disk of the paper, ")
    return short.replace("loom-speed/speed-", "loom, speed ").replace(
        "loom-l-over-v/l-over-v-", "loom, l/v "
    )


def _draw_crossings(axes: Axes, first: First) -> None:
    names = list(next(iter(first.values())))
    table = np.array([[times[name] for name in names] for times in first.values()])
    last = 1.05 * (np.max(table, where=np.isfinite(table), initial=0) or 1.0)
    end = 1.2 * last
    for times, name, marker, shift in zip(table.T, names, "os", (-0.12, 0.12), strict=True):
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
