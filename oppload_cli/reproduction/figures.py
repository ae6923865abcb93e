"""The figures by name, in the order of the page, and building them in processes."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

from oppload_cli.errors import ParameterError, suggestion
from oppload_cli.processes.outcomes import results

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from oppload_cli.reproduction.claims import Built

# Figure: the function that makes it (bars makes two), and seconds on one core, so that
# the long ones start first. Modules are imported where they run: they need matplotlib.
FIGURES = {
    "up-down": ("direction.up_and_down", 5),
    "diagonals": ("direction.diagonals", 3),
    "bar-time": ("bars.bar_figures", 30),
    "bar-polar": ("bars.bar_figures", 30),
    "inward": ("inward.inward_motion", 15),
    "looming-centre": ("looming.looming_centre", 4),
    "looming-off-centre": ("looming.looming_off_centre", 4),
    "thresholds": ("thresholds.thresholds", 40),
    "rmo-definition": ("definition.definition", 1),
    "rmo-stimuli": ("opponency.stimuli", 8),
}


def chosen(only: Iterable[str]) -> list[str]:
    """Return the figures to make, in the order of the page.

    Parameters
    ----------
    only : iterable of str
        Their names; none for all.

    Returns
    -------
    list of str

    Raises
    ------
    ParameterError
        If there is no figure of a name.
    """
    names = list(only)
    for name in names:
        if name not in FIGURES:
            raise ParameterError(f"no figure '{name}'{suggestion(name, FIGURES)}")
    return [name for name in FIGURES if name in names or not names]


def build(
    names: Sequence[str], *, jobs: int = 1, progress: Callable[[int], object] | None = None
) -> list[Built]:
    """Make figures.

    Parameters
    ----------
    names : sequence of str
        From :func:`chosen`.
    jobs : int
        Processes; the result does not depend on it.
    progress : callable, optional
        Called with a number of figures done.

    Returns
    -------
    list of Built
        In the order of `names`.

    Raises
    ------
    OutputError
        If a process is ended from outside, for instance for want of memory.
    """
    makers = {FIGURES[name] for name in names}
    ordered = [maker for maker, _ in sorted(makers, key=lambda each: (-each[1], each[0]))]
    made: dict[str, Built] = {}

    def take(built: list[Built]) -> None:
        made.update({each.name: each for each in built if each.name in names})
        if progress:
            progress(sum(each.name in names for each in built))

    results(make, ordered, jobs, named=_made_by, progress=take)
    return [made[name] for name in names]


def _made_by(maker: str) -> str:
    return " and ".join(name for name, (each, _) in FIGURES.items() if each == maker)


def make(maker: str) -> list[Built]:
    """Run one function that makes figures.

    Parameters
    ----------
    maker : str
        ``module.function`` in this package.

    Returns
    -------
    list of Built
    """
    module, _, function = maker.partition(".")
    built = getattr(importlib.import_module(f"oppload_cli.reproduction.{module}"), function)()
    return list(built) if isinstance(built, list) else [built]
