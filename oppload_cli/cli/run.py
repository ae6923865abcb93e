"""``oppload run``."""

from __future__ import annotations

import sys
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING

import click

from oppload_cli.cli import say
from oppload_cli.cli.options import settings_options
from oppload_cli.errors import ExitCode, OpploadError, OutputError, ParameterError, printable

if TYPE_CHECKING:
    from collections.abc import Iterator

    from oppload_cli.task import Outcome, Task

STANDARD_OUTPUT = "-"


@click.command(short_help="run both looming detectors on videos")
@click.argument("inputs", nargs=-1, required=True, metavar="INPUT...")
@click.option(
    "-o",
    "--output",
    default=".",
    metavar="DIR",
    help="Folder of the results; '-' streams one input's CSV.  [default: this folder]",
)
@settings_options
@click.option("--start", metavar="POSITION", help="First frame: 12.5 (s), f300 or 00:01:02.5.")
@click.option("--end", metavar="POSITION", help="Stop before this.")
@click.option("--duration", metavar="POSITION", help="Stop this long after the start.")
@click.option(
    "--image-rate", default="30", metavar="HZ", show_default=True, help="Frames/s of images."
)
@click.option(
    "--if-exists",
    type=click.Choice(["error", "skip", "overwrite"]),
    default="error",
    show_default=True,
    help="What to do where a result is there already.",
)
@click.option("-q", "--quiet", is_flag=True, help="Print errors only.")
@click.option("-v", "--verbose", is_flag=True, help="Print the sizes that the models see.")
def run(  # noqa: PLR0917 - click passes them by name
    inputs: tuple[str, ...],
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
    if_exists: str,
    quiet: bool,
    verbose: bool,
) -> int:
    """Run OppLoD and D-LGMD on videos, frame by frame.

    INPUT is a video file, a folder of videos or of images, a pattern such as
    frames_%04d.png, camera:0, or a stream's address. For each, DIR gets
    {stem}.frames.csv, a row per frame, and {stem}.oppload.json, all that is needed
    to trust or repeat it.
    """
    from oppload_cli.settings import resolve  # noqa: PLC0415 - keeps --help fast
    from oppload_cli.task import IfExists, Task  # noqa: PLC0415
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
    if output == STANDARD_OUTPUT:
        tasks = [Task(_only(inputs), settings, span=span, image_rate=rate, command=command)]
        failures: list[tuple[str, OpploadError]] = []
    else:
        names, failures = _expanded(inputs)
        tasks = [
            Task(name, settings, csv, sidecar, span, rate, existing, command)
            for name, csv, sidecar in _placed(names, Path(output))
        ]
    return _run_all(tasks, failures, verbosity=-1 if quiet else int(verbose))


def _run_all(tasks: list[Task], failures: list[tuple[str, OpploadError]], *, verbosity: int) -> int:
    """Run every task; a bad input never stops the others."""
    count = len(tasks) + len(failures)
    several = count > 1
    if failures and not several:
        raise failures[0][1]
    incomplete = False
    for task in tasks:
        try:
            outcome = _run_one(task, verbosity)
        except OpploadError as error:
            if not several:
                raise
            failures.append((task.name, error))
        else:
            incomplete |= not outcome.complete
    for _, failed in failures:
        say(f"oppload: {failed}")
    if not failures:
        return ExitCode.INCOMPLETE if incomplete else ExitCode.DONE
    if len(failures) == count:
        return max(failed.exit_code for _, failed in failures)
    say(f"oppload: {len(failures)} of the inputs failed; the others are done")
    return ExitCode.INCOMPLETE


def _run_one(task: Task, verbosity: int) -> Outcome:
    from oppload_cli.cli.progress import Progress  # noqa: PLC0415
    from oppload_cli.task import run_task  # noqa: PLC0415

    progress = Progress(printable(task.name), verbosity, whole=task.span.open_ended)
    try:
        outcome = run_task(task, progress)
    finally:
        progress.close()
    if verbosity >= 0:
        for line in _report(task, outcome):
            say(line)
    elif not outcome.complete:
        say(_incomplete(task, outcome))
    return outcome


def _report(task: Task, outcome: Outcome) -> Iterator[str]:
    if outcome.skipped:
        yield f"{task.name}: skipped, {task.csv} exists"
        return
    peaks = []
    for name, summary in outcome.summaries.items():
        if summary.peak_frame is None:
            peaks.append(f"{name} no response")
        else:
            alarm = summary.first_alarm_frame
            peaks.append(
                f"{name} peak {summary.peak:.3g} at frame {summary.peak_frame}, "
                + (f"first alarm at frame {alarm}" if alarm is not None else "no alarm")
            )
    speed = f"{outcome.frames / outcome.wall_s:.0f} frames/s" if outcome.wall_s else ""
    place = f" -> {task.csv}" if task.csv else ""
    yield f"{task.name}: {outcome.frames} frames, {speed}; {'; '.join(peaks)}{place}"
    if not outcome.complete:
        yield _incomplete(task, outcome)
    elif outcome.notes:
        yield f"oppload: {task.name}: {'; '.join(outcome.notes)}"


def _incomplete(task: Task, outcome: Outcome) -> str:
    return (
        f"oppload: {task.name}: incomplete ({'; '.join(outcome.notes) or 'damaged frames'}); "
        f"the rows that are there hold"
    )


def _expanded(inputs: tuple[str, ...]) -> tuple[list[str], list[tuple[str, OpploadError]]]:
    from oppload_cli.video.inputs import each_once, single_inputs  # noqa: PLC0415

    names: list[str] = []
    failures: list[tuple[str, OpploadError]] = []
    for name in dict.fromkeys(inputs):
        try:
            names += single_inputs(name)
        except OpploadError as error:
            failures.append((name, error))
    return each_once(names), failures


def _placed(names: list[str], folder: Path) -> Iterator[tuple[str, Path, Path]]:
    from oppload_cli.video.inputs import result_stems  # noqa: PLC0415

    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise OutputError(
            f"{folder}: cannot be made ({reason}); choose another folder with --output"
        ) from error
    for name, stem in zip(names, result_stems(names), strict=True):
        yield name, folder / f"{stem}.frames.csv", folder / f"{stem}.oppload.json"


def _only(inputs: tuple[str, ...]) -> str:
    if len(inputs) > 1:
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
