"""One input of a batch: the same function in this process, in others and on a cluster."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

from oppload_cli.batch.plan import Failure
from oppload_cli.errors import ExitCode, OpploadError
from oppload_cli.task import run_task

if TYPE_CHECKING:
    from oppload_cli.task import Outcome, Task, Watcher


class Observer(Protocol):
    """Whoever wants to know how a batch gets on."""

    def started(self, name: str) -> None:
        """Take note that an input is begun."""

    def frames(self, count: int) -> None:
        """Take note that more frames are analysed."""

    def ended(self, task: Task, result: Outcome | Failure) -> None:
        """Take note that an input is done, or has failed."""


def attempt(task: Task, watcher: Watcher | None = None) -> Outcome | Failure:
    """Do one task; what is wrong with its input is returned, not raised.

    Parameters
    ----------
    task : Task
        What to do.
    watcher : Watcher, optional
        Told of each frame.

    Returns
    -------
    Outcome or Failure
    """
    try:
        return run_task(task, watcher)
    except OpploadError as error:
        return failed(task, str(error), error.exit_code)
    except Exception as error:  # a bug met in one input spares the others
        return failed(
            task,
            f"{task.name}: this is a bug ({type(error).__name__}: {error}); please report it "
            f"with the output of 'oppload run' on this input alone",
            ExitCode.BUG,
        )


def failed(task: Task, message: str, code: int = ExitCode.USAGE) -> Failure:
    """Return the failure of a task.

    Parameters
    ----------
    task : Task
        What was to be done.
    message : str
        What was wrong: one sentence.
    code : int
        The exit code that it has alone.

    Returns
    -------
    Failure
    """
    return Failure(task.name, stem_of(task), code, message)


def stem_of(task: Task) -> str:
    """Return the stem of a task's results.

    Parameters
    ----------
    task : Task
        What was to be done.

    Returns
    -------
    str
        Empty where there is no table.
    """
    return task.outputs.csv.name.removesuffix(".frames.csv") if task.outputs else ""
