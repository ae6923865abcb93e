"""``oppload reproduce``."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import click

from oppload_cli.cli import options, progress_bar, say
from oppload_cli.files.atomic import claimed, refuse_existing, write_atomic
from oppload_cli.reproduction.claims import FIGURES, Built, build, chosen_figures, pages_of

if TYPE_CHECKING:
    from pathlib import Path


@click.command()
@options.output("reproduction")
@click.option(
    "--only",
    multiple=True,
    metavar="FIG",
    help="Only this figure, or A,B for several; may be given again.",
)
@click.option(
    "--plot",
    "form",
    type=click.Choice(["png", "svg", "pdf"]),
    default="png",
    show_default=True,
    help="Format of the figures.",
)
@click.option("--list", "listed", is_flag=True, help="Print the names of the figures.")
@options.jobs("figures")
@options.if_exists("a result")
@options.quiet
def reproduce(
    output: Path,
    only: tuple[str, ...],
    form: str,
    listed: bool,
    jobs: int,
    if_exists: str,
    quiet: bool,
) -> None:
    """Reproduce every synthetic figure of the OppLoD paper; takes about five minutes.

    For each figure, DIR gets a picture and a CSV with its numbers as soon as they are ready. At
    the end DIR gets report.json with every statement of the paper, the measurement and the
    verdict, and index.html, one page with everything.
    """
    if listed:
        click.echo("\n".join(FIGURES))
        return
    names = chosen_figures(options.listed_names(only))
    targets = [f"{name}.{suffix}" for name in names for suffix in (form, "csv")]
    targets += ["report.json", "index.html"]
    refuse_existing((output / name for name in targets), if_exists)
    started = time.perf_counter()
    with claimed(output / "report.json", if_exists) as claim:
        with progress_bar(len(names), "figure", quiet=quiet) as bar:

            def write(figure: Built) -> None:
                for name, content in figure.files(form).items():
                    write_atomic(output / name, content)
                bar.update()

            figures = build(names, jobs=jobs, form=form, done=write)
        pages, verdicts = pages_of(figures, time.perf_counter() - started, form)
        for name, content in pages.items():
            write_atomic(claim if name == "report.json" else output / name, content)
        # After all files: printing fails if the program that reads the names has ended.
        click.echo("\n".join(str(output / name) for name in targets))
        say(f"verdicts on the statements of the paper: {verdicts}")
