"""``oppload plot``."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from oppload_cli.errors import OutputError, ParameterError, ResultError, suggestion
from oppload_cli.results.columns import MODELS

if TYPE_CHECKING:
    from collections.abc import Sequence

    from oppload_cli.plots.figures import Drawn
    from oppload_cli.results.reading import Result

TUNING_KINDS = ("polar", "line", "heat")  # as in plots.figures, whose import costs matplotlib


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
@click.option(
    "--kind",
    type=click.Choice(["curves", "rmo", "map", *TUNING_KINDS]),
    help="Responses or RMO over time, places of the winning units; of a table of 'oppload tune': "
    "polar, line or heat.  [default: what suits the file]",
)
@click.option("--model", "models", multiple=True, metavar="NAME", help="Draw only this model.")
@click.option("--raw", is_flag=True, help="Responses in their own unit, not over the peak.")
@click.option("--threshold/--no-threshold", default=True, help="The alarm's threshold in curves.")
@click.option("--onset", metavar="POSITION", help="Mark an onset: 1.5 (s) or f50.")
@click.option("--contact", metavar="POSITION", help="Mark a contact: 2.5 (s) or f80.")
@click.option("--any-length", is_flag=True, help="Allow results of different lengths together.")
@click.option("--video", metavar="INPUT", help="For --kind map: the video, where it has moved.")
@click.option(
    "--lplc2",
    type=click.Choice(["auto", "10", "60", "none"]),
    default="auto",
    show_default=True,
    help="For --kind polar: overlay LPLC2 neurons' tuning to a bar of 10 or 60 deg.",
)
@click.option("--show", is_flag=True, help="Open the figures, where there is a display.")
def plot(  # noqa: PLR0917 - click passes them by name
    results: tuple[Path, ...],
    output: Path | None,
    kind: str | None,
    models: tuple[str, ...],
    raw: bool,
    threshold: bool,
    onset: str | None,
    contact: str | None,
    any_length: bool,
    video: str | None,
    lplc2: str,
    show: bool,
) -> None:
    """Plot results over time, or tuning.

    RESULT.csv is a frames.csv of 'oppload run' or a tuning.csv of 'oppload tune'. One
    model (--model) over several inputs shares one panel; several models get a panel
    per input. A NAME.stimulus.json beside a result is drawn as a strip of ground truth.
    """
    from oppload_cli.plots.style import check_suffix, save  # noqa: PLC0415 - keeps --help fast

    if output is not None:
        check_suffix(output)
    for model in models:
        if model not in MODELS:
            raise ParameterError(f"no model '{model}'{suggestion(model, MODELS)}")
    if show:
        _need_display()
    groups = [(output, results)] if output else [(_beside(path), (path,)) for path in results]
    for path, group in groups:
        if _are_tunings(group, kind):
            drawn = _draw_tunings(group, kind, models, raw=raw, lplc2=lplc2)
        else:
            from oppload_cli.plots.curves import CurveOptions  # noqa: PLC0415

            options = CurveOptions(models, raw, threshold, any_length=any_length)
            positions = {"onset": onset, "contact": contact}
            drawn = _draw_results(group, kind or "curves", options, positions, video)
        save(drawn.figure, path)
        for line in drawn.lines:
            click.echo(line)
        click.echo(path)
        if show and click.launch(str(path)):
            raise OutputError(f"{path}: no program shows it; open it yourself, without --show")


def _are_tunings(paths: Sequence[Path], kind: str | None) -> bool:
    from oppload_cli.results.tuning import is_tuning  # noqa: PLC0415

    if kind is None:
        return is_tuning(paths[0])
    if kind not in TUNING_KINDS and is_tuning(paths[0]):
        raise ResultError(
            f"{paths[0]}: a table of 'oppload tune' has no column 'frame'; "
            f"draw --kind {', '.join(TUNING_KINDS)}"
        )
    return kind in TUNING_KINDS


def _draw_tunings(
    paths: Sequence[Path], kind: str | None, models: Sequence[str], *, raw: bool, lplc2: str
) -> Drawn:
    from oppload_cli.plots.figures import draw_tuning  # noqa: PLC0415
    from oppload_cli.results.tuning import read_tuning  # noqa: PLC0415

    return draw_tuning(
        [read_tuning(path) for path in paths], kind, models=models, raw=raw, lplc2=lplc2
    )


def _draw_results(
    paths: Sequence[Path],
    kind: str,
    options: object,
    positions: dict[str, str | None],
    video: str | None,
) -> Drawn:
    from dataclasses import replace  # noqa: PLC0415

    from oppload_cli.plots.curves import CurveOptions, plot_curves  # noqa: PLC0415
    from oppload_cli.plots.figures import Drawn  # noqa: PLC0415
    from oppload_cli.plots.map import plot_map, still_of  # noqa: PLC0415
    from oppload_cli.plots.rmo import plot_rmo  # noqa: PLC0415
    from oppload_cli.results.reading import read_result  # noqa: PLC0415

    read = [read_result(path) for path in paths]
    if kind == "rmo":
        return Drawn(plot_rmo(read))
    if kind == "map":
        if len(read) > 1:
            raise ResultError(f"{paths[1]}: a map shows one result; leave out --output")
        still = still_of(read[0], video)
        figure = plot_map(read[0], still)
        if still is None:
            click.echo(f"{paths[0]}: its video is not there; give --video INPUT", err=True)
        return Drawn(figure)
    if not isinstance(options, CurveOptions):
        raise TypeError(options)
    marks: dict[str, list[float | None]] = {
        label: [_time_of(result, text, label) for result in read]
        for label, text in positions.items()
        if text
    }
    return Drawn(plot_curves(read, replace(options, marks=marks)))


def _time_of(result: Result, text: str, label: str) -> float:
    """Return the time of a position such as 1.5 or f50 in a result."""
    from oppload_cli.video.span import parse_position  # noqa: PLC0415

    position = parse_position(text)
    if position.seconds is not None:
        return position.seconds
    rows = result.frames.loc[result.frames["frame"] == position.frame, "time_s"]
    if rows.empty:
        raise ParameterError(f"--{label} {text}: column 'frame' of {result.path} never holds it")
    return float(rows.iloc[0])


def _need_display() -> None:
    if sys.platform.startswith("linux") and not any(
        os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY")
    ):
        raise ParameterError("--show needs a display, and there is none; open the file elsewhere")


def _beside(path: Path) -> Path:
    return path.with_name(path.name.removesuffix(".part")).with_suffix(".png")
