"""Statements of the paper, our measurements, the verdicts that follow, and the report on them.

Every figure shows stimuli of the catalogue to the paper's own model, and judges the responses.
The figures have names, and are made in processes.
"""

from __future__ import annotations

import importlib
import json
import math
from dataclasses import dataclass, field
from enum import StrEnum
from typing import TYPE_CHECKING, Any

from oppload_cli.environment import environment
from oppload_cli.errors import ParameterError, suggestion
from oppload_cli.files.html import embedded, rendered
from oppload_cli.models.presets import STUDY_PRESET
from oppload_cli.pipeline.settings import resolve
from oppload_cli.processes.pool import results
from oppload_cli.stimulus.catalogue import load_all
from oppload_cli.tuning.present import present

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Mapping, Sequence

    from oppload_cli.pipeline.settings import Settings
    from oppload_cli.tuning.present import Responses


NO_PRESET = "any preset"
# The presets that are the paper's own model; preset default departs from it.
TITLES = {STUDY_PRESET: "preset reference", "paper": "preset paper (literal)"}
PRESETS = tuple(TITLES)
# Without a pause before the motion: after one, the first moving frames meet no delayed
# inhibition yet, and give a transient that is the same for every direction.
NO_PAUSE = {"timing.before_s": 0}
NO_RESPONSE = "No response to compare."  # in place of a sentence whose numbers are not known
DPI = 130  # of a figure
WIDE = 7.2  # inches, of a figure


class Verdict(StrEnum):
    """Whether a statement holds."""

    HOLDS = "holds"
    IN_PART = "holds in part"
    DOES_NOT = "does not hold"


def at_most(value: float, holds: float, in_part: float) -> Verdict:
    """Judge a measurement that should be small by the limits of the two better verdicts."""
    if value <= holds:
        return Verdict.HOLDS
    return Verdict.IN_PART if value <= in_part else Verdict.DOES_NOT  # as for NaN


def at_least(value: float, holds: float, in_part: float) -> Verdict:
    """Judge a measurement that should be large by the limits of the two better verdicts."""
    return at_most(-value, -holds, -in_part)


def _overall(verdicts: Iterable[Verdict]) -> Verdict:
    """Sum up at least one verdict: all hold, none does, or in part."""
    different = set(verdicts)
    return different.pop() if len(different) == 1 else Verdict.IN_PART


@dataclass(frozen=True)
class Finding:
    """The measurement for one preset.

    Attributes
    ----------
    text : str
        A sentence with the numbers.
    verdict : Verdict
        Computed from the numbers by the claim's rule.
    numbers : dict
        The numbers by name.
    """

    text: str
    verdict: Verdict
    numbers: dict[str, float | None] = field(default_factory=dict)

    def as_dict(self) -> dict[str, Any]:
        """Return the finding ready for JSON; NaN and infinite numbers become null."""
        numbers = {
            name: value if value is not None and math.isfinite(value) else None
            for name, value in self.numbers.items()
        }
        return {"text": self.text, "verdict": str(self.verdict), "numbers": numbers}


@dataclass(frozen=True)
class Claim:
    """One statement of the paper.

    Attributes
    ----------
    statement : str
        In our own words.
    rule : str
        How the verdict follows from the measurement.
    findings : dict of str to Finding
        By preset, or under `NO_PRESET`.
    """

    statement: str
    rule: str
    findings: dict[str, Finding]


@dataclass(frozen=True)
class Built:
    """One figure with its claims.

    Attributes
    ----------
    name : str
        For ``--only``.
    title : str
        For the page.
    shows : str
        The content of the picture.
    claims : tuple of Claim
        At least one.
    png : bytes
        The picture.
    notes : tuple of str
        Further remarks for the reader.
    tables : dict of str to str
        Further files by name: CSV text.
    """

    name: str
    title: str
    shows: str
    claims: tuple[Claim, ...]
    png: bytes
    notes: tuple[str, ...] = ()
    tables: dict[str, str] = field(default_factory=dict)

    def as_dict(self) -> dict[str, Any]:
        """Return all but the picture, ready for JSON, with the verdict over all claims."""
        found: dict[str, list[Verdict]] = {}
        for claim in self.claims:
            for preset, finding in claim.findings.items():
                found.setdefault(preset, []).append(finding.verdict)
        return {
            "name": self.name,
            "title": self.title,
            "shows": self.shows,
            "file": f"{self.name}.png",
            "command": f"oppload reproduce --only {self.name}",
            "verdicts": {preset: str(_overall(verdicts)) for preset, verdicts in found.items()},
            "claims": [
                {
                    "statement": claim.statement,
                    "rule": claim.rule,
                    "measured": {
                        preset: finding.as_dict() for preset, finding in claim.findings.items()
                    },
                }
                for claim in self.claims
            ],
            "notes": list(self.notes),
        }


def settings_of(
    preset: str, assignments: Sequence[str] = (), *, height: str | None = None, detector: str = ""
) -> Settings:
    """Return the settings of a preset.

    Parameters
    ----------
    preset : str
        ``reference`` or ``paper``.
    assignments : sequence of str
        As for ``--set``; for preset ``reference`` only, as ``paper`` is literal.
    height : str, optional
        Working height; else the preset's.
    detector : str
        The only detector to run; both if empty.
    """
    return resolve(
        preset=preset,
        assignments=assignments if preset == STUDY_PRESET else (),
        height=height,
        models=[detector] if detector else (),
    )


def presented(
    name: str, settings: Settings, changes: dict[str, Any] | None = None
) -> dict[str, dict[str, Responses]]:
    """Show all members of a stimulus of the catalogue, some of its values changed.

    Returns
    -------
    dict of str to dict of str to Responses
        By the member's name, then by detector.
    """
    return {each.name: present(each, settings) for each in load_all(name, changes)}


def peak_of(responses: Responses) -> float:
    """Return the largest response, 0 if nothing responded."""
    best = responses.peak
    return 0.0 if best is None else float(responses.response[best])


def plain(value: float) -> str:
    """Return a number in few digits, without an exponent unless it is very small."""
    return f"{value:,.0f}" if abs(value) >= 100 else f"{value:.2g}"


# By figure, in the order of the page: the function that makes it (one makes two figures) and
# its seconds on one core, so that the long ones start first. Modules are imported when they
# run: they need matplotlib.
FIGURES = {
    "up-down": ("direction.up_and_down", 5),
    "diagonals": ("direction.diagonals", 3),
    "bar-time": ("bars.bar_figures", 30),
    "bar-polar": ("bars.bar_figures", 30),
    "inward": ("looming.inward_motion", 15),
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


def chosen(names: Collection[str]) -> list[str]:
    """Return the figures to make, in the order of the page.

    Parameters
    ----------
    names : collection of str
        Of the figures; none for all.

    Raises
    ------
    ParameterError
        If no figure has such a name.
    """
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
