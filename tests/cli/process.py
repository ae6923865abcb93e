"""The real command, or other code, in a real process."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
import warnings
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

HEAVY = ("numpy", "cv2", "av", "pandas", "matplotlib", "difflib", "traceback")  # slow to load
ENTRY = "from oppload_cli.__main__ import entry; entry()"  # the code of the installed script


def python(
    code: str, *arguments: str | Path, cwd: Path | None = None, **environment: str
) -> subprocess.CompletedProcess[str]:
    """Run code in a new Python process until it ends."""
    return subprocess.run(
        [sys.executable, "-c", code, *map(str, arguments)],
        capture_output=True,
        text=True,
        errors="surrogateescape",
        check=False,
        cwd=cwd,
        timeout=120,
        env={**os.environ, **environment},
    )


def loaded(code: str, *modules: str) -> list[str]:
    """Return which of these modules a new Python process has loaded after this code."""
    done = python(f"{code}\nimport sys; print(*({{*sys.argv[1:]}} & sys.modules.keys()))", *modules)
    assert done.returncode == 0, done.stderr
    return sorted(done.stdout.splitlines()[-1].split())


def oppload(
    *arguments: str | Path, cwd: Path | None = None, **environment: str
) -> subprocess.CompletedProcess[str]:
    return python(ENTRY, *arguments, cwd=cwd, **environment)


def start(*arguments: str | Path, code: str = ENTRY) -> subprocess.Popen[str]:
    """Start the command, or other code, and do not wait until it ends."""
    words = [sys.executable, "-c", code, *map(str, arguments)]
    return subprocess.Popen(words, stderr=subprocess.PIPE, text=True)


@contextmanager
def at_terminal(*arguments: str | Path) -> Iterator[tuple[int, int]]:
    """Start the command at a terminal of its own, of 120 columns.

    Yield the number of its process, and the terminal as an open file.
    """
    import pty  # not on Windows
    import termios

    with warnings.catch_warnings():  # the new process only starts a program, so threads do no harm
        warnings.filterwarnings("ignore", ".*multi-threaded", DeprecationWarning)
        child, terminal = pty.fork()
    if child == 0:
        os.execv(  # noqa: S606
            sys.executable, [sys.executable, "-c", ENTRY, *map(str, arguments)]
        )
    termios.tcsetwinsize(terminal, (24, 120))
    try:
        yield child, terminal
    finally:
        os.close(terminal)


def shown_at(terminal: int) -> str:
    """Return what a command prints at a terminal until it ends."""
    shown = b""
    with suppress(OSError):  # Linux: the command has ended
        while chunk := os.read(terminal, 4096):
            shown += chunk
    return shown.decode()


_ROWS = 8  # the first three frames have no response


def wait_for_rows(run: subprocess.Popen[str], part: Path) -> None:
    """Wait until a command has written rows with responses to a part file, or has ended."""
    while run.poll() is None and not (part.exists() and part.read_bytes().count(b"\n") > _ROWS):
        time.sleep(0.01)


# Loads the libraries once, then forks a process for each command.
IN_TURN = """
import json, os, subprocess, sys
from pathlib import Path
from oppload_cli.__main__ import entry

forks = sys.platform == "linux"  # elsewhere a copy of a process with these libraries may fail
if forks:
    import av, cv2, numpy, oppload_cli.cli.running

def code_of(words):
    if not forks:
        return subprocess.call([sys.executable, "-m", "oppload_cli", *words])
    child = os.fork()
    if not child:
        sys.argv[1:] = words
        entry()
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])

codes = [code_of(words) for words in json.loads(sys.argv[2])]
Path(sys.argv[1]).write_text(json.dumps(codes))
"""


class InTurn(NamedTuple):
    """The exit codes of several commands, and what they all printed."""

    returncodes: list[int]
    stderr: str


def in_turn(
    *commands: Sequence[str | Path], prefix: Sequence[str] = (), stdout: Any = subprocess.DEVNULL
) -> InTurn:
    """Run commands one after the other, each in a process with the streams of the first.

    The prefix is a program that starts the first process, such as a shell that closes its streams.
    """
    listed = json.dumps([[str(word) for word in words] for words in commands])
    with TemporaryDirectory() as folder:
        codes = Path(folder) / "codes.json"
        done = subprocess.run(
            [*prefix, sys.executable, "-c", IN_TURN, str(codes), listed],
            stdout=stdout,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
            timeout=120,
            env={"OPENBLAS_NUM_THREADS": "1", "OPENCV_LOG_LEVEL": "SILENT", **os.environ},
        )
        return InTurn(json.loads(codes.read_text()) if codes.exists() else [], done.stderr)
