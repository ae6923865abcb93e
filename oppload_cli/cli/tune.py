"""``oppload tune``."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

import click

from oppload_cli.cli.options import (
    change_option,
    complete_stimuli,
    if_exists_option,
    jobs_option,
    output_option,
    quiet_option,
    settings_options,
)
from oppload_cli.files.atomic import claimed, refuse_existing
from oppload_cli.models.presets import STUDY_PRESET
from oppload_cli.processes import cores
from oppload_cli.stimulus.catalogue import parsed_setting

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from oppload_cli.files.atomic import PartFile
    from oppload_cli.pipeline.settings import Settings
    from oppload_cli.stimulus.catalogue import Entry
    from oppload_cli.tuning.run import Condition

FAINT = 0.1  # of an alarm's floor: the largest response of a detector that hardly sees a stimulus


@click.command(short_help="measure responses to a stimulus over directions, speeds, sizes")
@click.argument("stimulus", metavar="STIMULUS", shell_complete=complete_stimuli)
@click.option(
    "--over",
    multiple=True,
    metavar="PARAMETER[=VALUES]",
    help="What to sweep: axis, direction, speed, width, size, l/v, position or a key such as "
    "bar.axis_deg; VALUES as 10,20,40 or 0:330:30 (from:to:step). Given twice: every "
    "combination.  [default: the stimulus's own sweep]",
)
@change_option
@settings_options(preset=STUDY_PRESET, table=False)
@output_option(".", "Folder of the results.  [default: this folder]")
@click.option(
    "--plot",
    "figure",
    type=click.Choice(["png", "svg", "pdf", "none"]),
    default="png",
    show_default=True,
    help="Format of the matching plot.",
)
@jobs_option("Conditions")
@if_exists_option("a result")
@quiet_option
def tune(
    stimulus: str,
    over: tuple[str, ...],
    changes: tuple[str, ...],
    models: tuple[str, ...],
    preset: str | None,
    assignments: tuple[str, ...],
    config: Path | None,
    height: str | None,
    repeats: str | None,
    output: Path,
    figure: str,
    jobs: int,
    if_exists: str,
    quiet: bool,
) -> None:
    """Measure the tuning of detectors to one stimulus; no video is written.

    STIMULUS is a name of the catalogue ('oppload stimuli list') or a .toml file. DIR
    gets NAME.tuning.csv, a row per condition and detector, NAME.tuning.json with all
    settings, and the plot: polar over directions, a line over one parameter, a heat
    map over two.
    """
    from oppload_cli.pipeline.settings import resolve
    from oppload_cli.stimulus.files import file_stem
    from oppload_cli.tuning.run import entry_named, swept

    settings = resolve(
        preset=preset,
        config=config,
        models=models,
        height=height,
        repeats=repeats,
        assignments=assignments,
        usual=STUDY_PRESET,
    )
    entry = entry_named(stimulus)
    entry = swept(entry.with_settings(dict(parsed_setting(text) for text in changes)), over)
    table = output / f"{file_stem(entry.name)}.tuning.csv"
    kept = [table, table.with_suffix(".json")]
    kept += [table.with_suffix(f".{figure}")] if figure != "none" else []
    refuse_existing(kept, if_exists)
    with claimed(table, if_exists) as claim:
        _run(entry, settings, claim, kept, jobs=jobs, quiet=quiet)
    for path in kept:
        click.echo(path)


def _run(
    entry: Entry,
    settings: Settings,
    table: PartFile,
    paths: Sequence[Path],
    *,
    jobs: int,
    quiet: bool,
) -> None:
    from oppload_cli.cli.progress import progress_bar
    from oppload_cli.tuning.run import tune, write_tuning, write_tuning_sidecar

    count = len(entry.values())
    with progress_bar(count, "condition", quiet=quiet) as bar:
        conditions = tune(entry, settings, jobs=jobs or cores(), progress=bar.update)
    _warn_of_faint(conditions, settings)
    write_tuning(table, conditions)
    write_tuning_sidecar(paths[1], entry, settings, command=["oppload", *sys.argv[1:]])
    if len(paths) > 2:
        from oppload_cli.plots.polar import direction_tunings
        from oppload_cli.plots.style import save
        from oppload_cli.plots.tuning import kind_of, plot_tuning
        from oppload_cli.results.reading import read_tuning

        tuning = read_tuning(paths[0])
        save(plot_tuning(tuning)[0], paths[2])
        if kind_of(tuning) == "polar":
            for curve in direction_tunings([tuning]):
                click.echo(curve.line(), err=True)


def _warn_of_faint(conditions: Sequence[Condition], settings: Settings) -> None:
    """Say which detectors hardly respond: the shape of such a curve tells little."""
    from oppload_cli.models.registry import alarm_floor_of, detector_named

    for name in settings.models:
        peak = max(each.measures[name].peak or 0 for each in conditions)
        floor = alarm_floor_of(name, settings.preset)
        if peak < FAINT * floor:
            click.echo(
                f"oppload: {detector_named(name).label} hardly responds to this stimulus under "
                f"preset {settings.preset}: its largest response is {peak:.2g}, and no alarm is "
                f"given below {floor:g}; 'oppload models' lists the presets",
                err=True,
            )
