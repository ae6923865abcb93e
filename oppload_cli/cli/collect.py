"""``oppload collect``."""

from __future__ import annotations

from pathlib import Path

import click

from oppload_cli.cli import say
from oppload_cli.cli.options import if_exists_option
from oppload_cli.errors import ExitCode
from oppload_cli.results import collecting


@click.command(short_help="join many results into one table")
@click.argument(
    "folders", nargs=-1, required=True, metavar="DIR...", type=click.Path(path_type=Path)
)
@click.option(
    "-o",
    "--output",
    required=True,
    metavar="FILE",
    type=click.Path(path_type=Path),
    help="The table: .csv or .parquet.",
)
@click.option("--frames", "of_frames", is_flag=True, help="A row per frame, of all inputs.")
@if_exists_option("the table")
@click.option("-q", "--quiet", is_flag=True, help="Print errors only.")
def collect(
    folders: tuple[Path, ...], output: Path, of_frames: bool, if_exists: str, quiet: bool
) -> int:
    """Collect the results in folders, to any depth, into one table.

    A row per input and model, from the sidecars; or with --frames a row per frame.
    A result that cannot be collected is named, and does not stop the others.
    """
    found = collecting.collect(
        folders,
        output,
        of_frames=of_frames,
        if_exists=if_exists,
        told=lambda error: say(f"oppload: {error}"),
    )
    if not quiet:
        results, rows = "s" * (found.good != 1), "s" * (found.rows != 1)
        say(f"{found.good} result{results}, {found.rows} row{rows} -> {output}")
    if found.bad:
        lost = f"{found.bad} result{'s' * (found.bad != 1)}"
        say(f"oppload: {lost} could not be collected; the others are in {output}")
    return ExitCode.INCOMPLETE if found.bad else ExitCode.DONE
