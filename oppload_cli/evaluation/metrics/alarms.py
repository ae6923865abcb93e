"""Detections, lead times and false alarms, by a fixed threshold or by the detector's own alarm.

``docs/evaluation.md`` has the definitions.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from oppload_cli.evaluation.metrics.clips import EPSILON_S, videos_of
from oppload_cli.evaluation.metrics.intervals import (
    Measurement,
    interval,
    rate_interval,
    share_interval,
    weighted_mean,
    weighted_median,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from numpy.typing import NDArray

    from oppload_cli.evaluation.metrics.clips import Clip, Flags, Numbers
    from oppload_cli.evaluation.metrics.intervals import Weights


SILENCE_S = 1.0  # crossings of the threshold with less time between them are one alarm
RATES = (0.5, 1.0, 2.0)  # false alarms per minute
AT_ONE = "at 1 per minute"  # the condition under which the page compares detectors
SHIPPED = "alarm as shipped"
HELD_OUT = "held out"


@dataclass(frozen=True)
class _Outcomes:
    """Detections and false alarms in every clip, under one rule of alarm.

    `detected` (1 or 0) and the lead time `lead_s` are NaN for a clip without an approach, and if an
    alarm lasts from the approach before through this approach. The lead time is also NaN if the
    approach is not detected. `false_alarms` counts alarms in footage without an approach.
    """

    detected: Numbers
    lead_s: Numbers
    false_alarms: Numbers


class Thresholds:
    """The alarms of a detector in clips, if its evidence is compared with a fixed threshold."""

    def __init__(self, clips: Sequence[Clip], detector: str) -> None:
        self._clips, self._detector = clips, detector
        self.minutes = _minutes(clips)  # of footage without an approach, in each clip
        self._evidence = [clip.outputs[detector].evidence for clip in clips]
        quiet = [
            evidence[slice(*clip.quiet)]
            for evidence, clip in zip(self._evidence, clips, strict=True)
        ]
        # The thresholds: every local maximum of the evidence in footage without an approach, the
        # largest first. Evidence above a level is an alarm.
        self.levels = np.unique(np.concatenate([_maxima(evidence) for evidence in quiet]))[::-1]
        # Number of false alarms in each clip (row) at each level (column).
        self.counts = np.array(
            [
                _counts(evidence, clip.time_s[slice(*clip.quiet)], self.levels)
                for evidence, clip in zip(quiet, clips, strict=True)
            ],
            np.float64,  # NumPy multiplies floats many times faster than integers
        ).reshape(len(clips), len(self.levels))

    def rates(self, weights: Weights) -> Numbers:
        """Return the false alarms per minute at each level; clip i counts `weights[i]` times.

        NaN if there is no footage without an approach.
        """
        minutes = float(weights @ self.minutes)
        if not minutes:
            return np.full(len(self.levels), np.nan)
        return np.asarray(weights @ self.counts / minutes, np.float64)

    def lowest(self, weights: Weights, rate: float) -> float:
        """Return the lowest level such that no level at or above it exceeds a rate.

        `rate` is in false alarms per minute; clip i counts `weights[i]` times. NaN if there is no
        footage without an approach.
        """
        # At very low thresholds all alarms merge into one that never ends, so the rate falls again.
        # Therefore the search stops at the first level with too many false alarms.
        rates = self.rates(weights)
        if np.isnan(rates).all():
            return float("nan")
        # If no level has too many, `argmax` is 0, and the level is the last one: the lowest.
        return float(self.levels[int((rates > rate + 1e-9).argmax()) - 1])

    def outcomes(self, threshold: float | Numbers) -> _Outcomes:
        """Return the outcomes at one threshold, or at a threshold for each clip.

        The outcomes of a clip whose threshold is NaN are NaN.
        """
        thresholds = np.broadcast_to(threshold, len(self._clips))
        above = [
            None if np.isnan(level) else evidence > level
            for level, evidence in zip(thresholds, self._evidence, strict=True)
        ]
        return _outcomes(self._clips, above)

    def at_rate(self, rate: float, draws: Weights) -> Decision:
        """Decide by the lowest threshold with at most `rate` false alarms per minute in all clips.

        In each draw of the bootstrap the threshold is chosen again.
        """
        clips, condition = self._clips, _condition_of(rate)
        threshold = self.lowest(np.ones(len(clips), np.int64), rate)
        drawn = [self.lowest(weights, rate) for weights in draws]
        # Many draws have the same threshold.
        outcomes_at = {level: self.outcomes(level) for level in {threshold, *drawn}}
        own, each_draw = outcomes_at[threshold], [outcomes_at[level] for level in drawn]
        measured = _measurements(clips, self._detector, condition, own, draws, drawn=each_draw)
        bounds = interval(np.array(drawn))
        footage = int((self.minutes > 0).sum())
        level = Measurement(self._detector, "threshold", condition, threshold, *bounds, footage)
        return Decision(condition, np.full(len(clips), threshold), own, [*measured, level])

    def held_out(self, rate: float, draws: Weights) -> Decision:
        """Decide in each clip by the threshold that `lowest` finds for the clips of other videos.

        The threshold is NaN if the other videos have no footage without an approach.
        """
        videos = videos_of(self._clips)
        others = (videos[:, None] != videos).astype(np.int64)
        chosen = np.array([self.lowest(weights, rate) for weights in others])
        outcomes, condition = self.outcomes(chosen), f"{HELD_OUT} {_condition_of(rate)}"
        # No rates by kind of motion: each kind has few clips.
        measured = _measurements(
            self._clips, self._detector, condition, outcomes, draws, by_kind=False
        )
        return Decision(condition, chosen, outcomes, list(measured))


def _minutes(clips: Sequence[Clip]) -> Numbers:
    """Return the duration of each clip's footage without an approach, in minutes."""
    return np.array([clip.seconds(*clip.quiet) / 60 for clip in clips])


def _maxima(evidence: Numbers) -> Numbers:
    """Return the values that are at least as large as both neighbours; an end has only one."""
    padded = np.concatenate([[-np.inf], evidence, [-np.inf]])
    return np.asarray(evidence[(evidence >= padded[:-2]) & (evidence >= padded[2:])], np.float64)


def _counts(evidence: Numbers, time_s: Numbers, levels: Numbers) -> NDArray[np.int64]:
    """Return the number of a clip's alarms at each level, as `_alarms_in` counts them.

    A frame begins an alarm at each level below its evidence, unless a frame within the second
    before it, or the frame right before it, has evidence above this level too.
    """
    begin = np.searchsorted(time_s, time_s - SILENCE_S + EPSILON_S, side="right")
    begin = np.minimum(begin, np.maximum(np.arange(len(time_s)) - 1, 0))
    before = [evidence[first:last].max(initial=-np.inf) for last, first in enumerate(begin)]

    def above(values: Numbers) -> NDArray[np.int64]:
        return len(values) - np.searchsorted(np.sort(values), levels, side="right")

    return above(evidence) - above(np.minimum(evidence, before))


def _alarms_in(above: Flags, time_s: Numbers) -> int:
    """Return how many alarms begin: frames above the threshold after a second without any.

    So evidence that flickers about the threshold is one alarm. Evidence above the threshold in the
    first frame begins an alarm there. Frames above the threshold without one below it in between
    are one alarm, also if more than a second lies between them.
    """
    frames = np.flatnonzero(above)
    separate = (np.diff(frames) > 1) & (np.diff(time_s[frames]) >= SILENCE_S - EPSILON_S)
    return min(len(frames), 1) + int(separate.sum())


@dataclass(frozen=True)
class Decision:
    """A rule of alarm with its outcomes."""

    condition: str  # the name of the rule, such as ``at 1 per minute``
    thresholds: Numbers  # in each clip; NaN for the alarm as shipped
    outcomes: _Outcomes
    measurements: list[Measurement]


def _condition_of(rate: float) -> str:
    return f"at {rate:g} per minute"


def shipped(clips: Sequence[Clip], detector: str, draws: Weights) -> Decision:
    """Decide by the detector's own alarm, as ``oppload run`` has it.

    If the alarms of the detector are off, all outcomes are NaN.
    """
    outcomes = _outcomes(clips, [clip.outputs[detector].alarm for clip in clips])
    measurements = list(_measurements(clips, detector, SHIPPED, outcomes, draws))
    return Decision(SHIPPED, np.full(len(clips), np.nan), outcomes, measurements)


def _outcomes(clips: Sequence[Clip], alarms: Sequence[Flags | None]) -> _Outcomes:
    """Return the outcomes of an alarm that is on or off in every frame; NaN in a clip with None."""
    detected, leads, false = (np.full(len(clips), np.nan) for _ in range(3))
    for index, (clip, on) in enumerate(zip(clips, alarms, strict=True)):
        if on is None:
            continue
        quiet = slice(*clip.quiet)
        false[index] = _alarms_in(on[quiet], clip.time_s[quiet])
        detected[index], leads[index] = _first_alarm(clip, on)
    return _Outcomes(detected, leads, false)


def _first_alarm(clip: Clip, on: Flags) -> tuple[float, float]:
    """Return whether an alarm begins in a clip's approach (1 or 0), and its lead time in seconds.

    Both are NaN without an approach. They are also NaN if an alarm of the approach before lasts
    through this approach: whether this approach would have begun an alarm is not known.
    """
    start, stop = clip.approach
    during = on[start:stop]
    still_on = bool(clip.label.since and len(during) and on[start - 1])
    if not len(during) or (still_on and during.all()):
        return np.nan, np.nan
    frames = np.flatnonzero(during)
    if still_on:
        frames = frames[frames > int(during.argmin())]
    return float(len(frames) > 0), clip.lead(start + int(frames[0])) if len(frames) else np.nan


def _measurements(
    clips: Sequence[Clip],
    detector: str,
    condition: str,
    outcomes: _Outcomes,
    draws: Weights,
    *,
    drawn: Sequence[_Outcomes] | None = None,
    by_kind: bool = True,
) -> Iterator[Measurement]:
    """Yield the measurements of a rule, with `drawn` if each draw of the bootstrap has outcomes."""
    each_draw = list(drawn) if drawn is not None else [outcomes] * len(draws)
    once = np.ones(len(clips), np.int64)

    def estimated(statistic: Callable[[_Outcomes, Weights], float]) -> tuple[float, float, float]:
        values = [statistic(*pair) for pair in zip(each_draw, draws, strict=True)]
        return statistic(outcomes, once), *interval(np.array(values))

    rate, low, high = estimated(lambda outcomes, weights: weighted_mean(outcomes.detected, weights))
    approaches = int((~np.isnan(outcomes.detected)).sum())
    bounds = share_interval(rate, approaches, low, high)
    yield Measurement(detector, "detection_rate", condition, rate, *bounds, approaches)
    lead = estimated(lambda outcomes, weights: weighted_median(outcomes.lead_s, weights))
    detections = int(np.nansum(outcomes.detected))
    yield Measurement(detector, "lead_time_s", condition, *lead, detections)
    minutes = _minutes(clips)
    kinds = np.array([clip.label.kind for clip in clips])
    for kind in ("", *(sorted(set(kinds[minutes > 0])) if by_kind else ())):
        of_kind = (kinds == kind) | (kind == "")

        def per_minute(outcomes: _Outcomes, weights: Weights, of_kind: Flags = of_kind) -> float:
            total = float(minutes[of_kind] @ weights[of_kind])
            count = float(outcomes.false_alarms[of_kind] @ weights[of_kind])
            return count / total if total else float("nan")

        counted = of_kind & ~np.isnan(outcomes.false_alarms)
        rate, low, high = estimated(per_minute)
        events, footage = np.nansum(outcomes.false_alarms[counted]), minutes[counted].sum()
        bounds = rate_interval(float(events), float(footage), low, high)
        where = f"{condition}, {kind}" if kind else condition
        clips_of_kind = int((counted & (minutes > 0)).sum())
        yield Measurement(detector, "false_alarms_per_minute", where, rate, *bounds, clips_of_kind)
