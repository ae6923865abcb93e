"""The exceptions of oppload, and the exit codes of the command line for them.

Every error that a user can cause is an :class:`OpploadError`. Its message is one sentence with the
fault, its place, and the remedy. Only ``oppload_cli.cli.main`` prints it.
"""

from __future__ import annotations

import errno
from enum import IntEnum
from typing import TYPE_CHECKING, ClassVar

if TYPE_CHECKING:
    from collections.abc import Iterable


_NO_MEMORY = (
    "cannot allocate memory",
    "failed to map segment",  # when a library is loaded
    "insufficient memory",
    "failed to allocate",
    "out of memory",
    "bad_alloc",  # in C++
)


class ExitCode(IntEnum):
    """The exit codes of the process (``docs/formats.md``)."""

    DONE = 0
    BUG = 1
    USAGE = 2
    NOTHING_READ = 3
    INCOMPLETE = 4
    CONDITION_MET = 5
    INTERRUPTED = 130


class OpploadError(Exception):
    """Base of every error that oppload raises on purpose.

    Examples
    --------
    >>> import oppload_cli as oppload
    >>> try:
    ...     oppload.run("controls/looming-perspective", preset="lgmd")
    ... except oppload.OpploadError as error:
    ...     print(str(error).partition(";")[0])
    no preset 'lgmd'
    """

    exit_code: ClassVar[ExitCode] = ExitCode.USAGE


class ParameterError(OpploadError, ValueError):
    """A parameter has an unknown name, or a value outside its range."""


class DetectorError(OpploadError):
    """A detector that a user has registered fails, or gives a response that is not valid."""


class SourceError(OpploadError):
    """An input cannot be read at all."""

    exit_code: ClassVar[ExitCode] = ExitCode.NOTHING_READ


class FrameError(OpploadError, ValueError):
    """An array given to a model is not a luminance image of the right shape."""


class ResultError(OpploadError):
    """A result file cannot be read, or lacks something that the command needs."""


class NoResultError(ResultError):
    """None of several results can be read."""

    exit_code: ClassVar[ExitCode] = ExitCode.NOTHING_READ


class ManifestError(OpploadError):
    """A manifest of labelled clips, or their boxes, cannot be used."""


class OutputError(OpploadError):
    """A result cannot be written."""


class BusyError(OutputError):
    """Another run is writing the same result."""


class ShortageError(OpploadError):
    """The system has no further memory, processes or open files for oppload."""

    exit_code: ClassVar[ExitCode] = ExitCode.NOTHING_READ


class StimulusError(OpploadError, ValueError):
    """A stimulus protocol is not valid, or cannot be rendered with the given settings."""


def shortage(error: BaseException | None) -> str:
    """Return a message if an error means that memory, processes, threads or files ran out.

    Libraries use different words for memory and threads that the system refuses.

    Parameters
    ----------
    error : BaseException or None
        Any error; the errors that caused it are examined too.

    Returns
    -------
    str
        The message, without the place of the fault; empty for every other error.
    """
    seen: list[BaseException] = []
    # An error that was kept in a thread and raised again may be its own cause.
    while error is not None and error not in seen:
        seen.append(error)
        number = getattr(error, "errno", None)
        # The full text of a system error includes a path, which may contain any words.
        said = str(getattr(error, "strerror", None) or error).lower()
        known = isinstance(error, MemoryError) or number == errno.ENOMEM
        if known or any(words in said for words in _NO_MEMORY):
            return (
                "the memory is short; free some, raise its limit (ulimit -v), or use fewer --jobs"
            )
        if number == errno.EAGAIN or "start new thread" in said:
            return (
                "no further process or thread can be started; end some, raise their limit "
                "(ulimit -u), or use fewer --jobs"
            )
        if number in {errno.EMFILE, errno.ENFILE}:
            return "too many files are open; raise their limit (ulimit -n), or use fewer --jobs"
        error = error.__cause__ or error.__context__
    return ""


def reason_of(error: BaseException) -> str:
    """Return the text of a system's or parser's error, as a part of a sentence."""
    said = str(getattr(error, "strerror", None) or error).strip()
    if not said:
        return type(error).__name__
    first = said.splitlines()[0].rstrip(".")
    return first[:1].lower() + first[1:]


def cannot_read(name: str, error: OSError) -> SourceError:
    """Return the error to raise if the system refuses to read an input."""
    remedy = "check its rights" if isinstance(error, PermissionError) else "check the path"
    return SourceError(f"{name}: cannot be read ({reason_of(error)}); {remedy}")


def printable(text: str) -> str:
    r"""Return a text with control characters and undecodable bytes written as ``\\x1b``.

    Messages contain names of files, which may have line ends and escape sequences.
    """
    return "".join(
        c if c.isprintable() else c.encode("unicode_escape", "surrogatepass").decode() for c in text
    )


def suggestion(word: str, known: Iterable[str]) -> str:
    """Return a hint for a misspelt word: the known word that is nearest to it.

    Parameters
    ----------
    word : str
        The word that the user wrote.
    known : iterable of str
        The words that are allowed.

    Returns
    -------
    str
        ``"; did you mean 'receptive_field'?"``, or the words that end in `word`, or all known
        words if none is near.
    """
    names = sorted(known)
    import difflib  # noqa: PLC0415 - only for a misspelt word

    begun = [name for name in names if len(word) > 2 and name.startswith(word)]
    ended = [name for name in names if name.endswith(f"_{word}")]
    near = begun[:1] or ended or difflib.get_close_matches(word, names, n=1, cutoff=0.6)
    if len(near) == 1:
        return f"; did you mean '{near[0]}'?"
    return f"; choose {', '.join(near or names)}" if names else ""
