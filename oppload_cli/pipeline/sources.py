"""Stimuli and arrays as sources of frames, and a function that opens any source."""

from __future__ import annotations

from abc import ABC, abstractmethod
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from oppload_cli import stimulus
from oppload_cli.errors import ParameterError, SourceError
from oppload_cli.files.reading import is_there
from oppload_cli.frame_times import FrameTimes, ticks
from oppload_cli.video.frames import (
    AUTO,
    DecodeFacts,
    Frame,
    InputFacts,
    Picture,
    WorkingSize,
    other_sizes,
    parse_height,
    pixels_of,
    sizes_in_words,
)
from oppload_cli.video.inputs import HIGHEST_RATE, checked_rate
from oppload_cli.video.luminance import Luminance
from oppload_cli.video.source import open_video

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from fractions import Fraction

    from numpy.typing import NDArray

    from oppload_cli.stimulus.protocol import Protocol
    from oppload_cli.video.frames import DecodedSource, FrameSource

    Frames = NDArray[Any]
    Source = str | Path | FrameSource | Protocol | Frames | Sequence[Frames]
    Times = Sequence[float] | NDArray[np.floating[Any] | np.integer[Any]]


class ArrayLuminance:
    """Converts pictures that are arrays to luminance at the working size.

    The arrays have the shape (height, width), or a third axis of red, green and blue. They are
    uint8 or uint16 over their full range, or float from 0 (black) to 1 (white).
    """

    def __init__(self, working: WorkingSize) -> None:
        self._working = working
        self._of_plane = Luminance(working)

    def __call__(self, values: Frames, name: str) -> NDArray[np.float32]:
        """Return the luminance of a picture, 0 to 1, as a new array.

        Raises SourceError, with the picture's name, if the picture has another type, or floating
        values that are not finite or outside 0 to 1.
        """
        _check_type(values, name)
        values = values.astype(values.dtype.newbyteorder("="), copy=False)  # as OpenCV needs it
        is_float = values.dtype.kind == "f"
        if is_float:
            values = values.astype(np.float32)  # always a copy
            if not np.isfinite(values).all():
                raise SourceError(f"{name} holds NaN or infinite values; replace them")
            if values.min() < 0 or values.max() > 1:
                raise SourceError(f"{name} holds values outside 0 to 1; scale it, or give uint8")
        if values.ndim == 3:
            code = cv2.COLOR_RGB2GRAY
            if values.strides[2] < 0:  # bgr[..., ::-1], which would take three times as long
                values, code = values[..., ::-1], cv2.COLOR_BGR2GRAY
            if values.dtype == np.uint8:  # OpenCV would round grey to 8 bits before it is resized
                values = np.multiply(values, np.uint16(257), dtype=np.uint16)
            values = np.asarray(cv2.cvtColor(np.ascontiguousarray(values), code))
        if not is_float:
            bits = 8 * values.dtype.itemsize
            return self._of_plane(Picture(0, 0, np.ascontiguousarray(values), bits))
        if values.shape == self._working.shape:
            return np.asarray(values, np.float32)
        from oppload_cli.video.planes import resized  # noqa: PLC0415 - imports PyAV, rarely needed

        return resized(values, (self._working.width, self._working.height))


class _VideoInMemory(ABC):
    """Base of videos whose pictures are computed or in memory, with the interface of `Video`."""

    def __init__(self, facts: InputFacts, height: int | None, others: Sequence[int] = ()) -> None:
        self.facts = facts
        self.working = WorkingSize.of(facts, height)
        self.others = other_sizes(facts, self.working, others)
        self._begin()
        self._luminance = ArrayLuminance(self.working)
        self._others = {size.shape: ArrayLuminance(size) for size in self.others}

    def _begin(self) -> None:
        self.decode, self.times = DecodeFacts(), FrameTimes(self.facts.frame_rate)

    def __repr__(self) -> str:
        name = type(self).__name__.lstrip("_")
        return f"{name}({self.facts.name!r}, {sizes_in_words(self.facts, self.working)})"

    def __iter__(self) -> Iterator[Frame]:
        self._begin()  # unlike those of a video, the frames can be had again
        for index, (time, values) in enumerate(self._pictures()):
            self.decode.decoded += 1
            name = f"array: frame {index}"
            luma = self._luminance(values, name)
            others = {shape: convert(values, name) for shape, convert in self._others.items()}
            yield Frame(index, self.times.step(time), luma, others=others)

    @abstractmethod
    def _pictures(self) -> Iterator[tuple[int, Frames]]:
        """Yield each picture with its presentation time in ticks."""


class StimulusVideo(_VideoInMemory):
    """The frames of a stimulus at the working size, like those of an open video.

    `height` is the working height in pixels; None keeps the native size. `others` are further
    heights that each frame has. `presentations` is the number of times that the stimulus is shown,
    one after the other without a pause.
    """

    def __init__(
        self,
        protocol: Protocol,
        height: int | None,
        presentations: int = 1,
        others: Sequence[int] = (),
    ) -> None:
        display, frames = protocol.display, protocol.frame_count * presentations
        size, rate = (display.width, display.height), display.frame_rate
        facts = InputFacts(protocol.name, "stimulus", *size, rate, frames)
        super().__init__(facts, height, others)
        self.protocol = protocol

    def _pictures(self) -> Iterator[tuple[int, Frames]]:
        for first in range(0, self.facts.frames_declared or 0, self.protocol.frame_count):
            for shown in stimulus.frames(self.protocol):
                yield ticks(self.protocol.time_of(first + shown.index)), shown.grey


class _ArrayVideo(_VideoInMemory):
    """The frames of an array; the parameters and errors are those of :func:`open_source`."""

    def __init__(
        self,
        frames: Frames | Sequence[Frames],
        rate: float | Fraction | None,
        times: Times | None,
        height: int | None,
        others: Sequence[int],
    ) -> None:
        try:
            self._frames = np.asarray(frames)
        except ValueError as error:
            raise SourceError("array: its frames differ in shape; give them one shape") from error
        shape = self._frames.shape
        if not (len(shape) == 3 or (len(shape) == 4 and shape[3] == 3)) or 0 in shape:
            raise SourceError(
                f"array: its shape is {shape}; give (frames, height, width), or with a last axis "
                "of red, green and blue"
            )
        _check_type(self._frames, "array")
        count, rows, columns = shape[:3]
        declared = checked_rate(rate)
        if times is not None:
            self._times_s = _checked_times(times, count)
            steps = np.diff(self._times_s)
            usual_s = float(np.median(steps)) if len(steps) else 0.0
            if declared is None and usual_s * HIGHEST_RATE >= 1:
                declared = checked_rate(1 / usual_s)
        elif declared is not None:
            self._times_s = [float(index / declared) for index in range(count)]
        else:
            raise ParameterError(
                "an array of frames has no times; give its rate, e.g. rate=30, or the times"
            )
        facts = InputFacts("array", "array", columns, rows, declared, count)
        super().__init__(facts, height, others)

    def _pictures(self) -> Iterator[tuple[int, Frames]]:
        for time_s, values in zip(self._times_s, self._frames, strict=True):
            yield ticks(time_s) - ticks(self._times_s[0]), values


class _Counted:
    """A user's own source of frames, with the report on its frames that it need not have."""

    def __init__(self, source: FrameSource) -> None:
        self.facts, self.working, self.decode = source.facts, source.working, DecodeFacts()
        self.others: Sequence[WorkingSize] = getattr(source, "others", ())
        self.times = FrameTimes(source.facts.frame_rate)
        self._source = source

    def __iter__(self) -> Iterator[Frame]:
        for frame in self._source:
            self.decode.decoded += 1
            yield replace(frame, time=self.times.step(frame.time))


def _checked_times(times: Times, count: int) -> list[float]:
    try:
        values = np.asarray(times)
        if values.dtype.kind in "mM":  # dates and durations, which NumPy would take for integers
            raise TypeError
        values = values.astype(np.float64)
    except (TypeError, ValueError):
        values = np.full(1, np.nan)
    if not np.isfinite(values).all():
        raise ParameterError("times must be finite numbers of seconds")
    if values.shape != (count,):
        raise ParameterError(
            f"times must hold one time for each of the {count} frames, not shape {values.shape}"
        )
    late = np.flatnonzero(np.diff(values) <= 0)
    if late.size:
        before, after = values[late[0] : late[0] + 2]
        raise ParameterError(
            f"times must increase: frame {late[0] + 1} has {after:g} s, and the frame before "
            f"{before:g} s; put them right, or give a rate"
        )
    return [float(value) for value in values]


def _check_type(frames: Frames, name: str) -> None:
    """Raise a SourceError for an array whose type does not say which value is white."""
    native = frames.dtype.newbyteorder("=")  # stacks of microscopes are often big-endian
    if native not in {np.dtype(np.uint8), np.dtype(np.uint16)} and native.kind != "f":
        raise SourceError(
            f"{name}: its type is {frames.dtype}; give uint8 or uint16, or float from 0 to 1"
        )


@contextmanager
def open_source(
    source: Source,
    *,
    rate: float | Fraction | None = None,
    times: Times | None = None,
    height: int | str | None = None,
    others: Sequence[int] = (),
) -> Iterator[DecodedSource]:
    """Open any source of frames, to iterate over it once.

    Parameters
    ----------
    source : str, Path, FrameSource, Protocol or array
        A video file, a folder or pattern of images, ``camera:0`` or a stream; the TOML file of a
        stimulus, or the name of one in the catalogue; an open video, which is not closed; a
        stimulus; or an array. An array has the shape (frames, height, width), or (frames, height,
        width, 3) with red, green and blue, and is uint8 or uint16 over its full range, or float
        from 0 (black) to 1 (white).
    rate : float or Fraction, optional
        Frames per second of an array, or of images (30 if left out). Other sources have a rate.
    times : sequence of float, optional
        The presentation time of each frame of an array in seconds, instead of a rate.
    height : int or str, optional
        Working height in pixels, or ``native``; 240 if left out. An open video keeps its own.
    others : sequence of int
        Further working heights in pixels that some detectors need.

    Yields
    ------
    DecodedSource
        The open source, with `facts` and the `working` size of its frames.

    Raises
    ------
    SourceError
        If nothing can be read from the source.
    StimulusError
        If the stimulus of a TOML file is not valid, or if the file has several.
    ParameterError
        If the height or the rate is wrong, if an array has neither rate nor times, or
        if times are given for another source than an array.

    Examples
    --------
    >>> import oppload_cli as oppload
    >>> with oppload.open_source("controls/looming-perspective") as frames:
    ...     print(frames.working.shape, frames.facts.frame_rate)
    ...     print(sum(1 for frame in frames))
    (240, 320) 60
    102
    """
    size = pixels_of(parse_height(AUTO if height is None else height))
    # Names of stimuli have slashes, also on Windows.
    name = source.as_posix() if isinstance(source, Path) else source
    if isinstance(name, str) and _is_stimulus(name):
        source = stimulus.load(name)
    is_array = isinstance(source, np.ndarray | list | tuple)
    if isinstance(source, list | tuple) and source and isinstance(source[0], str | Path):
        raise SourceError("a list of names is no source of frames; take one name after the other")
    if times is not None and not is_array:
        raise ParameterError(
            "only an array of frames takes times; other sources have times of their own"
        )
    if isinstance(source, str | Path):
        image_rate = checked_rate(rate)
        with open_video(source, height=size, others=others, image_rate=image_rate) as video:
            if image_rate not in {None, video.facts.frame_rate}:
                raise ParameterError(
                    f"{source}: has times or a rate of its own; rate is for an array or images; "
                    "for slow motion, or a raw stream, give open_video(name, true_rate=...)"
                )
            yield video
    elif hasattr(source, "facts") and hasattr(source, "working"):
        yield source if hasattr(source, "decode") else _Counted(source)  # type: ignore[arg-type, misc]
    elif is_array:
        yield _ArrayVideo(source, rate, times, size, others)  # type: ignore[arg-type]
    elif isinstance(source, stimulus.Protocol):  # checked last, as it imports the stimuli
        _check_rate(source, rate)
        yield StimulusVideo(source, size, others=others)
    else:
        raise SourceError(
            f"{type(source).__name__}: holds no frames; give a path, a camera such as 'camera:0', "
            "an open video, a stimulus or an array of frames"
        )


def _check_rate(protocol: stimulus.Protocol, rate: float | Fraction | None) -> None:
    own = protocol.display.frame_rate
    if checked_rate(rate) not in {None, own}:
        raise ParameterError(
            f"{protocol.name}: has {own} frames/s; leave out the rate, or load the stimulus with "
            "another display.frame_rate"
        )


def _is_stimulus(name: str) -> bool:
    """Return whether a name is that of a TOML file, or one in the catalogue that no file has.

    Raises SourceError for a name that no file has, and that is like one in the catalogue.
    """
    if name.endswith(".toml") or ".toml/" in name:
        return True
    if not name or is_there(name):
        return False
    known = (entry.name for entry in stimulus.entries())
    if any(name == entry_name or name.startswith(f"{entry_name}/") for entry_name in known):
        return True
    from oppload_cli.stimulus.catalogue import meant_by  # noqa: PLC0415 - loaded by now

    if meant := meant_by(name):
        raise SourceError(f"{name}: no such file; did you mean the stimulus '{meant}'?")
    return False
