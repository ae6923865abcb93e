"""The attack itself: it finds what is planted, and gives the same cases for the same seed."""

from __future__ import annotations

import json
import multiprocessing
import os
import re
import subprocess
import sys
import tempfile
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from random import Random

import pytest

from tools.attack import judge
from tools.attack.campaign import Judged, isolate, keep, main, table
from tools.attack.families import FAMILIES, family_of, make_case, make_material
from tools.attack.judge import Case, Ended, faults, faults_of_process, prepared, shared_memory
from tools.attack.media import WAYS
from tools.attack.server import Server

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")

TABLE = "frame,time_s\\n0,0\\n1,0.1\\n"
RESULT = (
    f"open('../out/a.frames.csv', 'w').write('{TABLE}'); "
    "open('../out/a.oppload.json', 'w').write('{\"decode\": {\"analysed\": %s, \"complete\": %s}}')"
)
PLANTED = {
    "raise ValueError": ["exit code 1", "standard error has 'Traceback'"],
    "sys.exit('oppload: this is a bug')": ["exit code 1", "standard error has 'this is a bug'"],
    "print('x\\n' * 99, file=sys.stderr)": ["100 lines of standard error"],
    "print('\\x1b', file=sys.stderr)": ["a control character on standard error"],
    "sys.exit(2)": ["exit code 2 without a message"],
    "os.kill(os.getpid(), 11)": ["exit code -11"],
    "sys.exit(130)": ["exit code 130 without an interrupt"],
    "time.sleep(60)": ["no end after 1 s"],
    "open('../escaped', 'w')": ["'escaped' outside the output folder has changed"],
    "open('../in/mine', 'w')": ["'in/mine' outside the output folder has changed"],
    "open('../out/a.csv.part', 'w')": ["'a.csv.part' beside exit code 0"],
    "open('../out/a.png', 'w')": ["'a.png' is empty"],
    "open('../out/a.png', 'w').write('half')": ["'a.png' is cut"],
    "open('../out/a.json', 'w').write('{')": ["'a.json' cannot be read (*)"],
    f"open('../out/a.frames.csv', 'w').write('{TABLE}')": ["'a.frames.csv' has no sidecar"],
    "open('../out/a.frames.csv', 'w').write('frame,time_s\\n0,0\\n1')": [
        "'a.frames.csv' ends within a row",
        "'a.frames.csv' has no sidecar",
    ],
    "open('../out/a.frames.csv', 'w').write('frame\\n1\\n0\\n')": [
        "'a.frames.csv' has frames out of order",
        "'a.frames.csv' has no sidecar",
    ],
    "open('../out/a.frames.csv', 'w').write('frame,time_s\\n0,0\\n1\\n')": [
        "'a.frames.csv' has rows of [1, 2] cells",
        "'a.frames.csv' has no sidecar",
    ],
    "open('../out/a.csv', 'w').write('a,b\\n1\\n')": ["'a.csv' has rows of [1, 2] cells"],
    RESULT % (2, "true"): [],
    RESULT % (3, "true"): ["'a.frames.csv' has 2 rows and not 3"],
    RESULT % (2, "false"): ["'a.frames.csv' is incomplete, at exit code 0"],
    f"{RESULT % (2, 'false')}; print('a word', file=sys.stderr); sys.exit(4)": [],
    "subprocess.Popen(['sleep', '60'], start_new_session=True)": ["left processes: *"],
    "os.fork() or time.sleep(60)": ["left processes: *"],
    "open('../../shm/planted', 'w')": ["shared memory planted"],
    "open('../out/a.csv', 'w').write('a,b\\n1,2\\n')": [],
    "print('a word', file=sys.stderr); sys.exit(4)": [],
}


def planted(folder: Path, code: str) -> Case:
    case = prepared("planted", 0, folder / "case")
    case.command = (sys.executable, "-S", "-c", f"import os, subprocess, sys, time\n{code}")
    case.limit_s = 1
    return case


def end(code: int, stderr: str = "", memory: int = 0) -> Ended:
    return Ended(code, b"", stderr, hung=False, memory=memory, outliving=[])


@pytest.mark.parametrize("code", PLANTED)
def test_what_is_planted_is_found(
    code: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(judge, "END_S", 0.2)
    monkeypatch.setattr(judge, "SHARED", tmp_path / "shm")  # other tests use that of the machine
    (tmp_path / "shm").mkdir()
    wrong, _ = faults(planted(tmp_path, code))
    patterns = [re.escape(each).replace(r"\*", ".*") for each in PLANTED[code]]
    assert len(wrong) == len(patterns), wrong
    for pattern, each in zip(patterns, wrong, strict=True):
        assert re.fullmatch(pattern, each)


@pytest.mark.parametrize(("lines", "wrong"), [(17, []), (18, ["18 lines of standard error"])])
def test_remarks_may_have_a_line_each(tmp_path: Path, lines: int, wrong: list[str]) -> None:
    case = prepared("x", 0, tmp_path / "0")
    case.files = 2
    for name, text in (
        ("a", '{"remarks": ["short", "assumed"]}'),
        ("b", '{"remarks": ["short"]}'),
        ("c", "{"),
    ):
        (case.out / f"{name}.oppload.json").write_text(text)
    assert faults_of_process(case, end(0, "x\n" * lines)) == wrong


SIGNAL = (0.1, "SIGTERM", False)
PLACE = 'Traceback\n  File "/oppload_cli/a.py", line 1, in {}\n'


@pytest.mark.parametrize(
    ("signals", "ended", "results", "wrong"),
    [
        ([SIGNAL], end(-15), False, []),  # during the start
        ([SIGNAL], end(-15), True, ["exit code -15"]),
        ([SIGNAL, SIGNAL], end(-15), True, []),
        ([(0.1, "SIGKILL", False)], end(-9), True, []),
        ([], end(-9), False, ["exit code -9"]),
        ([SIGNAL], end(1, PLACE.format("<module>")), False, []),
        (
            [SIGNAL],
            end(1, PLACE.format("run")),
            False,
            ["exit code 1", "standard error has 'Traceback'"],
        ),
    ],
)
def test_a_signal_may_end_a_command_only_before_it_handles_signals(
    tmp_path: Path,
    signals: list[tuple[float, str, bool]],
    ended: Ended,
    results: bool,
    wrong: list[str],
) -> None:
    case = prepared("x", 0, tmp_path / "0")
    case.signals = signals
    if results:
        (case.out / "a.csv").touch()
    assert faults_of_process(case, ended) == wrong


def test_too_much_memory_is_a_fault(tmp_path: Path) -> None:
    case = prepared("x", 0, tmp_path / "0")
    assert faults_of_process(case, end(0, memory=4 << 30)) == ["took 4096 MB"]


def test_a_name_with_a_separator_ends_no_row(tmp_path: Path) -> None:
    table = r"open('../out/all.csv', 'w').write('a,b\nx\x1dy,1\n')"
    assert faults(planted(tmp_path, table))[0] == []


def test_a_case_that_failed_is_kept(tmp_path: Path) -> None:
    case = planted(tmp_path, "sys.exit('bad')")
    case.words = ["run", "a b.avi"]
    (case.folder / "in" / "a b.avi").write_bytes(b"damaged")
    wrong, ended = faults(case)
    keep(case, ended, wrong, tmp_path / "kept" / "planted-1-0")
    facts = json.loads((tmp_path / "kept" / "planted-1-0" / "case.json").read_text())
    assert (facts["wrong"], facts["stderr"]) == (["exit code 1"], "bad\n")
    assert facts["command"].endswith("-m oppload_cli run 'a b.avi'")
    assert (tmp_path / "kept" / "planted-1-0" / "in" / "a b.avi").read_bytes() == b"damaged"


def test_the_processes_of_another_case_are_left_alone(tmp_path: Path) -> None:
    with subprocess.Popen(
        ["sleep", "60"],
        env={**os.environ, "OPPLOAD_ATTACK": str(tmp_path / "case2")},
        start_new_session=True,
    ) as other:
        case = prepared("planted", 0, tmp_path / "case")
        case.command = (sys.executable, "-S", "-c", "pass")
        try:
            assert faults(case)[0] == []
            assert other.poll() is None
        finally:
            other.kill()


def test_a_child_of_the_caller_is_not_taken_for_an_orphan(tmp_path: Path) -> None:
    with subprocess.Popen([sys.executable, "-S", "-c", "raise SystemExit(7)"]) as other:
        os.waitid(os.P_PID, other.pid, os.WEXITED | os.WNOWAIT)
        assert faults(planted(tmp_path, "pass"))[0] == []
        assert other.wait() == 7


@pytest.mark.long
def test_cases_beside_each_other_do_not_share_memory() -> None:
    if os.geteuid() != 0 or subprocess.run(["unshare", "--mount", "true"], check=False).returncode:
        pytest.skip("NOT TESTED: mounting needs root")
    spawn = multiprocessing.get_context("spawn")
    with (
        tempfile.NamedTemporaryFile(dir=judge.SHARED) as other,
        ProcessPoolExecutor(1, mp_context=spawn, initializer=isolate) as pool,
    ):
        name = Path(other.name).name
        assert name in shared_memory()
        assert name not in pool.submit(shared_memory).result()


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of an attack, so that its files are made once."""
    return tmp_path_factory.mktemp("attack")


@pytest.mark.slow
def test_the_same_seed_gives_the_same_cases(folder: Path, tmp_path: Path) -> None:
    material = make_material(folder / "work")
    for number in range(40):
        cases = [
            make_case(number, tmp_path / name / "case", material, Random(f"3 {number}"))  # noqa: S311
            for name in (f"a{number}", f"b{number}")
        ]
        first, second = (
            (
                *(case.family, case.files, case.limits, case.signals, case.environment),
                judge.contents_of(case.folder),
            )
            for case in cases
        )
        for server in (each for case in cases for each in case.around):
            if isinstance(server, Server):
                server.server_close()
        if cases[0].family not in {"disks", "servers", "cameras"}:  # paths and ports are their own
            assert first == second
            assert cases[0].words == cases[1].words


@pytest.mark.slow
def test_some_cases_of_the_attack(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = shared_memory()
    code = main(["--cases", "10", "--seed", "1", "--jobs", "2", "--folder", str(folder)])
    done = capsys.readouterr()
    assert code == 0, done.err
    assert done.out.splitlines()[-1].split()[:3] == ["all", "10", "0"]
    assert list(folder.iterdir()) == []
    assert shared_memory() - before == set()


def test_the_families_have_their_shares_and_the_page_states_them() -> None:
    weights = {name: weight for name, (weight, _) in FAMILIES.items()}
    every = sum(weights.values())
    assert Counter(map(family_of, range(every))) == weights
    page = Path(__file__).parents[1] / "docs" / "development" / "robustness.md"
    text = page.read_text("utf-8")
    assert f"damaged in {len(WAYS)} ways" in text
    rows = re.findall(r"^\| (`.*`) \| (\d+) % \|", text, re.MULTILINE)
    stated = {tuple(re.findall(r"`(\w+)`", names)): int(share) for names, share in rows}
    assert {name for names in stated for name in names} == weights.keys()
    for names, share in stated.items():
        assert share == round(100 * sum(weights[name] for name in names) / every)


def test_the_table_counts_failures() -> None:
    verdicts = [Judged("names", 0, 0, 1.5, ()), Judged("names", 1, 1, 0.5, ("exit code 1",))]
    lines = table([*verdicts, Judged("lists", 2, 0, 0.1, ())]).splitlines()
    assert [line.split()[:4] for line in lines[1:]] == [
        ["names", "2", "1", "1.5"],
        ["lists", "1", "0", "0.1"],
        ["all", "3", "1", "1.5"],
    ]
    assert lines[1].endswith("0: 1, 1: 1")
