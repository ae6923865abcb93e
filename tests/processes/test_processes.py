"""Several processes: complete results in order, a process that dies, and an early end."""

from __future__ import annotations

import math
import os
import subprocess
import sys
from contextlib import closing
from functools import partial
from typing import TYPE_CHECKING

import pytest

from oppload_cli import processes
from oppload_cli.errors import OutputError, ParameterError
from oppload_cli.processes import pool
from oppload_cli.processes.pool import Event, Kind, events, outcomes, results
from tests.processes.work import (
    ends_itself,
    ends_well,
    halved,
    never_asks,
    squared,
    stopped_twice,
    waits,
    wrong,
)

if TYPE_CHECKING:
    from pathlib import Path


@pytest.mark.parametrize("jobs", [1, 9])
def test_results_keep_their_order(jobs: int) -> None:
    came: list[int] = []
    assert results(squared, [3, 1, 2], jobs, named=str, progress=came.append) == [9, 1, 4]
    assert sorted(came) == [1, 4, 9]
    assert results(squared, [], jobs, named=str) == []


@pytest.mark.parametrize("jobs", [1, 2])
def test_an_error_of_one_item_does_not_stop_the_others(jobs: int) -> None:
    told: list[int] = []
    done = dict(outcomes(halved, [4, 3, 6], jobs, named=str, on_message=told.append))
    assert sorted(told) == [0, 0, 0, 1, 1, 2]
    assert done[0] == 2
    assert isinstance(done[1], ParameterError)
    assert str(done[1]) == "3 is odd"
    assert done[2] == 3


@pytest.mark.long
def test_a_bug_is_raised_with_the_traceback_of_its_process() -> None:
    with pytest.raises(ZeroDivisionError) as met:
        results(wrong, [1, 2], 2, named=str)
    assert "return number // 0" in met.value.__notes__[0]


@pytest.mark.long
@pytest.mark.skipif(sys.platform == "win32", reason="signals are of POSIX")
def test_a_process_that_dies_takes_only_its_item_along() -> None:
    done = dict(outcomes(ends_itself, [1, 2, 3, 4], 2, named="number {}".format))
    assert [done[position] for position in (0, 2, 3)] == [1, 3, 4]
    assert isinstance(done[1], OutputError)
    assert str(done[1]) == (
        "number 2: its process was ended from outside (SIGKILL); check the memory, "
        "or use fewer --jobs"
    )


@pytest.mark.long
@pytest.mark.skipif(sys.platform == "win32", reason="signals are of POSIX")
def test_an_early_end_stops_the_processes_which_may_clean_up(tmp_path: Path) -> None:
    pids: list[int] = []
    with closing(events(partial(waits, tmp_path), range(9), 2)) as happening:
        for kind, _, content in happening:
            if kind is Kind.MESSAGE:
                pids.append(content)
            if len(pids) == 2:
                break
    for pid in pids:
        with pytest.raises(ProcessLookupError):
            os.kill(pid, 0)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["0", "1"]


@pytest.mark.long
@pytest.mark.skipif(sys.platform == "win32", reason="signals are of POSIX")
def test_results_that_processes_send_when_they_are_stopped_are_not_lost(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    happened: list[Event] = []
    items = iter([4, 5, 6])

    def stop_if_asked() -> None:
        if [event.kind for event in happened].count(Kind.MESSAGE) == 2:
            raise KeyboardInterrupt

    monkeypatch.setattr(pool, "stop_if_asked", stop_if_asked)
    with pytest.raises(KeyboardInterrupt):
        list(map(happened.append, events(ends_well, items, 2)))
    assert set(happened[-2:]) == {Event(Kind.DONE, 4, 4), Event(Kind.DONE, 5, 5)}
    assert next(items) == 6  # no process has begun with it


@pytest.mark.long
@pytest.mark.skipif(sys.platform == "win32", reason="signals are of POSIX")
def test_a_process_that_does_not_stop_is_killed(tmp_path: Path) -> None:
    with closing(events(partial(never_asks, tmp_path), [1], 1)) as happening:
        pid = next(content for kind, _, content in happening if kind is Kind.MESSAGE)
    assert not list(tmp_path.iterdir())
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)


@pytest.mark.skipif(sys.platform == "win32", reason="signals are of POSIX")
def test_a_process_that_is_stopped_twice_cleans_up_all_the_same(tmp_path: Path) -> None:
    happened = list(events(partial(stopped_twice, tmp_path), [7], 1))
    died = "ended from outside (exit code 0); check the memory, or use fewer --jobs"
    assert happened == [Event(Kind.BEGUN, 7), Event(Kind.DIED, 7, died)]
    assert (tmp_path / "7").exists()


KILLED = """
import os, signal, sys
from functools import partial
from pathlib import Path
from oppload_cli.processes.pool import Kind, events
from tests.processes.work import waits

for kind, *_ in events(partial(waits, Path(sys.argv[1])), [1], 1):
    if kind is Kind.MESSAGE:
        os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.long
@pytest.mark.skipif(sys.platform == "win32", reason="signals are of POSIX")
def test_a_process_ends_with_a_main_process_that_is_killed(tmp_path: Path) -> None:
    words = [sys.executable, "-c", KILLED, str(tmp_path)]
    path = os.pathsep.join(sys.path)
    # Both processes hold the pipe of this test: it closes when both have ended.
    done = subprocess.run(
        words, capture_output=True, check=False, timeout=30, env={**os.environ, "PYTHONPATH": path}
    )
    assert (done.returncode, done.stdout, done.stderr) == (-9, b"", b"")
    assert (tmp_path / "1").exists()  # it had time to clean up


SIGHUP_FOR_ALL = """
import os, signal, time
from multiprocessing import resource_tracker
from oppload_cli.processes.pool import results

if __name__ == "__main__":
    signal.signal(signal.SIGHUP, lambda *_: None)
    for item in results(abs, [1, -2], 2, named=str):
        os.killpg(0, signal.SIGHUP)
        time.sleep(0.2)  # a process that the signal ends has ended by then
        resource_tracker.register(f"/item-{item}", "shared_memory")
        resource_tracker.unregister(f"/item-{item}", "shared_memory")
"""


@pytest.mark.long
@pytest.mark.skipif(sys.platform == "win32", reason="no POSIX signals")
def test_a_hangup_of_all_processes_leaves_pythons_own_ones(tmp_path: Path) -> None:
    (tmp_path / "script.py").write_text(SIGHUP_FOR_ALL)
    done = subprocess.run(
        [sys.executable, tmp_path / "script.py"],
        capture_output=True,
        text=True,
        check=False,
        start_new_session=True,
    )
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.long
def test_events_of_an_item() -> None:
    assert list(events(halved, [4], 1)) == [
        Event(Kind.BEGUN, 4),
        Event(Kind.MESSAGE, 4, 0),
        Event(Kind.MESSAGE, 4, 1),
        Event(Kind.DONE, 4, 2),
    ]


@pytest.mark.parametrize(
    ("groups", "files", "quota"),
    [
        ("0::/", {"cpu.max": "150000 100000"}, 1.5),
        ("0::/", {"cpu.max": "max 100000"}, math.inf),
        ("0::/", {"cpu.max": "wrong"}, math.inf),
        ("0::/a/b", {"a/b/cpu.max": "max 100000", "a/cpu.max": "300000 100000"}, 3),
        ("0::/a", {"a/cpu.max": "200000 100000", "cpu.max": "100000 100000"}, 1),
        ("0::/of/the/host", {"cpu.max": "50000 100000"}, 0.5),  # within a container
        (
            "4:memory:/m\n3:cpu,cpuacct:/a",
            {"cpu/a/cpu.cfs_quota_us": "400000", "cpu/a/cpu.cfs_period_us": "100000"},
            4,
        ),
        ("3:cpu:/", {"cpu/cpu.cfs_quota_us": "-1", "cpu/cpu.cfs_period_us": "100000"}, math.inf),
        ("2:cpuset:/\nwrong\n\n", {"cpu.max": "100000 100000"}, math.inf),
        (None, {}, math.inf),
    ],
)
def test_the_cores_of_a_container_are_those_of_its_control_groups(
    groups: str | None,
    files: dict[str, str],
    quota: float,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    if groups is not None:
        (tmp_path / "own").write_text(groups)
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    monkeypatch.setattr(processes, "_GROUPS", tmp_path)
    monkeypatch.setattr(processes, "_OWN_GROUPS", tmp_path / "own")
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 2, 4}, raising=False)
    processes._quota.cache_clear()
    try:
        assert processes._quota() == quota
        assert processes.cores() == math.ceil(min(3, quota))
    finally:
        processes._quota.cache_clear()
