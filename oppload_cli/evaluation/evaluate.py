"""The evaluation of several contenders on the clips of a manifest."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

from oppload_cli.detection.evaluation.intervals import DRAWS, draws_of
from oppload_cli.detection.evaluation.measures import measured, place_figures
from oppload_cli.detection.evaluation.places import FRAME_CENTRE
from oppload_cli.errors import SourceError
from oppload_cli.evaluation.viewing import view
from oppload_cli.processes.outcomes import results

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from oppload_cli.detection.evaluation.measures import Figure, Measured
    from oppload_cli.detection.evaluation.series import Seen
    from oppload_cli.evaluation.contenders import Contender
    from oppload_cli.evaluation.manifest import Entry, Manifest
    from oppload_cli.evaluation.viewing import Viewed


@dataclass(frozen=True)
class Evaluation:
    """What is known once all clips are seen.

    Attributes
    ----------
    manifest : Manifest
        The clips that were named.
    contenders : list of Contender
        Who saw them.
    entries : list of Entry
        The rows that could be used.
    clips : list of Seen
        What was seen of each of them.
    measured : dict of str to Measured
        By contender.
    figures : list of Figure
        All of them, with those of always pointing at the frame's centre.
    faults : list of str
        What was wrong with the manifest and its clips.
    draws : int
        Of the bootstrap.
    """

    manifest: Manifest
    contenders: list[Contender]
    entries: list[Entry]
    clips: list[Seen]
    measured: dict[str, Measured]
    figures: list[Figure]
    faults: list[str]
    draws: int


def evaluate(
    manifest: Manifest,
    contenders: Sequence[Contender],
    *,
    jobs: int = 1,
    draws: int = DRAWS,
    progress: Callable[[], object] | None = None,
) -> Evaluation:
    """Show the clips of a manifest to contenders, and measure them.

    Parameters
    ----------
    manifest : Manifest
        The clips, with their boxes.
    contenders : sequence of Contender
        Who is evaluated.
    jobs : int
        Processes; the result does not depend on it.
    draws : int
        Of the bootstrap.
    progress : callable, optional
        Called after each clip.

    Returns
    -------
    Evaluation

    Raises
    ------
    SourceError
        If no clip can be used.
    OutputError
        If a process is ended from outside, for instance for want of memory.
    """
    faults = list(manifest.faults)
    entries, clips = [], []
    viewed = view_all(manifest.entries, contenders, jobs=jobs, progress=progress)
    for entry, each in zip(manifest.entries, viewed, strict=True):
        faults += [f"{manifest.path}: row {entry.row}: {fault}" for fault in each.faults]
        if each.seen is not None:
            entries.append(entry)
            clips.append(each.seen)
    if not clips:
        reason = f"; {faults[0].removeprefix(f'{manifest.path}: ')}" if faults else ""
        raise SourceError(f"{manifest.path}: names no clip that can be used{reason}")
    weights = draws_of([seen.label.looming for seen in clips], draws)
    found = {each.name: measured(clips, each.name, weights) for each in contenders}
    figures = [figure for each in found.values() for figure in each.figures]
    figures += place_figures(clips, FRAME_CENTRE, weights)
    return Evaluation(manifest, list(contenders), entries, clips, found, figures, faults, draws)


def view_all(
    entries: Sequence[Entry],
    contenders: Sequence[Contender],
    *,
    jobs: int = 1,
    progress: Callable[[], object] | None = None,
) -> list[Viewed]:
    """Show clips to contenders, in one or several processes.

    Parameters
    ----------
    entries : sequence of Entry
        The clips.
    contenders : sequence of Contender
        Who sees them.
    jobs : int
        Processes; the result does not depend on it.
    progress : callable, optional
        Called after each clip.

    Returns
    -------
    list of Viewed
        In the order of `entries`.

    Raises
    ------
    OutputError
        If a process is ended from outside.
    """
    return results(
        partial(view, contenders=contenders, threads=1 if min(jobs, len(entries)) > 1 else 0),
        entries,
        jobs,
        named=lambda entry: entry.label.name,
        progress=lambda _: progress() if progress else None,
    )
