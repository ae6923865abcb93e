"""``oppload plot``."""

from __future__ import annotations

from pathlib import Path

import click


@click.command(short_help="plot results")
@click.argument(
    "results", nargs=-1, required=True, metavar="RESULT.csv...", type=click.Path(path_type=Path)
)
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="All results in one figure: .png, .svg or .pdf.  [default: a .png beside each result]",
)
def plot(results: tuple[Path, ...], output: Path | None) -> None:
    """Plot the responses of the models over time, with their peaks and alarms.

    RESULT.csv is a frames.csv of 'oppload run'. Each curve is divided by its own peak.
    """
    from oppload_cli.plots.curves import plot_curves  # noqa: PLC0415 - keeps --help fast
    from oppload_cli.plots.style import check_suffix, save  # noqa: PLC0415
    from oppload_cli.results.reading import read_result  # noqa: PLC0415

    if output is not None:
        check_suffix(output)
    read = [read_result(path) for path in results]
    groups = [(output, read)] if output else [(_beside(one.path), [one]) for one in read]
    for path, group in groups:
        save(plot_curves(group), path)
        click.echo(path)


def _beside(path: Path) -> Path:
    return path.with_name(path.name.removesuffix(".part")).with_suffix(".png")
