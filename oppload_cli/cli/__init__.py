"""The command line: each command has a module, loaded only when it is called.

``main`` is the one place that turns an error into a sentence and an exit code.
"""

from __future__ import annotations

import errno
import importlib
import os
import sys
from contextlib import suppress
from typing import TYPE_CHECKING, NoReturn

import click

from oppload_cli import interruption
from oppload_cli.errors import ExitCode, OpploadError, OutputError, printable, suggestion
from oppload_cli.version import __version__

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from oppload_cli.video.apart import DecodingProcess

WIDEST = 80  # help, in characters
COMMANDS = {
    "run": "run both looming detectors on videos",
    "collect": "many results into one table",
    "plot": "plot results",
    "tune": "a stimulus over directions, speeds, sizes or places",
    "evaluate": "labelled clips: detection, lead time, false alarms",
    "reproduce": "every synthetic figure of the OppLoD paper, with verdicts",
    "demo": "show it at work on a looming disk",
    "stimuli": "the catalogue of looming stimuli",
    "models": "the models, their parameters and presets",
    "config": "every setting of a run, and where it came from",
    "info": "versions, for a bug report",
}


class LazyGroup(click.Group):
    """A group that imports a command's module when the command is called."""

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002
        """Return the commands' names, in the order of the help."""
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:  # noqa: ARG002
        """Return a command, or None if there is none of that name."""
        if cmd_name not in COMMANDS:
            return None
        module = importlib.import_module(f"oppload_cli.cli.{cmd_name}")
        command: click.Command = getattr(module, cmd_name)
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Find the command, suggesting the nearest one for a misspelt name."""
        if args and args[0] not in COMMANDS and not args[0].startswith("-"):
            raise click.UsageError(f"no command '{args[0]}'{suggestion(args[0], COMMANDS)}", ctx)
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:  # noqa: ARG002
        """Write the commands without importing any."""
        with formatter.section("Commands"):
            formatter.write_dl(list(COMMANDS.items()))


@click.group(cls=LazyGroup, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="oppload")
def oppload() -> None:
    r"""Run insect-inspired looming detectors on video: OppLoD and D-LGMD.

    \b
    oppload demo                   see it work
    oppload run video.mp4          writes video.frames.csv and video.oppload.json
    oppload plot video.frames.csv  writes video.frames.png
    """


def main(arguments: Sequence[str] | None = None, apart: DecodingProcess | None = None) -> NoReturn:
    """Run the command line and exit.

    Parameters
    ----------
    arguments : sequence of str, optional
        Instead of those of the process.
    apart : DecodingProcess, optional
        Stands by for ``oppload run``.
    """
    interruption.answer()
    try:
        code = oppload.main(
            arguments,
            prog_name="oppload",
            standalone_mode=False,
            terminal_width=help_width(),
            obj=apart,
        )
    except BaseException as error:  # the one place where all errors end
        interruption.ignore()  # what is left takes no time; a second Ctrl-C shall not garble it
        sys.exit(failure(error))
    sys.exit(code or ExitCode.DONE)


def help_width() -> int:
    """Return how wide the help is, as Click has it but without what Click loads to know.

    Returns
    -------
    int
        Characters, 50 to 78.
    """
    columns = 0
    with suppress(OSError, ValueError, AttributeError):  # no number, no terminal, no stream
        columns = int(os.environ.get("COLUMNS") or 0)
    with suppress(OSError, ValueError, AttributeError):
        columns = columns or os.get_terminal_size(sys.__stdout__.fileno()).columns  # type: ignore[union-attr]
    return max(min(columns or WIDEST, WIDEST) - 2, 50)


def failure(error: BaseException) -> int:
    """Print an error as one sentence and return the exit code for it.

    Parameters
    ----------
    error : BaseException
        Whatever ended the command.

    Returns
    -------
    int
        The exit code of ``docs/formats.md``.
    """
    if isinstance(error, SystemExit):
        return error.code if isinstance(error.code, int) else ExitCode.BUG
    if os.environ.get("OPPLOAD_DEBUG"):
        import traceback  # noqa: PLC0415 - seldom needed

        traceback.print_exception(error)
    if isinstance(error, OSError) and error.errno == errno.ENOSPC:
        error = OutputError("the output cannot be written (no space left on device); free some")
    if isinstance(error, BrokenPipeError | OutputError) and sys.stdout is not None:
        # What could not be written shall not be tried again, and fail again, at exit.
        with suppress(OSError):
            sys.stdout.flush()
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    if isinstance(error, BrokenPipeError):
        return ExitCode.INTERRUPTED
    if interruption.received() or isinstance(error, KeyboardInterrupt | click.Abort):
        # Click turns an interruption into an Abort, and an import into any other error.
        left = next(
            (str(each) for each in _causes(error) if isinstance(each, KeyboardInterrupt)), ""
        )
        say(f"oppload: interrupted{': ' if left else ''}{left}")
        return ExitCode.INTERRUPTED
    if isinstance(error, click.ClickException):
        error.show()
        return ExitCode.USAGE
    if isinstance(error, OpploadError):
        say(f"oppload: {error}")
        return error.exit_code
    say(
        f"oppload: this is a bug ({type(error).__name__}: {error}); please report it with the "
        f"output of OPPLOAD_DEBUG=1 and of 'oppload info'"
    )
    return ExitCode.BUG


def say(line: str) -> None:
    """Print one line on standard error, whatever the names in it hold.

    Parameters
    ----------
    line : str
        What to say.
    """
    with suppress(OSError):  # there may be nobody to read it
        click.echo(printable(line), err=True)


def on_terminal() -> bool:
    """Tell whether standard error is a terminal, which can show progress.

    Returns
    -------
    bool
        False also where it is closed.
    """
    return sys.stderr is not None and sys.stderr.isatty()


def _causes(error: BaseException | None) -> Iterator[BaseException]:
    while error is not None:
        yield error
        error = error.__cause__
