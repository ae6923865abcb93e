"""Options that commands share, with their completion in the shell.

An option of this module has the same name, default and meaning in every command. `RunOptions`
holds those of ``oppload run``, whose work is in a module of its own.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import click
from click.shell_completion import CompletionItem

import oppload_cli as oppload
from oppload_cli.errors import ParameterError, suggestion
from oppload_cli.files.reading import is_folder
from oppload_cli.models.presets import DEFAULT_PRESET, EXAMPLE_SETTING, PRESETS, preset_in

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    Command = Callable[..., Any]


# The kinds of files that commands write or read: a new folder of such a name is a mistake.
_FILE_SUFFIXES = frozenset(
    (".avi", ".csv", ".html", ".json", ".jsonl", ".mkv", ".mp4", ".parquet", ".pdf", ".png", ".svg")
)


class _ResultsFolder(click.Path):
    """A folder of results, which need not exist yet; the name of a file is refused."""

    name = "directory"

    def __init__(self) -> None:
        super().__init__(path_type=Path, readable=False)  # the first file that is written fails

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the folder as a path."""
        folder = Path(str(super().convert(value, param, ctx)))
        if folder.suffix.lower() in _FILE_SUFFIXES and not is_folder(folder):
            self.fail(
                f"'{folder}' is the name of a file; give a folder: the files in it are named "
                f"after the input",
                param,
                ctx,
            )
        return folder


def output_option(
    default: str | None, text: str = "Folder of the results."
) -> Callable[[Command], Command]:
    """Return the option ``--output`` of a command that fills a folder.

    Parameters
    ----------
    default : str or None
        The folder.
    text : str
        The help, with the default in words where that is this folder or none.
    """
    return click.option(
        "-o",
        "--output",
        type=_ResultsFolder(),
        default=default,
        show_default=default not in {None, "."},
        metavar="DIR",
        help=text,
    )


def if_exists_option(thing: str, *, skip: bool = False) -> Callable[[Command], Command]:
    """Return the option ``--if-exists`` of a command that writes files.

    Parameters
    ----------
    thing : str
        The object that may exist, for the help, such as ``a result``.
    skip : bool
        Whether it may be left as it is.
    """
    return click.option(
        "--if-exists",
        type=click.Choice(["error", "skip", "overwrite"] if skip else ["error", "overwrite"]),
        default="error",
        show_default=True,
        help=f"What to do if {thing} exists already.",
    )


def jobs_option(things: str) -> Callable[[Command], Command]:
    """Return the option ``--jobs`` of a command that does several things at a time.

    Parameters
    ----------
    things : str
        Name of the things, for the help, such as ``Inputs``.
    """
    return click.option(
        "-j",
        "--jobs",
        type=click.IntRange(0, 1024),
        default=0,
        show_default=True,
        help=f"{things} that are done at a time, each in a process of its own; 0: one per core.",
    )


def _complete_presets(_: click.Context, __: click.Parameter, text: str) -> list[CompletionItem]:
    """Complete the name of a preset."""
    return [
        CompletionItem(name, help=each.meaning)
        for name, each in PRESETS.items()
        if name.startswith(text)
    ]


def complete_models(_: click.Context, __: click.Parameter, text: str) -> list[CompletionItem]:
    """Complete the last of some detectors, and its preset."""
    before, comma, last = text.rpartition(",")
    names = {name: each.meaning for name, each in oppload.detectors().items()}
    if ":" in last:
        model = last.partition(":")[0]
        names = {f"{model}:{name}": each.meaning for name, each in PRESETS.items()}
    return [
        CompletionItem(before + comma + name, help=meaning)
        for name, meaning in names.items()
        if name.startswith(last)
    ]


def _complete_settings(_: click.Context, __: click.Parameter, text: str) -> list[CompletionItem]:
    """Complete ``set.parameter=value``: the parameter set, then the parameter, then its value."""
    from oppload_cli.pipeline.settings import parameter_sets

    group, dot, rest = text.partition(".")
    sets = parameter_sets()
    if not dot or group not in sets:
        return _starting(text, (f"{name}." for name in sets))
    name, equals, _value = rest.partition("=")
    declared = {each.name: each for each in sets[group][1].declared()}
    if equals:
        choices = declared[name].choices if name in declared else ()
        return _starting(text, (f"{group}.{name}={choice}" for choice in choices))
    return [
        CompletionItem(f"{group}.{each.name}=", help=each.meaning)
        for each in declared.values()
        if each.name.startswith(rest)
    ]


def complete_stimuli(_: click.Context, __: click.Parameter, text: str) -> list[CompletionItem]:
    """Complete the name of a stimulus of the catalogue, by any part of it, or a .toml file."""
    from oppload_cli.stimulus.catalogue import catalogue_directory

    root = catalogue_directory()
    names = sorted(
        path.relative_to(root).with_suffix("").as_posix() for path in root.rglob("*.toml")
    )
    found = _starting(text, names) or [CompletionItem(name) for name in names if text in name]
    return found or [CompletionItem(text, type="file")]


def _starting(text: str, names: Iterable[str]) -> list[CompletionItem]:
    return [CompletionItem(name) for name in names if name.startswith(text)]


def names_in(texts: Iterable[str]) -> list[str]:
    """Return the names in the values of an option that takes ``A,B`` for several."""
    return [name.strip() for text in texts for name in text.split(",")]


def check_models(names: Sequence[str], command: str, preset: str | None = None) -> None:
    """Check that the detectors of ``--model`` are known; one of the user's own must be loaded.

    Parameters
    ----------
    names : iterable of str
        As given, ``NAME``, ``NAME:VARIANT`` or ``NAME:PRESET``, or several with commas between.
    command : str
        Name of the command, for the message.
    preset : str, optional
        That of ``--preset``.

    Raises
    ------
    ParameterError
        If one is not known, or asks for another preset.
    """
    from oppload_cli.models.registry import ALL, known_names

    known = known_names()
    for each in names_in(names):
        name = each.partition(":")[0]
        if name != ALL and name not in known:
            raise ParameterError(
                f"no model '{name}'{suggestion(name, known)} (one of your own is loaded, as "
                f"in 'oppload --load FILE.py {command} ...')"
            )
    beside = preset_in(names) if preset else ""
    if beside and beside != preset:
        raise ParameterError(
            f"--model asks for preset '{beside}' and --preset for '{preset}'; leave one out"
        )


def check_assignments(assignments: Iterable[str], models: Sequence[str]) -> None:
    """Refuse a parameter of a detector that does not run.

    Parameters
    ----------
    assignments : iterable of str
        The values of ``--set``.
    models : sequence of str
        The detectors that run.

    Raises
    ------
    ParameterError
        If one has no effect.
    """
    from oppload_cli.models.registry import known_names

    idle = set(known_names()) - set(models)
    for text in assignments:
        name = text.partition(".")[0].strip()
        if name in idle:
            raise ParameterError(
                f"--set {text} has no effect, as '{name}' does not run; give --model {name} too, "
                "or leave it out"
            )


class RunOptions(NamedTuple):
    """The options of ``oppload run`` beside the part of the input and the settings.

    Attributes
    ----------
    output : Path
        Folder of the results, or ``-``.
    annotate, report_pages : bool
        Whether annotated videos and pages are written too.
    boxes : str
        Objects with a box in an annotated video.
    if_exists : str
        What to do where a result exists.
    fail_on : str or None
        ``alarm`` or ``no-alarm``: the condition of exit code 5.
    quiet, verbose : bool
        Whether less or more than the outcome is printed.
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

    output: Path
    annotate: bool
    report_pages: bool
    boxes: str
    if_exists: str
    fail_on: str | None
    quiet: bool
    verbose: bool
    recursive: bool
    files_from: str | None
    null: bool
    shard: str | None
    jobs: int
    scheduler: str | None
    dry_run: bool

    @property
    def for_many(self) -> bool:
        """Whether a batch is meant, however many inputs it has."""
        return bool(self.recursive or self.files_from or self.shard or self.scheduler)

    @property
    def verbosity(self) -> int:
        """-1 prints errors only, 0 the outcome of each input, 1 the sizes of frames too."""
        return -1 if self.quiet else int(self.verbose)


quiet_option = click.option("-q", "--quiet", is_flag=True, help="No progress bar.")

models_option = click.option(
    "--model",
    "models",
    multiple=True,
    metavar="NAME[:VARIANT|PRESET]",
    shell_complete=complete_models,
    help="A model to run, by its name in 'oppload models', NAME:VARIANT, A,B for several, or all; "
    "may be given again. NAME:PRESET also chooses the preset.  [default: the paper's two]",
)

repeats_option = click.option(
    "--repeats",
    type=click.Choice(["near", "exact", "keep"]),
    help="Repeats of a picture that are left out: exact and re-encoded ones (near), exact "
    "ones only, or none (keep).  [default: near]",
)

change_option = click.option(
    "--change",
    "changes",
    multiple=True,
    metavar="KEY=VALUE",
    help="Change a value of the stimulus, e.g. display.frame_rate=60 or bar.axis_deg=45.",
)


def settings_options(
    *, preset: str = DEFAULT_PRESET, table: bool = True
) -> Callable[[Command], Command]:
    """Return a decorator that adds the options of a run's settings.

    The options have the names that :func:`oppload_cli.pipeline.settings.resolve` takes.

    Parameters
    ----------
    preset : str
        The preset of the command where none is chosen.
    table : bool
        Whether the command makes a table of frames, which has columns to choose.
    """
    options = [
        models_option,
        click.option(
            "--preset",
            metavar="NAME",
            shell_complete=_complete_presets,
            help=f"A named parameter set: {', '.join(PRESETS)}; see 'oppload models'.  "
            f"[default: {preset}]",
        ),
        click.option(
            "--set",
            "assignments",
            multiple=True,
            metavar="SET.PARAMETER=VALUE",
            shell_complete=_complete_settings,
            help=f"One parameter, e.g. {EXAMPLE_SETTING}; 'oppload models NAME' lists them.",
        ),
        click.option(
            "--config",
            type=click.Path(path_type=Path),
            metavar="FILE.toml",
            help="Settings from a file; see 'oppload config'.",
        ),
        click.option(
            "--height",
            metavar="PX|native",
            help="Working height (of upright pictures: width); the other side follows.  "
            "[default: 240, preset paper 600]",
        ),
        repeats_option,
    ]
    if table:
        options += [
            click.option(
                "--fov",
                metavar="DEGREES",
                help="Horizontal field of view of the camera, across the frame: adds results in "
                "degrees, and sizes may be given as 60deg.",
            ),
            click.option(
                "--no-rmo",
                "measure_rmo",
                flag_value=False,
                default=None,
                type=bool,
                help="Do not measure radial motion opponency (RMO).",
            ),
            click.option(
                "--columns",
                metavar="usual|all",
                help="Columns of the table; all: also inner values, and details of the alarm.",
            ),
        ]

    def added(command: Command) -> Command:
        for option in reversed(options):
            command = option(command)
        return command

    return added
