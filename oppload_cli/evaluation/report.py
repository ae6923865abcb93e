"""``report.json``: every figure, parameter and fault of an evaluation."""

from __future__ import annotations

import json
import math
from typing import TYPE_CHECKING, Any

from oppload_cli.detection.evaluation.intervals import LEVEL, SEED
from oppload_cli.detection.evaluation.places import GROWN, NEAR_CONTACT
from oppload_cli.detection.evaluation.thresholds import RATES, SILENCE_S
from oppload_cli.detection.evaluation.windows import AHEAD, LEAST_S, WINDOW_S
from oppload_cli.environment import environment

if TYPE_CHECKING:
    from collections.abc import Iterator

    from oppload_cli.evaluation.evaluate import Evaluation

SCHEMA = "oppload.evaluation/1"


def report_of(evaluation: Evaluation) -> dict[str, Any]:
    """Gather the report; the same clips give the same one.

    Parameters
    ----------
    evaluation : Evaluation
        What was measured.

    Returns
    -------
    dict
        Ready for :func:`report_json`.
    """
    clips = evaluation.clips
    return {
        "schema": SCHEMA,
        "tool": environment(),
        "manifest": {
            "path": str(evaluation.manifest.path),
            "rows": evaluation.manifest.rows,
            "clips": len(clips),
            "looming": sum(seen.label.looming for seen in clips),
            "none": sum(not seen.label.looming for seen in clips),
            "frames": sum(len(seen) for seen in clips),
            "boxed_frames": sum(len(seen.label.boxes) for seen in clips),
            "minutes_without_approach": sum(seen.seconds(*seen.quiet) for seen in clips) / 60,
        },
        "faults": evaluation.faults,
        "settings": {
            "false_alarm_rates_per_minute": list(RATES),
            "silence_s": SILENCE_S,
            "window_s": WINDOW_S,
            "shortest_window_s": LEAST_S,
            "frames_before_contact": list(AHEAD),
            "near_contact_frames": NEAR_CONTACT,
            "box_grown_times": GROWN,
            "bootstrap": {"draws": evaluation.draws, "seed": SEED, "level_percent": LEVEL},
        },
        "contenders": {each.name: each.as_dict() for each in evaluation.contenders},
        "figures": [figure._asdict() for figure in evaluation.figures],
        "clips": list(clip_rows(evaluation)),
    }


def clip_rows(evaluation: Evaluation) -> Iterator[dict[str, Any]]:
    """Yield what came of each clip.

    Parameters
    ----------
    evaluation : Evaluation
        What was measured.

    Yields
    ------
    dict
        With its label, length, and for each contender and rule of alarm whether the
        approach was detected, its lead in seconds, and the false alarms.
    """
    for index, (entry, seen) in enumerate(zip(evaluation.entries, evaluation.clips, strict=True)):
        outcomes: dict[str, dict[str, Any]] = {}
        for name, found in evaluation.measured.items():
            outcomes[name] = {
                each.condition: {
                    "detected": _flag(each.outcomes.detected[index]),
                    "lead_s": float(each.outcomes.lead_s[index]),
                    "false_alarms": _count(each.outcomes.false_alarms[index]),
                }
                for each in found.decisions
            }
        yield {
            "file": seen.label.name,
            "row": entry.row,
            "label": "looming" if seen.label.looming else "none",
            "kind": seen.label.kind,
            "onset_frame": seen.label.onset,
            "contact_frame": seen.label.contact,
            "frames": len(seen),
            "first_frame": seen.first,
            "seconds": seen.seconds(0, len(seen)),
            "seconds_without_approach": seen.seconds(*seen.quiet),
            "width": seen.width,
            "height": seen.height,
            "outcomes": outcomes,
        }


def report_json(report: dict[str, Any]) -> str:
    """Return the report as text; what is not a number is null.

    Parameters
    ----------
    report : dict
        From :func:`report_of`.

    Returns
    -------
    str
    """
    return json.dumps(_finite(report), indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def _flag(value: float) -> bool | None:
    return None if math.isnan(value) else bool(value)


def _count(value: float) -> int | None:
    return None if math.isnan(value) else int(value)


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(one) for key, one in value.items()}
    if isinstance(value, list):
        return [_finite(one) for one in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
