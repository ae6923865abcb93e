"""A video file decoded in a process of its own, beside the one that has the models.

Python does one thing at a time in a process: decoding apart, neither waits for the
other, and both load their libraries at once. And damage that crashes a decoder ends
the video, not the run. Pictures come at the working size, through memory that both share.
"""

from __future__ import annotations

import mmap
import os
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, NamedTuple, Self

from oppload_cli.environment import cores
from oppload_cli.errors import SourceError
from oppload_cli.processes.forked import DiedError, Forked, can_fork
from oppload_cli.video.frames import DecodeFacts, InputFacts, Picture

if TYPE_CHECKING:
    from collections.abc import Iterator

    from oppload_cli.processes.forked import Outlet
    from oppload_cli.video.span import Span
    from oppload_cli.video.working import WorkingSize

CRASHES = {"SIGABRT", "SIGBUS", "SIGFPE", "SIGILL", "SIGSEGV"}
WIDEST_SAMPLE = 2  # bytes
# Pictures that wait: while the other process loads the models this one is far ahead.
MOST_SLOTS, LEAST_SLOTS = 64, 3
SHARED_BYTES = 1 << 24  # at most, above the least


class _Order(NamedTuple):
    """What to decode."""

    name: str
    height: int | None
    span: Span
    threads: int


class _Opened(NamedTuple):
    """What is known once the file is open."""

    facts: InputFacts
    working: WorkingSize
    decode: DecodeFacts


class _Shared(NamedTuple):
    """A picture but for its samples, which are in the shared memory."""

    frame: int
    time_s: float
    bits: int
    full_range: bool
    shape: tuple[int, int]
    kind: str  # of NumPy


class DecodingProcess:
    """A process that stands by to decode one video file: then a source of its pictures.

    The pictures are at the working size, and no others than those of the span.

    Raises
    ------
    OSError
        If no process is to be had.
    """

    def __init__(self) -> None:
        self.decode = DecodeFacts()
        self.stopping = False
        self.facts: InputFacts
        self._name = ""
        self._slots: _Slots
        memory = os.memfd_create("oppload-pictures")
        try:
            self._process = Forked(partial(_stand_by, memory))
        except BaseException:
            os.close(memory)
            raise
        self._memory = memory

    @classmethod
    def if_possible(cls) -> DecodingProcess | None:
        """Return one, unless something speaks against it.

        Returns
        -------
        DecodingProcess or None
            None where there is one core, or where this process cannot be copied.
        """
        if cores() > 1 and can_fork():
            with suppress(OSError, AttributeError):  # not every C library has such memory
                return cls()
        return None

    def begin(self, name: str, height: int | None, span: Span, threads: int) -> None:
        """Say what to decode.

        Parameters
        ----------
        name : str
            A path.
        height : int or None
            Working height; None keeps the native size.
        span : Span
            The part of the file to yield: no more than that is decoded.
        threads : int
            Decoder threads; 0 chooses by the codec, the size and the cores.
        """
        self._name = name
        self._process.tell(_Order(name, height, span, threads))

    def opened(self) -> Self:
        """Wait until the file is open.

        Returns
        -------
        DecodingProcess
            This one; its facts are known now.

        Raises
        ------
        SourceError
            If the file cannot be opened, or no frame can be decoded.
        ParameterError
            If the working size is too large.
        """
        try:
            opened = next(self._process)
        except DiedError as died:
            self.close()
            raise SourceError(
                f"{self._name}: its decoder was ended ({died}) before the first frame; "
                f"check the memory, or convert the file"
            ) from None
        except BaseException:
            self.close()
            raise
        self.facts, self.decode = opened.facts, opened.decode
        self._slots = _Slots(self._memory, opened.working)
        return self

    def pictures(self) -> Iterator[Picture]:
        """Yield the pictures.

        Yields
        ------
        Picture
            Its plane is a view that lasts until the next one.

        Raises
        ------
        SourceError
            If the process is ended from outside. A crash of the decoder ends the
            pictures, and counts as a failure.
        """
        import numpy as np  # noqa: PLC0415 - the process begins before it is loaded

        decoded = 0
        try:
            for ordinal, each in enumerate(self._process):
                if isinstance(each, DecodeFacts):
                    self.decode = each
                    continue
                samples = np.frombuffer(self._slots.of(ordinal), each.kind)
                plane = samples[: each.shape[0] * each.shape[1]].reshape(each.shape)
                decoded = each.frame + 1
                yield Picture(each.frame, each.time_s, plane, each.bits, each.full_range)
        except DiedError as died:
            if str(died) not in CRASHES:
                raise SourceError(
                    f"{self._name}: its decoder was ended ({died}) after frame {decoded - 1}; "
                    f"check the memory, and run it again"
                ) from None
            self.decode = replace(self.decode, decoded=decoded)
            self.decode.failed(f"the decoder crashed ({died}) after frame {decoded - 1}")

    def finish(self) -> None:
        """Do nothing: what came was compared with what was declared where it was decoded."""

    def close(self) -> None:
        """End the process and give back the memory; may be called twice."""
        self._process.close()
        if self._memory >= 0:
            os.close(self._memory)
            self._memory = -1


class _Slots:
    """Places for pictures in memory that two processes share, used in turn."""

    def __init__(self, memory: int, working: WorkingSize) -> None:
        page = mmap.ALLOCATIONGRANULARITY
        self._size = -(-WIDEST_SAMPLE * working.width * working.height // page) * page
        self.count = max(LEAST_SLOTS, min(MOST_SLOTS, SHARED_BYTES // self._size))
        os.ftruncate(memory, self.count * self._size)
        self._memory = memoryview(mmap.mmap(memory, self.count * self._size))

    def of(self, ordinal: int) -> memoryview:
        """Return the place of a picture; the one that had it before must be out of use."""
        first = ordinal % self.count * self._size
        return self._memory[first : first + self._size]


def _stand_by(memory: int, outlet: Outlet) -> None:
    """Load the libraries, then decode what is ordered: what the process does."""
    import numpy as np  # noqa: PLC0415 - of what is loaded here the models need little

    from oppload_cli.video.container import ContainerSource  # noqa: PLC0415
    from oppload_cli.video.working import Resizing, working_size  # noqa: PLC0415

    order: _Order = outlet.hear()
    source = ContainerSource(order.name, order.threads)
    source.decode.apart = True
    working = working_size(source.facts, order.height)
    outlet.send(_Opened(source.facts, working, source.decode))
    resizing = Resizing(working, source.facts.rotation)
    slots = _Slots(memory, working)
    for ordinal, picture in enumerate(order.span.within(source)):
        plane = resizing(picture.plane)
        outlet.wait(slots.count - 1)
        place = np.frombuffer(slots.of(ordinal), plane.dtype)
        np.copyto(place[: plane.size].reshape(plane.shape), plane)
        what = (picture.index, picture.time_s, picture.bits, picture.full_range)
        outlet.send(_Shared(*what, plane.shape, plane.dtype.str))
    outlet.send(source.decode)
