"""``oppload tune``."""

from __future__ import annotations

import math
import sys
from typing import TYPE_CHECKING, Any

import click

import oppload_cli as oppload
from oppload_cli import stimulus as stimuli
from oppload_cli.cli import options, progress_bar, say
from oppload_cli.cli.stimuli import say_remarks
from oppload_cli.errors import ParameterError, ResultError
from oppload_cli.files.atomic import PartFile, claimed, refuse_existing, write_atomic
from oppload_cli.stimulus.catalogue import parsed_settings

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from oppload_cli.tuning.sweeps import Sweep


@click.command()
@click.argument(
    "stimulus", metavar="[STIMULUS]", required=False, shell_complete=options.complete_stimuli
)
@click.option(
    "--figure",
    "figures",
    multiple=True,
    metavar="NAME",
    help="In place of STIMULUS, a classic figure of looming neuroscience: peak-time, size-speed, "
    "position, bar-ends, contrast, habituation, or all of them.",
)
@click.option(
    "--over",
    multiple=True,
    metavar="PARAMETER[=VALUES]",
    help="Parameter to sweep: axis, direction, speed, width, size, l/v, position, seed or a key "
    "such as bar.axis_deg; VALUES as 10,20,40 or 0:330:30 (from:to:step). Given twice: every "
    "combination.  [default: the stimulus's own sweep]",
)
@options.change
@options.settings(models_by_default="those that fit the stimulus", table=False)
@click.option(
    "--indicator",
    "indicator_s",
    type=click.FloatRange(0, 60),
    default=0.0,
    show_default=True,
    metavar="SECONDS",
    help="Measure the responses as a calcium indicator with this time constant shows them; "
    "0: no indicator.",
)
@options.output(".", "Folder of the results.  [default: this folder]")
@click.option(
    "--plot",
    "form",
    type=click.Choice(["png", "svg", "pdf", "none"]),
    default="png",
    show_default=True,
    help="Format of the matching plot.",
)
@options.jobs("conditions")
@options.if_exists("a result")
@options.quiet
def tune(
    stimulus: str | None,
    figures: tuple[str, ...],
    over: tuple[str, ...],
    changes: tuple[str, ...],
    indicator_s: float,
    output: Path,
    form: str,
    jobs: int,
    if_exists: str,
    quiet: bool,
    **chosen: Any,
) -> None:
    """Measure the tuning of detectors to one stimulus; no video is written.

    STIMULUS is a name of the catalogue ('oppload stimuli list') or a .toml file. DIR
    gets NAME.tuning.csv, a row per condition and detector, NAME.tuning.json with all
    settings, and the plot: polar over directions, a line over one parameter, a heat
    map over two. With --figure, NAME is the name of the figure.
    """
    from oppload_cli.tuning.sweeps import parsed_over, sweeps

    if (stimulus is None) == (not figures):
        raise click.UsageError("give a STIMULUS or --figure NAME, one of the two")
    if math.isnan(indicator_s):  # FloatRange lets it pass
        raise ParameterError("--indicator must be 0 to 60 seconds, not nan")
    values = parsed_settings(changes)
    options.check_models(chosen["models"], "tune")
    for sweep in sweeps(stimulus, figures, values, parsed_over(over), chosen):
        table = output / f"{stimuli.file_stem(sweep.entry.name)}.tuning.csv"
        paths = [table, table.with_suffix(".json")]
        paths += [table.with_suffix(f".{form}")] if form != "none" else []
        refuse_existing(paths, if_exists)
        with claimed(table, if_exists) as claim:
            written = _run(sweep, indicator_s, claim, paths, jobs=jobs, quiet=quiet)
        for path in written:
            click.echo(path)


def _run(
    sweep: Sweep,
    indicator_s: float,
    table: PartFile,
    paths: Sequence[Path],
    *,
    jobs: int,
    quiet: bool,
) -> Sequence[Path]:
    """Measure a sweep; write the table, the sidecar and the plot, and return their paths."""
    from oppload_cli.plots import style, tuning_plots
    from oppload_cli.results.table import write_sidecar
    from oppload_cli.tuning.measuring import doubts_about, tune, tuning_sidecar, tuning_text

    say_remarks(sweep.entry.protocols())
    for key, value in sweep.fixed.items():
        say(f"oppload: {key} stays at {value}; to sweep it as well, add --over {key}")
    with progress_bar(len(sweep.entry.values()), "condition", quiet=quiet) as bar:
        conditions = tune(sweep, indicator_s=indicator_s, jobs=jobs, progress=bar.update)
    doubts = list(doubts_about(conditions, sweep, indicator_s))
    for doubt in doubts:
        say(f"oppload: {doubt.text}")
    write_atomic(table, tuning_text(conditions))
    command = ["oppload", *sys.argv[1:]]
    sidecar = tuning_sidecar(sweep, command=command, indicator_s=indicator_s, doubts=doubts)
    table_path, sidecar_path, *plot_paths = paths
    write_sidecar(sidecar_path, sidecar)  # the summary follows, if the table can be read
    try:
        measured = oppload.read_tuning(table_path)
        write_sidecar(sidecar_path, sidecar | {"summary": tuning_plots.summary_of(measured)})
        lines = tuning_plots.lines_of([measured])
        for plot_path in plot_paths:
            for remark in style.save(oppload.plot_tuning(measured)[0], plot_path):
                say(f"oppload: {remark}")
    except ResultError as error:
        if plot_paths:
            say(f"oppload: no plot: {error}")
        return paths[:2]
    for line in lines:
        say(line)
    return paths
