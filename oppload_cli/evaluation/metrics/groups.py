"""Measurements that need ground truth: by condition, of boxes, and of times to contact."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from oppload_cli.evaluation.metrics.intervals import (
    Measurement,
    estimate,
    weighted_mean,
    weighted_median,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from oppload_cli.evaluation.metrics.alarms import Decision
    from oppload_cli.evaluation.metrics.clips import Box, Clip, Numbers
    from oppload_cli.evaluation.metrics.intervals import Weights

KIND = "kind"
_BEFORE_CONTACT = 5  # frames
_LAST_S, _WITHIN = 0.5, 0.2


def of_conditions(
    clips: Sequence[Clip], detector: str, decision: Decision, draws: Weights
) -> Iterator[Measurement]:
    """Yield the outcomes of a rule of alarm by the conditions of the clips.

    Detection and lead of the approaches by every condition, and the share of the clips without
    an approach that have an alarm, by kind and over all kinds.
    """
    outcomes = decision.outcomes
    looming = np.array([clip.label.looming for clip in clips])
    alarmed = np.where(looming | np.isnan(outcomes.false_alarms), np.nan, outcomes.false_alarms > 0)
    names = dict.fromkeys(name for clip in clips for name in clip.label.conditions)
    for name in names:
        values = [clip.label.conditions.get(name, "") for clip in clips]
        for value in sorted(set(values) - {""}, key=_order):
            members = np.array([each == value for each in values])
            where = f"{decision.condition}, {name} {value}"
            for measure, numbers, middle in (
                ("detection_rate", outcomes.detected, weighted_mean),
                ("lead_time_s", outcomes.lead_s, weighted_median),
                ("alarmed_share", alarmed, weighted_mean),
            ):
                part = np.where(members, numbers, np.nan)
                known = int((~np.isnan(part)).sum())
                if known and (measure != "alarmed_share" or name == KIND):
                    found = _estimated(middle, part, draws)
                    yield Measurement(detector, measure, where, *found, known)
    if names and not np.isnan(alarmed).all():
        found = _estimated(weighted_mean, alarmed, draws)
        known = int((~np.isnan(alarmed)).sum())
        yield Measurement(detector, "alarmed_share", decision.condition, *found, known)


def _order(text: str) -> tuple[float, str]:
    """Sort by the first number in a text."""
    for word in text.replace(",", " ").split():
        try:
            return float(word), text
        except ValueError:
            continue
    return 0.0, text


def _estimated(
    middle: Callable[[Numbers, Weights], float], values: Numbers, draws: Weights
) -> tuple[float, float, float]:
    return estimate(partial(middle, values), draws)


def of_objects(clips: Sequence[Clip], detector: str, draws: Weights) -> Iterator[Measurement]:
    """Yield how well a detector's boxes and times to contact fit the truth.

    Nothing for a detector without boxes, and for clips without times to contact.
    """
    outputs = [clip.outputs[detector] for clip in clips]
    if not any(clip.label.contacts for clip in clips) or any(one.box is None for one in outputs):
        return
    overlaps = np.array([_overlap_of(clip, detector) for clip in clips])
    errors = np.array([_contact_error(clip, detector) for clip in clips])
    looming = np.array([clip.label.looming for clip in clips])
    where = f"{_BEFORE_CONTACT} frames before contact"
    known = int((~np.isnan(overlaps)).sum())
    found = _estimated(weighted_median, overlaps, draws)
    yield Measurement(detector, "box_overlap", where, *found, known)
    within = np.where(looming, np.nan_to_num(errors, nan=np.inf) <= _WITHIN, np.nan)
    where = f"last {_LAST_S:g} s"
    found = _estimated(weighted_mean, within, draws)
    yield Measurement(detector, "contact_within", where, *found, int(looming.sum()))
    given = int((~np.isnan(errors)).sum())
    found = _estimated(weighted_median, errors, draws)
    yield Measurement(detector, "contact_error", where, *found, given)


def _overlap_of(clip: Clip, detector: str) -> float:
    """Return the intersection over union of the found and the true box, 5 frames before contact.

    0 without a found box; NaN without an approach or a true box.
    """
    box, contact = clip.outputs[detector].box, clip.label.contact
    if contact is None or box is None:
        return float("nan")
    frame = contact - _BEFORE_CONTACT
    true = clip.label.boxes.get(frame)
    if true is None or frame < clip.first:
        return float("nan")
    found = box[frame]
    return 0.0 if np.isnan(found).any() else overlap(tuple(map(float, found)), true)


def overlap(first: tuple[float, ...], second: Box) -> float:
    """Return the intersection of two boxes (left, top, width, height) over their union."""
    sides = []
    for at in (0, 1):
        low = max(first[at], second[at])
        sides.append(max(min(first[at] + first[at + 2], second[at] + second[at + 2]) - low, 0.0))
    common = sides[0] * sides[1]
    whole = first[2] * first[3] + second[2] * second[3] - common
    return common / whole if whole > 0 else 0.0


def _contact_error(clip: Clip, detector: str) -> float:
    """Return the median relative error of the times to contact in the last half second.

    NaN where none is given.
    """
    times = clip.outputs[detector].contact_s
    if times is None:
        return float("nan")
    errors = [
        abs(float(times[frame]) / left - 1)
        for frame, left in clip.label.contacts.items()
        if 0 < left <= _LAST_S and frame < len(clip) and not np.isnan(times[frame])
    ]
    return float(np.median(errors)) if errors else float("nan")
