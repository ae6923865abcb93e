"""The command line: each command has a module, which is loaded only when the command is called.

Only ``main`` turns errors into sentences and exit codes.
"""

from __future__ import annotations

import errno
import importlib
import os
import sys
import threading
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Never, NoReturn

import click
from click.shell_completion import CompletionItem

from oppload_cli.errors import (
    ExitCode,
    OpploadError,
    OutputError,
    ParameterError,
    ShortageError,
    printable,
    shortage,
    suggestion,
)
from oppload_cli.files.reading import is_file
from oppload_cli.models import LOAD
from oppload_cli.processes import signals
from oppload_cli.version import __version__

if TYPE_CHECKING:
    from collections.abc import Sequence

    from tqdm import tqdm


COMMANDS = {
    "run": "run looming detectors on videos",
    "collect": "join many results into one table",
    "plot": "plot results",
    "report": "make a page per result: video, curves and alarms in sync",
    "tune": "measure responses to a stimulus over directions, speeds, sizes",
    "evaluate": "measure detection, lead time and false alarms on labelled clips or stimuli",
    "reproduce": "reproduce the synthetic figures of the OppLoD paper",
    "demo": "show the detectors at work on a looming disk",
    "stimuli": "list, show and make looming stimuli",
    "models": "list the detectors and their parameters",
    "config": "print every setting of a run with its origin",
    "info": "print versions, for a bug report",
}

_GONE = {"benchmark": "; write 'oppload evaluate --battery'"}


class _ReaderGoneError(Exception):
    """The program that reads standard output has ended.

    A BrokenPipeError would not reach `main`: Click itself exits with code 1.
    """


class _LazyGroup(click.Group):
    """A group that imports a command's module when the command is called."""

    def invoke(self, ctx: click.Context) -> object:
        try:
            return super().invoke(ctx)
        except BrokenPipeError as error:
            raise _ReaderGoneError from error

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse the options before the command, where many write those of the command."""
        try:
            return super().parse_args(ctx, args)
        except click.NoSuchOption as error:
            name, others = error.option_name, error.possibilities
            message = (
                f"no option '{name}' before the command; "
                "write the options of a command after its name."
            )
            raise click.NoSuchOption(name, message, others, ctx) from error

    def list_commands(self, _ctx: click.Context) -> list[str]:
        """Return the names of all commands, for the page of the site that lists them."""
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in COMMANDS:
            return None
        module = importlib.import_module(f"oppload_cli.cli.{cmd_name}")
        _check_loaded(ctx.params.get("load") or ())
        command: click.Command = getattr(module, cmd_name)
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Find the command, suggesting the nearest one for a misspelt name."""
        if args and args[0] not in COMMANDS and not args[0].startswith("-"):
            hint = _GONE.get(args[0]) or suggestion(args[0], COMMANDS)
            if is_file(args[0]):
                hint = f"; did you mean 'oppload run {args[0]}'?"
            raise click.UsageError(f"no command '{args[0]}'{hint}", ctx)
        return super().resolve_command(ctx, args)

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        """Complete the name of a command without importing its module."""
        matching = [name for name in COMMANDS if name.startswith(incomplete)]
        if not matching:
            return click.Command.shell_complete(self, ctx, incomplete)
        return [CompletionItem(name, help=COMMANDS[name]) for name in matching]

    def format_commands(self, _ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the list of commands without importing their modules."""
        with formatter.section("Commands"):
            formatter.write_dl(list(COMMANDS.items()))


# \b keeps the lines of a paragraph as they are.
_HELP = """Run looming detectors on videos and cameras: OppLoD, D-LGMD and others.

\b
oppload demo                   see it work
oppload run video.mp4          says when an object looms; writes video.frames.csv
oppload plot video.frames.csv  writes video.frames.png
"""


def _load(_ctx: click.Context, _option: click.Parameter, names: tuple[str, ...]) -> tuple[str, ...]:
    """Put the names into the environment: the registry of each process loads the detectors."""
    absolute: list[str] = []
    for name in names:
        is_path = name.endswith(".py")
        if is_path and not is_file(name):
            raise ParameterError(f"--load {name}: no such file; check the name")
        absolute.append(str(Path(name).absolute()) if is_path else name)
        if os.pathsep in absolute[-1]:
            raise ParameterError(
                f"--load {name}: its path holds '{os.pathsep}', which separates the names in "
                f"{LOAD}; rename the file or its folder"
            )
    if names:
        os.environ[LOAD] = os.pathsep.join(absolute)
    return names


def _check_loaded(names: Sequence[str]) -> None:
    """Raise ParameterError if a file or a module of ``--load`` has registered no detector."""
    if not names:
        return
    from oppload_cli.models.registry import detectors, modules_of

    own = {detector.__module__ for detector in detectors().values()}
    own = {module for module in own if not module.startswith("oppload_cli.")}
    absolute = os.environ[LOAD].split(os.pathsep)  # by `_load`
    modules = modules_of(absolute)
    registering = {
        name: {
            module
            for module in own
            if module == modules[path] or module.startswith(f"{modules[path]}.")
        }
        for name, path in zip(names, absolute, strict=True)
    }
    if own.difference(*registering.values()):
        return  # one of the files imports the module that registers a detector
    for name, registered in registering.items():
        if not registered:
            raise ParameterError(
                f"--load {name}: registers no detector; write @oppload.register above its class"
            )


@click.group(cls=_LazyGroup, help=_HELP, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="oppload")
@click.option(
    "--load",
    multiple=True,
    metavar="FILE.py|MODULE",
    callback=_load,
    help=f"Load detectors of your own; {LOAD} in the environment does the same.",
)
def oppload(**_options: object) -> None:
    """Receive the options before the command; `_load` has handled them."""


def main(arguments: Sequence[str] | None = None) -> NoReturn:
    """Run a command line, by default that of the process, and exit."""
    signals.handle()
    try:
        if None in (sys.stdin, sys.stdout, sys.stderr):  # a file would get the number of the stream
            raise ParameterError("a standard stream is closed; open it, for example as /dev/null")
        code = oppload.main(arguments, prog_name="oppload", standalone_mode=False)
        signals.stop_if_asked()
    except BaseException as error:
        signals.ignore()  # a second Ctrl-C must not interrupt the printing of the error
        sys.exit(_failure(error))
    sys.exit(code or ExitCode.DONE)


def _failure(error: BaseException) -> int:
    """Print the error that ended a command as one sentence; return its exit code."""
    if isinstance(error, SystemExit):
        return error.code if isinstance(error.code, int) else ExitCode.BUG
    if os.environ.get("OPPLOAD_DEBUG"):
        sys.excepthook(type(error), error, error.__traceback__)
    error = _explained(error)
    if isinstance(error, _ReaderGoneError | OutputError):
        try:
            sys.stdout.flush()
        except OSError:  # Python would fail once more at exit, when it flushes the stream
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    if isinstance(error, _ReaderGoneError):
        return ExitCode.INTERRUPTED
    if signals.received() or isinstance(error, KeyboardInterrupt | click.Abort):
        kept = _interruption(error)
        say(f"oppload: interrupted{': ' if kept else ''}{kept}")
        return ExitCode.INTERRUPTED
    if isinstance(error, click.ClickException):
        _with_hint(error).show()
        return ExitCode.USAGE
    if isinstance(error, OpploadError):
        say(f"oppload: {error}")
        return error.exit_code
    say(
        f"oppload: this is a bug ({type(error).__name__}: {error}); please report it with the "
        f"output of OPPLOAD_DEBUG=1 and of 'oppload info'"
    )
    return ExitCode.BUG


def _with_hint(error: click.ClickException) -> click.ClickException:
    """Return an error that says what to do, in place of one of an unknown option."""
    if not isinstance(error, click.NoSuchOption):
        return error
    if error.option_name == "--load":
        hint = "--load stands before the command: oppload --load FILE.py run ..."
        return click.UsageError(hint, error.ctx)
    for word in sys.argv[1:]:
        if word.startswith("-") and os.path.lexists(word):
            name = printable(word)
            hint = f"'{name}' begins with a dash, like an option; write ./{name}"
            return click.UsageError(hint, error.ctx)
    return error


def _interruption(error: BaseException | None) -> str:
    """Return the text of the KeyboardInterrupt behind an error; Click turns it into an Abort."""
    while error and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__
    return str(error or "")


def _explained(error: BaseException) -> BaseException:
    """Return an OpploadError in place of an error of a disk, a folder or the memory."""
    if isinstance(error, OSError) and error.errno == errno.ENOSPC:
        return OutputError(
            "standard output or a file cannot be written (no space left on device); free some space"
        )
    if isinstance(error, OSError) and "MPLCONFIGDIR" in str(error):  # while matplotlib is loaded
        return OutputError(
            "matplotlib finds no folder that it can write for its cache; set the environment "
            "variable MPLCONFIGDIR to one"
        )
    if isinstance(error, Exception) and not isinstance(
        error, OpploadError | click.ClickException | click.Abort | _ReaderGoneError
    ):
        short = shortage(error)
        return ShortageError(short) if short else error
    return error


def say(line: str) -> None:
    """Print one line on standard error; control characters in it are escaped.

    If a signal has come and nobody reads standard error, the line is lost.
    """
    while sys.stderr is not None and not signals.takes_a_line(sys.stderr):
        if signals.received():
            return
    with suppress(OSError):  # the program that reads standard error may have ended
        click.echo(printable(line), err=True)


def on_terminal() -> bool:
    """Tell whether standard error is a terminal, which can show progress."""
    return sys.stderr.isatty()


def progress_bar(total: int | None, unit: str, *, quiet: bool, name: str = "") -> tqdm[Never]:
    """Return a progress bar on standard error, hidden if that is no terminal, or if `quiet`.

    The bar is full at `total`, which may be unknown. `unit` is the word for the things that it
    counts, and `name` a text before the bar.
    """
    from tqdm import tqdm  # not for help and completion

    # By default tqdm starts a thread that looks for bars without progress, and makes a lock that
    # several processes share. The bar needs neither, and the system may refuse both.
    tqdm.monitor_interval = 0
    tqdm.set_lock(threading.RLock())
    hidden = quiet or not on_terminal()
    return tqdm(
        total=total, unit=unit, desc=name or None, disable=hidden, leave=False, dynamic_ncols=True
    )


def check_display() -> None:
    """Raise ParameterError if this machine has no display for ``--show``."""
    if sys.platform.startswith("linux") and not any(
        os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY")
    ):
        raise ParameterError(
            "--show needs a display, and this machine has none; leave it out, and open the file "
            "elsewhere"
        )


def show_file(path: Path) -> None:
    """Open a file in the desktop's program for it; raise OutputError if there is none."""
    if click.launch(str(path)):
        raise OutputError(f"{path}: no program shows it; open it yourself, without --show")
