"""``oppload demo``."""

from __future__ import annotations

from pathlib import Path

import click

STIMULUS = "opplod2023/looming-disk-centre"
# The paper's units: fields of 200 px on its own frame.
FIELD = ("opplod.receptive_field=200", "opplod.cell=10")


@click.command(short_help="show it at work on a looming disk")
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    default="oppload-demo",
    show_default=True,
    metavar="DIR",
    help="Folder of the stimulus, the results and the plot.",
)
@click.option(
    "--if-exists",
    type=click.Choice(["error", "skip", "overwrite"]),
    default="error",
    show_default=True,
    help="What to do where a result is there already.",
)
def demo(output: Path, if_exists: str) -> None:
    """Render a looming disk, run both detectors on it and plot their responses."""
    from oppload_cli import stimulus  # noqa: PLC0415 - keeps --help fast
    from oppload_cli.outputs import IfExists, Outputs  # noqa: PLC0415
    from oppload_cli.plots.curves import plot_curves  # noqa: PLC0415
    from oppload_cli.plots.style import save  # noqa: PLC0415
    from oppload_cli.results.reading import read_result  # noqa: PLC0415
    from oppload_cli.settings import resolve  # noqa: PLC0415
    from oppload_cli.task import Task, exists_already, run_task  # noqa: PLC0415

    stem = stimulus.file_stem(STIMULUS)
    settings = resolve(height="native", assignments=FIELD)
    outputs = Outputs.of(output, stem, settings.models)
    csv = outputs.csv
    task = Task(
        name=str(output / f"{stem}.avi"),
        settings=settings,
        outputs=outputs,
        if_exists=IfExists(if_exists),
        command=("oppload", "demo"),
    )
    if exists_already(task):
        click.echo(f"{csv} exists: nothing to do")
        return
    video = stimulus.write(stimulus.load(STIMULUS), output).video
    outcome = run_task(task)
    figure, result = csv.with_suffix(".png"), read_result(csv)
    save(plot_curves([result]), figure)
    click.echo(f"{'model':<10}{'first response':>16}{'tenth of peak':>16}{'peak':>12}")
    for name, each in outcome.summaries.items():
        tenth = result.frames[result.frames[f"{name}_response"] >= (each.peak or 0) / 10]
        frames = (each.first_response_frame, tenth["frame"].iloc[0], each.peak_frame)
        click.echo("{:<10}{:>16}{:>16}{:>12}".format(name, *(f"frame {at}" for at in frames)))
    click.echo(f"\n{outcome.frames} frames at {outcome.frames / outcome.wall_s:.0f} frames/s")
    for path in (video, *outputs.paths(), figure):
        click.echo(path)
