"""What the paper says, what was measured, and the verdict that follows from it."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterable

NO_PRESET = "any preset"


class Verdict(StrEnum):
    """Whether a statement holds."""

    HOLDS = "holds"
    IN_PART = "holds in part"
    DOES_NOT = "does not hold"


@dataclass(frozen=True)
class Finding:
    """What one preset gave.

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

    def as_dict(self) -> dict[str, Any]:
        """Return the claim ready for JSON.

        Returns
        -------
        dict
        """
        return {
            "statement": self.statement,
            "rule": self.rule,
            "measured": {
                preset: {
                    "text": finding.text,
                    "verdict": str(finding.verdict),
                    "numbers": finding.numbers,
                }
                for preset, finding in self.findings.items()
            },
        }


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
        What is in the picture.
    claims : tuple of Claim
        At least one.
    png : bytes
        The picture.
    notes : tuple of str
        What a reader should know besides.
    """

    name: str
    title: str
    shows: str
    claims: tuple[Claim, ...]
    png: bytes
    notes: tuple[str, ...] = ()

    @property
    def command(self) -> str:
        """The command that makes this one figure."""
        return f"oppload reproduce --only {self.name}"

    @property
    def verdicts(self) -> dict[str, Verdict]:
        """The verdict over all claims, by preset."""
        presets = dict.fromkeys(preset for claim in self.claims for preset in claim.findings)
        return {
            preset: overall(
                claim.findings[preset].verdict for claim in self.claims if preset in claim.findings
            )
            for preset in presets
        }

    def as_dict(self) -> dict[str, Any]:
        """Return all but the picture, ready for JSON.

        Returns
        -------
        dict
        """
        return {
            "name": self.name,
            "title": self.title,
            "shows": self.shows,
            "file": f"{self.name}.png",
            "command": self.command,
            "verdicts": {preset: str(verdict) for preset, verdict in self.verdicts.items()},
            "claims": [claim.as_dict() for claim in self.claims],
            "notes": list(self.notes),
        }


def at_most(value: float, holds: float, in_part: float) -> Verdict:
    """Judge a value that should be small.

    Parameters
    ----------
    value : float
        The measurement; NaN does not hold.
    holds, in_part : float
        Largest values of the two better verdicts.

    Returns
    -------
    Verdict
    """
    if value <= holds:
        return Verdict.HOLDS
    return Verdict.IN_PART if value <= in_part else Verdict.DOES_NOT


def at_least(value: float, holds: float, in_part: float) -> Verdict:
    """Judge a value that should be large.

    Parameters
    ----------
    value : float
        The measurement; NaN does not hold.
    holds, in_part : float
        Smallest values of the two better verdicts.

    Returns
    -------
    Verdict
    """
    if value >= holds:
        return Verdict.HOLDS
    return Verdict.IN_PART if value >= in_part else Verdict.DOES_NOT


def overall(verdicts: Iterable[Verdict]) -> Verdict:
    """Sum verdicts up: all hold, none does, or in part.

    Parameters
    ----------
    verdicts : iterable of Verdict
        At least one.

    Returns
    -------
    Verdict
    """
    different = set(verdicts)
    return different.pop() if len(different) == 1 else Verdict.IN_PART
