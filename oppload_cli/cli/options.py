"""Options, and an argument, that several commands share, with their completion and their checks.

An option of this module has the same name, default and meaning in every command.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import click
from click.shell_completion import CompletionItem

import oppload_cli as oppload
from oppload_cli.errors import ParameterError, suggestion
from oppload_cli.files.reading import is_folder
from oppload_cli.models import EXAMPLE_SETTING
from oppload_cli.processes import cores

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    Command = Callable[..., Any]


USUAL_MODELS = "opplod, and its baseline dlgmd"
# Suffixes of files that commands write or read: a name with such a suffix is meant as a file.
_FILE_SUFFIXES = frozenset(
    (".avi", ".csv", ".html", ".json", ".jsonl", ".mkv", ".mp4", ".parquet", ".pdf", ".png", ".svg")
)


class _ResultsFolder(click.Path):
    """A folder of results, which need not exist yet. It refuses the name of a file.

    It also refuses ``-``, unless the command can write its table to standard output (`streams`).
    """

    name = "directory"

    def __init__(self, *, streams: bool) -> None:
        super().__init__(path_type=Path, readable=False)
        self._streams = streams

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        folder = Path(str(super().convert(value, param, ctx)))
        if value == "-" and not self._streams:
            self.fail(
                "'-' is standard output, which cannot hold the files of this command; give a "
                "folder",
                param,
                ctx,
            )
        if folder.suffix.lower() in _FILE_SUFFIXES and not is_folder(folder):
            self.fail(
                f"'{folder}' is the name of a file; give a folder, in which the command names the "
                f"files",
                param,
                ctx,
            )
        return folder


def output(
    default: str | None, text: str = "Folder of the results.", *, streams: bool = False
) -> Callable[[Command], Command]:
    """Return the option ``--output`` of a command that fills a folder.

    If the default is ``.`` or None, the text must explain it. `streams` says whether the command
    takes ``-`` for standard output.
    """
    return click.option(
        "-o",
        "--output",
        type=_ResultsFolder(streams=streams),
        default=default,
        show_default=default not in {None, "."},
        metavar="DIR",
        help=text,
    )


def if_exists(thing: str, *, skip: bool = False) -> Callable[[Command], Command]:
    """Return the option ``--if-exists`` of a command that writes a thing such as ``a result``.

    With `skip`, the option may also leave an existing thing as it is.
    """
    return click.option(
        "--if-exists",
        type=click.Choice(["error", "skip", "overwrite"] if skip else ["error", "overwrite"]),
        default="error",
        show_default=True,
        help=f"What to do if {thing} exists already.",
    )


def jobs(things: str) -> Callable[[Command], Command]:
    """Return the option ``--jobs`` of a command that does several things, such as ``inputs``."""
    return click.option(
        "-j",
        "--jobs",
        type=click.IntRange(0, 1024),
        default=0,
        show_default=True,
        callback=lambda _context, _option, jobs: jobs or cores(),
        help=f"Number of {things} done at the same time, each in its own process; 0: one per core.",
    )


def completions(text: str, meanings: Mapping[str, str]) -> list[CompletionItem]:
    """Return the names that begin with a text, with their meanings, for the shell."""
    return [
        CompletionItem(name, help=meaning)
        for name, meaning in meanings.items()
        if name.startswith(text)
    ]


def _complete_models(_: click.Context, __: click.Parameter, text: str) -> list[CompletionItem]:
    """Complete the last name in a list of detectors such as ``opplod,dlgmd``."""
    before, comma, _last = text.rpartition(",")
    names = {name: detector.meaning for name, detector in oppload.detectors().items()}
    return completions(text, {before + comma + name: names[name] for name in names})


def _complete_settings(_: click.Context, __: click.Parameter, text: str) -> list[CompletionItem]:
    """Complete ``set.parameter=value``: the parameter set, then the parameter, then its value."""
    from oppload_cli.pipeline.settings import parameter_sets

    group, dot, rest = text.partition(".")
    sets = parameter_sets()
    if not dot or group not in sets:
        return completions(text, dict.fromkeys((f"{name}." for name in sets), ""))
    name, equals, _value = rest.partition("=")
    declared = {parameter.name: parameter for parameter in sets[group][1].declared()}
    if equals:
        choices = declared[name].choices if name in declared else ()
        return completions(text, {f"{group}.{name}={choice}": "" for choice in choices})
    meanings = {f"{group}.{name}=": parameter.meaning for name, parameter in declared.items()}
    return completions(text, meanings)


def complete_stimuli(_: click.Context, __: click.Parameter, text: str) -> list[CompletionItem]:
    """Complete the name of a stimulus of the catalogue, by any part of it, or a .toml file."""
    from oppload_cli.stimulus.catalogue import catalogue_directory

    root = catalogue_directory()
    names = sorted(
        path.relative_to(root).with_suffix("").as_posix() for path in root.rglob("*.toml")
    )
    matching = [name for name in names if name.startswith(text)]
    matching = matching or [name for name in names if text in name]
    return [CompletionItem(name) for name in matching] or [CompletionItem(text, type="file")]


def listed_names(texts: Iterable[str]) -> list[str]:
    """Return the names in the values of an option, each of which may be a list ``A,B``."""
    return [name.strip() for text in texts for name in text.split(",")]


def check_models(names: Iterable[str], command: str) -> None:
    """Raise ParameterError if a detector of ``--model`` is not known.

    The message says how `command` loads the user's own detectors.
    """
    from oppload_cli.models.registry import ALL, known_names, names_of

    known = known_names()
    for name in listed_names(names):
        if ":" in name:
            names_of(name)  # raises the error, which names the detector to choose
        if name != ALL and name not in known:
            raise ParameterError(
                f"no model '{name}'{suggestion(name, known)} (load a detector of your own with "
                f"'oppload --load FILE.py {command} ...')"
            )


class RunOptions(NamedTuple):
    """The options of ``oppload run``, without its settings and the options of `Span`."""

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
        """Whether the run is a batch even if it has only one input."""
        return bool(self.recursive or self.files_from or self.shard or self.scheduler)

    @property
    def verbosity(self) -> int:
        """-1 prints errors only, 0 the outcome of each input, 1 the sizes of frames too."""
        return -1 if self.quiet else int(self.verbose)


results = click.argument(
    "results", nargs=-1, required=True, metavar="RESULT...", type=click.Path(path_type=Path)
)

quiet = click.option("-q", "--quiet", is_flag=True, help="No progress bar.")


def _assigned(_: click.Context, __: click.Parameter, texts: tuple[str, ...]) -> dict[str, str]:
    """Return the values of parameters by ``set.parameter``."""
    values = {}
    for text in texts:
        target, equals, value = text.partition("=")
        if not equals or "." not in target:
            raise ParameterError(
                f"'{text}' is no setting; write set.parameter=value, e.g. {EXAMPLE_SETTING}"
            )
        values[target.strip()] = value.strip()
    return values


# Each command says in its own words which detectors and settings it takes.
models = partial(click.option, "--model", "models", multiple=True, shell_complete=_complete_models)
assignments = partial(
    click.option,
    "--set",
    "assignments",
    multiple=True,
    callback=_assigned,
    metavar="SET.PARAMETER=VALUE",
    shell_complete=_complete_settings,
)
config = partial(click.option, "--config", type=click.Path(path_type=Path), metavar="FILE")

repeats = click.option(
    "--repeats",
    type=click.Choice(["near", "exact", "keep"]),
    help="Repeats of a picture that are left out: exact and re-encoded repeats (near), only "
    "exact repeats (exact), or none (keep).  [default: near]",
)

change = click.option(
    "--change",
    "changes",
    multiple=True,
    metavar="KEY=VALUE",
    help="Change a value of the stimulus, e.g. display.frame_rate=60 or bar.axis_deg=45.",
)


def _preset_is_gone(_: click.Context, __: click.Parameter, value: str | None) -> None:
    if value is not None:
        from oppload_cli.models.registry import preset_is_gone

        raise preset_is_gone(value)


def settings(
    *, models_by_default: str = USUAL_MODELS, table: bool = True
) -> Callable[[Command], Command]:
    """Return a decorator that adds the options of a run's settings.

    Their names are the parameters of :func:`oppload_cli.pipeline.settings.resolve`.
    `models_by_default` says in words which detectors run by default. With `table`, the command
    writes a table of frames, and also gets the options for its columns.
    """
    options = [
        models(
            metavar="NAME",
            help="Detectors to run, as A,B or given again; all runs all. 'oppload models' lists "
            f"the names.  [default: {models_by_default}]",
        ),
        click.option("--preset", hidden=True, expose_value=False, callback=_preset_is_gone),
        assignments(
            help=f"Set one parameter, e.g. {EXAMPLE_SETTING}; 'oppload models NAME' lists them.",
        ),
        config(
            help="Settings from a .toml file (see 'oppload config'), or those of a result from "
            "its sidecar."
        ),
        click.option(
            "--height",
            metavar="PX|native|auto",
            help="Height to which frames are resized before the detectors see them (of portrait "
            "videos: width); the other side follows. Another height gives other results.  "
            "[default: the height of each detector, 240 of all but opplod_paper, 600]",
        ),
        repeats,
    ]
    if table:
        options += [
            click.option(
                "--fov",
                metavar="DEGREES",
                help="Horizontal field of view of the camera, across the frame: adds results in "
                "degrees, and lets --set take sizes such as 60deg.",
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
                help="Columns of the table; all adds inner values and details of the alarm.",
            ),
        ]

    def added(command: Command) -> Command:
        for option in reversed(options):
            command = option(command)
        return command

    return added
