"""The command in this process: quick, for what needs no process of its own."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import pytest

from oppload_cli.cli import main

if TYPE_CHECKING:
    from pathlib import Path


class Done(NamedTuple):
    """What a command returned and printed."""

    returncode: int
    stdout: str
    stderr: str


def run(capsys: pytest.CaptureFixture[str], *arguments: str | Path) -> Done:
    capsys.readouterr()
    with pytest.raises(SystemExit) as ended:
        main([str(argument) for argument in arguments])
    out, err = capsys.readouterr()
    return Done(int(ended.value.code or 0), out, err)
