"""Statements of the paper, our measurements and verdicts, and the report on them.

Each figure shows stimuli of the catalogue to the paper's own model, and judges the responses.
"""

from __future__ import annotations

import importlib
import json
import math
import tomllib
from dataclasses import dataclass, field, replace
from enum import StrEnum
from functools import partial
from importlib import resources
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from oppload_cli.environment import environment
from oppload_cli.errors import ParameterError, suggestion
from oppload_cli.files.html import embedded, rendered
from oppload_cli.files.tables import csv_text, finite_text
from oppload_cli.models.registry import detector_named, parameters_of
from oppload_cli.models.timebase import TimeParams
from oppload_cli.pipeline.settings import Settings, resolve
from oppload_cli.processes.pool import results
from oppload_cli.stimulus.catalogue import load_all
from oppload_cli.tuning.measuring import faint
from oppload_cli.tuning.present import Responses, present

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Mapping, Sequence

    from matplotlib.figure import Figure


# The detectors with the paper's own model, made to work and to the letter.
REFERENCE, PAPER = PAPER_DETECTORS = "opplod_reference", "opplod_paper"
NO_DETECTOR = "no detector"  # in place of a detector's name, for a measurement of RMO
# No pause before the motion: after a pause, the first moving frames have no delayed inhibition,
# and the same transient response follows for every direction.
NO_PAUSE = {"timing.before_s": 0}
NO_RESPONSE = "No response to compare."  # replaces a sentence if its numbers are not known
_DPI = 130  # of a figure as PNG
WIDE = 7.2  # width of a figure in inches
_TEXTS = tomllib.loads(
    resources.files(__package__).joinpath("statements.toml").read_text(encoding="utf-8")
)


class ClaimVerdict(StrEnum):
    """Whether a statement holds."""

    HOLDS = "holds"
    IN_PART = "holds in part"
    DOES_NOT = "does not hold"

    @classmethod
    def at_most(cls, value: float, holds: float, in_part: float) -> ClaimVerdict:
        """Return the verdict on a value that should be small, by the largest value for each."""
        if value <= holds:
            return cls.HOLDS
        return cls.IN_PART if value <= in_part else cls.DOES_NOT  # also for NaN

    @classmethod
    def at_least(cls, value: float, holds: float, in_part: float) -> ClaimVerdict:
        """Return the verdict on a value that should be large, by the least value for each."""
        return cls.at_most(-value, -holds, -in_part)


@dataclass(frozen=True)
class Finding:
    """The measurement of one detector, with its verdict by the rule of the claim."""

    text: str  # a sentence with the numbers
    verdict: ClaimVerdict
    numbers: Mapping[str, float] = field(default_factory=dict)
    faint: str = ""  # sentences of :func:`faint_note` on detectors that hardly respond

    def as_dict(self) -> dict[str, Any]:
        """Return the finding ready for JSON; NaN and infinite numbers become null."""
        numbers = self.numbers.items()
        return {
            "text": f"{self.text} {self.faint}".strip(),
            "verdict": str(self.verdict),
            "hardly_responds": bool(self.faint),
            "numbers": {name: value if math.isfinite(value) else None for name, value in numbers},
        }


@dataclass(frozen=True)
class Claim:
    """One statement of the paper, or our reading of the paper, in our own words."""

    statement: str
    rule: str  # how the verdict follows from the measurement
    findings: dict[str, Finding]  # by detector, or one under `NO_DETECTOR`
    source: str = ""  # the paper's own words and their place; empty for our reading

    @classmethod
    def of(cls, name: str, findings: dict[str, Finding], **values: object) -> Claim:
        """Return a claim with the texts of ``statements.toml``, filled in with values."""
        texts = {key: text.format(**values) for key, text in _TEXTS["claims"][name].items()}
        return cls(findings=findings, **texts)


@dataclass(frozen=True)
class Built:
    """One figure with its claims."""

    name: str  # for ``--only``
    title: str  # on the page
    shows: str  # a sentence on the content of the figure
    claims: tuple[Claim, ...]
    figure: Figure | None  # None after :func:`build` made `pictures` of it
    rows: tuple[Mapping[str, Any], ...]  # of the CSV file: an observation per row, by column
    notes: tuple[str, ...] = ()
    # By detector, the working height and the changed parameters.
    settings: dict[str, str] = field(default_factory=dict)
    pictures: dict[str, bytes] = field(default_factory=dict)  # files by suffix

    @classmethod
    def of(
        cls,
        name: str,
        claims: Iterable[Claim],
        figure: Figure,
        rows: Iterable[Mapping[str, Any]],
        *,
        settings: dict[str, str] | None = None,
        notes: Iterable[str] = (),
        shared: str = "",
        **values: object,
    ) -> Built:
        """Return a figure with the texts of ``statements.toml``, filled in with values.

        The texts under the name `shared` come before those under the own name, and `notes` after
        them.
        """
        texts = [_TEXTS["figures"].get(part, {}) for part in (shared, name)]
        written = [note.format(**values) for part in texts for note in part.get("notes", ())]
        joined = texts[0] | texts[1]
        return cls(
            name,
            joined["title"],
            joined["shows"],
            tuple(claims),
            figure,
            tuple(rows),
            (*written, *notes),
            settings or {},
        )

    def table(self) -> str:
        """Return the rows as CSV."""
        return csv_text(self.rows, self.rows[0], finite_text)

    def files(self, form: str) -> dict[str, str | bytes]:
        """Return the figure in a format, and its table, by file name."""
        return {f"{self.name}.{form}": self.pictures[form], f"{self.name}.csv": self.table()}

    def as_dict(self, form: str = "png") -> dict[str, Any]:
        """Return all but the figure, ready for JSON, with the common verdict of all claims.

        The common verdict is "in part" if the verdicts differ.
        """
        verdicts: dict[str, set[ClaimVerdict]] = {}
        for claim in self.claims:
            for detector, finding in claim.findings.items():
                verdicts.setdefault(detector, set()).add(finding.verdict)
        return {
            "name": self.name,
            "title": self.title,
            "shows": self.shows,
            "file": f"{self.name}.{form}",
            "table": f"{self.name}.csv",
            "settings": self.settings,
            "command": f"oppload reproduce --only {self.name}",
            "verdicts": {
                detector: str(given.pop() if len(given) == 1 else ClaimVerdict.IN_PART)
                for detector, given in verdicts.items()
            },
            "claims": [
                {
                    "statement": claim.statement,
                    "source": claim.source,
                    "rule": claim.rule,
                    "measured": {
                        detector: finding.as_dict() for detector, finding in claim.findings.items()
                    },
                }
                for claim in self.claims
            ],
            "notes": list(self.notes),
        }


def faint_note(
    detector: str, responses: Collection[Responses], settings: Settings, stimuli: str
) -> str:
    """Return a sentence if a detector hardly responds, else an empty text.

    Parameters
    ----------
    detector : str
        Name of the detector.
    responses : collection of Responses
        Its responses to all stimuli of a measurement.
    settings : Settings
        The settings of the measurement.
    stimuli : str
        The stimuli in words, such as ``to the disk``.
    """
    peak = max(shown.largest for shown in responses)
    return "".join(
        f"{detector_named(detector).label} hardly responds {stimuli} (largest response "
        f"{peak:.3g}, {doubt.note}): the shape of its curve means little."
        for doubt in faint({detector: peak}, settings)
    )


def described_settings(settings: Settings) -> str:
    """Return the working height and the changed parameters of :func:`settings_of` as a text."""
    usual = {**{name: parameters_of(name) for name in settings.models}, "time": TimeParams()}
    changed = [
        f"{group}.{name}={value}"
        for group, params in usual.items()
        for name, value in settings.groups[group].as_dict().items()
        if value != params.as_dict()[name]
    ]
    height = "native size" if settings.pixels is None else f"{settings.pixels} px"
    return ", ".join((height, *changed))


def settings_of(
    detector: str,
    assignments: Mapping[str, object] = MappingProxyType({}),
    *,
    height: str | None = None,
    beside: str = "",
) -> Settings:
    """Return the settings for a measurement of a detector, alone or with another one beside it.

    Parameters
    ----------
    detector : str
        Name of the detector.
    assignments : mapping of str
        Values of parameters by ``detector.parameter``; those of other detectors are left out.
    height : str, optional
        The working height; by default that of the detector.
    beside : str
        Name of the other detector, if any. It gets frames of the same height, and the same time
        base, so that only the models differ.
    """
    chosen = {
        target: value for target, value in assignments.items() if target.startswith(f"{detector}.")
    }
    own = detector_named(detector)
    if beside and detector_named(beside).interval != own.interval:
        chosen["time.interval"] = own.interval
    return resolve(
        models=[detector, beside] if beside else [detector],
        height=height or str(own.height),
        assignments=chosen,
    )


def presented(
    name: str, settings: Settings, changes: Mapping[str, Any]
) -> dict[str, dict[str, Responses]]:
    """Show all stimuli of a family without a pause before the motion, and with changed values.

    Return the responses by the stimulus's name, then by detector.
    """
    protocols = load_all(name, {**NO_PAUSE, **changes})
    return {protocol.name: present(protocol, settings) for protocol in protocols}


def short(value: float) -> str:
    """Return a number with two digits or, from 99.5 on, without decimals: ``0.25``, ``1,200``."""
    return f"{value:,.0f}" if abs(value) >= 99.5 else f"{value:.2g}"


# The figures in the order of the page. Each has the function that makes it (one function makes two
# figures) and its time in s on one core, so that the long ones start first. The modules need
# matplotlib, so they are imported when they run.
FIGURES = {
    "up-down": ("direction.up_and_down", 5),
    "diagonals": ("direction.diagonals", 3),
    "bar-time": ("bars.bar_figures", 30),
    "bar-polar": ("bars.bar_figures", 30),
    "inward": ("direction.inward_motion", 15),
    "looming-centre": ("looming.looming_centre", 4),
    "looming-off-centre": ("looming.looming_off_centre", 4),
    "thresholds": ("looming.thresholds", 40),
    "rmo-definition": ("rmo_figures.definition", 1),
    "rmo-stimuli": ("rmo_figures.stimuli", 8),
    "lplc2": ("lplc2.battery", 280),
}
_SCHEMA = "oppload.reproduction/1"
_PAPER = (
    "OppLoD: the Opponency based Looming Detector, Model Extension of Looming Sensitivity from "
    "LGMD to LPLC2"
)
_MARKS = {
    ClaimVerdict.HOLDS: "yes",
    ClaimVerdict.IN_PART: "part",
    ClaimVerdict.DOES_NOT: "no",
}  # CSS classes


def chosen_figures(names: Collection[str]) -> list[str]:
    """Return the named figures in the order of the page, or all figures if none is named.

    Raises ParameterError if no figure has such a name.
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
    """Make figures, and return them in the order of `names`.

    Parameters
    ----------
    names : sequence of str
        Names from :func:`chosen_figures`.
    jobs : int
        Number of processes, which does not change the result.
    form : str
        Format of the pictures, ``png``, ``svg`` or ``pdf``; PNG is made too, for the page.
    done : callable, optional
        Takes each figure when it is made.

    Raises
    ------
    OutputError
        If the system ends one of the processes, for example because memory runs out.
    """
    makers = {FIGURES[name] for name in names}
    ordered = [maker for maker, _ in sorted(makers, key=lambda timed: (-timed[1], timed[0]))]
    made: dict[str, Built] = {}

    def take(built: list[Built]) -> None:
        for figure in built:
            if figure.name in names:
                made[figure.name] = figure
                if done:
                    done(figure)

    def made_by(maker: str) -> str:
        return " and ".join(name for name, (own, _) in FIGURES.items() if own == maker)

    results(partial(_make, form), ordered, jobs, named=made_by, progress=take)
    return [made[name] for name in names]


def _make(form: str, maker: str) -> list[Built]:
    """Return the figures of a function in `FIGURES`, with pictures in place of the drawn figure."""
    module, _, function = maker.partition(".")
    built = getattr(importlib.import_module(f"oppload_cli.reproduction.{module}"), function)()
    style = importlib.import_module("oppload_cli.plots.style")  # loads matplotlib
    made = []
    for drawn in built if isinstance(built, list) else [built]:
        pictures = {"png": style.image_bytes(drawn.figure, "png", _DPI)}
        if form not in pictures:
            pictures[form] = style.image_bytes(drawn.figure, form)
        made.append(replace(drawn, figure=None, pictures=pictures))
    return made


def pages_of(figures: Sequence[Built], wall_s: float, form: str) -> tuple[dict[str, str], str]:
    """Return ``report.json`` and ``index.html`` by name, and the counts of verdicts in words.

    `wall_s` is the time in s for making the figures, `form` the format of the pictures.
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
        detectors=detectors_in(report),
        introduction=introduction(report),
        marks=_MARKS,
        tally=tally,
        stated=stated,
        embedded=embedded,
    )
    text = json.dumps(report, indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    return {"report.json": text, "index.html": page}, _verdicts(report)


def detectors_in(report: Mapping[str, Any]) -> list[str]:
    """Return the detectors of all figures, in their order."""
    verdicts = [figure["verdicts"] for figure in report["figures"]]
    return list(dict.fromkeys(detector for given in verdicts for detector in given))


def introduction(report: Mapping[str, Any]) -> str:
    """Return the first paragraph of the page and of ``docs/reproduction.md``."""
    return str(_TEXTS["introduction"]).format(verdicts=_verdicts(report))


def _verdicts(report: Mapping[str, Any]) -> str:
    """Return how often each verdict occurs, over all statements and detectors."""
    findings = [
        finding
        for figure in report["figures"]
        for claim in figure["claims"]
        for finding in claim["measured"].values()
    ]
    counts = []
    for verdict in ClaimVerdict:
        faint = [found["hardly_responds"] for found in findings if found["verdict"] == verdict]
        note = f" ({sum(faint)} hardly responding)" * any(faint)
        counts.append(f"{len(faint)} '{verdict}'{note}")
    return ", ".join(counts)


def tally(figure: Mapping[str, Any], detector: str) -> str:
    """Return the counts of the verdicts on a figure for a detector, e.g. ``3 hold, 1 in part``."""
    findings = [
        claim["measured"][detector] for claim in figure["claims"] if detector in claim["measured"]
    ]
    verdicts = [finding["verdict"] for finding in findings]
    hold, part, failed = (verdicts.count(verdict) for verdict in ClaimVerdict)
    return f"{hold} hold" + f", {part} in part" * bool(part) + f", {failed} not" * bool(failed)


def stated(finding: Mapping[str, Any]) -> str:
    """Return the verdict of a finding in a report, and whether a detector hardly responds."""
    return f"{finding['verdict']}{', hardly responds' * finding['hardly_responds']}"
