"""Labelled clips with the output of every detector, and windows of one second of them.

The ROC and precision-recall curves go over the windows.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    Numbers = NDArray[np.float64]
    Flags = NDArray[np.bool_]
    Box = tuple[float, float, float, float]


_UNSTATED = "not stated"
_BEFORE = "before an approach"
WINDOW_S = 1.0
LEAST_S = 0.5  # the remainder of a clip counts as a window from this length
EPSILON_S = 1e-6  # times are fractions of a second that were rounded
AHEAD = (0, 4, 8, 12)  # frames before contact


@dataclass(frozen=True)
class Label:
    """The facts that a manifest or a ground truth states about a clip.

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
        By frame, the true time to contact in seconds of the looming object that arrives first,
        where it is known.
    conditions : dict of str to str
        Values by which clips of known truth are grouped, such as the speed.
    contact_times : tuple of float
        True times of contact of the approaching objects in seconds, rising, where they are known;
        else the contact is at the time of the frame `contact`. An object may stop growing before.
    since : int
        First frame that counts: where a video shows several approaches, one after the other, each
        is a clip of its own, and only the frames before the first onset are footage without one.
    video : int or None
        A number that all clips of one video share; None for the only one.
    """

    name: str
    onset: int | None = None
    contact: int | None = None
    motion: str = ""
    boxes: dict[int, Box] = field(default_factory=dict)
    contacts: dict[int, float] = field(default_factory=dict)
    conditions: dict[str, str] = field(default_factory=dict)
    contact_times: tuple[float, ...] = ()
    since: int = 0
    video: int | None = None

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
        The numbers that an alarm compares with its threshold: the responses, or multiples of them
        shortly before contact.
    alarm : ndarray of bool, shape (n,)
        The detector's own alarm.
    winner : ndarray, shape (n, 4), or None
        Left, top, width and height of the winning unit's receptive field in source
        pixels; NaN in frames without a winner; None for a detector without units.
    box : ndarray, shape (n, 4), or None
        Box of the strongest looming object that it sees, in the same form.
    contact_s : ndarray, shape (n,), or None
        Time to contact of that object; NaN where it is not determined.
    """

    response: Numbers
    evidence: Numbers
    alarm: Flags
    winner: Numbers | None = None
    box: Numbers | None = None
    contact_s: Numbers | None = None


class Window(NamedTuple):
    """Frames `start` to before `stop`."""

    start: int
    stop: int

    def score(self, response: Numbers) -> float:
        """Return the largest of a clip's responses within the window."""
        return float(response[self.start : self.stop].max())


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
        """The first frame that counts, with a response of every detector; the length if none has.

        The same frames count for all detectors, however long each takes to warm up.
        """
        valid = np.all([np.isfinite(each.response) for each in self.outputs.values()], axis=0)
        return max(int(valid.argmax()), self.label.since) if valid.any() else len(self)

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

        The duration runs from the frame before the first one to the last one.
        """
        if stop <= start or len(self) < 2:
            return 0.0
        if start > 0:
            return float(self.time_s[stop - 1] - self.time_s[start - 1])
        period = float(self.time_s[-1] - self.time_s[0]) / (len(self) - 1)
        return float(self.time_s[stop - 1] - self.time_s[0]) + period

    def lead(self, frame: int) -> float:
        """Return the time from a frame to the next contact, in seconds; NaN without an approach."""
        if self.label.contact is None:
            return float("nan")
        now = float(self.time_s[frame])
        coming = [each for each in self.label.contact_times if each >= now - EPSILON_S]
        return (coming[0] if coming else float(self.time_s[self.label.contact])) - now

    def windows(self, start: int, stop: int) -> list[Window]:
        """Return the windows that tile the frames from `start` to before `stop`, the latest first.

        The earliest may be shorter than a second, but has half a second.
        """
        made = []
        while (window := self._window_to(stop, start)) is not None:
            made.append(window)
            stop = window.start
        return made

    def window_before_contact(self, frames: int = 0) -> Window | None:
        """Return the window that ends some frames before contact; 0 includes that of contact.

        None without an approach, or if less than half a second is clear of warm-up.
        """
        if self.label.contact is None:
            return None
        return self._window_to(self.label.contact + 1 - frames, self.first)

    def windows_without_approach(self) -> list[Window]:
        """Return the windows in which no object approaches.

        These windows share no frame with the last second before contact.
        """
        start, stop = self.quiet
        last = self.window_before_contact()
        return self.windows(start, min(stop, last.start) if last else stop)

    def ordered_pairs(self, detector: str, frames: int) -> tuple[float, int]:
        """Return the share of correctly ordered pairs within the clip.

        The approach's window ends `frames` before contact.

        Returns
        -------
        share : float
            Of the clip's earlier windows, those with a largest response below that of the
            approach's window; ties count half. NaN without a pair.
        pairs : int
            Number of pairs.
        """
        approach = self.window_before_contact(frames)
        earlier = self.windows(self.first, approach.start) if approach else []
        if approach is None or not earlier:
            return float("nan"), 0
        response = self.outputs[detector].response
        own = approach.score(response)
        scores = np.array([each.score(response) for each in earlier])
        return float(np.mean((scores < own) + 0.5 * (scores == own))), len(earlier)

    def _window_to(self, stop: int, least: int) -> Window | None:
        """Return the window of one second that ends before the frame `stop`.

        The window holds no frame before `least`; None if it would be shorter than half a second.
        """
        if not least < stop <= len(self):
            return None
        since = self.time_s[stop - 1] - WINDOW_S + EPSILON_S
        start = max(least, int(np.searchsorted(self.time_s, since, side="right")))
        if self.seconds(start, stop) < LEAST_S - EPSILON_S:
            return None
        return Window(start, stop)


def videos_of(clips: Sequence[Clip]) -> NDArray[np.int64]:
    """Return the number of each clip's video: clips of one video are no independent examples."""
    shared = [clip.label.video for clip in clips]
    alone = max((each for each in shared if each is not None), default=-1) + 1
    numbers = [alone + at if each is None else each for at, each in enumerate(shared)]
    return np.array(numbers, np.int64)


def scored(clips: Sequence[Clip], detector: str) -> tuple[Numbers, Flags, Numbers]:
    """Return the one-second windows of all clips with a detector's scores.

    Returns
    -------
    score : ndarray, shape (n,)
        Largest response in each window.
    positive : ndarray of bool, shape (n,)
        Whether it is the last second before contact.
    owner : ndarray, shape (n,)
        Position of its clip.
    """
    rows: list[tuple[float, bool, int]] = []
    for index, clip in enumerate(clips):
        response, last = clip.outputs[detector].response, clip.window_before_contact()
        if last is not None:
            rows.append((last.score(response), True, index))
        rows += [
            (window.score(response), False, index) for window in clip.windows_without_approach()
        ]
    score, positive, owner = (np.array([row[at] for row in rows]) for at in range(3))
    return score.astype(np.float64), positive.astype(bool), owner.astype(np.int64)


class Curve(NamedTuple):
    """Both curves over all thresholds, from above the largest score to the smallest.

    Attributes
    ----------
    false_rate, true_rate : ndarray, shape (m + 1,)
        Share of the negative and of the positive windows at or above a threshold.
    precision : ndarray, shape (m + 1,)
        Share of positives among the windows at or above it; 1 without such a window.
    """

    false_rate: Numbers
    true_rate: Numbers
    precision: Numbers

    @property
    def auc(self) -> float:
        """Area under the ROC curve, 0 to 1: ties count half."""
        heights = (self.true_rate[1:] + self.true_rate[:-1]) / 2
        return float(np.sum(np.diff(self.false_rate) * heights))

    @property
    def average_precision(self) -> float:
        """Precision averaged over the steps of recall, 0 to 1; no interpolation."""
        return float(np.sum(np.diff(self.true_rate) * self.precision[1:]))


def curve(score: Numbers, positive: Flags, weight: Numbers) -> Curve | None:
    """Return the curves of some windows.

    Parameters
    ----------
    score : ndarray, shape (n,)
        Of each window.
    positive : ndarray of bool, shape (n,)
        Whether an object approaches in it.
    weight : ndarray, shape (n,)
        How often it counts.

    Returns
    -------
    Curve or None
        None without a positive or without a negative window.
    """
    order = np.argsort(-score, kind="stable")
    score, positive, weight = score[order], positive[order], weight[order]
    # Equal scores share a threshold.
    last = np.flatnonzero(np.append(np.diff(score), -1.0)[: len(score)])
    hits = np.append(0, np.cumsum(weight * positive)[last])
    false = np.append(0, np.cumsum(weight * ~positive)[last])
    if not hits[-1] or not false[-1]:
        return None
    marked = hits + false
    precision = np.divide(hits, marked, out=np.ones(len(hits)), where=marked > 0)
    return Curve(false / false[-1], hits / hits[-1], precision)
