"""Runs a sweep, writes the table of the measures, and finds the curves that mean little."""

from __future__ import annotations

import math
from dataclasses import asdict
from functools import partial
from itertools import chain
from operator import attrgetter
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from oppload_cli.environment import environment
from oppload_cli.errors import faults_at
from oppload_cli.files.tables import csv_text
from oppload_cli.models.opplod_lplc2 import OpplodLplc2Params
from oppload_cli.models.registry import (
    detector_named,
    is_rounding_error,
    least_response_of,
    parameters_of,
)
from oppload_cli.pipeline.sources import StimulusVideo
from oppload_cli.processes.pool import results
from oppload_cli.results.tuning import direction_of
from oppload_cli.schema import parsed_fraction
from oppload_cli.stimulus.kinematics import ROUNDING_S
from oppload_cli.stimulus.renderer import Renderer
from oppload_cli.stimulus.staging import camera_of
from oppload_cli.stimulus.truth import frame_truth
from oppload_cli.tuning.present import Condition, Measures, measure, present, seen_in

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from oppload_cli.files.tables import Cell
    from oppload_cli.pipeline.settings import Settings
    from oppload_cli.schema import Parameters
    from oppload_cli.stimulus.catalogue import Entry
    from oppload_cli.stimulus.protocol import Protocol
    from oppload_cli.tuning.sweeps import Sweep


_SCHEMA = "oppload.tuning/1"
_PRESENTATION = "presentation"  # column of the number of a presentation in a row
_FAINT = 0.1  # of the floor of the alarm; a detector with smaller responses hardly responds
_ONSET_INTERVALS = 2.5  # of 1/30 s: two intervals, and half an interval for a late frame
_ONSET_S = _ONSET_INTERVALS / 30
_ONE_UNIT = "1x1"


def tune(
    sweep: Sweep,
    *,
    indicator_s: float = 0.0,
    jobs: int = 1,
    progress: Callable[[], object] | None = None,
) -> list[Condition]:
    """Measure every condition of a sweep.

    Parameters
    ----------
    sweep : Sweep
        The stimulus with its sweep, the settings of the detectors, and the number of presentations
        in a row. If the number is above 1, each presentation is a condition.
    indicator_s : float
        Time constant in s of a calcium indicator that shows the responses; 0 for none.
    jobs : int
        Number of processes; the result does not depend on it.
    progress : callable, optional
        Called after each stimulus.

    Returns
    -------
    list of Condition
        The conditions in the order of the sweep.

    Raises
    ------
    StimulusError
        If a stimulus is not valid with one of the values.
    ParameterError
        If the working size is too large.
    OutputError
        If the system ends one of the processes, for example because memory runs out.
    """
    by_stimulus = results(
        partial(_measured, sweep.settings, sweep.presentations, indicator_s),
        sweep.entry.protocols(),
        jobs,
        named=attrgetter("name"),
        progress=lambda _: progress() if progress else None,
    )
    conditions = []
    for (stimulus, swept), presented in zip(sweep.entry.values().items(), by_stimulus, strict=True):
        for number, measures in enumerate(presented, 1):
            name, values = stimulus, swept
            if sweep.presentations > 1:
                name = f"{stimulus}/{_PRESENTATION}-{number}"
                values = {**swept, _PRESENTATION: number}
            conditions.append(Condition(name, values, measures))
    return conditions


def _measured(
    settings: Settings, presentations: int, indicator_s: float, protocol: Protocol
) -> list[dict[str, Measures]]:
    """Return the measures of each presentation of a stimulus, by detector."""
    with faults_at(protocol.name):
        responses = present(protocol, settings, presentations, indicator_s)
    parts = {
        detector: [response] if presentations == 1 else response.presentations(protocol)
        for detector, response in responses.items()
    }
    return [
        {detector: measure(part[number], protocol) for detector, part in parts.items()}
        for number in range(presentations)
    ]


def _is_symmetric(entry: Entry) -> bool:
    """Return whether the stimulus looks the same after half a turn of the swept direction.

    The frames at one third and at two thirds of each motion decide this. For such a stimulus, for
    example a bar that grows at both ends, half a circle of directions is the complete tuning.
    """
    direction = direction_of(list(entry.sweep))
    if direction is None:
        return False
    angle = entry.sweep[direction][0]
    settings = ({direction: angle}, {direction: angle + 180})
    protocols = [entry.with_settings(turned).protocols()[0] for turned in settings]
    original, turned = map(Renderer, protocols)
    protocol = protocols[0]
    timing, rate = protocol.timing, float(protocol.display.frame_rate)
    spans = {(timing.before_s, timing.end_s)}
    spans |= {protocol.motion_of(drawn) for drawn in protocol.objects}
    times = (start + share * (end - start) for start, end in spans for share in (1 / 3, 2 / 3))
    frames = {min(round(time * rate), protocol.frame_count - 1) for time in times}
    # Rounding may change a pixel on an edge by a grey level.
    return all(
        int(np.abs(original.grey(frame).astype(int) - turned.grey(frame).astype(int)).max()) <= 2
        for frame in frames
    )


def tuning_text(conditions: Sequence[Condition]) -> str:
    """Return the table of a sweep as the text of a CSV file."""
    rows = [
        {
            "stimulus": condition.stimulus,
            **_cells(condition.values),
            "model": detector,
            **asdict(measures),
        }
        for condition in conditions
        for detector, measures in condition.measures.items()
    ]
    return csv_text(rows, rows[0])


def tuning_sidecar(
    sweep: Sweep, *, command: Sequence[str], indicator_s: float = 0.0, doubts: Sequence[Doubt] = ()
) -> dict[str, Any]:
    """Return the content of the sidecar of a tuning table, without the numbers of its curves.

    Parameters
    ----------
    sweep : Sweep
        The stimulus with its sweep, and the settings of the detectors.
    command : sequence of str
        The command line.
    indicator_s : float
        As for :func:`tune`.
    doubts : sequence of Doubt
        The reasons why curves mean little; figures show them.
    """
    entry, settings = sweep.entry.with_changes_described(), sweep.settings
    first = entry.protocols()[0]
    video = StimulusVideo(first, settings.pixels, others=settings.other_heights)
    height = min(video.working.shape)
    resolved = seen_in(video, settings.with_all_detectors()).resolved(height)
    content = {
        "schema": _SCHEMA,
        "tool": environment(),
        "command": list(command),
        "models": list(settings.models),
        "height": settings.height,
        "parameters": {name: params.as_dict() for name, params in resolved.items()},
        "changed": _changed(settings, resolved, height),
        "sizes_deg": settings.angles,
        "indicator_s": indicator_s,
        "doubts": [{"model": doubt.detector, "note": doubt.note} for doubt in doubts],
        "summary": {},
        "stimulus": {
            "name": entry.name,
            "description": entry.description,
            "sweep": entry.sweep,
            "changes": dict(sweep.changes),
            "symmetric": _is_symmetric(entry),
            "first": first.as_table(),
        },
    }
    return content | ({"figure": dict(sweep.figure)} if sweep.figure else {})


def _changed(settings: Settings, resolved: Mapping[str, Parameters], height: int) -> dict[str, Any]:
    """Return the parameters of the measured detectors that differ from the defaults.

    `height` is the working height, for which the parameters are `resolved`.
    """
    usual = {
        name: parameters_of(name).resolved(settings.height_of(name, height)).as_dict()
        for name in settings.models
    }
    changed: dict[str, Any] = {}
    for key in settings.origins:
        group, _, name = key.partition(".")
        if group in settings.models and name:
            angle = settings.angles.get(key)
            value = resolved[group].as_dict().get(name)
            if angle is not None or value != usual[group].get(name):
                changed[key] = value if angle is None else f"{angle:g}deg"
    return changed


def _cells(values: dict[str, Any]) -> dict[str, Cell]:
    """Return the values of a condition by column; a position or a direction becomes two columns."""
    cells: dict[str, Cell] = {}
    for key, value in values.items():
        if key.endswith((".centre_deg", ".bearing_deg")):
            cells[f"{key}.right"], cells[f"{key}.up"] = value
        elif key.endswith(".frame_rate"):  # a number, or a fraction as text
            cells[key] = float(parsed_fraction(str(value)))
        else:
            number = isinstance(value, int | float) and not isinstance(value, bool)
            cells[key] = value if number else str(value)
    return cells


# ---- Doubts: why a curve means little ----------------------------------------------------------


class Doubt(NamedTuple):
    """Why the curve of a detector means little."""

    detector: str
    note: str  # in a few words, for the legend of a figure
    text: str  # a sentence with the numbers and advice


def doubts_about(
    conditions: Sequence[Condition], sweep: Sweep, indicator_s: float = 0.0
) -> Iterator[Doubt]:
    """Yield the detectors whose curves over a sweep mean little, with the reasons.

    `conditions` is what :func:`tune` returned for the other arguments.
    """
    protocols, settings = sweep.entry.protocols(), sweep.settings
    if not indicator_s:  # an indicator makes each peak smaller, and the floors do not regard it
        peaks = {
            name: max(condition.measures[name].peak or 0 for condition in conditions)
            for name in settings.models
        }
        yield from faint(peaks, settings)
    if sweep.presentations == 1:
        yield from _to_onset(conditions, protocols)
        yield from _within_warm_up(conditions, protocols)
        yield from _cut_off_by_end(conditions, protocols)
        if not indicator_s:  # with one, a peak may come at the end of any motion
            yield from _to_vanishing(conditions, protocols)
    yield from _unlike_neurons(settings, indicator_s)


def faint(peaks: Mapping[str, float], settings: Settings) -> Iterator[Doubt]:
    """Yield the detectors that hardly respond: the shapes of their curves mean little.

    `peaks` has the largest response of each detector without an indicator.
    """
    advice = "try other speeds, or another detector ('oppload models')"
    for name, peak in peaks.items():
        floor, label = least_response_of(name), detector_named(name).label
        alarmed = name in settings.with_alarm
        floor_of = "the floor of its alarm" if alarmed else "its least response of an object"
        if is_rounding_error(peak, floor):
            yield Doubt(
                name,
                "below a millionth of its floor",
                f"{label} does not respond to this stimulus: its largest response is below a "
                f"millionth of {floor_of}, {floor:g}, and may be a rounding error; {advice}",
            )
        elif peak < _FAINT * floor:
            yield Doubt(
                name,
                "below a tenth of its floor",
                f"{label} hardly responds to this stimulus: its largest response, {peak:.2g}, is "
                f"below a tenth of {floor_of}, {floor:g}, so that its shape means little; "
                f"{advice}",
            )


def _to_onset(conditions: Sequence[Condition], protocols: Sequence[Protocol]) -> Iterator[Doubt]:
    """Yield the detectors that respond to the start of the motion, or to noise before it.

    Any motion that starts excites these detectors, because nothing moved before. So the peak at the
    start of the motion shows no tuning. Without a pause before the motion, a detector with a long
    warm-up has no response to this start; the others respond to it all the same.
    """
    pauses = [_pause(protocol) for protocol in protocols]
    keys = dict.fromkeys(key for _, named in pauses for key in named)
    advice = f"; {' and '.join(f'--change {key}=0' for key in keys)} leaves the pause before it out"
    for name in conditions[0].measures:
        times = [condition.measures[name].peak_time_s for condition in conditions]
        since_s = [
            math.inf if time_s is None else time_s - start_s
            for (start_s, _), time_s in zip(pauses, times, strict=True)
        ]
        yield from _about_peaks(
            name,
            [peak_s <= -ROUNDING_S for peak_s in since_s],
            "before the motion: no tuning",
            "come before the start of the motion: they are no responses to it, and show no tuning",
        )
        early = [-ROUNDING_S < peak_s < _ONSET_S for peak_s in since_s]
        helps = keys and detector_named(name).warm_up > _ONSET_INTERVALS
        yield from _about_peaks(
            name,
            early,
            "at the start of the motion: no tuning",
            f"come within {_ONSET_S:.2g} s after the start of the motion: they are responses to "
            f"this start, and show no tuning{advice if helps else ''}",
        )


def _about_peaks(name: str, doubted: Sequence[bool], note: str, text: str) -> Iterator[Doubt]:
    """Yield a doubt if some peaks of a detector, of which each condition has one, mean nothing."""
    if any(doubted):
        part = f"{sum(doubted)} of {len(doubted)} peaks"
        label = detector_named(name).label
        yield Doubt(name, f"{part} {note}", f"{label}: {part} {text}")


def _within_warm_up(
    conditions: Sequence[Condition], protocols: Sequence[Protocol]
) -> Iterator[Doubt]:
    """Yield the detectors that see only the end of the motion, or nothing of it.

    A detector with a long warm-up does not respond to the first intervals of a motion. If these are
    more than half of the motion, a peak of 0, or one in the first frame with a response, depends on
    the warm-up.
    """
    for name in conditions[0].measures:
        warm_up = detector_named(name).warm_up
        first_s = warm_up / 30
        if warm_up <= _ONSET_INTERVALS:
            continue
        missed = []
        for condition, protocol in zip(conditions, protocols, strict=True):
            measures, start_s = condition.measures[name], _pause(protocol)[0]
            late = measures.peak_time_s is None or (
                measures.onset_frame == measures.peak_frame
                and _ONSET_S <= measures.peak_time_s - start_s < first_s + 1 / 30
            )
            missed.append(late and 0 < _motion_end(protocol) - start_s < 2 * first_s)
        yield from _about_peaks(
            name,
            missed,
            "cut off by the warm-up: no tuning",
            f"are 0 or its first response, because it responds only from {first_s:.2g} s after the "
            "start of the motion on, when more than half of the motion is over: they show no "
            "tuning; choose a slower or longer motion",
        )


def _cut_off_by_end(
    conditions: Sequence[Condition], protocols: Sequence[Protocol]
) -> Iterator[Doubt]:
    """Yield the detectors whose response might have grown further, but the stimulus ends."""
    changing = [_changes_size_at_end(protocol) for protocol in protocols]
    approaches = [obj.growth or obj.course for protocol in protocols for obj in protocol.objects]
    stated = any(approach and approach.contact_s for approach in approaches)
    key = "timing.motion_s" if stated else "timing.after_s"
    for name in conditions[0].measures:
        last = [
            changes and condition.measures[name].peak_frame == protocol.frame_count - 1
            for changes, condition, protocol in zip(changing, conditions, protocols, strict=True)
        ]
        yield from _about_peaks(
            name,
            last,
            "in the last frame: cut off",
            "come in the last frame, while an object still grows or shrinks: a later and larger "
            f"peak cannot be seen; give a larger {key}",
        )


def _changes_size_at_end(protocol: Protocol) -> bool:
    """Return whether the size of an object changes up to the last frame."""
    last = protocol.frame_count - 1
    before, after = (frame_truth(protocol, max(frame, 0)).objects for frame in (last - 1, last))
    return any(
        one.visible and one.angular_size_deg != other.angular_size_deg
        for one, other in zip(after, before, strict=True)
    )


def _motion_end(protocol: Protocol) -> float:
    """Return when the last object stops, in seconds of the clip; 0 if none moves."""
    step_s = 1 / float(protocol.display.frame_rate)
    truths = (frame_truth(protocol, index) for index in range(protocol.frame_count))
    moving = [
        truth.time_s for truth in truths if any(obj.edge_speed_deg_s for obj in truth.objects)
    ]
    return moving[-1] + step_s if moving else 0.0


def _pause(protocol: Protocol) -> tuple[float, list[str]]:
    """Return the seconds before the first motion, and the keys of the protocol that set them."""
    before_s = protocol.timing.before_s
    keys = ["timing.before_s"] if before_s else []
    moving = [obj for obj in protocol.objects if obj.motion or obj.growth or obj.course]
    if protocol.scene.motion or camera_of(protocol).moves or not moving:
        return before_s, keys
    onset_s = min(obj.onset_s for obj in moving)
    first = [obj for obj in moving if onset_s and obj.onset_s == onset_s]
    return before_s + onset_s, keys + [f"{obj.id}.onset_s" for obj in first]


def _to_vanishing(
    conditions: Sequence[Condition], protocols: Sequence[Protocol]
) -> Iterator[Doubt]:
    """Yield the detectors that respond to an object that vanishes, which is no motion."""
    vanishing = [_vanishing(protocol) for protocol in protocols]
    advice = " and ".join(f"--change {key}=never" for key in dict.fromkeys(chain(*vanishing)))
    for name in conditions[0].measures:
        times = [condition.measures[name].peak_time_s for condition in conditions]
        late = [
            time_s is not None
            and any(-ROUNDING_S < time_s - end_s < _ONSET_S for end_s in ends.values())
            for ends, time_s in zip(vanishing, times, strict=True)
        ]
        yield from _about_peaks(
            name,
            late,
            "when an object vanishes: no tuning",
            f"come within {_ONSET_S:.2g} s after an object has vanished: they are responses to "
            f"this, and show no tuning; {advice} keeps the object",
        )


def _vanishing(protocol: Protocol) -> dict[str, float]:
    """Return when objects vanish, in s, by the keys of the protocol that say so."""
    return {
        f"{obj.id}.vanishes": protocol.motion_of(obj)[1]
        for obj in protocol.objects
        if obj.vanishes != "never"
    }


def _unlike_neurons(settings: Settings, indicator_s: float) -> Iterator[Doubt]:
    """Yield the detectors that model LPLC2 neurons, but are not measured as the neurons were.

    The neurons were recorded one at a time, with a calcium indicator (``docs/lplc2.md``). Without
    an indicator, the peak is that of the first transient; with many units, the strongest one gives
    the peak. Each of these makes the responses to bars several times as large.
    """
    for name in settings.models:
        params = settings.groups[name]
        if not isinstance(params, OpplodLplc2Params):
            continue
        remedies = {}  # by cause
        if not indicator_s:
            remedies["no indicator"] = "--indicator 1"
        if params.units != _ONE_UNIT:
            remedies["more than one unit"] = f"--set {name}.units={_ONE_UNIT}"
        if remedies:
            cause = " and ".join(remedies)
            yield Doubt(
                name,
                f"{cause}: larger for bars than in LPLC2 neurons",
                f"{detector_named(name).label}: LPLC2 neurons were measured one at a time, with a "
                f"calcium indicator; with {cause}, the responses to bars are several times as "
                f"large as those of the neurons; add {' and '.join(remedies.values())}",
            )
