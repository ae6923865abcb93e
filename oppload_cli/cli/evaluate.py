"""``oppload evaluate``."""

from __future__ import annotations

import time
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Any

import click

from oppload_cli.cli import options, progress_bar, say
from oppload_cli.errors import ExitCode
from oppload_cli.files.atomic import claimed, refuse_existing
from oppload_cli.models import EXAMPLE_SETTING


@click.command()
@click.argument(
    "inputs",
    nargs=-1,
    metavar="MANIFEST.csv|STIMULUS...|VIDEO...",
    shell_complete=options.complete_stimuli,
)
@click.option(
    "--battery",
    is_flag=True,
    help="Show the detectors a fixed set of approaches and other motions: how selective they are, "
    "and what they cost. Without MANIFEST, STIMULUS or VIDEO, these are also the clips.",
)
@options.models(
    metavar="NAME",
    help="Detectors to evaluate, as A,B or given again; all takes all. The baselines are always "
    "evaluated.  [default: opplod and opplod_reference]",
)
@options.assignments(
    help=f"One parameter of a detector or of all alarms, e.g. {EXAMPLE_SETTING}; may be given "
    "again.",
)
@options.config(
    help="Settings of 'oppload run' from a file, for all detectors; those that the file names are "
    "evaluated, unless --model names others.",
)
@click.option(
    "--height",
    metavar="PX",
    help="Height to which frames are resized for all detectors.  [default: their own]",
)
@click.option(
    "--boxes",
    type=click.Path(path_type=Path),
    metavar="FILE.json",
    help="Boxes of the looming objects.  [default: boxes.json beside MANIFEST.csv]",
)
@click.option(
    "--background",
    "backgrounds",
    multiple=True,
    type=click.Path(path_type=Path),
    metavar="VIDEO",
    help="Stage the stimuli in this video; may be given again.",
)
@options.change
@options.output("evaluation")
@options.repeats
@options.jobs("clips")
@click.option(
    "--draws",
    type=click.IntRange(100, 100_000),
    default=1000,
    show_default=True,
    help="Draws of the bootstrap that gives the confidence intervals.",
)
@options.if_exists("a result")
@click.option("-q", "--quiet", is_flag=True, help="No progress bar and no table.")
def evaluate(
    inputs: tuple[str, ...],
    battery: bool,
    models: tuple[str, ...],
    assignments: dict[str, str],
    config: Path | None,
    height: str | None,
    boxes: Path | None,
    backgrounds: tuple[Path, ...],
    changes: tuple[str, ...],
    output: Path,
    repeats: str | None,
    jobs: int,
    draws: int,
    if_exists: str,
    quiet: bool,
) -> int:
    """Measure how often the detectors are right on labelled clips.

    MANIFEST.csv has a row per clip: file,label,onset_frame,contact_frame, with the label
    'looming' or 'none'. Instead of a manifest, name stimuli of the catalogue, such as 'staged/*',
    or videos and folders of images with their ground truth beside them.

    OppLoD is compared with D-LGMD, the divergence of optical flow and the mean change of
    luminance; '--model all' takes all detectors. DIR gets evaluation.html, one page with
    everything, report.json, the measurements, responses and windows as CSV, and the plots.
    """
    from oppload_cli.evaluation import detectors, engine
    from oppload_cli.evaluation.battery import battery_stimuli
    from oppload_cli.evaluation.clip_inputs import clips_of
    from oppload_cli.evaluation.output import ALL_FILES, printed_table, write_evaluation

    chosen = detectors.evaluated_detectors(
        options.listed_names(models), repeats, assignments, config=config, height=height
    )
    of_inputs = inputs or not battery or boxes or backgrounds or changes
    labelled = [clips_of(inputs, boxes, [*map(str, backgrounds)], changes)] if of_inputs else []
    labelled += [battery_stimuli()] if battery else []
    refuse_existing((output / name for name in ALL_FILES), if_exists)
    started = time.perf_counter()
    with claimed(output / "report.json", if_exists) as claim:
        for fault in chain.from_iterable((*clips.notes, *clips.faults) for clips in labelled):
            say(f"oppload: {fault}")
        total = sum(len(clips.entries) for clips in labelled)
        with progress_bar(total, "clip", quiet=quiet) as bar:
            how: Any = {"jobs": jobs, "draws": draws, "progress": bar.update}
            results = [engine.evaluate(clips, chosen, **how) for clips in labelled]
        for clips, found in zip(labelled, results, strict=True):
            for fault in found.faults[len(clips.faults) :]:
                say(f"oppload: {fault}")
        faults = [fault for found in results for fault in found.faults]
        result = replace(results[0], faults=faults, battery=results[-1] if battery else None)
        made = write_evaluation(result, output, claim, lambda: time.perf_counter() - started)
        written = [str(path) for path in made]  # `made` writes each file when it yields its path
    click.echo("\n".join(written))
    if not quiet:
        for line in printed_table(result):
            say(line)
    return ExitCode.INCOMPLETE if faults else ExitCode.DONE
