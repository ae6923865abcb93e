"""Many inputs on the command line: the run and its report."""

from __future__ import annotations

import os
import shlex
import time
from typing import TYPE_CHECKING

import click
from click.core import ParameterSource

from oppload_cli.cli import say
from oppload_cli.errors import OpploadError

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from oppload_cli.batch.plan import Failure, Plan
    from oppload_cli.cli.selection import Selection
    from oppload_cli.task import Outcome, Task

NAMES_INPUTS = {"recursive", "files_from", "null", "shard", "dry_run", "if_exists"}


class Batch:
    """Runs a plan, and reports.

    Parameters
    ----------
    plan : Plan
        The plan.
    selection : Selection
        How it is run.
    folder : Path
        Of the results.
    verbosity : int
        -1 prints errors only, 0 what came of each input.
    fail_on : str or None
        The condition of ``--fail-on``.
    """

    def __init__(
        self,
        plan: Plan,
        selection: Selection,
        folder: Path,
        verbosity: int,
        fail_on: str | None = None,
    ) -> None:
        from oppload_cli.batch.report import Tally  # noqa: PLC0415 - keeps --help fast
        from oppload_cli.cli.progress import BatchProgress  # noqa: PLC0415

        self._plan, self._selection, self._verbosity = plan, selection, verbosity
        self._fail_on = fail_on
        part = f"-{selection.shard.replace('/', '-of-')}" if selection.shard else ""
        self._failures = folder / f"failures{part}.csv"
        self._tally = Tally(plan.failures)
        for failure in plan.failures:
            say(f"oppload: {failure.message}")
        self._begun = time.monotonic()
        self._progress = BatchProgress(len(plan.inputs), verbosity)
        self.started = self._progress.started
        self.frames = self._progress.frames

    def ended(self, task: Task, result: Outcome | Failure) -> None:
        """Count what came of a task, and say it.

        Parameters
        ----------
        task : Task
            The task.
        result : Outcome or Failure
            What came of it.
        """
        self._tally.add(result)
        self._progress.ended(task.name, self._lines(task, result))

    def run(self, tasks: Iterator[Task]) -> int:
        """Run the tasks; a bad input never stops the others.

        Parameters
        ----------
        tasks : iterator of Task
            Of the plan's inputs.

        Returns
        -------
        int
            The exit code.
        """
        from oppload_cli.task import Interrupted  # noqa: PLC0415 - keeps --help fast

        try:
            self._run(tasks)
        except KeyboardInterrupt as error:
            self._report()
            finished = self._tally.inputs.total()
            left = f"{error}; " if str(error) else ""
            raise Interrupted(
                f"{left}{finished} of {len(self._plan)} inputs are finished; "
                f"go on with --if-exists skip"
            ) from error
        except OpploadError:
            self._progress.close()
            if self._tally.inputs.total():
                self._report()
            raise
        self._report()
        return self._tally.exit_code_unless(self._fail_on)

    def _run(self, tasks: Iterator[Task]) -> None:
        from oppload_cli.batch import local  # noqa: PLC0415 - keeps --help fast

        jobs = local.jobs_for(self._selection.jobs, len(self._plan.inputs))
        if self._selection.scheduler:
            from oppload_cli.batch.cluster import run_on_cluster  # noqa: PLC0415

            run_on_cluster(tasks, self._selection.scheduler, self)
        elif jobs > 1:
            local.run_in_processes(tasks, jobs, self)
        else:
            local.run_here(tasks, self)

    def _lines(self, task: Task, result: Outcome | Failure) -> Iterator[str]:
        from oppload_cli.batch.plan import Failure  # noqa: PLC0415 - keeps --help fast

        if isinstance(result, Failure):
            yield f"oppload: {result.message}"
        elif self._verbosity >= 0 and not (self._progress.on_terminal and result.complete):
            yield from report(task, result)
        elif not result.complete:
            yield incomplete(task, result)

    def _report(self) -> None:
        from oppload_cli.batch.report import write_failures  # noqa: PLC0415 - keeps --help fast

        self._progress.close()
        try:
            write_failures(self._failures, self._tally.failures)
        except OpploadError as error:
            say(f"oppload: {error}")
        if self._verbosity >= 0:
            for line in self._tally.table(time.monotonic() - self._begun):
                say(line)
        if self._tally.failures and self._failures.exists():
            say(f"oppload: the failed ones are in {self._failures}; try them again with:")
            say(f"  {retry_command(click.get_current_context(), self._failures)}")


def retry_command(context: click.Context, failures: Path) -> str:
    """Return the command line that does just the failed inputs again.

    Parameters
    ----------
    context : click.Context
        Of the command that was run.
    failures : Path
        Its ``failures.csv``.

    Returns
    -------
    str
        For a shell; with every option that was given.
    """
    words = ["oppload", str(context.info_name), "--files-from", str(failures)]
    for option in context.command.params:
        name = option.name or ""
        given = context.get_parameter_source(name) is ParameterSource.COMMANDLINE
        if not given or name in NAMES_INPUTS or not isinstance(option, click.Option):
            continue
        value = context.params[name]
        flag = max(option.opts, key=len)
        values = value if option.multiple else [value]
        words += [flag] if option.is_flag else [w for v in values for w in (flag, str(v))]
    overwrite = context.params["if_exists"] == "overwrite"
    words += ["--if-exists", "overwrite" if overwrite else "skip"]
    return shlex.join(words)


def report(task: Task, outcome: Outcome) -> Iterator[str]:
    """Yield what to print of one input.

    Parameters
    ----------
    task : Task
        What was done.
    outcome : Outcome
        What came of it.

    Yields
    ------
    str
    """
    table = task.outputs and task.outputs.csv
    if outcome.skipped:
        there = table and os.path.lexists(table)
        reason = f"{table} exists" if there else "another run is writing it"
        yield f"{task.name}: skipped, {reason}"
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
    place = f" -> {table}" if table else ""
    yield f"{task.name}: {outcome.frames} frames, {speed}; {'; '.join(peaks)}{place}"
    if not outcome.complete:
        yield incomplete(task, outcome)
    elif outcome.notes:
        yield f"oppload: {task.name}: {'; '.join(outcome.notes)}"


def incomplete(task: Task, outcome: Outcome) -> str:
    """Return the sentence that says why a result is incomplete.

    Parameters
    ----------
    task : Task
        What was done.
    outcome : Outcome
        What came of it.

    Returns
    -------
    str
    """
    return (
        f"oppload: {task.name}: incomplete ({'; '.join(outcome.notes) or 'damaged frames'}); "
        f"the rows that are there hold"
    )
