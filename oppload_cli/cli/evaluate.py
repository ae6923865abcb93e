"""``oppload evaluate``."""

from __future__ import annotations

import time
from pathlib import Path

import click

from oppload_cli.cli import options, progress_bar, say
from oppload_cli.errors import ExitCode
from oppload_cli.files.atomic import claimed, refuse_existing
from oppload_cli.models.presets import EXAMPLE_SETTING


@click.command()
@click.argument(
    "inputs",
    nargs=-1,
    required=True,
    metavar="MANIFEST.csv|STIMULUS...|VIDEO...",
    shell_complete=options.complete_stimuli,
)
@options.models(
    metavar="NAME[:PRESET]",
    help="Detectors to evaluate: NAME, or NAME:PRESET of one that presets change, or several as "
    "A,B; may be given again; the baselines are always evaluated.  "
    "[default: presets default and reference]",
)
@options.assignments(
    help=f"One parameter of a detector or of all alarms, e.g. {EXAMPLE_SETTING}; may be given "
    "again.",
)
@options.config(
    help="Settings of 'oppload run' from a file, for all detectors; the models of the file are "
    "evaluated under its preset, unless --model names others.",
)
@click.option(
    "--height",
    metavar="PX",
    help="Height to which frames are resized for all detectors.  [default: that of the preset]",
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
    models: tuple[str, ...],
    assignments: tuple[str, ...],
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
    luminance. DIR gets evaluation.html, one page with everything, report.json, the
    measurements, responses and windows as CSV, and the plots.
    """
    from oppload_cli.evaluation import detectors, evaluate
    from oppload_cli.evaluation.inputs import clips_of
    from oppload_cli.evaluation.output import FILES, printed_table, write_evaluation

    chosen = detectors.evaluated_detectors(
        options.listed_names(models), repeats, assignments, config=config, height=height
    )
    clips = clips_of(inputs, boxes, [str(path) for path in backgrounds], changes)
    refuse_existing((output / name for name in FILES), if_exists)
    started = time.perf_counter()
    with claimed(output / "report.json", if_exists) as claim:
        for fault in (*clips.notes, *clips.faults):
            say(f"oppload: {fault}")
        with progress_bar(len(clips.entries), "clip", quiet=quiet) as bar:
            result = evaluate.evaluate(clips, chosen, jobs=jobs, draws=draws, progress=bar.update)
        for fault in result.faults[len(clips.faults) :]:
            say(f"oppload: {fault}")
        made = write_evaluation(result, output, claim, lambda: time.perf_counter() - started)
        written = [str(path) for path in made]  # `made` writes each file when it yields its path
    click.echo("\n".join(written))
    if not quiet:
        for line in printed_table(result):
            say(line)
    return ExitCode.INCOMPLETE if result.faults else ExitCode.DONE
