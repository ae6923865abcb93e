"""The tidy tables of an evaluation: figures, responses and windows."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from oppload_cli.detection.evaluation.windows import (
    AHEAD,
    before_contact,
    tiled,
    without_approach,
)
from oppload_cli.results.sinks import sink

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from oppload_cli.detection.evaluation.series import Seen
    from oppload_cli.detection.evaluation.windows import Window
    from oppload_cli.evaluation.evaluate import Evaluation
    from oppload_cli.results.sinks import Cell

FIGURES: dict[str, type] = {
    "contender": str,
    "measure": str,
    "condition": str,
    "value": float,
    "low": float,
    "high": float,
    "n": int,
}
RESPONSES: dict[str, type] = {
    "clip": str,
    "frame": int,
    "time_s": float,
    "contender": str,
    "response": float,
    "alarm": bool,
    "x": float,
    "y": float,
    "width": float,
    "height": float,
}
WINDOWS: dict[str, type] = {
    "clip": str,
    "use": str,
    "frames_before_contact": int,
    "first_frame": int,
    "last_frame": int,
    "contender": str,
    "score": float,
}


def write_tables(evaluation: Evaluation, folder: Path) -> list[Path]:
    """Write ``evaluation.csv``, ``responses.csv`` and ``windows.csv``.

    Parameters
    ----------
    evaluation : Evaluation
        What was measured.
    folder : Path
        Where they go.

    Returns
    -------
    list of Path
        The files.

    Raises
    ------
    OutputError
        If one cannot be written.
    """
    figures = (dict(figure._asdict()) for figure in evaluation.figures)
    made = []
    for name, columns, rows in (
        ("evaluation.csv", FIGURES, figures),
        ("responses.csv", RESPONSES, _responses(evaluation)),
        ("windows.csv", WINDOWS, _windows(evaluation)),
    ):
        made.append(folder / name)
        with sink(made[-1], columns) as table:
            for row in rows:
                table.write({key: _known(value) for key, value in row.items()})
    return made


def _responses(evaluation: Evaluation) -> Iterator[dict[str, Cell]]:
    """Yield a row per clip, contender and frame."""
    for seen in evaluation.clips:
        for name, answer in seen.answers.items():
            for frame, response in enumerate(answer.response):
                row: dict[str, Cell] = {
                    "clip": seen.label.name,
                    "frame": frame,
                    "time_s": float(seen.time_s[frame]),
                    "contender": name,
                    "response": float(response),
                }
                if answer.alarm is not None and not math.isnan(response):
                    row["alarm"] = bool(answer.alarm[frame])
                if answer.place is not None:
                    sides = map(float, answer.place[frame])
                    row.update(zip(("x", "y", "width", "height"), sides, strict=True))
                yield row


def _windows(evaluation: Evaluation) -> Iterator[dict[str, Cell]]:
    """Yield a row per window and contender, for each use of it."""
    for seen in evaluation.clips:
        for use, ahead, window in _uses(seen):
            for name, answer in seen.answers.items():
                yield {
                    "clip": seen.label.name,
                    "use": use,
                    "frames_before_contact": ahead,
                    "first_frame": window.start,
                    "last_frame": window.stop - 1,
                    "contender": name,
                    "score": window.score(answer.response),
                }


def _uses(seen: Seen) -> Iterator[tuple[str, int | None, Window]]:
    for window in without_approach(seen):
        yield "without approach", None, window
    for frames in AHEAD:
        approach = before_contact(seen, frames)
        if approach is not None:
            yield "approach", frames, approach
            for window in tiled(seen, seen.first, approach.start):
                yield "earlier", frames, window


def _known(value: Cell) -> Cell:
    return None if isinstance(value, float) and math.isnan(value) else value
