"""Runs a sweep: shows each condition to each detector, and writes the table of the measures."""

from __future__ import annotations

from dataclasses import asdict
from functools import partial
from operator import attrgetter
from typing import TYPE_CHECKING, Any

import numpy as np

from oppload_cli.environment import environment
from oppload_cli.errors import faults_at
from oppload_cli.files.atomic import PartFile, write_atomic
from oppload_cli.files.tables import csv_text
from oppload_cli.models.registry import parameters_of
from oppload_cli.pipeline.sources import StimulusVideo
from oppload_cli.processes.pool import results
from oppload_cli.results.reading import direction_of
from oppload_cli.stimulus.renderer import Renderer
from oppload_cli.tuning.present import Condition, Measures, measure, present, seen_in

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

    from oppload_cli.files.tables import Cell
    from oppload_cli.pipeline.settings import Settings
    from oppload_cli.schema import Parameters
    from oppload_cli.stimulus.catalogue import Entry
    from oppload_cli.stimulus.protocol import Protocol
    from oppload_cli.tuning.doubts import Doubt
    from oppload_cli.tuning.sweeps import Sweep


_SCHEMA = "oppload.tuning/1"
_PRESENTATION = "presentation"  # column of the number of a presentation in a row


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
        If a process is ended from outside, for instance for want of memory.
    """
    shown = results(
        partial(_measured, sweep.settings, sweep.presentations, indicator_s),
        sweep.entry.protocols(),
        jobs,
        named=attrgetter("name"),
        progress=lambda _: progress() if progress else None,
    )
    conditions = []
    for (stimulus, swept), measured in zip(sweep.entry.values().items(), shown, strict=True):
        for number, measures in enumerate(measured, 1):
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
        shown = present(protocol, settings, presentations, indicator_s)
    parts = {
        detector: [each] if presentations == 1 else each.presentations(protocol)
        for detector, each in shown.items()
    }
    return [
        {detector: measure(each[number], protocol) for detector, each in parts.items()}
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
    first = next(iter(entry.sweep[direction]))
    protocols = [
        entry.with_settings({direction: angle}).protocols()[0] for angle in (first, first + 180)
    ]
    one, turned = map(Renderer, protocols)
    protocol = protocols[0]
    timing, rate = protocol.timing, float(protocol.display.frame_rate)
    spans = {(timing.before_s, timing.end_s)}
    spans |= {protocol.motion_of(each) for each in protocol.objects}
    times = (start + share * (end - start) for start, end in spans for share in (1 / 3, 2 / 3))
    frames = {min(round(time * rate), protocol.frame_count - 1) for time in times}
    # Rounding may change a pixel on an edge by a grey level.
    return all(
        int(np.abs(one.grey(at).astype(int) - turned.grey(at).astype(int)).max()) <= 2
        for at in frames
    )


def write_tuning(table: Path | PartFile, conditions: Sequence[Condition]) -> None:
    """Write the table of a sweep; raise OutputError if it cannot be written."""
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
    write_atomic(table, csv_text(rows, rows[0]))


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
    video = StimulusVideo(first, settings.height)
    height = min(video.working.shape)
    resolved = seen_in(video, settings.with_all_detectors()).resolved(height)
    content = {
        "schema": _SCHEMA,
        "tool": environment(),
        "command": list(command),
        "preset": settings.preset,
        "models": list(settings.models),
        "height": settings.height,
        "parameters": {name: params.as_dict() for name, params in resolved.items()},
        "changed": _changed(settings, resolved, height),
        "sizes_deg": settings.angles,
        "indicator_s": indicator_s,
        "doubts": [{"model": each.detector, "note": each.note} for each in doubts],
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
    """Return the parameters of the measured detectors that differ from those of the preset.

    A file of settings may also state values that are those of the preset. `height` is the working
    height, for which the parameters are `resolved`.
    """
    usual = {
        name: parameters_of(name, settings.preset).resolved(height).as_dict()
        for name in settings.models
    }
    changed: dict[str, Any] = {}
    for key, origin in settings.origins.items():
        group, _, name = key.partition(".")
        if group in settings.models and name and not origin.startswith("preset"):
            angle = settings.angles.get(key)
            value = resolved[group].as_dict().get(name)
            if angle is not None or value != usual[group].get(name):
                changed[key] = value if angle is None else f"{angle:g}deg"
    return changed


def _cells(values: dict[str, Any]) -> dict[str, Cell]:
    """Return the values of a condition by column; a position becomes two columns."""
    cells: dict[str, Cell] = {}
    for key, value in values.items():
        if isinstance(value, list) and len(value) == 2:
            cells[f"{key}.right"], cells[f"{key}.up"] = value
        else:
            number = isinstance(value, int | float) and not isinstance(value, bool)
            cells[key] = value if number else str(value)
    return cells
