"""Every figure of an evaluation, with its interval (``docs/evaluation.md``)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from oppload_cli.detection.evaluation.alarms import (
    Decision,
    at_rate,
    held_out,
    shipped,
)
from oppload_cli.detection.evaluation.curves import Curve, curve
from oppload_cli.detection.evaluation.intervals import (
    estimate,
    weighted_mean,
    weighted_median,
)
from oppload_cli.detection.evaluation.places import FRAME_CENTRE, NEAR_CONTACT, places
from oppload_cli.detection.evaluation.thresholds import RATES, Approaches, FalseAlarms
from oppload_cli.detection.evaluation.windows import (
    AHEAD,
    before_contact,
    ordered_pairs,
    without_approach,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from oppload_cli.detection.evaluation.intervals import Weights
    from oppload_cli.detection.evaluation.places import Place
    from oppload_cli.detection.evaluation.series import Flags, Numbers, Seen
    from oppload_cli.detection.evaluation.windows import Window

LAST_SECOND = "last second before contact"
WITHIN = f"within {NEAR_CONTACT} frames of contact"
ALL_BOXED = "all boxed frames"


class Figure(NamedTuple):
    """One row of ``evaluation.csv``.

    Attributes
    ----------
    contender, measure, condition : str
        What was measured of whom, and under which condition.
    value, low, high : float
        With the bounds of its interval; NaN where it is not determined.
    n : int
        How many clips, windows, pairs or frames it stands on.
    """

    contender: str
    measure: str
    condition: str
    value: float
    low: float
    high: float
    n: int


@dataclass(frozen=True)
class Measured:
    """What was measured of one contender.

    Attributes
    ----------
    figures : list of Figure
        In the order of the page.
    decisions : list of Decision
        Its alarms, by how they are decided.
    curve : Curve or None
        Over one-second windows.
    false_alarms, approaches
        For the curve of detection against false alarms.
    """

    figures: list[Figure]
    decisions: list[Decision]
    curve: Curve | None
    false_alarms: FalseAlarms
    approaches: Approaches


def measured(clips: Sequence[Seen], contender: str, draws: Weights) -> Measured:
    """Measure one contender.

    Parameters
    ----------
    clips : sequence of Seen
        All clips, at least one.
    contender : str
        Its name.
    draws : ndarray of int, shape (count, clips)
        Of the bootstrap.

    Returns
    -------
    Measured
    """
    alarms, approaches = FalseAlarms(clips, contender), Approaches(clips, contender)
    decisions = [
        *(at_rate(clips, alarms, approaches, rate, draws) for rate in RATES),
        *(held_out(clips, contender, alarms, rate, draws) for rate in RATES),
        *shipped(clips, contender, draws),
    ]
    score, positive, owner = scored(clips, contender)
    whole = curve(score, positive, np.ones(len(score)))
    figures = [figure for each in decisions for figure in _of_decision(contender, each)]
    figures += _of_windows(contender, score, positive, owner, draws)
    figures += _of_order(clips, contender, draws)
    figures.append(_distinct(clips, contender, approaches, draws))
    figures += place_figures(clips, contender, draws)
    return Measured(figures, decisions, whole, alarms, approaches)


def scored(clips: Sequence[Seen], contender: str) -> tuple[Numbers, Flags, Numbers]:
    """Return the one-second windows of all clips with their scores.

    Parameters
    ----------
    clips : sequence of Seen
        All clips.
    contender : str
        Whose responses.

    Returns
    -------
    score : ndarray, shape (n,)
        Largest response in each window.
    positive : ndarray of bool, shape (n,)
        Whether it is the last second before contact.
    owner : ndarray, shape (n,)
        Position of its clip.
    """
    rows = [
        (window.score(seen.answers[contender].response), positive, index)
        for index, seen in enumerate(clips)
        for window, positive in _windows(seen)
    ]
    score, positive, owner = (np.array([row[at] for row in rows]) for at in range(3))
    return score.astype(np.float64), positive.astype(bool), owner.astype(np.int64)


def _windows(seen: Seen) -> Iterator[tuple[Window, bool]]:
    last = before_contact(seen)
    if last is not None:
        yield last, True
    for window in without_approach(seen):
        yield window, False


def _of_decision(contender: str, decision: Decision) -> Iterator[Figure]:
    for measure, condition, each, n in decision.estimates:
        yield Figure(contender, measure, condition, *each, n)


def _of_windows(
    contender: str, score: Numbers, positive: Flags, owner: Numbers, draws: Weights
) -> list[Figure]:
    def area(weights: Weights, of: Callable[[Curve], float]) -> float:
        drawn = curve(score, positive, weights[owner])
        return float("nan") if drawn is None else of(drawn)

    measures: dict[str, Callable[[Curve], float]] = {
        "roc_auc": lambda drawn: drawn.auc,
        "average_precision": lambda drawn: drawn.average_precision,
    }
    return [
        Figure(
            contender,
            name,
            LAST_SECOND,
            *estimate(lambda weights, of=of: area(weights, of), draws),  # type: ignore[misc]
            len(score),
        )
        for name, of in measures.items()
    ]


def _of_order(clips: Sequence[Seen], contender: str, draws: Weights) -> Iterator[Figure]:
    for frames in AHEAD:
        pairs = [ordered_pairs(seen, contender, frames) for seen in clips]
        shares = np.array([share for share, _ in pairs])
        yield Figure(
            contender,
            "ordered_pairs",
            f"{frames} frames before contact",
            *estimate(lambda weights, shares=shares: weighted_mean(shares, weights), draws),  # type: ignore[misc]
            sum(count for _, count in pairs),
        )


def distinct_ratios(clips: Sequence[Seen], contender: str, approaches: Approaches) -> Numbers:
    """Return how far each approach stands out of what came before it.

    Parameters
    ----------
    clips : sequence of Seen
        All clips.
    contender : str
        Whose responses.
    approaches : Approaches
        Of the contender.

    Returns
    -------
    ndarray, shape (clips,)
        Largest response from onset to contact over the largest one before onset; over
        the median of the clips without an approach where under half a second comes
        before. 1 where both are 0, infinite where only the latter is; NaN without an
        approach.
    """
    before = np.array([_largest_before(seen, contender) for seen in clips])
    looming = np.array([seen.label.looming for seen in clips])
    calm = before[~looming & ~np.isnan(before)]
    usual = float(np.median(calm)) if len(calm) else float("nan")
    ratios = np.full(len(clips), np.nan)
    for index in np.flatnonzero(~np.isnan(approaches.peaks)):
        peak = float(approaches.peaks[index])
        base = usual if np.isnan(before[index]) else float(before[index])
        ratios[index] = peak / base if base else float("inf") if peak else 1.0
    return ratios


def _largest_before(seen: Seen, contender: str) -> float:
    start, stop = seen.quiet
    if seen.seconds(start, stop) < 0.5:
        return float("nan")
    return float(seen.answers[contender].response[start:stop].max())


def _distinct(
    clips: Sequence[Seen], contender: str, approaches: Approaches, draws: Weights
) -> Figure:
    ratios = distinct_ratios(clips, contender, approaches)
    found = estimate(lambda weights: weighted_median(ratios, weights), draws)
    known = int((~np.isnan(ratios)).sum())
    return Figure(contender, "distinct_ratio", "median over clips", *found, known)


def place_figures(clips: Sequence[Seen], contender: str, draws: Weights) -> list[Figure]:
    """Return how near a contender's winning unit is to the labelled boxes.

    Parameters
    ----------
    clips : sequence of Seen
        All clips.
    contender : str
        A contender, or ``frame_centre``.
    draws : ndarray of int, shape (count, clips)
        Of the bootstrap.

    Returns
    -------
    list of Figure
        None for a contender that knows no places, or without boxes.
    """
    knows = contender == FRAME_CENTRE or any(
        seen.answers[contender].place is not None for seen in clips
    )
    found = places(clips, contender) if knows else []
    parts = {WITHIN: [each for each in found if each.near], ALL_BOXED: found}
    return [
        figure
        for condition, part in parts.items()
        if part
        for figure in _of_places(contender, condition, part, draws)
    ]


def _of_places(
    contender: str, condition: str, part: Sequence[Place], draws: Weights
) -> Iterator[Figure]:
    owner = np.array([each.clip for each in part])
    for measure, values, middle in (
        ("place_inside", [float(each.inside) for each in part], weighted_mean),
        ("place_distance_px", [each.distance_px for each in part], weighted_median),
        ("place_distance_diagonals", [each.distance_diagonals for each in part], weighted_median),
    ):
        numbers = np.array(values)

        def statistic(
            weights: Weights,
            numbers: Numbers = numbers,
            middle: Callable[[Numbers, Weights], float] = middle,
        ) -> float:
            return middle(numbers, weights[owner])

        known = int((~np.isnan(numbers)).sum())
        yield Figure(contender, measure, condition, *estimate(statistic, draws), known)
