"""Frames that are no video file: stimuli and arrays; and one way to open any source."""

from __future__ import annotations

from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from oppload_cli import stimulus
from oppload_cli.errors import ParameterError, SourceError
from oppload_cli.files.reading import is_there
from oppload_cli.models.presets import DEFAULT_PRESET, preset_named
from oppload_cli.video.frames import DecodeFacts, Frame, InputFacts, Picture, working_size
from oppload_cli.video.luminance import Luminance
from oppload_cli.video.source import open_video

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from oppload_cli.stimulus.protocol import Protocol
    from oppload_cli.video.frames import DecodedSource, FrameSource

    Frames = NDArray[Any]
    Source = str | Path | FrameSource | Protocol | Frames | Sequence[Frames]


class StimulusVideo:
    """The frames of a stimulus at the working size, as an open video would give them.

    Parameters
    ----------
    protocol : Protocol
        The stimulus.
    height : int or None
        Working height in pixels; None keeps the native size.
    times : int
        How often it is shown, each time at once after the time before.
    """

    def __init__(self, protocol: Protocol, height: int | None, times: int = 1) -> None:
        display = protocol.display
        self.protocol, self.times = protocol, times
        self.decode = DecodeFacts()
        self.facts = InputFacts(
            protocol.name,
            "stimulus",
            display.width,
            display.height,
            display.frame_rate,
            protocol.frame_count * times,
        )
        self.working = working_size(self.facts, height)
        self._luminance = Luminance(self.working, 0)

    def __iter__(self) -> Iterator[Frame]:
        for first in range(0, self.protocol.frame_count * self.times, self.protocol.frame_count):
            for shown in stimulus.frames(self.protocol):
                index = first + shown.index
                picture = Picture(index, self.protocol.time_of(index), shown.grey)
                self.decode.decoded += 1
                yield Frame(index, picture.time_s, self._luminance(picture))


class _ArrayVideo:
    """The frames of an array at the working size, as an open video would give them.

    Parameters
    ----------
    frames : ndarray or sequence of ndarray
        Shape (frames, height, width), or with a last axis of red, green and blue: uint8 or
        uint16 over their full range, or float from 0 (black) to 1 (white).
    rate : float or Fraction
        Frames per second, above 0.
    height : int or None
        Working height in pixels; None keeps the native size.

    Raises
    ------
    SourceError
        If they are not frames of such a shape and type.
    ParameterError
        If the rate is not above 0.
    """

    def __init__(
        self, frames: Frames | Sequence[Frames], rate: float | Fraction, height: int | None
    ) -> None:
        try:
            self._frames = np.asarray(frames)
        except ValueError as error:
            raise SourceError("array: its frames differ in shape; give them one shape") from error
        _check_frames(self._frames)
        if not 0 < rate <= 100_000:
            raise ParameterError(f"rate must be above 0 and at most 100000 frames/s, not {rate}")
        count, rows, columns = self._frames.shape[:3]
        self.decode = DecodeFacts()
        self.rate = Fraction(rate).limit_denominator(1 << 16)
        self.facts = InputFacts("array", "array", columns, rows, self.rate, count)
        self.working = working_size(self.facts, height)
        self._luminance = Luminance(self.working, 0)

    def __iter__(self) -> Iterator[Frame]:
        for index, values in enumerate(self._frames):
            time_s = float(index / self.rate)
            self.decode.decoded += 1
            yield Frame(index, time_s, self._luma(index, time_s, values))

    def _luma(self, index: int, time_s: float, values: Frames) -> NDArray[np.float32]:
        floating = values.dtype.kind == "f"
        if floating:
            values = values.astype(np.float32)
            if not (np.isfinite(values).all() and values.min() >= 0 and values.max() <= 1):
                raise SourceError(
                    f"array: frame {index} holds values outside 0 to 1; scale it, or give uint8"
                )
        if values.ndim == 3:
            values = np.asarray(cv2.cvtColor(values, cv2.COLOR_RGB2GRAY))
        if not floating:
            bits = 8 * values.dtype.itemsize
            return self._luminance(Picture(index, time_s, np.ascontiguousarray(values), bits))
        if values.shape == self.working.shape:
            return np.ascontiguousarray(values, np.float32)
        size = (self.working.width, self.working.height)
        return np.asarray(cv2.resize(values, size, interpolation=cv2.INTER_AREA), np.float32)


def _check_frames(frames: Frames) -> None:
    colour = frames.ndim == 4 and frames.shape[3] == 3
    if not (frames.ndim == 3 or colour) or 0 in frames.shape:
        raise SourceError(
            f"array: its shape is {frames.shape}; give (frames, height, width), or with a last "
            "axis of red, green and blue"
        )
    if frames.dtype not in {np.dtype(np.uint8), np.dtype(np.uint16)} and frames.dtype.kind != "f":
        raise SourceError(
            f"array: its type is {frames.dtype}; give uint8 or uint16, or float from 0 to 1"
        )


@contextmanager
def open_source(
    source: Source,
    *,
    rate: float | Fraction | None = None,
    height: int | str | None = None,
    preset: str = DEFAULT_PRESET,
) -> Iterator[DecodedSource]:
    """Open anything that holds frames, to iterate over it once.

    Parameters
    ----------
    source : str, Path, FrameSource, Protocol or array
        A video file, a folder or pattern of images, ``camera:0`` or a stream; the name of a
        stimulus of the catalogue; an open video, which is not closed; a stimulus; or an array
        of frames, as :class:`_ArrayVideo` takes them.
    rate : float or Fraction, optional
        Frames per second of an array, which needs it, or of images (else 30).
    height : int or str, optional
        Working height in pixels, or ``native``; else the preset's. An open video has one.
    preset : str
        Gives the working height.

    Yields
    ------
    DecodedSource
        With `facts`, and the `working` size of its frames.

    Raises
    ------
    SourceError
        If nothing can be read from it.
    ParameterError
        If the height, the preset or the rate is wrong, or an array has no rate.

    Examples
    --------
    >>> import oppload_cli as oppload
    >>> with oppload.open_source("controls/looming-perspective") as frames:
    ...     print(frames.working.shape, frames.facts.frame_rate)
    ...     print(sum(1 for frame in frames))
    (240, 320) 60
    102
    """
    pixels = preset_named(preset).height if height is None else height
    if pixels != "native" and (not isinstance(pixels, int) or not 1 <= pixels <= 8192):
        raise ParameterError(f"height must be 'native' or 1 to 8192 pixels, not {height!r}")
    size = None if isinstance(pixels, str) else pixels
    if isinstance(source, str) and _is_stimulus(source):
        source = stimulus.load(source)
    if isinstance(source, str | Path):
        with open_video(source, height=size, image_rate=Fraction(rate or 30)) as video:
            yield video
    elif hasattr(source, "facts") and hasattr(source, "working"):
        yield source  # type: ignore[misc]
    elif isinstance(source, np.ndarray | list | tuple):
        if rate is None:
            raise ParameterError("an array of frames has no times; give its rate, e.g. rate=30")
        yield _ArrayVideo(source, rate, size)
    elif isinstance(source, stimulus.Protocol):  # the last kind: this loads the stimuli
        yield StimulusVideo(source, size)
    else:
        raise SourceError(
            f"{type(source).__name__}: holds no frames; give a path, an open video, a stimulus or "
            "an array of frames"
        )


def _is_stimulus(name: str) -> bool:
    """Tell whether a name is one of the catalogue, and of no file."""
    if not name or is_there(Path(name)):
        return False
    known = (entry.name for entry in stimulus.entries())
    return any(name == each or name.startswith(f"{each}/") for each in known)
