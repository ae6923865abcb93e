"""Measure the gain from each part of preset `default`: the table of ``docs/presets.md``.

    python -m benchmarks.ablation MANIFEST.csv [--jobs N]

Each row leaves one part of the preset out. On the clips it measures detection and median lead
time at one false alarm per minute, the order within clips, and the place of the winning unit.
On the control stimuli of the catalogue it counts the alarms at the threshold that the clips set.
The last line is the cross-validation: for each clip, the variant that is best on all other clips
is chosen, with its threshold, and judged on that clip alone.
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
    from numpy.typing import NDArray

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
    "objects that pass count": {"passing": 0.0},
    "no steady light": {"light_s": 0.0},
    "no noise filter": {"residual_noise": 0},
    "no steady view": {"steady_view": False},
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


def _variants() -> list[EvaluatedDetector]:
    """Return preset default, preset default without one part each, and preset reference."""
    default, reference, *_ = evaluated_detectors(["opplod:default", "opplod:reference"])
    made = [
        replace(default, name=name, meaning=name, params=default.params.replaced(**changes))
        for name, changes in WITHOUT.items()
    ]
    return [*made, replace(reference, name="reference", meaning="")]


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("manifest", type=Path, help="the labelled clips, as for oppload evaluate")
    parser.add_argument("--jobs", type=int, default=1, help="number of processes (1)")
    arguments = parser.parse_args()
    manifest = with_boxes(read_manifest(arguments.manifest))
    variants = _variants()
    # One variant at a time, because one pass cannot run the same detector twice.
    analysed: dict[str, list[Clip]] = {}
    for each in variants:
        found = analyse_clips(manifest.entries, [each], jobs=arguments.jobs)
        analysed[each.name] = [one.clip for one in found if one.clip]
    print("| variant | detected | held out | lead (s) | pairs at 4 | at 8 | place | controls |")
    print("|---|---|---|---|---|---|---|---|")
    for each in variants:
        row = _measured(analysed[each.name], each)
        print(f"| {each.name} | " + " | ".join(f"{value:.3g}" for value in row) + " |", flush=True)
    print()
    print(_cross_validated(analysed))


def _measured(clips: list[Clip], detector: EvaluatedDetector) -> list[float]:
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
        *np.nanmean(_ordered_pairs(clips, name), axis=0),
        float(np.mean(near)),
        _alarms_on_controls(detector, threshold),
    ]


def _ordered_pairs(clips: list[Clip], name: str) -> NDArray[np.float64]:
    """Return the share of pairs of responses in order, by clip and number of frames."""
    return np.array([[clip.ordered_pairs(name, frames)[0] for frames in FRAMES] for clip in clips])


def _alarms_on_controls(detector: EvaluatedDetector, threshold: float) -> int:
    """Return the number of control stimuli that cause an alarm at a threshold."""
    alarm, count = detector.alarm.replaced(opplod_floor=threshold), 0
    for protocol in (each for pattern in CONTROLS for each in load_all(pattern)):
        video = StimulusVideo(protocol, detector.height)
        records = analyse(video, [detector.params], alarm=alarm, rmo=None)
        count += any(record.alarms.get("opplod", False) for record in records)
    return count


def _cross_validated(analysed: dict[str, list[Clip]]) -> str:
    """Return the result of the cross-validation as a sentence."""
    clips = len(next(iter(analysed.values())))
    detected, ordered = {}, {}
    for name, own in analysed.items():
        thresholds = Thresholds(own, name)
        held_out = thresholds.held_out(RATE, np.ones((1, clips), np.int64)).thresholds
        detected[name] = np.array([thresholds.outcomes(each).detected for each in held_out])
        ordered[name] = _ordered_pairs(own, name)
    chosen = []
    for clip in range(clips):  # the threshold was chosen without this clip, and so is the variant
        scores = {
            name: np.nanmean(np.delete(detected[name][clip], clip))
            + np.nanmean(np.delete(ordered[name], clip, axis=0))
            for name in analysed
        }
        chosen.append(max(scores, key=lambda name: scores[name]))
    found = [detected[name][clip][clip] for clip, name in enumerate(chosen)]
    shares = np.nanmean([ordered[name][clip] for clip, name in enumerate(chosen)], axis=0)
    counts = {name: chosen.count(name) for name in dict.fromkeys(chosen)}
    return (
        f"Chosen on the other clips: detected {np.nanmean(found):.2f}, "
        f"pairs in order {shares[0]:.2f} at 4 and {shares[1]:.2f} at 8 frames; chosen: {counts}"
    )


if __name__ == "__main__":
    main()
