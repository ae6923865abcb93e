"""Run one command under limits, and report the faults in the files and processes it leaves."""

from __future__ import annotations

import csv
import ctypes
import json
import os
import re
import shutil
import signal
import stat
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass, field
from io import StringIO
from itertools import pairwise
from pathlib import Path
from typing import IO, TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator

_ENTRY = "from oppload_cli.__main__ import entry; entry()"  # as in the installed script
_COMMAND = (sys.executable, "-c", _ENTRY)
_CODES = frozenset({0, 2, 3, 4, 5, 130})  # the exit codes of docs/formats.md without 1, a bug
_LIMIT_S = 90.0  # a server that stalls delays a command by 10 s
END_S = 15.0  # after the command, its other processes must end within this time
_MOST_MEMORY = 3 << 30
_MOST_LINES = 10  # of standard error, besides two for each input and one for each remark
_WRONG_WORDS = (
    *("Traceback", "this is a bug", "Fatal Python error", "Exception ignored", "terminate called"),
    *("Segmentation fault", "resource_tracker", "MemoryError", "Unraisable", "core dumped"),
    *("Error in atexit", "Warning:", "[mov,", "[h264 @", "[swscaler", "<jemalloc>"),
    "spawn new thread",
)
# The last bytes of a complete file, by suffix.
_ENDS = {
    ".png": b"IEND\xaeB`\x82",
    ".svg": b"</svg>",
    ".pdf": b"%%EOF",
    ".html": b"</html>",
    ".parquet": b"PAR1",
}
SHARED = Path("/dev/shm")  # noqa: S108
_SUBREAPER = 36  # PR_SET_CHILD_SUBREAPER of Linux


@dataclass
class Case:
    """One command with its files, limits and signals.

    The folder of a case has the folders `in` for input, `out` for results, `home` and `tmp`. The
    command may change `out` only.
    """

    family: str
    number: int
    folder: Path
    words: list[str] = field(default_factory=list)
    files: int = 1  # number of inputs of the command
    limits: dict[str, int] = field(default_factory=dict)  # by the names of prlimit's options
    # Seconds after the start, name of the signal, and whether the process group receives it.
    signals: list[tuple[float, str, bool]] = field(default_factory=list)
    stdin: bytes = b""
    environment: dict[str, str | None] = field(default_factory=dict)  # None: without the variable
    one_core: bool = False  # whether the command may use a single core only
    umask: int = -1  # that of this process
    user: int = 0  # the user that runs the command; 0: the user of this process
    reads: int | None = None  # bytes after which the reader of standard output closes it
    around: list[AbstractContextManager[object]] = field(default_factory=list)  # servers, disks
    command: tuple[str, ...] = _COMMAND
    codes: frozenset[int] = _CODES
    limit_s: float = _LIMIT_S

    @property
    def out(self) -> Path:
        """The only folder that the command may write into."""
        return self.folder / "out"


@dataclass
class Ended:
    """The end of a command."""

    code: int
    stdout: bytes
    stderr: str
    hung: bool
    memory: int  # largest memory of any of its processes, in bytes
    outliving: list[str]  # ids of its processes that did not end


def prepared(family: str, number: int, folder: Path) -> Case:
    """Return a case with its folders."""
    for name in ("in", "out", "home", "tmp"):
        (folder / name).mkdir(parents=True)
    return Case(family, number, folder)


def adopt_orphans() -> None:
    """Become the parent of descendants whose own parent has ended, so that all can be found."""
    with suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(_SUBREAPER, 1, 0, 0, 0)


def execute(case: Case) -> Ended:
    """Run the command of a case until it ends or reaches its time limit."""
    cache = str(case.folder.parent / "cache")
    environment = {
        **{name: os.environ[name] for name in ("PATH", "LANG", "PYTHONPATH") if name in os.environ},
        "HOME": str(case.folder / "home"),
        "XDG_CACHE_HOME": cache,
        "TMPDIR": str(case.folder / "tmp"),
        "MPLCONFIGDIR": cache,
        "PYTHONDONTWRITEBYTECODE": "1",
        "OPPLOAD_ATTACK": str(case.folder),
    }
    for name, value in case.environment.items():
        environment.pop(name, None)
        if value is not None:
            environment[name] = value
    prefix = []
    if case.one_core:
        core = min(os.sched_getaffinity(0))
        prefix += [str(shutil.which("taskset")), "--cpu-list", str(core)]
    if case.user:  # another user who may read all files, like root
        rights = "+dac_override,+dac_read_search"
        prefix += ["setpriv", f"--reuid={case.user}", f"--regid={case.user}", "--clear-groups"]
        prefix += [f"--inh-caps={rights}", f"--ambient-caps={rights}"]
    if case.limits:
        limits = [f"--{name}={amount}" for name, amount in case.limits.items()]
        prefix += ["prlimit", *limits, "--"]
    before = _children()
    run = subprocess.Popen(
        [*prefix, *case.command, *case.words],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        cwd=case.folder / "in",
        env=environment,
        umask=case.umask,
        start_new_session=True,
    )
    with ThreadPoolExecutor(2) as readers:  # of pipes: a limit of file sizes would stop files
        stdout = readers.submit(_read, run.stdout, case.reads)
        stderr = readers.submit(_read, run.stderr, None)
        if run.stdin is not None:
            with suppress(BrokenPipeError):
                run.stdin.write(case.stdin)
                run.stdin.close()
        hung, memory = _wait(case, run)
        outliving = _outliving(case, run.pid, before)
        text = stderr.result().decode("utf-8", "replace")
        return Ended(run.returncode, stdout.result(), text, hung, memory, outliving)


def _read(stream: IO[bytes] | None, size: int | None) -> bytes:
    """Read a stream to its end, or only the first `size` bytes, and close it."""
    if stream is None:
        return b""
    with stream:
        return stream.read(-1 if size is None else size)


def _wait(case: Case, run: subprocess.Popen[bytes]) -> tuple[bool, int]:
    """Send the signals and wait; return whether the command hung, and its memory in bytes."""
    began = time.monotonic()
    due = sorted(case.signals)
    hung = False
    while True:
        pid, status, usage = os.wait4(run.pid, os.WNOHANG)
        if pid:
            run.returncode = os.waitstatus_to_exitcode(status)
            return hung, usage.ru_maxrss * 1024
        passed = time.monotonic() - began
        while due and passed >= due[0][0]:
            _, name, group = due.pop(0)
            (os.killpg if group else os.kill)(run.pid, getattr(signal, name))
        if passed > case.limit_s and not hung:
            hung = True
            os.killpg(run.pid, signal.SIGKILL)
        time.sleep(0.005)


def _outliving(case: Case, session: int, before: set[int]) -> list[str]:
    """Return the processes of an ended command that still run after a while, and kill them.

    `before` are the children that this process had before the command.
    """
    over = time.monotonic() + END_S
    mark = f"OPPLOAD_ATTACK={case.folder}\0".encode()  # with the end: case 1 is not case 12
    while found := _marked(mark, session):
        if time.monotonic() > over:
            for pid in found:
                with suppress(OSError):
                    os.kill(pid, signal.SIGKILL)
            break
        time.sleep(0.02)
    for pid in _children() - before:  # orphans that this process has adopted
        with suppress(ChildProcessError):
            os.waitpid(pid, os.WNOHANG)
    return [str(pid) for pid in found]


def _children() -> set[int]:
    """Return the children of this process, also those that have ended but still have an id."""
    pid = os.getpid()
    return {int(process.name) for process, fields in _processes() if int(fields[1]) == pid}


def _processes() -> Iterator[tuple[Path, list[str]]]:
    """Yield the folder in /proc of each process, and the fields of `stat` after the name."""
    for path in Path("/proc").iterdir():
        if path.name.isdecimal():
            with suppress(OSError):
                yield path, (path / "stat").read_text().rpartition(")")[2].split()


def _marked(mark: bytes, session: int) -> list[int]:
    """Return the processes that run in this session, or with this mark in their environment."""
    found = []
    for process, fields in _processes():
        with suppress(OSError):
            marked = mark in (process / "environ").read_bytes()
            if fields[0] != "Z" and (int(fields[3]) == session or marked):
                found.append(int(process.name))
    return found


def contents_of(folder: Path) -> dict[str, tuple[int, int, str]]:
    """Return kind, size and link target of all files of a case, except in its folder `out`."""
    found = {}
    for place, folders, files in os.walk(folder):
        if place == str(folder):
            folders[:] = [name for name in folders if name != "out"]
        for name in (*folders, *files):
            path = os.path.join(place, name)  # noqa: PTH118 - names of any bytes
            status = os.lstat(path)
            kind = stat.S_IFMT(status.st_mode)
            target = str(Path(path).readlink()) if stat.S_ISLNK(status.st_mode) else ""
            found[os.path.relpath(path, folder)] = kind, status.st_size * stat.S_ISREG(kind), target
    return found


def shared_memory() -> set[str]:
    """Return the names of shared memory on this machine."""
    return {each.name for each in SHARED.iterdir()} if SHARED.is_dir() else set()


def _is_used(name: str) -> bool:
    """Tell whether a process uses this shared memory."""
    for process, _ in _processes():
        with suppress(OSError):
            if name in (process / "maps").read_text():
                return True
    return False


def faults(case: Case) -> tuple[list[str], Ended]:
    """Run a case; return its faults in words, and the end of the command."""
    memory = shared_memory()
    before = contents_of(case.folder)
    ended = execute(case)
    wrong = faults_of_process(case, ended)
    after = contents_of(case.folder)
    for name in sorted(set(before) | set(after)):
        if before.get(name) != after.get(name):
            wrong.append(f"{name!r} outside the output folder has changed")
    wrong += [f"shared memory {name}" for name in shared_memory() - memory if not _is_used(name)]
    wrong += _faults_of_results(case, ended)
    return wrong, ended


def faults_of_process(case: Case, ended: Ended) -> list[str]:
    """Return the faults in the exit code, the messages, the memory and the processes."""
    wrong = []
    early = _ended_early(case, ended)
    if ended.hung:
        wrong.append(f"no end after {case.limit_s:g} s")
    elif ended.code not in case.codes and not early:
        wrong.append(f"exit code {ended.code}")
    if ended.code == 130 and not case.signals and case.reads is None:
        wrong.append("exit code 130 without an interrupt")
    lines = ended.stderr.splitlines()
    if not early:
        wrong += [f"standard error has '{word}'" for word in _WRONG_WORDS if word in ended.stderr]
        if len(lines) > _MOST_LINES + 2 * case.files + _remarks(case):
            wrong.append(f"{len(lines)} lines of standard error")
        if ended.code in {2, 3} and not lines:
            wrong.append(f"exit code {ended.code} without a message")
    if re.search("[\x00-\x08\x0b-\x1f\x7f]", ended.stderr.replace("\r", "")):
        wrong.append("a control character on standard error")
    if ended.memory > _MOST_MEMORY:
        wrong.append(f"took {ended.memory >> 20} MB")
    if ended.outliving:
        wrong.append(f"left processes: {', '.join(ended.outliving)}")
    return wrong


def _remarks(case: Case) -> int:
    """Return the number of remarks in the sidecars of a case; the command prints each of them."""
    count = 0
    # Some cases make a pipe in place of a sidecar; to read it would take for ever.
    for path in filter(Path.is_file, case.out.rglob("*.oppload.json")):
        with suppress(OSError, ValueError, KeyError, TypeError):  # damaged by the case itself
            count += len(json.loads(path.read_bytes())["remarks"])
    return count


def _ended_early(case: Case, ended: Ended) -> bool:
    """Tell whether a signal ended the command in a way that the program could not handle.

    The signal is SIGKILL, the second of two signals, or came while Python imported the program.
    """
    sent = {-getattr(signal, name) for _, name, _ in case.signals}
    if ended.code in sent and (ended.code == -signal.SIGKILL or len(case.signals) > 1):
        return True
    if not sent or ended.code not in {*sent, 1}:
        return False
    places = re.findall(r'File "[^"]*oppload_cli/[^"]*", line [0-9]+, in (.*)', ended.stderr)
    if "Traceback" in ended.stderr and any(name != "<module>" for name in places):
        return False
    return not any(case.out.iterdir())


def _faults_of_results(case: Case, ended: Ended) -> list[str]:
    """Return the faults of results: each must be complete, a readable `.part`, or absent."""
    wrong = []
    for path in sorted(case.out.rglob("*")):
        name = os.fsdecode(path.name)
        if path.is_symlink() or not path.is_file():
            continue
        if name.endswith(".part"):
            if ended.code == 0:
                wrong.append(f"{name!r} beside exit code 0")
            wrong += _faults_of_table(path, complete=False) if name.endswith(".csv.part") else []
        elif name.endswith(".frames.csv"):
            wrong += _faults_of_table(path, complete=True)
            wrong += _faults_of_sidecar(path, ended)
        elif name.endswith((".json", ".jsonl", ".csv")):
            wrong += _faults_of_text(path)
        elif not path.stat().st_size:
            wrong.append(f"{name!r} is empty")
        elif not path.read_bytes().rstrip().endswith(_ENDS.get(path.suffix, b"")):
            wrong.append(f"{name!r} is cut")
    return wrong


def _faults_of_table(path: Path, *, complete: bool) -> list[str]:
    with path.open(newline="", encoding="utf-8") as file:
        text = file.read()
    if not complete:
        text = text[: text.rfind("\n") + 1]
    elif not text.endswith("\n"):
        return [f"{path.name!r} ends within a row"]
    rows = list(csv.reader(_lines(text)))
    if not rows or "frame" not in rows[0]:
        return [f"{path.name!r} has no header"] if complete else []
    widths = {len(row) for row in rows}
    if len(widths) > 1:
        return [f"{path.name!r} has rows of {sorted(widths)} cells"]
    if ".frames.csv" not in path.name:  # `collect --frames` joins the rows of several inputs
        return []
    place = rows[0].index("frame")
    numbers = [row[place] for row in rows[1:]]
    if any(int(b) <= int(a) for a, b in pairwise(numbers)):
        return [f"{path.name!r} has frames out of order"]
    return []


def _faults_of_sidecar(table: Path, ended: Ended) -> list[str]:
    path = table.with_name(table.name.removesuffix(".frames.csv") + ".oppload.json")
    if not path.exists():
        return [f"{table.name!r} has no sidecar"]
    decode = json.loads(path.read_text(encoding="utf-8", errors="surrogateescape"))["decode"]
    rows = table.read_bytes().count(b"\n") - 1
    wrong = []
    if decode["analysed"] != rows:
        wrong.append(f"{table.name!r} has {rows} rows and not {decode['analysed']}")
    if ended.code == 0 and not decode["complete"]:
        wrong.append(f"{table.name!r} is incomplete, at exit code 0")
    return wrong


def _lines(text: str) -> StringIO:
    """Return the lines of a file; `str.splitlines` would also split at other characters."""
    return StringIO(text, newline="")


def _faults_of_text(path: Path) -> list[str]:
    try:
        text = path.read_text(encoding="utf-8", errors="surrogateescape")
        if path.suffix == ".csv":
            usual = csv.field_size_limit(sys.maxsize)
            try:
                widths = {len(row) for row in csv.reader(_lines(text))}
            finally:
                csv.field_size_limit(usual)
            return [f"{path.name!r} has rows of {sorted(widths)} cells"] if len(widths) > 1 else []
        for part in _lines(text) if path.suffix == ".jsonl" else [text]:
            json.loads(part)
    except (ValueError, csv.Error) as error:
        return [f"{path.name!r} cannot be read ({error})"]
    return []
