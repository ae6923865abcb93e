"""The exceptions of oppload with their exit codes, and functions for messages.

Every error that a user can cause is an :class:`OpploadError`. Its message is one sentence with the
fault, its place, and the remedy. Only ``oppload_cli.cli.main`` prints it.
"""

from __future__ import annotations

import errno
import os
import re
import unicodedata
from contextlib import contextmanager
from enum import IntEnum
from typing import TYPE_CHECKING, ClassVar

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence


_NO_MEMORY = (
    "cannot allocate memory",
    "failed to map segment",  # when a library is loaded
    "insufficient memory",
    "failed to allocate",
    "out of memory",
    "bad_alloc",  # in C++
)
_IN_USE = {32, 33}  # Windows: ERROR_SHARING_VIOLATION, ERROR_LOCK_VIOLATION
_LOGIN = re.compile(r"(?<=://)[^/?#\s]*@")  # as FFmpeg finds it in an address
_JOINERS = "\N{ZERO WIDTH NON-JOINER}\N{ZERO WIDTH JOINER}"


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
    ...     oppload.run("controls/looming-perspective", models=["lgmd"])
    ... except oppload.OpploadError as error:
    ...     print(str(error).partition(";")[0])
    no model 'lgmd'
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
    """An array given to a model is not a frame of the right shape."""


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


@contextmanager
def faults_at(place: str, kind: type[OpploadError] | None = None) -> Iterator[None]:
    """Put the place of the fault, such as the name of a file, before the message of an error.

    The error keeps its class, unless `kind` is given.
    """
    try:
        yield
    except OpploadError as error:
        raise (kind or type(error))(f"{place}: {error}") from error


def shortage(error: BaseException | None) -> str:
    """Return a message if an error, or its cause, means that memory, processes or files ran out.

    The message lacks the place of the fault; it is empty for every other error.
    """
    checked: list[BaseException] = []
    # An error that was kept in a thread and raised again may be its own cause.
    while error is not None and error not in checked:
        checked.append(error)
        number = getattr(error, "errno", None)
        # Not the complete text of a system error: its path may contain any words.
        text = str(getattr(error, "strerror", None) or error).lower()
        no_memory = isinstance(error, MemoryError) or number == errno.ENOMEM
        if no_memory or any(words in text for words in _NO_MEMORY):
            return (
                "the memory is short; free some, raise its limit (ulimit -v), or run less at once "
                "(--jobs)"
            )
        # A thread needs memory too, and the system gives the same error if there is none.
        if number == errno.EAGAIN or "start new thread" in text:
            return (
                "no further process or thread can be started; end some, raise their limit "
                "(ulimit -u) or that of the memory (ulimit -v), or run less at once (--jobs)"
            )
        if number in {errno.EMFILE, errno.ENFILE}:
            return (
                "too many files are open; raise their limit (ulimit -n), or run less at once "
                "(--jobs)"
            )
        error = error.__cause__ or error.__context__
    return ""


def reason_of(error: BaseException) -> str:
    """Return the first line of an error of the system or a parser, as a part of a sentence."""
    text = getattr(error, "strerror", None) or str(error)
    if isinstance(error, OSError) and (code := getattr(error, "winerror", None)):
        # The text of Windows is in the user's language.
        text = "another program uses it" if code in _IN_USE else os.strerror(error.errno or code)
    text = text.strip()
    if not text:
        return type(error).__name__
    first = text.splitlines()[0].rstrip(".")
    rest = first.partition(" ")[0][1:]
    return first[:1].lower() + first[1:] if rest == rest.lower() else first  # not "i/O error"


def cannot_read(name: str, error: OSError) -> SourceError:
    """Return the error to raise if the system refuses to read an input."""
    remedy = "check its rights" if isinstance(error, PermissionError) else "check the path"
    return SourceError(f"{name}: cannot be read ({reason_of(error)}); {remedy}")


def printable(text: str) -> str:
    r"""Return a text without logins, its control characters and undecodable bytes as ``\\x1b``.

    Names of files, which messages contain, may have line ends and escape sequences. All spaces and
    joiners of characters are kept: macOS writes a narrow space into names, and Persian and emoji
    need joiners.
    """
    return "".join(
        c
        if c.isprintable() or c in _JOINERS or unicodedata.category(c) == "Zs"
        else c.encode("unicode_escape", "surrogatepass").decode()
        for c in without_login(text)
    )


def without_login(text: str) -> str:
    """Return a text whose addresses lack user and password, so that no log or result has them."""
    return _LOGIN.sub("", text)


def counted(count: int, noun: str) -> str:
    """Return a number with its noun, such as ``1 frame`` or ``0 frames``."""
    return f"{count} {noun}{'s' * (count != 1)}"


def suggestion(word: object, known: Iterable[str]) -> str:
    """Return a hint for a misspelt word, such as ``; did you mean 'receptive_field'?``.

    The hint names the most similar known word, the known words that end in ``_word``, or else all
    known words.
    """
    names = sorted(known)
    similar = _similar(word, names)
    if len(similar) == 1:
        return f"; did you mean '{similar[0]}'?"
    return f"; choose {', '.join(similar or names)}" if names else ""


def nearest(word: object, known: Iterable[str]) -> str:
    """Return the one known word that `suggestion` takes for a misspelt word; else an empty text."""
    similar = _similar(word, sorted(known))
    return similar[0] if len(similar) == 1 else ""


def _similar(word: object, names: Sequence[str]) -> list[str]:
    text = str(word)  # from Python also None or a number
    return _similar_to(text, names) or _similar_to(text.lower(), names)


def _similar_to(word: str, names: Sequence[str]) -> list[str]:
    import difflib  # noqa: PLC0415 - only for a misspelt word

    begun = [name for name in names if len(word) > 2 and name.startswith(word)]
    ended = [name for name in names if name.endswith(f"_{word}")]
    return begun[:1] or ended or difflib.get_close_matches(word, names, n=1, cutoff=0.6)
