"""A sweep: every condition through every detector, and the table of the measures."""

from __future__ import annotations

import csv
import math
import tomllib
from dataclasses import dataclass, fields, replace
from functools import partial
from io import StringIO
from operator import attrgetter
from typing import TYPE_CHECKING, Any

import numpy as np

from oppload_cli.environment import environment
from oppload_cli.errors import OpploadError, ParameterError, StimulusError, suggestion
from oppload_cli.files.atomic import PartFile, write_atomic
from oppload_cli.files.tables import formatted
from oppload_cli.processes.pool import results
from oppload_cli.results.reading import direction_of
from oppload_cli.results.writing import write_sidecar
from oppload_cli.stimulus.catalogue import find
from oppload_cli.stimulus.renderer import Renderer
from oppload_cli.tuning.present import Measures, measure, present

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

    from oppload_cli.pipeline.settings import Settings
    from oppload_cli.stimulus.catalogue import Entry
    from oppload_cli.stimulus.protocol import Protocol


_SCHEMA = "oppload.tuning/1"
_PRESENTATION = "presentation"  # column of the number of a presentation in a row
_MEASURES = tuple(field.name for field in fields(Measures))


@dataclass(frozen=True)
class Condition:
    """One stimulus of a sweep with its measures.

    Attributes
    ----------
    stimulus : str
        Its name.
    values : dict
        Swept values by dotted key.
    measures : dict of str to Measures
        By detector.
    """

    stimulus: str
    values: dict[str, Any]
    measures: dict[str, Measures]


def tune(
    entry: Entry,
    settings: Settings,
    *,
    presentations: int = 1,
    indicator_s: float = 0.0,
    jobs: int = 1,
    progress: Callable[[], object] | None = None,
) -> list[Condition]:
    """Measure every condition of a sweep.

    Parameters
    ----------
    entry : Entry
        The stimulus with its sweep, from :func:`oppload_cli.tuning.run.swept`.
    settings : Settings
        Detectors, their parameters and the working height.
    presentations : int
        How often each stimulus is shown in a row; above 1, each time is a condition of its own.
    indicator_s : float
        Time constant of a calcium indicator that shows the responses; 0 for none.
    jobs : int
        Processes; the result does not depend on it.
    progress : callable, optional
        Called after each stimulus.

    Returns
    -------
    list of Condition
        In the order of the sweep.

    Raises
    ------
    StimulusError
        If a value makes a stimulus that is not valid.
    ParameterError
        If the working size is too large.
    OutputError
        If a process is ended from outside, for instance for want of memory.
    """
    shown = results(
        partial(_measured, settings, presentations, indicator_s),
        entry.protocols(),
        jobs,
        named=attrgetter("name"),
        progress=lambda _: progress() if progress else None,
    )
    return [
        Condition(name, values, measures)
        if presentations == 1
        else Condition(
            f"{name}/{_PRESENTATION}-{number}", {**values, _PRESENTATION: number}, measures
        )
        for (name, values), times in zip(entry.values().items(), shown, strict=True)
        for number, measures in enumerate(times, 1)
    ]


def _measured(
    settings: Settings, presentations: int, indicator_s: float, protocol: Protocol
) -> list[dict[str, Measures]]:
    """Return the measures of each presentation of a stimulus, by detector."""
    try:
        shown = present(protocol, settings, presentations, indicator_s)
    except OpploadError as error:
        raise type(error)(f"{protocol.name}: {error}") from error
    if presentations == 1:
        return [{detector: measure(each, protocol) for detector, each in shown.items()}]
    parts = {detector: each.presentations(protocol) for detector, each in shown.items()}
    return [
        {detector: measure(each[number], protocol) for detector, each in parts.items()}
        for number in range(presentations)
    ]


def is_symmetric(entry: Entry) -> bool:
    """Tell whether half a turn of the swept direction gives the same stimulus.

    Then half a circle of directions is the complete tuning, as for a bar that grows at
    both ends. Two frames of the stimulus decide it, not the name of the key. False if no
    direction is swept.
    """
    direction = direction_of(list(entry.sweep))
    if direction is None:
        return False
    first = next(iter(entry.sweep[direction]))
    here, turned = (
        entry.with_settings({direction: angle}).protocols()[0] for angle in (first, first + 180)
    )
    one, other = Renderer(here), Renderer(turned)
    # A pixel on the edge may be rounded to the next grey level.
    return all(
        int(np.abs(one.grey(at).astype(int) - other.grey(at).astype(int)).max()) <= 2
        for at in (here.frame_count // 3, 2 * here.frame_count // 3)
    )


def write_tuning(table: Path | PartFile, conditions: Sequence[Condition]) -> None:
    """Write the table of a sweep; raise OutputError if it cannot be written."""
    columns = list(_cells(conditions[0].values))
    text = StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["stimulus", *columns, "model", *_MEASURES])
    for condition in conditions:
        values = list(_cells(condition.values).values())
        for detector, measures in condition.measures.items():
            numbers = [formatted(getattr(measures, name)) for name in _MEASURES]
            writer.writerow([condition.stimulus, *values, detector, *numbers])
    write_atomic(table, text.getvalue())


def write_tuning_sidecar(
    path: Path,
    entry: Entry,
    settings: Settings,
    *,
    command: Sequence[str],
    indicator_s: float = 0.0,
    figure: Mapping[str, Any] | None = None,
) -> None:
    """Write everything that is needed to trust or repeat a tuning table.

    Parameters
    ----------
    path : Path
        Its name.
    entry : Entry
        The stimulus with its sweep.
    settings : Settings
        Of the detectors.
    command : sequence of str
        The command line.
    indicator_s : float
        Time constant of the calcium indicator; 0 for none.
    figure : mapping, optional
        Name, title and kind of the classic figure that the table is for.

    Raises
    ------
    OutputError
        If it cannot be written.
    """
    first = entry.protocols()[0]
    height = settings.height or first.display.height
    content = {
        "schema": _SCHEMA,
        "tool": environment(),
        "command": list(command),
        "preset": settings.preset,
        "models": list(settings.models),
        "height": settings.height,
        "parameters": {
            name: params.as_dict()
            for name, params in settings.with_all_detectors().resolved(height).items()
        },
        "sizes_deg": settings.angles,
        "indicator_s": indicator_s,
        "stimulus": {
            "name": entry.name,
            "description": entry.description,
            "sweep": entry.sweep,
            "symmetric": is_symmetric(entry),
            "first": first.as_table(),
        },
    }
    write_sidecar(path, content | ({"figure": dict(figure)} if figure else {}))


def _cells(values: dict[str, Any]) -> dict[str, str]:
    """Return the values of a condition by column; a position becomes two columns."""
    cells: dict[str, str] = {}
    for key, value in values.items():
        if isinstance(value, list) and len(value) == 2:
            cells[f"{key}.right"], cells[f"{key}.up"] = (formatted(float(one)) for one in value)
        elif isinstance(value, bool) or not isinstance(value, int | float):
            cells[key] = str(value)
        else:
            cells[key] = formatted(float(value))
    return cells


# Words that stand for a key, and the keys that each may mean, with {id} for an object.
_WORDS = {
    "axis": ("{id}.axis_deg", "scene.rotation_deg"),
    "direction": ("scene.rotation_deg",),
    "speed": ("{id}.growth.speed_deg_s", "{id}.motion.speed_deg_s"),
    "width": ("{id}.width_deg",),
    "size": ("{id}.size_deg",),
    "l/v": ("{id}.growth.l_over_v_ms",),
    "position": ("{id}.centre_deg", "scene.centre_deg"),
}
_MOST_VALUES = 1000


def entry_named(name: str) -> Entry:
    """Return the one stimulus of a name in the catalogue, or in a TOML file.

    Raises
    ------
    StimulusError
        If none has the name, or if it is a pattern for several.
    """
    found = find(name)
    if len(found) > 1:
        raise StimulusError(
            f"'{name}' stands for {len(found)} stimuli; name one, such as '{found[0].name}'"
        )
    return found[0]


def swept(entry: Entry, over: Sequence[str]) -> Entry:
    """Return a stimulus with the sweep that the command line asks for.

    Parameters
    ----------
    entry : Entry
        The stimulus with its own sweep, if it has one.
    over : sequence of str
        ``PARAMETER`` of its own sweep, or ``PARAMETER=VALUES``; nothing keeps its
        own sweep. A parameter is a key such as ``bar.axis_deg`` or one of `WORDS`.

    Raises
    ------
    ParameterError
        If a parameter or its values cannot be understood.
    StimulusError
        If nothing is swept.
    """
    if not over:
        if not entry.sweep:
            raise StimulusError(
                f"{entry.name}: has no sweep of its own; name one, e.g. --over speed=10,20,40"
            )
        return entry
    chosen: dict[str, list[Any]] = {}
    for text in over:
        word, equals, values = text.partition("=")
        key = _key_of(entry, word.strip())
        if not equals and key not in entry.sweep:
            raise ParameterError(
                f"--over {text}: {entry.name} has no values of its own for '{key}'; "
                f"give some, e.g. --over {text}=10,20,40 or {text}=0:330:30"
            )
        chosen[key] = _values_of(text, values) if equals else entry.sweep[key]
    # Settings are checked as the protocols are made; one that names no table fails here.
    return replace(entry.with_settings({key: chosen[key][0] for key in chosen}), sweep=chosen)


def _key_of(entry: Entry, word: str) -> str:
    """Return the dotted key that a word means in a stimulus.

    Parameters
    ----------
    entry : Entry
        The stimulus.
    word : str
        One of `_WORDS`, or a dotted key, which is returned as it is.

    Raises
    ------
    ParameterError
        If the word is unknown, or means nothing or several things here.
    """
    if "." in word:
        return word
    if word not in _WORDS:
        hint = suggestion(word, _WORDS)
        raise ParameterError(f"--over {word}: no parameter '{word}'{hint}; or a key as ID.size_deg")
    objects = [one for one in entry.table.get("object", []) if isinstance(one, dict)]
    meant = [pattern.format(id=one.get("id")) for one in objects for pattern in _WORDS[word]]
    own = [key for key in dict.fromkeys(meant) if key in entry.sweep]
    if len(own) == 1:
        return own[0]
    if word in {"axis", "direction"}:
        return "scene.rotation_deg"
    if len(objects) > 1 and word == "position":
        return "scene.centre_deg"
    keys = list(dict.fromkeys(key for key in meant if _stated(objects, key)))
    if len(keys) != 1:
        found = f"is {' or '.join(keys)}" if keys else "is not among its keys"
        raise ParameterError(f"--over {word}: in {entry.name} that {found}; write a key in full")
    return keys[0]


def _values_of(text: str, values: str) -> list[Any]:
    """Read the values of a sweep.

    Parameters
    ----------
    text : str
        The complete option, for the message.
    values : str
        ``10,20,40``, ``0:330:30`` (from, to, step; both ends included), or a list as
        in TOML, such as ``[[0,0],[10,0]]``.

    Raises
    ------
    ParameterError
        If they cannot be read.
    """
    try:
        if values.count(":") == 2:
            listed = _range(*(float(end) for end in values.split(":")))
        else:
            stated = values if values.strip().startswith("[") else f"[{values}]"
            listed = tomllib.loads(f"values = {stated}")["values"]
    except ValueError:
        listed = []
    if not listed:
        raise ParameterError(
            f"--over {text}: its values cannot be read; "
            f"write 10,20,40 or 0:330:30 (from, to, step) or [[0,0],[10,0]]"
        )
    return listed


def _range(first: float, last: float, step: float) -> list[Any]:
    count = math.floor((last - first) / step + 1e-9) + 1 if step else 0
    if not 1 <= count <= _MOST_VALUES:
        return []
    values = [first + index * step for index in range(count)]
    return [int(value) if value.is_integer() else value for value in values]


def _stated(objects: Sequence[dict[str, Any]], key: str) -> bool:
    """Tell whether the file gives a value for a key of one of its objects."""
    first, *rest = key.split(".")
    value: Any = next((one for one in objects if one.get("id") == first), None)
    for word in rest:
        value = value.get(word) if isinstance(value, dict) else None
    # An object without a position is in the middle.
    return value is not None or (rest == ["centre_deg"] and first != "scene")
