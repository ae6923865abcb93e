"""The files of an evaluation, each written as a whole or not at all."""

from __future__ import annotations

from typing import TYPE_CHECKING

from oppload_cli.evaluation.report import report_json, report_of
from oppload_cli.evaluation.tables import write_tables
from oppload_cli.video.atomic import write_atomic

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from oppload_cli.evaluation.evaluate import Evaluation

FILES = ("evaluation.csv", "responses.csv", "windows.csv", "report.json")


def write_evaluation(
    evaluation: Evaluation, folder: Path, wall_s: Callable[[], float]
) -> Iterator[Path]:
    """Write everything that an evaluation gives.

    Parameters
    ----------
    evaluation : Evaluation
        What was measured.
    folder : Path
        Where it goes.
    wall_s : callable
        Returns the seconds that it took so far: the one thing in the files that is
        not the same for the same clips, under ``timing`` in ``report.json``.

    Yields
    ------
    Path
        Each file once it is there.

    Raises
    ------
    OutputError
        If one cannot be written.
    """
    report = report_of(evaluation)
    yield from write_tables(evaluation, folder)
    frames = report["manifest"]["frames"]
    seconds = wall_s()
    timing = {"wall_s": round(seconds, 1), "frames_per_s": round(frames / seconds, 1)}
    path = folder / "report.json"
    write_atomic(path, [report_json({**report, "timing": timing}).encode()])
    yield path
