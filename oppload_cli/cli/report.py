"""``oppload report``."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

import click

from oppload_cli.cli import check_display, options, progress_bar, say, show_file
from oppload_cli.errors import ExitCode, ParameterError
from oppload_cli.files.atomic import folder_of_outputs
from oppload_cli.files.reading import is_folder

if TYPE_CHECKING:
    from collections.abc import Sequence


@click.command()
@options.results
@options.output(None, "Folder of the pages.  [default: the folder of the results]")
@click.option(
    "--video",
    "videos",
    type=click.Path(path_type=Path, exists=True),
    metavar="INPUT|DIR",
    help="The video, or the folder of the videos, if they were moved.",
)
@options.jobs("pages")
@click.option("--show", is_flag=True, help="Open the page in the browser, if there is one.")
@options.quiet
def report(
    results: tuple[Path, ...],
    output: Path | None,
    videos: Path | None,
    jobs: int,
    show: bool,
    quiet: bool,
) -> int:
    """Make one HTML page per result; a page opens offline in any browser.

    RESULT is a frames.csv of 'oppload run', or a folder of results, searched to any depth.
    The page NAME.report.html holds the video with its boxes, the responses divided by their
    thresholds, RMO, the ground truth of a stimulus, the alarms and the settings, all in sync. A
    long video is a file beside the page, NAME.report.mp4. For several results there is
    also index.html, a table of them that can be sorted.
    """
    from oppload_cli.results.collecting import tables_in

    if show:
        check_display()
    folders = [path for path in results if is_folder(path)]
    common = _common_folder(folders)
    inputs = tables_in(results)
    tables = [table for _, table in inputs]
    roots = [common if common and is_folder(path) else table.parent for path, table in inputs]
    folder = output or _folder_of(results)
    with folder_of_outputs(folder):
        page, code = write_pages(
            tables, folder, roots=roots, batches=folders, videos=videos, jobs=jobs, quiet=quiet
        )
    click.echo(page)
    if show:
        show_file(page)
    return code


def write_pages(
    tables: Sequence[Path],
    folder: Path,
    *,
    roots: Sequence[Path],
    batches: Sequence[Path],
    jobs: int,
    quiet: bool,
    videos: Path | None = None,
) -> tuple[Path, ExitCode]:
    """Write pages with a progress bar, and print their faults.

    The parameters are those of :func:`~oppload_cli.report.writing.write_report`; `batches` are the
    folders whose failed inputs the index lists too. Returns the index, or the only page, and the
    exit code: ``INCOMPLETE`` if a result has no page.
    """
    from oppload_cli.batch.plan import failed_in
    from oppload_cli.report.writing import write_report

    failed = [
        (batch / stem, error)
        for batch in dict.fromkeys(batches)
        for stem, error in failed_in(batch)
    ]
    total, unit = (None, "frame") if len(tables) == 1 else (len(tables), "page")
    with progress_bar(total, unit, quiet=quiet) as bar:
        written = write_report(
            tables,
            folder,
            roots=roots,
            videos=videos,
            failed=failed,
            jobs=jobs,
            progress=bar.update,
        )
    for line in (*written.notes, *map(str, written.failures)):
        say(f"oppload: {line}")
    return written.first, ExitCode.INCOMPLETE if written.failures else ExitCode.DONE


def _common_folder(folders: Sequence[Path]) -> Path | None:
    """Return the nearest folder that holds all of some folders; None if there is none."""
    try:
        return Path(os.path.commonpath(folders))
    except ValueError:  # no folder, an absolute and a relative path, or another drive
        return None


def _folder_of(results: Sequence[Path]) -> Path:
    """Return the folder of the results; raise ParameterError if they lie in several."""
    folders = {path if is_folder(path) else path.parent for path in results}
    if len(folders) > 1:
        raise ParameterError("the results lie in several folders; give one for the pages, --output")
    return folders.pop()
