"""``oppload collect``."""

from __future__ import annotations

from pathlib import Path

import click

from oppload_cli.cli import options, say
from oppload_cli.errors import ExitCode, counted
from oppload_cli.results import collecting


@click.command()
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
@options.if_exists("the table")
@click.option("-q", "--quiet", is_flag=True, help="Print errors only.")
def collect(
    folders: tuple[Path, ...], output: Path, of_frames: bool, if_exists: str, quiet: bool
) -> int:
    """Collect the results in folders, to any depth, into one table.

    The table has a row per input and detector, from the sidecars, or with --frames a row per
    frame. If a result cannot be collected, a message names it, and the others are collected.
    """
    collected = collecting.collect(
        folders,
        output,
        of_frames=of_frames,
        if_exists=if_exists,
        on_error=lambda error: say(f"oppload: {error}"),
    )
    if not quiet:
        say(f"{counted(collected.results, 'result')}, {counted(collected.rows, 'row')} -> {output}")
    if collected.differences and not quiet:
        say(f"oppload: the results have different settings: {collected.differences}")
    if collected.failures:
        lost = counted(collected.failures, "result")
        say(f"oppload: {lost} could not be collected; the others are in {output}")
    return ExitCode.INCOMPLETE if collected.failures else ExitCode.DONE
