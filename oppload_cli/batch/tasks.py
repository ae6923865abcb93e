"""The tasks of a batch: done one after the other, in several processes, or on a cluster.

The cluster is one of dask.distributed that is running already. Its workers read the inputs and
write the results on storage that they share. The scheduler gives the inputs of a worker that
dies to another worker.
"""

from __future__ import annotations

import logging
import os
import pkgutil
import queue
import uuid
from contextlib import closing, contextmanager, suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import cv2

from oppload_cli.batch.plan import Failure
from oppload_cli.errors import ExitCode, OpploadError, ParameterError, reason_of, shortage
from oppload_cli.files.reading import is_file
from oppload_cli.pipeline.execute import run_task
from oppload_cli.pipeline.task import IfExists, exists_already
from oppload_cli.processes import cores
from oppload_cli.processes.pool import TELL_EVERY_S, Kind, Seldom, events
from oppload_cli.processes.signals import stop_if_asked
from oppload_cli.processes.threads import Call
from oppload_cli.version import __version__
from oppload_cli.video.inputs import is_camera

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from oppload_cli.pipeline.task import Outcome, Task, Watcher
    from oppload_cli.results.table import FrameRecord
    from oppload_cli.video.source import Video


ANSWER_WITHIN_S = 8.0  # a scheduler: with the start of Python, an error is printed within 10 s
_STOP_WITHIN_S = 3.0  # tasks on a cluster
_TELL_SCHEDULER_EVERY_S = 1.0
# Each has a level of its own by the library's configuration.
_TALKATIVE = ("distributed", "distributed.client", "tornado.application", "asyncio")
_IN_FLIGHT = 1000  # inputs that the scheduler knows of at a time: memory stays flat


class Observer(Protocol):
    """An object that receives the progress of a batch."""

    def started(self, name: str) -> None:
        """Take note that an input is begun."""

    def frames(self, count: int) -> None:
        """Take note that more frames are analysed."""

    def ended(self, task: Task, result: Outcome | Failure) -> None:
        """Take note that an input is done, or has failed."""


def run_tasks(
    tasks: Iterable[Task],
    observer: Observer,
    *,
    inputs: int,
    jobs: int = 0,
    scheduler: str | None = None,
) -> None:
    """Do the tasks of a batch.

    Parameters
    ----------
    tasks : iterable of Task
        Taken as they are needed.
    observer : Observer
        Told of everything.
    inputs : int
        How many tasks there are.
    jobs : int
        How many are done at a time, each in a process; 0 means the cores that the affinity mask
        allows. A single one is done in this process.
    scheduler : str, optional
        The cluster to do them on: the scheduler's address such as ``tcp://host:8786``, or its
        scheduler file.

    Raises
    ------
    KeyboardInterrupt
        If the user stops it; processes are ended and joined first, and tasks on workers stopped.
    ParameterError
        If dask.distributed is missing here, the scheduler does not answer, has no worker, or a
        worker has no oppload or another version of it; no task is begun then.
    """
    jobs = min(jobs or cores(), inputs)
    if scheduler:
        _run_on_cluster(tasks, scheduler, observer)
    elif jobs > 1:
        _run_in_processes(tasks, jobs, observer)
    else:
        for task in tasks:
            observer.started(task.name)
            observer.ended(task, _counted(task, observer.frames))


def _run_in_processes(tasks: Iterable[Task], jobs: int, observer: Observer) -> None:
    threads = max(1, cores() // jobs)
    limited = (replace(task, threads=threads) for task in tasks)
    with closing(events(_counted, limited, jobs, threads=threads)) as happening:
        for kind, task, content in happening:
            if kind is Kind.BEGUN:
                observer.started(task.name)
            elif kind is Kind.TOLD:
                observer.frames(content)
            elif kind is Kind.DONE:
                observer.ended(task, content)
            elif kind is Kind.DIED:
                how = f"the process that analysed it was {content}"
                observer.ended(task, _failed(task, f"{task.name}: {how}"))
            else:
                raise content


def _attempt(task: Task, watcher: Watcher | None = None) -> Outcome | Failure:
    """Do one task; an error of its input is returned, not raised."""
    try:
        return run_task(task, watcher)
    except OpploadError as error:
        return _failed(task, str(error), error.exit_code)
    except Exception as error:  # a bug met in one input spares the others
        short = shortage(error)
        if short:
            return _failed(task, f"{task.name}: {short}", ExitCode.NOTHING_READ)
        return _failed(
            task,
            f"{task.name}: this is a bug ({type(error).__name__}: {error}); please report it "
            f"with the output of 'oppload run' on this input alone",
            ExitCode.BUG,
        )


def _failed(task: Task, message: str, code: int = ExitCode.USAGE) -> Failure:
    """Return the failure of a task: one sentence, and the exit code that it has alone."""
    return Failure(task.name, task.stem, code, message)


class _Counting:
    """A watcher of one task that passes on how many frames are analysed.

    Parameters
    ----------
    tell : callable
        Called with a number of frames; an error that it raises ends the task.
    every_s : float
        Seconds between two calls, at least.
    """

    def __init__(self, tell: Callable[[int], object], every_s: float = TELL_EVERY_S) -> None:
        self._count = Seldom(tell, every_s)

    def opened(self, video: Video) -> None:
        """Do nothing: a batch shows inputs, not their sizes."""

    def frame(self, _record: FrameRecord) -> None:
        """Count a frame."""
        self._count(1)

    def flush(self) -> None:
        """Pass on the frames that are not yet passed on."""
        self._count.flush()


def _counted(task: Task, tell: Callable[[int], object]) -> Outcome | Failure:
    watcher = _Counting(tell)
    result = _attempt(task, watcher)
    watcher.flush()
    return result


def _run_on_cluster(tasks: Iterable[Task], scheduler: str, observer: Observer) -> None:
    with _connected(scheduler) as client:
        _check_workers(client, scheduler)
        run = _Run(client, iter(tasks), observer)
        try:
            run.run()
        except BaseException:
            run.cancel()
            raise


def _distributed() -> Any:
    """Return dask.distributed, an optional extra."""
    try:
        import distributed  # noqa: PLC0415
    except ImportError as error:
        raise ParameterError(
            "--scheduler needs dask.distributed; pip install 'oppload[distributed]'"
        ) from error
    return distributed


@contextmanager
def _connected(scheduler: str) -> Iterator[Any]:
    """Connect to a scheduler; yield a distributed.Client."""
    distributed = _distributed()
    for name in _TALKATIVE:  # the errors below say the same
        logging.getLogger(name).setLevel(logging.CRITICAL)
    where = {"address": scheduler} if "://" in scheduler else {"scheduler_file": scheduler}
    if "://" not in scheduler and not is_file(Path(scheduler)):
        raise ParameterError(
            f"--scheduler {scheduler}: no such file; give tcp://host:port or a scheduler file"
        )
    connect = partial(distributed.Client, **where, timeout=ANSWER_WITHIN_S, set_as_default=False)
    try:
        # Dask waits for ever for a scheduler that accepts a connection and stays silent.
        client = Call(connect).result(ANSWER_WITHIN_S)
    except Exception as error:
        raise ParameterError(
            f"--scheduler {scheduler}: does not answer ({reason_of(error)}); "
            f"check the address, and that the scheduler runs"
        ) from error
    try:
        yield client
    finally:
        # A scheduler that has gone must not hide the first error, and a stopped one does not
        # answer.
        Call(partial(client.close, timeout=_STOP_WITHIN_S)).wait(_STOP_WITHIN_S)


def _check_workers(client: Any, scheduler: str) -> None:
    """Check that workers are connected, and that each has this version of oppload."""
    try:
        Call(partial(client.wait_for_workers, 1, timeout=ANSWER_WITHIN_S)).result()
    except TimeoutError as error:
        raise ParameterError(
            f"--scheduler {scheduler}: has no worker; start some with 'dask worker {scheduler}'"
        ) from error
    # A function of Python's own: a worker without oppload could not load one of oppload's.
    asked = partial(client.run, pkgutil.resolve_name, "oppload_cli.version:__version__")
    try:
        versions = Call(partial(asked, on_error="return")).result(ANSWER_WITHIN_S)
    except Exception as error:
        raise ParameterError(
            f"--scheduler {scheduler}: does not answer ({reason_of(error)}); restart it"
        ) from error
    for worker, version in sorted(versions.items()):
        if isinstance(version, ImportError | AttributeError):
            raise ParameterError(
                f"worker {worker}: has no oppload; install oppload {__version__} there"
            )
        if isinstance(version, BaseException):
            raise ParameterError(
                f"worker {worker}: does not answer ({reason_of(version)}); restart it"
            )
        if version != __version__:
            raise ParameterError(
                f"worker {worker}: has oppload {version}, not {__version__}; install one "
                f"version everywhere"
            )


def _do_on_worker(task: Task, topic: str, version: str) -> Outcome | Failure:
    """Do one task on a worker.

    Parameters
    ----------
    task : Task
        The task.
    topic : str
        Under which the worker reports its progress.
    version : str
        Of oppload where the batch was started.
    """
    if version != __version__:  # a worker that came later
        message = f"{task.name}: its worker has oppload {__version__}, not {version}; replace it"
        return _failed(task, message)
    cv2.setNumThreads(1)  # dask counts one core for a task
    distributed = _distributed()
    worker = distributed.get_worker()
    stop = distributed.Event(topic)

    def tell(count: int) -> None:
        worker.log_event(topic, ("frames", count))
        if stop.is_set():
            raise KeyboardInterrupt

    worker.log_event(topic, ("started", task.name))
    watcher = _Counting(tell, _TELL_SCHEDULER_EVERY_S)
    try:
        result = _attempt(replace(task, threads=1), watcher)
        watcher.flush()
    except KeyboardInterrupt:
        return _failed(task, f"{task.name}: was stopped; go on with --if-exists skip")
    return result


class _Run:
    """A batch under way on a cluster."""

    def __init__(self, client: Any, tasks: Iterator[Task], observer: Observer) -> None:
        self._client = client
        self._tasks = tasks
        self._observer = observer
        self._topic = f"oppload-{uuid.uuid4().hex}"
        self._messages: queue.SimpleQueue[tuple[str, Any]] = queue.SimpleQueue()
        self._under_way: dict[str, tuple[Task, Any]] = {}

    def run(self) -> None:
        """Keep the scheduler supplied until every task is done."""
        self._client.subscribe_topic(self._topic, self._heard)
        try:
            while len(self._under_way) < _IN_FLIGHT and self._submit():
                pass
            while self._under_way:
                self._wait()
        finally:
            with suppress(Exception):
                self._client.unsubscribe_topic(self._topic)

    def cancel(self) -> None:
        """Cancel the tasks that wait, stop those that run, and wait a moment for them to end."""
        # The scheduler itself may have failed, or have stopped.
        Call(self._cancel).wait(_STOP_WITHIN_S + 1)  # of which the workers get most

    def _cancel(self) -> None:
        distributed = _distributed()
        with self._client.as_current():
            futures = [future for _, future in self._under_way.values()]
            processing = {key for keys in self._client.processing().values() for key in keys}
            distributed.Event(self._topic).set()
            self._client.cancel([each for each in futures if each.key not in processing])
            running = [each for each in futures if each.key in processing]
            distributed.wait(running, timeout=_STOP_WITHIN_S)
            self._client.cancel(running)

    def _heard(self, event: tuple[float, tuple[str, Any]]) -> None:
        self._messages.put(event[1])

    def _submit(self) -> bool:
        task = next(self._tasks, None)
        if task is None:
            return False
        try:
            sent = _for_a_worker(task)
        except OpploadError as error:
            self._observer.ended(task, _failed(task, str(error), error.exit_code))
            return True
        future = self._client.submit(
            _do_on_worker,
            sent,
            self._topic,
            __version__,
            key=f"{self._topic}-{uuid.uuid4().hex}",
            pure=False,
        )
        self._under_way[future.key] = (task, future)
        future.add_done_callback(lambda done: self._messages.put(("ended", done.key)))
        return True

    def _wait(self) -> None:
        stop_if_asked()
        try:
            kind, value = self._messages.get(timeout=0.5)
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
    """Return a task as a worker needs it: with absolute paths, and so that it can be repeated."""
    if task.if_exists is IfExists.ERROR:
        exists_already(task)
        # From here on only this batch writes it: the files of a dead worker are written again.
        task = replace(task, if_exists=IfExists.SKIP)
    name = task.name
    if "://" not in name and not is_camera(name):
        name = os.path.abspath(name)  # noqa: PTH100 - without following links
    return replace(task, name=name, outputs=task.outputs and task.outputs.absolute())


def _result(task: Task, future: Any) -> Outcome | Failure:
    if future.status == "finished":
        # In a thread, as the scheduler may stop meanwhile.
        result: Outcome | Failure = Call(future.result).result()
        return result
    if future.status == "cancelled":
        return _failed(task, f"{task.name}: was cancelled on the cluster; try it again")
    error = Call(future.exception).result()
    kind = type(error).__name__
    if kind == "KilledWorker":
        return _failed(
            task,
            f"{task.name}: several workers died of it; check their memory, or run it alone",
        )
    return _failed(
        task, f"{task.name}: the worker failed ({kind}: {reason_of(error)}); see its log"
    )
