"""``oppload benchmark``."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from oppload_cli.benchmark.battery import TABLES, columns_of, show
from oppload_cli.benchmark.output import (
    SIDECAR,
    Benchmark,
    refuse_other,
    settings_of,
    write_benchmark,
)
from oppload_cli.cli import options, progress_bar, say
from oppload_cli.errors import ExitCode
from oppload_cli.evaluation.detectors import chosen_detectors
from oppload_cli.evaluation.evaluate import evaluate
from oppload_cli.evaluation.manifest import read_manifest
from oppload_cli.files.atomic import claimed


@click.command()
@options.models(
    metavar="NAME[:PRESET]",
    help="Detectors: NAME, or NAME:PRESET of one that presets change.  [default: all]",
)
@click.option(
    "--only",
    multiple=True,
    metavar="TABLE[,TABLE...]",
    help=f"Tables of the benchmark: {', '.join(each.name for each in TABLES)}.  [default: all]",
)
@click.option(
    "--manifest",
    type=click.Path(path_type=Path),
    metavar="MANIFEST.csv",
    help="Labelled clips to evaluate the detectors on as well, as by 'oppload evaluate'.",
)
@options.output("benchmark")
@options.jobs("stimuli")
@options.if_exists("a benchmark with other settings")
@options.quiet
def benchmark(
    models: tuple[str, ...],
    only: tuple[str, ...],
    manifest: Path | None,
    output: Path,
    jobs: int,
    if_exists: str,
    quiet: bool,
) -> int:
    """Compare all detectors: their responses, their alarms and their cost.

    Every detector sees the same looming stimuli and controls. DIR gets benchmark.html, one
    page with everything, stimuli.csv and summary.csv, a PDF per table, benchmark.json with all
    settings, and a file per stimulus in stimuli/. If you stop a benchmark and give the same
    command again, it reads these files and goes on.
    """
    names = options.listed_names(only)
    columns = columns_of(names)
    detectors = chosen_detectors(options.listed_names(models))
    tables = [table.name for table in TABLES if table.name in names or not names]
    settings = settings_of(detectors, tables, manifest)
    labelled = read_manifest(manifest) if manifest else None
    counts: list[int] = []
    # Files of a benchmark with the same settings may exist: this run goes on with it.
    with claimed(output / SIDECAR, "overwrite") as claim:
        if if_exists == "error":
            refuse_other(output, settings)
        with progress_bar(None, "stimulus", quiet=quiet) as bar:

            def progress(done: int, total: int) -> None:
                counts.append(done)
                bar.total = total
                bar.update(done - bar.n)

            folder = output / "stimuli"
            shown = show(columns, detectors, folder, jobs=jobs, progress=progress)
        if counts[0]:
            say(
                f"{counts[0]} of {counts[-1]} stimuli kept from an earlier run of the same code "
                f"({folder})"
            )
        clips = None
        if labelled is not None:
            with progress_bar(len(labelled.entries), "clip", quiet=quiet) as clip_bar:
                clips = evaluate(labelled, detectors, jobs=jobs, progress=clip_bar.update)
            for fault in (*labelled.notes, *clips.faults):
                say(f"oppload: {fault}")
        measured = Benchmark(shown, detectors, clips)
        command = ["oppload", *sys.argv[1:]]
        for path in write_benchmark(measured, claim, command=command, settings=settings):
            click.echo(path)
    return ExitCode.INCOMPLETE if clips and clips.faults else ExitCode.DONE
