"""Opens and decodes a video in a separate process, beside the process of the detectors.

Python runs only one thread of a process at a time. With two processes, decoder and detectors do not
wait for each other, and load their libraries at the same time. If the decoder crashes, the video
ends, but the run goes on. The pictures pass through shared memory at the working size. If the
program cannot fork a process, or the input is not a file, a thread decodes instead.

The program forks the process before it loads NumPy, because a process with NumPy has several
threads. So this module imports no large library at its top.
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
from typing import TYPE_CHECKING, Any

from oppload_cli.errors import OpploadError, SourceError
from oppload_cli.files.reading import is_file
from oppload_cli.processes import cores, signals
from oppload_cli.processes.signals import POLL_S, ending, stop_if_asked
from oppload_cli.processes.threads import Call
from oppload_cli.video.frames import DecodeFacts, Picture, PictureSource, WorkingSize
from oppload_cli.video.inputs import is_camera, is_image_file, is_stack
from oppload_cli.video.span import Reading, Span

if sys.platform != "win32":
    import resource

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from multiprocessing.connection import Connection

    from oppload_cli.video.source import Video


_CRASHES = {"SIGABRT", "SIGBUS", "SIGFPE", "SIGILL", "SIGSEGV"}
_WIDEST_SAMPLE = 2  # bytes
# A slot is a place for one picture in the shared memory. With many slots the decoder can run far
# ahead while the other process loads the detectors.
MOST_SLOTS, _LEAST_SLOTS = 64, 3
_SHARED_BYTES = 1 << 24  # most shared memory, unless `_LEAST_SLOTS` slots need more
_AS_STATED = Reading()
_PARTS = 8  # one message frees an eighth of the slots


class Opening:
    """An input that is opened and decoded while the caller does other work.

    The parameters are those of :func:`oppload_cli.open_video`, and `own_process`: whether a
    separate process may decode. The process ignores `threads`. It decodes only video files, without
    colour, on Linux with two cores or more. In all other cases a thread decodes.
    """

    def __init__(
        self,
        name: str,
        *,
        height: int | None,
        span: Span,
        others: Sequence[int] = (),
        reading: Reading = _AS_STATED,
        threads: int = 0,
        colour: bool = False,
        own_process: bool = False,
    ) -> None:
        self.height, self._span, self._others, self._colour = height, span, others, colour
        self._video: Video | None = None
        self._process: _DecodingProcess | None = None
        # Pictures in colour, and of several sizes, are too large for the shared memory.
        alone = own_process and not colour and not others
        if alone and is_video_file(name) and cores() > 1 and _can_fork():
            # `os` has no `memfd_create` with some C libraries, and limits of files, processes or
            # sizes may forbid a process or shared memory.
            with suppress(OSError, AttributeError):
                self._process = _DecodingProcess(name, height, span, reading)
        if self._process is None:

            def source() -> PictureSource:
                from oppload_cli.video.source import source_of  # imports NumPy: not before a fork

                return source_of(name, reading, threads)

            self._call = Call(source)

    def result(self) -> Video:
        """Wait until the input is open, and return it; raises the errors of `open_video`."""
        from oppload_cli.video.source import Video

        if self._process is not None:
            self._video = Video(self._process.opened(), self.height, Span(), ahead=False)
        else:
            source, others, colour = self._call.result(), self._others, self._colour
            self._video = Video(source, self.height, self._span, others=others, colour=colour)
            self._video.begin()
        return self._video

    def close(self) -> None:
        """Stop decoding, and close the video; may be called twice."""
        if opened := self._video or self._process:
            opened.close()


def is_video_file(name: str) -> bool:
    """Return whether a text is the name of a single file that is not an image."""
    return is_file(name) and not (is_camera(name) or is_image_file(name) or is_stack(name))


def _can_fork() -> bool:
    """Return whether this process can be forked safely.

    If a process has several threads, its copy may hang; only Linux counts the threads of libraries
    too. A limit of the size of files also limits the shared memory.
    """
    if sys.platform != "linux":
        return False
    if resource.getrlimit(resource.RLIMIT_FSIZE)[0] != resource.RLIM_INFINITY:
        return False
    try:
        return len(os.listdir("/proc/self/task")) == 1  # noqa: PTH208 - a count of names
    except OSError:
        return False


class _DecodingProcess(PictureSource):
    """A source of pictures at the working size; a separate process decodes them from a file.

    The process also calls `finish` of its own source. Raises OSError if the system refuses a
    process or memory.
    """

    def __init__(self, name: str, height: int | None, span: Span, reading: Reading) -> None:
        super().__init__()
        self._slots: _Slots
        self._name, self._height = name, height
        self._lock = threading.Lock()
        context = multiprocessing.get_context("fork")
        with ExitStack() as on_failure:
            self._memory = os.memfd_create("oppload-pictures")
            on_failure.callback(os.close, self._memory)
            self._connection, theirs = context.Pipe()
            on_failure.callback(self._connection.close)
            # This process closes `theirs`, so that the pipe closes when the decoding process ends.
            with theirs:
                order = (name, height, span, reading)
                arguments = (theirs, self._connection, self._memory, order)
                self._process = context.Process(target=_decode, args=arguments, daemon=True)
                self._process.start()
            on_failure.pop_all()

    def opened(self) -> _DecodingProcess:
        """Wait until the file is open, set `facts` and `decode`, and return this source.

        Raises the errors of opening the file, and KeyboardInterrupt after a signal to stop.
        """
        try:
            while not self._connection.poll(POLL_S):
                stop_if_asked()
            self.facts, self.decode = self._received()
        except EOFError:
            cause = self._ending()
            self.close()
            raise SourceError(
                f"{self._name}: its decoder was ended ({cause}) before the first frame; "
                f"check the memory, or convert the file"
            ) from None
        except BaseException:
            self.close()
            raise
        self._slots = _Slots(self._memory, WorkingSize.of(self.facts, self._height))
        return self

    def pictures(self) -> Iterator[Picture]:
        """Yield the pictures; the plane of each is a view that is valid until the next picture.

        Raises SourceError if another program ended the process. If the decoder crashes, the
        pictures end, and a failure is counted.
        """
        import numpy as np

        index, ordinal = -1, 0
        try:
            while not isinstance(message := self._received(), DecodeFacts):
                index, time, bits, full_range, corrected, shape, dtype = message
                samples = np.frombuffer(self._slots.of(ordinal), dtype)
                plane = samples[: shape[0] * shape[1]].reshape(shape)
                ordinal += 1
                yield Picture(index, time, plane, bits, full_range, corrected=corrected)
                if not ordinal % self._slots.at_once:
                    self._free_slots()
            self.decode = message
        except EOFError:
            cause = self._ending()
            stop_if_asked()  # SIGTERM may have gone to all processes of a group
            if cause not in _CRASHES:
                raise SourceError(
                    f"{self._name}: its decoder was ended ({cause}) after frame {index}; "
                    f"check the memory, and run it again"
                ) from None
            self.decode = replace(self.decode, decoded=index + 1)
            self.decode.failed(f"the decoder crashed ({cause}) after frame {index}")

    def close(self) -> None:
        """End the process and free the memory; may be called twice."""
        self._process.kill()
        self._process.join()
        with self._lock:  # a thread that waits for a message gets its EOFError first
            self._connection.close()
        if self._memory >= 0:
            os.close(self._memory)
            self._memory = -1

    def _received(self) -> Any:
        with self._lock:
            if self._connection.closed:
                raise EOFError
            try:
                message = self._connection.recv()
            except ConnectionResetError:
                raise EOFError from None
        if isinstance(message, BaseException):
            raise message
        return message

    def _free_slots(self) -> None:
        """Tell the process that the slots of the latest `at_once` pictures are free again."""
        with self._lock:  # else another thread could close the connection meanwhile
            if not self._connection.closed:
                with suppress(OSError):  # the process has ended; the next `_received` reports it
                    self._connection.send_bytes(b"used")

    def _ending(self) -> str:
        self._process.join()
        return ending(self._process.exitcode)


class _Slots:
    """Places for pictures in the memory that both processes share.

    The pictures fill the places in turn; after the last place follows the first one again. The
    `ordinal` of a picture is its number among those that the process sends, from 0.
    """

    def __init__(self, memory: int, working: WorkingSize) -> None:
        page = mmap.ALLOCATIONGRANULARITY
        self._size = -(-_WIDEST_SAMPLE * working.width * working.height // page) * page
        self.count = max(_LEAST_SLOTS, min(MOST_SLOTS, _SHARED_BYTES // self._size))
        # A message for each single slot would take a twentieth of a run's time.
        self.at_once = max(1, self.count // _PARTS)
        os.ftruncate(memory, self.count * self._size)
        self._memory = memoryview(mmap.mmap(memory, self.count * self._size))

    def of(self, ordinal: int) -> memoryview:
        """Return the place of a picture; the earlier picture there must no longer be in use."""
        first = ordinal % self.count * self._size
        return self._memory[first : first + self._size]


def _decode(
    theirs: Connection, ours: Connection, memory: int, order: tuple[str, int | None, Span, Reading]
) -> None:
    """Decode and send all pictures, or an error; this function runs in the separate process.

    `order` is the name of the file, the working height, the part of it, and what the user states.
    """
    name, height, span, reading = order
    ours.close()  # so that the pipe closes when the process of the detectors ends
    # A terminal sends these signals to both processes; that of the detectors decides what to do.
    signals.ignore("SIGINT", "SIGHUP")
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    try:
        from oppload_cli.video.container import ContainerSource
        from oppload_cli.video.planes import Resizing

        source = ContainerSource(name, true_rate=reading.true_rate, number=reading.stream)
        source.decode.own_process = True
        working = WorkingSize.of(source.facts, height)
        theirs.send((source.facts, source.decode))
        resizing = Resizing(*working.coded(source.facts.rotation))
        slots = _Slots(memory, working)
        in_use = 0
        for ordinal, picture in enumerate(span.within(source)):
            plane = resizing(picture.plane)
            while in_use == slots.count:
                theirs.recv_bytes()
                in_use -= slots.at_once
            slots.of(ordinal)[: plane.nbytes] = plane.tobytes()
            facts = (picture.index, picture.time, picture.bits, picture.full_range)
            theirs.send((*facts, picture.corrected, plane.shape, plane.dtype.str))
            in_use += 1
        theirs.send(source.decode)
    except BaseException as error:
        trace = "".join(traceback.format_exception(error))
        if not isinstance(error, OpploadError):  # some other errors cannot be pickled
            error = RuntimeError(f"{type(error).__name__}: {error}")
        error.add_note(trace)
        with suppress(OSError):  # the process of the detectors has ended
            theirs.send(error)
