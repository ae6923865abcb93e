"""Running the tasks of a batch: one after the other, in several processes, or on a cluster.

The cluster is a running one of dask.distributed. Its workers read the inputs and write the results
on shared storage. If a worker dies, the scheduler gives its tasks to another worker.
"""

from __future__ import annotations

import logging
import os
import pickle
import pkgutil
import queue
import uuid
from contextlib import closing, contextmanager, suppress
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, Protocol

import cv2

from oppload_cli.batch.plan import Failure
from oppload_cli.errors import (
    DetectorError,
    ExitCode,
    OpploadError,
    ParameterError,
    reason_of,
    shortage,
)
from oppload_cli.files.reading import is_file
from oppload_cli.models import registry
from oppload_cli.pipeline.execute import run_task
from oppload_cli.pipeline.task import IfExists, Interrupted, exists_already
from oppload_cli.processes import cores
from oppload_cli.processes.pool import TELL_EVERY_S, Kind, Seldom, events
from oppload_cli.processes.signals import stop_if_asked
from oppload_cli.processes.threads import Call
from oppload_cli.version import __version__
from oppload_cli.video.inputs import is_camera_or_stream

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

    from oppload_cli.pipeline.task import Outcome, Task


# Time for a scheduler to answer; Python takes up to 2 s more until the error is printed.
ANSWER_WITHIN_S = 8.0
_STOP_WITHIN_S = 3.0  # time for the tasks on a cluster to stop
_TELL_SCHEDULER_EVERY_S = 1.0
# Loggers of dask, whose configuration gives each of them a level of its own.
_LOGGERS = ("distributed", "distributed.client", "tornado.application", "asyncio")
_MOST_SUBMITTED = 1000  # tasks that the scheduler has at a time, which bounds its memory


class _Observer(Protocol):
    """An object that receives the progress of a batch."""

    def started(self, name: str) -> None:
        """Receive the name of an input that is begun."""

    def frames(self, count: int) -> None:
        """Receive the number of frames analysed since the last call."""

    def ended(self, task: Task, result: Outcome | Failure) -> None:
        """Receive the result of an input."""


def run_tasks(
    tasks: Iterable[Task], observer: _Observer, *, inputs: int, jobs: int, scheduler: str | None
) -> None:
    """Run the tasks of a batch.

    Parameters
    ----------
    tasks : iterable of Task
        The tasks; one is taken when it can begin.
    observer : _Observer
        Receives the progress.
    inputs : int
        The number of tasks.
    jobs : int
        Number of processes, each of which runs a task at a time. With one job, this process runs
        the tasks.
    scheduler : str or None
        The cluster that runs the tasks instead: the scheduler's address such as
        ``tcp://host:8786``, or its scheduler file.

    Raises
    ------
    KeyboardInterrupt
        If the user stops the batch, after the processes have ended and the workers' tasks stopped.
    ParameterError
        If dask.distributed is not installed, the scheduler does not answer or has no worker, or a
        worker has no oppload or another version of it. No task has begun then.
    """
    jobs = min(jobs, inputs)
    if scheduler:
        with _connected(scheduler) as client:
            _check_workers(client, scheduler)
            _ClusterRun(client, iter(tasks), observer).run()
    elif jobs > 1:
        _run_in_processes(tasks, jobs, observer)
    else:
        for task in tasks:
            observer.started(task.name)
            observer.ended(task, _counted(task, observer.frames))
            stop_if_asked()  # a stopped live input has an outcome like any other


def _run_in_processes(tasks: Iterable[Task], jobs: int, observer: _Observer) -> None:
    threads = max(1, cores() // jobs)
    limited = (replace(task, threads=threads) for task in tasks)
    with closing(events(_counted, limited, jobs, threads=threads)) as happening:
        for kind, task, content in happening:
            if kind is Kind.BEGUN:
                observer.started(task.name)
            elif kind is Kind.MESSAGE:
                observer.frames(content)
            elif kind is Kind.DONE:
                observer.ended(task, content)
            elif kind is Kind.DIED:
                how = f"the process that analysed it was {content}"
                observer.ended(task, _failed(task, f"{task.name}: {how}"))
            else:
                raise content


def _attempt(task: Task, count: Seldom) -> Outcome | Failure:
    """Run one task; return a Failure instead of raising an error, so that the others can go on.

    If the user stops a live input, its result is complete, and its outcome is returned.
    """
    try:
        return run_task(task, on_frame=lambda _record: count(1))
    except Interrupted as stop:
        if stop.outcome is None:
            raise
        return stop.outcome
    except (DetectorError, ParameterError) as error:  # its message may not name the input
        fault = str(error).removeprefix(f"{task.name}: ")
        return _failed(task, f"{task.name}: {fault}", error.exit_code)
    except OpploadError as error:
        return _failed(task, str(error), error.exit_code)
    except Exception as error:
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
    return Failure(task.name, task.stem, code, message)


def _counted(
    task: Task, tell: Callable[[int], object], every_s: float = TELL_EVERY_S
) -> Outcome | Failure:
    """Run one task; call `tell` with numbers of frames, at most once in `every_s` seconds."""
    count = Seldom(tell, every_s)
    result = _attempt(task, count)
    count.flush()
    return result


def _import_distributed() -> Any:
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
    distributed = _import_distributed()
    for name in _LOGGERS:  # the errors below say the same
        logging.getLogger(name).setLevel(logging.CRITICAL)
    where = {"address" if "://" in scheduler else "scheduler_file": scheduler}
    if "scheduler_file" in where and not is_file(scheduler):
        raise ParameterError(
            f"--scheduler {scheduler}: no such file; give tcp://host:port or a scheduler file"
        )
    connect = partial(distributed.Client, **where, timeout=ANSWER_WITHIN_S, set_as_default=False)
    try:
        # A time limit of our own: if a scheduler accepts the connection but sends nothing, dask
        # waits for ever.
        client = Call(connect).result(ANSWER_WITHIN_S)
    except Exception as error:
        raise ParameterError(
            f"--scheduler {scheduler}: does not answer ({reason_of(error)}); "
            f"check the address, and that the scheduler runs"
        ) from error
    try:
        yield client
    finally:
        # `wait` raises no error, which would hide the first one, and does not wait for ever for a
        # scheduler that has stopped.
        Call(partial(client.close, timeout=_STOP_WITHIN_S)).wait(_STOP_WITHIN_S)


def _check_workers(client: Any, scheduler: str) -> None:
    """Raise ParameterError unless there are workers, and all have this version of oppload.

    The scheduler needs it too, because it reads the name of our function in each task.
    """
    try:
        Call(partial(client.wait_for_workers, 1, timeout=ANSWER_WITHIN_S)).result()
    except TimeoutError as error:
        raise ParameterError(
            f"--scheduler {scheduler}: has no worker; start some with 'dask worker {scheduler}'"
        ) from error
    # The call is of a function of Python: a worker without oppload could load none of ours.
    call = pkgutil.resolve_name, "oppload_cli.version:__version__"
    try:
        ask_workers = partial(client.run, *call, on_error="return")
        versions = Call(ask_workers).result(ANSWER_WITHIN_S)
        of_scheduler = Call(partial(client.run_on_scheduler, *call)).result(ANSWER_WITHIN_S)
    except ImportError as error:
        of_scheduler = error
    except Exception as error:
        raise ParameterError(
            f"--scheduler {scheduler}: does not answer ({reason_of(error)}); restart it"
        ) from error
    answers = {f"worker {name}": version for name, version in sorted(versions.items())}
    for where, version in {f"--scheduler {scheduler}": of_scheduler, **answers}.items():
        if version == __version__:
            continue
        if isinstance(version, ImportError | AttributeError):
            fault = f"has no oppload; install oppload {__version__} there"
        elif isinstance(version, BaseException):
            fault = f"does not answer ({reason_of(version)}); restart it"
        else:
            fault = f"has oppload {version}, not {__version__}; install one version everywhere"
        raise ParameterError(f"{where}: {fault}")


def _run_on_worker(
    pickled: bytes, loaded: Sequence[dict[str, str]], topic: str, version: str
) -> Outcome | Failure:
    """Run one task on a worker.

    `pickled` is the task, which may hold parameters of the user's own detectors, and `loaded` are
    the files that define these (:func:`registry.loaded`). `topic` is the topic of dask under which
    the worker reports its progress, and the name of the event that stops the task. `version` is the
    version of oppload that has started the batch.
    """
    registry.load_only(loaded)
    task: Task = pickle.loads(pickled)  # noqa: S301 - from the client, as all that dask sends
    if version != __version__:  # a worker that joined after `_check_workers`
        message = f"{task.name}: its worker has oppload {__version__}, not {version}; replace it"
        return _failed(task, message)
    cv2.setNumThreads(1)  # dask counts one core for a task
    distributed = _import_distributed()
    worker = distributed.get_worker()
    stop = distributed.Event(topic)

    def tell(count: int) -> None:
        worker.log_event(topic, ("frames", count))
        if stop.is_set():
            raise KeyboardInterrupt

    worker.log_event(topic, ("started", task.name))
    try:
        return _counted(replace(task, threads=1), tell, _TELL_SCHEDULER_EVERY_S)
    except KeyboardInterrupt:
        return _failed(task, f"{task.name}: was stopped; go on with --if-exists skip")


class _ClusterRun:
    """A batch that runs on a cluster."""

    def __init__(self, client: Any, tasks: Iterator[Task], observer: _Observer) -> None:
        self._client = client
        self._tasks = tasks
        self._observer = observer
        self._topic = f"oppload-{uuid.uuid4().hex}"
        self._messages: queue.SimpleQueue[tuple[str, Any]] = queue.SimpleQueue()
        self._submitted: dict[str, tuple[Task, Any]] = {}  # with its future, by the future's key

    def run(self) -> None:
        """Submit the tasks, and wait until each is done; after an error, cancel the others."""
        try:
            self._client.subscribe_topic(self._topic, lambda event: self._messages.put(event[1]))
            try:
                self._fill()
                while self._submitted:
                    self._take_message()
            finally:
                with suppress(Exception):
                    self._client.unsubscribe_topic(self._topic)
        except BaseException:
            # In a thread with a time limit: the scheduler itself may have failed or stopped. The
            # workers get nearly all of this time.
            Call(self._cancel).wait(_STOP_WITHIN_S + 1)
            raise

    def _cancel(self) -> None:
        """Cancel the tasks that have not begun, stop the others, and wait for their end."""
        distributed = _import_distributed()
        with self._client.as_current():
            futures = [future for _, future in self._submitted.values()]
            processing = {key for keys in self._client.processing().values() for key in keys}
            distributed.Event(self._topic).set()
            self._client.cancel([future for future in futures if future.key not in processing])
            running = [future for future in futures if future.key in processing]
            distributed.wait(running, timeout=_STOP_WITHIN_S)
            self._client.cancel(running)

    def _fill(self) -> None:
        """Submit tasks until the scheduler has as many as it may have, or none remains."""
        while len(self._submitted) < _MOST_SUBMITTED and (task := next(self._tasks, None)):
            try:
                self._submit(task, _for_a_worker(task))
            except OpploadError as error:
                self._observer.ended(task, _failed(task, str(error), error.exit_code))

    def _submit(self, task: Task, sent: Task) -> None:
        """Submit a task in the form `sent`, in which a worker can run it."""
        key = f"{self._topic}-{uuid.uuid4().hex}"
        # The scheduler reads the arguments too, and knows no detector of the user's own.
        arguments = pickle.dumps(sent), registry.loaded(), self._topic, __version__
        future = self._client.submit(_run_on_worker, *arguments, key=key, pure=False)
        self._submitted[future.key] = (task, future)
        future.add_done_callback(lambda done: self._messages.put(("ended", done.key)))

    def _take_message(self) -> None:
        stop_if_asked()
        try:
            kind, value = self._messages.get(timeout=0.5)
        except queue.Empty:
            if self._client.status not in {"running", "connecting"}:
                raise ParameterError(
                    "the scheduler has gone; start it again, and go on with --if-exists skip"
                ) from None
            return
        if kind == "started":
            self._observer.started(value)
        elif kind == "frames":
            self._observer.frames(value)
        else:
            task, future = self._submitted.pop(value)
            self._observer.ended(task, _result(task, future))
            self._fill()


def _for_a_worker(task: Task) -> Task:
    """Return a task with absolute paths that a second worker can repeat if the first one dies.

    Raises OutputError if the result must not exist and does.
    """
    if task.if_exists is IfExists.ERROR:
        exists_already(task)
        # The second worker must accept what the first one has written.
        task = replace(task, if_exists=IfExists.SKIP)
    name = task.name
    if not is_camera_or_stream(name):
        name = os.path.abspath(name)  # noqa: PTH100 - follows no links
    return replace(task, name=name, outputs=task.outputs and task.outputs.absolute())


def _result(task: Task, future: Any) -> Outcome | Failure:
    if future.status == "finished":
        # In a thread, as the scheduler may stop before it sends the result.
        result: Outcome | Failure = Call(future.result).result()
        return result
    if future.status == "cancelled":
        return _failed(task, f"{task.name}: was cancelled on the cluster; try it again")
    error = Call(future.exception).result()
    if isinstance(error, OpploadError):
        return _failed(task, f"{task.name}: on its worker: {error}", error.exit_code)
    kind = type(error).__name__
    if kind == "KilledWorker":
        remedy = "check their memory, or run it alone"
        return _failed(task, f"{task.name}: several workers died while they ran it; {remedy}")
    return _failed(
        task, f"{task.name}: the worker failed ({kind}: {reason_of(error)}); see its log"
    )
