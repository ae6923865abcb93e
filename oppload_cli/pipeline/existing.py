"""A result that exists already: whether it is the one that a task would make."""

from __future__ import annotations

import json
import math
import os
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from oppload_cli.errors import OutputError
from oppload_cli.files.reading import reading
from oppload_cli.pipeline.settings import NATIVE
from oppload_cli.results.alarms import verdicts_in
from oppload_cli.results.writing import SCHEMA
from oppload_cli.video.frames import WorkingSize
from oppload_cli.video.optics import FOV, Optics

if TYPE_CHECKING:
    from collections.abc import Iterator

    from oppload_cli.pipeline.settings import Settings
    from oppload_cli.pipeline.task import Task
    from oppload_cli.results.alarms import Verdict

_REMEDY = "choose --if-exists overwrite, or another --output"


def kept_result(task: Task) -> tuple[Verdict, ...]:
    """Return the alarms of a result that a task passes over.

    Raises
    ------
    OutputError
        If it is of another input, of another version of the table, or has other settings:
        results that differ in these must not lie beside each other as if they were alike.
    """
    path = task.outputs.sidecar if task.outputs else None
    if path is None:
        return ()
    with reading(path, OutputError, form="JSON", check="check its rights", repair=_REMEDY):
        content = json.loads(path.read_text(encoding="utf-8"))
    if not isinstance(content, dict) or content.get("schema") != SCHEMA:
        raise OutputError(f"{path}: is of another version of oppload; {_REMEDY}")
    try:
        difference, verdicts = next(_differences(task, content), None), verdicts_in(content)
    except (KeyError, TypeError, ValueError, AttributeError, ZeroDivisionError) as error:
        raise OutputError(f"{path}: is damaged; {_REMEDY}") from error
    if difference:
        raise OutputError(f"{path}: is a result {difference}; {_REMEDY}")
    return verdicts


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
    yield from _other_parameters(settings, content)


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
    rate = _number(facts["frame_rate"])
    groups = (*settings.models, "alarm", "places", "repeats", "time")
    groups += ("rmo",) if settings.measure_rmo else ()
    resolved = settings.resolved(working["height"], rate)
    for group, params in ((name, resolved[name]) for name in groups):
        held = content["parameters"].get(group, {})
        for name, value in _plain(params.as_dict()).items():
            if held.get(name) != value:
                yield f"with {group}.{name} = {held.get(name)}, not {value}"


def _fov(degrees: float | None) -> str:
    """Return a field of view in words, without the rounding of sines and tangents."""
    return "no --fov" if degrees is None else f"--fov {round(degrees, 9):.12g}"


def _number(rate: str | None) -> float | None:
    if not rate:
        return None
    above, _, below = rate.partition("/")
    return float(above) / float(below or 1)


def _plain(value: Any) -> Any:
    """Return a value as it comes back from JSON."""
    return json.loads(json.dumps(value, default=str))


def _bytes_of(name: str) -> int | None:
    path = Path(name)
    try:
        return path.stat().st_size if path.is_file() else None
    except (OSError, ValueError):  # an address
        return None
