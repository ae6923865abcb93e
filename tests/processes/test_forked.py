"""A copy of this process: items in order, errors passed on, none left behind."""

from __future__ import annotations

import faulthandler
import os
import signal
import sys
import threading
import time
from pathlib import Path

import pytest

from oppload_cli.errors import SourceError
from oppload_cli.processes.forked import DiedError, Forked, Outlet, can_fork

pytestmark = [
    pytest.mark.skipif(sys.platform != "linux", reason="copies are made on Linux only"),
    # Other tests have left threads here. The copies of these tests need nothing of theirs.
    pytest.mark.filterwarnings("ignore:.*multi-threaded:DeprecationWarning"),
]


def is_there(process: int) -> bool:
    """Whether a process runs, and is not merely waited for."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except FileNotFoundError:
        return False


def check_ended(process: int) -> None:
    deadline = time.monotonic() + 5
    while is_there(process):
        assert time.monotonic() < deadline
        time.sleep(0.01)


def count(outlet: Outlet) -> None:
    for number in range(outlet.hear()):
        outlet.send((number, os.getpid()))


def test_items_come_in_order_from_another_process() -> None:
    copy = Forked(count)
    copy.tell(1000)
    items = list(copy)
    assert [number for number, _ in items] == list(range(1000))
    assert {process for _, process in items} != {os.getpid()}
    assert list(copy) == []
    copy.close()
    check_ended(items[0][1])


def test_an_item_of_a_megabyte_passes_whole() -> None:
    copy = Forked(lambda outlet: outlet.send(outlet.hear()[::-1]))
    copy.tell(b"ab" * (1 << 14))
    assert next(copy) == b"ba" * (1 << 14)
    copy.close()
    copy = Forked(lambda outlet: outlet.send(bytes(1 << 20)))
    assert next(copy) == bytes(1 << 20)
    copy.close()


def test_no_more_items_are_in_use_than_it_waits_for(tmp_path: Path) -> None:
    def make(outlet: Outlet) -> None:
        for number in range(20):
            outlet.wait(3)
            (tmp_path / str(number)).touch()
            outlet.send(number)

    copy = Forked(make)
    for number in copy:
        time.sleep(0.02)  # it has time to go too far
        assert len(list(tmp_path.iterdir())) <= number + 4
    copy.close()
    assert len(list(tmp_path.iterdir())) == 20


class TwoWordsError(Exception):
    """Cannot be made again from its message alone."""

    def __init__(self, one: str, two: str) -> None:
        super().__init__(f"{one} {two}")


@pytest.mark.parametrize(
    ("raised", "arrives"),
    [
        (SourceError("a.mp4: is no video"), SourceError),
        (ValueError("wrong"), ValueError),
        (EOFError("the decoder met its end"), EOFError),
        (BrokenPipeError("the decoder lost its file"), BrokenPipeError),
        (TwoWordsError("one", "two"), RuntimeError),
    ],
)
def test_what_it_raises_is_raised_after_its_items(
    raised: Exception, arrives: type[Exception]
) -> None:
    def make(outlet: Outlet) -> None:
        outlet.send(1)
        raise raised

    copy = Forked(make)
    assert next(copy) == 1
    with pytest.raises(arrives, match=str(raised)) as caught:
        next(copy)
    assert "in make" in caught.value.__notes__[0]
    copy.close()


@pytest.mark.parametrize("name", ["SIGSEGV", "SIGKILL"])
def test_a_death_is_told_after_its_items(name: str) -> None:
    def make(outlet: Outlet) -> None:
        faulthandler.disable()  # the story would be printed among the tests
        outlet.send(1)
        outlet.send(2)
        os.kill(os.getpid(), getattr(signal, name))

    copy = Forked(make)
    assert [next(copy), next(copy)] == [1, 2]
    with pytest.raises(DiedError, match=name):
        next(copy)
    copy.close()


def test_closing_ends_it_at_once() -> None:
    def make(outlet: Outlet) -> None:
        outlet.send(os.getpid())
        time.sleep(60)

    files = len(list(Path("/proc/self/fd").iterdir()))
    copy = Forked(make)
    process = next(copy)
    copy.close()
    copy.close()
    assert not Path(f"/proc/{process}").exists()
    assert len(list(Path("/proc/self/fd").iterdir())) == files


def test_closing_while_a_thread_waits_for_an_item() -> None:
    def make(outlet: Outlet) -> None:
        outlet.send(0)
        time.sleep(60)

    for _ in range(20):
        copy = Forked(make)
        assert next(copy) == 0
        caught: list[BaseException] = []

        def wait(copy: Forked = copy, caught: list[BaseException] = caught) -> None:
            try:
                next(copy)
            except BaseException as error:
                caught.append(error)

        thread = threading.Thread(target=wait)
        thread.start()
        time.sleep(0.005)
        copy.close()
        thread.join(5)
        assert not thread.is_alive()
        assert isinstance(caught[0], DiedError | StopIteration)


def test_it_ends_with_the_one_it_was_copied_from(tmp_path: Path) -> None:
    def make(outlet: Outlet) -> None:
        (tmp_path / str(os.getpid())).touch()
        outlet.send(0)
        outlet.wait(0)

    def make_one_and_die(_: Outlet) -> None:
        next(Forked(make))
        os.kill(os.getpid(), signal.SIGKILL)

    copy = Forked(make_one_and_die)
    with pytest.raises(DiedError):
        next(copy)
    copy.close()
    (process,) = tmp_path.iterdir()
    check_ended(int(process.name))


def test_ctrl_c_does_not_reach_it() -> None:
    def make(outlet: Outlet) -> None:
        for name in ("SIGINT", "SIGTERM", "SIGHUP"):
            os.kill(os.getpid(), getattr(signal, name))
        outlet.send("still here")

    copy = Forked(make)
    assert next(copy) == "still here"
    copy.close()
    assert signal.getsignal(signal.SIGINT) is not signal.SIG_IGN


def test_it_is_loaded_where_there_is_no_sighup(monkeypatch: pytest.MonkeyPatch) -> None:
    import importlib.util

    from oppload_cli.processes import forked

    monkeypatch.delattr(signal, "SIGHUP")  # as on Windows, where nothing is copied
    found = importlib.util.spec_from_file_location("forked_elsewhere", str(forked.__file__))
    assert found is not None
    assert found.loader is not None
    found.loader.exec_module(importlib.util.module_from_spec(found))


def test_a_process_with_threads_is_not_copied() -> None:
    release = threading.Event()
    thread = threading.Thread(target=release.wait)
    thread.start()
    assert not can_fork()
    release.set()
    thread.join()
