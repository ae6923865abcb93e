"""The tuning table: a tidy CSV, one row per condition and model, and its sidecar."""

from __future__ import annotations

import csv
from dataclasses import fields
from io import StringIO
from typing import TYPE_CHECKING, Any

from oppload_cli.environment import environment
from oppload_cli.results.sidecar import write_sidecar
from oppload_cli.results.table import formatted
from oppload_cli.tuning.measure import Measures
from oppload_cli.video.atomic import write_atomic

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from oppload_cli.settings import Settings
    from oppload_cli.stimulus.catalogue import Entry
    from oppload_cli.tuning.run import Condition

SCHEMA = "oppload.tuning/1"
MEASURES = tuple(field.name for field in fields(Measures))


def write_tuning(path: Path, conditions: Sequence[Condition]) -> None:
    """Write a tuning table.

    Parameters
    ----------
    path : Path
        Its name; it appears whole or not at all.
    conditions : sequence of Condition
        At least one, all of one sweep.

    Raises
    ------
    OutputError
        If it cannot be written.
    """
    columns = list(_cells(conditions[0].values))
    text = StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["stimulus", *columns, "model", *MEASURES])
    for condition in conditions:
        values = list(_cells(condition.values).values())
        for model, measures in condition.measures.items():
            numbers = [formatted(getattr(measures, name)) for name in MEASURES]
            writer.writerow([condition.stimulus, *values, model, *numbers])
    write_atomic(path, [text.getvalue().encode()])


def write_tuning_sidecar(
    path: Path, entry: Entry, settings: Settings, *, symmetric: bool, command: Sequence[str]
) -> None:
    """Write all that is needed to trust or repeat a tuning table.

    Parameters
    ----------
    path : Path
        Its name.
    entry : Entry
        The stimulus with its sweep.
    settings : Settings
        What the models ran with.
    symmetric : bool
        Whether half a turn gives the same stimulus.
    command : sequence of str
        The command line.

    Raises
    ------
    OutputError
        If it cannot be written.
    """
    first = entry.protocols()[0]
    height = settings.height or first.display.height
    groups = {**settings.groups, "opplod": settings.opplod.resolved(height)}
    content = {
        "schema": SCHEMA,
        "tool": environment(),
        "command": list(command),
        "preset": settings.preset,
        "models": list(settings.models),
        "height": settings.height,
        "parameters": {name: params.as_dict() for name, params in groups.items()},
        "stimulus": {
            "name": entry.name,
            "description": entry.description,
            "sweep": entry.sweep,
            "symmetric": symmetric,
            "first": first.as_table(),
        },
    }
    write_sidecar(path, content)


def _cells(values: dict[str, Any]) -> dict[str, str]:
    """Return a condition's values by column; a place becomes two columns."""
    cells: dict[str, str] = {}
    for key, value in values.items():
        if isinstance(value, list) and len(value) == 2:
            cells[f"{key}.right"], cells[f"{key}.up"] = (formatted(float(one)) for one in value)
        elif isinstance(value, bool) or not isinstance(value, int | float):
            cells[key] = str(value)
        else:
            cells[key] = formatted(float(value))
    return cells
