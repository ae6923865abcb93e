"""``oppload reproduce``."""

from __future__ import annotations

import sys
import time
from pathlib import Path

import click

from oppload_cli.cli import on_terminal
from oppload_cli.errors import OutputError


@click.command(short_help="every synthetic figure of the OppLoD paper, with verdicts")
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    default=Path("reproduction"),
    metavar="DIR",
    show_default=True,
    help="Folder of the results.",
)
@click.option("--only", multiple=True, metavar="FIG", help="Only this figure; may be given again.")
@click.option("--list", "listed", is_flag=True, help="Print the names of the figures.")
@click.option("--jobs", type=click.IntRange(1, 64), help="Processes.  [default: the cores]")
@click.option(
    "--if-exists",
    type=click.Choice(["error", "overwrite"]),
    default="error",
    show_default=True,
    help="What to do where results are there already.",
)
@click.option("-q", "--quiet", is_flag=True, help="No progress bar.")
def reproduce(  # noqa: PLR0917 - click passes them by name
    output: Path,
    only: tuple[str, ...],
    listed: bool,
    jobs: int | None,
    if_exists: str,
    quiet: bool,
) -> None:
    """Reproduce every synthetic figure of the OppLoD paper; takes about two minutes.

    DIR gets a PNG per figure, report.json with every statement of the paper, what was
    measured and the verdict, and index.html, one page with all of it.
    """
    from oppload_cli.reproduction.figures import FIGURES, chosen  # noqa: PLC0415

    if listed:
        click.echo("\n".join(FIGURES))
        return
    names = chosen(only)
    targets = [output / f"{name}.png" for name in names]
    targets += [output / "report.json", output / "index.html"]
    there = [path for path in targets if path.exists()]
    if there and if_exists == "error":
        raise OutputError(f"{there[0]}: exists already; use --if-exists overwrite or another -o")
    _make(names, output, jobs=jobs, quiet=quiet)


def _make(names: list[str], output: Path, *, jobs: int | None, quiet: bool) -> None:
    from tqdm import tqdm  # noqa: PLC0415

    from oppload_cli.environment import cores  # noqa: PLC0415
    from oppload_cli.reproduction.figures import build  # noqa: PLC0415
    from oppload_cli.reproduction.page import page_of  # noqa: PLC0415
    from oppload_cli.reproduction.report import report_json, report_of  # noqa: PLC0415
    from oppload_cli.video.atomic import part_of, remove, write_atomic  # noqa: PLC0415

    started = time.perf_counter()
    # A folder that cannot be written shall be known before two minutes of work.
    write_atomic(part_of(output / "report.json"), [])
    remove(part_of(output / "report.json"))
    hidden = quiet or not on_terminal()
    with tqdm(total=len(names), unit="figure", disable=hidden, file=sys.stderr) as bar:
        figures = build(names, jobs=jobs or cores(), progress=bar.update)
    report = report_of(figures, time.perf_counter() - started)
    pictures = {figure.name: figure.png for figure in figures}
    for name, png in pictures.items():
        write_atomic(output / f"{name}.png", [png])
        click.echo(output / f"{name}.png")
    page = page_of(report, pictures)
    for path, text in (
        (output / "report.json", report_json(report)),
        (output / "index.html", page),
    ):
        write_atomic(path, [text.encode()])
        click.echo(path)
