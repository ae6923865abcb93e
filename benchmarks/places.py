"""Measure the places of looming objects: the figures of ``docs/places.md``.

    python -m benchmarks.places                  # on stimuli: focus, box, time to contact
    python -m benchmarks.places --rates          # time to contact at low frame rates
    python -m benchmarks.places --clips FOLDER   # on labelled clips: winning unit and box
    python -m benchmarks.places --roll           # staged approaches seen by a camera that rolls
    python -m benchmarks.places --vibration      # the same, a rolling shutter that vibrates
    python -m benchmarks.places --flicker        # the same, a rolling shutter in flickering light
    python -m benchmarks.places --arrival        # the same, frames with times of arrival
    python -m benchmarks.places --cost FOLDER    # processor time

All but the last use the units alone, `opplod_reference`, or ``--model NAME``. FOLDER holds
``manifest.csv`` and ``boxes.json`` as for ``oppload evaluate``.
"""  # fmt: skip

from __future__ import annotations

import argparse
import math
import statistics
import time
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import cv2
import numpy as np

from oppload_cli import FrameRecord, Opplod, PlaceParams, analyse, open_video, stimulus
from oppload_cli.detection.places import Detection, Places
from oppload_cli.evaluation.manifest import ClipEntry, read_manifest, with_boxes
from oppload_cli.evaluation.metrics.measures import overlap
from oppload_cli.motion.flow import DenseFlow
from oppload_cli.pipeline.sources import StimulusVideo
from oppload_cli.stimulus.truth import ObjectTruth, contact_time, frame_truth
from oppload_cli.video.arrivals import Arrivals

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from numpy.typing import NDArray

    from oppload_cli.models.detector import Box, Response
    from oppload_cli.stimulus.protocol import Protocol
    from oppload_cli.video.source import Video

LAST_S = 0.5  # time before contact in which times to contact are compared
NEAR_CONTACT = 15  # frames
LOOM = "klapoetke2017/loom-l-over-v"
L_OVER_V = "disk.growth.l_over_v_ms"
STAGED = "staged/collision"
RATE = 30  # of the staged approaches, in frames/s
PAIRS = -1  # stands for frames that arrive two at a time
FINE_RATE = 120  # frames/s of the pictures of which cameras take some
LOW_RATES = range(10, 16)  # frames/s
ROLLS = 0, 15, 30, 60, 120  # deg/s
VIBRATIONS = 0, 0.25, 0.5, 1, 2, 4  # amplitudes in px of 240 rows
DELAYS = 0.003, 0.01, 0.03  # largest delay in s of a frame on its way
DEPTHS = 0, 0.05, 0.1, 0.2, 0.3  # of flicker, from its darkest to its brightest moment
# READOUT_S is the time from the first row of a rolling shutter to the last.
VIBRATION_HZ, FLICKER_HZ, READOUT_S = 37, 100, 0.02
ASIDE = {"disk.centre_deg": [12, -9], "disk.growth.most_deg": 40}
HEAD = (
    "| {} | with an alarm | lead | given | median error | within 20 % |\n|---|---|---|---|---|---|"
)
CONDITIONS: list[tuple[str, str, dict[str, Any]]] = [
    *((f"disk, l/v {ms} ms", LOOM, {L_OVER_V: ms}) for ms in (20, 30, 40, 60, 80, 100)),
    *((f"aside, l/v {ms} ms", LOOM, {L_OVER_V: ms, **ASIDE}) for ms in (20, 40, 60, 100)),
    *((f"bright, l/v {ms} ms", "klapoetke2017/loom-bright", {L_OVER_V: ms}) for ms in (40, 100)),
    *(
        (f"texture at rest, l/v {ms} ms", "controls/looming-on-static-texture", {L_OVER_V: ms})
        for ms in (30, 60, 100)
    ),
    ("texture that zooms, l/v 60 ms", "controls/looming-on-zooming-texture", {}),
    ("texture that moves, l/v 60 ms", "controls/looming-on-moving-texture", {}),
    ("perspective, 60 frames/s", "controls/looming-perspective", {}),
    ("motion blur", "controls/looming-motion-blur", {"effects.shutter": 0.5}),
    ("contrast 0.15", "controls/looming-contrast", {"disk.luminance": 0.35}),
    ("noise 0.05", "controls/looming-noise", {"effects.noise": 0.05}),
    ("camera shake", "controls/looming-with-shake", {}),
    ("two disks", "controls/two-looming-disks", {}),
    ("square, upright", "controls/looming-square", {"square.axis_deg": 0}),
    ("square, on its corner", "controls/looming-square", {"square.axis_deg": 45}),
]


@dataclass
class Measured:
    """The detections of one stimulus: relative errors, and distances in stimulus pixels."""

    frames: int = 0
    errors: list[float] = field(default_factory=list)
    certain: list[bool] = field(default_factory=list)  # the true time is within twice the error
    focus: list[float] = field(default_factory=list)
    size: list[float] = field(default_factory=list)
    identities: set[int] = field(default_factory=set)

    def row(self, name: str) -> str:
        """Return a line of the table."""
        errors = [abs(error) for error in self.errors]
        cells = [
            name,
            f"{len(errors)} of {self.frames}",
            _percent(errors, statistics.median),
            _percent(errors, max),
            f"{statistics.median(self.focus):.1f}" if self.focus else "",
            _percent(self.size, statistics.median, "+"),
            str(len(self.identities)) if self.identities else "",
        ]
        return f"| {' | '.join(cells)} |"


def measured(protocol: Protocol, model: str) -> Measured:
    """Show a stimulus to a detector, and compare every detection with the ground truth."""
    result = Measured()
    video = cast("Video", StimulusVideo(protocol, 240))
    for record in analyse(video, [model], rmo=None):
        result.identities |= {seen.identity for seen in record.detections}
        for truth in frame_truth(protocol, record.frame).objects:
            if truth.time_to_contact_s and truth.looming:  # until it has its largest size
                _compare(result, protocol, truth, record.detections)
    return result


def _compare(
    result: Measured, protocol: Protocol, truth: ObjectTruth, detections: tuple[Detection, ...]
) -> None:
    """Add the detection that is nearest to an object, if its focus lies within the object."""

    def distance(seen: Detection) -> float:
        return math.hypot(seen.centre_x - truth.centre_x_px, seen.centre_y - truth.centre_y_px)

    radius, time_s = _radius(protocol, truth), truth.time_to_contact_s or math.inf
    nearest = min(detections, key=distance, default=None)
    last = time_s <= LAST_S + 1e-9
    result.frames += last
    if nearest is None or distance(nearest) > radius:
        return
    result.focus.append(distance(nearest))
    result.size.append(math.sqrt(nearest.box.width * nearest.box.height) / 2 / radius - 1)
    if last and nearest.time_to_contact_s is not None:
        result.errors.append(nearest.time_to_contact_s / time_s - 1)
        error_s = abs(nearest.time_to_contact_s - time_s)
        result.certain.append(error_s <= 2 * (nearest.time_to_contact_error_s or 0))


def _radius(protocol: Protocol, truth: ObjectTruth) -> float:
    """Return half the size of an object in stimulus pixels."""
    half, scale = (truth.angular_size_deg or 0) / 2, protocol.display.scale
    if protocol.display.projection == "perspective":
        return scale * 180 / math.pi * math.tan(math.radians(half))
    return scale * half


def _percent(values: Sequence[float], of: Any, sign: str = "") -> str:
    return f"{100 * of(values):{sign}.0f} %" if values else ""


def _contact_table(model: str) -> Iterator[str]:
    """Yield the table of the stimuli; the last row is that of all stimuli together."""
    yield "| stimulus | given | median error | largest | focus, px | size | numbers |"
    yield "|---|---|---|---|---|---|---|"
    everything = Measured()
    for name, protocol, settings in CONDITIONS:
        result = measured(stimulus.load_all(protocol, settings)[0], model)
        yield result.row(name)
        everything.frames += result.frames
        everything.errors += result.errors
        everything.certain += result.certain
        everything.focus += result.focus
        everything.size += result.size
    yield everything.row("**all**")
    within, count = sum(everything.certain), len(everything.certain)
    yield f"true time within twice the error: {within} of {count}"


def _rate_table(model: str) -> Iterator[str]:
    """Yield the table of looming disks at low frame rates; errors have a sign."""
    yield "| l/v, ms | given | median error | true time within twice the error |"
    yield "|---|---|---|---|"
    for l_over_v in (20, 40, 60, 80, 100):
        found = Measured()
        for rate in LOW_RATES:
            settings = {L_OVER_V: l_over_v, "display.frame_rate": rate}
            one = measured(stimulus.load_all(LOOM, settings)[0], model)
            found.frames += one.frames
            found.errors += one.errors
            found.certain += one.certain
        error, within = _percent(found.errors, statistics.median, "+"), sum(found.certain)
        yield f"| {l_over_v} | {len(found.errors)} of {found.frames} | {error} | {within} |"


def _rolled(frames: Sequence[NDArray[np.float32]], roll: float) -> NDArray[np.float32]:
    """Show frames as a camera sees them that rolls about its axis by `roll` degrees per second."""
    height, width = frames[0].shape
    middle = (width - 1) / 2, (height - 1) / 2
    turned = [
        cv2.warpAffine(
            frame,
            cv2.getRotationMatrix2D(middle, roll * number / RATE, 1),
            (width, height),
            borderMode=cv2.BORDER_REFLECT,
        )
        for number, frame in enumerate(frames)
    ]
    return np.clip(np.array(turned, np.float32), 0, 1)


def _vibrating(frames: Sequence[NDArray[np.float32]], amplitude: float) -> NDArray[np.float32]:
    """Show frames as a rolling shutter sees them that vibrates by `amplitude` px in both axes."""
    y, x = np.mgrid[: frames[0].shape[0], : frames[0].shape[1]].astype(np.float32)
    shown = []
    for number, frame in enumerate(frames):
        phase = 2 * np.pi * VIBRATION_HZ * (number / RATE + y / len(y) * READOUT_S)
        column, row = x + amplitude * np.sin(phase), y + amplitude * np.cos(phase + 1)
        shown.append(cv2.remap(frame, column, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT))
    return np.clip(np.array(shown, np.float32), 0, 1)


def _banded(frames: Sequence[NDArray[np.float32]], depth: float) -> NDArray[np.float32]:
    """Show frames as a rolling shutter sees them in light that flickers by `depth` of its value."""
    shown = np.array(frames, np.float32)
    row_s = np.arange(shown.shape[1]) / shown.shape[1] * READOUT_S
    phase = 2 * np.pi * FLICKER_HZ * (np.arange(len(shown))[:, None] / RATE + row_s)
    shown *= (1 - depth * (1 + np.sin(phase)) / 2)[:, :, None]
    return shown


@dataclass
class _Approaches:
    """The alarms and times to contact of several approaches."""

    count: int = 0
    frames: int = 0  # in the last half second
    leads: list[float] = field(default_factory=list)
    errors: list[float] = field(default_factory=list)

    def add(
        self,
        contact_s: float,
        taken: list[float],
        shown: NDArray[np.float32],
        times: list[float],
        model: str,
    ) -> None:
        """Analyse an approach whose frames were `taken` at other times than the stated `times`."""
        self.count += 1
        records = analyse(shown, [model], times=times, rmo=False)
        alarm = False
        for time_s, record in zip(taken, records, strict=True):
            left_s = contact_s - time_s
            if record[model].alarm and not alarm:
                alarm = True
                self.leads += [left_s] if left_s > 0 else []
            if 0 < left_s <= LAST_S:
                self.frames += 1
                found = record[model].object
                if found and found.time_to_contact_s:
                    self.errors.append(abs(found.time_to_contact_s / left_s - 1))

    def row(self, name: str) -> str:
        """Return a line of the table."""
        cells = [
            name,
            f"{len(self.leads)} of {self.count}",
            f"{statistics.median(self.leads):.2f} s" if self.leads else "",
            f"{len(self.errors)} of {self.frames}",
            f"{100 * statistics.median(self.errors):.1f} %" if self.errors else "",
            f"{sum(error <= 0.2 for error in self.errors)}",
        ]
        return f"| {' | '.join(cells)} |"


def _view_table(
    title: str,
    view: Callable[[Sequence[NDArray[np.float32]], float], NDArray[np.float32]],
    sizes: Sequence[float],
    model: str,
) -> Iterator[str]:
    """Yield the table of staged approaches seen by a camera with a disturbance of several sizes."""
    approaches = []
    for protocol in stimulus.load_all(STAGED)[::3]:
        video = StimulusVideo(protocol, 240)
        approaches.append((contact_time(protocol) or 0.0, [frame.luma for frame in video]))
    yield HEAD.format(title)
    for size in sizes:
        row = _Approaches()
        for contact_s, frames in approaches:
            times = [number / RATE for number in range(len(frames))]
            row.add(contact_s, times, view(frames, size), times, model)
        yield row.row(str(size))


def _cameras(count: int) -> dict[str, tuple[NDArray[np.int64], float]]:
    """Return which of `count` pictures at `FINE_RATE` a camera takes, and how late they arrive."""
    rng, every = np.random.default_rng(0), np.arange(0, count, FINE_RATE // RATE)
    middle, half_s = every[len(every) // 2], FINE_RATE // 2
    uneven = np.cumsum(rng.integers(3, 7, count))
    irregular = {
        "a tenth lost": every[rng.random(len(every)) >= 0.1],
        "half the rate from the middle on": every[(every < middle) | (every % 8 == 0)],
        "1 s lost in the middle": every[abs(every - middle) > half_s],
        "steps of 25 to 50 ms": uneven[uneven < count],
    }
    return {
        "no delays": (every, 0),
        **{f"delays up to {1000 * delay:g} ms": (every, delay) for delay in DELAYS},
        "two at a time": (every, PAIRS),
        "15 frames/s, up to 30 ms": (every[::2], 0.03),
        "60 frames/s, up to 30 ms": (np.arange(0, count, FINE_RATE // 60), 0.03),
        **{name: (taken, 0) for name, taken in irregular.items()},
        **{f"{name}, up to 10 ms": (taken, 0.01) for name, taken in irregular.items()},
    }


def _arrivals(taken: NDArray[np.float64], delay: float) -> NDArray[np.float64]:
    """Return the times at which frames arrive with delays of up to `delay` s, or in pairs."""
    number = np.arange(len(taken))
    if delay == PAIRS:
        return taken[number // 2 * 2] + number % 2 * 0.002
    late = np.random.default_rng(0).uniform(0, delay, len(taken))
    # No frame overtakes another.
    return np.asarray(np.maximum.accumulate(taken + late) + number * 1e-6)


def _arrival_table(model: str) -> Iterator[str]:
    """Yield the table of staged approaches: times of arrival, as they are and smoothed."""
    found: dict[tuple[str, str], _Approaches] = {}
    for protocol in stimulus.load_all(STAGED, {"display.frame_rate": FINE_RATE})[::3]:
        contact_s = contact_time(protocol) or 0.0
        pictures = [frame.luma for frame in StimulusVideo(protocol, 240)]
        for name, (indices, delay) in _cameras(len(pictures)).items():
            shown, taken = np.array([pictures[index] for index in indices]), indices / FINE_RATE
            arrived, clock = _arrivals(taken, delay).tolist(), Arrivals()
            for kind, times in (
                ("", arrived),
                ("smoothed", [clock.step(time_s) for time_s in arrived]),
            ):
                row = found.setdefault((name, kind), _Approaches())
                row.add(contact_s, taken.tolist(), shown, times, model)
    yield HEAD.format("times of arrival")
    for (name, kind), row in found.items():
        yield row.row(f"{name} {kind}")


def _localisation(folder: Path, model: str) -> Iterator[str]:
    """Yield the table of the clips: winning units within the labelled box, enlarged by half."""
    yield "| clip | labelled frames | every frame between | overlap of the box |"
    yield "|---|---|---|---|"
    labelled: list[list[bool]] = []
    every: list[list[bool]] = []
    overlaps: list[float] = []
    contacts: list[tuple[float, bool] | None] = []
    for entry in _entries(folder):
        name, contact, boxes = entry.label.name, entry.label.contact, entry.label.boxes
        if contact is None or not boxes:
            continue
        near = _between(boxes, contact)
        with open_video(cast("Path", entry.path), height=240) as video:
            records = list(analyse(video, [model], rmo=None))
        inside = {
            frame: _is_inside(records[frame][model].answer, box) for frame, box in near.items()
        }
        labelled.append([inside[frame] for frame in boxes if frame in inside])
        every.append(list(inside.values()))
        own = [
            overlap(records[frame].detections[0].box, box)
            for frame, box in near.items()
            if records[frame].detections
        ]
        overlaps += own
        contacts += _contacts(records, contact)
        yield _clip_row(name, labelled[-1], every[-1], own)
    yield _clip_row("**all**", list(chain(*labelled)), list(chain(*every)), overlaps)
    low, high = _interval(labelled)
    yield f"95 % interval of the labelled frames: {100 * low:.0f} to {100 * high:.0f} %"
    known = [contact for contact in contacts if contact is not None]
    yield f"time to contact given in {len(known)} of {len(contacts)} frames with a detection"
    if known:
        seconds = [late_s for late_s, _ in known]
        low, high, middle = min(seconds), max(seconds), statistics.median(seconds)
        yield f"contact later than labelled by {low:.2f} to {high:.2f} s, median {middle:.2f} s"
        within = sum(is_within for _, is_within in known)
        yield f"labelled time within twice the error: {within} of {len(known)}"


def _contacts(records: Sequence[FrameRecord], contact: int) -> list[tuple[float, bool] | None]:
    """Compare the predicted with the labelled contact, in each frame shortly before the contact.

    The first value is the predicted minus the labelled time of contact of the first detection; the
    second one tells whether it is within twice its error. None stands for an unknown time.
    """
    contacts: list[tuple[float, bool] | None] = []
    for record in records[max(0, contact - NEAR_CONTACT) : contact]:
        for first in record.detections[:1]:
            if first.time_to_contact_s is None:
                contacts.append(None)
                continue
            late_s = record.time_s + first.time_to_contact_s - records[contact].time_s
            contacts.append((late_s, abs(late_s) <= 2 * (first.time_to_contact_error_s or 0)))
    return contacts


def _cost(folder: Path) -> Iterator[str]:
    """Yield the processor time of the search for objects per frame, in microseconds."""
    yield "| clip | mean per frame, us | over decoding and OppLoD |"
    yield "|---|---|---|"
    every: list[tuple[float, float, int]] = []
    for entry in _entries(folder):
        with open_video(cast("Path", entry.path), height=240) as video:
            model = Opplod(video.working.shape)
            places, search = Places(PlaceParams().of(Opplod.least_object)), DenseFlow()
            frames, searched, started = 0, 0.0, time.process_time()
            for frame in video:
                flow = search.step(frame.luma, frame.time_s)
                model.layers.flow().give(flow)
                if model.step(frame.luma):
                    before = time.thread_time()  # without the decoder's threads
                    places.step(model.units, flow, frame.time_s)
                    searched += time.thread_time() - before
                    frames += 1
            every.append((searched, time.process_time() - started, frames))
        yield _cost_row(entry.label.name, every[-1:])
    yield _cost_row("**all**", every)


def _cost_row(name: str, times: list[tuple[float, float, int]]) -> str:
    searched, total, frames = (sum(column) for column in zip(*times, strict=True))
    share = 100 * searched / (total - searched)
    return f"| {name} | {1e6 * searched / frames:.0f} | {share:.1f} % |"


def _entries(folder: Path) -> list[ClipEntry]:
    return with_boxes(read_manifest(folder / "manifest.csv")).entries


def _between(labels: dict[int, Box], contact: int) -> dict[int, list[float]]:
    """Interpolate the boxes of the frames near contact from the labelled ones."""
    known = sorted(labels)
    sides = list(zip(*(labels[frame] for frame in known), strict=True))
    return {
        frame: [float(np.interp(frame, known, side)) for side in sides]
        for frame in range(known[0], known[-1] + 1)
        if abs(frame - contact) <= NEAR_CONTACT
    }


def _clip_row(name: str, labelled: list[bool], every: list[bool], overlaps: list[float]) -> str:
    shares = [
        f"{sum(inside)} of {len(inside)} ({_percent(inside, statistics.mean)})"
        for inside in (labelled, every)
    ]
    overlap = f"{statistics.median(overlaps):.2f} ({len(overlaps)})" if overlaps else ""
    return f"| {name} | {shares[0]} | {shares[1]} | {overlap} |"


def _is_inside(response: Response | None, box: list[float]) -> bool:
    """Return whether the centre of the winning unit lies in a box that is enlarged by half."""
    if response is None or response.box is None:
        return False
    (x, y), (left, top, width, height) = response.box.centre, box
    away_x, away_y = abs(x - left - width / 2), abs(y - top - height / 2)
    return away_x <= 0.75 * width and away_y <= 0.75 * height


def _interval(clips: list[list[bool]]) -> tuple[float, float]:
    """Return the 95 % interval of the share of frames inside, by a bootstrap over clips."""
    rng = np.random.default_rng(0)
    counts = np.array([[sum(inside), len(inside)] for inside in clips])
    drawn = counts[rng.integers(0, len(counts), (2000, len(counts)))].sum(axis=1)
    low, high = np.quantile(drawn[:, 0] / drawn[:, 1], [0.025, 0.975])
    return float(low), float(high)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--clips", type=Path, metavar="FOLDER", help="labelled clips")
    parser.add_argument("--rates", action="store_true", help="low frame rates")
    parser.add_argument("--roll", action="store_true", help="a camera that rolls")
    parser.add_argument("--vibration", action="store_true", help="a camera that vibrates")
    parser.add_argument("--flicker", action="store_true", help="light that flickers")
    parser.add_argument("--arrival", action="store_true", help="times of arrival")
    parser.add_argument("--cost", type=Path, metavar="FOLDER", help="processor time")
    parser.add_argument(
        "--model", default="opplod_reference", metavar="NAME", help="detector (opplod_reference)"
    )
    arguments = parser.parse_args()
    if arguments.clips:
        table = _localisation(arguments.clips, arguments.model)
    elif arguments.rates:
        table = _rate_table(arguments.model)
    elif arguments.roll:
        table = _view_table("roll, deg/s", _rolled, ROLLS, arguments.model)
    elif arguments.vibration:
        table = _view_table("amplitude, px", _vibrating, VIBRATIONS, arguments.model)
    elif arguments.flicker:
        table = _view_table("depth", _banded, DEPTHS, arguments.model)
    elif arguments.arrival:
        table = _arrival_table(arguments.model)
    elif arguments.cost:
        table = _cost(arguments.cost)
    else:
        table = _contact_table(arguments.model)
    for line in table:
        print(line, flush=True)


if __name__ == "__main__":
    main()
