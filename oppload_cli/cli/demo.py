"""``oppload demo``."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

import oppload_cli as oppload
from oppload_cli import stimulus
from oppload_cli.cli import options
from oppload_cli.cli.progress import outcome_lines
from oppload_cli.files.atomic import refuse_existing
from oppload_cli.files.reading import is_file
from oppload_cli.pipeline.execute import run_task
from oppload_cli.pipeline.settings import resolve
from oppload_cli.pipeline.task import IfExists, Outputs, Task, exists_already
from oppload_cli.plots.style import save
from oppload_cli.video.inputs import GROUND_TRUTH

if TYPE_CHECKING:
    from pathlib import Path

_STIMULUS = "controls/looming-and-translating"


@click.command()
@options.output("oppload-demo", "Folder of the stimulus, the results, the plot and the page.")
@options.if_exists("a result", skip=True)
def demo(output: Path, if_exists: str) -> None:
    """Show the detectors a disk that approaches while another disk passes by.

    The demo renders the stimulus, runs the detectors, and makes a plot and a page. It prints
    the commands that give the same files.
    """
    stem, settings = stimulus.file_stem(_STIMULUS), resolve()
    outputs = Outputs.of(output, stem, settings.models)
    video, figure = output / f"{stem}.avi", outputs.csv.with_suffix(".png")
    task = Task(
        name=str(video),
        stem=stem,
        settings=settings,
        outputs=outputs,
        if_exists=IfExists(if_exists),
        command=("oppload", "run", str(video), "-o", str(output)),
    )
    others = video, output / f"{stem}{GROUND_TRUTH}", figure, output / f"{stem}.report.html"
    if exists_already(task) is not None and all(map(is_file, others)):
        click.echo(f"{outputs.csv} exists: nothing to do")
        return
    refuse_existing(others, if_exists)
    protocol = stimulus.load(_STIMULUS)
    contact_s = stimulus.ground_truth(protocol)["contact_time_s"]
    stimulus.write(protocol, output)
    click.echo(f"{protocol.description}; contact at {contact_s:.2f} s")
    click.echo(f"$ oppload run {video} -o {output}")
    for line in outcome_lines(task, run_task(task)):
        click.echo(line)
    result = oppload.read_result(outputs.csv)
    save(result.plot()[0], figure)
    click.echo(f"$ oppload plot {outputs.csv}\n  {figure}")
    click.echo(f"$ oppload report {outputs.csv}\n  {result.report(output)}")
