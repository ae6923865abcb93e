"""Run one command under its limits, and say what is wrong with what it leaves behind."""

from __future__ import annotations

import csv
import ctypes
import json
import os
import re
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
from typing import IO

ENTRY = "from oppload_cli.__main__ import entry; entry()"  # as the installed script has it
COMMAND = (sys.executable, "-c", ENTRY)
CODES = frozenset({0, 2, 3, 4, 5, 130})  # docs/formats.md, without 1: a bug
LIMIT_S = 90.0  # a server that stalls takes 10 s, a busy machine some more
END_S = 15.0  # within this after the command, its processes have ended too, on a busy machine
MOST_MEMORY = 3 << 30
MOST_LINES = 10  # of standard error, and two for each input, and one for each remark
WRONG_WORDS = (
    *("Traceback", "this is a bug", "Fatal Python error", "Exception ignored", "terminate called"),
    *("Segmentation fault", "resource_tracker", "MemoryError", "Unraisable", "core dumped"),
    *(
        "Error in atexit",
        "Warning:",
        "[mov,",
        "[h264 @",
        "[swscaler",
        "<jemalloc>",
        "spawn new thread",
    ),
)
ENDS = {
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
    """One command, and all that is done to it.

    Its folder has `in` for its files, `out` for its results, `home` and `tmp`. Nothing but
    `out` may change.
    """

    family: str
    number: int
    folder: Path
    words: list[str] = field(default_factory=list)
    files: int = 1  # given to the command
    limits: dict[str, int] = field(default_factory=dict)  # by the names of prlimit's options
    signals: list[tuple[float, str, bool]] = field(default_factory=list)  # after s, to the group
    stdin: bytes = b""
    user: int = 0  # to run as, 0: the same
    reads: int | None = None  # the reader of standard output goes after so many bytes
    around: list[AbstractContextManager[object]] = field(default_factory=list)  # servers, disks
    command: tuple[str, ...] = COMMAND
    codes: frozenset[int] = CODES
    limit_s: float = LIMIT_S

    @property
    def out(self) -> Path:
        """The only folder that the command may write into."""
        return self.folder / "out"


@dataclass
class Ended:
    """How a command ended."""

    code: int
    stdout: bytes
    stderr: str
    hung: bool
    memory: int  # the most of any process, bytes
    left: list[str]  # processes that outlived it


def prepared(family: str, number: int, folder: Path) -> Case:
    """Return a case with its folders."""
    for name in ("in", "out", "home", "tmp"):
        (folder / name).mkdir(parents=True)
    return Case(family, number, folder)


def adopt_orphans() -> None:
    """Become the parent of processes whose own parent has ended, so that none is missed."""
    with suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(_SUBREAPER, 1, 0, 0, 0)


def execute(case: Case) -> Ended:
    """Run the command of a case to its end, or until its time is over."""
    cache = str(case.folder.parent / "cache")
    home = str(case.folder / "home")
    environment = {
        **{name: os.environ[name] for name in ("PATH", "LANG", "PYTHONPATH") if name in os.environ},
        "HOME": home,
        "XDG_CACHE_HOME": cache,
        "TMPDIR": str(case.folder / "tmp"),
        "MPLCONFIGDIR": cache,
        "PYTHONDONTWRITEBYTECODE": "1",
        "OPPLOAD_ATTACK": str(case.folder),
    }

    limited = [f"--{name}={amount}" for name, amount in case.limits.items()]
    if limited:
        limited = ["prlimit", *limited, "--"]
    if case.user:  # one who may read all the same, as root may
        rights = "+dac_override,+dac_read_search"
        user = [f"--reuid={case.user}", f"--regid={case.user}", "--clear-groups"]
        limited = [
            *("setpriv", *user, f"--inh-caps={rights}", f"--ambient-caps={rights}"),
            *limited,
        ]
    before = _children()
    run = subprocess.Popen(
        [*limited, *case.command, *case.words],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        cwd=case.folder / "in",
        env=environment,
        start_new_session=True,
    )
    with ThreadPoolExecutor(2) as readers:  # pipes, as limits would hold for files
        shown = readers.submit(_all_of, run.stdout, case.reads)
        said = readers.submit(_all_of, run.stderr, None)
        if run.stdin is not None:
            with suppress(BrokenPipeError):
                run.stdin.write(case.stdin)
                run.stdin.close()
        hung, memory = _wait(case, run)
        left = _outliving(case, run.pid, before)
        text = said.result().decode("utf-8", "replace")
        return Ended(run.returncode, shown.result(), text, hung, memory, left)


def _all_of(stream: IO[bytes] | None, size: int | None) -> bytes:
    """Read a stream to its end, or only so many bytes of it, and close it."""
    if stream is None:
        return b""
    with stream:
        return stream.read() if size is None else stream.read(size)


def _wait(case: Case, run: subprocess.Popen[bytes]) -> tuple[bool, int]:
    """Send the signals, and wait; return whether it hung, and the memory that it took."""
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
    """Return the processes of a command that has ended, after some time for them to end too.

    `before` are the children that this process had before the command.
    """
    over = time.monotonic() + END_S
    mark = f"OPPLOAD_ATTACK={case.folder}\0".encode()  # of this case, and of none like 1 and 12
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
    """Return the children of this process, zombies among them."""
    found = set()
    for process in _processes():
        with suppress(OSError):
            fields = (process / "stat").read_text().rpartition(")")[2].split()
            if int(fields[1]) == os.getpid():
                found.add(int(process.name))
    return found


def _processes() -> list[Path]:
    return [path for path in Path("/proc").iterdir() if path.name.isdecimal()]


def _marked(mark: bytes, session: int) -> list[int]:
    """Return the processes that run in this session, or with this mark in their environment."""
    found = []
    for process in _processes():
        with suppress(OSError):
            fields = (process / "stat").read_text().rpartition(")")[2].split()
            marked = mark in (process / "environ").read_bytes()
            if fields[0] != "Z" and (int(fields[3]) == session or marked):
                found.append(int(process.name))
    return found


def seen(folder: Path) -> dict[str, tuple[int, int, str]]:
    """Return all that lies below the folder of a case, besides its results: kind, size, target."""
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


def _held(name: str) -> bool:
    """Tell whether a process that still runs uses this shared memory."""
    for process in _processes():
        with suppress(OSError):
            if name in (process / "maps").read_text():
                return True
    return False


def faults(case: Case) -> tuple[list[str], Ended]:
    """Run a case; return what is wrong, in words, and how the command ended."""
    memory = shared_memory()
    before = seen(case.folder)
    ended = execute(case)
    wrong = faults_of_process(case, ended)
    after = seen(case.folder)
    for name in sorted(set(before) | set(after)):
        if before.get(name) != after.get(name):
            wrong.append(f"{name!r} outside the output folder has changed")
    wrong += [f"shared memory {name}" for name in shared_memory() - memory if not _held(name)]
    wrong += faults_of_results(case, ended)
    return wrong, ended


def faults_of_process(case: Case, ended: Ended) -> list[str]:
    """Return what is wrong with the end of a command, and with what it said."""
    wrong = []
    early = _ended_before_the_program(case, ended)
    if ended.hung:
        wrong.append(f"no end after {case.limit_s:g} s")
    elif ended.code not in case.codes and not early:
        wrong.append(f"exit code {ended.code}")
    if ended.code == 130 and not case.signals and case.reads is None:
        wrong.append("interrupted by nobody")
    lines = ended.stderr.splitlines()
    if not early:
        words = [word for word in WRONG_WORDS if word in ended.stderr]
        wrong += [f"standard error has '{word}'" for word in words]
        if len(lines) > MOST_LINES + 2 * case.files + _remarks(case):
            wrong.append(f"{len(lines)} lines of standard error")
        if ended.code in {2, 3} and not lines:
            wrong.append(f"exit code {ended.code} without a word")
    if re.search("[\x00-\x08\x0b-\x1f\x7f]", ended.stderr.replace("\r", "")):
        wrong.append("a control character on standard error")
    if ended.memory > MOST_MEMORY:
        wrong.append(f"took {ended.memory >> 20} MB")
    if ended.left:
        wrong.append(f"left processes: {', '.join(ended.left)}")
    return wrong


def _remarks(case: Case) -> int:
    """Return how many remarks the sidecars of a case state: the command prints a line for each."""
    count = 0
    # A case may have put a pipe there, which nobody writes to.
    for path in filter(Path.is_file, case.out.rglob("*.oppload.json")):
        with suppress(OSError, ValueError, KeyError, TypeError):  # damaged by the case itself
            count += len(json.loads(path.read_bytes())["remarks"])
    return count


def _ended_before_the_program(case: Case, ended: Ended) -> bool:
    """Tell whether a signal came before the first line of the program, or could not be answered."""
    sent = {-getattr(signal, name) for _, name, _ in case.signals}
    if -signal.SIGKILL in sent and ended.code == -signal.SIGKILL:
        return True
    several = len(case.signals) > 1  # the second one ends the process as the system has it
    if not sent or (ended.code not in sent and ended.code != 1):
        return False
    if several and ended.code in sent:
        return True
    if "Traceback" in ended.stderr:
        # While the program is imported, Python itself answers.
        places = re.findall(r'File "[^"]*oppload_cli/[^"]*", line [0-9]+, in (.*)', ended.stderr)
        if any(name != "<module>" for name in places):
            return False
    return not any(case.out.iterdir())


def faults_of_results(case: Case, ended: Ended) -> list[str]:
    """Return what is wrong with the results: each is complete, a readable `.part`, or absent."""
    wrong = []
    for path in sorted(case.out.rglob("*")):
        name = os.fsdecode(path.name)
        if path.is_symlink() or not path.is_file():
            continue
        if name.endswith(".part"):
            if ended.code == 0:
                wrong.append(f"{name!r} beside exit code 0")
            wrong += _faults_of_table(path, whole=False) if name.endswith(".csv.part") else []
        elif name.endswith(".frames.csv"):
            wrong += _faults_of_table(path, whole=True)
            wrong += _faults_of_sidecar(path, ended)
        elif name.endswith((".json", ".jsonl", ".csv")):
            wrong += _faults_of_text(path)
        elif not path.stat().st_size:
            wrong.append(f"{name!r} is empty")
        elif not path.read_bytes().rstrip().endswith(ENDS.get(path.suffix, b"")):
            wrong.append(f"{name!r} is cut")
    return wrong


def _faults_of_table(path: Path, *, whole: bool) -> list[str]:
    with path.open(newline="", encoding="utf-8") as file:
        text = file.read()
    if not whole:
        text = text[: text.rfind("\n") + 1]
    elif not text.endswith("\n"):
        return [f"{path.name!r} ends within a row"]
    rows = list(csv.reader(_lines(text)))
    if not rows or "frame" not in rows[0]:
        return [f"{path.name!r} has no header"] if whole else []
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
    """Return the lines of a file; `str.splitlines` also cuts at separators that are no ends."""
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
