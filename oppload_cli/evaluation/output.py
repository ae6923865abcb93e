"""The files of an evaluation: tables, plots, ``report.json`` and the page."""

from __future__ import annotations

import json
import math
from itertools import combinations
from typing import TYPE_CHECKING, Any

from oppload_cli.environment import environment
from oppload_cli.evaluation.battery import BATTERY_COLUMNS, BatteryResponses, known
from oppload_cli.evaluation.detectors import full_label
from oppload_cli.evaluation.metrics.alarms import AT_ONE, HELD_OUT, RATES, SHIPPED, SILENCE_S
from oppload_cli.evaluation.metrics.clips import AHEAD, LEAST_S, WINDOW_S, Clip, Window, videos_of
from oppload_cli.evaluation.metrics.intervals import (
    LEVEL,
    RULE_OF_THREE,
    SEED,
    Measurement,
    split_of,
)
from oppload_cli.evaluation.metrics.measures import GROWN, KIND, NEAR_CONTACT
from oppload_cli.evaluation.page import NO_VALUE, number, page_of
from oppload_cli.evaluation.plots import PLOTS, battery_figure, figure_of
from oppload_cli.files.atomic import PartFile, output_errors, remove, write_atomic
from oppload_cli.files.tables import Cell, open_csv, plain_text
from oppload_cli.models.detector import Box
from oppload_cli.plots.style import image_bytes

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from oppload_cli.evaluation.engine import Evaluation


# The files name the column of detectors "contender", on which users' programs depend.
_COLUMNS = {
    "evaluation.csv": ("contender", *Measurement._fields[1:]),
    "responses.csv": (
        *("clip", "frame", "time_s", "contender", "response", "alarm"),
        *(*Box._fields, "evidence"),
    ),
    "windows.csv": (
        *("clip", "use", "frames_before_contact", "first_frame", "last_frame", "contender"),
        "score",
    ),
}
FILES = (*_COLUMNS, *PLOTS, "report.json", "evaluation.html")
BATTERY_FILES = ("battery.csv", "battery.png")
ALL_FILES = (*FILES, *BATTERY_FILES)


def write_evaluation(
    evaluation: Evaluation, folder: Path, claim: PartFile, wall_s: Callable[[], float]
) -> Iterator[Path]:
    """Write all files of an evaluation into a folder; yield each path after the file was written.

    Parameters
    ----------
    evaluation, folder
        The evaluation and the folder.
    claim : PartFile
        The part file of ``report.json``, which keeps other runs out of the folder.
    wall_s : callable
        Returns the seconds since the start, for ``timing`` in ``report.json``. Two runs over the
        same clips differ only in ``timing``.

    Raises
    ------
    OutputError
        If a file cannot be written.
    """
    report = report_of(evaluation)
    figures = {name: figure_of(name, evaluation.performances) for name in PLOTS}
    rows = map(_row, evaluation.measurements), _responses(evaluation), _windows(evaluation)
    tables = [(*named, of_table) for named, of_table in zip(_COLUMNS.items(), rows, strict=True)]
    if evaluation.battery:
        responses = BatteryResponses(evaluation.battery)
        tables.append(("battery.csv", BATTERY_COLUMNS, responses.rows()))
        figures["battery.png"] = battery_figure(responses)
    plots = {name: image_bytes(figure, "png", dpi=160) for name, figure in figures.items()}
    page = page_of(evaluation, report, plots)
    # All old files go first: a run that fails must not leave old files beside new ones.
    for name in ALL_FILES:
        with output_errors(folder / name):
            remove(folder / name)
    for name, columns, of_table in tables:
        with open_csv(folder / name, columns, cell=_cell) as file:
            for row in of_table:
                file.write(row)
        yield folder / name
    for name, png in plots.items():
        write_atomic(folder / name, png)
        yield folder / name
    frames, seconds = report["manifest"]["frames"], wall_s()
    if evaluation.battery and evaluation.battery.clips is not evaluation.clips:
        frames += sum(map(len, evaluation.battery.clips))
    timing = {"wall_s": round(seconds, 1), "frames_per_s": round(frames / seconds, 1)}
    # NaN and infinity become null.
    content = _finite({**report, "timing": timing})
    write_atomic(claim, json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False) + "\n")
    yield claim.path
    write_atomic(folder / "evaluation.html", page)
    yield folder / "evaluation.html"


def printed_table(evaluation: Evaluation) -> Iterator[str]:
    """Yield the lines to print: detections and false alarms of each detector, with intervals."""
    measured = {(one.detector, one.measure, one.condition): one for one in evaluation.measurements}
    minutes = _quiet_minutes(evaluation)
    approaches = sum(clip.label.looming for clip in evaluation.clips)
    yield (
        f"approaches: {approaches}, clips without one: {len(evaluation.clips) - approaches}, "
        f"minutes without an approach: {number(minutes)}"
    )
    rules = {
        "alarm as shipped": SHIPPED,
        "1 per minute, these clips": AT_ONE,
        "1 per minute, held out": f"{HELD_OUT} {AT_ONE}",
    }
    labels = _labels(evaluation)
    wide = max(map(len, (*rules, *labels.values())))
    for title, condition in rules.items():
        yield f"{title:<{wide}}  {'detected':<24}{'lead (s)':<10}false alarms per minute"
        for name, label in labels.items():
            rate, lead, false = (
                measured.get((name, measure, condition))
                for measure in ("detection_rate", "lead_time_s", "false_alarms_per_minute")
            )
            detected = NO_VALUE
            if rate and rate.n:
                detected = f"{rate.value * rate.n:.0f} of {rate.n}{_interval(rate)}"
            yield (
                f"{label:<{wide}}  {detected:<24}"
                f"{_value(lead):<10}{_value(false)}{_interval(false)}"
            )
    yield (
        "These clips: each detector has the lowest threshold with at most one false alarm per "
        "minute on these clips. Held out: the threshold for each clip comes from the other "
        "videos; expect these results on new footage. In brackets: 95 % intervals, of the share "
        "that is detected and of the rate."
    )
    yield from _by_kind(evaluation, measured)
    yield from _by_footage(evaluation, measured)
    if evaluation.battery:
        yield from _of_battery(evaluation.battery)
    if any(
        one.value == 0 and (one.measure, one.condition) == ("false_alarms_per_minute", SHIPPED)
        for one in evaluation.measurements
    ):
        bound = number(RULE_OF_THREE / minutes) if minutes else NO_VALUE
        yield (
            f"A detector without a false alarm in {number(minutes)} minutes may still have up to "
            f"{bound} per minute (the rule of three, 95 %)."
        )


def _by_footage(
    evaluation: Evaluation, measured: dict[tuple[str, str, str], Measurement]
) -> Iterator[str]:
    """Yield lines for manifests: false alarms per minute by the manifest's kinds of motion."""
    start = f"{SHIPPED}, "
    kinds = dict.fromkeys(
        condition.removeprefix(start)
        for _, measure, condition in measured
        if measure == "false_alarms_per_minute" and condition.startswith(start)
    )
    if len(kinds) < 3 or any(measure == "alarmed_share" for _, measure, _ in measured):
        return  # stimuli have shares of clips by kind
    yield "false alarms per minute by kind of motion, alarm as shipped; 95 % intervals in brackets"
    labels = _labels(evaluation)
    width, wide = max(map(len, kinds)), 22
    yield "  ".join([" " * width, *(f"{label:<{wide}}" for label in labels.values())]).rstrip()
    for kind in kinds:
        rates = (measured.get((name, "false_alarms_per_minute", start + kind)) for name in labels)
        cells = (f"{_value(rate)}{_interval(rate)}" for rate in rates)
        yield "  ".join([f"{kind:<{width}}", *(f"{cell:<{wide}}" for cell in cells)]).rstrip()


def _by_kind(
    evaluation: Evaluation, measured: dict[tuple[str, str, str], Measurement]
) -> Iterator[str]:
    """Yield lines for stimuli: the share of clips of each kind with a false alarm, by detector."""
    start = f"{AT_ONE}, {KIND} "
    conditions = (condition for _, measure, condition in measured if measure == "alarmed_share")
    kinds = [
        condition.removeprefix(start)
        for condition in dict.fromkeys(conditions)
        if condition.startswith(start)
    ]
    if not kinds:
        return
    yield "share of clips with a false alarm, at 1 per minute"
    width = max(map(len, kinds))
    labels = _labels(evaluation)
    yield "  ".join([" " * width, *labels.values()])
    for kind in kinds:
        cells = [
            f"{_value(measured.get((name, 'alarmed_share', start + kind))):<{len(label)}}"
            for name, label in labels.items()
        ]
        yield "  ".join([f"{kind:<{width}}", *cells])


def _of_battery(battery: Evaluation) -> Iterator[str]:
    """Yield lines for the battery: how selective each detector is, and its cost."""
    responses = BatteryResponses(battery)
    title = "battery of stimuli, alarm as shipped"
    wide = max(map(len, [title, *map(full_label, responses.names)]))
    yield f"{title:<{wide}}  approaches  controls  AUC    ms/frame  largest control / looming disk"
    for name in responses.names:
        found = responses.summary(name)
        largest = f"{number(found.largest_control_over_loom)} ({found.largest_control})"
        yield (
            f"{full_label(name):<{wide}}  {_of(found.approaches_detected, found.approaches):<12}"
            f"{_of(found.controls_alarmed, found.controls):<10}{number(found.auc):<7}"
            f"{number(found.cost_ms):<10}{largest}"
        )


def _labels(evaluation: Evaluation) -> dict[str, str]:
    return {detector.name: full_label(detector.name) for detector in evaluation.detectors}


def _of(count: int | None, total: int) -> str:
    return NO_VALUE if count is None else f"{count} of {total}"


def _quiet_minutes(evaluation: Evaluation) -> float:
    # The plain `sum` of floats rounds in another way since Python 3.12.
    return math.fsum(clip.seconds(*clip.quiet) for clip in evaluation.clips) / 60


def _value(measured: Measurement | None) -> str:
    return number(measured.value if measured else None)


def _interval(measured: Measurement | None) -> str:
    known = measured is not None and not math.isnan(measured.low)
    return f" ({number(measured.low)} to {number(measured.high)})" if measured and known else ""


def _row(measurement: Measurement) -> dict[str, Cell]:
    return dict(zip(_COLUMNS["evaluation.csv"], measurement, strict=True))


def _responses(evaluation: Evaluation) -> Iterator[dict[str, Cell]]:
    for clip in evaluation.clips:
        for name, output in clip.outputs.items():
            alarm = output.alarm
            for frame, response in enumerate(output.response):
                winner = [None] * 4 if output.winner is None else output.winner[frame]
                yield {
                    "clip": clip.label.name,
                    "frame": frame,
                    "time_s": float(clip.time_s[frame]),
                    "contender": name,
                    "response": float(response),
                    "alarm": None if alarm is None or math.isnan(response) else bool(alarm[frame]),
                    **dict(zip(Box._fields, winner, strict=True)),
                    "evidence": float(output.evidence[frame]),
                }


def _windows(evaluation: Evaluation) -> Iterator[dict[str, Cell]]:
    for clip in evaluation.clips:
        for use, ahead, window in _window_uses(clip):
            for name, output in clip.outputs.items():
                yield {
                    "clip": clip.label.name,
                    "use": use,
                    "frames_before_contact": ahead,
                    "first_frame": window.start,
                    "last_frame": window.stop - 1,
                    "contender": name,
                    "score": window.score(output.response),
                }


def _window_uses(clip: Clip) -> Iterator[tuple[str, int | None, Window]]:
    for window in clip.windows_without_approach():
        yield "without approach", None, window
    for frames in AHEAD:
        approach = clip.window_before_contact(frames)
        if approach is not None:
            yield "approach", frames, approach
            for window in clip.windows(clip.first, approach.start):
                yield "earlier", frames, window


def _cell(value: Cell) -> str:
    return "" if isinstance(value, float) and math.isnan(value) else plain_text(value)


def report_of(evaluation: Evaluation) -> dict[str, Any]:
    """Return the content of ``report.json`` without ``timing``."""
    clips = evaluation.clips
    battery = BatteryResponses(evaluation.battery) if evaluation.battery else None
    return {
        "schema": "oppload.evaluation/1",
        "tool": environment(),
        "manifest": {
            "path": str(evaluation.manifest.path),
            "rows": evaluation.manifest.rows,
            "clips": len(clips),
            "looming": sum(clip.label.looming for clip in clips),
            "none": sum(not clip.label.looming for clip in clips),
            "frames": sum(len(clip) for clip in clips),
            "boxed_frames": sum(len(clip.label.boxes) for clip in clips),
            "minutes_without_approach": _quiet_minutes(evaluation),
        },
        "faults": evaluation.faults,
        "settings": {
            "false_alarm_rates_per_minute": list(RATES),
            "silence_s": SILENCE_S,
            "window_s": WINDOW_S,
            "shortest_window_s": LEAST_S,
            "frames_before_contact": list(AHEAD),
            "near_contact_frames": NEAR_CONTACT,
            "box_grown_times": GROWN,
            "bootstrap": {"draws": evaluation.draws, "seed": SEED, "level_percent": LEVEL},
        },
        "contenders": {detector.name: detector.as_dict() for detector in evaluation.detectors},
        "figures": [_row(measurement) for measurement in evaluation.measurements],
        "splits": list(_splits(evaluation)),
        "clips": list(_clips(evaluation)),
        "battery": battery and {name: battery.summary(name)._asdict() for name in battery.names},
    }


def _clips(evaluation: Evaluation) -> Iterator[dict[str, Any]]:
    for index, (entry, clip) in enumerate(zip(evaluation.entries, evaluation.clips, strict=True)):
        outcomes = {
            name: {
                decision.condition: {
                    "detected": known(decision.outcomes.detected[index], bool),
                    "lead_s": float(decision.outcomes.lead_s[index]),
                    "false_alarms": known(decision.outcomes.false_alarms[index], int),
                }
                for decision in performance.decisions.values()
            }
            for name, performance in evaluation.performances.items()
        }
        yield {
            "file": clip.label.name,
            "row": entry.row,
            "label": "looming" if clip.label.looming else "none",
            "kind": clip.label.kind,
            "conditions": clip.label.conditions,
            "onset_frame": clip.label.onset,
            "contact_frame": clip.label.contact,
            "true_rate": None if entry.true_rate is None else float(entry.true_rate),
            "frames": len(clip),
            "first_frame": clip.first,
            "seconds": clip.seconds(0, len(clip)),
            "seconds_without_approach": clip.seconds(*clip.quiet),
            "width": clip.width,
            "height": clip.height,
            "outcomes": outcomes,
        }


def _splits(evaluation: Evaluation) -> Iterator[dict[str, Any]]:
    """Yield for each pair of detectors how they differ in the approaches that they detect."""
    videos = videos_of(evaluation.clips)
    for condition in (f"{HELD_OUT} {AT_ONE}", SHIPPED):
        detected = {
            name: performance.decisions[condition].outcomes.detected
            for name, performance in evaluation.performances.items()
        }
        for one, other in combinations(detected, 2):
            split = split_of(detected[one], detected[other], videos)
            yield {"condition": condition, "contenders": [one, other], **split._asdict()}


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_finite(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
