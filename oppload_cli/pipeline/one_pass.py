"""One pass of the detectors over a video: the way of a frame to its record."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

from oppload_cli.detection.alarm import Alarm, Cuts
from oppload_cli.detection.places import Detections
from oppload_cli.models.bank import DetectorBank
from oppload_cli.models.detector import Box
from oppload_cli.models.registry import detector_of
from oppload_cli.models.timebase import ROUNDING, ROUNDING_S
from oppload_cli.motion.flow import DenseFlow, Flow, Interpolation, rmo_of
from oppload_cli.motion.rmo import RmoMetrics
from oppload_cli.pipeline.repeats import EXACT, Repeat
from oppload_cli.results.table import FrameRecord
from oppload_cli.video.frames import FrameTimes

if TYPE_CHECKING:
    from collections.abc import Sequence
    from fractions import Fraction

    from oppload_cli.detection.alarm import AlarmParams
    from oppload_cli.detection.contact import PlaceParams
    from oppload_cli.detection.places import Detection
    from oppload_cli.models.detector import Response
    from oppload_cli.models.dpc import Map
    from oppload_cli.models.timebase import TimeParams
    from oppload_cli.motion.rmo import RmoParams
    from oppload_cli.pipeline.repeats import Repeats
    from oppload_cli.schema import Parameters
    from oppload_cli.video.frames import Frame, InputFacts, WorkingSize
    from oppload_cli.video.optics import Optics

# A cadence that the first 0.6 s prove, or those after a still start, counts from their first frame
# on. For this their frames are kept, but not more than 64 MB.
_FIRST_S, _FIRST_BYTES = 0.6, 1 << 26


class PassParams(NamedTuple):
    """The parameters of one pass."""

    params: Sequence[Parameters]  # one set for each detector
    alarm: AlarmParams
    places: PlaceParams | None  # None: looming objects are not looked for
    time: TimeParams  # auto: each detector has its own time base
    rmo: RmoParams | None  # None: RMO is not measured
    repeats: Repeats  # recognises the repeats of this pass

    @property
    def needs_flow(self) -> bool:
        """Whether RMO, a detector's objects or pictures in between need the flow of each frame."""
        kinds = map(detector_of, self.params)
        return self.rmo is not None or any(kind.places or kind.interpolates for kind in kinds)


class Prepared(NamedTuple):
    """A frame with its corrected time, whether it is a repeat, and its motion."""

    frame: Frame
    repeat: Repeat
    flow: Flow | None  # None for the first picture and for repeats
    rmo: RmoMetrics | None
    # Whether it is not known yet if the frames before, all equal, were repeats or a scene at rest.
    undecided: bool = False
    # All frames before this one, if their repeats are now better known: the detectors begin again.
    again: Sequence[Prepared] = ()


class Preparation:
    """The work on a frame before the detectors: its time, repeats and flow."""

    def __init__(self, chosen: PassParams, rate: Fraction | None) -> None:
        self.times, self.repeats = FrameTimes(rate), chosen.repeats
        per_second = chosen.time.per_second
        self._flow = DenseFlow(1 / per_second if per_second else 0) if chosen.needs_flow else None
        self._rmo = chosen.rmo
        # The first frames of the video, until a cadence is known or there are too many.
        self._first: list[Prepared] | None = []

    def step(self, frame: Frame) -> Prepared:
        """Take the next frame."""
        # An open video has corrected its times already; the times from a caller may be wrong.
        time_s = self.times.step(frame.time_s)
        if time_s != frame.time_s:
            frame = replace(frame, time_s=time_s)
        repeat = self.repeats.step(frame.luma, time_s)
        prepared = self._prepared(frame, repeat)
        return prepared if self._first is None else self._with_first_frames(self._first, prepared)

    def _prepared(self, frame: Frame, repeat: Repeat) -> Prepared:
        """Return a frame with its motion."""
        taken_s = frame.time_s + repeat.shift_s
        if repeat.kind or not self._flow:
            if self._flow and not repeat.passed_over:
                self._flow.stand_still(taken_s)
            return Prepared(frame, repeat, None, RmoMetrics() if self._rmo else None)
        flow = self._flow.step(frame.luma, taken_s)
        rmo = rmo_of(flow, self._rmo) if flow and self._rmo else None
        return Prepared(frame, repeat, flow, rmo)

    def _with_first_frames(self, first: list[Prepared], latest: Prepared) -> Prepared:
        """Return the latest frame, and those before too if their repeats are better known now."""
        still = latest.repeat.kind == EXACT and not latest.repeat.passed_over
        if still and all(each.repeat.kind == EXACT for each in first[1:]):
            first.clear()  # the video begins at rest: the frames count from the last one at rest
        first.append(latest)
        seconds = latest.frame.time_s - first[0].frame.time_s
        if seconds > _FIRST_S + ROUNDING_S or len(first) * latest.frame.luma.nbytes > _FIRST_BYTES:
            self._first = None
            return latest
        if self.repeats.is_cadence:
            self._first = None
            found = self.repeats.again([(each.frame.luma, each.frame.time_s) for each in first])
            if self._flow:
                self._flow.reset()
            *again, latest = (
                self._prepared(seen.frame, repeat)
                for seen, repeat in zip(first, found, strict=True)
            )
            return latest._replace(again=again)
        # p: a picture that the detectors got; r: a frame that was taken for a repeat of it.
        pattern = "".join("r" if each.repeat.passed_over else "p" for each in first)
        if re.fullmatch("pr+p", pattern):
            return latest._replace(undecided=True)
        if re.fullmatch("pr+pp", pattern) and not self.repeats.in_run:
            # No repeat follows the second picture: the first was not repeated, but stood still.
            self.repeats.forget_cadence()
            again = [e._replace(repeat=e.repeat._replace(passed_over=False)) for e in first[:-1]]
            return latest._replace(again=again)
        return latest


class DetectorPass:
    """The detectors over one video, with their alarms and the places of looming objects."""

    def __init__(
        self,
        working: WorkingSize,
        others: Sequence[WorkingSize],
        facts: InputFacts,
        chosen: PassParams,
        optics: Optics | None,
    ) -> None:
        self._working, self._facts, self._chosen, self._optics = working, facts, chosen, optics
        self._sizes = {
            kind.name: next((size for size in others if _is_of(size, kind.height)), working)
            for kind in map(detector_of, chosen.params)
        }
        self._begin()

    def _begin(self) -> None:
        working, chosen = self._working, self._chosen
        places, time = chosen.places, chosen.time
        rate = self._facts.frame_rate
        stated = float(rate) if rate else None
        self._count = 0  # number of frames since the detectors began
        shapes = {name: size.shape for name, size in self._sizes.items()}
        self._bank = DetectorBank(working.shape, chosen.params, stated, time, shapes)
        self._per_second = time.per_second
        self._first_s = 0.0
        self._cuts = Cuts(chosen.alarm)
        self._alarms = {name: Alarm(name, chosen.alarm) for name in self._bank.detectors}
        detectors = self._bank.detectors.values()
        interpolates = {detector.shape for detector in detectors if detector.interpolates}
        self._interpolations = {shape: Interpolation() for shape in interpolates}
        self._latest: FrameRecord | None = None  # the row that a repeat in a cadence repeats
        self._index = -1  # number of the frame before
        # Of the latest frame that the detectors saw: when it was presented, and its picture taken.
        self._before_s = self._taken_s = 0.0
        self._too_slow = False  # whether a frame after that one was dropped
        self._passed_over_s: list[float] = []  # times of the frames after that one
        self._places = {
            name: Detections(self._sizes[name], places.of(detector.least_object))
            for name, detector in self._bank.detectors.items()
            if detector.places and places
        }

    def step(self, prepared: Prepared) -> FrameRecord:
        """Take the next frame."""
        if prepared.again:
            responded = self._bank.responded
            self._begin()
            self._bank.responded = responded
            for each in prepared.again:
                self.step(each)
        time_s, repeat = prepared.frame.time_s, prepared.repeat
        if not self._count:
            self._first_s = time_s
        elif self._facts.real_time and prepared.frame.index > self._index + 1:
            self._too_slow = True
        self._index = prepared.frame.index
        self._count += 1
        if repeat.held and self._latest is not None:
            return _held(self._latest, prepared)
        blind = "" if repeat.passed_over else self._see(prepared)
        responses = self._responses(prepared)
        objects, alarms = self._judged(responses, prepared, blind)
        thresholds = {name: alarm.threshold for name, alarm in self._alarms.items()}
        objects = {
            name: self._places[name].with_alarm(
                each, alarm=alarms[name], threshold=thresholds[name]
            )
            for name, each in objects.items()
        }
        self._latest = FrameRecord(
            frame=prepared.frame.index,
            time_s=time_s,
            luma_change=0.0 if repeat.kind else self._bank.luma_change,
            responses={
                name: _in_source(each, self._sizes[name]) for name, each in responses.items()
            },
            alarms=alarms,
            rmo=prepared.rmo,
            repeat=repeat.kind,
            thresholds=thresholds,
            detections=next(iter(objects.values()), ()),
            objects={name: each[0] if each else None for name, each in objects.items()},
            blind=blind,
            evidence={n: self._alarms[n].evidence for n, each in responses.items() if each},
        )
        return self._latest

    def _see(self, prepared: Prepared) -> str:
        """Show the detectors a frame, after all pictures before it that they have not seen.

        Return why the frame is blind; empty for a frame that counts.
        """
        (frame, repeat, flow), bank = prepared[:3], self._bank
        luma, taken_s = frame.luma, frame.time_s + repeat.shift_s
        if self._chosen.needs_flow:  # without it, detectors that use the flow measure it
            bank.give(None)
        if repeat.still_begins:
            # The frames that were passed over are no repeats: the detectors get them now.
            for passed_over_s in self._passed_over_s:
                bank.see(luma, passed_over_s)
                bank.respond(frame.lumas, passed_over_s)
                self._before_s = self._taken_s = passed_over_s
        stood_still = bool(self._passed_over_s)
        self._passed_over_s.clear()
        elapsed = (taken_s - self._taken_s) * (self._per_second or 0)
        if self._too_slow:  # pictures in between take time, so that one gap would lead to the next
            elapsed, self._too_slow = 0.0, False
        pictures = self._pictures_between(frame, elapsed, flow)
        if pictures:
            bank.separate()
        bank.see(luma, taken_s)
        change = 0.0 if repeat.kind else bank.luma_change
        blind = self._cuts.step(bank.photoreceptors, change, frame.time_s, stood_still=stood_still)
        times_s = (self._before_s, frame.time_s), (self._taken_s, taken_s)
        for share, lumas in pictures:
            shown_s, time_s = (then + share * (now - then) for then, now in times_s)
            responses = bank.respond(lumas, time_s, between=True)
            between = replace(frame, time_s=shown_s)
            shown = Prepared(between, Repeat(shift_s=time_s - shown_s), None, None)
            self._judged(responses, shown, blind)
        if self._chosen.needs_flow:
            bank.give(flow)
        self._before_s, self._taken_s = frame.time_s, taken_s
        return blind

    def _pictures_between(
        self, frame: Frame, elapsed: float, flow: Flow | None
    ) -> list[tuple[float, dict[tuple[int, int], Map]]]:
        """Return the pictures before a frame by their place in time, each at the needed sizes."""
        of_sizes: dict[float, dict[tuple[int, int], Map]] = {}
        for shape, interpolation in self._interpolations.items():
            scaled = flow and flow.scaled(shape[0] / self._working.height)
            for share, picture in interpolation.step(frame.lumas[shape], elapsed, scaled):
                of_sizes.setdefault(share, {})[shape] = picture
        return list(of_sizes.items())

    def _responses(self, prepared: Prepared) -> dict[str, Response | None]:
        """Return the responses to a frame that the detectors have seen, or that is a repeat."""
        bank, time_s, repeat = self._bank, prepared.frame.time_s, prepared.repeat
        responses: dict[str, Response | None] = {}
        if repeat.passed_over:
            self._passed_over_s.append(time_s)
        else:
            responses = bank.respond(prepared.frame.lumas, time_s + repeat.shift_s)
        if not repeat.kind and not prepared.undecided:
            return responses
        # If nothing changed, or it is not known how long the change took, every detector responds
        # with 0, whatever its earlier responses.
        lasted = float(self._count - 1)  # intervals
        if self._per_second:
            lasted = (time_s - self._first_s) * self._per_second
        return bank.at_rest(lasted + ROUNDING)

    def _judged(
        self, responses: dict[str, Response | None], prepared: Prepared, blind: str
    ) -> tuple[dict[str, tuple[Detection, ...]], dict[str, bool]]:
        """Return the looming objects and the alarms at a frame, or at a picture between frames."""
        objects = {
            name: () if prepared.repeat.kind else self._objects(name, responses[name], prepared)
            for name in self._places
            if name in responses
        }
        time_s = prepared.frame.time_s
        alarms = {
            name: each is not None
            and self._alarms[name].step(each.response, time_s, blind=bool(blind))
            for name, each in responses.items()
        }
        return objects, alarms

    def _objects(
        self, name: str, response: Response | None, prepared: Prepared
    ) -> tuple[Detection, ...]:
        if response is None:
            return ()
        places, units = self._places[name], self._bank.units_of(name)
        shift_s = prepared.repeat.shift_s
        if units is None:
            detections = places.of_box(response)
        else:
            # Growth is measured between the times at which pictures were taken. But the time to
            # contact counts from the presentation time of the frame.
            taken_s = prepared.frame.time_s + shift_s
            scale = self._sizes[name].height / self._working.height
            flow = prepared.flow and prepared.flow.scaled(scale)
            detections = places.step(units, flow, taken_s)
            if shift_s:
                detections = tuple(each.after(-shift_s) for each in detections)
        if not self._optics:
            return detections
        return tuple(each.seen_through(self._optics) for each in detections)


def _is_of(size: WorkingSize, height: int) -> bool:
    return min(size.shape) == height


def _held(record: FrameRecord, prepared: Prepared) -> FrameRecord:
    """Return the record of a repeat; `record` is that of the picture that the frame repeats."""
    passed_s = prepared.frame.time_s - record.time_s
    return replace(
        record,
        frame=prepared.frame.index,
        time_s=prepared.frame.time_s,
        luma_change=0.0,
        repeat=prepared.repeat.kind,
        detections=tuple(each.after(passed_s) for each in record.detections),
        objects={name: each and each.after(passed_s) for name, each in record.objects.items()},
    )


def _in_source(response: Response | None, working: WorkingSize) -> Response | None:
    """Convert the box of a response to source pixels."""
    if response is None or response.box is None:
        return response
    box, x, y = response.box, working.scale_x, working.scale_y
    return replace(response, box=Box(box.x * x, box.y * y, box.width * x, box.height * y))
