"""``oppload run``: one input, or the plan of many."""

from __future__ import annotations

import os
import sys
from contextlib import ExitStack
from dataclasses import replace
from fractions import Fraction
from typing import TYPE_CHECKING, Any, NamedTuple

import click

from oppload_cli.cli import say
from oppload_cli.cli.options import if_exists_option, jobs_option, output_option, settings_options
from oppload_cli.cli.report import write_pages
from oppload_cli.errors import ExitCode, OutputError, ParameterError, SourceError, printable
from oppload_cli.files.reading import text_of
from oppload_cli.models.presets import DEFAULT_PRESET, PRESETS, preset_in
from oppload_cli.schema import parsed_fraction
from oppload_cli.video.opening import Opening, is_video_file
from oppload_cli.video.span import Span, parse_position

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from oppload_cli.batch.plan import Plan
    from oppload_cli.pipeline.settings import Settings
    from oppload_cli.pipeline.task import Task


STANDARD_OUTPUT = "-"


class _Selection(NamedTuple):
    """The inputs that the user names, and how they are done.

    Attributes
    ----------
    recursive : bool
        Whether folders are searched to any depth.
    files_from : str or None
        A list of inputs.
    null : bool
        Whether the names of the list end in NUL.
    shard : str or None
        ``I/N``.
    jobs : int
        Processes; 0 means the cores that the affinity mask allows.
    scheduler : str or None
        Address or file of a dask scheduler.
    dry_run : bool
        Whether the plan is only printed.
    """

    recursive: bool
    files_from: str | None
    null: bool
    shard: str | None
    jobs: int
    scheduler: str | None
    dry_run: bool

    @property
    def wants_report(self) -> bool:
        """Whether a batch is meant, however many inputs it has."""
        return bool(self.recursive or self.files_from or self.shard or self.scheduler)


@click.command(short_help="run looming detectors on videos")
@click.argument("inputs", nargs=-1, metavar="INPUT...")
@output_option(".", "Folder of the results; '-' streams one input's CSV.  [default: this folder]")
@settings_options()
@click.option("-r", "--recursive", is_flag=True, help="Search folders to any depth.")
@click.option(
    "--files-from",
    metavar="LIST|-",
    help="Read inputs from a list, a name per line, or from a failures.csv.",
)
@click.option("-0", "--null", is_flag=True, help="The names of the list end in NUL.")
@jobs_option("Inputs")
@click.option("--shard", metavar="I/N", help="Do only the I-th of N parts, for job arrays.")
@click.option(
    "--scheduler",
    metavar="ADDRESS|FILE",
    help="Run on this dask cluster: tcp://host:port or a scheduler file.",
)
@click.option("--dry-run", is_flag=True, help="Print the plan, and do nothing.")
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
    "--report",
    "report_pages",
    is_flag=True,
    help="Write {stem}.report.html too, a page with video and curves; see 'oppload report'.",
)
@click.option(
    "--boxes",
    type=click.Choice(["alarm", "all", "none"]),
    default="alarm",
    show_default=True,
    help="Boxes in the annotated video: of objects that cause an alarm, of all, or none.",
)
@if_exists_option("a result", skip=True)
@click.option(
    "--fail-on",
    type=click.Choice(["alarm", "no-alarm"]),
    help="End with exit code 5: alarm, if any input had an alarm; no-alarm, if any input had none.",
)
@click.option("-q", "--quiet", is_flag=True, help="Print errors only.")
@click.option("-v", "--verbose", is_flag=True, help="Print the sizes that the models see.")
def run(
    inputs: tuple[str, ...],
    output: Path,
    start: str | None,
    end: str | None,
    duration: str | None,
    image_rate: str,
    annotate: bool,
    report_pages: bool,
    boxes: str,
    if_exists: str,
    fail_on: str | None,
    quiet: bool,
    verbose: bool,
    **others: Any,
) -> int:
    """Run OppLoD and D-LGMD on videos, frame by frame.

    INPUT is a video file, a folder of videos or of images, a pattern such as
    'clips/*.mp4' or frames_%04d.png, camera:0, or a stream's address. For each, DIR
    gets {stem}.frames.csv, a row per frame, {stem}.detections.jsonl, a line per
    looming object and frame, and {stem}.oppload.json, all that is needed to trust or
    repeat it. Of many inputs, DIR/alarms.csv lists the alarms, and DIR/failures.csv the
    inputs that fail.
    """
    from oppload_cli.files.atomic import make_folder

    selection = _Selection(**{name: others.pop(name) for name in _Selection._fields})
    if not inputs and not selection.files_from:
        raise click.UsageError("Missing argument 'INPUT...'; or give --files-from LIST")
    span = Span(*(parse_position(text) if text else None for text in (start, end, duration)))
    rate = _rate(image_rate)
    opening = None
    with ExitStack() as stack:
        if len(inputs) == 1 and not (annotate or selection.wants_report or selection.dry_run):
            opening = _begun(inputs[0], span, rate, others)
            if opening is not None:
                stack.callback(opening.close)
        # Not before: these load the detectors.
        from oppload_cli.pipeline.outputs import IfExists
        from oppload_cli.pipeline.settings import resolve
        from oppload_cli.pipeline.task import Task

        settings = resolve(**others)
        _check_alarms(settings, fail_on, quiet=quiet)
        _check_loops(quiet=quiet)
        command = ["oppload", *sys.argv[1:]]
        verbosity = -1 if quiet else int(verbose)
        task = Task("", settings, None, span, rate, IfExists(if_exists), command, boxes=boxes)
        if str(output) == STANDARD_OUTPUT:
            name = _only(inputs, selection, annotate=annotate, report=report_pages)
            return _run_one(replace(task, name=name), verbosity, fail_on, opening)
        folder, plan = output, _plan_of(inputs, selection)
        if report_pages and selection.shard:
            raise ParameterError(
                "--report makes one index of all pages; leave it out with --shard, and run "
                "'oppload report DIR' when all parts are done"
            )
        tasks = _tasks(plan, folder, task, annotate=annotate)
        if selection.dry_run:
            return _print_plan(tasks, plan)
        alone = len(plan) == 1 and not selection.wants_report
        if alone and plan.failures:
            raise SourceError(plan.failures[0].message)
        make_folder(folder)
        if alone:
            code = _run_one(next(tasks), verbosity, fail_on, opening)
        else:
            from oppload_cli.cli.batch import Batch

            batch = Batch(plan, folder, settings.models, verbosity, fail_on, shard=selection.shard)
            code = batch.run(tasks, selection.jobs, selection.scheduler)
        if not report_pages:
            return code
        return (
            _report(_tasks(plan, folder, task, annotate=annotate), folder, selection, quiet) or code
        )


def _check_alarms(settings: Settings, fail_on: str | None, *, quiet: bool) -> None:
    """Where alarms are off, say why, and refuse a condition on them."""
    if settings.alarm.on:
        return
    reason = PRESETS[settings.preset].no_alarm
    why = f" under preset '{settings.preset}', because {reason}" if reason else ""
    if fail_on:
        raise ParameterError(f"--fail-on: alarms are off{why}; choose another preset")
    if not quiet:
        say(f"oppload: alarms are off{why}; --set alarm.on=true switches them on")


def _check_loops(*, quiet: bool) -> None:
    """Say why the models run slowly, unless the user has switched the compiled loops off."""
    from oppload_cli.compute import loops

    reason = None if loops.portable else loops.why_portable() or loops.why_not_wide()
    if reason and not quiet:
        slow = "10 to 20 times as slow as" if loops.arithmetic() == "portable" else "slower than"
        say(f"oppload: {reason}. The alarms are the same, but the models are {slow} usual")


def _begun(name: str, span: Span, image_rate: Fraction, settings: dict[str, Any]) -> Opening | None:
    """Begin to decode a single video file, while the detectors are loaded.

    None for other inputs, and where a setting is wrong: resolving it gives the error.
    """
    if not is_video_file(name):
        return None
    try:
        content: dict[str, Any] = {}
        if settings["config"]:
            import tomllib

            content = tomllib.loads(text_of(settings["config"]))
        stated = settings["preset"] or preset_in(settings["models"])
        preset = PRESETS[stated or content.get("preset", DEFAULT_PRESET)]
        wanted = settings["height"] or content.get("height", preset.height)
        pixels = None if wanted == "native" else int(wanted)
    except (OSError, ValueError, TypeError, KeyError, RecursionError):
        return None
    return Opening(name, height=pixels, span=span, image_rate=image_rate, own_process=True)


def _run_one(task: Task, verbosity: int, fail_on: str | None, opening: Opening | None) -> int:
    """Run one input, showing its frames."""
    from oppload_cli.batch.report import Tally
    from oppload_cli.cli.progress import Progress, incomplete, report
    from oppload_cli.pipeline.execute import run_task

    progress = Progress(printable(task.name), verbosity, to_end=task.span.open_ended)
    try:
        outcome = run_task(task, progress, opening)
    except SourceError as error:
        raise SourceError(f"{error}{_stimulus_of(task.name)}") from error
    finally:
        progress.close()
    if verbosity >= 0:
        for line in report(task, outcome):
            say(line)
    elif not outcome.complete:
        say(incomplete(task, outcome))
    tally = Tally()
    tally.add(task.name, outcome)
    return tally.exit_code_unless(fail_on)


def _stimulus_of(name: str) -> str:
    """Return how to make the stimulus whose name was given in place of a file, or nothing."""
    if os.path.lexists(name):
        return ""
    from oppload_cli.errors import StimulusError
    from oppload_cli.stimulus.catalogue import find

    try:
        found = find(name)
    except StimulusError:
        return ""
    return f"; 'oppload stimuli generate {found[0].name}' makes the stimulus of this name"


def _report(tasks: Iterator[Task], folder: Path, selection: _Selection, quiet: bool) -> int:
    """Write the pages of the results that are there; return the exit code."""
    named = [task.outputs.csv for task in tasks if task.outputs]
    tables = [table for table in named if os.path.lexists(table)]
    if not tables:
        return ExitCode.DONE
    page, code = write_pages(tables, folder, jobs=selection.jobs, quiet=quiet)
    if not quiet:
        say(f"page: {page}")
    return code


def _plan_of(inputs: tuple[str, ...], selection: _Selection) -> Plan:
    from oppload_cli.batch.plan import parse_shard, planned, read_list

    shard = parse_shard(selection.shard) if selection.shard else None
    listed = read_list(selection.files_from, null=selection.null) if selection.files_from else []
    plan = planned([*inputs, *listed], recursive=selection.recursive)
    return plan.shard(*shard) if shard else plan


def _tasks(plan: Plan, folder: Path, task: Task, *, annotate: bool) -> Iterator[Task]:
    """Yield a task per input, like the one given."""
    from oppload_cli.pipeline.outputs import Outputs

    models = task.settings.models
    for each in plan.inputs:
        outputs = Outputs.of(folder, each.stem, models, annotate=annotate)
        yield replace(task, name=each.name, stem=each.stem, outputs=outputs)


def _print_plan(tasks: Iterator[Task], plan: Plan) -> int:
    """Print what would be done, a line per input; return the exit code."""
    from oppload_cli.batch.report import Tally
    from oppload_cli.pipeline.task import exists_already

    counts = {"run": 0, "skip": 0, "refuse": 0}
    for task in tasks:
        try:
            state = "run" if exists_already(task) is None else "skip"
        except OutputError:
            state = "refuse"
        counts[state] += 1
        table = task.outputs and task.outputs.csv
        click.echo(f"{state}\t{printable(task.name)}\t{printable(str(table))}")
    failures = plan.failures
    for failure in failures:
        say(f"oppload: {failure.message}")
    refused = ", which have results: see --if-exists" if counts["refuse"] else ""
    say(
        f"{len(plan)} inputs: {counts['run']} to run, {counts['skip']} to skip, "
        f"{len(failures)} not there, {counts['refuse']} to refuse{refused}"
    )
    if failures and len(failures) == len(plan):
        return Tally(failures).exit_code
    return ExitCode.INCOMPLETE if failures else ExitCode.DONE


def _only(inputs: tuple[str, ...], selection: _Selection, *, annotate: bool, report: bool) -> str:
    if annotate or report:
        option = "--annotate" if annotate else "--report"
        raise ParameterError(f"{option} writes a file; give a folder with --output, not '-'")
    if len(inputs) != 1 or selection.wants_report or selection.dry_run:
        raise ParameterError("'-o -' streams one input; give one, or a folder with --output")
    return inputs[0]


def _rate(text: str) -> Fraction:
    try:
        rate = parsed_fraction(text)
    except (ValueError, ZeroDivisionError):
        rate = Fraction(0)
    if not Fraction(1, 1_000_000) <= rate <= 100_000:
        raise ParameterError(
            f"--image-rate must be a number above 0 such as 30 or 30000/1001, from 0.000001 to "
            f"100000, not '{text[:80]}'"
        )
    return rate
