"""Frames and pictures of an input, their times and sizes, and the facts of the input."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

from oppload_cli.errors import ParameterError, SourceError
from oppload_cli.frame_times import seconds_of
from oppload_cli.schema import is_integer

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping
    from fractions import Fraction

    import numpy as np
    from av.video.frame import VideoFrame
    from numpy.typing import NDArray

    from oppload_cli.frame_times import FrameTimes


WORKING_HEIGHT = 240  # px; the height at which the frames themselves are measured
HIGHEST = 8192  # px; largest working height
AUTO, NATIVE = "auto", "native"  # working heights: those of the detectors; that of the video


@dataclass(frozen=True, eq=False)  # `==` of two arrays is an array, not True or False
class Frame:
    """One frame for the detectors.

    Attributes
    ----------
    index : int
        Number of the frame in the complete input, from 0, in the order of decoding.
    time : int
        Presentation time minus that of frame 0, in ticks (:func:`oppload_cli.ticks`).
    luma : ndarray of float32, shape (height, width)
        Luminance, 0 to 1, at the working size.
    others : mapping of tuple of int to ndarray of float32
        The same luminance at other sizes that some detectors need, by height and width.
    colour : ndarray of uint8, shape (rows, columns, 3), or None
        The picture as displayed, in blue, green and red; None unless it was asked for.

    Examples
    --------
    >>> import oppload_cli as oppload
    >>> with oppload.open_source("controls/looming-perspective", height=120) as frames:
    ...     frame = next(iter(frames))
    >>> frame.index, frame.time_s, frame.luma.shape
    (0, 0.0, (120, 160))
    """

    index: int
    time: int
    luma: NDArray[np.float32]
    colour: NDArray[np.uint8] | None = None
    others: Mapping[tuple[int, int], NDArray[np.float32]] = field(default_factory=dict)

    @property
    def time_s(self) -> float:
        """Presentation time minus that of frame 0, in seconds."""
        return seconds_of(self.time)

    @property
    def lumas(self) -> Mapping[tuple[int, int], NDArray[np.float32]]:
        """The luminance at all sizes, by height and width."""
        height, width = self.luma.shape
        return {(height, width): self.luma, **self.others}


class FrameSource(Protocol):
    """A source of frames at the working size, such as an open video."""

    @property
    def facts(self) -> InputFacts:
        """The facts of the input."""

    @property
    def working(self) -> WorkingSize:
        """Size of the frames, and of their pixels in source pixels."""

    def __iter__(self) -> Iterator[Frame]:
        """Yield the frames in order, once."""


def other_sizes(
    facts: InputFacts, working: WorkingSize, heights: Iterable[int]
) -> list[WorkingSize]:
    """Return the working sizes of some heights in px that differ from the main one."""
    sizes = dict.fromkeys(WorkingSize.of(facts, height) for height in heights)
    return [size for size in sizes if size.shape != working.shape]


class DecodedSource(FrameSource, Protocol):
    """A source of frames that reports on the decoding after the last frame."""

    times: FrameTimes

    @property
    def decode(self) -> DecodeFacts:
        """The result of decoding."""


@dataclass(frozen=True)
class Picture:
    """One decoded frame before it is resized to the working size."""

    index: int  # as in `Frame`
    time: int  # as in `Frame`
    # The luma as coded, not turned, shape (rows, columns); often a view of the decoder's memory.
    plane: NDArray[np.uint8] | NDArray[np.uint16]
    bits: int = 8  # bits that a sample uses, 8 to 16
    full_range: bool = True  # False: luma runs from 16 to 235 (for 8 bits)
    # The same picture in colour; an array holds blue, green and red, shape (rows, columns, 3).
    original: VideoFrame | NDArray[np.uint8] | None = None
    corrected: bool = False  # whether the input gave a time that was wrong


@dataclass(frozen=True)
class InputFacts:
    """The facts that an input declares about itself."""

    name: str  # as the user wrote it, an address without user and password
    kind: str  # container, images, camera, stream, stimulus or array
    width: int  # of the displayed picture, in source pixels
    height: int
    frame_rate: Fraction | None
    frames_declared: int | None  # by the container
    mirrored: bool = False  # whether left and right are exchanged before the picture is turned
    rotation: int = 0  # counter-clockwise turn of the picture in degrees: 0, 90, 180 or 270
    codec: str = ""
    pixel_format: str = ""
    colour_range: str = "full"
    pixel_aspect: Fraction | None = None  # width over height of a pixel; it is not corrected
    bytes: int | None = None  # size of the file or files
    rate_assumed: bool = False  # as for images, or a raw stream, if nobody states a rate
    # The rate in the file, if the user states another one, at which the pictures were taken.
    rate_in_file: Fraction | None = None
    tick_s: Fraction | None = None  # length of a tick of the file's clock
    video_stream: int = 1  # number of the one that is read, from 1
    video_streams: int = 1  # how many there are in a container, without cover pictures
    # Whether pictures come at their own pace, so that a slow reader has to drop some of them; the
    # numbers of the frames show these gaps.
    real_time: bool = False

    @property
    def live(self) -> bool:
        """Whether the input is a camera or a stream, which may go on until the user stops it."""
        return self.kind in {"camera", "stream"}

    @property
    def rate_declared(self) -> Fraction | None:
        """The rate to compare with the times; None for GIF and APNG, which state only times."""
        return None if self.codec in {"gif", "apng"} else self.frame_rate

    def as_dict(self) -> dict[str, Any]:
        """Return the facts ready for JSON, fractions as ``"30000/1001"``."""
        facts = dict(vars(self))
        for name in ("frame_rate", "rate_in_file", "pixel_aspect", "tick_s"):
            value = facts[name]
            facts[name] = None if value is None else f"{value.numerator}/{value.denominator}"
        return facts


@dataclass
class DecodeFacts:
    """The result of decoding; final after the last picture."""

    decoded: int = 0  # frames
    failures: int = 0  # such as packets that the decoder refused
    corrupt: int = 0  # frames that the decoder marked as damaged
    missing: int = 0  # declared frames that never came, as far as it is known
    dropped: int = 0  # frames of an input in real time that waited too long to be analysed
    smoothed: int = 0  # frames whose time is not that of their arrival, but was estimated from it
    messages: list[str] = field(default_factory=list)  # reasons of the first five faults
    threads: int = 1  # of the decoder
    own_process: bool = False  # whether a separate process decoded

    @property
    def complete(self) -> bool:
        """Whether all declared frames of the wanted part were decoded without damage."""
        return self.failures == self.corrupt == self.missing == 0

    def failed(self, reason: object) -> None:
        """Count a failure, and keep its reason as `note` does."""
        self.failures += 1
        self.note(str(reason))

    def note(self, message: str) -> None:
        """Keep a message of one line, unless five or the same message are kept already."""
        if len(self.messages) < 5 and message not in self.messages:
            self.messages.append(message)

    def note_few_bits(self, brightest: int) -> None:
        """Note that pictures of 16 bits, of which `brightest` is the largest value, use few."""
        bits = brightest.bit_length()
        if 0 < bits <= _FEW_BITS:
            self.note(
                f"no value is above {brightest} of 65535, so that responses are low; if the "
                f"pictures have {bits} bits, scale them to 16 first"
            )


_FEW_BITS = 14  # of 16: values that need no more use at most a quarter of the range


def no_true_rate(name: str, reason: str) -> SourceError:
    """Return the error of an input whose rate no true rate can replace."""
    return SourceError(
        f"{name}: {reason}, so that its times cannot be scaled to a true rate; leave the "
        "true rate out"
    )


class PictureSource:
    """Base of the sources of pictures, for :class:`oppload_cli.video.source.Video`."""

    facts: InputFacts

    def __init__(self) -> None:
        self.decode = DecodeFacts()
        self.stopping = False  # another thread sets it: then the pictures end as soon as possible

    def pictures(self) -> Iterator[Picture]:
        """Yield the pictures in order, once; raise an error that ends the input."""
        raise NotImplementedError

    def finish(self) -> None:
        """Compare the decoded frames with the declared ones, after the last picture."""

    def close(self) -> None:
        """Close files, decoders and devices, if there are any; may be called twice."""


_LEAST_AHEAD, _MOST_AHEAD = 2, 16  # frames that may wait for the next thread
# Frames of an input in real time that may wait for the detectors. Networks deliver several frames
# at once: fewer would drop frames that a fast machine has time for. More would delay the results.
MOST_WAITING = 4
_WAITING_BYTES = 1 << 23  # most luminance that waits, unless `_LEAST_AHEAD` frames need more


def frames_ahead(facts: InputFacts, working: WorkingSize, *, colour: bool = False) -> int:
    """Return how many frames may wait between two threads.

    A long queue keeps both threads busy, because some frames take longer than others. But it needs
    memory, most of all with colour pictures, and it delays the frames of a live input.
    """
    if facts.live:
        return 1
    if colour:
        return _LEAST_AHEAD
    fit = _WAITING_BYTES // (4 * working.width * working.height)
    return max(_LEAST_AHEAD, min(_MOST_AHEAD, fit))


_LEAST_SIDE = 13  # px; in smaller frames OppLoD and D-LGMD do not respond to a disk
# Most pixels of any working frame, and of an enlarged one. The detectors need about 100 bytes per
# pixel, and an enlarged frame shows no more detail than its picture.
_MOST_WORKING_PIXELS, _MOST_ENLARGED = 1 << 25, 1 << 22
_USUAL_ENLARGING = 2.5  # opplod_paper, at 600 px, enlarges a video of 240 px by this factor


class WorkingSize(NamedTuple):
    """The size of the frames that the detectors get."""

    width: int
    height: int
    scale_x: float  # source pixels per working pixel
    scale_y: float

    @classmethod
    def of(cls, facts: InputFacts, height: int | None) -> WorkingSize:
        """Return the working size of an input.

        `height` is the working height in pixels; None keeps the native size. If the picture is
        higher than wide, `height` is its width, so that a camera turned by 90 degrees gives the
        same results. Raises ParameterError if `height` is not a whole number of at least 1, or if
        the frame would be too large.
        """
        if height is not None and not is_integer(height, 1):
            raise ParameterError(
                f"the working height must be None or a whole number of at least 1, not {height!r}"
            )
        if height is None:
            size = cls(facts.width, facts.height, 1.0, 1.0)
        else:
            sides = facts.width, facts.height
            width, rows = (max(1, round(side * height / min(sides))) for side in sides)
            size = cls(width, rows, facts.width / width, facts.height / rows)
        pixels = size.width * size.height
        if pixels > min(_MOST_WORKING_PIXELS, max(facts.width * facts.height, _MOST_ENLARGED)):
            raise ParameterError(
                f"{facts.name}: a working size of {size.width} x {size.height} is too large; "
                f"crop the picture, or choose a smaller working height"
            )
        return size

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width, in the order of arrays."""
        return self.height, self.width

    def remarks(self) -> list[str]:
        """Return a sentence if frames are too small, or much larger than their pictures."""
        size, enlarging = f"{self.width} x {self.height} px", 1 / min(self.scale_x, self.scale_y)
        if min(self.width, self.height) < _LEAST_SIDE:
            return [
                f"has a working size of {size}: below {_LEAST_SIDE} px no detector is known to "
                "respond to an approach; choose a larger working height"
            ]
        if enlarging <= _USUAL_ENLARGING:
            return []
        return [
            f"is enlarged {enlarging:.3g} times, to {size}: the models see no more detail than the "
            "input has; give a larger input, or a smaller working height"
        ]

    def coded(self, rotation: int) -> tuple[int, int]:
        """Return width and height before the picture is turned by `rotation` degrees."""
        return turned(self.width, self.height, rotation)


def parse_height(value: str | int) -> int | str:
    """Return a working height in pixels, ``auto`` or ``native``.

    Raises
    ------
    ParameterError
        If `value` is none of these words and not an integer from 1 to 8192.
    """
    text = str(value)
    if text in {AUTO, NATIVE}:
        return text
    if not re.fullmatch(r"[0-9]{1,4}", text) or not 1 <= int(text) <= HIGHEST:
        raise ParameterError(
            f"height must be 'auto', 'native' or a whole number of pixels from 1 to {HIGHEST}, "
            f"not '{value}'"
        )
    return int(text)


def pixels_of(height: int | str, own: int = WORKING_HEIGHT) -> int | None:
    """Return a working height in pixels, None for ``native``, and `own` for ``auto``."""
    return own if height == AUTO else None if isinstance(height, str) else height


def sizes_in_words(facts: InputFacts, working: WorkingSize) -> str:
    """Return the size and the rate of an input, and its working size, as a part of a sentence."""
    timing = f" at {float(facts.frame_rate):.6g} frames/s" if facts.frame_rate else ""
    return f"{facts.width} x {facts.height}{timing}, seen at {working.width} x {working.height}"


def turned(width: int, height: int, rotation: int) -> tuple[int, int]:
    """Return width and height of a picture after a turn by 0, 90, 180 or 270 degrees."""
    return (height, width) if rotation in (90, 270) else (width, height)


MAX_PIXELS = "OPPLOAD_MAX_PIXELS"  # an environment variable
DEFAULT_MAX_PIXELS = 1 << 26  # 8192 x 8192; a decoder keeps up to about 20 pictures
USUAL_BITS = 12  # per pixel: 8 bits of luma, and a quarter of the samples for both colours


def max_pixels() -> int:
    """Return the largest number of pixels of a picture: ``OPPLOAD_MAX_PIXELS``, or else 2^26.

    Raises ParameterError if the variable is not a whole number from 1 to 2^31 - 1.
    """
    text = os.environ.get(MAX_PIXELS, str(DEFAULT_MAX_PIXELS))
    if not (text.isascii() and text.isdigit() and len(text) <= 10 and 1 <= int(text) < 1 << 31):
        raise ParameterError(
            f"{MAX_PIXELS} must be a whole number from 1 to {(1 << 31) - 1}, not '{text}'"
        )
    return int(text)


def too_large(width: int, height: int, bits: int = USUAL_BITS) -> bool:
    """Return whether a picture of `bits` per pixel needs too much memory.

    The most is the memory of :func:`max_pixels` pixels of `USUAL_BITS`.
    """
    return width * height * max(bits, USUAL_BITS) > max_pixels() * USUAL_BITS


def check_pixels(name: str, width: int, height: int, bits: int = USUAL_BITS) -> None:
    """Raise SourceError, with the file's `name`, for a picture that is :func:`too_large`.

    A file of a few bytes may declare a picture that fills the memory.
    """
    if too_large(width, height, bits):
        deep = f" of {bits} bits" if bits > USUAL_BITS else ""
        limit = f"{max_pixels()} of {USUAL_BITS} bits" if deep else str(max_pixels())
        raise SourceError(
            f"{name}: declares {width} x {height} pixels{deep}, more than {limit}; "
            f"set {MAX_PIXELS} higher if that is right"
        )
