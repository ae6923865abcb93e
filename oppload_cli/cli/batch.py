"""Many inputs on the command line: running them, and the report."""

from __future__ import annotations

import shlex
import time
from typing import TYPE_CHECKING

import click
from click.core import ParameterSource

from oppload_cli.batch import local
from oppload_cli.batch.plan import Failure
from oppload_cli.batch.report import Tally, write_failures
from oppload_cli.cli import say
from oppload_cli.cli.progress import AlarmTable, BatchProgress, incomplete
from oppload_cli.errors import OpploadError
from oppload_cli.pipeline.task import Interrupted
from oppload_cli.results.alarms import write_alarms

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from oppload_cli.batch.plan import Plan
    from oppload_cli.pipeline.task import Outcome, Task


_LISTED = 10  # inputs with alarms that are printed
_NAMES_INPUTS = {"recursive", "files_from", "null", "shard", "dry_run", "if_exists"}


class Batch:
    """Runs a plan, and reports.

    Parameters
    ----------
    plan : Plan
        The inputs.
    folder : Path
        Of the results.
    models : sequence of str
        The detectors.
    verbosity : int
        -1 prints errors only, 0 the outcome of each input.
    fail_on : str or None
        The condition of ``--fail-on``.
    shard : str or None
        ``I/N`` if the plan is one of several parts.
    """

    def __init__(
        self,
        plan: Plan,
        folder: Path,
        models: Sequence[str],
        verbosity: int,
        fail_on: str | None,
        *,
        shard: str | None,
    ) -> None:
        self._plan, self._verbosity = plan, verbosity
        self._fail_on = fail_on
        part = f"-{shard.replace('/', '-of-')}" if shard else ""
        self._failures = folder / f"failures{part}.csv"
        self._alarms = folder / f"alarms{part}.csv"
        self._rows = AlarmTable((each.stem for each in plan.inputs), models)
        self._tally = Tally(plan.failures)
        for failure in plan.failures:
            say(f"oppload: {failure.message}")
        self._begun = time.monotonic()
        self._progress = BatchProgress(len(plan.inputs), verbosity)
        self.started = self._progress.started
        self.frames = self._progress.frames

    def ended(self, task: Task, result: Outcome | Failure) -> None:
        """Count the outcome of a task, and print it."""
        self._tally.add(task.name, result)
        self._progress.ended(task.name, self._lines(task, result))

    def run(self, tasks: Iterator[Task], jobs: int, scheduler: str | None) -> int:
        """Run the tasks of the plan's inputs; return the exit code.

        A bad input never stops the others.
        """
        try:
            self._run(tasks, local.jobs_for(jobs, len(self._plan.inputs)), scheduler)
        except KeyboardInterrupt as error:
            self._report()
            finished = self._tally.inputs.total()
            kept = f"{error}; " if str(error) else ""
            raise Interrupted(
                f"{kept}{finished} of {len(self._plan)} inputs are finished; "
                f"go on with --if-exists skip"
            ) from error
        except OpploadError:
            self._progress.close()
            if self._tally.inputs.total():
                self._report()
            raise
        self._report()
        return self._tally.exit_code_unless(self._fail_on)

    def _run(self, tasks: Iterator[Task], jobs: int, scheduler: str | None) -> None:
        if scheduler:
            from oppload_cli.batch.cluster import run_on_cluster

            run_on_cluster(tasks, scheduler, self)
        elif jobs > 1:
            local.run_in_processes(tasks, jobs, self)
        else:
            local.run_here(tasks, self)

    def _lines(self, task: Task, result: Outcome | Failure) -> Iterator[str]:
        if isinstance(result, Failure):
            yield f"oppload: {result.message}"
            return
        if self._verbosity >= 0:
            yield from self._rows.lines(task.stem, result)
        if not result.complete:
            yield incomplete(task, result)
        elif result.notes and self._verbosity >= 0:
            yield f"oppload: {task.name}: {'; '.join(result.notes)}"

    def _report(self) -> None:
        self._progress.close()
        try:
            write_failures(self._failures, self._tally.failures)
            if self._tally.verdicts:
                write_alarms(self._alarms, self._tally.verdicts)
        except OpploadError as error:
            say(f"oppload: {error}")
        if self._verbosity >= 0:
            wall_s = time.monotonic() - self._begun
            shown = {each.name: each.stem for each in self._plan.inputs}
            alarms = self._tally.alarms(_LISTED, self._alarms, shown)
            for line in (*self._tally.table(wall_s), *alarms):
                say(line)
        if self._tally.failures and self._failures.exists():
            say(f"oppload: the failed ones are in {self._failures}; try them again with:")
            say(f"  {_retry_command(click.get_current_context(), self._failures)}")


def _retry_command(context: click.Context, failures: Path) -> str:
    """Return the command line, with every option given, that does just the failed inputs again."""
    words = ["oppload", str(context.info_name), "--files-from", str(failures)]
    for option in context.command.params:
        name = option.name or ""
        given = context.get_parameter_source(name) is ParameterSource.COMMANDLINE
        if not given or name in _NAMES_INPUTS or not isinstance(option, click.Option):
            continue
        value = context.params[name]
        flag = max(option.opts, key=len)
        values = value if option.multiple else [value]
        words += [flag] if option.is_flag else [w for v in values for w in (flag, str(v))]
    overwrite = context.params["if_exists"] == "overwrite"
    words += ["--if-exists", "overwrite" if overwrite else "skip"]
    return shlex.join(words)
