"""Many inputs on the command line: the options that name them, and the plan in print."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import click

from oppload_cli.cli import say
from oppload_cli.errors import ExitCode, OutputError, printable

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from oppload_cli.batch.plan import Plan
    from oppload_cli.task import Task

    Command = Callable[..., Any]


class Selection(NamedTuple):
    """What the user names, and how it is done.

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


OPTIONS = (
    click.option("-r", "--recursive", is_flag=True, help="Search folders to any depth."),
    click.option(
        "--files-from",
        metavar="LIST|-",
        help="Read inputs from a list, a name per line, or from a failures.csv.",
    ),
    click.option("-0", "--null", is_flag=True, help="The names of the list end in NUL."),
    click.option(
        "-j",
        "--jobs",
        type=click.IntRange(0, 1024),
        default=1,
        show_default=True,
        help="Inputs at a time, a process each; 0: as many as there are cores.",
    ),
    click.option("--shard", metavar="I/N", help="Do only the I-th of N parts, for job arrays."),
    click.option(
        "--scheduler",
        metavar="ADDRESS|FILE",
        help="Run on this dask cluster: tcp://host:port or a scheduler file.",
    ),
    click.option("--dry-run", is_flag=True, help="Print the plan, and do nothing."),
)


def several_options(command: Command) -> Command:
    """Add the options for many inputs, given to the command as one `selection`.

    Parameters
    ----------
    command : callable
        Takes `inputs` and `selection`.

    Returns
    -------
    callable
    """

    def gathered(**values: Any) -> Any:
        chosen = {name: values.pop(name) for name in Selection._fields}
        if not values["inputs"] and not chosen["files_from"]:
            raise click.UsageError("Missing argument 'INPUT...'; or give --files-from LIST")
        return command(selection=Selection(**chosen), **values)

    gathered.__doc__ = command.__doc__
    gathered.__click_params__ = getattr(command, "__click_params__", [])  # type: ignore[attr-defined]
    result: Command = gathered
    for option in reversed(OPTIONS):
        result = option(result)
    return result


def plan_of(inputs: tuple[str, ...], selection: Selection) -> Plan:
    """Return the plan of a command line.

    Parameters
    ----------
    inputs : tuple of str
        What is named.
    selection : Selection
        How.

    Returns
    -------
    Plan

    Raises
    ------
    ParameterError
        If the list cannot be read, or the shard is none.
    """
    from oppload_cli.batch.lists import read_list  # noqa: PLC0415 - keeps --help fast
    from oppload_cli.batch.plan import parse_shard, planned  # noqa: PLC0415

    shard = parse_shard(selection.shard) if selection.shard else None
    listed = read_list(selection.files_from, null=selection.null) if selection.files_from else []
    plan = planned([*inputs, *listed], recursive=selection.recursive)
    return plan.shard(*shard) if shard else plan


def print_plan(tasks: Iterator[Task], plan: Plan) -> int:
    """Print what would be done, a line per input.

    Parameters
    ----------
    tasks : iterator of Task
        Of the plan's inputs.
    plan : Plan
        The plan.

    Returns
    -------
    int
        The exit code.
    """
    from oppload_cli.batch.report import Tally  # noqa: PLC0415 - keeps --help fast
    from oppload_cli.task import exists_already  # noqa: PLC0415

    failures = list(plan.failures)
    counts = {"run": 0, "skip": 0, "refuse": 0}
    for task in tasks:
        try:
            state = "skip" if exists_already(task) else "run"
        except OutputError:
            state = "refuse"
        counts[state] += 1
        table = task.outputs and task.outputs.csv
        click.echo(f"{state}\t{printable(task.name)}\t{printable(str(table))}")
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
