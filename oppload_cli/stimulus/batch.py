"""Writing many stimuli, several at a time."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from typing import TYPE_CHECKING

from oppload_cli.errors import OpploadError, OutputError
from oppload_cli.stimulus.files import Written, write

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from pathlib import Path

    from oppload_cli.stimulus.protocol import Protocol


def default_jobs(clips: int) -> int:
    """Return how many stimuli to write at a time.

    Parameters
    ----------
    clips : int
        How many there are.

    Returns
    -------
    int
        At most the cores there are; 1 where starting more would take longer.
    """
    return max(1, min(clips // 2, os.cpu_count() or 1))


def write_all(
    protocols: Sequence[Protocol],
    directory: Path,
    *,
    form: str = "ffv1",
    preview: bool = False,
    jobs: int = 1,
    progress: Callable[[int], None] | None = None,
) -> list[Written | OpploadError]:
    """Write stimuli; one that fails does not stop the others.

    Parameters
    ----------
    protocols : sequence of Protocol
        The stimuli.
    directory : Path
        Where the files go.
    form : str
        A key of :data:`oppload_cli.video.writer.FORMATS`.
    preview : bool
        Whether to write contact sheets too.
    jobs : int
        How many at a time.
    progress : callable or None
        Called with a number of frames done.

    Returns
    -------
    list of Written or OpploadError
        In the order of `protocols`.
    """
    if jobs <= 1:
        return [_written(protocol, directory, form, preview, progress) for protocol in protocols]
    # fresh processes: a copy of one that runs decoder threads may hang
    context = multiprocessing.get_context("spawn")
    others = set(multiprocessing.active_children())
    pool = ProcessPoolExecutor(
        min(jobs, len(protocols)), mp_context=context, initializer=_stop_cleanly
    )
    try:
        with _interrupts_held():
            futures = {
                pool.submit(_written, protocol, directory, form, preview, None): protocol
                for protocol in protocols
            }
        for future in as_completed(futures):
            if progress is not None:
                progress(futures[future].frame_count)
        return [_result(future, protocol) for future, protocol in futures.items()]
    except BaseException:
        for process in set(multiprocessing.active_children()) - others:
            process.terminate()
        raise
    finally:
        pool.shutdown(cancel_futures=True)


@contextmanager
def _interrupts_held() -> Iterator[None]:
    """Hold Ctrl-C back, for good in the processes started meanwhile: their starter ends them."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _stop_cleanly() -> None:
    """Take the end of a process as an exception, so that it removes what is half-written."""
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))


def _written(
    protocol: Protocol,
    directory: Path,
    form: str,
    preview: bool,
    progress: Callable[[int], None] | None,
) -> Written | OpploadError:
    try:
        return write(protocol, directory, form=form, preview=preview, progress=progress)
    except OpploadError as problem:
        return problem


def _result(future: Future[Written | OpploadError], protocol: Protocol) -> Written | OpploadError:
    try:
        return future.result()
    except BrokenProcessPool:
        return OutputError(
            f"{protocol.name}: the process that wrote it was ended from outside; try again with "
            "--jobs 1"
        )
