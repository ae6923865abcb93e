"""A batch on a dask.distributed cluster that is there already.

Its workers read the inputs and write the results on storage that they share. The
scheduler gives the inputs of a worker that dies to another one.
"""

from __future__ import annotations

import logging
import os
import queue
import uuid
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from oppload_cli.batch.attempt import attempt, failed
from oppload_cli.batch.counting import Counting
from oppload_cli.errors import OpploadError, ParameterError
from oppload_cli.outputs import IfExists
from oppload_cli.task import exists_already
from oppload_cli.version import __version__
from oppload_cli.video.prefetch import Call

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from oppload_cli.batch.attempt import Observer
    from oppload_cli.batch.plan import Failure
    from oppload_cli.task import Outcome, Task

ANSWER_WITHIN_S = 8.0  # so that with the start of Python an error is there within 10 s
STOP_WITHIN_S = 3.0
TELL_EVERY_S = 1.0
IN_FLIGHT = 1000  # inputs that the scheduler knows of at a time: memory stays flat


def run_on_cluster(tasks: Iterable[Task], scheduler: str, observer: Observer) -> None:
    """Do tasks on a cluster.

    Parameters
    ----------
    tasks : iterable of Task
        What to do; taken as they are needed.
    scheduler : str
        The scheduler's address such as ``tcp://host:8786``, or its scheduler file.
    observer : Observer
        Told of everything.

    Raises
    ------
    ParameterError
        If dask.distributed is missing here, the scheduler does not answer, has no
        worker, or a worker has no oppload or another version of it; nothing is
        begun then.
    KeyboardInterrupt
        If the user stops it; what runs on the workers is stopped first.
    """
    with connected(scheduler) as client:
        check_workers(client, scheduler)
        run = _Run(client, iter(tasks), observer)
        try:
            run.run()
        except BaseException:
            run.cancel()
            raise


@contextmanager
def connected(scheduler: str) -> Iterator[Any]:
    """Connect to a scheduler.

    Parameters
    ----------
    scheduler : str
        Its address or file.

    Yields
    ------
    distributed.Client

    Raises
    ------
    ParameterError
        If dask.distributed is missing, or nobody answers within 8 s.
    """
    try:
        import distributed  # noqa: PLC0415 - an optional extra
    except ImportError as error:
        raise ParameterError(
            "--scheduler needs dask.distributed; pip install 'oppload[distributed]'"
        ) from error
    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # the sentence below says it
    where = {"address": scheduler} if "://" in scheduler else {"scheduler_file": scheduler}
    if "://" not in scheduler and not Path(scheduler).is_file():
        raise ParameterError(
            f"--scheduler {scheduler}: no such file; give tcp://host:port or a scheduler file"
        )
    connect = partial(distributed.Client, **where, timeout=ANSWER_WITHIN_S, set_as_default=False)
    try:
        # Dask waits for ever where nobody says a word.
        client = Call(connect).result(ANSWER_WITHIN_S)
    except Exception as error:
        raise ParameterError(
            f"--scheduler {scheduler}: does not answer ({_first_line(error)}); "
            f"check the address, and that the scheduler runs"
        ) from error
    try:
        yield client
    finally:
        with suppress(Exception):  # a scheduler that has gone shall not hide what was wrong
            client.close(timeout=STOP_WITHIN_S)


def check_workers(client: Any, scheduler: str) -> None:
    """Check that every worker has this version of oppload.

    Parameters
    ----------
    client : distributed.Client
        Connected.
    scheduler : str
        For the messages.

    Raises
    ------
    ParameterError
        If there is no worker within 8 s, or one has no oppload or another version.
    """
    try:
        client.wait_for_workers(1, timeout=ANSWER_WITHIN_S)
    except TimeoutError as error:
        raise ParameterError(
            f"--scheduler {scheduler}: has no worker; start some with 'dask worker {scheduler}'"
        ) from error
    import pkgutil  # noqa: PLC0415 - only here

    # A function of Python's own: one of oppload's would not arrive where there is none.
    versions = client.run(
        pkgutil.resolve_name, "oppload_cli.version:__version__", on_error="return"
    )
    for worker, version in sorted(versions.items()):
        if isinstance(version, ImportError | AttributeError):
            raise ParameterError(
                f"worker {worker}: has no oppload; install oppload {__version__} there"
            )
        if isinstance(version, BaseException):
            raise ParameterError(
                f"worker {worker}: does not answer ({_first_line(version)}); restart it"
            )
        if version != __version__:
            raise ParameterError(
                f"worker {worker}: has oppload {version}, not {__version__}; install one "
                f"version everywhere"
            )


def do_there(task: Task, topic: str, version: str) -> Outcome | Failure:
    """Do one task on a worker.

    Parameters
    ----------
    task : Task
        What to do.
    topic : str
        Under which the worker tells how it gets on.
    version : str
        Of oppload where the batch was started.

    Returns
    -------
    Outcome or Failure
    """
    import cv2  # noqa: PLC0415 - only on the worker
    import distributed  # noqa: PLC0415

    if version != __version__:  # a worker that came later
        message = f"{task.name}: its worker has oppload {__version__}, not {version}; replace it"
        return failed(task, message)
    cv2.setNumThreads(1)  # as dask counts: a task, a core
    worker = distributed.get_worker()
    stop = distributed.Event(topic)

    def tell(count: int) -> None:
        worker.log_event(topic, ("frames", count))
        if stop.is_set():
            raise KeyboardInterrupt

    worker.log_event(topic, ("started", task.name))
    watcher = Counting(tell, TELL_EVERY_S)
    try:
        result = attempt(replace(task, threads=1), watcher)
        watcher.flush()
    except KeyboardInterrupt:
        return failed(task, f"{task.name}: was stopped; go on with --if-exists skip")
    return result


class _Run:
    """A batch under way on a cluster."""

    def __init__(self, client: Any, tasks: Iterator[Task], observer: Observer) -> None:
        self._client = client
        self._tasks = tasks
        self._observer = observer
        self._topic = f"oppload-{uuid.uuid4().hex}"
        self._said: queue.SimpleQueue[tuple[str, Any]] = queue.SimpleQueue()
        self._under_way: dict[str, tuple[Task, Any]] = {}

    def run(self) -> None:
        """Keep the scheduler supplied until every task is done."""
        self._client.subscribe_topic(self._topic, self._heard)
        try:
            while len(self._under_way) < IN_FLIGHT and self._submit():
                pass
            while self._under_way:
                self._wait()
        finally:
            with suppress(Exception):
                self._client.unsubscribe_topic(self._topic)

    def cancel(self) -> None:
        """Drop what waits, stop what runs, and wait a moment for it to end."""
        # The scheduler may be what has failed; a second Ctrl-C ends the waiting.
        with suppress(Exception, KeyboardInterrupt), self._client.as_current():
            import distributed  # noqa: PLC0415

            futures = [future for _, future in self._under_way.values()]
            processing = {key for keys in self._client.processing().values() for key in keys}
            distributed.Event(self._topic).set()
            self._client.cancel([each for each in futures if each.key not in processing])
            running = [each for each in futures if each.key in processing]
            distributed.wait(running, timeout=STOP_WITHIN_S)
            self._client.cancel(running)

    def _heard(self, event: tuple[float, tuple[str, Any]]) -> None:
        self._said.put(event[1])

    def _submit(self) -> bool:
        task = next(self._tasks, None)
        if task is None:
            return False
        try:
            sent = _for_a_worker(task)
        except OpploadError as error:
            self._observer.ended(task, failed(task, str(error), error.exit_code))
            return True
        future = self._client.submit(
            do_there,
            sent,
            self._topic,
            __version__,
            key=f"{self._topic}-{uuid.uuid4().hex}",
            pure=False,
        )
        self._under_way[future.key] = (task, future)
        future.add_done_callback(lambda done: self._said.put(("ended", done.key)))
        return True

    def _wait(self) -> None:
        try:
            kind, value = self._said.get(timeout=0.5)
        except queue.Empty:
            self._check_scheduler()
            return
        if kind == "started":
            self._observer.started(value)
        elif kind == "frames":
            self._observer.frames(value)
        else:
            task, future = self._under_way.pop(value)
            self._observer.ended(task, _result(task, future))
            self._submit()

    def _check_scheduler(self) -> None:
        if self._client.status not in {"running", "connecting"}:
            raise ParameterError(
                "the scheduler has gone; start it again, and go on with --if-exists skip"
            )


def _for_a_worker(task: Task) -> Task:
    """Return a task as a worker needs it: with whole paths, and so that it can be repeated."""
    if task.if_exists is IfExists.ERROR:
        exists_already(task)
        # From here on only this batch writes it: what a dead worker left is gone over.
        task = replace(task, if_exists=IfExists.SKIP)
    name = task.name
    if "://" not in name and not name.startswith("camera:"):
        name = os.path.abspath(name)  # noqa: PTH100 - without following links
    return replace(task, name=name, outputs=task.outputs and task.outputs.absolute())


def _result(task: Task, future: Any) -> Outcome | Failure:
    if future.status == "finished":
        result: Outcome | Failure = future.result()
        return result
    if future.status == "cancelled":
        return failed(task, f"{task.name}: was cancelled on the cluster; try it again")
    error = future.exception()
    kind = type(error).__name__
    if kind == "KilledWorker":
        return failed(
            task,
            f"{task.name}: several workers died of it; check their memory, or run it alone",
        )
    return failed(
        task, f"{task.name}: the worker failed ({kind}: {_first_line(error)}); see its log"
    )


def _first_line(error: BaseException) -> str:
    return (str(error).strip().splitlines() or [type(error).__name__])[0].lower().rstrip(".")
