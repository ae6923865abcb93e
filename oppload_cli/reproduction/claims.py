"""Statements of the paper, our measurements, the verdicts that follow, and the report on them.

Every figure shows stimuli of the catalogue to the paper's own model, and judges the responses.
"""

from __future__ import annotations

import csv
import importlib
import json
import math
from dataclasses import dataclass, field, replace
from enum import StrEnum
from functools import partial
from io import StringIO
from typing import TYPE_CHECKING, Any

from oppload_cli.environment import environment
from oppload_cli.errors import ParameterError, suggestion
from oppload_cli.files.html import embedded, rendered
from oppload_cli.files.tables import formatted
from oppload_cli.models.presets import STUDY_PRESET
from oppload_cli.models.registry import detector_named
from oppload_cli.pipeline.settings import resolve
from oppload_cli.processes.pool import results
from oppload_cli.stimulus.catalogue import load_all
from oppload_cli.tuning.present import measure, present
from oppload_cli.tuning.run import Condition, faint

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Mapping, Sequence

    from matplotlib.figure import Figure

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
_DPI = 130  # of a figure
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
        Follows from the numbers by the claim's rule.
    numbers : mapping of str to float
        By name.
    faint : str
        Sentences on detectors that hardly respond, from :func:`hardly`; mostly empty.
    """

    text: str
    verdict: Verdict
    numbers: Mapping[str, float] = field(default_factory=dict)
    faint: str = ""

    def as_dict(self) -> dict[str, Any]:
        """Return the finding ready for JSON; NaN and infinite numbers become null."""
        numbers = {
            name: value if math.isfinite(value) else None for name, value in self.numbers.items()
        }
        return {
            "text": f"{self.text} {self.faint}".strip(),
            "verdict": str(self.verdict),
            "hardly_responds": bool(self.faint),
            "numbers": numbers,
        }


@dataclass(frozen=True)
class Claim:
    """One statement of the paper, or our reading of it.

    Attributes
    ----------
    statement : str
        In our own words.
    rule : str
        How the verdict follows from the measurement.
    findings : dict of str to Finding
        By preset, or under `NO_PRESET`.
    source : str
        The paper's own words, and their place; empty for a reading of ours, which it does not say.
    """

    statement: str
    rule: str
    findings: dict[str, Finding]
    source: str = ""


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
    figure : Figure or None
        As drawn; :func:`build` makes the pictures of it, and returns none.
    rows : tuple of dict
        The numbers behind the picture, for its CSV: one observation in a row, by column.
    notes : tuple of str
        Further remarks for the reader.
    settings : dict of str to str
        By preset, the working height and the parameters that differ from the preset's.
    pictures : dict of str to bytes
        By suffix, ``png`` among them.
    """

    name: str
    title: str
    shows: str
    claims: tuple[Claim, ...]
    figure: Figure | None
    rows: tuple[Mapping[str, Any], ...]
    notes: tuple[str, ...] = ()
    settings: dict[str, str] = field(default_factory=dict)
    pictures: dict[str, bytes] = field(default_factory=dict)

    def table(self) -> str:
        """Return the rows as CSV."""
        text = StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(self.rows[0])
        writer.writerows(map(_cell, row.values()) for row in self.rows)
        return text.getvalue()

    def files(self, form: str) -> dict[str, str | bytes]:
        """Return the picture in a format, and the table, by name."""
        return {f"{self.name}.{form}": self.pictures[form], f"{self.name}.csv": self.table()}

    def as_dict(self, form: str = "png") -> dict[str, Any]:
        """Return all but the picture, ready for JSON, with the verdict over all claims."""
        found: dict[str, list[Verdict]] = {}
        for claim in self.claims:
            for preset, finding in claim.findings.items():
                found.setdefault(preset, []).append(finding.verdict)
        return {
            "name": self.name,
            "title": self.title,
            "shows": self.shows,
            "file": f"{self.name}.{form}",
            "table": f"{self.name}.csv",
            "settings": self.settings,
            "command": f"oppload reproduce --only {self.name}",
            "verdicts": {preset: str(_overall(verdicts)) for preset, verdicts in found.items()},
            "claims": [
                {
                    "statement": claim.statement,
                    "source": claim.source,
                    "rule": claim.rule,
                    "measured": {
                        preset: finding.as_dict() for preset, finding in claim.findings.items()
                    },
                }
                for claim in self.claims
            ],
            "notes": list(self.notes),
        }


def _cell(value: Any) -> str:
    """Return a value of a table; unknown and infinite numbers are empty."""
    unknown = isinstance(value, float) and not math.isfinite(value)
    return "" if unknown else formatted(value)


def hardly(
    detector: str, responses: Collection[Responses], settings: Settings, stimuli: str
) -> str:
    """Say whether a detector hardly responds, as ``oppload tune`` judges it.

    Parameters
    ----------
    detector : str
        Its name.
    responses : collection of Responses
        To all stimuli of a measurement.
    settings : Settings
        Under which they were measured.
    stimuli : str
        For the reader, such as ``to the disk``.

    Returns
    -------
    str
        A sentence; empty for a detector that responds.
    """
    measured = [Condition("", {}, {detector: measure(each)}) for each in responses]
    peak = max(map(peak_of, responses))
    return "".join(
        f"{detector_named(detector).label} hardly responds {stimuli} (largest response "
        f"{peak:.3g}, {doubt.note}): the shape of its curve means little."
        for doubt in faint(measured, replace(settings, models=(detector,)))
    )


def described_settings(settings: Settings, assignments: Sequence[str] = ()) -> str:
    """Return the working height and the assignments that :func:`settings_of` took."""
    height = "native size" if settings.height is None else f"{settings.height} px"
    return ", ".join((height, *(assignments if settings.preset != "paper" else ())))


def settings_of(
    preset: str, assignments: Sequence[str] = (), *, height: str | None = None, detector: str = ""
) -> Settings:
    """Return the settings of preset ``reference`` or ``paper``.

    Parameters
    ----------
    preset : str
        Its name.
    assignments : sequence of str
        As for ``--set``; preset ``paper`` takes none, as it is literal.
    height : str, optional
        Working height; else the preset's.
    detector : str
        The only detector to run; OppLoD and D-LGMD if empty.
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

    Returns the responses by the member's name, then by detector.
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
    "inward": ("direction.inward_motion", 15),
    "looming-centre": ("looming.looming_centre", 4),
    "looming-off-centre": ("looming.looming_off_centre", 4),
    "thresholds": ("looming.thresholds", 40),
    "rmo-definition": ("rmo.definition", 1),
    "rmo-stimuli": ("rmo.stimuli", 8),
    "lplc2": ("lplc2.battery", 400),
}
_SCHEMA = "oppload.reproduction/1"
_PAPER = (
    "OppLoD: the Opponency based Looming Detector, Model Extension of Looming Sensitivity from "
    "LGMD to LPLC2"
)
MARKS = {Verdict.HOLDS: "yes", Verdict.IN_PART: "part", Verdict.DOES_NOT: "no"}  # CSS classes


def chosen(names: Collection[str]) -> list[str]:
    """Return the names of the figures to make, in the order of the page; all for no name.

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
    names: Sequence[str],
    *,
    jobs: int = 1,
    form: str = "png",
    done: Callable[[Built], object] | None = None,
) -> list[Built]:
    """Make figures.

    Parameters
    ----------
    names : sequence of str
        From :func:`chosen`.
    jobs : int
        Processes; the result does not depend on it.
    form : str
        ``png``, ``svg`` or ``pdf``: the format of the pictures; the page needs PNG as well.
    done : callable, optional
        Called with each figure once it is made.

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
        for each in built:
            if each.name in names:
                made[each.name] = each
                if done:
                    done(each)

    results(partial(_make, form), ordered, jobs, named=_made_by, progress=take)
    return [made[name] for name in names]


def _make(form: str, maker: str) -> list[Built]:
    """Return what a maker of `FIGURES` makes, with its pictures in place of its figure."""
    module, _, function = maker.partition(".")
    built = getattr(importlib.import_module(f"oppload_cli.reproduction.{module}"), function)()
    style = importlib.import_module("oppload_cli.plots.style")  # loads matplotlib
    made = []
    for each in built if isinstance(built, list) else [built]:
        pictures = {"png": style.image_bytes(each.figure, "png", _DPI)}
        if form not in pictures:
            pictures[form] = style.image_bytes(each.figure, form)
        made.append(replace(each, figure=None, pictures=pictures))
    return made


def _made_by(maker: str) -> str:
    return " and ".join(name for name, (each, _) in FIGURES.items() if each == maker)


def pages_of(figures: Sequence[Built], wall_s: float, form: str) -> tuple[dict[str, str], str]:
    """Return ``report.json`` and ``index.html`` by name, and how often each verdict was given.

    Parameters
    ----------
    figures : sequence of Built
        In the order of the page.
    wall_s : float
        Time that it took to make them, in s.
    form : str
        Format of the pictures.
    """
    report = {
        "schema": _SCHEMA,
        "paper": _PAPER,
        "tool": environment(),
        "wall_s": round(wall_s, 1),
        "figures": [figure.as_dict(form) for figure in figures],
    }
    pictures = {figure.name: figure.pictures["png"] for figure in figures}
    page = rendered(
        "reproduction.html",
        report=report,
        pictures=pictures,
        presets=presets_of(report),
        introduction=introduction(report),
        marks=MARKS,
        tally=tally,
        stated=stated,
        embedded=embedded,
    )
    text = json.dumps(report, indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    return {"report.json": text, "index.html": page}, _verdicts(report)


def presets_of(report: Mapping[str, Any]) -> list[str]:
    """Return the presets of all figures, in their order."""
    verdicts = [figure["verdicts"] for figure in report["figures"]]
    return list(dict.fromkeys(preset for each in verdicts for preset in each))


def introduction(report: Mapping[str, Any]) -> str:
    """Return the first paragraph for a reader, of the page and of the docs alike."""
    return (
        "Every synthetic figure of the OppLoD paper, made by oppload alone. Each statement is in "
        "our words, with the sentence of the paper that it goes by, or marked as our reading where "
        "the paper does not say it. Our measurement follows, and the verdict follows from the "
        "measurement by the rule that is printed with it. Preset 'paper' is the paper to the "
        "letter, preset 'reference' the same model made to work; each figure names the working "
        "height and the parameters that it changes. Where a detector hardly responds (below a "
        "tenth of the floor of its alarm), the shape of its curve means little, and the verdict "
        f"says so. Verdicts: {_verdicts(report)}. The table gives each figure's verdict, and those "
        "of its statements."
    )


def _verdicts(report: Mapping[str, Any]) -> str:
    """Return how often each verdict was given, over all statements and presets."""
    findings = [
        finding
        for figure in report["figures"]
        for claim in figure["claims"]
        for finding in claim["measured"].values()
    ]
    counts = []
    for verdict in Verdict:
        doubted = [each["hardly_responds"] for each in findings if each["verdict"] == verdict]
        note = f" ({sum(doubted)} hardly responding)" * any(doubted)
        counts.append(f"{len(doubted)} '{verdict}'{note}")
    return ", ".join(counts)


def tally(figure: Mapping[str, Any], preset: str) -> str:
    """Return the verdicts of a figure for a preset, e.g. ``3 hold, 1 in part``."""
    judged = [claim["measured"] for claim in figure["claims"] if preset in claim["measured"]]
    given = [measured[preset]["verdict"] for measured in judged]
    held, part, failed = (given.count(verdict) for verdict in Verdict)
    return f"{held} hold" + f", {part} in part" * bool(part) + f", {failed} not" * bool(failed)


def stated(finding: Mapping[str, Any]) -> str:
    """Return the verdict of a finding of a report, for the reader."""
    return f"{finding['verdict']}{', hardly responds' * finding['hardly_responds']}"
