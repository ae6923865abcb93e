"""``oppload stimuli``: lists and shows protocols of the catalogue, and makes their files."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import click

from oppload_cli.cli import options, progress_bar, say
from oppload_cli.errors import ExitCode, OpploadError
from oppload_cli.stimulus.catalogue import Entry, entries, find, in_toml, parsed_settings
from oppload_cli.stimulus.protocol import Protocol, json_schema

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path


_INDENT = "\n" + 13 * " "  # before the second and further values of a fact
# The keys of oppload_cli.video.writers.FORMATS; importing that module would slow down --help.
FORMATS = ("ffv1", "mkv", "mp4", "png", "npz", "gif")


@click.group(name="stimuli")
def stimuli() -> None:
    """List, show and generate looming stimuli with ground truth."""


@stimuli.command(name="list")
@click.argument(
    "patterns", nargs=-1, metavar="[NAME|GLOB]...", shell_complete=options.complete_stimuli
)
@click.option("--json", "as_json", is_flag=True, help="A JSON list instead of a table.")
def list_stimuli(patterns: tuple[str, ...], as_json: bool) -> None:
    """List the catalogue."""
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


@stimuli.command(short_help="Show a protocol with its values and its file.")
@click.argument("name", metavar="NAME|FILE", shell_complete=options.complete_stimuli)
@click.option("--json", "as_json", is_flag=True, help="The resolved protocols as a JSON list.")
@options.change
def show(name: str, as_json: bool, changes: tuple[str, ...]) -> None:
    """Show a protocol: its description, its stimuli, the changed values and its file."""
    shown = [(entry, entry.with_settings(parsed_settings(changes))) for entry in find(name)]
    say_remarks([protocol for _, entry in shown for protocol in entry.protocols()])
    if as_json:
        changed = [entry.with_changes_described() for _, entry in shown]
        tables = [protocol.as_table() for entry in changed for protocol in entry.protocols()]
        click.echo(json.dumps(tables, indent=2, ensure_ascii=False))
        return
    for original, entry in shown:
        click.echo(_details(original, entry))


@stimuli.command()
@click.argument(
    "names",
    nargs=-1,
    metavar="NAME|FILE|GLOB...",
    shell_complete=options.complete_stimuli,
)
@options.output(".", "Folder of the files.  [default: this folder]")
@click.option(
    "--format",
    "form",
    type=click.Choice(FORMATS),
    default="ffv1",
    show_default=True,
    help="ffv1 (.avi), mkv (FFV1), png (folder), npz and gif are lossless; mp4 (H.264) is lossy.",
)
@options.change
@click.option("--preview", is_flag=True, help="Also write a contact sheet NAME.preview.png.")
@options.jobs("stimuli")
@options.if_exists("a file", skip=True)
@options.quiet
@click.pass_context
def generate(
    context: click.Context,
    names: tuple[str, ...],
    output: Path,
    form: str,
    changes: tuple[str, ...],
    preview: bool,
    jobs: int,
    if_exists: str,
    quiet: bool,
) -> None:
    """Generate videos with their ground truth, NAME.stimulus.json.

    NAME is an entry of the catalogue (all stimuli of its sweep) or one of its stimuli; the last
    part of a name is enough, or any part that no other name has. FILE is a .toml of your own, GLOB
    a pattern such as 'klapoetke2017/*'. The command prints the paths of the videos.
    """
    if not names:
        raise click.UsageError(
            "Missing argument 'NAME|FILE|GLOB...'; 'oppload stimuli list' has the names"
        )
    from oppload_cli.stimulus.files import not_made_yet, stimuli_named, write_all

    protocols, problems = stimuli_named(names, parsed_settings(changes), form)
    wanted = not_made_yet(protocols, output, form, if_exists, preview=preview)
    say_remarks(protocols)
    if form == "mp4":
        say("note: mp4 (H.264) is lossy; use ffv1 for exact luminance")
    total = sum(protocol.frame_count for protocol in wanted)
    with progress_bar(total, " frames", quiet=quiet) as bar:
        results = write_all(
            wanted,
            output,
            form=form,
            preview=preview,
            new=if_exists == "error",
            jobs=jobs,
            progress=bar.update,
        )
    for result in results:
        if isinstance(result, OpploadError):
            problems.append(result)
        else:
            click.echo(str(result.video))
    made = len(protocols) - sum(isinstance(result, OpploadError) for result in results)
    for problem in problems if made else problems[:-1]:
        say(f"oppload: {problem}")
    if problems and not made:
        raise problems[-1]  # `main` prints it and exits with its code
    if problems:
        context.exit(ExitCode.INCOMPLETE)


@stimuli.command()
def schema() -> None:
    """Print the JSON Schema of protocol files, for editors."""
    click.echo(json.dumps(json_schema(), indent=2, ensure_ascii=False))


def say_remarks(protocols: Sequence[Protocol]) -> None:
    """Say each remark once, with the first stimulus that it concerns and the number of others."""
    concerned: dict[str, list[str]] = {}
    for protocol in protocols:
        for remark in protocol.remarks():
            concerned.setdefault(remark, []).append(protocol.name)
    for remark, (first, *others) in concerned.items():
        say(f"note: {first}{f' and {len(others)} more' if others else ''}: {remark}")


def _table(listed: Sequence[Entry]) -> str:
    """Return lines with the name, the number of stimuli and the description of each entry."""
    rows = [(entry.name, str(len(entry.values())), entry.description) for entry in listed]
    widths = [max(len(row[column]) for row in rows) for column in (0, 1)]
    lines = [f"{name:<{widths[0]}}  {clips:>{widths[1]}}  {text}" for name, clips, text in rows]
    total = sum(int(row[1]) for row in rows)
    return "\n".join([*lines, "", f"{len(rows)} protocols, {total} stimuli"])


def _details(original: Entry, entry: Entry) -> str:
    """Return the description of an entry with its changed values, and the text of its file."""
    protocols = entry.protocols()
    displays = (protocol.display for protocol in protocols)
    changes = [
        f"{dotted} = {in_toml(value)}, {_in_file(original.value_of(dotted))}"
        for dotted, value in entry.changes.items()
    ]
    facts = {
        "changed": _INDENT.join(changes),
        "description": entry.description,
        "source": entry.source,
        "tags": ", ".join(entry.tags),
        "display": _unique_lines(
            f"{display.width} x {display.height} px, {display.scale:g} px/deg, "
            f"{display.projection}, {float(display.frame_rate):g} Hz"
            for display in displays
        ),
        "frames": _unique_lines(
            f"{protocol.frame_count} ({protocol.timing.total_s:g} s)" for protocol in protocols
        ),
        "file": str(entry.path),
        "stimuli": _INDENT.join(protocol.name for protocol in protocols),
    }
    lines = [entry.name, *(f"{name + ':':<13}{value}" for name, value in facts.items() if value)]
    if changes:
        lines += ["", "The file, without the changes:"]
    return "\n".join([*lines, "", entry.path.read_text(encoding="utf-8")])


def _unique_lines(texts: Iterable[str]) -> str:
    """Return each text of the stimuli of a sweep once, on lines of their own."""
    return _INDENT.join(dict.fromkeys(texts))


def _in_file(value: object) -> str:
    return "which the file leaves out" if value is None else f"in the file {in_toml(value)}"
