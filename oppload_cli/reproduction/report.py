"""The figures by name, making them in processes, and the report on them."""

from __future__ import annotations

import importlib
import json
from typing import TYPE_CHECKING, Any

from oppload_cli.environment import environment
from oppload_cli.errors import ParameterError, suggestion
from oppload_cli.files.html import embedded, rendered
from oppload_cli.processes.pool import results
from oppload_cli.reproduction.claims import Verdict

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

    from oppload_cli.reproduction.claims import Built


# By figure, in the order of the page: the function that makes it (one makes two figures) and
# its seconds on one core, so that the long ones start first. Modules are imported when they
# run: they need matplotlib.
FIGURES = {
    "up-down": ("direction.up_and_down", 5),
    "diagonals": ("direction.diagonals", 3),
    "bar-time": ("bars.bar_figures", 30),
    "bar-polar": ("bars.bar_figures", 30),
    "inward": ("inward.inward_motion", 15),
    "looming-centre": ("looming.looming_centre", 4),
    "looming-off-centre": ("looming.looming_off_centre", 4),
    "thresholds": ("thresholds.thresholds", 40),
    "rmo-definition": ("rmo.definition", 1),
    "rmo-stimuli": ("rmo.stimuli", 8),
    "lplc2": ("lplc2.battery", 400),
}
TABLES = {"lplc2": ("lplc2.csv",)}  # further files of a figure
_SCHEMA = "oppload.reproduction/1"
_PAPER = (
    "OppLoD: the Opponency based Looming Detector, Model Extension of Looming Sensitivity from "
    "LGMD to LPLC2"
)
MARKS = {Verdict.HOLDS: "yes", Verdict.IN_PART: "part", Verdict.DOES_NOT: "no"}  # CSS classes


def chosen(only: Iterable[str]) -> list[str]:
    """Return the figures to make, in the order of the page.

    Parameters
    ----------
    only : iterable of str
        Their names; none for all.

    Raises
    ------
    ParameterError
        If no figure has such a name.
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
        Called with the number of figures that were just made.

    Returns
    -------
    list of Built
        In the order of `names`.

    Raises
    ------
    OutputError
        If a process is ended from outside, for instance because memory ran out.
    """
    makers = {FIGURES[name] for name in names}
    ordered = [maker for maker, _ in sorted(makers, key=lambda each: (-each[1], each[0]))]
    made: dict[str, Built] = {}

    def take(built: list[Built]) -> None:
        wanted = {each.name: each for each in built if each.name in names}
        made.update(wanted)
        if progress:
            progress(len(wanted))

    results(_make, ordered, jobs, named=_made_by, progress=take)
    return [made[name] for name in names]


def _make(maker: str) -> list[Built]:
    module, _, function = maker.partition(".")
    built = getattr(importlib.import_module(f"oppload_cli.reproduction.{module}"), function)()
    return list(built) if isinstance(built, list) else [built]


def _made_by(maker: str) -> str:
    return " and ".join(name for name, (each, _) in FIGURES.items() if each == maker)


def files_of(figures: Sequence[Built], wall_s: float) -> tuple[dict[str, str | bytes], str]:
    """Return the files of a reproduction.

    Parameters
    ----------
    figures : sequence of Built
        In the order of the page.
    wall_s : float
        How long making them took, in seconds.

    Returns
    -------
    files : dict of str to str or bytes
        By name: pictures, tables, ``report.json`` and ``index.html``.
    verdicts : str
        How often each verdict was given.
    """
    report = {
        "schema": _SCHEMA,
        "paper": _PAPER,
        "tool": environment(),
        "wall_s": round(wall_s, 1),
        "figures": [figure.as_dict() for figure in figures],
    }
    pictures = {figure.name: figure.png for figure in figures}
    files: dict[str, str | bytes] = {f"{name}.png": png for name, png in pictures.items()}
    for figure in figures:
        files.update(figure.tables)
    files["report.json"] = json.dumps(report, indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    files["index.html"] = rendered(
        "reproduction.html",
        report=report,
        pictures=pictures,
        presets=presets_of(report),
        introduction=introduction(report),
        marks=MARKS,
        tally=tally,
        embedded=embedded,
    )
    return files, _verdicts(report)


def presets_of(report: Mapping[str, Any]) -> list[str]:
    """Return the presets of all figures, in their order."""
    verdicts = [figure["verdicts"] for figure in report["figures"]]
    return list(dict.fromkeys(preset for each in verdicts for preset in each))


def introduction(report: Mapping[str, Any]) -> str:
    """Return the first paragraph for a reader, of the page and of the docs alike."""
    return (
        "Every synthetic figure of the OppLoD paper, made by oppload alone. Each statement of "
        "the paper, in our words, is followed by our measurement; the verdict follows from the "
        "measurement by the rule that is printed with it. Preset 'paper' is the paper to the "
        "letter, preset 'reference' the same model made to work. Verdicts: "
        f"{_verdicts(report)}. The table gives each figure's verdict, and how many of its "
        "statements hold."
    )


def _verdicts(report: Mapping[str, Any]) -> str:
    """Return how often each verdict was given, over all statements and presets."""
    counts = dict.fromkeys(map(str, Verdict), 0)
    for figure in report["figures"]:
        for claim in figure["claims"]:
            for finding in claim["measured"].values():
                counts[finding["verdict"]] += 1
    return ", ".join(f"{count} '{verdict}'" for verdict, count in counts.items())


def tally(figure: Mapping[str, Any], preset: str) -> str:
    """Return how many statements of a figure hold for a preset, e.g. ``2 of 4``."""
    judged = [claim["measured"] for claim in figure["claims"] if preset in claim["measured"]]
    held = sum(measured[preset]["verdict"] == Verdict.HOLDS for measured in judged)
    return f"{held} of {len(judged)}"
