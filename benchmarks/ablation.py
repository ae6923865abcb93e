"""Measure the gain from each part of preset `default`: the table of ``docs/presets.md``.

    python -m benchmarks.ablation MANIFEST.csv [--jobs N]

Each row leaves one part of the preset out. On the clips it measures detection and median lead
time at one false alarm per minute, the order within clips, and the place of the winning unit.
On the control stimuli of the catalogue it counts the alarms at the threshold that the clips set.
Last comes the cross-validation: for each clip, the variant that is best on all other clips is
chosen, with its threshold, and judged on that clip alone.
"""  # fmt: skip

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from oppload_cli.evaluation.detectors import EvaluatedDetector, evaluated_detectors
from oppload_cli.evaluation.evaluate import analyse_clips
from oppload_cli.evaluation.manifest import read_manifest, with_boxes
from oppload_cli.evaluation.metrics.alarms import Thresholds
from oppload_cli.evaluation.metrics.measures import places
from oppload_cli.pipeline.analysis import analyse
from oppload_cli.pipeline.sources import StimulusVideo
from oppload_cli.stimulus.catalogue import load_all

if TYPE_CHECKING:
    from oppload_cli.evaluation.metrics.clips import Clip

RATE = 1.0  # false alarms per minute
FRAMES = (4, 8)
WITHOUT: dict[str, dict[str, Any]] = {
    "default": {},
    "fields of 100 px": {"receptive_field": 100},
    "cells of 8 px": {"cell": 8, "pool_sigma": 1.5},
    "no compression": {"compression": 1.0, "adaptation_level": 0.0},
    "no interval of two": {"stride": 1},
    "no frame at half its size": {"halved_weight": 0.0},
    "no persistence": {"persistence": 0.0},
    "no adaptation": {"adaptation_level": 0.0},
    "no history": {"history": 0.0},
    "cone of 90 degrees": {"cone": 90.0},
    "no border": {"border": 0},
    "nothing left out that enters": {"entering": 0},
    "no steady light": {"light_s": 0.0},
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


def variants() -> list[EvaluatedDetector]:
    """Return preset default, its variants without one part each, and preset reference."""
    default, reference, *_ = evaluated_detectors(["opplod:default", "opplod:reference"])
    made = [
        replace(default, name=name, meaning=name, params=default.params.replaced(**changes))
        for name, changes in WITHOUT.items()
    ]
    return [*made, replace(reference, name="reference", meaning="")]


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("manifest", type=Path)
    parser.add_argument("--jobs", type=int, default=1)
    arguments = parser.parse_args()
    manifest = with_boxes(read_manifest(arguments.manifest))
    chosen = variants()
    # One at a time, because one pass cannot hold the same model twice.
    analysed: dict[str, list[Clip]] = {}
    for each in chosen:
        found = analyse_clips(manifest.entries, [each], jobs=arguments.jobs)
        analysed[each.name] = [one.clip for one in found if one.clip]
    print("| variant | detected | held out | lead (s) | pairs at 4 | at 8 | place | controls |")
    print("|---|---|---|---|---|---|---|---|")
    for each in chosen:
        row = measured(analysed[each.name], each)
        print(f"| {each.name} | " + " | ".join(f"{value:.3g}" for value in row) + " |", flush=True)
    print()
    print(cross_validated(analysed))


def measured(clips: list[Clip], detector: EvaluatedDetector) -> list[float]:
    """Return the values of one row of the table."""
    name = detector.name
    thresholds = Thresholds(clips, name)
    once = np.ones((1, len(clips)), np.int64)
    threshold = thresholds.lowest(once[0], RATE)
    outcomes = thresholds.outcomes(threshold)
    near = [place.inside for place in places(clips, name) if place.near]
    return [
        float(np.nanmean(outcomes.detected)),
        float(np.nanmean(thresholds.held_out(RATE, once).outcomes.detected)),
        float(np.nanmedian(outcomes.lead_s)),
        *(order(clips, name, frames) for frames in FRAMES),
        float(np.mean(near)),
        alarms_on_controls(detector, threshold),
    ]


def order(clips: list[Clip], name: str, frames: int) -> float:
    """Return the mean share of ordered pairs over clips."""
    return float(np.nanmean([clip.ordered_pairs(name, frames)[0] for clip in clips]))


def alarms_on_controls(detector: EvaluatedDetector, threshold: float) -> int:
    """Return the number of control stimuli that set off an alarm at a threshold."""
    alarm, count = detector.alarm.replaced(opplod_floor=threshold), 0
    for protocol in (each for pattern in CONTROLS for each in load_all(pattern)):
        records = analyse(
            StimulusVideo(protocol, detector.height),
            [detector.params],
            alarm=alarm,
            rmo=None,
        )
        count += any(record.alarms.get("opplod", False) for record in records)
    return count


def cross_validated(analysed: dict[str, list[Clip]]) -> str:
    """Return the result of the cross-validation as a sentence."""
    clips = len(next(iter(analysed.values())))
    others = 1 - np.eye(clips, dtype=np.int64)
    thresholds = {name: Thresholds(own, name) for name, own in analysed.items()}
    hits = {
        name: np.array(
            [
                each.outcomes(threshold).detected
                for threshold in each.held_out(RATE, np.ones((1, clips), np.int64)).thresholds
            ]
        )
        for name, each in thresholds.items()
    }  # shape: held-out clip, clip
    pairs = {
        name: np.array([[one.ordered_pairs(name, f)[0] for f in FRAMES] for one in own])
        for name, own in analysed.items()
    }
    detected, ordered, picks = [], [], []
    for held_out_clip in range(clips):
        kept = others[held_out_clip] == 1
        best = max(
            analysed,
            key=lambda name: (
                np.nanmean(hits[name][held_out_clip][kept]) + np.nanmean(pairs[name][kept])
            ),
        )
        picks.append(best)
        detected.append(hits[best][held_out_clip][held_out_clip])
        ordered.append(pairs[best][held_out_clip])
    shares = np.nanmean(np.array(ordered), axis=0)
    counts = {name: picks.count(name) for name in dict.fromkeys(picks)}
    return (
        f"Chosen on the other clips: detected {np.nanmean(detected):.2f}, "
        f"pairs in order {shares[0]:.2f} at 4 and {shares[1]:.2f} at 8 frames; chosen: {counts}"
    )


if __name__ == "__main__":
    main()
