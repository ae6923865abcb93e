"""``oppload run``."""

from __future__ import annotations

import sys
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING

import click

from oppload_cli.cli import say
from oppload_cli.cli.options import settings_options
from oppload_cli.cli.selection import plan_of, print_plan, several_options
from oppload_cli.cli.several import Batch, incomplete, report
from oppload_cli.errors import OutputError, ParameterError, SourceError, printable

if TYPE_CHECKING:
    from collections.abc import Iterator

    from oppload_cli.batch.plan import Plan
    from oppload_cli.cli.selection import Selection
    from oppload_cli.task import Task
    from oppload_cli.video.apart import DecodingProcess

STANDARD_OUTPUT = "-"


@click.command(short_help="run both looming detectors on videos")
@click.argument("inputs", nargs=-1, metavar="INPUT...")
@click.option(
    "-o",
    "--output",
    default=".",
    metavar="DIR",
    help="Folder of the results; '-' streams one input's CSV.  [default: this folder]",
)
@settings_options
@several_options
@click.option("--start", metavar="POSITION", help="First frame: 12.5 (s), f300 or 00:01:02.5.")
@click.option("--end", metavar="POSITION", help="Stop before this.")
@click.option("--duration", metavar="POSITION", help="Stop this long after the start.")
@click.option(
    "--image-rate", default="30", metavar="HZ", show_default=True, help="Frames/s of images."
)
@click.option(
    "--annotate", is_flag=True, help="Write {stem}.annotated.mp4 too: boxes, responses and alarms."
)
@click.option(
    "--if-exists",
    type=click.Choice(["error", "skip", "overwrite"]),
    default="error",
    show_default=True,
    help="What to do where a result is there already.",
)
@click.option(
    "--fail-on",
    type=click.Choice(["alarm", "no-alarm"]),
    help="Exit with 5 if an input had an alarm of any model, or if one had none.",
)
@click.option("-q", "--quiet", is_flag=True, help="Print errors only.")
@click.option("-v", "--verbose", is_flag=True, help="Print the sizes that the models see.")
@click.pass_obj
def run(  # noqa: PLR0917 - click passes them by name
    apart: DecodingProcess | None,
    inputs: tuple[str, ...],
    selection: Selection,
    output: str,
    models: tuple[str, ...],
    preset: str | None,
    assignments: tuple[str, ...],
    config: Path | None,
    height: str | None,
    measure_rmo: bool | None,
    start: str | None,
    end: str | None,
    duration: str | None,
    image_rate: str,
    annotate: bool,
    if_exists: str,
    fail_on: str | None,
    quiet: bool,
    verbose: bool,
) -> int:
    """Run OppLoD and D-LGMD on videos, frame by frame.

    INPUT is a video file, a folder of videos or of images, a pattern such as
    'clips/*.mp4' or frames_%04d.png, camera:0, or a stream's address. For each, DIR
    gets {stem}.frames.csv, a row per frame, {stem}.detections.jsonl, a line per
    looming object and frame, and {stem}.oppload.json, all that is needed to trust or
    repeat it. What fails of many inputs is listed in DIR/failures.csv.
    """
    from oppload_cli.outputs import IfExists  # noqa: PLC0415 - keeps --help fast
    from oppload_cli.settings import resolve  # noqa: PLC0415
    from oppload_cli.task import Task  # noqa: PLC0415
    from oppload_cli.video.span import Span, parse_position  # noqa: PLC0415

    settings = resolve(
        preset=preset,
        config=config,
        models=models,
        height=height,
        measure_rmo=measure_rmo,
        assignments=assignments,
    )
    span = Span(*(parse_position(text) if text else None for text in (start, end, duration)))
    command = ["oppload", *sys.argv[1:]]
    rate, existing = _rate(image_rate), IfExists(if_exists)
    verbosity = -1 if quiet else int(verbose)
    task = Task("", settings, None, span, rate, existing, command)
    if output == STANDARD_OUTPUT:
        name = _only(inputs, selection, annotate=annotate)
        return _run_one(replace(task, name=name), verbosity, fail_on, apart)
    folder, plan = Path(output), plan_of(inputs, selection)
    tasks = _tasks(plan, folder, task, annotate=annotate)
    if selection.dry_run:
        return print_plan(tasks, plan)
    alone = len(plan) == 1 and not selection.wants_report
    if alone and plan.failures:
        raise SourceError(plan.failures[0].message)
    _make(folder)
    if alone:
        return _run_one(next(tasks), verbosity, fail_on, apart)
    if apart is not None:
        apart.close()  # each process of a batch decodes for itself
    return Batch(plan, selection, folder, verbosity, fail_on).run(tasks)


def _run_one(task: Task, verbosity: int, fail_on: str | None, apart: DecodingProcess | None) -> int:
    """Run one input, showing its frames."""
    from oppload_cli.batch.report import Tally  # noqa: PLC0415
    from oppload_cli.cli.progress import Progress  # noqa: PLC0415
    from oppload_cli.task import run_task  # noqa: PLC0415

    progress = Progress(printable(task.name), verbosity, whole=task.span.open_ended)
    try:
        outcome = run_task(task, progress, apart)
    finally:
        progress.close()
    if verbosity >= 0:
        for line in report(task, outcome):
            say(line)
    elif not outcome.complete:
        say(incomplete(task, outcome))
    tally = Tally()
    tally.add(outcome)
    return tally.exit_code_unless(fail_on)


def _tasks(plan: Plan, folder: Path, task: Task, *, annotate: bool) -> Iterator[Task]:
    """Yield a task per input, like the one given."""
    from oppload_cli.outputs import Outputs  # noqa: PLC0415

    models = task.settings.models
    for each in plan.inputs:
        outputs = Outputs.of(folder, each.stem, models, annotate=annotate)
        yield replace(task, name=each.name, outputs=outputs)


def _make(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise OutputError(
            f"{folder}: cannot be made ({reason}); choose another folder with --output"
        ) from error


def _only(inputs: tuple[str, ...], selection: Selection, *, annotate: bool) -> str:
    if annotate:
        raise ParameterError("--annotate writes a file; give a folder with --output, not '-'")
    if len(inputs) != 1 or selection.wants_report or selection.dry_run:
        raise ParameterError("'-o -' streams one input; give one, or a folder with --output")
    return inputs[0]


def _rate(text: str) -> Fraction:
    try:
        rate = Fraction(text)
    except (ValueError, ZeroDivisionError):
        rate = Fraction(0)
    if not 0 < rate <= 100_000:
        raise ParameterError(
            f"--image-rate must be a number above 0 such as 30 or 30000/1001, not '{text}'"
        )
    return rate
