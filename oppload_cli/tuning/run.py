"""Running a sweep: every condition through every model, in one or several processes."""

from __future__ import annotations

import multiprocessing
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from oppload_cli.errors import OpploadError, OutputError
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
        If the system ends a process, for instance for want of memory.
    """
    if min(jobs, len(protocols)) <= 1:
        made = []
        for protocol in protocols:
            made.append(_presented(protocol, settings))
            if progress:
                progress()
        return made
    return _in_processes(protocols, settings, min(jobs, len(protocols)), progress)


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


def _in_processes(
    protocols: Sequence[Protocol],
    settings: Settings,
    jobs: int,
    progress: Callable[[], object] | None,
) -> list[dict[str, Responses]]:
    # Fresh processes: a copy of one that runs OpenCV's threads may hang.
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(jobs, mp_context=context, initializer=_one_thread) as pool:
        futures = [pool.submit(_presented, protocol, settings) for protocol in protocols]
        try:
            for future in as_completed(futures):
                future.result()
                if progress:
                    progress()
        except BrokenProcessPool as error:
            raise OutputError("a process was ended by the system; use fewer --jobs") from error
        finally:
            pool.shutdown(wait=False, cancel_futures=True)
        return [future.result() for future in futures]


def _one_thread() -> None:
    cv2.setNumThreads(1)


def _presented(protocol: Protocol, settings: Settings) -> dict[str, Responses]:
    try:
        return present(protocol, settings)
    except OpploadError as error:
        raise type(error)(f"{protocol.name}: {error}") from error
