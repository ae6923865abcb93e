"""Measure what each part of preset `robust` brings: the tables of ``docs/robust.md``.

    python -m benchmarks.ablation MANIFEST.csv [--jobs N]

Each row leaves one part of the preset out. On the clips: detection and median lead at one
false alarm per minute, order within clips, the winning unit's place. On the catalogue's
control stimuli: how many alarm at the threshold that the clips set. Last, the
cross-validation: for each clip the variant that is best on all the other clips is chosen,
with its threshold, and judged on that clip alone.
"""  # fmt: skip

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from oppload_cli.analysis import analyse
from oppload_cli.detection.alarm import ALARMS
from oppload_cli.detection.evaluation.places import places
from oppload_cli.detection.evaluation.thresholds import Approaches, FalseAlarms, held_out_thresholds
from oppload_cli.detection.evaluation.windows import ordered_pairs
from oppload_cli.evaluation.boxes import with_boxes
from oppload_cli.evaluation.contenders import Contender
from oppload_cli.evaluation.evaluate import view_all
from oppload_cli.evaluation.manifest import read_manifest
from oppload_cli.models.parameters import OpplodParams
from oppload_cli.models.presets import PRESETS
from oppload_cli.stimulus.catalogue import load_all
from oppload_cli.tuning.present import StimulusVideo

if TYPE_CHECKING:
    from oppload_cli.detection.evaluation.series import Seen

RATE = 1.0  # false alarms per minute
FRAMES = (4, 8)
WITHOUT: dict[str, dict[str, Any]] = {
    "robust": {},
    "fields of 100 px": {"receptive_field": 100},
    "cells of 8 px": {"cell": 8, "pool_sigma": 1.5},
    "no compression": {"compression": 1.0, "adaptation_level": 0.0},
    "no frames two apart": {"strides": 1},
    "no persistence": {"persistence": 0.0},
    "no adaptation": {"adaptation_level": 0.0},
    "no reference rate": {"reference_rate": 0.0},
    "inward as heavy as outward": {"periphery": 1.0},
    "cone of 90 degrees": {"cone": 90.0},
    "no border": {"border": 0},
}
CONTROLS = (
    "controls/translating-*",
    "controls/receding-*",
    "controls/*rotati*",
    "controls/*grating*",
    "controls/texture-pan*",
    "controls/luminance-*",
    "controls/dots-drift*",
    "klapoetke2017/grating*",
    "klapoetke2017/loom-receding*",
)


def variants() -> list[Contender]:
    """Return preset robust, and it without each of its parts, and preset default."""
    preset = PRESETS["robust"]
    alarm = ALARMS[preset.name]
    made = [
        Contender(name, name, preset.height, preset.opplod.replaced(**changes), alarm)
        for name, changes in WITHOUT.items()
    ]
    default = PRESETS["default"]
    return [*made, Contender("default", "", default.height, default.opplod, ALARMS["default"])]


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("manifest", type=Path)
    parser.add_argument("--jobs", type=int, default=1)
    arguments = parser.parse_args()
    manifest = with_boxes(read_manifest(arguments.manifest))
    chosen = variants()
    # One at a time: they are the same model, and would stand in one bank's way.
    viewed: dict[str, list[Seen]] = {}
    for each in chosen:
        seen = view_all(manifest.entries, [each], jobs=arguments.jobs)
        viewed[each.name] = [one.seen for one in seen if one.seen]
    print("| variant | detected | held out | lead (s) | pairs at 4 | at 8 | place | controls |")
    print("|---|---|---|---|---|---|---|---|")
    for each in chosen:
        row = measured(viewed[each.name], each)
        print(f"| {each.name} | " + " | ".join(f"{value:.3g}" for value in row) + " |", flush=True)
    print()
    print(cross_validated(viewed))


def measured(clips: list[Seen], contender: Contender) -> list[float]:
    """Return a row of the table."""
    name = contender.name
    alarms, approaches = FalseAlarms(clips, name), Approaches(clips, name)
    threshold = alarms.threshold(np.ones(len(clips), np.int64), RATE)
    apart = [
        float(approaches.detected(one)[index])
        for index, one in enumerate(held_out_thresholds(alarms, RATE))
    ]
    near = [place.inside for place in places(clips, name) if place.near]
    return [
        float(np.nanmean(approaches.detected(threshold))),
        float(np.nanmean(apart)),
        float(np.nanmedian(approaches.leads(threshold))),
        *(order(clips, name, frames) for frames in FRAMES),
        float(np.mean(near)),
        alarms_on_controls(contender, threshold),
    ]


def order(clips: list[Seen], name: str, frames: int) -> float:
    """Return the mean share of ordered pairs over clips."""
    return float(np.nanmean([ordered_pairs(seen, name, frames)[0] for seen in clips]))


def alarms_on_controls(contender: Contender, threshold: float) -> int:
    """Return how many control stimuli alarm at a threshold."""
    params, alarm = contender.params, contender.alarm
    if not isinstance(params, OpplodParams) or alarm is None:
        return 0
    count = 0
    for protocol in (each for pattern in CONTROLS for each in load_all(pattern)):
        records = analyse(
            StimulusVideo(protocol, contender.height),
            [params],
            alarm=alarm.replaced(opplod_floor=threshold),
            rmo=None,
        )
        count += any(record.alarms.get("opplod", False) for record in records)
    return count


def cross_validated(viewed: dict[str, list[Seen]]) -> str:
    """Return the sentence on variants chosen on the other clips."""
    clips = len(next(iter(viewed.values())))
    others = 1 - np.eye(clips, dtype=np.int64)
    thresholds = {n: held_out_thresholds(FalseAlarms(s, n), RATE) for n, s in viewed.items()}
    hits = {
        name: np.array(
            [Approaches(seen, name).detected(each) for each in thresholds[name]]
        )  # by clip left out, and clip
        for name, seen in viewed.items()
    }
    pairs = {
        name: np.array([[ordered_pairs(one, name, f)[0] for f in FRAMES] for one in seen])
        for name, seen in viewed.items()
    }
    detected, ordered, picks = [], [], []
    for left_out in range(clips):
        kept = others[left_out] == 1
        best = max(
            viewed,
            key=lambda name: np.nanmean(hits[name][left_out][kept]) + np.nanmean(pairs[name][kept]),
        )
        picks.append(best)
        detected.append(hits[best][left_out][left_out])
        ordered.append(pairs[best][left_out])
    shares = np.nanmean(np.array(ordered), axis=0)
    counts = {name: picks.count(name) for name in dict.fromkeys(picks)}
    return (
        f"Chosen on the other clips: detected {np.nanmean(detected):.2f}, "
        f"pairs in order {shares[0]:.2f} at 4 and {shares[1]:.2f} at 8 frames; chosen: {counts}"
    )


if __name__ == "__main__":
    main()
