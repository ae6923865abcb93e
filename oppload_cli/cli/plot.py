"""``oppload plot``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import click

import oppload_cli as oppload
from oppload_cli.cli import check_display, say, show_file
from oppload_cli.cli.options import check_models
from oppload_cli.errors import ParameterError, ResultError
from oppload_cli.evaluation.manifest import read_manifest
from oppload_cli.models.registry import detector_named
from oppload_cli.results.collecting import tables_in
from oppload_cli.results.reading import is_tuning, read_result
from oppload_cli.results.truths import truth_fault
from oppload_cli.video.inputs import parse_position

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.figure import Figure

    from oppload_cli.results.reading import BaseResult


_CLASSIC_KINDS = ("contact", "position", "ends", "contrast", "habituation")
_TUNING_KINDS = ("polar", "line", "heat", *_CLASSIC_KINDS)


@click.command(short_help="plot results")
@click.argument(
    "results", nargs=-1, required=True, metavar="RESULT...", type=click.Path(path_type=Path)
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
    type=click.Choice(["curves", "rmo", "map", *_TUNING_KINDS]),
    help="Responses or RMO over time, places of the winning units; of a table of 'oppload tune': "
    "polar, line, heat, or the classic figures that 'oppload tune --figure' measures.  "
    "[default: the one that suits the file]",
)
@click.option("--model", "models", multiple=True, metavar="NAME", help="Draw only this detector.")
@click.option(
    "--scale",
    type=click.Choice(["threshold", "peak", "raw"]),
    help="Responses over the alarm's threshold (logarithmic), over the peak, or in their own "
    "unit.  [default: threshold; of tuning: peak]",
)
@click.option(
    "--align",
    type=click.Choice(["contact"]),
    help="Count time from contact, where a ground truth, --contact or --manifest states it.",
)
@click.option("--xlim", nargs=2, type=float, metavar="FROM TO", help="First and last second.")
@click.option("--title", help="Title of the figure.")
@click.option(
    "--label",
    "labels",
    multiple=True,
    metavar="NAME",
    help="Name of a result, once for each, in their order.  [default: what differs]",
)
@click.option("--threshold/--no-threshold", default=True, help="The alarm's threshold in curves.")
@click.option("--onset", metavar="POSITION", help="Mark an onset: 1.5 (s) or f50.")
@click.option("--contact", metavar="POSITION", help="Mark a contact: 2.5 (s) or f80.")
@click.option(
    "--manifest",
    type=click.Path(path_type=Path),
    metavar="FILE.csv",
    help="Mark onsets and contacts of a manifest of 'oppload evaluate'.",
)
@click.option("--any-length", is_flag=True, help="Allow results of different lengths together.")
@click.option("--video", metavar="INPUT", help="For --kind map: the video, where it has moved.")
@click.option(
    "--lplc2",
    type=click.Choice(["auto", "10", "60", "none"]),
    default="auto",
    show_default=True,
    help="For --kind polar: overlay LPLC2 neurons' tuning to a bar of 10 or 60 deg.",
)
@click.option(
    "--published/--no-published",
    default=True,
    help="For --kind contact and ends: numbers of published neurons.",
)
@click.option("--show", is_flag=True, help="Open the figures, where there is a display.")
def plot(
    results: tuple[Path, ...],
    output: Path | None,
    kind: str | None,
    models: tuple[str, ...],
    scale: str | None,
    align: str | None,
    xlim: tuple[float, float] | None,
    title: str | None,
    labels: tuple[str, ...],
    threshold: bool,
    onset: str | None,
    contact: str | None,
    manifest: Path | None,
    any_length: bool,
    video: str | None,
    lplc2: str,
    published: bool,
    show: bool,
) -> None:
    """Plot results over time, or tuning.

    RESULT is a frames.csv of 'oppload run', a tuning.csv of 'oppload tune', or a folder,
    which stands for all results of 'oppload run' in it, to any depth. One
    detector (--model) over several inputs shares one panel; several detectors get a
    panel per input; more than six curves become small multiples, and more than 24
    results a heat map. A NAME.stimulus.json beside a result is drawn as a strip of
    ground truth.
    """
    from oppload_cli.plots import style, tuning

    if output is not None:
        style.check_suffix(output)
    check_models(models, "plot")
    for model in models:
        detector_named(model)
    if show:
        check_display()
    results = tuple(path for each in results for path in tables_in(each))
    marks = _Marks({"onset": onset, "contact": contact}, manifest)
    groups = [(output, results)] if output else [(_beside(path), (path,)) for path in results]
    look: dict[str, Any] = {"title": title, "labels": labels}
    for target, paths in groups:
        tuned = is_tuning(paths[0])
        if tuned and kind and kind not in _TUNING_KINDS:
            raise ResultError(
                f"{paths[0]}: a table of 'oppload tune' has no column 'frame'; "
                f"draw --kind {', '.join(_TUNING_KINDS)}"
            )
        lines: list[str] = []
        if kind in _TUNING_KINDS or tuned:
            tunings = [oppload.read_tuning(path) for path in paths]
            look |= {"models": models, "scale": scale or "peak", "lplc2": lplc2}
            figure, _ = oppload.plot_tuning(tunings, kind, published=published, **look)
            lines = tuning.lines_of(tunings, kind, models=models, lplc2=lplc2, labels=labels)
        else:
            drawn: dict[str, Any] = {
                "models": models,
                "scale": scale or "threshold",
                "align": align,
            }
            drawn |= {"threshold": threshold, "any_length": any_length}
            figure = _plot_results(paths, kind, {**look, "xlim": xlim}, drawn, marks, video=video)
        style.save(figure, target)
        click.echo("\n".join([*lines, str(target)]))
        if show:
            show_file(target)


def _plot_results(
    paths: Sequence[Path],
    kind: str | None,
    look: dict[str, Any],
    curves: dict[str, Any],
    marks: _Marks,
    *,
    video: str | None,
) -> Figure:
    """Draw results of ``oppload run``: `look` is for every kind, `curves` for curves only."""
    from oppload_cli.plots import places, rmo

    needed = {"rmo": rmo.COLUMNS, "map": ("",)}.get(kind or "", ("_alarm", "luma_change"))
    results = [read_result(path, needed) for path in paths]
    for result in results:
        for fault in filter(None, (result.shortfall, truth_fault(result))):
            say(f"oppload: {result.path}: {fault}")
    if kind == "rmo":
        return oppload.plot_rmo(results, **look)[0]
    if kind == "map":
        if len(results) > 1:
            raise ResultError(f"{paths[1]}: a map shows one result; leave out --output")
        models = curves["models"]
        if len(models) > 1:
            raise ParameterError("--kind map shows one detector; give one --model")
        model = models[0] if models else None
        still = places.still_of(results[0], video, model=model)
        figure, _ = oppload.plot_places(results[0], still, title=look["title"], model=model)
        if still is None:
            click.echo(
                f"oppload: {paths[0]}: its video is gone, so the ground is white; --video says "
                "where it is now",
                err=True,
            )
        return figure
    return oppload.plot_curves(results, **look, **curves, marks=marks.of(results))[0]


class _Marks(NamedTuple):
    """Onsets and contacts, as the user states them.

    Attributes
    ----------
    positions : dict of str to str or None
        ``onset`` and ``contact`` of every result, such as ``1.5`` or ``f50``.
    manifest : Path or None
        Of labelled clips.
    """

    positions: dict[str, str | None]
    manifest: Path | None

    def of(self, results: Sequence[BaseResult]) -> dict[str, list[float | None]]:
        """Return the times of each mark, one for each result."""
        marks: dict[str, list[float | None]] = {}
        if self.manifest:
            clips = {each.path.name: each.label for each in read_manifest(self.manifest).entries}
            labels = [clips.get(result.title) for result in results]
            for name in ("onset", "contact"):
                frames = [getattr(label, name, None) for label in labels]
                marks[name] = [
                    None if frame is None else _time_of(result, f"f{frame}", name)
                    for result, frame in zip(results, frames, strict=True)
                ]
        for name, text in self.positions.items():
            if text:
                marks[name] = [_time_of(result, text, name) for result in results]
        return marks


def _time_of(result: BaseResult, text: str, label: str) -> float:
    """Return the time of a position such as 1.5 or f50 in a result."""
    position = parse_position(text)
    if position.seconds is not None:
        return position.seconds
    rows = result.frames.loc[result.frames["frame"] == position.frame, "time_s"]
    if rows.empty:
        raise ParameterError(f"--{label} {text}: column 'frame' of {result.path} never holds it")
    return float(rows.iloc[0])


def _beside(path: Path) -> Path:
    return path.with_name(path.name.removesuffix(".part")).with_suffix(".png")
