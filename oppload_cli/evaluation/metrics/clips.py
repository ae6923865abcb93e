"""Labelled clips with the outputs of the detectors, and their windows of one second.

The ROC curve and the precision-recall curve judge each window.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from oppload_cli.models.detector import Box

    Numbers = NDArray[np.float64]
    Flags = NDArray[np.bool_]
    Positions = NDArray[np.int64]  # of clips, or numbers of videos


WINDOW_S = 1.0
LEAST_S = 0.5  # a remaining part of a clip that is at least this long is also a window
EPSILON_S = 1e-6  # tolerance for times, which are rounded
AHEAD = (0, 4, 8, 12)  # frames before contact


@dataclass(frozen=True)
class Label:
    """The facts about a clip from a manifest or a ground truth."""

    name: str  # in the manifest
    onset: int | None = None  # first frame of the approach; None without an approach
    contact: int | None = None  # last frame of the approach
    motion: str = ""  # kind of motion of a clip without an approach
    # By frame, the object in source pixels. Of several looming objects of a stimulus, the object is
    # the one that arrives first.
    boxes: dict[int, Box] = field(default_factory=dict)
    # By frame, the true time to contact in seconds of the looming object that arrives first, if the
    # time is known.
    contacts: dict[int, float] = field(default_factory=dict)
    # Values by which clips of stimuli are grouped, such as the speed.
    conditions: dict[str, str] = field(default_factory=dict)
    # True times of contact of all approaching objects, in seconds and rising; an object may stop
    # growing before its contact. If empty, contact is at the time of the frame `contact`.
    contact_times: tuple[float, ...] = ()
    # First frame that counts. If a video shows several approaches, each of them is a clip. The
    # first clip counts from frame 0, so that it has the footage without an approach. A later clip
    # counts from its onset.
    since: int = 0
    video: int | None = None  # a number that all clips of one video share; None for a single clip

    @property
    def looming(self) -> bool:
        """Whether an object approaches in the clip."""
        return self.contact is not None

    @property
    def kind(self) -> str:
        """The kind of motion of the clip's footage without an approach."""
        return "before an approach" if self.looming else self.motion or "not stated"


@dataclass(frozen=True)
class Output:
    """The output of one detector for the n frames of one clip."""

    response: Numbers  # (n,), at least 0; NaN during warm-up
    # (n,): the number that the alarm compares with its threshold: the response, or shortly before
    # contact a multiple of the response.
    evidence: Numbers
    # (n,): whether the detector's own alarm is on; None if it has no alarm, as `opplod_paper`.
    alarm: Flags | None
    # (n, 4): left, top, width and height of the winning unit's receptive field in source pixels;
    # NaN in frames without a winning unit; None for a detector without units.
    winner: Numbers | None = None
    # (n, 4): box of the strongest looming object that the detector finds, in the same form.
    box: Numbers | None = None
    contact_s: Numbers | None = None  # (n,): time to contact of that object; NaN if not given


class Window(NamedTuple):
    """The frames from `start` to `stop` - 1."""

    start: int
    stop: int

    def score(self, response: Numbers) -> float:
        """Return the largest response in the window."""
        return float(response[self.start : self.stop].max())


@dataclass(frozen=True)
class Clip:
    """A clip with its label and the outputs of the detectors."""

    label: Label
    time_s: Numbers  # (n,): presentation times of the frames
    width: int  # of the source in pixels
    height: int
    outputs: dict[str, Output]  # by detector

    def __len__(self) -> int:
        return len(self.time_s)

    @cached_property
    def first(self) -> int:
        """The first frame in which every detector has a response, but not before `label.since`.

        So the same frames count for all detectors. The value is the clip's length if there is no
        such frame.
        """
        valid = np.all([np.isfinite(output.response) for output in self.outputs.values()], axis=0)
        return max(int(valid.argmax()), self.label.since) if valid.any() else len(self)

    @property
    def quiet(self) -> tuple[int, int]:
        """The first frame of the footage without an approach, and the frame after its last one."""
        stop = len(self) if self.label.onset is None else self.label.onset
        return self.first, max(self.first, stop)

    @property
    def approach(self) -> tuple[int, int]:
        """The first frame of the approach that counts, and the frame after contact.

        Both are the clip's length without an approach.
        """
        if self.label.onset is None or self.label.contact is None:
            return len(self), len(self)
        return max(self.first, self.label.onset), self.label.contact + 1

    def seconds(self, start: int, stop: int) -> float:
        """Return the duration of the frames from `start` to `stop` - 1 in seconds.

        A frame lasts from the time of the frame before it to its own time.
        """
        if stop <= start or len(self) < 2:
            return 0.0
        if start > 0:
            return float(self.time_s[stop - 1] - self.time_s[start - 1])
        period = float(self.time_s[-1] - self.time_s[0]) / (len(self) - 1)
        return float(self.time_s[stop - 1] - self.time_s[0]) + period

    def lead(self, frame: int) -> float:
        """Return the time from a frame of the approach to the next contact, in seconds."""
        now = float(self.time_s[frame])
        contacts_s = [
            contact_s for contact_s in self.label.contact_times if contact_s >= now - EPSILON_S
        ]
        return (contacts_s[0] if contacts_s else float(self.time_s[self.approach[1] - 1])) - now

    def windows(self, start: int, stop: int) -> list[Window]:
        """Return the windows that tile the frames from `start` to `stop` - 1, the latest first.

        The earliest window may be shorter than a second, but not shorter than half a second.
        """
        windows = []
        while (window := self._window_to(stop, start)) is not None:
            windows.append(window)
            stop = window.start
        return windows

    def window_before_contact(self, frames: int = 0) -> Window | None:
        """Return the window whose last frame is `frames` before the frame of contact.

        None without an approach, or if the window would have less than half a second after warm-up.
        """
        if self.label.contact is None:
            return None
        return self._window_to(self.label.contact + 1 - frames, self.first)

    def windows_without_approach(self) -> list[Window]:
        """Return the windows before onset that share no frame with the last second of approach."""
        start, stop = self.quiet
        last = self.window_before_contact()
        return self.windows(start, min(stop, last.start) if last else stop)

    def ordered_pairs(self, detector: str, frames: int) -> tuple[float, int]:
        """Return the share of correctly ordered pairs of windows in the clip, and their number.

        A pair is the window that ends `frames` before contact and an earlier window. The order is
        correct if the earlier window has the smaller score; equal scores count half. The share is
        NaN without a pair.
        """
        approach = self.window_before_contact(frames)
        earlier = self.windows(self.first, approach.start) if approach else []
        if approach is None or not earlier:
            return float("nan"), 0
        response = self.outputs[detector].response
        last = approach.score(response)
        scores = np.array([window.score(response) for window in earlier])
        return float(np.mean((scores < last) + 0.5 * (scores == last))), len(earlier)

    def _window_to(self, stop: int, least: int) -> Window | None:
        """Return the window of one second, or less, from at least frame `least` to `stop` - 1.

        None if it would be shorter than half a second.
        """
        if not least < stop <= len(self):
            return None
        since = self.time_s[stop - 1] - WINDOW_S + EPSILON_S
        start = max(least, int(np.searchsorted(self.time_s, since, side="right")))
        if self.seconds(start, stop) < LEAST_S - EPSILON_S:
            return None
        return Window(start, stop)


def videos_of(clips: Sequence[Clip]) -> Positions:
    """Return the number of each clip's video: clips of one video are no independent examples."""
    shared = [clip.label.video for clip in clips]
    first_free = max((number for number in shared if number is not None), default=-1) + 1
    numbers = [first_free + i if number is None else number for i, number in enumerate(shared)]
    return np.array(numbers, np.int64)


def scored(clips: Sequence[Clip], detector: str) -> tuple[Numbers, Flags, Positions]:
    """Return the scores of a detector in the windows of all clips.

    Returns
    -------
    score : ndarray, shape (n,)
        Largest response in each window.
    positive : ndarray of bool, shape (n,)
        Whether the window is the last second before contact.
    owner : ndarray, shape (n,)
        Position in `clips` of the window's clip.
    """
    rows: list[tuple[float, bool, int]] = []
    for index, clip in enumerate(clips):
        response, last = clip.outputs[detector].response, clip.window_before_contact()
        if last is not None:
            rows.append((last.score(response), True, index))
        rows += [
            (window.score(response), False, index) for window in clip.windows_without_approach()
        ]
    score, positive, owner = np.array(rows, float).reshape(-1, 3).T
    return score, positive.astype(bool), owner.astype(np.int64)


class Curves(NamedTuple):
    """The ROC curve and the precision-recall curve, over m + 1 thresholds.

    The first threshold is above all scores; the other thresholds are the scores, the largest first.
    """

    # Share of the negative and of the positive windows with a score of at least the threshold.
    false_rate: Numbers
    true_rate: Numbers
    precision: Numbers  # share of positive windows among all such windows; 1 if there are none

    @property
    def auc(self) -> float:
        """Area under the ROC curve, 0 to 1; equal scores count half."""
        heights = (self.true_rate[1:] + self.true_rate[:-1]) / 2
        return float(np.sum(np.diff(self.false_rate) * heights))

    @property
    def average_precision(self) -> float:
        """Precision averaged over the steps of recall, 0 to 1; no interpolation."""
        return float(np.sum(np.diff(self.true_rate) * self.precision[1:]))


def curves_of(score: Numbers, positive: Flags) -> Curves | None:
    """Return the curves of windows with scores; None without a positive or a negative window.

    `score` and `positive`, shape (n,), are as `scored` returns them.
    """
    order = np.argsort(-score, kind="stable")
    score, positive = score[order], positive[order]
    # Windows with equal scores share a threshold: the last window of each score.
    last = np.flatnonzero(np.append(np.diff(score), -1.0)[: len(score)])
    true_count = np.append(0, np.cumsum(positive)[last])
    false_count = np.append(0, np.cumsum(~positive)[last])
    if not true_count[-1] or not false_count[-1]:
        return None
    count = true_count + false_count
    precision = np.divide(true_count, count, out=np.ones(len(true_count)), where=count > 0)
    return Curves(false_count / false_count[-1], true_count / true_count[-1], precision)
