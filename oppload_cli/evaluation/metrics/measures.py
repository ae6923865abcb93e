"""All measurements of a detector over labelled clips; ``docs/evaluation.md`` defines them."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from oppload_cli.evaluation.metrics.alarms import (
    AT_ONE,
    RATES,
    SHIPPED,
    Decision,
    Thresholds,
    shipped,
)
from oppload_cli.evaluation.metrics.clips import (
    AHEAD,
    EPSILON_S,
    LEAST_S,
    Curves,
    curves_of,
    scored,
    videos_of,
)
from oppload_cli.evaluation.metrics.intervals import (
    Measurement,
    area_interval,
    estimate,
    precision_interval,
    share_interval,
    weighted_mean,
    weighted_median,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from oppload_cli.evaluation.metrics.clips import Clip, Numbers, Positions
    from oppload_cli.evaluation.metrics.intervals import Weights
    from oppload_cli.models.detector import Box


NEAR_CONTACT = 15  # frames before contact
GROWN = 1.5  # factor by which a labelled box is enlarged about its centre
FRAME_CENTRE = "frame_centre"  # a baseline that always points at the centre of the frame
KIND = "kind"  # the condition by which clips without an approach are grouped
_BEFORE_CONTACT = 5  # frames before contact, of the compared boxes
_LAST_S, _WITHIN = 0.5, 0.2  # the judged times to contact, and their largest relative error
_EACH_CLIP = slice(None)


@dataclass(frozen=True)
class Performance:
    """All measurements of one detector."""

    measurements: list[Measurement]
    decisions: dict[str, Decision]  # by condition, such as ``at 1 per minute``
    curves: Curves | None  # of the one-second windows
    thresholds: Thresholds  # for detections over false alarms


def measured(clips: Sequence[Clip], detector: str, draws: Weights) -> Performance:
    """Measure one detector over at least one clip, with the draws from `draws_of`."""
    thresholds = Thresholds(clips, detector)
    rules = [
        *(thresholds.at_rate(rate, draws) for rate in RATES),
        *(thresholds.held_out(rate, draws) for rate in RATES),
        shipped(clips, detector, draws),
    ]
    decisions = {decision.condition: decision for decision in rules}
    measurements = [measurement for decision in rules for measurement in decision.measurements]
    for condition in (AT_ONE, SHIPPED):
        measurements += _of_conditions(clips, detector, decisions[condition], draws)
    measurements += _of_objects(clips, detector, draws)
    score, positive, owner = scored(clips, detector)
    curves = curves_of(score, positive)
    video = videos_of(clips)[owner]
    measurements += _of_windows(detector, curves, video[positive], video[~positive])
    measurements += _of_order(clips, detector, draws)
    ratio = _median(_distinct_ratios(clips, detector), draws)
    measurements.append(Measurement(detector, "distinct_ratio", "median over clips", *ratio))
    measurements += of_places(clips, detector, draws)
    return Performance(measurements, decisions, curves, thresholds)


def _of_windows(
    detector: str, curves: Curves | None, approaches: Positions, others: Positions
) -> Iterator[Measurement]:
    """Yield how well the scores of one-second windows tell approaches from other footage.

    `approaches` and `others` hold the number of the video of each window of these kinds.
    """
    videos = len(np.unique(approaches)), len(np.unique(others))
    area, precision = (curves.auc, curves.average_precision) if curves else (math.nan, math.nan)
    condition, windows = "last second before contact", len(approaches) + len(others)
    bounds = area_interval(area, *videos)
    yield Measurement(detector, "roc_auc", condition, area, *bounds, windows)
    bounds = precision_interval(precision, *videos)
    yield Measurement(detector, "average_precision", condition, precision, *bounds, windows)


def _averaged(
    average: Callable[[Numbers, Weights], float],
    values: Numbers,
    draws: Weights,
    owner: Positions | slice = _EACH_CLIP,
) -> tuple[float, float, float, int]:
    """Return a mean or median with its interval, and the number of values that are not NaN.

    Value i belongs to clip i, or to clip `owner[i]`.
    """
    estimated = estimate(lambda weights: average(values, weights[owner]), draws)
    return (*estimated, int((~np.isnan(values)).sum()))


_median = partial(_averaged, weighted_median)


def _share(
    values: Numbers, draws: Weights, owner: Positions | slice = _EACH_CLIP
) -> tuple[float, float, float, int]:
    """Return a mean of shares like `_averaged`; its interval is not empty if all values agree."""
    share, low, high, count = _averaged(weighted_mean, values, draws, owner)
    clips = np.arange(draws.shape[1])[owner][~np.isnan(values)]
    return (share, *share_interval(share, len(np.unique(clips)), low, high), count)


def _of_order(clips: Sequence[Clip], detector: str, draws: Weights) -> Iterator[Measurement]:
    for frames in AHEAD:
        shares, pairs = zip(*(clip.ordered_pairs(detector, frames) for clip in clips), strict=True)
        share, low, high, _ = _share(np.array(shares), draws)
        condition = f"{frames} frames before contact"
        yield Measurement(detector, "ordered_pairs", condition, share, low, high, sum(pairs))


def _distinct_ratios(clips: Sequence[Clip], detector: str) -> Numbers:
    """Return the largest response of each approach divided by the largest response before onset.

    If less than half a second comes before onset, the divisor is the median of the largest
    responses of the clips without an approach. The ratio is 1 if both are 0, infinite if only the
    divisor is 0, and NaN without an approach.
    """
    before = np.array([_largest_before(clip, detector) for clip in clips])
    looming = np.array([clip.label.looming for clip in clips])
    without_approach = before[~looming & ~np.isnan(before)]
    median = float(np.median(without_approach)) if len(without_approach) else float("nan")
    ratios = np.full(len(clips), np.nan)
    for index, clip in enumerate(clips):
        start, stop = clip.approach
        if start == stop:
            continue
        peak = float(clip.outputs[detector].response[start:stop].max())
        divisor = median if np.isnan(before[index]) else float(before[index])
        ratios[index] = peak / divisor if divisor else float("inf") if peak else 1.0
    return ratios


def _largest_before(clip: Clip, detector: str) -> float:
    """Return the largest response without an approach; NaN for less than half a second of it."""
    start, stop = clip.quiet
    if clip.seconds(start, stop) < LEAST_S - EPSILON_S:
        return float("nan")
    return float(clip.outputs[detector].response[start:stop].max())


def _of_conditions(
    clips: Sequence[Clip], detector: str, decision: Decision, draws: Weights
) -> Iterator[Measurement]:
    """Yield the outcomes of a rule of alarm, grouped by the conditions of the clips.

    Each condition has a detection rate and a lead time. Each kind, and all kinds together, have the
    share of clips without an approach that have an alarm.
    """
    outcomes = decision.outcomes
    looming = np.array([clip.label.looming for clip in clips])
    alarmed = np.where(looming | np.isnan(outcomes.false_alarms), np.nan, outcomes.false_alarms > 0)
    names = dict.fromkeys(name for clip in clips for name in clip.label.conditions)
    for name in names:
        values = np.array([clip.label.conditions.get(name, "") for clip in clips])
        for value in sorted(set(values.tolist()) - {""}, key=_order):
            where = f"{decision.condition}, {name} {value}"
            for measure, numbers, average in (
                ("detection_rate", outcomes.detected, _share),
                ("lead_time_s", outcomes.lead_s, _median),
                ("alarmed_share", alarmed, _share),
            ):
                part = np.where(values == value, numbers, np.nan)
                if not np.isnan(part).all() and (measure != "alarmed_share" or name == KIND):
                    yield Measurement(detector, measure, where, *average(part, draws))
    if names and not np.isnan(alarmed).all():
        yield Measurement(detector, "alarmed_share", decision.condition, *_share(alarmed, draws))


def _order(text: str) -> tuple[float, str]:
    """Return a key that sorts texts by their first number."""
    for word in text.replace(",", " ").split():
        with suppress(ValueError):
            return float(word), text
    return 0.0, text


def _of_objects(clips: Sequence[Clip], detector: str, draws: Weights) -> Iterator[Measurement]:
    """Yield how well a detector's boxes and times to contact agree with the ground truth.

    A detector without boxes, or clips without true times to contact, give no measurement.
    """
    outputs = [clip.outputs[detector] for clip in clips]
    if not any(clip.label.contacts for clip in clips) or any(one.box is None for one in outputs):
        return
    overlaps = np.array([_overlap_of(clip, detector) for clip in clips])
    errors = np.array([_contact_error(clip, detector) for clip in clips])
    if not np.isnan(overlaps).all():
        where = f"{_BEFORE_CONTACT} frames before contact"
        yield Measurement(detector, "box_overlap", where, *_median(overlaps, draws))
    timed = np.array([any(map(_is_last, clip.label.contacts.values())) for clip in clips])
    within = np.where(timed, errors <= _WITHIN, np.nan)  # NaN is not within
    where = f"last {_LAST_S:g} s"
    yield Measurement(detector, "contact_within", where, *_share(within, draws))
    yield Measurement(detector, "contact_error", where, *_median(errors, draws))


def _overlap_of(clip: Clip, detector: str) -> float:
    """Return the intersection over union of the detector's and the true box before contact.

    0 without a box of the detector; NaN without an approach or a true box.
    """
    box, contact = clip.outputs[detector].box, clip.label.contact
    if contact is None or box is None:
        return float("nan")
    frame = contact - _BEFORE_CONTACT
    true = clip.label.boxes.get(frame)
    if true is None or frame < clip.first:
        return float("nan")
    detected = box[frame]
    return 0.0 if np.isnan(detected).any() else overlap(tuple(map(float, detected)), true)


def overlap(first: Sequence[float], second: Sequence[float]) -> float:
    """Return the intersection of two boxes (left, top, width, height) over their union."""
    sides = []
    for axis in (0, 1):
        low = max(first[axis], second[axis])
        high = min(first[axis] + first[axis + 2], second[axis] + second[axis + 2])
        sides.append(max(high - low, 0.0))
    intersection = sides[0] * sides[1]
    union = first[2] * first[3] + second[2] * second[3] - intersection
    return intersection / union if union > 0 else 0.0


def _is_last(contact_s: float) -> bool:
    """Tell whether a time to contact lies in the last half second."""
    return 0 < contact_s <= _LAST_S


def _contact_error(clip: Clip, detector: str) -> float:
    """Return the median relative error of the times to contact in the last half second.

    NaN if the detector gives no time to contact there.
    """
    times = clip.outputs[detector].contact_s
    if times is None:
        return float("nan")
    errors = [
        abs(float(times[frame]) / true - 1)
        for frame, true in clip.label.contacts.items()
        if _is_last(true) and frame < len(clip) and not np.isnan(times[frame])
    ]
    return float(np.median(errors)) if errors else float("nan")


class _Place(NamedTuple):
    """The distance between the winning unit and the labelled box in one frame."""

    clip: int  # its position
    near: bool  # whether the frame is at most 15 frames before contact
    distance_px: float  # of the centres, in source pixels; NaN without a winning unit
    distance_diagonals: float  # the same in diagonals of the box
    inside: bool  # whether the unit's centre is in the box, enlarged 1.5 times


def places(clips: Sequence[Clip], detector: str) -> list[_Place]:
    """Return the place of the winning unit in every frame with a labelled box after warm-up.

    The `detector` has units, or is ``frame_centre``, which points at the centre of the frame.
    """
    placed = []
    for index, clip in enumerate(clips):
        centres, contact = _centres(clip, detector), clip.label.contact
        for frame, box in sorted(clip.label.boxes.items()):
            if clip.first <= frame < len(clip):
                near = contact is not None and contact - NEAR_CONTACT <= frame <= contact
                placed.append(_Place(index, near, *_compared(centres[frame], box)))
    return placed


def _centres(clip: Clip, detector: str) -> Numbers:
    if detector == FRAME_CENTRE:
        return np.tile([clip.width / 2, clip.height / 2], (len(clip), 1))
    winner = clip.outputs[detector].winner
    if winner is None:
        return np.full((len(clip), 2), np.nan)
    return np.asarray(winner[:, :2] + winner[:, 2:] / 2, np.float64)


def _compared(centre: Numbers, box: Box) -> tuple[float, float, bool]:
    left, top, width, height = box
    offset = np.abs(centre - (left + width / 2, top + height / 2))
    distance = float(np.hypot(*offset))
    inside = bool(offset[0] <= GROWN * width / 2 and offset[1] <= GROWN * height / 2)
    return distance, distance / float(np.hypot(width, height)), inside


def of_places(clips: Sequence[Clip], detector: str, draws: Weights) -> list[Measurement]:
    """Return how near a detector's winning unit is to the labelled boxes.

    The list is empty if the detector has no units or the clips have no boxes.
    """
    has_units = detector == FRAME_CENTRE or any(
        clip.outputs[detector].winner is not None for clip in clips
    )
    boxed = places(clips, detector) if has_units else []
    near = [place for place in boxed if place.near]
    measurements = []
    for condition, part in (
        (f"within {NEAR_CONTACT} frames of contact", near),
        ("all boxed frames", boxed),
    ):
        owner = np.array([place.clip for place in part])
        for name in ("inside", "distance_px", "distance_diagonals") if part else ():
            values = np.array([getattr(place, name) for place in part], np.float64)
            averaged = (_share if name == "inside" else _median)(values, draws, owner)
            measurements.append(Measurement(detector, f"place_{name}", condition, *averaged))
    return measurements
