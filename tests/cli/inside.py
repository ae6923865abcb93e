"""The command in this process: quick, for what needs no process of its own."""

from __future__ import annotations

import io
import shlex
import sys
from contextlib import chdir, redirect_stderr, redirect_stdout
from typing import TYPE_CHECKING, NamedTuple

import pytest

from oppload_cli.cli import main

if TYPE_CHECKING:
    from pathlib import Path


_ERRORS = "surrogateescape"  # as the command sets it


class Done(NamedTuple):
    """What a command returned and printed."""

    returncode: int
    stdout: str
    stderr: str


def oppload(*arguments: str | Path, cwd: Path | str = ".") -> Done:
    """Run the command as `tests.cli.process.oppload` does, which starts a process for it."""
    out, err = (io.TextIOWrapper(io.BytesIO(), "utf-8", _ERRORS, newline="") for _ in range(2))
    with redirect_stdout(out), redirect_stderr(err), chdir(cwd), pytest.raises(SystemExit) as ended:
        main([str(argument) for argument in arguments])
    texts = []
    for stream in (out, err):
        stream.seek(0)
        texts.append(stream.read())
    return Done(int(ended.value.code or 0), *texts)


def words_of(command: str) -> list[str]:
    """Split a command that oppload has printed for the shell of this system."""
    return shlex.split(command, posix=sys.platform != "win32")
