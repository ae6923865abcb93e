"""One-second windows of clips, and the ROC and precision-recall curves over them."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from oppload_cli.evaluation.metrics.clips import Clip, Flags, Numbers


WINDOW_S = 1.0
LEAST_S = 0.5  # the remainder of a clip counts as a window from this length
_EPSILON_S = 1e-6  # times are fractions of a second that were rounded
AHEAD = (0, 4, 8, 12)  # frames before contact


class Window(NamedTuple):
    """Frames `start` to before `stop`."""

    start: int
    stop: int

    def score(self, response: Numbers) -> float:
        """Return the largest of a clip's responses within the window."""
        return float(response[self.start : self.stop].max())


def _window_to(clip: Clip, stop: int, least: int) -> Window | None:
    """Return the window of one second that ends before the frame `stop`.

    It holds no frame before `least`; None if it would be shorter than half a second.
    """
    if not least < stop <= len(clip):
        return None
    since = clip.time_s[stop - 1] - WINDOW_S + _EPSILON_S
    start = max(least, int(np.searchsorted(clip.time_s, since, side="right")))
    if clip.seconds(start, stop) < LEAST_S - _EPSILON_S:
        return None
    return Window(start, stop)


def tiled(clip: Clip, start: int, stop: int) -> list[Window]:
    """Return the windows that tile the frames from `start` to before `stop`, the latest first.

    The earliest may be shorter than a second, but has half a second.
    """
    made = []
    while (window := _window_to(clip, stop, start)) is not None:
        made.append(window)
        stop = window.start
    return made


def before_contact(clip: Clip, frames: int = 0) -> Window | None:
    """Return the window that ends some frames before contact; 0 includes that of contact.

    None without an approach, or if less than half a second is clear of warm-up.
    """
    if clip.label.contact is None:
        return None
    return _window_to(clip, clip.label.contact + 1 - frames, clip.first)


def without_approach(clip: Clip) -> list[Window]:
    """Return the windows of a clip in which no object approaches.

    They share no frame with the last second before contact.
    """
    start, stop = clip.quiet
    last = before_contact(clip)
    return tiled(clip, start, min(stop, last.start) if last else stop)


def ordered_pairs(clip: Clip, detector: str, frames: int) -> tuple[float, int]:
    """Return the share of correctly ordered pairs within a clip.

    The approach's window ends `frames` before contact.

    Returns
    -------
    share : float
        Of the clip's earlier windows, those with a largest response below that of the
        approach's window; ties count half. NaN without a pair.
    pairs : int
        Their number.
    """
    approach = before_contact(clip, frames)
    earlier = tiled(clip, clip.first, approach.start) if approach else []
    if approach is None or not earlier:
        return float("nan"), 0
    response = clip.outputs[detector].response
    own = approach.score(response)
    scores = np.array([each.score(response) for each in earlier])
    return float(np.mean((scores < own) + 0.5 * (scores == own))), len(earlier)


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
        response, last = clip.outputs[detector].response, before_contact(clip)
        if last is not None:
            rows.append((last.score(response), True, index))
        rows += [(window.score(response), False, index) for window in without_approach(clip)]
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
