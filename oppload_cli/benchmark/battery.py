"""Shows one battery of stimuli to all detectors, and keeps the measurements in files."""

from __future__ import annotations

import hashlib
import inspect
import itertools
import json
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from oppload_cli.errors import ParameterError, faults_at
from oppload_cli.evaluation.evaluate import outputs_of
from oppload_cli.files.atomic import write_atomic
from oppload_cli.models.registry import detector_named
from oppload_cli.pipeline.sources import StimulusVideo
from oppload_cli.processes.pool import results
from oppload_cli.stimulus.catalogue import find
from oppload_cli.stimulus.files import file_stem
from oppload_cli.version import __version__

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from oppload_cli.evaluation.detectors import EvaluatedDetector
    from oppload_cli.evaluation.metrics.clips import Flags, Numbers
    from oppload_cli.stimulus.protocol import Protocol


LOOM = "klapoetke2017/loom-l-over-v"
L_OVER_V = "disk.growth.l_over_v_ms"
LOOMING, CONTROL = "looming", "control"
SELECTIVITY, _POLARITY, _CONTRAST, _NOISE = "selectivity", "polarity", "contrast", "noise"
_SPEED, _SIZE, _PLACE, _BACKGROUND = "speed", "size", "place", "background"


class BatteryTable(NamedTuple):
    """One table of the benchmark; `axis` is the quantity in which its columns differ."""

    name: str
    title: str
    axis: str


TABLES = (
    BatteryTable(SELECTIVITY, "Kinds of motion", "kind of motion"),
    BatteryTable(_POLARITY, "Polarity: a dark and a bright approach", "polarity"),
    BatteryTable(_CONTRAST, "Contrast of the approaching disk", "contrast with the ground"),
    BatteryTable(_NOISE, "An approach in noise", "standard deviation of the noise, share of white"),
    BatteryTable(_SPEED, "Speed of the approach", "l/v (ms)"),
    BatteryTable(_SIZE, "Angular size at which the approach ends", "size (deg)"),
    BatteryTable(_PLACE, "Place of the approach", "right, up of the centre (deg)"),
    BatteryTable(_BACKGROUND, "Motion behind the approach", "ground"),
)


@dataclass(frozen=True)
class BatteryColumn:
    """One column of a table, with one stimulus of the catalogue or several."""

    table: str  # its name
    label: str  # the heading
    stimulus: str
    # Changed values of the protocol by key; a list of values gives a stimulus for each value.
    settings: dict[str, Any] = field(default_factory=dict)
    kind: str = LOOMING  # an alarm is right; with ``control``, it is a false alarm

    def protocols(self) -> list[Protocol]:
        """Return the protocols of the stimuli."""
        return find(self.stimulus)[0].with_settings(self.settings).protocols()


def _control(label: str, stimulus: str, settings: dict[str, Any] | None = None) -> BatteryColumn:
    return BatteryColumn(SELECTIVITY, label, stimulus, settings or {}, CONTROL)


_DISK = {L_OVER_V: 40}
_SMALL_DISK = {**_DISK, "disk.growth.most_deg": 40}
_QUARTERS = [0, 45, 90, 135]
BATTERY = (
    BatteryColumn(SELECTIVITY, "looming disk", LOOM, _DISK),
    BatteryColumn(SELECTIVITY, "looming square", "controls/looming-square"),
    BatteryColumn(SELECTIVITY, "looming patch", "controls/looming-patch"),
    _control("receding disk", "controls/receding-disk", _DISK),
    _control("receding patch", "controls/receding-patch"),
    _control("near miss", "controls/near-miss"),
    _control(
        "translating disk",
        "controls/translating-disk-speed",
        {"disk.motion.speed_deg_s": [20, 40, 80]},
    ),
    _control("translating bar", "controls/translating-bar-speed"),
    _control("turning bar", "controls/rotating-bar"),
    _control("grating", "controls/square-grating", {"grating.axis_deg": _QUARTERS}),
    _control("plaid", "controls/plaid"),
    _control("pan", "controls/texture-pan", {"ground.motion.direction_deg": _QUARTERS}),
    _control("roll", "controls/texture-rotation"),
    _control("forward and backward", "controls/texture-zoom"),
    _control("drifting dots", "controls/dots-drift"),
    _control("shake", "controls/camera-shake"),
    _control("flicker", "controls/flicker"),
    _control("luminance step", "controls/luminance-step"),
    _control("dimming, brightening", "controls/luminance-ramp"),
    _control("appearing disk", "controls/appearing-disk"),
    _control("noise", "controls/static-texture", {"effects.noise": 0.05}),
    BatteryColumn(_POLARITY, "dark", LOOM, _DISK),
    BatteryColumn(_POLARITY, "bright", "klapoetke2017/loom-bright", _DISK),
    BatteryColumn(_PLACE, "0, 0", LOOM, _SMALL_DISK),
    *(
        BatteryColumn(
            _CONTRAST,
            f"{contrast:g}",
            "controls/looming-contrast",
            {"display.background": 0.5, "disk.luminance": round(0.5 * (1 - contrast), 6)},
        )
        for contrast in (0.1, 0.2, 0.3, 0.5, 0.7, 1.0)
    ),
    *(
        BatteryColumn(_NOISE, f"{noise:g}", "controls/looming-noise", {"effects.noise": noise})
        for noise in (0.0, 0.02, 0.05, 0.1, 0.2)
    ),
    *(
        BatteryColumn(_SPEED, f"{ratio}", LOOM, {L_OVER_V: ratio})
        for ratio in (10, 20, 40, 60, 80, 100, 140, 200)
    ),
    *(
        BatteryColumn(_SIZE, f"{size}", LOOM, {**_DISK, "disk.growth.most_deg": size})
        for size in (10, 20, 30, 45, 60)
    ),
    *(
        BatteryColumn(_PLACE, f"{x}, {y}", LOOM, {**_SMALL_DISK, "disk.centre_deg": [x, y]})
        for x, y in ((10, 0), (20, 0), (0, 10), (-10, 0), (0, -10), (14, 14))
    ),
    BatteryColumn(_BACKGROUND, "still texture", "controls/looming-on-static-texture"),
    *(
        BatteryColumn(
            _BACKGROUND,
            f"pan {speed} deg/s",
            "controls/looming-on-moving-texture",
            {"ground.motion.speed_deg_s": speed, "ground.motion.direction_deg": 0},
        )
        for speed in (5, 15, 30)
    ),
    BatteryColumn(_BACKGROUND, "forward motion", "controls/looming-on-zooming-texture"),
    BatteryColumn(_BACKGROUND, "shake", "controls/looming-with-shake"),
)


def columns_of(tables: Sequence[str]) -> list[BatteryColumn]:
    """Return the columns of the named tables; of all tables if none is named.

    Raises ParameterError if no table has such a name.
    """
    names = [table.name for table in TABLES]
    for name in tables:
        if name not in names:
            raise ParameterError(f"no table '{name}'; choose from {', '.join(names)}")
    # The looming disk is always shown, because the response to it is the unit of all responses.
    return [
        column for column in BATTERY if not tables or column.table in tables or column is BATTERY[0]
    ]


@dataclass(frozen=True)
class Measured:
    """The measurement of one detector on one stimulus."""

    detector: str  # ``NAME`` or ``NAME:PRESET``
    peak: float | None  # the largest response; None if there was no response
    peak_time_s: float | None
    alarms: int  # how often an alarm started
    first_alarm_s: float | None


class Shown(NamedTuple):
    """One stimulus of the battery with the measurements of all detectors.

    Two columns may have the same stimulus; then `key` is the same too.
    """

    column: BatteryColumn
    key: str
    protocol: Protocol
    measured: dict[str, Measured]  # by detector


class _Task(NamedTuple):
    """A stimulus, the file of its measurements, and a checksum of all on which they depend."""

    protocol: Protocol
    file: Path
    key: str


def show(
    columns: Sequence[BatteryColumn],
    detectors: Sequence[EvaluatedDetector],
    folder: Path,
    *,
    jobs: int = 1,
    progress: Callable[[int, int], object] | None = None,
) -> list[Shown]:
    """Show stimuli to the detectors, except those whose measurements the folder has already.

    Parameters
    ----------
    columns, detectors
        Columns of the battery, and the detectors.
    folder : Path
        The folder for the measurements, with a file for each stimulus.
    jobs : int
        Number of processes, which does not change the result.
    progress : callable, optional
        Takes the number of stimuli that are done, and the number of all stimuli.

    Raises
    ------
    StimulusError
        If a stimulus cannot be drawn.
    OutputError
        If a file cannot be written, or the system ends one of the processes.
    """
    code = _code_checksum(detectors)
    listed = [
        (column, _task(protocol, detectors, code, folder))
        for column in columns
        for protocol in column.protocols()
    ]
    tasks = {task.file: task for _, task in listed}
    waiting = [task for task in tasks.values() if _measurements_of(task) is None]
    done = itertools.count(len(tasks) - len(waiting))

    def count(_: object = None) -> None:
        if progress:
            progress(next(done), len(tasks))

    count()
    results(
        partial(_show, detectors),
        waiting,
        jobs,
        named=lambda task: task.protocol.name,
        progress=count,
    )
    return [
        Shown(column, task.key, task.protocol, _measurements_of(task) or {})
        for column, task in listed
    ]


# The measurements depend on the code of these rooms and modules.
_ROOMS = "compute", "detection", "models", "motion", "pipeline", "stimulus", "video"
_MODULES = "benchmark/battery.py", "evaluation/evaluate.py"
_SOURCES = {".py", ".c", ".h", ".csv"}


def _code_checksum(detectors: Sequence[EvaluatedDetector]) -> str:
    """Return a checksum of the code: after a change, all measurements are made again."""
    package = Path(__file__).parents[1]
    files = {path for room in _ROOMS for path in (package / room).rglob("*.*")}
    files |= {package / name for name in _MODULES}
    # A user's own detector lies outside the package.
    files |= {Path(inspect.getfile(detector_named(each.detector))) for each in detectors}
    code = hashlib.sha256()
    for path in sorted(path for path in files if path.suffix in _SOURCES):
        code.update(path.read_bytes())
    return code.hexdigest()


def _task(
    protocol: Protocol, detectors: Sequence[EvaluatedDetector], code: str, folder: Path
) -> _Task:
    content = {
        "version": __version__,
        "code": code,
        "stimulus": protocol.as_table(),
        "detectors": {each.name: each.as_dict() for each in detectors},
    }
    text = json.dumps(content, sort_keys=True, default=str)
    key = hashlib.sha256(text.encode()).hexdigest()
    # Stimuli that differ only in settings have the same name.
    file = folder / f"{file_stem(protocol.name)}.{key[:8]}.json"
    return _Task(protocol, file, key)


def _show(detectors: Sequence[EvaluatedDetector], task: _Task) -> None:
    measured: dict[str, Measured] = {}
    with faults_at(task.protocol.name):
        for height in dict.fromkeys(each.height for each in detectors):
            of_height = [each for each in detectors if each.height == height]
            video = StimulusVideo(task.protocol, height)
            times, outputs = outputs_of(video, of_height)
            for name, output in outputs.items():
                measured[name] = _measure(name, times, output.response, output.alarm)
    rows = [asdict(measured[each.name]) for each in detectors]
    write_atomic(task.file, json.dumps({"key": task.key, "measured": rows}, indent=1) + "\n")


def _measure(name: str, times: Numbers, response: Numbers, alarm: Flags | None) -> Measured:
    on = np.zeros(len(times)) if alarm is None else alarm.astype(int)
    begins = np.flatnonzero(np.diff(on, prepend=0) == 1)
    first = float(times[begins[0]]) if len(begins) else None
    if not np.isfinite(response).any():
        return Measured(name, None, None, len(begins), first)
    best = int(np.nanargmax(response))
    return Measured(name, float(response[best]), float(times[best]), len(begins), first)


def _measurements_of(task: _Task) -> dict[str, Measured] | None:
    """Return a task's measurements by detector from its file; None without a file for this task."""
    try:
        content = json.loads(task.file.read_text("utf-8"))
        measured = {row["detector"]: Measured(**row) for row in content["measured"]}
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return measured if content.get("key") == task.key else None
