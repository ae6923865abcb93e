"""``oppload collect``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from oppload_cli.cli import say
from oppload_cli.cli.options import if_exists_option
from oppload_cli.errors import ExitCode, ResultError
from oppload_cli.files.atomic import refuse_existing
from oppload_cli.files.tables import open_table
from oppload_cli.processes.signals import stop_if_asked

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from oppload_cli.files.tables import Rows
    from oppload_cli.results.collecting import Row


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
    from oppload_cli.results import collecting

    refuse_existing([output], if_exists)
    results = [path for folder in folders for path in collecting.found_results(folder)]
    columns = collecting.frame_columns(results) if of_frames else collecting.SUMMARY_COLUMNS
    rows_of = collecting.frame_rows if of_frames else collecting.summary_rows
    with open_table(output, columns, new=if_exists == "error") as table:
        good, bad, rows = _collected(results, rows_of, table)
        if not good:
            where = ", ".join(map(str, folders))
            reason = "no result could be read" if bad else "no result of 'oppload run' in there"
            raise ResultError(f"{where}: {reason}; check the folder")
    if not quiet:
        say(f"{good} results, {rows} rows -> {output}")
    if bad:
        say(f"oppload: {bad} results could not be collected; the others are in {output}")
    return ExitCode.INCOMPLETE if bad else ExitCode.DONE


def _collected(
    results: Iterable[Path], rows_of: Callable[[Path], Iterator[Row]], table: Rows
) -> tuple[int, int, int]:
    """Collect every result; return how many were good and bad, and the rows."""
    good = bad = rows = 0
    for path in results:
        stop_if_asked()
        try:
            for row in rows_of(path):
                table.write(row)
                rows += 1
        except ResultError as error:
            say(f"oppload: {error}")
            bad += 1
        else:
            good += 1
    return good, bad, rows
