"""``oppload evaluate``."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

import click

from oppload_cli.cli import on_terminal, say
from oppload_cli.errors import ExitCode, OutputError

if TYPE_CHECKING:
    from oppload_cli.evaluation.contenders import Contender
    from oppload_cli.evaluation.evaluate import Evaluation
    from oppload_cli.evaluation.manifest import Manifest


@click.command(short_help="labelled clips: detection, lead time, false alarms")
@click.argument("manifest", type=click.Path(path_type=Path), metavar="MANIFEST.csv")
@click.option(
    "--models",
    multiple=True,
    metavar="NAME[,NAME...]",
    help="What to evaluate beside the baselines: opplod:PRESET, such as opplod:paper.  "
    "[default: opplod:default, and opplod:robust where there is one]",
)
@click.option(
    "--boxes",
    type=click.Path(path_type=Path),
    metavar="FILE.json",
    help="Boxes of the looming objects.  [default: boxes.json beside MANIFEST.csv]",
)
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    default=Path("evaluation"),
    metavar="DIR",
    show_default=True,
    help="Folder of the results.",
)
@click.option("-j", "--jobs", type=click.IntRange(1, 64), help="Processes.  [default: the cores]")
@click.option(
    "--draws",
    type=click.IntRange(100, 100_000),
    default=1000,
    show_default=True,
    help="Draws of the bootstrap that gives the intervals.",
)
@click.option(
    "--if-exists",
    type=click.Choice(["error", "overwrite"]),
    default="error",
    show_default=True,
    help="What to do where results are there already.",
)
@click.option("-q", "--quiet", is_flag=True, help="No progress bar.")
def evaluate(  # noqa: PLR0917 - click passes them by name
    manifest: Path,
    models: tuple[str, ...],
    boxes: Path | None,
    output: Path,
    jobs: int | None,
    draws: int,
    if_exists: str,
    quiet: bool,
) -> int:
    """Measure how often the detectors are right on labelled clips.

    MANIFEST.csv has a row per clip: file,label,onset_frame,contact_frame, with the label
    'looming' or 'none'. OppLoD stands beside D-LGMD, the divergence of optical flow and
    the mean change of luminance. DIR gets evaluation.html, one page with all of it,
    report.json, the figures, responses and windows as CSV, and the plots.
    """
    from oppload_cli.evaluation.boxes import with_boxes  # noqa: PLC0415 - keeps --help fast
    from oppload_cli.evaluation.contenders import contenders  # noqa: PLC0415
    from oppload_cli.evaluation.manifest import read_manifest  # noqa: PLC0415
    from oppload_cli.evaluation.output import FILES  # noqa: PLC0415

    chosen = contenders(name for text in models for name in text.split(","))
    read = with_boxes(read_manifest(manifest), boxes)
    there = [output / name for name in FILES if (output / name).exists()]
    if there and if_exists == "error":
        raise OutputError(f"{there[0]}: exists already; use --if-exists overwrite or another -o")
    started = time.perf_counter()
    found = _evaluated(read, chosen, output, jobs=jobs, draws=draws, quiet=quiet)
    _write(found, output, started)
    return ExitCode.INCOMPLETE if found.faults else ExitCode.DONE


def _evaluated(
    manifest: Manifest,
    chosen: list[Contender],
    output: Path,
    *,
    jobs: int | None,
    draws: int,
    quiet: bool,
) -> Evaluation:
    from tqdm import tqdm  # noqa: PLC0415

    from oppload_cli.environment import cores  # noqa: PLC0415
    from oppload_cli.evaluation.evaluate import evaluate  # noqa: PLC0415
    from oppload_cli.video.atomic import part_of, remove, write_atomic  # noqa: PLC0415

    # A folder that cannot be written shall be known before minutes of work.
    write_atomic(part_of(output / "report.json"), [])
    remove(part_of(output / "report.json"))
    for fault in manifest.faults:
        say(f"oppload: {fault}")
    hidden = quiet or not on_terminal()
    total = len(manifest.entries)
    with tqdm(total=total, unit="clip", disable=hidden, file=sys.stderr) as bar:
        found = evaluate(manifest, chosen, jobs=jobs or cores(), draws=draws, progress=bar.update)
    for fault in found.faults[len(manifest.faults) :]:
        say(f"oppload: {fault}")
    return found


def _write(found: Evaluation, output: Path, started: float) -> None:
    from oppload_cli.evaluation.output import write_evaluation  # noqa: PLC0415

    for path in write_evaluation(found, output, lambda: time.perf_counter() - started):
        click.echo(path)
