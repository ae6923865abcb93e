"""Writing many stimuli, several at a time."""

from __future__ import annotations

from contextlib import closing
from functools import partial
from operator import attrgetter
from typing import TYPE_CHECKING

from oppload_cli.environment import cores
from oppload_cli.processes.outcomes import outcomes
from oppload_cli.processes.seldom import Seldom
from oppload_cli.stimulus.files import Written, write

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from oppload_cli.errors import OpploadError
    from oppload_cli.stimulus.protocol import Protocol


def default_jobs(clips: int) -> int:
    """Return how many stimuli to write at a time.

    Parameters
    ----------
    clips : int
        How many there are.

    Returns
    -------
    int
        At most the cores there are; 1 where starting more would take longer.
    """
    return max(1, min(clips // 2, cores()))


def write_all(
    protocols: Sequence[Protocol],
    directory: Path,
    *,
    form: str = "ffv1",
    preview: bool = False,
    jobs: int = 1,
    progress: Callable[[int], object] | None = None,
) -> list[Written | OpploadError]:
    """Write stimuli; one that fails does not stop the others.

    Parameters
    ----------
    protocols : sequence of Protocol
        The stimuli.
    directory : Path
        Where the files go.
    form : str
        A key of :data:`oppload_cli.video.writer.FORMATS`.
    preview : bool
        Whether to write contact sheets too.
    jobs : int
        How many at a time.
    progress : callable or None
        Called with a number of frames done.

    Returns
    -------
    list of Written or OpploadError
        In the order of `protocols`.
    """
    one = partial(_written, directory, form, preview)
    done: dict[int, Written | OpploadError] = {}
    with closing(outcomes(one, protocols, jobs, named=attrgetter("name"), told=progress)) as coming:
        done.update(coming)
    return [done[position] for position in range(len(protocols))]


def _written(
    directory: Path, form: str, preview: bool, protocol: Protocol, tell: Callable[[int], object]
) -> Written:
    count = Seldom(tell)
    made = write(protocol, directory, form=form, preview=preview, progress=count)
    count.flush()
    return made
