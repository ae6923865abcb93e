"""A task: one input with its settings and outputs, its outcome, and whether it is done already."""

from __future__ import annotations

import json
import math
import os
from dataclasses import asdict, dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from oppload_cli.errors import OutputError
from oppload_cli.files.reading import reading
from oppload_cli.models.presets import NATIVE
from oppload_cli.pipeline.outputs import IfExists
from oppload_cli.results.alarms import verdicts_in
from oppload_cli.results.table import SCHEMA
from oppload_cli.video.frames import WorkingSize
from oppload_cli.video.inputs import Span
from oppload_cli.video.optics import FOV, Optics

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from oppload_cli.pipeline.outputs import Outputs
    from oppload_cli.pipeline.settings import Settings
    from oppload_cli.results.alarms import Verdict
    from oppload_cli.results.table import FrameRecord, ModelSummary
    from oppload_cli.video.source import Video

_REMEDY = "choose --if-exists overwrite, or another --output"


@dataclass(frozen=True)
class Task:
    """One input, how to analyse it, and where to write the results.

    Attributes
    ----------
    name : str
        The input.
    settings : Settings
        The detectors and their parameters.
    outputs : Outputs or None
        The files to write; None streams the CSV to standard output.
    span : Span
        The part of the input.
    image_rate : Fraction
        Frames per second of images.
    if_exists : IfExists
        What to do where a file exists already.
    command : sequence of str
        The command line, for the sidecar.
    threads : int
        Threads of the decoder, and of the detectors on large frames; 0 lets them choose.
    stem : str
        The beginning of the names of its results.
    boxes : str
        Objects with a box in an annotated video: ``alarm``, ``all`` or ``none``.
    """

    name: str
    settings: Settings
    outputs: Outputs | None = None
    span: Span = field(default_factory=Span)
    image_rate: Fraction = Fraction(30)
    if_exists: IfExists = IfExists.ERROR
    command: Sequence[str] = ()
    threads: int = 0
    boxes: str = "alarm"
    stem: str = ""


@dataclass(frozen=True)
class Outcome:
    """The outcome of a task.

    Attributes
    ----------
    skipped : bool
        Whether the result existed already.
    complete : bool
        Whether every frame that the input declared was decoded.
    frames : int
        Number of rows written.
    wall_s : float
        Seconds from opening to the last row.
    notes : tuple of str
        Faults of the input, a line each.
    remarks : tuple of str
        Unusual properties of the input that are no faults, a line each.
    summaries : dict of str to ModelSummary
        By detector; empty where the result existed.
    verdicts : tuple of Verdict
        Of every detector, those of an existing result included.
    """

    skipped: bool = False
    complete: bool = True
    frames: int = 0
    wall_s: float = 0.0
    notes: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()
    summaries: dict[str, ModelSummary] = field(default_factory=dict)
    verdicts: tuple[Verdict, ...] = ()

    @property
    def alarmed(self) -> bool:
        """Whether the alarm of any detector went on."""
        return any(each.alarms for each in self.verdicts)


class Watcher(Protocol):
    """An observer of the progress of a task."""

    def opened(self, video: Video) -> None:
        """Take note that the input is open."""

    def frame(self, record: FrameRecord) -> None:
        """Take note that the record of a frame is written."""


class Interrupted(KeyboardInterrupt):
    """The user stopped a task; the message says which rows are kept."""


def exists_already(task: Task) -> Outcome | None:
    """Return the outcome of a result that exists and is kept; None where there is none.

    Raises
    ------
    OutputError
        If a result exists and the task does not say what to do with it, or to skip it and it
        is of another input or has other settings.
    """
    if task.outputs is None or not task.outputs.kept(task.if_exists):
        return None
    return _kept_result(task)


def _kept_result(task: Task) -> Outcome:
    """Return the outcome of a result that a task passes over.

    Results that differ in input or settings must not lie beside each other as if they were alike.
    """
    path = task.outputs.sidecar if task.outputs else None
    if path is None:
        return Outcome(skipped=True)
    with reading(path, OutputError, form="JSON", check="check its rights", repair=_REMEDY):
        content = json.loads(path.read_text(encoding="utf-8"))
    if not isinstance(content, dict) or content.get("schema") != SCHEMA:
        raise OutputError(f"{path}: is of another version of oppload; {_REMEDY}")
    try:
        difference, verdicts = next(_differences(task, content), None), verdicts_in(content)
        complete, notes = bool(content["decode"]["complete"]), content["decode"]["messages"]
    except (KeyError, TypeError, ValueError, AttributeError, ZeroDivisionError) as error:
        raise OutputError(f"{path}: is damaged; {_REMEDY}") from error
    if difference:
        raise OutputError(f"{path}: is a result {difference}; {_REMEDY}")
    return Outcome(skipped=True, complete=complete, notes=tuple(notes), verdicts=verdicts)


def _differences(task: Task, content: dict[str, Any]) -> Iterator[str]:
    """Yield how a result differs from the one that a task would make, in words."""
    settings, facts = task.settings, content["input"]
    own = os.path.basename(task.name), _bytes_of(task.name)  # noqa: PTH119 - addresses too
    made = os.path.basename(facts["name"]), facts.get("bytes")  # noqa: PTH119
    if own[0] != made[0] or (None not in {own[1], made[1]} and own[1] != made[1]):
        yield f"of another input, {facts['name']}"
    if list(settings.models) != content["models"]:
        yield f"of the models {', '.join(content['models'])}, not {', '.join(settings.models)}"
    if settings.columns != content["columns"]:
        yield f"with --columns {content['columns']}, not {settings.columns}"
    if settings.height != content["height"]:
        yield f"at --height {content['height'] or NATIVE}, not {settings.height or NATIVE}"
    if settings.measure_rmo != content["measure_rmo"]:
        yield f"with{'' if content['measure_rmo'] else 'out'} radial motion opponency"
    if _plain(asdict(task.span)) != content["span"]:
        yield "of another part of the input: see --start, --end and --duration"
    others = list(_other_parameters(settings, content))
    if others and settings.preset != content["preset"]:  # which says more than a parameter
        yield f"of preset {content['preset']}, not {settings.preset}"
    yield from others


def _other_parameters(settings: Settings, content: dict[str, Any]) -> Iterator[str]:
    facts, working, view = content["input"], content["working"], content["field_of_view"]
    if view:
        per_radian = math.degrees(view["px_per_degree_in_the_middle"])
        seen = Optics(facts["width"], facts["height"], per_radian, view["projection"])
        scale = working["source_px_per_px_x"], working["source_px_per_px_y"]
        size = WorkingSize(working["width"], working["height"], *scale)
        settings = settings.seen_through(seen, size)
    made = _fov(view["horizontal_deg"] if view and view["origin"] == FOV else None)
    if made != _fov(settings.fov):
        yield f"with {made}, not {_fov(settings.fov)}"
    groups = (*settings.models, "alarm", "places", "repeats", "time")
    groups += ("rmo",) if settings.measure_rmo else ()
    resolved = settings.resolved(min(working["width"], working["height"]))
    for group, params in ((name, resolved[name]) for name in groups):
        held = content["parameters"].get(group, {})
        for name, value in _plain(params.as_dict()).items():
            if held.get(name) != value:
                yield f"with {group}.{name} = {held.get(name)}, not {value}"


def _fov(degrees: float | None) -> str:
    """Return a field of view in words, without the rounding of sines and tangents."""
    return "no --fov" if degrees is None else f"--fov {round(degrees, 9):.12g}"


def _plain(value: Any) -> Any:
    """Return a value as it comes back from JSON."""
    return json.loads(json.dumps(value, default=str))


def _bytes_of(name: str) -> int | None:
    path = Path(name)
    try:
        return path.stat().st_size if path.is_file() else None
    except (OSError, ValueError):  # an address
        return None
