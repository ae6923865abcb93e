"""A labelled clip with the output of every detector for it."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Numbers = NDArray[np.float64]
    Flags = NDArray[np.bool_]
    Box = tuple[float, float, float, float]


_UNSTATED = "not stated"
_BEFORE = "before an approach"


@dataclass(frozen=True)
class Label:
    """The manifest's knowledge of a clip.

    Attributes
    ----------
    name : str
        The clip, as its manifest names it.
    onset, contact : int or None
        Frames at which an approach begins and ends, both included; None without one.
    motion : str
        Kind of motion of a clip without an approach.
    boxes : dict of int to tuple
        By frame, the object's left, top, width and height in source pixels.
    contacts : dict of int to float
        By frame, the true time to contact in seconds, where it is known.
    conditions : dict of str to str
        Values by which clips of known truth are grouped, such as the speed.
    """

    name: str
    onset: int | None = None
    contact: int | None = None
    motion: str = ""
    boxes: dict[int, Box] = field(default_factory=dict)
    contacts: dict[int, float] = field(default_factory=dict)
    conditions: dict[str, str] = field(default_factory=dict)

    @property
    def looming(self) -> bool:
        """Whether an object approaches in the clip."""
        return self.contact is not None

    @property
    def kind(self) -> str:
        """The kind of motion of the clip's footage without an approach."""
        return _BEFORE if self.looming else self.motion or _UNSTATED


@dataclass(frozen=True)
class Output:
    """The output of one detector for one clip.

    Attributes
    ----------
    response : ndarray, shape (n,)
        Per frame, at least 0; NaN during warm-up.
    evidence : ndarray, shape (n,)
        What an alarm compares with its threshold: the response, or more shortly before contact.
    alarm : ndarray of bool, shape (n,), or None
        The detector's own alarm; None where it has none.
    winner : ndarray, shape (n, 4), or None
        Left, top, width and height of the winning unit's receptive field in source
        pixels; NaN in frames without a winner; None for a detector without units.
    box : ndarray, shape (n, 4), or None
        The same of the strongest looming object that it sees.
    contact_s : ndarray, shape (n,), or None
        Its time to contact; NaN where it is not determined.
    """

    response: Numbers
    evidence: Numbers
    alarm: Flags | None = None
    winner: Numbers | None = None
    box: Numbers | None = None
    contact_s: Numbers | None = None


@dataclass(frozen=True)
class Clip:
    """A clip that every detector has analysed.

    Attributes
    ----------
    label : Label
        From the manifest.
    time_s : ndarray, shape (n,)
        Presentation time of each frame.
    width, height : int
        Of the source in pixels.
    outputs : dict of str to Output
        By detector.
    """

    label: Label
    time_s: Numbers
    width: int
    height: int
    outputs: dict[str, Output]

    def __len__(self) -> int:
        return len(self.time_s)

    @cached_property
    def first(self) -> int:
        """The first frame with a response of every detector; the length if none has one.

        The same frames count for all detectors, however long each takes to warm up.
        """
        valid = np.all([np.isfinite(each.response) for each in self.outputs.values()], axis=0)
        return int(valid.argmax()) if valid.any() else len(self)

    @property
    def quiet(self) -> tuple[int, int]:
        """First frame, and the one after the last, of the footage without an approach."""
        stop = len(self) if self.label.onset is None else self.label.onset
        return self.first, max(self.first, stop)

    @property
    def approach(self) -> tuple[int, int]:
        """First frame, and the one after the last, of the approach; empty without one."""
        if self.label.onset is None or self.label.contact is None:
            return len(self), len(self)
        return max(self.first, self.label.onset), self.label.contact + 1

    def seconds(self, start: int, stop: int) -> float:
        """Return the duration of the frames from `start` to before `stop`, in seconds.

        It counts from the frame before the first to the last.
        """
        if stop <= start or len(self) < 2:
            return 0.0
        if start > 0:
            return float(self.time_s[stop - 1] - self.time_s[start - 1])
        period = float(self.time_s[-1] - self.time_s[0]) / (len(self) - 1)
        return float(self.time_s[stop - 1] - self.time_s[0]) + period

    def lead(self, frame: int) -> float:
        """Return the time from a frame to contact, in seconds; NaN without an approach."""
        if self.label.contact is None:
            return float("nan")
        return float(self.time_s[self.label.contact] - self.time_s[frame])
