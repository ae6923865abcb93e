"""``oppload tune``."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from oppload_cli.cli import on_terminal
from oppload_cli.cli.options import settings_options
from oppload_cli.errors import OutputError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from oppload_cli.settings import Settings
    from oppload_cli.stimulus.catalogue import Entry


@click.command(short_help="a stimulus over directions, speeds, sizes or places")
@click.argument("stimulus", metavar="STIMULUS")
@click.option(
    "--over",
    multiple=True,
    metavar="PARAMETER[=VALUES]",
    help="What to sweep: axis, direction, speed, width, size, l/v, position or a key such as "
    "bar.axis_deg; VALUES as 10,20,40 or 0:330:30 (from:to:step). Given twice: every "
    "combination.  [default: the stimulus's own sweep]",
)
@click.option(
    "--stimulus-set",
    "changes",
    multiple=True,
    metavar="KEY=VALUE",
    help="Change a value of the stimulus, e.g. timing.before_s=0.",
)
@settings_options
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    default=Path(),
    metavar="DIR",
    help="Folder of the results.  [default: this folder]",
)
@click.option(
    "--plot",
    "figure",
    type=click.Choice(["png", "svg", "pdf", "none"]),
    default="png",
    show_default=True,
    help="Format of the matching plot.",
)
@click.option("--jobs", type=click.IntRange(1, 64), help="Processes.  [default: the cores]")
@click.option(
    "--if-exists",
    type=click.Choice(["error", "overwrite"]),
    default="error",
    show_default=True,
    help="What to do where a result is there already.",
)
@click.option("-q", "--quiet", is_flag=True, help="No progress bar.")
def tune(  # noqa: PLR0917 - click passes them by name
    stimulus: str,
    over: tuple[str, ...],
    changes: tuple[str, ...],
    models: tuple[str, ...],
    preset: str | None,
    assignments: tuple[str, ...],
    config: Path | None,
    height: str | None,
    output: Path,
    figure: str,
    jobs: int | None,
    if_exists: str,
    quiet: bool,
) -> None:
    """Measure the models' tuning to one stimulus; no video is written.

    STIMULUS is a name of the catalogue ('oppload stimuli list') or a .toml file. DIR
    gets NAME.tuning.csv, a row per condition and model, NAME.tuning.json with all
    settings, and the plot: polar over directions, a line over one parameter, a heat
    map over two.
    """
    from oppload_cli.settings import resolve  # noqa: PLC0415 - keeps --help fast
    from oppload_cli.stimulus.files import file_stem  # noqa: PLC0415
    from oppload_cli.stimulus.sweep import parsed_setting  # noqa: PLC0415
    from oppload_cli.tuning.sweep import entry_named, swept  # noqa: PLC0415

    settings = resolve(
        preset=preset, config=config, models=models, height=height, assignments=assignments
    )
    entry = entry_named(stimulus)
    entry = swept(entry.with_settings(dict(parsed_setting(text) for text in changes)), over)
    table = output / f"{file_stem(entry.name)}.tuning.csv"
    kept = [table, table.with_suffix(".json")]
    kept += [table.with_suffix(f".{figure}")] if figure != "none" else []
    there = [path for path in kept if path.exists()]
    if there and if_exists == "error":
        raise OutputError(f"{there[0]}: exists already; use --if-exists overwrite or another -o")
    _run(entry, settings, kept, jobs=jobs, quiet=quiet)
    for path in kept:
        click.echo(path)


# A tuning table has no motion vectors to switch off.
tune.params = [option for option in tune.params if option.name != "measure_rmo"]


def _run(
    entry: Entry, settings: Settings, paths: Sequence[Path], *, jobs: int | None, quiet: bool
) -> None:
    from tqdm import tqdm  # noqa: PLC0415

    from oppload_cli.environment import cores  # noqa: PLC0415
    from oppload_cli.tuning.run import is_symmetric, tune  # noqa: PLC0415
    from oppload_cli.tuning.table import write_tuning, write_tuning_sidecar  # noqa: PLC0415

    hidden = quiet or not on_terminal()
    count = len(entry.values())
    with tqdm(total=count, unit="condition", disable=hidden, file=sys.stderr) as bar:
        conditions = tune(entry, settings, jobs=jobs or cores(), progress=bar.update)
    write_tuning(paths[0], conditions)
    write_tuning_sidecar(
        paths[1],
        entry,
        settings,
        symmetric=is_symmetric(entry),
        command=["oppload", *sys.argv[1:]],
    )
    if len(paths) > 2:
        from oppload_cli.plots.figures import draw_tuning  # noqa: PLC0415
        from oppload_cli.plots.style import save  # noqa: PLC0415
        from oppload_cli.results.tuning import read_tuning  # noqa: PLC0415

        drawn = draw_tuning([read_tuning(paths[0])])
        save(drawn.figure, paths[2])
        for line in drawn.lines:
            click.echo(line, err=True)
