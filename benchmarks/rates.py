"""Measure how responses depend on the frame rate, for ``docs/time.md``.

    python -m benchmarks.rates [--phases N] [--model NAME]
    python -m benchmarks.rates --between [--phases N]
    python -m benchmarks.rates --controls
    python -m benchmarks.rates --clips MANIFEST.csv

The program draws looming disks at the times of the frames, at 10 to 240 frames/s and with dropped
and jittered frames. It analyses them as ``oppload run`` does. The frames end when the disk stops to
grow. The peak depends on the time from the last frame to this moment. So every rate is shown with
`--phases` shifts of its first frame, and compared with the mean at 30 frames/s. Dropped and
jittered frames are drawn at random, 4 times for each shift. With `--model` only that detector runs.
With `--between` the detectors also see the frames between, at 240 frames/s, but only
responses at the times of the frames count: this is the share of a peak that these times leave.
`--clips` shows every frame, every second or every third frame of labelled clips, or all frames as a
camera that jerks or has noise sees them, and counts the alarms at the floors of the package.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import replace
from fractions import Fraction
from functools import partial
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, cast

import cv2
import numpy as np

from oppload_cli.evaluation.detectors import EvaluatedDetector, evaluated_detectors
from oppload_cli.evaluation.engine import outputs_of
from oppload_cli.evaluation.manifest import ClipEntry, read_manifest
from oppload_cli.evaluation.metrics.alarms import shipped
from oppload_cli.evaluation.metrics.clips import Clip
from oppload_cli.evaluation.metrics.intervals import draws_of
from oppload_cli.frame_times import ticks
from oppload_cli.models.registry import parameters_of
from oppload_cli.pipeline.analysis import analyse
from oppload_cli.pipeline.sources import StimulusVideo
from oppload_cli.processes import cores
from oppload_cli.processes.pool import results
from oppload_cli.stimulus.catalogue import load, load_all
from oppload_cli.stimulus.renderer import Renderer
from oppload_cli.video.frames import WORKING_HEIGHT
from oppload_cli.video.source import open_video

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from oppload_cli.results.record import FrameRecord
    from oppload_cli.stimulus.protocol import Protocol
    from oppload_cli.video.frames import Frame, FrameSource

    Times = NDArray[np.float64]
    Case = tuple[str, str]  # the disk and the detector
    Table = dict[tuple[Case, float, str], "_Compared"]

RATES = (10, 15, 24, 25, 30, 50, 60, 90, 120, 240)
FINEST = 240  # frames/s of `--between`
COARSE = (10, 15, 24)
UNEVEN = (
    *((30, "dropped"), (30, "jittered"), (60, "dropped and jittered")),
    *((30, "steps 1, 2"), (30, "steps 1, 3")),
)
DRAWS = 4  # random draws for each shift of the first frame
DISKS = {
    "l/v 20 ms": ("klapoetke2017/loom-l-over-v", 20),
    "l/v 40 ms": ("klapoetke2017/loom-l-over-v", 40),
    "l/v 80 ms": ("klapoetke2017/loom-l-over-v", 80),
    "paper, centre": ("opplod2023/looming-disk-centre", None),
    "paper, off centre": ("opplod2023/looming-disk-off-centre", None),
}
CASES = tuple(product(DISKS, ("opplod", "opplod_reference", "dlgmd")))
CONTROLS = (
    *("controls/receding-disk", "controls/translating-disk-speed"),
    *("controls/texture-pan", "controls/square-grating/axis-0"),
)


class _ShownAt(StimulusVideo):
    """A stimulus, drawn at given times instead of the times of its own frames."""

    def __init__(self, protocol: Protocol, height: int, rate: float, times: Times) -> None:
        display = replace(protocol.display, frame_rate=Fraction(rate).limit_denominator(1001))
        super().__init__(replace(protocol, display=display), height)
        self._times = times

    def _pictures(self) -> Iterator[tuple[int, NDArray[np.uint8]]]:
        renderer = Renderer(self.protocol)
        for time_s in self._times:
            drawn = renderer._picture(time_s, time_s)
            yield ticks(time_s), np.clip(np.rint(drawn * np.float32(255)), 0, 255).astype(np.uint8)


class _Result(NamedTuple):
    """The largest response, its time, and the time of the first alarm."""

    peak: float
    peak_s: float
    alarm_s: float


class _Compared(NamedTuple):
    """Runs of one detector on one disk, compared with those at 30 frames/s."""

    peak: float  # mean ratio of the peaks
    least: float
    largest: float
    peak_late_s: float  # mean difference of the times of the peaks
    alarm_late_s: float  # mean difference of the first alarms, of the runs with an alarm
    without: int  # number of runs without an alarm
    runs: int


def _disk(name: str) -> tuple[Protocol, float]:
    """Return a stimulus and the time at which its disk stops to grow."""
    protocol, l_over_v = DISKS[name]
    if l_over_v is None:
        loaded = load(protocol)
        return loaded, float(loaded.frame_count / loaded.display.frame_rate)
    loaded = load(protocol, {"disk.growth.l_over_v_ms": l_over_v})
    contact_s = loaded.timing.before_s + loaded.timing.motion_s
    return loaded, contact_s - l_over_v / 1000 / np.tan(np.radians(30))


def _frame_times(rate: float, kind: str, phase: float, end_s: float, draw: int = 0) -> Times:
    """Return the times of frames up to `end_s`, of which the first is `phase` frames late.

    `kind` is empty for even times. With "dropped" about every seventh frame is left out. With
    "jittered" each time changes by up to a quarter of a frame. `draw` is the number of the random
    draw. With "steps 1, 3" the steps from frame to frame are 1 and 3 frames in turns.
    """
    times = (np.arange(int(end_s * rate) + 1) + phase) / rate
    random = np.random.default_rng([5, round(1000 * phase), draw])
    jitter = (random.random(len(times)) - 0.5) * 0.5 / rate
    dropped = random.random(len(times)) < 0.15
    if "jittered" in kind:
        times += jitter
    times = np.maximum(times - times[0], 0) + phase / rate
    if "dropped" in kind:
        times = times[~dropped]
    if "steps" in kind:
        one, other = map(int, kind.removeprefix("steps ").split(", "))
        times = times[np.isin(np.arange(len(times)) % (one + other), (0, one))]
    within: Times = times[times <= end_s]
    return within


def _records_of(case: Case, rate: float, times: Times) -> list[FrameRecord]:
    """Run one detector on one disk, shown at these times."""
    name, model = case
    height = 600 if model == "opplod_reference" and name.startswith("paper") else 240
    params = parameters_of(model)
    if height == 600:
        params = params.replaced(receptive_field=200)
    return list(analyse(_ShownAt(_disk(name)[0], height, rate, times), [params], rmo=None))


def _result_of(case: Case, rate: float, times: Times) -> _Result:
    """Return the result of one detector on one disk."""
    records, (_, model) = _records_of(case, rate, times), case
    peak, peak_s = max(
        (response, -record.time_s)
        for record in records
        if (response := record[model].response) is not None
    )
    alarm_s = next((record.time_s for record in records if record[model].alarm), np.nan)
    return _Result(peak, -peak_s, alarm_s)


def _between_of(case: Case, rate: float, phase: float) -> float:
    """Return the largest response at the times of the frames if frames between are seen too."""
    end_s = _disk(case[0])[1]
    times = _frame_times(rate, "", phase, end_s)
    between = np.arange(0, end_s, 1 / FINEST)
    apart_s = np.abs(between[:, None] - times).min(axis=1)
    seen = np.sort(np.concatenate((times, between[apart_s > 0.5 / FINEST])))
    responses = [record[case[1]].response for record in _records_of(case, FINEST, seen)]
    at_frames = np.isin(seen, times)
    return max(
        response
        for response, at in zip(responses, at_frames, strict=True)
        if response is not None and at
    )


def _between(phases: int) -> Iterator[str]:
    """Yield a table of the peaks of :func:`_between_of`, as ratios to those at 30 frames/s."""
    disks = ("l/v 20 ms", "l/v 40 ms", "l/v 80 ms")
    yield f"| frames/s | detector | {' | '.join(disks)} |"
    yield "|---|---|" + "---|" * len(disks)
    for rate, model in product(COARSE, dict.fromkeys(model for _, model in CASES)):
        ratios = []
        for name in disks:
            case = name, model
            reference = np.mean([result.peak for result in _results_of(case, 30, "", phases)])
            found = [_between_of(case, rate, shift / phases) for shift in range(phases)]
            ratios.append(f"{np.mean(found) / reference:.2f}")
        yield f"| {rate} | {model} | {' | '.join(ratios)} |"


def _results_of(case: Case, rate: float, kind: str, phases: int) -> list[_Result]:
    """Return the results at all shifts of the first frame, and of all random draws."""
    count = phases if rate <= 60 or kind else 1
    draws = DRAWS if "dropped" in kind or "jittered" in kind else 1
    end_s = _disk(case[0])[1]
    return [
        _result_of(case, rate, _frame_times(rate, kind, shift / count, end_s, draw))
        for shift, draw in product(range(count), range(draws))
    ]


def _measured_case(phases: int, case: Case) -> Table:
    at_30 = _Result(*np.mean(_results_of(case, 30, "", phases), axis=0))
    table: Table = {}
    for rate, kind in [*((rate, "") for rate in RATES), *UNEVEN]:
        here = np.array(_results_of(case, rate, kind, phases))
        ratios = here[:, 0] / (at_30.peak or np.nan)  # D-LGMD misses slow disks at every rate
        peak_late_s, alarm_late_s = (here[:, 1:] - at_30[1:]).T
        late = alarm_late_s[np.isfinite(alarm_late_s)]
        table[case, rate, kind] = _Compared(
            ratios.mean(), ratios.min(), ratios.max(), peak_late_s.mean(),
            late.mean() if len(late) else np.nan, len(here) - len(late), len(here),
        )  # fmt: skip
    return table


def _measured(phases: int, cases: tuple[Case, ...] = CASES) -> Table:
    """Compare each case at each rate with the mean of the case at 30 frames/s."""
    table: Table = {}
    measured = partial(_measured_case, phases)
    for of_case in results(measured, cases, cores(), named=str):
        table |= of_case
    for (case, rate, kind), values in table.items():
        print(*case, rate, kind, np.round(values, 3).tolist())
    return table


def _markdown(table: Table) -> Iterator[str]:
    """Yield the table of the page: the smallest and the largest mean over the stimuli."""
    detectors = list(dict.fromkeys(model for (_, model), _, _ in table))
    yield f"| frames/s | {' | '.join(f'{name}: peak | alarm (s)' for name in detectors)} |"
    yield "|---" * (1 + 2 * len(detectors)) + "|"
    for rate, kind in dict.fromkeys(key[1:] for key in table):
        cells = []
        for detector in detectors:
            rows = {
                c: v for (c, *how), v in table.items() if (c[1], *how) == (detector, rate, kind)
            }
            peaks = [row.peak for row in rows.values() if np.isfinite(row.peak)]
            cells.append(f"{min(peaks):.2f} to {max(peaks):.2f}")
            # A disk that the detector misses at every rate does not count as one without an alarm.
            detected = [row for case, row in rows.items() if not table[case, 30, ""].without]
            late = [round(row.alarm_late_s, 3) + 0.0 for row in detected if row.without < row.runs]
            alarms = f"{min(late):+.3f} to {max(late):+.3f}" if late else "none"
            if late and (without := sum(row.without for row in detected)):
                alarms += f", none in {without} of {sum(row.runs for row in detected)}"
            cells.append(alarms)
        yield f"| {rate:g} {kind} | {' | '.join(cells)} |"


def _controls() -> Iterator[str]:
    """Yield the largest response to controls over that to the disk of l/v 40 ms, and alarms."""
    protocols = [protocol for name in CONTROLS for protocol in load_all(name)]
    for model, rate in product(("opplod", "opplod_reference"), (30, 120, 240)):
        disk = "l/v 40 ms"
        times = _frame_times(rate, "", 0, _disk(disk)[1])
        looming = _result_of((disk, model), rate, times).peak
        for protocol in protocols:
            end_s = float(protocol.frame_count / protocol.display.frame_rate)
            video = _ShownAt(protocol, 240, rate, _frame_times(rate, "", 0, end_s))
            records = list(analyse(video, [model], rmo=None))
            peak = max(record[model].response or 0.0 for record in records)
            alarm = "yes" if any(record[model].alarm for record in records) else "no"
            share = peak / looming
            yield f"{model} {rate} {protocol.name}: {share:.4f} of the disk, alarm {alarm}"


class _Shown:
    """Every nth frame of an open video, seen by a camera that jerks or has noise.

    The picture of each frame is displaced by whole pixels of the working frame, with the standard
    deviation `jerk_px` across and down, and with no relation to the frame before. The edges of the
    frame mirror the picture. `noise` is a standard deviation, in luminance.
    """

    def __init__(self, video: FrameSource, every: int, jerk_px: float, noise: float) -> None:
        rate = video.facts.frame_rate
        self.facts = replace(video.facts, frame_rate=rate / every if rate else None)
        self.working, self._video = video.working, video
        self._every, self._jerk_px, self._noise = every, jerk_px, noise

    def __iter__(self) -> Iterator[Frame]:
        random = np.random.default_rng(1)
        for frame in self._video:
            if frame.index % self._every == 0:
                x, y = np.rint(random.normal(0, self._jerk_px, 2))
                moved = cv2.warpAffine(
                    frame.luma,
                    np.array([[1, 0, x], [0, 1, y]]),
                    frame.luma.shape[::-1],
                    flags=cv2.INTER_NEAREST,
                    borderMode=cv2.BORDER_REFLECT,
                )
                if self._noise:
                    moved = np.clip(moved + random.normal(0, self._noise, moved.shape), 0, 1)
                index = frame.index // self._every
                yield replace(frame, index=index, luma=np.asarray(moved, np.float32))


def _seen(
    entry: ClipEntry, detector: EvaluatedDetector, every: int, jerk_px: float, noise: float
) -> Clip:
    """Run a detector over a labelled clip, as `_Shown` shows it."""
    height = detector.height if isinstance(detector.height, int) else WORKING_HEIGHT
    with open_video(cast("Path", entry.path), height=height) as video:
        times, outputs = outputs_of(_Shown(video, every, jerk_px, noise), [detector])
        facts = video.facts
    label = entry.label
    if label.onset is not None and label.contact is not None:
        contact = min(label.contact // every, len(times) - 1)
        label = replace(label, onset=label.onset // every, contact=contact)
    return Clip(label, times, facts.width, facts.height, outputs)


def _on_clips(manifest: Path) -> Iterator[str]:
    """Yield the table of alarms on labelled clips: fewer frames, jerks, noise."""
    measures = "detected | lead (s) | false alarms per minute"
    yield f"| shown | jerks (px) | noise | detector | {measures} |"
    yield "|---|---|---|---|---|---|---|"
    names = "opplod", "opplod_reference", "dlgmd", "flow_divergence"
    jerks, noises = ((1, px, 0.0) for px in (1, 2, 5)), ((1, 0, share) for share in (0.02, 0.05))
    for every, jerk_px, noise in ((1, 0, 0.0), (2, 0, 0.0), (3, 0, 0.0), *jerks, *noises):
        for detector in evaluated_detectors(names):
            entries = read_manifest(manifest).entries
            clips = [_seen(entry, detector, every, jerk_px, noise) for entry in entries]
            draws = draws_of([clip.label.looming for clip in clips], 1)
            found = shipped(clips, detector.name, draws).outcomes
            minutes = math.fsum(clip.seconds(*clip.quiet) for clip in clips) / 60
            lead = f"{np.nanmedian(found.lead_s):.2f}" if np.nansum(found.detected) else ""
            yield (
                f"| 1 of {every} | {jerk_px} | {noise} | {detector.name} | "
                f"{np.nansum(found.detected):.0f} of "
                f"{np.isfinite(found.detected).sum()} | {lead} | "
                f"{np.nansum(found.false_alarms) / minutes:.2f} |"
            )


def main() -> None:
    """Measure, and print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--phases", type=int, default=12, help="shifts (12)")
    parser.add_argument("--model", metavar="NAME", help="only this detector")
    parser.add_argument("--between", action="store_true", help="frames between are seen too")
    parser.add_argument("--controls", action="store_true", help="controls at 30 to 240 frames/s")
    parser.add_argument("--clips", type=Path, metavar="MANIFEST.csv", help="labelled clips")
    arguments = parser.parse_args()
    if arguments.clips:
        lines = _on_clips(arguments.clips)
    elif arguments.controls:
        lines = _controls()
    elif arguments.between:
        lines = _between(arguments.phases)
    else:
        model = arguments.model
        cases = tuple((name, model) for name in DISKS) if model else CASES
        lines = _markdown(_measured(arguments.phases, cases))
    for line in lines:
        print(line, flush=True)


if __name__ == "__main__":
    main()
