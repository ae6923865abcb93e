"""Statements of the paper, our measurements, and the verdicts that follow from them.

Every figure shows stimuli of the catalogue to the paper's own model, and judges the responses.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import StrEnum
from typing import TYPE_CHECKING, Any

from oppload_cli.models.presets import STUDY_PRESET
from oppload_cli.pipeline.settings import resolve
from oppload_cli.stimulus.catalogue import load_all
from oppload_cli.tuning.present import present

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from oppload_cli.pipeline.settings import Settings
    from oppload_cli.tuning.present import Responses


NO_PRESET = "any preset"
# The presets that are the paper's own model; preset default departs from it.
TITLES = {STUDY_PRESET: "preset reference", "paper": "preset paper (literal)"}
PRESETS = tuple(TITLES)
# Without a pause before the motion: after one, the first moving frames meet no delayed
# inhibition yet, and give a transient that is the same for every direction.
NO_PAUSE = {"timing.before_s": 0}
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
