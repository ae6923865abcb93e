"""The command line: each command has a module, loaded only when it is called.

``main`` is the one place that turns an error into a sentence and an exit code.
"""

from __future__ import annotations

import errno
import importlib
import mmap
import os
import sys
import threading
from contextlib import suppress
from importlib.util import find_spec
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
from oppload_cli.models import LOAD
from oppload_cli.processes import signals
from oppload_cli.version import __version__

if sys.platform != "win32":
    import resource

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from tqdm import tqdm


# Of address space; the commands take more than either of them in the end.
_LIBRARY_BYTES = 150 << 20
_ARROW_BYTES = 800 << 20  # of commands that read tables, where Arrow is installed
_READING_TABLES = {
    "collect",
    "plot",
    "report",
    "tune",
    "evaluate",
    "benchmark",
    "reproduce",
    "demo",
}
_WIDEST = 80  # characters of help
COMMANDS = {
    "run": "run looming detectors on videos",
    "collect": "join many results into one table",
    "plot": "plot results",
    "report": "make a page per result: video, curves and alarms in sync",
    "tune": "measure responses to a stimulus over directions, speeds, sizes",
    "evaluate": "measure detection, lead time and false alarms on labelled clips",
    "benchmark": "compare all detectors on one set of stimuli",
    "reproduce": "reproduce the synthetic figures of the OppLoD paper",
    "demo": "show the detectors at work on a looming disk",
    "stimuli": "list, show and make looming stimuli",
    "models": "list the models, their parameters and presets",
    "config": "print every setting of a run, and where it came from",
    "info": "print versions, for a bug report",
}


class _ReaderGoneError(Exception):
    """The reader of standard output has gone; for a BrokenPipeError, Click itself exits with 1."""


class _LazyGroup(click.Group):
    """A group that imports a command's module when the command is called."""

    def invoke(self, ctx: click.Context) -> object:
        """Call the command."""
        try:
            return super().invoke(ctx)
        except BrokenPipeError as error:
            raise _ReaderGoneError from error

    def list_commands(self, _ctx: click.Context) -> list[str]:
        """Return the commands' names, in the order of the help."""
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Return a command, or None if none has that name."""
        if cmd_name not in COMMANDS:
            return None
        _check_memory(cmd_name)
        module = importlib.import_module(f"oppload_cli.cli.{cmd_name}")
        _check_loaded(ctx.params.get("load") or ())
        command: click.Command = getattr(module, cmd_name)
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Find the command, suggesting the nearest one for a misspelt name."""
        if args and args[0] not in COMMANDS and not args[0].startswith("-"):
            raise click.UsageError(f"no command '{args[0]}'{suggestion(args[0], COMMANDS)}", ctx)
        return super().resolve_command(ctx, args)

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        """Complete the name of a command without importing any."""
        named = [
            CompletionItem(name, help=text)
            for name, text in COMMANDS.items()
            if name.startswith(incomplete)
        ]
        return named or click.Command.shell_complete(self, ctx, incomplete)

    def format_commands(self, _ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the commands without importing any."""
        with formatter.section("Commands"):
            formatter.write_dl(list(COMMANDS.items()))


# \b keeps the lines of a paragraph as they are.
_HELP = """Run insect-inspired looming detectors on video: OppLoD and D-LGMD.

\b
oppload demo                   see it work
oppload run video.mp4          says when an object looms; writes video.frames.csv
oppload plot video.frames.csv  writes video.frames.png
"""


def _load(_ctx: click.Context, _option: click.Parameter, names: tuple[str, ...]) -> tuple[str, ...]:
    """Have the registry load detectors, in this process and in others that it starts."""
    for name in names:
        if name.endswith(".py") and not Path(name).is_file():
            raise ParameterError(f"--load {name}: no such file; check the name")
    files = [str(Path(each).absolute()) if each.endswith(".py") else each for each in names]
    for name, file in zip(names, files, strict=True):
        if os.pathsep in file:
            raise ParameterError(
                f"--load {name}: its path holds '{os.pathsep}', which separates the names in "
                f"{LOAD}; rename the file or its folder"
            )
    if names:
        os.environ[LOAD] = os.pathsep.join(files)
    return names


def _check_loaded(names: Sequence[str]) -> None:
    """Raise ParameterError if a file or a module of ``--load`` has registered no detector."""
    if not names:
        return
    from oppload_cli.models.registry import detectors

    classes = (each.__module__ for each in detectors().values())
    modules = {module for module in classes if not module.startswith("oppload_cli.")}
    registering = {name: _part_of(name, modules) for name in names}
    if modules.difference(*registering.values()):
        return  # a module that one of the files imports
    for name, found in registering.items():
        if not found:
            raise ParameterError(
                f"--load {name}: registers no detector; write @oppload.register above its class"
            )


def _part_of(name: str, modules: set[str]) -> set[str]:
    """Return those of some modules that a file or a module of ``--load`` consists of."""
    title = f"loaded_{Path(name).stem}" if name.endswith(".py") else name
    return {module for module in modules if module == title or module.startswith(f"{title}.")}


@click.group(cls=_LazyGroup, help=_HELP, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="oppload")
@click.option(
    "--load",
    multiple=True,
    metavar="FILE.py|MODULE",
    callback=_load,  # the module of a command, which is loaded next, may load the registry
    help=f"Load detectors of your own; {LOAD} in the environment does the same.",
)
def oppload(**_options: object) -> None:
    """Take the options before the command."""


def main(arguments: Sequence[str] | None = None) -> NoReturn:
    """Run the command line, with other arguments than those of the process if given, and exit."""
    signals.answer()
    try:
        code = oppload.main(
            arguments, prog_name="oppload", standalone_mode=False, terminal_width=_help_width()
        )
        signals.stop_if_asked()
    except BaseException as error:  # the one place where all errors end
        signals.ignore()  # a second Ctrl-C must not garble the last lines
        sys.exit(_failure(error))
    sys.exit(code or ExitCode.DONE)


def _help_width() -> int:
    """Return the width of the help, 50 to 78 characters, without the imports that Click needs."""
    columns = 0
    with suppress(OSError, ValueError, AttributeError):  # no number, no terminal, no stream
        columns = int(os.environ.get("COLUMNS") or 0)
    with suppress(OSError, ValueError, AttributeError):
        columns = columns or os.get_terminal_size(sys.__stdout__.fileno()).columns  # type: ignore[union-attr]
    return max(min(columns or _WIDEST, _WIDEST) - 2, 50)


def _check_memory(command: str) -> None:
    """Raise OSError if a limit of memory leaves no room for the libraries of a command.

    OpenBLAS, which NumPy loads, and Arrow, which pandas loads, take memory as they are loaded,
    and end the process if they cannot: no error could be caught.
    """
    if sys.platform == "win32":  # it has no such limits
        return
    if resource.getrlimit(resource.RLIMIT_AS)[0] != resource.RLIM_INFINITY:
        with_arrow = command in _READING_TABLES and find_spec("pyarrow")
        mmap.mmap(-1, _ARROW_BYTES if with_arrow else _LIBRARY_BYTES).close()


def _failure(error: BaseException) -> int:
    """Print an error as one sentence and return the exit code for it.

    Parameters
    ----------
    error : BaseException
        The error that ended the command.

    Returns
    -------
    int
        As in ``docs/formats.md``.
    """
    if isinstance(error, SystemExit):
        return error.code if isinstance(error.code, int) else ExitCode.BUG
    if os.environ.get("OPPLOAD_DEBUG"):
        import traceback

        traceback.print_exception(error)
    error = _explained(error)
    if isinstance(error, _ReaderGoneError | OutputError) and sys.stdout is not None:
        try:
            sys.stdout.flush()
        except OSError:  # else Python would try once more at exit, and fail once more
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    if isinstance(error, _ReaderGoneError):
        return ExitCode.INTERRUPTED
    if signals.received() or isinstance(error, KeyboardInterrupt | click.Abort):
        # Click turns an interruption into an Abort.
        kept = next(
            (str(each) for each in _causes(error) if isinstance(each, KeyboardInterrupt)), ""
        )
        say(f"oppload: interrupted{': ' if kept else ''}{kept}")
        return ExitCode.INTERRUPTED
    if isinstance(error, click.ClickException):
        if isinstance(error, click.NoSuchOption) and error.option_name == "--load":
            place = "--load stands before the command: oppload --load FILE.py run ..."
            error = click.UsageError(place, error.ctx)
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


def _explained(error: BaseException) -> BaseException:
    """Return an error of this package for one by which the system refuses something."""
    if isinstance(error, OSError) and error.errno == errno.ENOSPC:
        return OutputError("the output cannot be written (no space left on device); free some")
    if isinstance(error, Exception) and not isinstance(
        error, OpploadError | click.ClickException | click.Abort | _ReaderGoneError
    ):
        short = shortage(error)
        return ShortageError(short) if short else error
    return error


def say(line: str) -> None:
    """Print one line on standard error; the names in it may hold any character."""
    with suppress(OSError):  # its reader may have gone
        click.echo(printable(line), err=True)


def on_terminal() -> bool:
    """Tell whether standard error is a terminal, which can show progress; False if closed."""
    return sys.stderr is not None and sys.stderr.isatty()


def progress_bar(total: int | None, unit: str, *, quiet: bool, name: str = "") -> tqdm[Never]:
    """Return a bar on standard error, which is shown on a terminal only.

    Parameters
    ----------
    total : int or None
        Count at which it is full; None if it is not known.
    unit : str
        The word for the things that are counted.
    quiet : bool
        Whether it is not shown on a terminal either.
    name : str
        Put before the bar.
    """
    from tqdm import tqdm  # not for help and completion

    # Neither its thread, which looks for bars that stand still, nor its lock for several
    # processes is needed, and the system may refuse both.
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
    """Open a file in the program of the desktop; raise OutputError if none shows it."""
    if click.launch(str(path)):
        raise OutputError(f"{path}: no program shows it; open it yourself, without --show")


def _causes(error: BaseException | None) -> Iterator[BaseException]:
    while error is not None:
        yield error
        error = error.__cause__
