"""Alarms by one fixed threshold, set by how often it may be wrong (``docs/evaluation.md``)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from oppload_cli.detection.evaluation.intervals import Weights
    from oppload_cli.detection.evaluation.series import Flags, Numbers, Seen

SILENCE_S = 1.0
RATES = (0.5, 1.0, 2.0)  # false alarms per minute
HIGHEST_RATE = 10.0  # up to which the curve is drawn


def events(above: Flags, time_s: Numbers) -> list[int]:
    """Return when alarms begin: upward crossings after a second of silence.

    What goes above and below the threshold in quick turns is one alarm, not many.

    Parameters
    ----------
    above : ndarray of bool, shape (n,)
        Whether the response is above the threshold, or an alarm on; where the first
        frame is, an alarm begins there.
    time_s : ndarray, shape (n,)
        Presentation times.

    Returns
    -------
    list of int
        Positions in `above`.
    """
    frames = np.flatnonzero(above)
    silence = np.diff(time_s[frames], prepend=-np.inf)
    return [int(frame) for frame in frames[silence >= SILENCE_S - 1e-6]]


class FalseAlarms:
    """How often one contender is above each threshold where nothing approaches.

    Parameters
    ----------
    clips : sequence of Seen
        All clips.
    contender : str
        Whose responses.

    Attributes
    ----------
    thresholds : ndarray, shape (m,)
        Every local maximum of the footage without an approach, the largest first: a
        response must be above one to alarm.
    counts : ndarray of int, shape (clips, m)
        False alarms of each clip at each threshold.
    minutes : ndarray, shape (clips,)
        Footage of each clip without an approach.
    """

    def __init__(self, clips: Sequence[Seen], contender: str) -> None:
        quiet = [slice(*seen.quiet) for seen in clips]
        responses = [
            seen.answers[contender].response[part] for seen, part in zip(clips, quiet, strict=True)
        ]
        self.minutes = np.array([seen.seconds(*seen.quiet) / 60 for seen in clips])
        self.thresholds = np.unique(np.concatenate([_maxima(each) for each in responses]))[::-1]
        # A clip with more is over every rate, however often its clip is drawn.
        most = int(HIGHEST_RATE * len(clips) * self.minutes.max(initial=0)) + 1
        self.counts = np.array(
            [
                _counts(each, seen.time_s[part], self.thresholds, most)
                for each, seen, part in zip(responses, clips, quiet, strict=True)
            ]
        ).reshape(len(clips), len(self.thresholds))

    def rates(self, weights: Weights) -> Numbers:
        """Return the false alarms per minute at each threshold.

        Parameters
        ----------
        weights : ndarray of int, shape (clips,)
            How often each clip counts.

        Returns
        -------
        ndarray, shape (m,)
            NaN without footage.
        """
        minutes = float(weights @ self.minutes)
        if not minutes:
            return np.full(len(self.thresholds), np.nan)
        return np.asarray(weights @ self.counts / minutes, np.float64)

    def threshold(self, weights: Weights, rate: float) -> float:
        """Return the lowest threshold that keeps to a rate of false alarms.

        Parameters
        ----------
        weights : ndarray of int, shape (clips,)
            How often each clip counts.
        rate : float
            False alarms per minute.

        Returns
        -------
        float
            The lowest at which, and above which, there are no more; NaN without
            footage.
        """
        # Lower thresholds merge alarms into one that never ends; so what is above counts.
        over = self.rates(weights) > rate + 1e-9
        if not len(over) or not weights @ self.minutes:
            return float("nan")
        return float(self.thresholds[int(over.argmax()) - 1 if over.any() else -1])

    def false_alarms(self, threshold: float) -> Numbers:
        """Return the false alarms of each clip at one of the thresholds.

        Parameters
        ----------
        threshold : float
            One of `thresholds`, or NaN.

        Returns
        -------
        ndarray, shape (clips,)
            NaN without a threshold.
        """
        if np.isnan(threshold):
            return np.full(len(self.minutes), np.nan)
        at = int(np.searchsorted(-self.thresholds, -threshold))
        return np.asarray(self.counts[:, at], np.float64)


class Approaches:
    """The approaches that one contender detects at any threshold.

    Parameters
    ----------
    clips : sequence of Seen
        All clips.
    contender : str
        Whose responses.

    Attributes
    ----------
    peaks : ndarray, shape (clips,)
        Largest response from onset to contact; NaN without an approach.
    """

    def __init__(self, clips: Sequence[Seen], contender: str) -> None:
        self._clips = clips
        self._largest = [
            np.maximum.accumulate(seen.answers[contender].response[slice(*seen.approach)])
            for seen in clips
        ]
        self.peaks = np.array([each[-1] if len(each) else np.nan for each in self._largest])

    def detected(self, threshold: float) -> Numbers:
        """Return which approaches are detected.

        Parameters
        ----------
        threshold : float
            What a response must be above, from onset to contact.

        Returns
        -------
        ndarray, shape (clips,)
            1, 0, or NaN without an approach or without a threshold.
        """
        if np.isnan(threshold):
            return np.full(len(self.peaks), np.nan)
        return np.where(np.isnan(self.peaks), np.nan, self.peaks > threshold)

    def leads(self, threshold: float) -> Numbers:
        """Return how long before contact each approach is detected first.

        Parameters
        ----------
        threshold : float
            What a response must be above.

        Returns
        -------
        ndarray, shape (clips,)
            In seconds; NaN where it is not detected.
        """
        made = np.full(len(self.peaks), np.nan)
        for index in np.flatnonzero(self.detected(threshold) == 1):
            seen = self._clips[int(index)]
            above = int(np.searchsorted(self._largest[int(index)], threshold, side="right"))
            made[index] = seen.lead(seen.approach[0] + above)
        return made


def held_out_thresholds(alarms: FalseAlarms, rate: float) -> Numbers:
    """Return a threshold for each clip that is chosen on all the others.

    Parameters
    ----------
    alarms : FalseAlarms
        Of all clips.
    rate : float
        False alarms per minute.

    Returns
    -------
    ndarray, shape (clips,)
        NaN where the others hold no footage without an approach.
    """
    others = 1 - np.eye(len(alarms.minutes), dtype=np.int64)
    return np.array([alarms.threshold(each, rate) for each in others])


def false_alarms(seen: Seen, above: Flags) -> list[int]:
    """Return the frames at which false alarms begin in a clip.

    Parameters
    ----------
    seen : Seen
        The clip.
    above : ndarray of bool, shape (n,)
        Whether there is an alarm, for every frame of the clip.

    Returns
    -------
    list of int
        Frames of its footage without an approach.
    """
    start, stop = seen.quiet
    return [start + at for at in events(above[start:stop], seen.time_s[start:stop])]


def _maxima(response: Numbers) -> Numbers:
    """Return the local maxima, those at the ends included."""
    padded = np.concatenate([[-np.inf], response, [-np.inf]])
    return np.asarray(response[(response >= padded[:-2]) & (response >= padded[2:])], np.float64)


def _counts(
    response: Numbers, time_s: Numbers, thresholds: Numbers, most: int
) -> NDArray[np.int64]:
    """Return the number of alarms at each threshold, which fall.

    They change only at the clip's own responses.
    """
    own = np.unique(response)[::-1]
    found: list[int] = []
    for value in own:
        found.append(len(events(response > value, time_s)))
        if found[-1] > most:
            break
    if not found:
        return np.zeros(len(thresholds), np.int64)
    # The first own response at or below each threshold; below all of them one alarm lasts.
    at = np.searchsorted(-own[: len(found)], -thresholds)
    everywhere = 1 if len(found) == len(own) else found[-1]
    return np.append(found, everywhere)[at]
