"""The records that pass from a video to the models, and what is known of an input."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    from collections.abc import Iterator
    from fractions import Fraction

    import numpy as np
    from av.video.frame import VideoFrame
    from numpy.typing import NDArray

    from oppload_cli.video.working import WorkingSize


@dataclass(frozen=True)
class Frame:
    """One frame as the models see it.

    Attributes
    ----------
    index : int
        0-based decode ordinal in the whole input.
    time_s : float
        Presentation time minus that of frame 0, in seconds.
    luma : ndarray of float32, shape (height, width)
        Luminance, 0 to 1, at the working size.
    colour : ndarray of uint8, shape (rows, columns, 3), or None
        The picture as displayed, blue, green and red, where it was asked for.
    """

    index: int
    time_s: float
    luma: NDArray[np.float32]
    colour: NDArray[np.uint8] | None = None


class FrameSource(Protocol):
    """What a pass takes its frames from, such as an open video."""

    @property
    def facts(self) -> InputFacts:
        """What is known of the input."""

    @property
    def working(self) -> WorkingSize:
        """Size of the frames, and what a pixel of them is in the source."""

    def __iter__(self) -> Iterator[Frame]:
        """Yield the frames in order, once."""


@dataclass(frozen=True)
class Picture:
    """One decoded frame before it is brought to the working size.

    Attributes
    ----------
    index, time_s
        As in :class:`Frame`.
    plane : ndarray of uint8 or uint16, shape (rows, columns)
        The luma as coded, not rotated; often a view of the decoder's memory.
    bits : int
        Bits that a sample uses, 8 to 16.
    full_range : bool
        Whether samples use all of their range, or 16 to 235 (of 8 bits).
    original : av.VideoFrame or ndarray of uint8, shape (rows, columns, 3)
        What `plane` was taken from, in colour (an array is blue, green and red).
    """

    index: int
    time_s: float
    plane: NDArray[np.uint8] | NDArray[np.uint16]
    bits: int = 8
    full_range: bool = True
    original: VideoFrame | NDArray[np.uint8] | None = None


@dataclass(frozen=True)
class InputFacts:
    """What an input declares about itself, in its displayed orientation.

    Attributes
    ----------
    name : str
        What the user named.
    kind : str
        ``container``, ``images``, ``camera`` or ``stream``.
    width, height : int
        Size in source pixels, after rotation.
    frame_rate : Fraction or None
        Frames per second.
    frames_declared : int or None
        As the container says; None where it does not.
    rotation : int
        Counter-clockwise turn in degrees that was applied: 0, 90, 180 or 270.
    codec, pixel_format, colour_range : str
        As decoded.
    pixel_aspect : Fraction or None
        Width over height of a pixel; recorded, not corrected.
    bytes : int or None
        Size of the file or files.
    """

    name: str
    kind: str
    width: int
    height: int
    frame_rate: Fraction | None
    frames_declared: int | None
    rotation: int = 0
    codec: str = ""
    pixel_format: str = ""
    colour_range: str = "full"
    pixel_aspect: Fraction | None = None
    bytes: int | None = None

    def as_dict(self) -> dict[str, Any]:
        """Return the facts ready for JSON, fractions as ``"30000/1001"``.

        Returns
        -------
        dict
        """
        facts = dict(vars(self))
        for name in ("frame_rate", "pixel_aspect"):
            value = facts[name]
            facts[name] = None if value is None else f"{value.numerator}/{value.denominator}"
        return facts


@dataclass
class DecodeFacts:
    """What came of decoding; complete once the source is exhausted.

    Attributes
    ----------
    decoded : int
        Frames that came out.
    failures : int
        Packets that the decoder refused.
    corrupt : int
        Frames that the decoder itself marked as damaged.
    missing : int
        Frames declared that never came, where this can be told.
    messages : list of str
        The first few reasons.
    threads : int
        Of the decoder.
    apart : bool
        Whether a process of its own decoded.
    """

    decoded: int = 0
    failures: int = 0
    corrupt: int = 0
    missing: int = 0
    messages: list[str] = field(default_factory=list)
    threads: int = 1
    apart: bool = False

    @property
    def complete(self) -> bool:
        """Whether all that was declared and asked for came out undamaged."""
        return self.failures == self.corrupt == self.missing == 0

    def failed(self, reason: object) -> None:
        """Count a failure, and keep its reason if it is one of the first.

        Parameters
        ----------
        reason : object
            The error.
        """
        self.failures += 1
        self.note(str(reason))

    def note(self, message: str) -> None:
        """Keep a message if it is one of the first.

        Parameters
        ----------
        message : str
            One line.
        """
        if len(self.messages) < 5 and message not in self.messages:
            self.messages.append(message)


class PictureSource(Protocol):
    """What every kind of input offers to :class:`oppload_cli.video.source.Video`."""

    facts: InputFacts
    decode: DecodeFacts
    stopping: bool  # set by another thread: end as soon as may be

    def pictures(self) -> Iterator[Picture]:
        """Yield the pictures in order, once; errors that end the input are raised."""

    def finish(self) -> None:
        """Compare what came with what was declared, after the last picture."""

    def close(self) -> None:
        """Give back files, decoders and devices; may be called twice."""
