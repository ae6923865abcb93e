"""What a batch hands to its processes, and what it hears from a task."""

from __future__ import annotations

from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

from oppload_cli.batch import tasks
from oppload_cli.pipeline.settings import resolve
from oppload_cli.pipeline.task import Outcome, Task

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    import pytest

TASKS = [Task(name, resolve(models=["dlgmd"])) for name in "abc"]


def test_every_frame_of_a_task_is_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Also frames after the latest message, of which there is one in a quarter of a second."""

    def run_task(_task: Task, on_frame: Callable[[object], None]) -> Outcome:
        for _ in range(7):
            on_frame(None)
        return Outcome(frames=7)

    monkeypatch.setattr(tasks, "run_task", run_task)
    heard: list[Any] = []
    observer: Any = SimpleNamespace(
        started=heard.append, frames=heard.append, ended=lambda task, _: heard.append(task)
    )
    tasks.run_tasks(TASKS[:2], observer, inputs=2, jobs=1, scheduler=None)
    assert heard == ["a", 7, TASKS[0], "b", 7, TASKS[1]]


def test_processes_share_the_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    given: list[tuple[int, int, list[int]]] = []

    def events(_function: object, items: Iterable[Task], jobs: int, threads: int) -> Iterator[Any]:
        given.append((jobs, threads, [task.threads for task in items]))
        yield from ()

    monkeypatch.setattr(tasks, "events", events)
    monkeypatch.setattr(tasks, "cores", lambda: 8)
    nobody: Any = None
    for jobs in (9, 2):  # no more processes than inputs
        tasks.run_tasks(TASKS, nobody, inputs=3, jobs=jobs, scheduler=None)
    assert given == [(3, 2, [2, 2, 2]), (2, 4, [4, 4, 4])]
