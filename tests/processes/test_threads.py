"""Threads that work ahead of their caller."""

from __future__ import annotations

import threading
from itertools import count
from queue import SimpleQueue
from time import sleep
from typing import TYPE_CHECKING

import pytest

from oppload_cli.errors import SourceError
from oppload_cli.processes import threads
from oppload_cli.processes.threads import Call, Prefetch
from oppload_cli.processes.threads import _close_all as before_exit

if TYPE_CHECKING:
    from collections.abc import Iterator


def test_prefetching_keeps_order_and_joins() -> None:
    before = threading.active_count()
    items = Prefetch(iter(range(20)), ahead=2)
    assert list(items) == list(range(20))
    assert list(items) == []
    items.close()
    assert threading.active_count() == before


def failing() -> Iterator[int]:
    yield 1
    raise SourceError("gone")


def test_an_error_in_the_thread_is_raised_after_the_items_before_it() -> None:
    items = Prefetch(failing())
    assert next(items) == 1
    with pytest.raises(SourceError, match="gone"):
        next(items)
    items.close()


def test_closing_ends_a_thread_that_waits_for_its_caller() -> None:
    made: SimpleQueue[int] = SimpleQueue()

    def counting() -> Iterator[int]:
        for number in count():
            made.put(number)
            yield number

    items = Prefetch(counting(), ahead=2)
    for number in range(2):
        assert made.get(timeout=5) == number
    sleep(0.01)  # two items wait now, and so does the thread
    assert items.close()


def test_closing_early_joins_the_thread() -> None:
    before = threading.active_count()
    items = Prefetch(iter(range(10**9)), ahead=2)
    assert next(items) == 0
    items.close()
    items.close()
    assert threading.active_count() == before


def test_a_waiting_caller_gets_the_end_although_the_thread_still_waits_for_a_device(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(threads, "_JOIN_WITHIN_S", 0.01)
    answer, waits = threading.Event(), threading.Event()
    errors: list[SourceError] = []

    def items() -> Iterator[int]:
        waits.set()
        answer.wait()
        yield 1

    def call() -> None:
        try:
            next(ahead)
        except SourceError as error:
            errors.append(error)

    ahead = Prefetch(items())
    caller = threading.Thread(target=call)
    caller.start()
    assert waits.wait(10)
    caller.join(0.2)  # by now it waits for the first item
    closed = SourceError("closed")
    assert not ahead.close(closed)
    caller.join(5)
    assert errors == [closed]
    answer.set()


def test_at_the_exit_a_daemon_thread_does_not_take_its_items_for_complete() -> None:
    items, begun, ends = Prefetch(count()), threading.Event(), []

    def call() -> None:
        try:
            for _ in items:
                begun.set()
            ends.append("complete")
        except SystemExit:  # Python ends a thread by it without a message
            ends.append("left")

    caller = threading.Thread(target=call, daemon=True)
    caller.start()
    assert begun.wait(10)
    before_exit()
    assert (ends, caller.is_alive()) == (["left"], False)


def test_the_oldest_items_are_dropped_if_too_many_wait() -> None:
    ended, dropped = threading.Event(), []

    def numbers() -> Iterator[int]:
        yield from range(10)
        ended.set()

    items = Prefetch(numbers(), ahead=3, on_drop=lambda: dropped.append(1))
    assert ended.wait(10)
    assert list(items) == [7, 8, 9]
    assert len(dropped) == 7
    assert items._free_places.qsize() <= 3  # it does not grow with the number of items


def test_a_caller_that_stays_too_slow_gets_recent_items() -> None:
    made: SimpleQueue[int] = SimpleQueue()
    latest = taken = dropped = 0

    def counted() -> None:
        nonlocal dropped
        dropped += 1

    items = Prefetch(iter(made.get, None), ahead=3, on_drop=counted)
    waiting = items._made.qsize

    def make(number: int) -> None:
        nonlocal latest
        for _ in range(number):
            latest += 1
            made.put(latest)
        while taken + dropped + waiting() < latest or waiting() > items._may_wait:
            sleep(0.001)

    late: list[int] = []
    for _ in range(6):
        make(3 if late else 9)  # a burst, then three items in the time that one takes
        late.append(latest - next(items))
        taken += 1
    assert late == [2, 1, 0, 0, 0, 0]
    make(1)
    assert next(items) == latest
    taken += 1
    threading.Timer(0.05, made.put, [latest + 1]).start()  # this time the caller has to wait
    latest += 1
    assert next(items) == latest
    taken += 1
    make(3)
    assert [next(items) for _ in range(3)] == [latest - 2, latest - 1, latest]
    made.put(None)  # type: ignore[arg-type]
    assert list(items) == []


def test_without_a_further_thread_the_caller_does_the_work(monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(_: threading.Thread) -> None:
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr(threading.Thread, "start", refused)
    assert list(Prefetch(iter(range(5)))) == list(range(5))
    items = Prefetch(failing())
    assert next(items) == 1
    with pytest.raises(SourceError, match="gone"):
        next(items)
    assert items.close()
    assert list(items) == []
    assert Call(lambda: 7).result() == 7
    failed = Call(lambda: 1 / 0)
    failed.wait(0)
    with pytest.raises(ZeroDivisionError):
        failed.result()
