"""The files of an evaluation, each written as a whole or not at all."""

from __future__ import annotations

from typing import TYPE_CHECKING

from oppload_cli.evaluation.definitions import displayed
from oppload_cli.evaluation.page import PLOTS, page_of
from oppload_cli.evaluation.report import report_json, report_of
from oppload_cli.evaluation.stills import pictures, worst
from oppload_cli.evaluation.tables import write_tables
from oppload_cli.plots.evaluation import (
    Drawn,
    plot_detection,
    plot_false_alarms,
    plot_leads,
    plot_order,
    plot_precision_recall,
    plot_roc,
)
from oppload_cli.plots.style import png_bytes
from oppload_cli.video.atomic import disk_errors, remove, write_atomic

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from oppload_cli.evaluation.evaluate import Evaluation

TABLES = ("evaluation.csv", "responses.csv", "windows.csv")
FILES = (*TABLES, *PLOTS, "report.json", "evaluation.html")
DPI = 160


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
    report, plots, moments = report_of(evaluation), drawn(evaluation), worst(evaluation)
    page = page_of(evaluation, report, plots, moments, pictures(evaluation, moments))
    # Old files must never stand beside new ones, however this ends; the page comes last.
    for name in FILES:
        with disk_errors(folder / name):
            remove(folder / name)
    yield from write_tables(evaluation, folder)
    for name, png in plots.items():
        write_atomic(folder / name, [png])
        yield folder / name
    frames = report["manifest"]["frames"]
    seconds = wall_s()
    timing = {"wall_s": round(seconds, 1), "frames_per_s": round(frames / seconds, 1)}
    for name, text in (
        ("report.json", report_json({**report, "timing": timing})),
        ("evaluation.html", page),
    ):
        write_atomic(folder / name, [text.encode("utf-8", "backslashreplace")])
        yield folder / name


def drawn(evaluation: Evaluation) -> dict[str, bytes]:
    """Draw the figures.

    Parameters
    ----------
    evaluation : Evaluation
        What was measured.

    Returns
    -------
    dict of str to bytes
        PNG by file name.
    """
    contenders = [Drawn(n, displayed(n), each) for n, each in evaluation.measured.items()]
    plots = {
        "detection.png": plot_detection,
        "roc.png": plot_roc,
        "precision-recall.png": plot_precision_recall,
        "within-clip.png": plot_order,
        "lead-time.png": plot_leads,
        "false-alarms.png": plot_false_alarms,
    }
    return {name: png_bytes(plot(contenders), DPI) for name, plot in plots.items()}
