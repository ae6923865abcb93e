"""The part of ``oppload run`` that needs the detectors: it runs the inputs, and prints.

The command imports this module after it has begun to decode the video.
"""

from __future__ import annotations

import os
import sys
import time
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from oppload_cli.batch.plan import (
    FAILURE_COLUMNS,
    Failure,
    Tally,
    parse_shard,
    planned,
    read_list,
    write_failures,
)
from oppload_cli.batch.tasks import run_tasks
from oppload_cli.cli import say
from oppload_cli.cli.options import RunOptions, check_models
from oppload_cli.cli.progress import AlarmTable, BatchProgress, Progress, faults, outcome_lines
from oppload_cli.cli.report import write_pages
from oppload_cli.compute import loops
from oppload_cli.errors import (
    ExitCode,
    OpploadError,
    OutputError,
    ParameterError,
    ResultError,
    SourceError,
    counted,
    printable,
)
from oppload_cli.files.atomic import folder_of_outputs
from oppload_cli.files.reading import is_file
from oppload_cli.files.tables import refuse_another_table, rows_of
from oppload_cli.models.detector import Detector
from oppload_cli.models.registry import detector_named
from oppload_cli.pipeline.execute import run_task
from oppload_cli.pipeline.settings import Settings, check_assignments, resolve
from oppload_cli.pipeline.task import (
    IfExists,
    Interrupted,
    Outcome,
    Outputs,
    Task,
    exists_already,
)
from oppload_cli.results.alarm_log import ALARM_COLUMNS, write_alarms
from oppload_cli.video.inputs import GROUND_TRUTH, is_missing, is_real_time, left_out

if sys.platform == "win32":
    from subprocess import list2cmdline as command_line
else:
    from shlex import join as command_line

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from oppload_cli.batch.plan import Plan
    from oppload_cli.video.opening import Opening
    from oppload_cli.video.span import Reading, Span


_STANDARD_OUTPUT = "-"
_MOST_LISTED = 10  # how many inputs with alarms, and how many with remarks, are printed


def run_inputs(
    inputs: tuple[str, ...],
    options: RunOptions,
    chosen: dict[str, Any],
    span: Span,
    reading: Reading,
    opening: Opening | None,
) -> int:
    """Run the detectors on inputs; return the exit code.

    Parameters
    ----------
    inputs : tuple of str
        The names that the user gives.
    options : RunOptions
        The options of the command, without the following ones.
    chosen : dict
        The settings, as for :func:`oppload_cli.pipeline.settings.resolve`.
    span : Span
        The part of each input.
    reading : Reading
        What the user states about the inputs.
    opening : Opening or None
        The opening of a single input whose decoding has begun.
    """
    check_models(chosen["models"], "run")
    settings = resolve(**chosen)
    check_assignments(chosen["assignments"], settings.models, measure_rmo=settings.measure_rmo)
    _check_options(options, settings)
    for note in () if options.quiet else _notes(settings):
        say(f"oppload: {note}")
    if_exists, command = IfExists(options.if_exists), ["oppload", *sys.argv[1:]]
    task = Task("", settings, None, span, reading, if_exists, command, boxes=options.boxes)
    if str(options.output) == _STANDARD_OUTPUT:
        return _run_one(replace(task, name=_streamed_input(inputs, options)), options, opening)
    plan = _plan_of(inputs, options)
    tasks = _tasks(plan, task, options)
    if options.dry_run:
        return _print_plan(tasks, plan)
    alone = len(plan) == 1 and not options.for_many
    if alone and plan.failures:
        raise SourceError(plan.failures[0].message)
    with folder_of_outputs(options.output):
        try:
            if alone:
                code = _run_one(next(tasks), options, opening)
            else:
                shown = settings.with_alarm
                code = _Batch(plan, shown, options).run(tasks)
        except Interrupted as stop:
            if options.report_pages and _existing_tables(_tasks(plan, task, options)):
                words = command_line(["oppload", "report", str(options.output)])
                raise Interrupted(f"{stop}; '{words}' makes the pages") from stop
            raise
        if options.report_pages:
            code = _make_pages(_tasks(plan, task, options), options) or code
        return code


def _check_options(options: RunOptions, settings: Settings) -> None:
    """Raise ParameterError if options contradict each other or the settings."""
    if options.boxes != "alarm" and not options.annotate:
        raise ParameterError("--boxes has no effect without --annotate; give both or neither")
    if options.quiet and options.verbose:
        raise ParameterError("--quiet and --verbose exclude each other; give one of them")
    if options.null and not options.files_from:
        raise ParameterError("--null has no effect without --files-from; give both or neither")
    if options.fail_on and not settings.with_alarm:
        raise ParameterError(f"--fail-on: {_no_alarm(settings)}; choose another detector")
    if options.report_pages and options.shard:
        raise ParameterError(
            "--report makes one index of all pages; leave it out with --shard, and run "
            "'oppload report DIR' when all parts are done"
        )


def _no_alarm(settings: Settings) -> str:
    """Return a text that says which detectors have no alarm, and why."""
    reasons: dict[str, list[str]] = {}
    for name in settings.models:
        if name not in settings.with_alarm:
            reasons.setdefault(settings.alarm.rule_of(name).why_none, []).append(name)
    return "; ".join(f"no alarm of {', '.join(names)}: {why}" for why, names in reasons.items())


def _notes(settings: Settings) -> Iterator[str]:
    """Yield sentences on alarms that are off, on detectors without a floor, and on slow ones."""
    if without := _no_alarm(settings):
        silent = [name for name in settings.models if name not in settings.with_alarm]
        advice = f"; --set alarm.{silent[0]}_floor=NUMBER gives it one" if settings.alarm.on else ""
        yield f"{without}{advice}"
    for name in settings.with_alarm:
        inherited = detector_named(name).alarm is Detector.alarm
        if inherited and not settings.alarm.rule_of(name).floor:
            yield (
                f"{name} has no floor: any response above 0 may cause an alarm; set its alarm in "
                f"its class, or --set alarm.{name}_floor=NUMBER"
            )
    # If the user has switched the compiled loops off, the detectors are slow on purpose.
    reason = None if loops.portable else loops.why_portable() or loops.why_not_wide()
    if reason:
        slow = "10 to 20 times as slow as" if loops.arithmetic() == "portable" else "slower than"
        yield f"{reason}. The alarms are the same, but the models are {slow} usual"


def _run_one(task: Task, options: RunOptions, opening: Opening | None) -> int:
    """Run one input with its progress; return the exit code."""
    progress = Progress(printable(task.name), options.verbosity, to_end=task.span.open_ended)
    try:
        if opening and task.settings.other_heights:  # it has begun at one height only
            opening.close()
            opening = None
        outcome = run_task(task, on_open=progress.opened, on_frame=progress.frame, opening=opening)
    except SourceError as error:
        raise SourceError(f"{error}{_stimulus_hint(task.name)}") from error
    except Interrupted as stop:
        if stop.outcome and options.verbosity >= 0:
            progress.close()
            for line in outcome_lines(task, stop.outcome):
                say(line)
        raise
    finally:
        progress.close()
    quiet = options.verbosity < 0
    for line in faults(task, outcome, quiet=True) if quiet else outcome_lines(task, outcome):
        say(line)
    alarms = options.output / "alarms.csv"
    written = True
    # Maybe an earlier batch has listed the alarms of this result.
    if task.outputs and outcome.verdicts and rows_of(alarms, ALARM_COLUMNS):
        verdicts, stems = {task.name: outcome.verdicts}, {task.name: task.stem}
        written = _try_to_write(partial(write_alarms, alarms, verdicts, stems))
    tally = Tally()
    tally.add(task.name, outcome)
    return _exit_code(tally, options, written=written)


def _try_to_write(write: Callable[[], None]) -> bool:
    """Write a list of alarms or failures; print the error and return False if that fails."""
    try:
        write()
    except OpploadError as error:
        say(f"oppload: {error}")
        return False
    return True


def _exit_code(tally: Tally, options: RunOptions, *, written: bool) -> int:
    """Return the exit code of all inputs, or INCOMPLETE if a list could not be written."""
    code = tally.exit_code(options.fail_on)
    return code or (ExitCode.DONE if written else ExitCode.INCOMPLETE)


def _stimulus_hint(name: str) -> str:
    """Return how to make the video of a stimulus, if the name of an input is a stimulus."""
    if name.endswith(GROUND_TRUTH):
        return "; this is the ground truth of a stimulus: give its video"
    if name.endswith(".toml") and is_file(Path(name)):
        words = command_line(["oppload", "stimuli", "generate", name])
        return f"; if this is a stimulus, '{words}' makes its video"
    from oppload_cli.stimulus.catalogue import meant_by

    meant = "" if os.path.lexists(name) else meant_by(name)
    return f"; 'oppload stimuli generate {meant}' makes the stimulus of this name" if meant else ""


def _existing_tables(tasks: Iterator[Task]) -> list[Path]:
    """Return the tables of the results that exist."""
    paths = [task.outputs.csv for task in tasks if task.outputs]
    return [path for path in paths if os.path.lexists(path)]


def _make_pages(tasks: Iterator[Task], options: RunOptions) -> int:
    """Write the pages of the results that exist; return the exit code."""
    tables = _existing_tables(tasks)
    if not tables:
        return ExitCode.DONE
    folder, quiet = options.output, options.quiet
    roots = [folder] * len(tables)
    try:
        page, code = write_pages(
            tables, folder, roots=roots, batches=[folder], jobs=options.jobs, quiet=quiet
        )
    except ResultError as error:  # none of the results has a page, but all have their files
        say(f"oppload: {error}")
        return ExitCode.INCOMPLETE
    if not quiet:
        say(f"page: {page}")
    return code


def _plan_of(inputs: tuple[str, ...], options: RunOptions) -> Plan:
    shard = parse_shard(options.shard) if options.shard else None
    listed = read_list(options.files_from, null=options.null) if options.files_from else []
    for name in () if options.quiet else inputs:
        for sentence in left_out(name, recursive=options.recursive):
            say(f"oppload: {sentence}")
    plan = planned([*inputs, *listed], recursive=options.recursive)
    return plan.shard(*shard) if shard else plan


def _tasks(plan: Plan, task: Task, options: RunOptions) -> Iterator[Task]:
    """Yield a task per input of the plan, with the settings of `task`."""
    models = task.settings.models
    for name, stem in plan.inputs:
        outputs = Outputs.of(options.output, stem, models, annotate=options.annotate)
        yield replace(task, name=name, stem=stem, outputs=outputs)


def _print_plan(tasks: Iterator[Task], plan: Plan) -> int:
    """Print for each input whether it would run; return the exit code."""
    counts = {"run": 0, "skip": 0, "refuse": 0}
    failures = list(plan.failures)
    for task in tasks:
        if is_missing(task.name):
            reason = "no such file; check the path"
            failures.append(Failure(task.name, "", ExitCode.NOTHING_READ, f"{task.name}: {reason}"))
            continue
        try:
            state = "run" if exists_already(task) is None else "skip"
        except OutputError:
            state = "refuse"
        counts[state] += 1
        table = task.outputs and task.outputs.csv
        click.echo(f"{state}\t{printable(task.name)}\t{printable(str(table))}")
    for failure in failures:
        say(f"oppload: {failure.message}")
    refused = ", which have results: see --if-exists" if counts["refuse"] else ""
    say(
        f"{counted(len(plan), 'input')}: {counts['run']} to run, {counts['skip']} to skip, "
        f"{len(failures)} not possible, {counts['refuse']} to refuse{refused}"
    )
    if failures and len(failures) == len(plan):
        return Tally(failures).exit_code()
    return ExitCode.INCOMPLETE if failures else ExitCode.DONE


def _streamed_input(inputs: tuple[str, ...], options: RunOptions) -> str:
    if options.annotate or options.report_pages:
        option = "--annotate" if options.annotate else "--report"
        raise ParameterError(f"{option} writes a file; give a folder with --output, not '-'")
    if len(inputs) != 1:
        raise ParameterError("'-o -' streams one input; give one, or a folder with --output")
    if options.for_many or options.dry_run:
        raise ParameterError(
            "'-o -' streams one input at once; leave out --recursive, --files-from, --shard, "
            "--scheduler and --dry-run, or give a folder with --output"
        )
    return inputs[0]


class _Batch:
    """Runs the inputs of a plan, and prints their outcomes; the observer of the tasks.

    `models` are the detectors whose alarms are printed: none if alarms are off.
    """

    def __init__(self, plan: Plan, models: Sequence[str], options: RunOptions) -> None:
        self._plan, self._options, self._verbosity = plan, options, options.verbosity
        # Shards run side by side, so each has lists of its own, such as failures-3-of-8.csv.
        part = f"-{options.shard.replace('/', '-of-')}" if options.shard else ""
        self._failures = options.output / f"failures{part}.csv"
        self._alarms = options.output / f"alarms{part}.csv"
        if options.if_exists != IfExists.OVERWRITE:
            refuse_another_table(self._failures, FAILURE_COLUMNS)
            refuse_another_table(self._alarms, ALARM_COLUMNS)
        self._rows = AlarmTable((stem for _, stem in plan.inputs), models)
        self._tally, self._alarms_on = Tally(plan.failures), bool(models)
        self._remarked = 0
        for failure in plan.failures:
            say(f"oppload: {failure.message}")
        count, at_once = len(plan.inputs), options.jobs
        live = any(is_real_time(name) for name, _ in plan.inputs)
        if live and at_once < count and not (options.scheduler or options.quiet):
            say(
                f"oppload: {at_once} of {count} inputs run at once, and a camera or a stream may "
                f"never end; give --jobs {count} to run all of them at once"
            )
        self._begun = time.monotonic()
        self._progress = BatchProgress(len(plan.inputs), self._verbosity)
        self.started = self._progress.started
        self.frames = self._progress.frames

    def ended(self, task: Task, result: Outcome | Failure) -> None:
        self._tally.add(task.name, result)
        self._progress.ended(task.name, self._lines(task, result))

    def run(self, tasks: Iterator[Task]) -> int:
        """Run the tasks of the plan's inputs; return the exit code.

        If an input fails, the others still run.
        """
        options, inputs = self._options, len(self._plan.inputs)
        try:
            run_tasks(tasks, self, inputs=inputs, jobs=options.jobs, scheduler=options.scheduler)
        except KeyboardInterrupt as error:
            self._finish()
            finished = self._tally.inputs.total()
            kept = f"{error}; " if str(error) else ""
            go_on = "; go on with --if-exists skip"
            if finished == len(self._plan):  # live inputs, which usually end so
                go_on = ""
            elif options.if_exists == "overwrite":
                go_on = "; the same command begins again; --if-exists skip keeps older results too"
            raise Interrupted(
                f"{kept}{finished} of {len(self._plan)} inputs are finished{go_on}"
            ) from error
        except OpploadError:
            self._progress.close()
            if self._tally.inputs.total():
                self._finish()
            raise
        return _exit_code(self._tally, options, written=self._finish())

    def _lines(self, task: Task, result: Outcome | Failure) -> Iterator[str]:
        if isinstance(result, Failure):
            yield f"oppload: {result.message}{_stimulus_hint(task.name)}"
            return
        if self._verbosity >= 0:
            yield from self._rows.lines(task.stem, result)
        yield from faults(task, result, quiet=self._verbosity < 0)
        if not result.remarks or self._verbosity < 0:
            return
        self._remarked += 1
        if self._remarked <= _MOST_LISTED or self._verbosity > 0:
            yield f"oppload: {task.name}: {'; '.join(result.remarks)}"

    def _finish(self) -> bool:
        """Write the lists of failures and alarms, and print the summary of the batch.

        Return whether both lists could be written.
        """
        self._progress.close()
        tally, stems = self._tally, dict(self._plan.inputs)
        lists: list[Callable[[], None]] = [partial(write_failures, self._failures, tally.failures)]
        if tally.verdicts:
            lists.append(partial(write_alarms, self._alarms, tally.verdicts, stems))
        written = [_try_to_write(write) for write in lists]
        if self._verbosity >= 0:
            wall_s = time.monotonic() - self._begun
            alarms = tally.alarms(_MOST_LISTED, self._alarms, stems) if self._alarms_on else ()
            for line in (*self._rows.legend(), *tally.table(wall_s), *alarms):
                say(line)
            more = self._remarked - _MOST_LISTED
            if more > 0 and not self._verbosity:
                inputs = "input has" if more == 1 else "inputs have"
                say(
                    f"oppload: {more} more {inputs} remarks such as those above; the sidecars hold "
                    f"all of them (remarks), and -v prints them"
                )
        if tally.failures and is_file(self._failures):
            say(f"oppload: the failed inputs are in {self._failures}")
        return all(written)
