"""``oppload plot``."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import click
from click.core import ParameterSource

import oppload_cli as oppload
from oppload_cli.cli import check_display, say, show_file
from oppload_cli.cli.options import check_models, names_in
from oppload_cli.errors import ExitCode, ParameterError, ResultError
from oppload_cli.evaluation.manifest import read_manifest
from oppload_cli.models.registry import detector_named
from oppload_cli.results.collecting import tables_in
from oppload_cli.results.reading import is_tuning, read_result
from oppload_cli.results.truths import truth_fault
from oppload_cli.video.inputs import parse_position

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from matplotlib.figure import Figure

    from oppload_cli.results.reading import BaseResult


_CLASSIC_KINDS = ("contact", "position", "ends", "contrast", "habituation")
_TUNING_KINDS = ("polar", "line", "heat", *_CLASSIC_KINDS)
# By option: the kinds of plot that take notice of it; the others of all kinds.
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


@click.command(short_help="plot results")
@click.argument(
    "results", nargs=-1, required=True, metavar="RESULT...", type=click.Path(path_type=Path)
)
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="All results in one figure: .png, .svg or .pdf.  [default: a .png beside each "
    "result; that of an unusual kind ends in .KIND.png]",
)
@click.option(
    "--kind",
    type=click.Choice(["curves", "rmo", "map", *_TUNING_KINDS]),
    help="Responses or RMO over time, places of the winning units; of a table of 'oppload tune': "
    "polar, line, heat, or the classic figures that 'oppload tune --figure' measures.  "
    "[default: the one that suits the file]",
)
@click.option(
    "--model",
    "models",
    multiple=True,
    metavar="NAME",
    help="Draw only this detector; A,B for several, or given again.",
)
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
) -> int:
    """Plot results over time, or tuning.

    RESULT is a frames.csv of 'oppload run', a tuning.csv of 'oppload tune', or a folder,
    which stands for all results of 'oppload run' in it, to any depth. One
    detector (--model) over several inputs shares one panel; several detectors get a
    panel per input; more than six curves become small multiples, and more than 24
    results a heat map. A NAME.stimulus.json beside a result is drawn as a strip of
    ground truth. One of several results that cannot be drawn is left out, and named.
    """
    from oppload_cli.plots import style, tuning

    if output is not None:
        style.check_suffix(output)
    models = tuple(names_in(models))
    check_models(models, "plot")
    for model in models:
        detector_named(model)
    if show:
        check_display()
    results = tuple(table for _, table in tables_in(results))
    kinds = {path: _kind_of(path, kind) for path in results}
    _check_effects(set(kinds.values()))
    marks = _Marks({"onset": onset, "contact": contact}, manifest)
    groups = [(output, results)] if output else [(None, (path,)) for path in results]
    failures: list[ResultError] = []
    for target, paths in groups:
        look: dict[str, Any] = {"title": title}
        lines: list[str] = []
        try:
            if kind in _TUNING_KINDS or is_tuning(paths[0]):
                tunings, look["labels"] = _readable(paths, labels, oppload.read_tuning, failures)
                look |= {"models": models, "lplc2": lplc2}
                figure, _ = oppload.plot_tuning(
                    tunings, kind, scale=scale or "peak", published=published, **look
                )
                del look["title"]
                lines = tuning.lines_of(tunings, kind, **look)
            else:
                read = partial(_read_result, kind=kind, models=models)
                found, look["labels"] = _readable(paths, labels, read, failures)
                curves: dict[str, Any] = {"models": models, "scale": scale or "threshold"}
                curves |= {"align": align, "threshold": threshold, "any_length": any_length}
                look["xlim"] = xlim
                figure = _plot_results(found, kind, look, curves, marks, video=video)
        except ResultError as error:
            if len(groups) == 1:
                raise
            _leave_out(error, failures)
            continue
        made = target or _beside(paths[0], kinds[paths[0]])
        style.save(figure, made)
        click.echo("\n".join([*lines, str(made)]))
        if show:
            show_file(made)
    if failures and len(failures) == len(results):
        return failures[0].exit_code
    return ExitCode.INCOMPLETE if failures else ExitCode.DONE


def _kind_of(path: Path, kind: str | None) -> tuple[str, bool]:
    """Return the kind of plot of a file, and whether it is the one that suits it without --kind."""
    from oppload_cli.plots import tuning

    if not is_tuning(path):
        return kind or "curves", kind in {None, "curves"}
    if kind and kind not in _TUNING_KINDS:
        raise ResultError(
            f"{path}: a table of 'oppload tune' has no column 'frame'; "
            f"draw --kind {', '.join(_TUNING_KINDS)}"
        )
    try:
        own = tuning.kind_of(oppload.read_tuning(path))
    except ResultError:  # which is reported as the table is drawn
        own = kind or ""
    return kind or own, kind in {None, own}


def _check_effects(kinds: set[tuple[str, bool]]) -> None:
    """Refuse an option that none of some kinds of plot takes notice of."""
    shown = {kind for kind, _ in kinds}
    context = click.get_current_context()
    for option in context.command.params:
        name = option.name or ""
        given = context.get_parameter_source(name) is ParameterSource.COMMANDLINE
        if given and name in _EFFECTS and shown and shown.isdisjoint(_EFFECTS[name]):
            word = max((*option.opts, *option.secondary_opts), key=len)
            word = max(option.opts, key=len) if context.params[name] is not False else word
            raise ParameterError(
                f"{word} has no effect on --kind {' and '.join(sorted(shown))}; leave it out"
            )


T = TypeVar("T")


def _readable(
    paths: Sequence[Path],
    labels: Sequence[str],
    read: Callable[[Path], T],
    failures: list[ResultError],
) -> tuple[list[T], Sequence[str]]:
    """Read the files of a figure and keep their labels; of several, one that fails is left out."""
    found: dict[int, T] = {}
    bad: list[ResultError] = []
    for at, path in enumerate(paths):
        try:
            found[at] = read(path)
        except ResultError as error:
            bad.append(error)
    if not found:
        raise bad[0]
    for each in bad:
        _leave_out(each, failures)
    kept = [labels[at] for at in found] if len(labels) == len(paths) else labels
    return list(found.values()), kept


def _leave_out(error: ResultError, failures: list[ResultError]) -> None:
    """Tell of a result that is not drawn, and count it."""
    failures.append(error)
    say(f"oppload: left out: {error}")


def _read_result(path: Path, kind: str | None, models: Sequence[str]) -> BaseResult:
    """Read a result of ``oppload run`` with the columns that a kind of plot needs."""
    from oppload_cli.plots import rmo

    needed = {"rmo": rmo.COLUMNS, "map": ("",)}.get(kind or "", ("_alarm", "luma_change"))
    return read_result(path, needed, () if kind == "rmo" else models or None)


def _plot_results(
    results: Sequence[BaseResult],
    kind: str | None,
    look: dict[str, Any],
    curves: dict[str, Any],
    marks: _Marks,
    *,
    video: str | None,
) -> Figure:
    """Draw results of ``oppload run``: `look` is for every kind, `curves` for curves only."""
    from oppload_cli.plots import places

    for result in results:
        for fault in filter(None, (result.shortfall, truth_fault(result))):
            say(f"oppload: {result.path}: {fault}")
    if kind == "rmo":
        return oppload.plot_rmo(results, **look)[0]
    if kind == "map":
        if len(results) > 1:
            raise ResultError(f"{results[1].path}: a map shows one result; leave out --output")
        models = curves["models"]
        if len(models) > 1:
            raise ParameterError("--kind map shows one detector; give one --model")
        model = models[0] if models else None
        still = places.still_of(results[0], video, model=model)
        figure, _ = oppload.plot_places(results[0], still, title=look["title"], model=model)
        if still is None:
            why = f"{results[0].path}: {places.why_no_still(results[0])}"
            say(f"oppload: {why}, so the ground is white; --video says where it is")
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
    last = result.frames["frame"].max()
    if position.frame is not None and position.frame > last:
        raise ParameterError(
            f"--{label} {text}: {result.path} ends at frame {last:.0f}; give a later time in "
            f"seconds, such as --{label} {result.frames['time_s'].max() + 0.5:.1f}"
        )
    if rows.empty:
        raise ParameterError(f"--{label} {text}: column 'frame' of {result.path} never holds it")
    return float(rows.iloc[0])


def _beside(path: Path, kind: tuple[str, bool]) -> Path:
    """Return the name of a figure beside its table; that of an unusual kind says the kind."""
    name, usual = kind
    plain = path.with_name(path.name.removesuffix(".part"))
    return plain.with_suffix(".png" if usual else f".{name}.png")
