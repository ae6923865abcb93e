"""``oppload stimuli``: the catalogue, one protocol, and files made of them."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from oppload_cli.cli import on_terminal
from oppload_cli.errors import ExitCode, OpploadError, OutputError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from oppload_cli.stimulus.catalogue import Entry
    from oppload_cli.stimulus.files import Written
    from oppload_cli.stimulus.protocol import Protocol

# as in oppload_cli.video.writer, whose import would cost what --help must not
FORMATS = ("ffv1", "mkv", "mp4", "png", "npz", "gif")


@click.group(name="stimuli")
def stimuli() -> None:
    """Looming stimuli with ground truth: list, look at and generate them."""


@stimuli.command(name="list")
@click.argument("patterns", nargs=-1, metavar="[NAME|GLOB]...")
@click.option("--json", "as_json", is_flag=True, help="A JSON list instead of a table.")
def list_stimuli(patterns: tuple[str, ...], as_json: bool) -> None:
    """List the catalogue."""
    from oppload_cli.stimulus.catalogue import entries, find  # noqa: PLC0415

    listed = [entry for wanted in patterns for entry in find(wanted)] or list(entries())
    if as_json:
        rows = [
            {
                "name": entry.name,
                "description": entry.description,
                "source": entry.source,
                "tags": entry.tags,
                "members": list(entry.values()),
            }
            for entry in listed
        ]
        click.echo(json.dumps(rows, indent=2, ensure_ascii=False))
        return
    click.echo(_table(listed))


@stimuli.command()
@click.argument("name", metavar="NAME|FILE")
@click.option("--json", "as_json", is_flag=True, help="The resolved protocols as a JSON list.")
@click.option("--set", "settings", multiple=True, metavar="KEY=VALUE", help="Change a value.")
def show(name: str, as_json: bool, settings: tuple[str, ...]) -> None:
    """Show one protocol: what it is, its stimuli, and its file."""
    from oppload_cli.stimulus.catalogue import find  # noqa: PLC0415

    found = [entry.with_settings(_settings(settings)) for entry in find(name)]
    protocols = [protocol for entry in found for protocol in entry.protocols()]
    if as_json:
        tables = [protocol.as_table() for protocol in protocols]
        click.echo(json.dumps(tables, indent=2, ensure_ascii=False))
        return
    for entry in found:
        click.echo(_shown(entry, entry.protocols()))


@stimuli.command()
@click.argument("names", nargs=-1, required=True, metavar="NAME|FILE|GLOB...")
@click.option(
    "-o",
    "--output",
    "directory",
    type=click.Path(path_type=Path),
    default=Path(),
    help="Folder for the files; default: the current one.",
)
@click.option(
    "--format",
    "form",
    type=click.Choice(FORMATS),
    default="ffv1",
    show_default=True,
    help="ffv1 (.avi), mkv (FFV1), png (folder), npz and gif are lossless; mp4 (H.264) is lossy.",
)
@click.option(
    "--set",
    "settings",
    multiple=True,
    metavar="KEY=VALUE",
    help="Change a value, e.g. display.frame_rate=60 or bar.axis_deg=45.",
)
@click.option("--preview", is_flag=True, help="Also write a contact sheet NAME.preview.png.")
@click.option("--jobs", type=click.IntRange(1, 64), help="Stimuli at a time; default: the cores.")
@click.option(
    "--if-exists",
    type=click.Choice(("error", "skip", "overwrite")),
    default="error",
    show_default=True,
    help="What to do where a file is there already.",
)
@click.option("-q", "--quiet", is_flag=True, help="No progress bar.")
@click.pass_context
def generate(  # noqa: PLR0917 - one argument per option
    context: click.Context,
    names: tuple[str, ...],
    directory: Path,
    form: str,
    settings: tuple[str, ...],
    preview: bool,
    jobs: int | None,
    if_exists: str,
    quiet: bool,
) -> None:
    """Generate videos with their ground truth, NAME.stimulus.json.

    NAME is an entry of the catalogue (all stimuli of its sweep) or one of its stimuli,
    FILE your own .toml, GLOB a pattern such as 'klapoetke2017/*'. The paths of the
    videos are printed.
    """
    protocols, problems = _protocols(names, _settings(settings), form)
    wanted = _not_there(protocols, directory, form, preview, if_exists)
    if form == "mp4":
        click.echo("note: mp4 (H.264) is lossy; use ffv1 for exact luminance", err=True)
    results = _written(wanted, directory, form, preview=preview, jobs=jobs, quiet=quiet)
    for one in results:
        if isinstance(one, OpploadError):
            problems.append(one)
        else:
            click.echo(str(one.video))
    made = len(protocols) - sum(isinstance(one, OpploadError) for one in results)
    if problems and not made:
        # the last one is printed by the caller, with its exit code
        raise _reported(problems)
    if problems:
        for problem in problems:
            click.echo(f"oppload: {problem}", err=True)
        context.exit(ExitCode.INCOMPLETE)


@stimuli.command()
def schema() -> None:
    """Print the JSON Schema of protocol files, for editors."""
    from oppload_cli.stimulus.schema import json_schema  # noqa: PLC0415

    click.echo(json.dumps(json_schema(), indent=2, ensure_ascii=False))


def _settings(texts: Sequence[str]) -> dict[str, Any]:
    from oppload_cli.stimulus.sweep import parsed_setting  # noqa: PLC0415

    return dict(parsed_setting(text) for text in texts)


def _protocols(
    names: Sequence[str], settings: dict[str, Any], form: str
) -> tuple[list[Protocol], list[OpploadError]]:
    """Resolve all names; a name that fails does not stop the others."""
    from oppload_cli.stimulus.catalogue import find  # noqa: PLC0415
    from oppload_cli.stimulus.files import check_fits  # noqa: PLC0415

    found: dict[str, Protocol] = {}
    problems: list[OpploadError] = []
    for name in names:
        try:
            for entry in find(name):
                for protocol in entry.with_settings(settings).protocols():
                    check_fits(protocol, form, str(entry.path))
                    same = found.setdefault(protocol.name, protocol)
                    if same != protocol:
                        raise OutputError(
                            f"{entry.path}: two different stimuli are named '{protocol.name}'; "
                            "rename a file or generate them one by one"
                        )
        except OpploadError as problem:
            problems.append(problem)
    return list(found.values()), problems


def _not_there(
    protocols: list[Protocol], directory: Path, form: str, preview: bool, if_exists: str
) -> list[Protocol]:
    """Leave out what exists already, or complain about it before anything is drawn."""
    from oppload_cli.stimulus.files import targets  # noqa: PLC0415

    wanted = []
    for protocol in protocols:
        made = targets(protocol, directory, form, preview=preview)
        there = [path for path in (made.video, made.truth) if path.exists()]
        if there and if_exists == "error":
            raise OutputError(
                f"{there[0]} exists already; use --if-exists skip or overwrite, or another folder"
            )
        if len(there) < 2 or if_exists == "overwrite":
            wanted.append(protocol)
    return wanted


def _written(
    protocols: list[Protocol],
    directory: Path,
    form: str,
    *,
    preview: bool,
    jobs: int | None,
    quiet: bool,
) -> list[Written | OpploadError]:
    from tqdm import tqdm  # noqa: PLC0415

    from oppload_cli.stimulus.batch import default_jobs, write_all  # noqa: PLC0415

    total = sum(protocol.frame_count for protocol in protocols)
    hidden = quiet or not on_terminal()
    with tqdm(total=total, unit=" frames", disable=hidden, file=sys.stderr) as bar:

        def advance(frames: int) -> None:
            bar.update(frames)

        return write_all(
            protocols,
            directory,
            form=form,
            preview=preview,
            jobs=jobs or default_jobs(len(protocols)),
            progress=advance,
        )


def _reported(problems: list[OpploadError]) -> OpploadError:
    for problem in problems[:-1]:
        click.echo(f"oppload: {problem}", err=True)
    return problems[-1]


def _table(listed: Sequence[Entry]) -> str:
    """Name, number of stimuli and description, in columns."""
    rows = [(entry.name, str(len(entry.values())), entry.description) for entry in listed]
    widths = [max(len(row[column]) for row in rows) for column in (0, 1)]
    lines = [f"{name:<{widths[0]}}  {clips:>{widths[1]}}  {text}" for name, clips, text in rows]
    total = sum(int(row[1]) for row in rows)
    return "\n".join([*lines, "", f"{len(rows)} protocols, {total} stimuli"])


def _shown(entry: Entry, protocols: Sequence[Protocol]) -> str:
    first = protocols[0]
    display = first.display
    facts = {
        "description": entry.description,
        "source": entry.source,
        "tags": ", ".join(entry.tags),
        "display": f"{display.width} x {display.height} px, {display.scale:g} px/deg, "
        f"{display.projection}, {float(display.frame_rate):g} Hz",
        "frames": f"{first.frame_count} ({first.timing.total_s:g} s)",
        "file": str(entry.path),
        "stimuli": "\n             ".join(protocol.name for protocol in protocols),
    }
    lines = [entry.name, *(f"{name + ':':<13}{value}" for name, value in facts.items() if value)]
    return "\n".join([*lines, "", entry.path.read_text(encoding="utf-8")])
