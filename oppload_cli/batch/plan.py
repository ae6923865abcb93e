"""The plan of a batch: which inputs, in which order, and what their results are called."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from oppload_cli.batch.lists import Listed
from oppload_cli.errors import ParameterError
from oppload_cli.video.inputs import each_once, found_inputs, result_stems

if TYPE_CHECKING:
    from collections.abc import Iterable


@dataclass(frozen=True)
class Planned:
    """One input of a batch.

    Attributes
    ----------
    name : str
        The input.
    stem : str
        Of its results: ``{stem}.frames.csv`` and ``{stem}.oppload.json``.
    """

    name: str
    stem: str


@dataclass(frozen=True)
class Failure:
    """An input that failed.

    Attributes
    ----------
    name : str
        The input, as it was named.
    stem : str
        Of its results; empty where no input was found under the name.
    code : int
        The exit code that it has alone (``docs/formats.md``).
    message : str
        What was wrong, where, and what to do: one sentence.
    """

    name: str
    stem: str
    code: int
    message: str


@dataclass(frozen=True)
class Plan:
    """All inputs of a batch, each once, sorted by name.

    Attributes
    ----------
    inputs : list of Planned
        What is to be done.
    failures : list of Failure
        What was named and is not there.
    """

    inputs: list[Planned] = field(default_factory=list)
    failures: list[Failure] = field(default_factory=list)

    def __len__(self) -> int:
        return len(self.inputs) + len(self.failures)

    def shard(self, number: int, of: int) -> Plan:
        """Return the part of the plan that is one shard's.

        Parameters
        ----------
        number, of : int
            Which one, from 1, of how many.

        Returns
        -------
        Plan
            Every `of`-th input: the same list gives the same shards, they never
            overlap, and together they are the plan. The names of the results are
            those of the whole plan. What is not there fails in the first shard.
        """
        return Plan(self.inputs[number - 1 :: of], self.failures if number == 1 else [])


def planned(named: Iterable[str | Listed], *, recursive: bool = False) -> Plan:
    """Return the plan for what the user names.

    Parameters
    ----------
    named : iterable of str or Listed
        Files, folders, patterns and addresses; a listed one with a stem keeps it.
    recursive : bool
        Whether folders are searched to any depth.

    Returns
    -------
    Plan
    """
    stems: dict[str, str] = {}
    failures: dict[str, Failure] = {}
    names: list[str] = []
    for entry in dict.fromkeys(named):
        each = entry if isinstance(entry, Listed) else Listed(entry)
        if each.stem:
            stems[each.name] = each.stem
            names.append(each.name)
            continue
        for name, error in found_inputs(each.name, recursive=recursive):
            if error is None:
                names.append(name)
            else:
                failures[name] = Failure(name, "", error.exit_code, str(error))
    names = sorted(each_once(names))
    inputs = [
        Planned(name, stems.get(name, stem))
        for name, stem in zip(names, result_stems(names), strict=True)
    ]
    return Plan(inputs, list(failures.values()))


def parse_shard(text: str) -> tuple[int, int]:
    """Read which shard is meant.

    Parameters
    ----------
    text : str
        ``I/N``: the I-th of N, from 1.

    Returns
    -------
    tuple of int
        I and N.

    Raises
    ------
    ParameterError
        If it is written in another way, or I is not 1 to N.
    """
    match = re.fullmatch(r"(\d{1,9})/(\d{1,9})", text)
    number, of = (int(match[1]), int(match[2])) if match else (0, 0)
    if not 1 <= number <= of:
        raise ParameterError(
            f"--shard must be I/N with I from 1 to N, such as 1/8 to 8/8, not '{text}'"
        )
    return number, of
