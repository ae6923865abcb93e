"""Running a sweep: every condition through every model, in one or several processes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from operator import attrgetter
from typing import TYPE_CHECKING, Any

import numpy as np

from oppload_cli.errors import OpploadError
from oppload_cli.processes.outcomes import results
from oppload_cli.results.directions import direction_of
from oppload_cli.stimulus.renderer import Renderer
from oppload_cli.tuning.measure import Measures, measure
from oppload_cli.tuning.present import present

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from oppload_cli.settings import Settings
    from oppload_cli.stimulus.catalogue import Entry
    from oppload_cli.stimulus.protocol import Protocol
    from oppload_cli.tuning.present import Responses


@dataclass(frozen=True)
class Condition:
    """One stimulus of a sweep, and what was measured of it.

    Attributes
    ----------
    stimulus : str
        Its name.
    values : dict
        Swept values by dotted key.
    measures : dict of str to Measures
        By model.
    """

    stimulus: str
    values: dict[str, Any]
    measures: dict[str, Measures]


def tune(
    entry: Entry,
    settings: Settings,
    *,
    jobs: int = 1,
    progress: Callable[[], object] | None = None,
) -> list[Condition]:
    """Measure every condition of a sweep.

    Parameters
    ----------
    entry : Entry
        The stimulus with its sweep, from :func:`oppload_cli.tuning.sweep.swept`.
    settings : Settings
        Models, their parameters and the working height.
    jobs : int
        Processes; the result does not depend on it.
    progress : callable, optional
        Called after each condition.

    Returns
    -------
    list of Condition
        In the order of the sweep.

    Raises
    ------
    StimulusError
        If a value makes a stimulus that is not valid.
    ParameterError
        If the working size is too large.
    """
    shown = present_all(entry.protocols(), settings, jobs=jobs, progress=progress)
    return [
        Condition(name, values, {model: measure(each) for model, each in responses.items()})
        for (name, values), responses in zip(entry.values().items(), shown, strict=True)
    ]


def present_all(
    protocols: Sequence[Protocol],
    settings: Settings,
    *,
    jobs: int = 1,
    progress: Callable[[], object] | None = None,
) -> list[dict[str, Responses]]:
    """Show several stimuli to the models.

    Parameters
    ----------
    protocols : sequence of Protocol
        The stimuli.
    settings : Settings
        Models, their parameters and the working height.
    jobs : int
        Processes; the result does not depend on it.
    progress : callable, optional
        Called after each stimulus.

    Returns
    -------
    list of dict of str to Responses
        In the order of `protocols`, by model.

    Raises
    ------
    OutputError
        If a process is ended from outside, for instance for want of memory.
    """
    return results(
        partial(_presented, settings),
        protocols,
        jobs,
        named=attrgetter("name"),
        progress=lambda _: progress() if progress else None,
    )


def is_symmetric(entry: Entry) -> bool:
    """Tell whether half a turn of the swept direction gives the same stimulus.

    Then a half circle of directions is the whole tuning: a bar of which both ends
    grow. Decided by two pictures of the clip, not by the name of the key.

    Parameters
    ----------
    entry : Entry
        With its sweep.

    Returns
    -------
    bool
        False where no direction is swept.
    """
    direction = direction_of(list(entry.sweep))
    if direction is None:
        return False
    first = next(iter(entry.sweep[direction]))
    here, turned = (
        entry.with_settings({direction: angle}).protocols()[0] for angle in (first, first + 180)
    )
    one, other = Renderer(here), Renderer(turned)
    # A pixel on the edge may be rounded to the next grey level.
    return all(
        int(np.abs(one.grey(at).astype(int) - other.grey(at).astype(int)).max()) <= 2
        for at in (here.frame_count // 3, 2 * here.frame_count // 3)
    )


def _presented(settings: Settings, protocol: Protocol) -> dict[str, Responses]:
    try:
        return present(protocol, settings)
    except OpploadError as error:
        raise type(error)(f"{protocol.name}: {error}") from error
