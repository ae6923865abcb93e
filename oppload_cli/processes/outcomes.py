"""What comes of items that several processes do."""

from __future__ import annotations

from contextlib import closing
from functools import partial
from typing import TYPE_CHECKING, TypeVar

from oppload_cli.errors import OpploadError, OutputError
from oppload_cli.processes.events import Kind, ended_from_outside, events

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Sequence

    from oppload_cli.processes.events import Tell

Item = TypeVar("Item")
Result = TypeVar("Result")


def outcomes(
    function: Callable[[Item, Tell], Result],
    items: Sequence[Item],
    jobs: int,
    *,
    named: Callable[[Item], str],
    told: Tell | None = None,
) -> Generator[tuple[int, Result | OpploadError], None, None]:
    """Do items; what is wrong with one does not stop the others.

    Parameters
    ----------
    function : callable
        As for :func:`events`.
    items : sequence
        What is to be done.
    jobs : int
        Processes; with 1, or for 1 item, all is done in this one.
    named : callable
        Gives an item's name, for errors.
    told : callable, optional
        Gets what the function passes on.

    Yields
    ------
    tuple of int and Result or OpploadError
        The item's position, and what came of it; as they are done.

    Raises
    ------
    Exception
        If the function raises anything but an OpploadError: a bug.
    """
    told = told or _nothing
    jobs = min(jobs, len(items))
    if jobs <= 1:
        for position, item in enumerate(items):
            try:
                yield position, function(item, told)
            except OpploadError as error:
                yield position, error
        return
    with closing(events(partial(_numbered, function), enumerate(items), jobs)) as happening:
        for kind, (position, item), content in happening:
            if kind is Kind.TOLD:
                told(content)
            elif kind is Kind.DIED:
                yield (
                    position,
                    OutputError(f"{named(item)}: its process was {ended_from_outside(content)}"),
                )
            elif kind is Kind.DONE or isinstance(content, OpploadError):
                yield position, content
            elif kind is Kind.RAISED:
                raise content


def results(
    function: Callable[[Item], Result],
    items: Sequence[Item],
    jobs: int,
    *,
    named: Callable[[Item], str],
    progress: Callable[[Result], object] | None = None,
) -> list[Result]:
    """Do items, or raise what the first one meets that cannot be done.

    Parameters
    ----------
    function : callable
        Of a module; takes an item, returns a result.
    items : sequence
        What is to be done.
    jobs : int
        Processes; with 1, or for 1 item, all is done in this one.
    named : callable
        Gives an item's name, for errors.
    progress : callable, optional
        Gets each result as it comes.

    Returns
    -------
    list
        In the order of `items`.

    Raises
    ------
    OutputError
        If a process is ended from outside, for instance for want of memory.
    Exception
        Whatever the function raises.
    """
    done: dict[int, Result] = {}
    with closing(outcomes(partial(_silent, function), items, jobs, named=named)) as coming:
        for position, outcome in coming:
            if isinstance(outcome, OpploadError):
                raise outcome
            done[position] = outcome
            if progress:
                progress(outcome)
    return [done[position] for position in range(len(items))]


def _numbered(
    function: Callable[[Item, Tell], Result], numbered: tuple[int, Item], tell: Tell
) -> Result:
    return function(numbered[1], tell)


def _silent(function: Callable[[Item], Result], item: Item, _tell: Tell) -> Result:
    return function(item)


def _nothing(_told: object) -> None:
    pass
