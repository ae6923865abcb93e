"""Detections, their lead and false alarms, for each way to decide on an alarm."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from oppload_cli.detection.evaluation.intervals import (
    Estimate,
    interval,
    weighted_mean,
    weighted_median,
)
from oppload_cli.detection.evaluation.thresholds import false_alarms, held_out_thresholds

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from oppload_cli.detection.evaluation.intervals import Weights
    from oppload_cli.detection.evaluation.series import Flags, Numbers, Seen
    from oppload_cli.detection.evaluation.thresholds import Approaches, FalseAlarms

SHIPPED = "alarm as shipped"
Named = tuple[str, str, Estimate, int]  # measure, condition, estimate, n


@dataclass(frozen=True)
class Outcomes:
    """What one rule of alarm gives in every clip.

    Attributes
    ----------
    detected, lead_s : ndarray, shape (clips,)
        1 or 0, and seconds before contact; NaN where there is no approach, or it is
        not detected.
    false_alarms : ndarray, shape (clips,)
        In the clip's footage without an approach.
    """

    detected: Numbers
    lead_s: Numbers
    false_alarms: Numbers


@dataclass(frozen=True)
class Decision:
    """A way to decide on an alarm, with what came of it.

    Attributes
    ----------
    condition : str
        Such as ``at 1 per minute``.
    thresholds : ndarray, shape (clips,)
        What each clip's responses had to be above; NaN for the alarm as shipped.
    outcomes : Outcomes
        Per clip.
    estimates : list of tuple
        Measure, condition, estimate and n.
    """

    condition: str
    thresholds: Numbers
    outcomes: Outcomes
    estimates: list[Named]


def condition_of(rate: float) -> str:
    """Return what a rate of false alarms is called.

    Parameters
    ----------
    rate : float
        Per minute.

    Returns
    -------
    str
    """
    return f"at {rate:g} per minute"


def at_rate(
    clips: Sequence[Seen],
    alarms: FalseAlarms,
    approaches: Approaches,
    rate: float,
    draws: Weights,
) -> Decision:
    """Decide by the lowest threshold that keeps to a rate over all footage.

    Parameters
    ----------
    clips : sequence of Seen
        All clips.
    alarms, approaches
        Its responses without and with an approach.
    rate : float
        False alarms per minute.
    draws : ndarray of int, shape (count, clips)
        Of the bootstrap; the threshold is chosen again in each draw.

    Returns
    -------
    Decision
    """
    threshold = alarms.threshold(np.ones(len(clips), np.int64), rate)
    drawn = [alarms.threshold(each, rate) for each in draws]
    # The same few thresholds come again and again.
    known: dict[float, Outcomes] = {}

    def outcomes(at: float) -> Outcomes:
        if at not in known:
            known[at] = Outcomes(
                approaches.detected(at), approaches.leads(at), alarms.false_alarms(at)
            )
        return known[at]

    whole = outcomes(threshold)
    condition = condition_of(rate)
    estimates = list(_estimates(clips, condition, whole, draws, [outcomes(each) for each in drawn]))
    spread = interval(np.array(drawn))
    footage = int((alarms.minutes > 0).sum())
    estimates.append(("threshold", condition, Estimate(threshold, *spread), footage))
    return Decision(condition, np.full(len(clips), threshold), whole, estimates)


def held_out(
    clips: Sequence[Seen], contender: str, alarms: FalseAlarms, rate: float, draws: Weights
) -> Decision:
    """Decide in each clip by the threshold that all the other clips give.

    Parameters
    ----------
    clips : sequence of Seen
        All clips.
    contender : str
        Its name.
    alarms : FalseAlarms
        Its responses without an approach.
    rate : float
        False alarms per minute that the others keep to.
    draws : ndarray of int, shape (count, clips)
        Of the bootstrap, over the clips' outcomes.

    Returns
    -------
    Decision
    """
    thresholds = held_out_thresholds(alarms, rate)
    above = [
        None if np.isnan(threshold) else seen.answers[contender].response > threshold
        for seen, threshold in zip(clips, thresholds, strict=True)
    ]
    outcomes = _outcomes(clips, above)
    condition = f"held out {condition_of(rate)}"
    estimates = list(_estimates(clips, condition, outcomes, draws, by_kind=False))
    return Decision(condition, thresholds, outcomes, estimates)


def shipped(clips: Sequence[Seen], contender: str, draws: Weights) -> Iterator[Decision]:
    """Take the contender's own alarm as it ran; no threshold is chosen afterwards.

    Parameters
    ----------
    clips : sequence of Seen
        All clips.
    contender : str
        Its name.
    draws : ndarray of int, shape (count, clips)
        Of the bootstrap.

    Yields
    ------
    Decision
        None for a contender without an alarm.
    """
    above = [seen.answers[contender].alarm for seen in clips]
    if all(each is None for each in above):
        return
    outcomes = _outcomes(clips, above)
    nothing = np.full(len(clips), np.nan)
    yield Decision(SHIPPED, nothing, outcomes, list(_estimates(clips, SHIPPED, outcomes, draws)))


def _outcomes(clips: Sequence[Seen], above: Sequence[Flags | None]) -> Outcomes:
    detected, leads, false = (np.full(len(clips), np.nan) for _ in range(3))
    for index, (seen, on) in enumerate(zip(clips, above, strict=True)):
        if on is None:
            continue
        false[index] = len(false_alarms(seen, on))
        start, stop = seen.approach
        if stop > start and seen.label.looming:
            found = np.flatnonzero(on[start:stop])
            detected[index] = float(len(found) > 0)
            if len(found):
                leads[index] = seen.lead(start + int(found[0]))
    return Outcomes(detected, leads, false)


def _estimates(
    clips: Sequence[Seen],
    condition: str,
    whole: Outcomes,
    draws: Weights,
    drawn: Sequence[Outcomes] | None = None,
    *,
    by_kind: bool = True,
) -> Iterator[Named]:
    """Yield the figures; each draw has its own outcomes, or shares those of the whole."""
    each_draw = list(drawn) if drawn is not None else [whole] * len(draws)
    once = np.ones(len(clips), np.int64)

    def found(statistic: Callable[[Outcomes, Weights], float]) -> Estimate:
        values = [statistic(*pair) for pair in zip(each_draw, draws, strict=True)]
        return Estimate(statistic(whole, once), *interval(np.array(values)))

    approaches, detections = int((~np.isnan(whole.detected)).sum()), int(np.nansum(whole.detected))
    yield (
        "detection_rate",
        condition,
        found(lambda outcomes, weights: weighted_mean(outcomes.detected, weights)),
        approaches,
    )
    yield (
        "lead_time_s",
        condition,
        found(lambda outcomes, weights: weighted_median(outcomes.lead_s, weights)),
        detections,
    )
    minutes = np.array([seen.seconds(*seen.quiet) / 60 for seen in clips])
    kinds = np.array([seen.label.kind for seen in clips])
    # Kinds of motion are few clips each: they are not split by clip again.
    for kind in ("", *(sorted(set(kinds[minutes > 0])) if by_kind else ())):
        members = (kinds == kind) | (kind == "")
        yield (
            "false_alarms_per_minute",
            f"{condition}, {kind}" if kind else condition,
            found(
                lambda outcomes, weights, members=members: _per_minute(  # type: ignore[misc]
                    outcomes.false_alarms[members], minutes[members], weights[members]
                )
            ),
            int((members & (minutes > 0) & ~np.isnan(whole.false_alarms)).sum()),
        )


def _per_minute(counts: Numbers, minutes: Numbers, weights: Weights) -> float:
    known = ~np.isnan(counts)
    total = float(minutes[known] @ weights[known])
    return float(counts[known] @ weights[known]) / total if total else float("nan")
