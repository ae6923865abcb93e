"""Lists of inputs: plain text, NUL-separated, or the ``failures.csv`` of a batch."""

from __future__ import annotations

import csv
import io
import os
import sys
from pathlib import Path
from typing import NamedTuple

from oppload_cli.errors import ParameterError

STANDARD_INPUT = "-"
FAILURE_COLUMNS = ("input", "stem", "exit_code", "error")


class Listed(NamedTuple):
    """One entry of a list.

    Attributes
    ----------
    name : str
        A file, a folder, a pattern or an address.
    stem : str
        The stem of its results, where that is settled; else empty.
    """

    name: str
    stem: str = ""


def read_list(source: str, *, null: bool = False) -> list[Listed]:
    """Read a list of inputs.

    Parameters
    ----------
    source : str
        A file, or ``-`` for standard input: a name per line, empty lines left out;
        or the ``failures.csv`` of a batch.
    null : bool
        Whether the names end in NUL, as ``find -print0`` writes them.

    Returns
    -------
    list of Listed
        In their order.

    Raises
    ------
    ParameterError
        If it cannot be read, or names nothing.
    """
    text = os.fsdecode(_content(source))
    if null:
        entries = [Listed(name) for name in text.split("\0") if name]
    elif text.startswith(",".join(FAILURE_COLUMNS)):
        rows = csv.DictReader(io.StringIO(text, newline=""))
        entries = [Listed(row["input"] or "", row["stem"] or "") for row in rows]
    else:
        # Only line ends separate: a name may hold any other character.
        lines = (line.removesuffix("\r") for line in text.split("\n"))
        entries = [Listed(line) for line in lines if line]
    if not entries:
        raise ParameterError(f"--files-from {source}: names no input; put a name on each line")
    if any("\0" in entry.name for entry in entries):
        raise ParameterError(f"--files-from {source}: its names end in NUL; add -0")
    return entries


def _content(source: str) -> bytes:
    if source == STANDARD_INPUT:
        if sys.stdin is None:  # as Python has it after "oppload ... <&-"
            raise ParameterError("--files-from -: standard input is closed; pipe a list into it")
        return sys.stdin.buffer.read()
    try:
        return Path(source).read_bytes()
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise ParameterError(
            f"--files-from {source}: cannot be read ({reason}); check the path"
        ) from error
