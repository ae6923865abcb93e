"""Every stimulus of the battery through every detector; measurements are kept."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass
from functools import partial
from operator import attrgetter
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from oppload_cli.errors import OpploadError
from oppload_cli.evaluation.evaluate import outputs_of
from oppload_cli.files.atomic import write_atomic
from oppload_cli.pipeline.sources import StimulusVideo
from oppload_cli.processes.pool import results
from oppload_cli.stimulus.files import file_stem
from oppload_cli.version import __version__

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from oppload_cli.benchmark.battery import Column
    from oppload_cli.evaluation.detectors import EvaluatedDetector
    from oppload_cli.stimulus.protocol import Protocol


@dataclass(frozen=True)
class Measured:
    """The measurement of one detector on one stimulus.

    Attributes
    ----------
    detector : str
        ``NAME`` or ``NAME:PRESET``.
    peak : float or None
        Its largest response; None if it gave none.
    peak_time_s : float or None
        When it was first reached.
    alarms : int
        How often its alarm began.
    first_alarm_s : float or None
        When it first began.
    """

    detector: str
    peak: float | None
    peak_time_s: float | None
    alarms: int
    first_alarm_s: float | None


class Shown(NamedTuple):
    """One stimulus of the battery with the measures of every detector."""

    column: Column
    stimulus: str
    motion_end_s: float
    measured: list[Measured]


class _Task(NamedTuple):
    """A stimulus that is still to be shown."""

    name: str
    protocol: Protocol
    kept: Path
    key: str

    @property
    def motion_end_s(self) -> float:
        """When the motion ends."""
        timing = self.protocol.timing
        return float(timing.before_s + timing.motion_s)


def show(
    columns: Sequence[Column],
    detectors: Sequence[EvaluatedDetector],
    folder: Path,
    *,
    jobs: int = 1,
    progress: Callable[[int, int], object] | None = None,
) -> list[Shown]:
    """Show the battery to the detectors, but for the stimuli whose results the folder holds.

    Parameters
    ----------
    columns : sequence of Column
        Of the battery.
    detectors : sequence of EvaluatedDetector
        With their parameters and alarms.
    folder : Path
        Keeps the measures of each stimulus, in a file of its own.
    jobs : int
        Processes; the result does not depend on it.
    progress : callable, optional
        Called with the number of stimuli done and the number of all.

    Raises
    ------
    StimulusError
        If a stimulus cannot be rendered.
    OutputError
        If a file cannot be written, or a process is ended from outside.
    """
    listed = [
        (column, _task(protocol, detectors, folder))
        for column in columns
        for protocol in column.protocols()
    ]
    tasks = {task.kept: task for _, task in listed}
    waiting = [task for task in tasks.values() if _kept(task) is None]
    done = len(tasks) - len(waiting)
    if progress:
        progress(done, len(tasks))

    def count(_: object) -> None:
        nonlocal done
        done += 1
        if progress:
            progress(done, len(tasks))

    results(partial(_show, detectors), waiting, jobs, named=attrgetter("name"), progress=count)
    return [
        Shown(column, task.name, task.motion_end_s, _kept(task) or []) for column, task in listed
    ]


def _task(protocol: Protocol, detectors: Sequence[EvaluatedDetector], folder: Path) -> _Task:
    content = {
        "version": __version__,
        "stimulus": protocol.as_table(),
        "detectors": {each.name: each.as_dict() for each in detectors},
    }
    text = json.dumps(content, sort_keys=True, default=str)
    key = hashlib.sha256(text.encode()).hexdigest()
    # Two columns may show one stimulus with other settings under one name.
    kept = folder / f"{file_stem(protocol.name)}.{key[:8]}.json"
    return _Task(protocol.name, protocol, kept, key)


def _show(detectors: Sequence[EvaluatedDetector], task: _Task) -> None:
    measured: dict[str, Measured] = {}
    try:
        for height in dict.fromkeys(each.height for each in detectors):
            same = [each for each in detectors if each.height == height]
            video = StimulusVideo(task.protocol, height)
            times, outputs = outputs_of(video, same)
            for name, output in outputs.items():
                measured[name] = _measure(name, times, output.response, output.alarm)
    except OpploadError as error:
        raise type(error)(f"{task.name}: {error}") from error
    rows = [asdict(measured[each.name]) for each in detectors]
    write_atomic(task.kept, json.dumps({"key": task.key, "measured": rows}, indent=1) + "\n")


def _measure(name: str, times: Any, response: Any, alarm: Any) -> Measured:
    begins = np.flatnonzero(np.diff(np.concatenate([[False], alarm]).astype(int)) == 1)
    first = float(times[begins[0]]) if len(begins) else None
    if not np.isfinite(response).any():
        return Measured(name, None, None, len(begins), first)
    best = int(np.nanargmax(response))
    return Measured(name, float(response[best]), float(times[best]), len(begins), first)


def _kept(task: _Task) -> list[Measured] | None:
    """Return the measures that the folder holds, if they are of the same task."""
    try:
        content = json.loads(task.kept.read_text("utf-8"))
        rows = [Measured(**row) for row in content["measured"]]
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return rows if content.get("key") == task.key else None
