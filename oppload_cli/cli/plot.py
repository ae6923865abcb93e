"""``oppload plot``."""

from __future__ import annotations

import os.path
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click
from click.core import ParameterSource

import oppload_cli as oppload
from oppload_cli.cli import check_display, options, say, show_file
from oppload_cli.errors import (
    ExitCode,
    ParameterError,
    ResultError,
    SourceError,
    counted,
    faults_at,
)
from oppload_cli.evaluation.manifest import Manifest, read_manifest
from oppload_cli.files.atomic import PART
from oppload_cli.models.columns import RMO
from oppload_cli.models.registry import detector_named
from oppload_cli.results.collecting import tables_in
from oppload_cli.results.result_files import BaseResult, find_video, read_result
from oppload_cli.results.truths import truth_fault
from oppload_cli.results.tuning import is_tuning
from oppload_cli.video.span import parse_position

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from matplotlib.figure import Figure

    from oppload_cli.evaluation.metrics.clips import Label


_CLASSIC_KINDS = ("contact", "position", "ends", "contrast", "habituation")
_TUNING_KINDS = ("polar", "line", "heat", *_CLASSIC_KINDS)
# The kinds of plot on which an option has an effect. An option that is not listed affects all.
_EFFECTS = {
    "models": ("curves", "map", *_TUNING_KINDS),
    "labels": ("curves", "rmo", "polar", "line", "contact", "contrast", "habituation"),
    "scale": ("curves", "polar", "line"),
    "xlim": ("curves", "rmo"),
    **dict.fromkeys(
        ("align", "threshold", "onset", "contact", "manifest", "any_length"), ("curves",)
    ),
    "video": ("map",),
    "lplc2": ("polar",),
    "published": ("contact", "ends"),
}


@click.command()
@options.results
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="All results in one figure: .png, .svg or .pdf.  [default: a .png beside each "
    "result; with another --kind than the default, .KIND.png]",
)
@click.option(
    "--kind",
    type=click.Choice(["curves", "rmo", "map", *_TUNING_KINDS]),
    help="curves: responses over time; rmo: RMO over time; map: places of the winning units. The "
    "other kinds draw a table of 'oppload tune', the last five as classic figures (see 'oppload "
    "tune --figure').  [default: the one that suits the file]",
)
@options.models(metavar="NAME", help="Draw only this detector; A,B for several, or given again.")
@click.option(
    "--scale",
    type=click.Choice(["threshold", "peak", "raw"]),
    help="Responses divided by the alarm's threshold (logarithmic), divided by the peak, or in "
    "their own unit.  [default: threshold; of tuning: peak]",
)
@click.option(
    "--align",
    type=click.Choice(["contact"]),
    help="Count time from contact, where a ground truth, --contact or --manifest states it.",
)
@click.option(
    "--xlim", nargs=2, type=float, metavar="FROM TO", help="First and last time, in seconds."
)
@click.option("--title", help="Title of the figure.")
@click.option(
    "--label",
    "labels",
    multiple=True,
    metavar="NAME",
    help="Name of a result, once for each, in their order.  [default: their differences]",
)
@click.option("--threshold/--no-threshold", default=True, help="Draw the alarm's threshold.")
@click.option("--onset", metavar="POSITION", help="Mark an onset: 1.5 (s) or f50.")
@click.option("--contact", metavar="POSITION", help="Mark a contact: 2.5 (s) or f80.")
@click.option(
    "--manifest",
    type=click.Path(path_type=Path),
    metavar="FILE.csv",
    help="Mark onsets and contacts of a manifest of 'oppload evaluate'.",
)
@click.option("--any-length", is_flag=True, help="Let inputs of different lengths share a panel.")
@click.option("--video", metavar="INPUT", help="For --kind map: the video, if it was moved.")
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
    help="For --kind contact and ends: draw published neurons too.",
)
@click.option("--show", is_flag=True, help="Open the figures, where there is a display.")
def plot(
    results: tuple[Path, ...], output: Path | None, kind: str | None, show: bool, **chosen: Any
) -> int:
    """Plot results over time, or tuning.

    RESULT is a frames.csv of 'oppload run', a tuning.csv of 'oppload tune', or a folder,
    which stands for all results of 'oppload run' in it, to any depth. The curves of one
    detector (--model) over several inputs share a panel; with several detectors, each
    input has a panel. More than six curves have small panels, and more than 24 results
    make a heat map. A NAME.stimulus.json beside a result is drawn as a strip of ground
    truth. If one of several results cannot be drawn, a message names it, and the others
    are drawn.
    """
    from oppload_cli.plots import style

    if output is not None:
        style.check_suffix(output)
    chosen["models"] = options.listed_names(chosen["models"])
    options.check_models(chosen["models"], "plot")
    for model in chosen["models"]:
        detector_named(model)  # refuses NAME:PRESET too
    if show:
        check_display()
    paths = [table for _, table in tables_in(results)]
    kinds = {path: _kind_of(path, kind) for path in paths}
    _check_effects({name for name, _ in kinds.values()})
    chosen["manifest"] = _manifest_of(chosen["manifest"])
    groups = _groups(paths, chosen["labels"], output)
    failures: list[ResultError] = []
    for group, labels in groups:
        chosen["labels"] = labels
        of_tuning = kind in _TUNING_KINDS or is_tuning(group[0])
        draw = _draw_tunings if of_tuning else _draw_results
        try:
            figure, lines = draw(group, kind, chosen, failures)
        except ResultError as error:
            if len(groups) == 1:
                raise
            _leave_out(error, failures)
            continue
        target = output or _beside(group[0], *kinds[group[0]])
        remarks = [f"oppload: {remark}" for remark in style.save(figure, target)]
        for line in [*remarks, *lines]:
            say(line)
        click.echo(target)
        if show:
            show_file(target)
    if failures and len(failures) == len(paths):
        return failures[0].exit_code
    return ExitCode.INCOMPLETE if failures else ExitCode.DONE


def _groups(
    paths: Sequence[Path], labels: Sequence[str], output: Path | None
) -> list[tuple[Sequence[Path], Sequence[str]]]:
    """Return the results of each figure, with their labels."""
    if output:
        return [(paths, labels)]
    if len(labels) not in {0, len(paths)}:
        raise ParameterError(
            f"{counted(len(labels), 'label')} for {counted(len(paths), 'figure')}; give one for "
            "each, or none"
        )
    return [([path], labels[at : at + 1]) for at, path in enumerate(paths)]


def _kind_of(path: Path, kind: str | None) -> tuple[str, bool]:
    """Return the kind of plot of a file, and whether it is the file's kind without ``--kind``."""
    from oppload_cli.plots import tuning_plots

    if not is_tuning(path):
        return kind or "curves", kind in {None, "curves"}
    if kind and kind not in _TUNING_KINDS:
        raise ResultError(
            f"{path}: a table of 'oppload tune' has no column 'frame'; "
            f"draw --kind {', '.join(_TUNING_KINDS)}"
        )
    try:
        usual = tuning_plots.kind_of(oppload.read_tuning(path))
    except ResultError:  # drawing the table raises the error again
        usual = kind or ""
    return kind or usual, kind in {None, usual}


def _check_effects(kinds: set[str]) -> None:
    """Raise ParameterError if the user gives an option that has no effect on any of the plots."""
    context = click.get_current_context()
    for option in context.command.params:
        name = option.name or ""
        given = context.get_parameter_source(name) is ParameterSource.COMMANDLINE
        if given and name in _EFFECTS and kinds.isdisjoint(_EFFECTS[name]):
            switched_off = context.params[name] is False
            word = max(option.secondary_opts if switched_off else option.opts, key=len)
            raise ParameterError(
                f"{word} has no effect on --kind {' and '.join(sorted(kinds))}; leave it out"
            )


T = TypeVar("T")


def _readable(
    paths: Sequence[Path],
    labels: Sequence[str],
    read: Callable[[Path], T],
    failures: list[ResultError],
) -> tuple[list[T], Sequence[str]]:
    """Read the files of a figure; return the contents and labels of the readable ones.

    Raises ResultError if no file can be read.
    """
    contents: dict[int, T] = {}
    errors: list[ResultError] = []
    for index, path in enumerate(paths):
        try:
            contents[index] = read(path)
        except ResultError as error:
            errors.append(error)
    if not contents:
        raise errors[0]
    for left_out in errors:
        _leave_out(left_out, failures)
    kept = [labels[index] for index in contents] if len(labels) == len(paths) else labels
    return list(contents.values()), kept


def _leave_out(error: ResultError, failures: list[ResultError]) -> None:
    """Print and keep the error of a result that is not drawn."""
    failures.append(error)
    say(f"oppload: left out: {error}")


def _draw_tunings(
    paths: Sequence[Path], kind: str | None, chosen: dict[str, Any], failures: list[ResultError]
) -> tuple[Figure, list[str]]:
    """Draw tables of ``oppload tune``; return also the lines that describe them."""
    from oppload_cli.plots import tuning_plots

    tunings, labels = _readable(paths, chosen["labels"], oppload.read_tuning, failures)
    look = {"labels": labels, "models": chosen["models"], "lplc2": chosen["lplc2"]}
    figure, _ = oppload.plot_tuning(
        tunings,
        kind,
        scale=chosen["scale"] or "peak",
        published=chosen["published"],
        title=chosen["title"],
        **look,
    )
    return figure, tuning_plots.lines_of(tunings, kind, **look)


def _draw_results(
    paths: Sequence[Path], kind: str | None, chosen: dict[str, Any], failures: list[ResultError]
) -> tuple[Figure, list[str]]:
    """Draw results of ``oppload run``, which no lines of text describe."""
    columns = {"rmo": tuple(column.name for column in RMO), "map": ("",)}
    needed = columns.get(kind or "", ("_alarm", "_threshold"))

    def read(path: Path) -> BaseResult:
        result = read_result(path, needed)
        models = chosen["models"] or result.models
        result.need_responses([name for name in models if name in result.models and kind != "rmo"])
        return result

    results, labels = _readable(paths, chosen["labels"], read, failures)
    for result in results:
        for fault in filter(None, (result.shortfall, truth_fault(result))):
            say(f"oppload: {result.path}: {fault}")
    if kind == "map":
        return _draw_map(results, chosen), []
    look = {"labels": labels, "title": chosen["title"], "xlim": chosen["xlim"]}
    if kind == "rmo":
        return oppload.plot_rmo(results, **look)[0], []
    curves = {name: chosen[name] for name in ("models", "align", "threshold", "any_length")}
    scale, marks = chosen["scale"] or "threshold", _marks(results, chosen)
    return oppload.plot_curves(results, scale=scale, marks=marks, **look, **curves)[0], []


def _draw_map(results: Sequence[BaseResult], chosen: dict[str, Any]) -> Figure:
    from oppload_cli.plots import place_map

    if len(results) > 1:
        raise ResultError(f"{results[1].path}: a map shows one result; leave out --output")
    if len(chosen["models"]) > 1:
        raise ParameterError("--kind map shows one detector; give one --model")
    model = chosen["models"][0] if chosen["models"] else None
    (result,) = results
    still, remark = None, ""
    try:
        video = chosen["video"] or find_video(result)
    except SourceError as error:
        remark = f"the map has no video ({error}), so its background is white"
    else:
        still = place_map.still_of(result, video, model=model)
    figure, _ = oppload.plot_places(result, still, title=chosen["title"], model=model)
    if remark:
        say(f"oppload: {result.path}: {remark}")
    return figure


def _marks(results: Sequence[BaseResult], chosen: dict[str, Any]) -> dict[str, list[float | None]]:
    """Return the times of onsets and contacts, one for each result.

    ``--onset`` and ``--contact`` override ``--manifest``.
    """
    marks: dict[str, list[float | None]] = {}
    manifest: Manifest | None = chosen["manifest"]
    clips = [_clip_of(result, manifest) for result in results] if manifest else []
    for name in ("onset", "contact"):
        text = chosen[name]
        if text:
            marks[name] = [_time_of(result, text, name) for result in results]
        elif manifest:
            frames = [getattr(clip, name, None) for clip in clips]
            marks[name] = [
                None if frame is None else _time_of(result, f"f{frame}", name)
                for result, frame in zip(results, frames, strict=True)
            ]
    pairs = zip(results, marks.get("onset", ()), marks.get("contact", ()), strict=False)
    for result, onset, contact in pairs:
        if onset is not None and contact is not None and onset > contact:
            raise ParameterError(
                f"{result.path}: the onset, {onset:g} s, is after the contact, {contact:g} s; "
                "correct --onset or --contact"
            )
    return marks


def _manifest_of(path: Path | None) -> Manifest | None:
    """Read the manifest, if there is one, and print its faults: their rows mark no result."""
    manifest = read_manifest(path) if path else None
    for fault in manifest.faults if manifest else ():
        say(f"oppload: {fault}")
    return manifest


def _clip_of(result: BaseResult, manifest: Manifest) -> Label | None:
    """Return the label of a result's clip; None if the manifest has no clip of this name.

    If several have this name, the path in the sidecar decides; raises ResultError if none has it.
    """
    clips = [clip for clip in manifest.entries if clip.path.name == result.title]
    if len(clips) > 1:
        stated = str(result.part("input").get("name"))
        paths = {os.path.realpath(path) for path in (stated, result.path.parent / stated)}
        clips = [clip for clip in clips if os.path.realpath(str(clip.path)) in paths]
        if not clips:
            raise ResultError(
                f"{result.path}: several clips of {manifest.path} are named '{result.title}'; "
                "plot it from the folder of its run, or give --onset and --contact"
            )
    return clips[0].label if clips else None


def _time_of(result: BaseResult, text: str, label: str) -> float:
    """Return the time of a position such as 1.5 or f50 in a result."""
    with faults_at(f"--{label}"):
        position = parse_position(text)
    if position.seconds is not None:
        return position.seconds
    rows = result.frames.loc[result.frames["frame"] == position.frame, "time_s"]
    last = result.frames["frame"].max()
    if position.frame is not None and position.frame > last:
        raise ParameterError(
            f"--{label} {text}: {result.path} ends at frame {last:.0f}; give a later time in "
            f"seconds, such as --{label} {result.frames['time_s'].max() + 0.5:.1f}"
        )
    if rows.empty:
        raise ParameterError(f"--{label} {text}: column 'frame' of {result.path} never holds it")
    return float(rows.iloc[0])


def _beside(path: Path, kind: str, usual: bool) -> Path:
    """Return the path of a figure beside its table; an unusual kind is part of the name."""
    plain = path.with_name(path.name.removesuffix(PART))
    return plain.with_suffix(".png" if usual else f".{kind}.png")
