"""Runs detectors over labelled clips, and measures how often they are right."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from functools import partial
from itertools import chain, groupby
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from oppload_cli.errors import DetectorError, ParameterError, SourceError, StimulusError, counted
from oppload_cli.evaluation.metrics.clips import Clip, Output, videos_of
from oppload_cli.evaluation.metrics.intervals import DRAWS, Measurement, draws_of
from oppload_cli.evaluation.metrics.measures import FRAME_CENTRE, Performance, measured, of_places
from oppload_cli.models.registry import detector_named, other_heights
from oppload_cli.pipeline.analysis import pass_params, side_by_side
from oppload_cli.pipeline.sources import StimulusVideo
from oppload_cli.processes.pool import results
from oppload_cli.video.frames import AUTO, pixels_of
from oppload_cli.video.source import open_video

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from oppload_cli.evaluation.detectors import EvaluatedDetector
    from oppload_cli.evaluation.manifest import ClipEntry, Manifest
    from oppload_cli.evaluation.metrics.clips import Numbers
    from oppload_cli.models.detector import Box
    from oppload_cli.results.record import FrameRecord
    from oppload_cli.video.frames import DecodedSource, FrameSource


_MOST_REASONS = 10  # in the message that no clip can be used


@dataclass(frozen=True)
class Evaluation:
    """The outcome of `evaluate`: the analysed clips and all measurements."""

    manifest: Manifest
    detectors: list[EvaluatedDetector]
    entries: list[ClipEntry]  # the rows of the manifest whose clips could be used
    clips: list[Clip]  # of each entry
    performances: dict[str, Performance]  # by the name of the detector
    measurements: list[Measurement]  # of all detectors, then of ``frame_centre``
    faults: list[str]  # a sentence for each fault of the manifest and its clips
    draws: int  # of the bootstrap
    battery: Evaluation | None = None  # of the same detectors on the stimuli of the battery


def evaluate(
    manifest: Manifest,
    detectors: Sequence[EvaluatedDetector],
    *,
    jobs: int = 1,
    draws: int = DRAWS,
    progress: Callable[[int], object] | None = None,
) -> Evaluation:
    """Run detectors over the clips of a manifest, and measure them.

    `jobs` is the number of processes, which does not change the result; `draws` is the number of
    draws of the bootstrap. `progress` takes the number of clips that are done since its last call.

    Raises
    ------
    SourceError
        If no clip can be used.
    OutputError
        If the system ends one of the processes, for example because memory runs out.
    """
    faults = list(manifest.faults)
    entries, clips = [], []
    rows: dict[str, list[int]] = {}  # by the fault of their clips
    analysed = analyse_clips(manifest.entries, detectors, jobs=jobs, progress=progress)
    for entry, result in zip(manifest.entries, analysed, strict=True):
        for fault in result.faults:
            faults.append(f"{manifest.path}: row {entry.row}: {fault}")
            rows.setdefault(fault, []).append(entry.row)
        if result.clip is not None:
            entries.append(entry)
            clips.append(result.clip)
    if not clips:
        # The command has printed the faults of the manifest, so the error names those of the clips.
        # It names a fault of many clips, such as a background that is missing, only once.
        shown = [
            f"row {first}" + f" and {counted(len(more), 'other row')}" * bool(more) + f": {fault}"
            for fault, (first, *more) in rows.items()
        ]
        shown = shown or [fault.removeprefix(f"{manifest.path}: ") for fault in faults]
        reasons = shown[:_MOST_REASONS]
        if len(shown) > _MOST_REASONS:
            reasons.append(f"and {len(shown) - _MOST_REASONS} more faults")
        reasons = reasons or ["add a row for each clip"]
        raise SourceError("; ".join([f"{manifest.path}: names no clip that can be used", *reasons]))
    looming = [clip.label.looming for clip in clips]
    weights = draws_of(looming, draws, videos=videos_of(clips))
    performances = {
        detector.name: measured(clips, detector.name, weights) for detector in detectors
    }
    measurements = [
        one for performance in performances.values() for one in performance.measurements
    ]
    measurements += of_places(clips, FRAME_CENTRE, weights)
    return Evaluation(
        manifest, list(detectors), entries, clips, performances, measurements, faults, draws
    )


class _Analysed(NamedTuple):
    """A clip, or None if it cannot be used, and a sentence for each of its faults."""

    clip: Clip | None
    faults: list[str]


def analyse_clips(
    entries: Sequence[ClipEntry],
    detectors: Sequence[EvaluatedDetector],
    *,
    jobs: int = 1,
    progress: Callable[[int], object] | None = None,
) -> list[_Analysed]:
    """Run detectors over clips; arguments and OutputError are those of `evaluate`."""
    videos = [list(of_one) for _, of_one in groupby(entries, attrgetter("path"))]
    threads = 1 if min(jobs, len(videos)) > 1 else 0  # of each decoder
    analysed = results(
        partial(_analyse_video, detectors=detectors, threads=threads),
        videos,
        jobs,
        named=lambda video: video[0].label.name,
        progress=lambda done: progress(len(done)) if progress else None,
    )
    return list(chain.from_iterable(analysed))


def _analyse_video(
    entries: Sequence[ClipEntry], detectors: Sequence[EvaluatedDetector], threads: int
) -> list[_Analysed]:
    """Run detectors over the clips of one video, which is decoded once.

    A clip that cannot be used is a fault, not an error. If `threads` is 0, the decoder chooses
    how many threads it uses.
    """
    try:
        with _opened(entries[0], detectors, threads) as video:
            times, outputs = outputs_of(video, detectors)
            complete, facts = video.decode.complete, video.facts
    # ParameterError: a picture is too wide for the working height.
    except (SourceError, StimulusError, ParameterError) as error:
        return [_Analysed(None, [str(error)]) for _ in entries]
    except DetectorError as error:  # its message does not name the file
        return [_Analysed(None, [f"{entry.label.name}: {error}"]) for entry in entries]
    analysed = []
    for entry in entries:
        clip = Clip(entry.label, times, facts.width, facts.height, outputs)
        name = entry.label.name
        damage = [] if complete else [f"{name}: is damaged or cut; what could be decoded is used"]
        if unfit := _fault_of(clip):
            analysed.append(_Analysed(None, [f"{name}: {unfit}"]))
        else:
            beyond = [
                f"{name}: the box of frame {frame} is beyond its last frame, {len(clip) - 1}; "
                "correct it"
                for frame in sorted(entry.label.boxes)
                if frame >= len(clip)
            ]
            analysed.append(_Analysed(clip, damage + beyond))
    return analysed


def _opened(
    entry: ClipEntry, detectors: Sequence[EvaluatedDetector], threads: int
) -> AbstractContextManager[DecodedSource]:
    """Open a video, or a stimulus that is drawn frame by frame."""
    height, names = detectors[0].height, [detector.name for detector in detectors]
    others = other_heights(names) if height == AUTO else ()
    pixels = pixels_of(height)
    if isinstance(entry.path, Path):
        rate = entry.true_rate
        return open_video(entry.path, height=pixels, others=others, true_rate=rate, threads=threads)
    return nullcontext(StimulusVideo(entry.path, pixels, others=others))


def _fault_of(clip: Clip) -> str:
    """Return why a clip cannot be used; empty if it can."""
    contact = clip.label.contact
    if clip.first == len(clip):
        return f"has {counted(len(clip), 'frame')}, too few for any response; leave it out"
    if contact is not None and contact >= len(clip):
        return (
            f"its contact, frame {contact}, is beyond its last frame, {len(clip) - 1}; correct it"
        )
    if contact is not None and contact < clip.first:
        return (
            f"its contact, frame {contact}, is before the first response, frame {clip.first}; "
            "count in frames, not in seconds, or leave it out"
        )
    return ""


def outputs_of(
    video: FrameSource, detectors: Sequence[EvaluatedDetector]
) -> tuple[Numbers, dict[str, Output]]:
    """Run detectors over a video.

    Return the presentation times of the n frames in seconds, and each detector's output by name.
    """
    first = detectors[0]  # all have the same alarm, repeats and time base
    chosen = pass_params(
        [detector.params for detector in detectors],
        alarm=first.alarm,
        rmo=None,
        repeats=first.repeats,
        time=first.time,
    )
    records = [record for (record,) in side_by_side(video, [chosen])]
    outputs = {detector.name: _output(records, detector) for detector in detectors}
    return np.array([record.time_s for record in records]), outputs


def _output(records: Sequence[FrameRecord], detector: EvaluatedDetector) -> Output:
    name = detector.name
    said = [record[name] for record in records]
    response = np.array([one.response for one in said], float)
    alarm = None
    if detector.alarm.rule_of(name).floor is not None:
        alarm = np.array([one.alarm for one in said], bool)
    if not detector_named(name).places:
        return Output(response, response, alarm)
    return Output(
        response,
        np.array([one.evidence for one in said], float),
        alarm,
        _boxes(None if one.answer is None else one.answer.box for one in said),
        _boxes(one.box for one in said),
        np.array([one.contact_s for one in said], float),
    )


def _boxes(boxes: Iterable[Box | None]) -> Numbers:
    return np.array([box or [None] * 4 for box in boxes], float)
