"""The exception tree, and the exit codes that the command line gives for it.

Every error that a user can cause is an :class:`OpploadError`; its message is one
sentence that says what is wrong, where, and what to do. ``oppload_cli.cli.failure``
is the one place that prints it.
"""

from __future__ import annotations

from enum import IntEnum
from typing import TYPE_CHECKING, ClassVar

if TYPE_CHECKING:
    from collections.abc import Iterable


class ExitCode(IntEnum):
    """What the process returns (``docs/formats.md``)."""

    DONE = 0
    BUG = 1
    USAGE = 2
    NOTHING_READ = 3
    INCOMPLETE = 4
    CONDITION_MET = 5
    INTERRUPTED = 130


class OpploadError(Exception):
    """Base of every error that oppload raises on purpose."""

    exit_code: ClassVar[ExitCode] = ExitCode.USAGE


class ParameterError(OpploadError, ValueError):
    """A parameter has an unknown name, or a value outside its range."""


class SourceError(OpploadError):
    """An input cannot be read at all."""

    exit_code: ClassVar[ExitCode] = ExitCode.NOTHING_READ


class FrameError(OpploadError, ValueError):
    """An array given to a model is not a luminance image of the right shape."""


class ResultError(OpploadError):
    """A result file cannot be read back, or does not hold what is asked of it."""


class ManifestError(OpploadError):
    """A manifest of labelled clips, or their boxes, cannot be used."""


class OutputError(OpploadError):
    """A result cannot be written."""


class BusyError(OutputError):
    """Another run is writing the same result."""


class StimulusError(OpploadError, ValueError):
    """A stimulus protocol is not valid, or cannot be rendered as asked."""


def printable(text: str) -> str:
    r"""Return a text on one line, without what a terminal would obey.

    Names of files go into messages, and may hold line ends and escape sequences.

    Parameters
    ----------
    text : str
        Of any origin.

    Returns
    -------
    str
        With control characters and undecodable bytes as ``\\x1b``.
    """
    return "".join(
        c if c.isprintable() else c.encode("unicode_escape", "surrogatepass").decode() for c in text
    )


def suggestion(word: str, known: Iterable[str]) -> str:
    """Return a hint that names the known word nearest to a misspelt one.

    Parameters
    ----------
    word : str
        What the user wrote.
    known : iterable of str
        What would have been right.

    Returns
    -------
    str
        ``"; did you mean 'receptive_field'?"``, or the list of what there is
        where nothing is near.
    """
    names = sorted(known)
    import difflib  # noqa: PLC0415 - seldom needed

    near = difflib.get_close_matches(word, names, n=1, cutoff=0.6)
    if near:
        return f"; did you mean '{near[0]}'?"
    return f"; there is {', '.join(names)}" if names else ""
