"""Opens and decodes a video in a process of its own, beside the process of the detectors.

Python runs only one thread of a process at a time. With two processes, decoder and detectors do not
wait for each other, and load their libraries at the same time. If the decoder crashes, the video
ends, but not the run. The pictures pass through shared memory at the working size. If no process
can be forked, or the input is not a file, a thread decodes instead.

The process is forked before NumPy is loaded: this module imports no large library at its top.
"""

from __future__ import annotations

import mmap
import multiprocessing
import os
import signal
import sys
import threading
import traceback
from contextlib import ExitStack, suppress
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

from oppload_cli.errors import OpploadError, SourceError
from oppload_cli.files.reading import is_file
from oppload_cli.processes import cores, signals
from oppload_cli.processes.signals import POLL_S, ending, stop_if_asked
from oppload_cli.processes.threads import Call
from oppload_cli.video.frames import DecodeFacts, Picture, WorkingSize
from oppload_cli.video.inputs import Span, is_camera, is_image_file

if sys.platform != "win32":
    import resource

if TYPE_CHECKING:
    from collections.abc import Iterator
    from fractions import Fraction
    from multiprocessing.connection import Connection

    from oppload_cli.video.frames import InputFacts, PictureSource
    from oppload_cli.video.source import Video


_CRASHES = {"SIGABRT", "SIGBUS", "SIGFPE", "SIGILL", "SIGSEGV"}
_WIDEST_SAMPLE = 2  # bytes
# Slots are places for pictures. Many are useful: while the other process loads the detectors, the
# decoder runs far ahead.
MOST_SLOTS, _LEAST_SLOTS = 64, 3
_SHARED_BYTES = 1 << 24  # most shared memory, unless the least number of slots needs more
_PARTS = 8  # the slots are given back in 8 parts, each part at once


class Opening:
    """An input that is opened and decoded while the caller does other work.

    Parameters
    ----------
    name, height, span, image_rate, threads, colour
        As for :func:`oppload_cli.open_video`.
    own_process : bool
        Whether a separate process may decode; it ignores `threads`. It decodes only video files,
        without colour, on Linux with two cores or more. In all other cases a thread decodes.
    """

    def __init__(
        self,
        name: str,
        *,
        height: int | None,
        span: Span,
        image_rate: Fraction | None = None,
        threads: int = 0,
        colour: bool = False,
        own_process: bool = False,
    ) -> None:
        self.height, self._span, self._colour = height, span, colour
        self._video: Video | None = None
        self._process: _DecodingProcess | None = None
        # Pictures in colour are too large for the shared memory.
        if own_process and not colour and is_video_file(name) and cores() > 1 and _can_fork():
            # Not every C library offers shared memory, and limits of files, processes or sizes may
            # forbid it.
            with suppress(OSError, AttributeError):
                self._process = _DecodingProcess(_Order(name, height, span))
        if self._process is None:

            def source() -> PictureSource:
                from oppload_cli.video.source import source_of  # imports NumPy: not before a fork

                return source_of(name, image_rate, threads)

            self._call = Call(source)

    def result(self) -> Video:
        """Wait until the input is open, and return it; raises the errors of `open_video`."""
        from oppload_cli.video.source import Video

        if self._process is not None:
            self._video = Video(self._process.opened(), self.height, Span(), ahead=False)
        else:
            self._video = Video(self._call.result(), self.height, self._span, colour=self._colour)
            self._video.begin()
        return self._video

    def close(self) -> None:
        """Stop decoding, and close the video; may be called twice."""
        if self._video is not None:
            self._video.close()
        elif self._process is not None:
            self._process.close()


def is_video_file(name: str) -> bool:
    """Return whether a text is the name of a single file that is not an image."""
    return is_file(name) and not is_camera(name) and not is_image_file(name)


def _can_fork() -> bool:
    """Return whether this process can be forked safely.

    A copy of a process with several threads may hang, and only Linux tells the number of threads
    including those of libraries. If a standard stream is closed, a pipe would get its number, and
    libraries would write their messages into the pipe. A limit of the size of files also limits the
    shared memory.
    """
    if sys.platform != "linux" or None in (sys.stdin, sys.stdout, sys.stderr):
        return False
    if resource.getrlimit(resource.RLIMIT_FSIZE)[0] != resource.RLIM_INFINITY:
        return False
    try:
        return len(os.listdir("/proc/self/task")) == 1  # noqa: PTH208 - a count of names
    except OSError:
        return False


class _Order(NamedTuple):
    """The file to decode, its part, and the working height."""

    name: str
    height: int | None  # None keeps the native size
    span: Span


class _Shared(NamedTuple):
    """The facts of a picture whose samples are in the shared memory."""

    number: int
    time_s: float
    bits: int
    full_range: bool
    shape: tuple[int, int]
    dtype: str


class _DecodingProcess:
    """A source of pictures at the working size, which a separate process decodes from a file.

    Raises OSError if the system refuses a process or memory.
    """

    def __init__(self, order: _Order) -> None:
        self.decode = DecodeFacts()
        self.stopping = False
        self.facts: InputFacts
        self._slots: _Slots
        self._order = order
        self._reading = threading.Lock()
        context = multiprocessing.get_context("fork")
        with ExitStack() as undone:
            self._memory = os.memfd_create("oppload-pictures")
            undone.callback(os.close, self._memory)
            self._connection, theirs = context.Pipe()
            undone.callback(self._connection.close)
            with theirs:  # closed in this process, so that the pipe closes when the other one ends
                arguments = (theirs, self._connection, self._memory, order)
                self._process = context.Process(target=_decode, args=arguments, daemon=True)
                self._process.start()
            undone.pop_all()

    def opened(self) -> _DecodingProcess:
        """Wait until the file is open, and return this source; its facts are known from then on.

        Raises the errors of opening the file, and KeyboardInterrupt after a signal to stop.
        """
        try:
            while not self._connection.poll(POLL_S):
                stop_if_asked()
            self.facts, self.decode = self._received()
        except EOFError:
            how = self._ending()
            self.close()
            raise SourceError(
                f"{self._order.name}: its decoder was ended ({how}) before the first frame; "
                f"check the memory, or convert the file"
            ) from None
        except BaseException:
            self.close()
            raise
        self._slots = _Slots(self._memory, WorkingSize.of(self.facts, self._order.height))
        return self

    def pictures(self) -> Iterator[Picture]:
        """Yield the pictures; the plane of each is a view that is valid until the next picture.

        Raises SourceError if another program ended the process. If the decoder crashes, the
        pictures end, and a failure is counted.
        """
        import numpy as np

        decoded = ordinal = 0
        try:
            while isinstance(shared := self._received(), _Shared):
                samples = np.frombuffer(self._slots.of(ordinal), shared.dtype)
                plane = samples[: shared.shape[0] * shared.shape[1]].reshape(shared.shape)
                decoded, ordinal = shared.number + 1, ordinal + 1
                yield Picture(shared.number, shared.time_s, plane, shared.bits, shared.full_range)
                if not ordinal % self._slots.at_once:
                    self._give_back()
            self.decode = shared
        except EOFError:
            how = self._ending()
            stop_if_asked()  # SIGTERM may have gone to all processes of a group
            if how not in _CRASHES:
                raise SourceError(
                    f"{self._order.name}: its decoder was ended ({how}) after frame {decoded - 1}; "
                    f"check the memory, and run it again"
                ) from None
            self.decode = replace(self.decode, decoded=decoded)
            self.decode.failed(f"the decoder crashed ({how}) after frame {decoded - 1}")

    def finish(self) -> None:
        """Do nothing: the process compares the decoded frames with the declared ones."""

    def close(self) -> None:
        """End the process and give back the memory; may be called twice."""
        self._process.kill()
        self._process.join()
        with self._reading:  # a thread that waits for a message is told of the end first
            self._connection.close()
        if self._memory >= 0:
            os.close(self._memory)
            self._memory = -1

    def _received(self) -> Any:
        with self._reading:
            if self._connection.closed:
                raise EOFError
            try:
                message = self._connection.recv()
            except ConnectionResetError:
                raise EOFError from None
        if isinstance(message, BaseException):
            raise message
        return message

    def _give_back(self) -> None:
        """Tell the process that the latest `at_once` pictures are no longer used."""
        with self._reading:  # else another thread could close the connection meanwhile
            if not self._connection.closed:
                with suppress(OSError):  # the process has ended; the next `_received` reports it
                    self._connection.send_bytes(b"used")

    def _ending(self) -> str:
        self._process.join()
        return ending(self._process.exitcode)


class _Slots:
    """Places for pictures in the memory that both processes share; they are used in turn."""

    def __init__(self, memory: int, working: WorkingSize) -> None:
        page = mmap.ALLOCATIONGRANULARITY
        self._size = -(-_WIDEST_SAMPLE * working.width * working.height // page) * page
        self.count = max(_LEAST_SLOTS, min(MOST_SLOTS, _SHARED_BYTES // self._size))
        # To give slots back one by one would take a twentieth of a run's time.
        self.at_once = max(1, self.count // _PARTS)
        os.ftruncate(memory, self.count * self._size)
        self._memory = memoryview(mmap.mmap(memory, self.count * self._size))

    def of(self, ordinal: int) -> memoryview:
        """Return the place of a picture; the former picture there must no longer be used."""
        first = ordinal % self.count * self._size
        return self._memory[first : first + self._size]


def _decode(theirs: Connection, ours: Connection, memory: int, order: _Order) -> None:
    """Decode and send all pictures, or an error; this function runs in the separate process."""
    ours.close()  # so that the pipe closes when the other process ends
    # A terminal sends these signals to all its processes; the other process decides what to do.
    signals.ignore("SIGINT", "SIGHUP")
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    try:
        _send_pictures(theirs, memory, order)
    except BaseException as error:
        story = "".join(traceback.format_exception(error))
        if not isinstance(error, OpploadError):  # some other errors cannot be pickled
            error = RuntimeError(f"{type(error).__name__}: {error}")
        error.add_note(story)
        with suppress(OSError):  # the other process has ended
            theirs.send(error)


def _send_pictures(connection: Connection, memory: int, order: _Order) -> None:
    from oppload_cli.video.container import ContainerSource
    from oppload_cli.video.planes import Resizing

    source = ContainerSource(order.name)
    source.decode.own_process = True
    working = WorkingSize.of(source.facts, order.height)
    connection.send((source.facts, source.decode))
    resizing = Resizing(*working.coded(source.facts.rotation))
    slots = _Slots(memory, working)
    in_use = 0
    for ordinal, picture in enumerate(order.span.within(source)):
        plane = resizing(picture.plane)
        while in_use == slots.count:
            connection.recv_bytes()
            in_use -= slots.at_once
        slots.of(ordinal)[: plane.nbytes] = plane.tobytes()
        facts = (picture.index, picture.time_s, picture.bits, picture.full_range)
        connection.send(_Shared(*facts, plane.shape, plane.dtype.str))
        in_use += 1
    connection.send(source.decode)
