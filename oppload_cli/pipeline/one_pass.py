"""One pass of the detectors over a video: the way of a frame to its record."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

from oppload_cli.detection.alarm import Alarm, Cuts
from oppload_cli.detection.places import Detections
from oppload_cli.frame_times import FrameTimes, seconds_of
from oppload_cli.frames.between import Interpolation
from oppload_cli.frames.preparation import Preparation, Prepared
from oppload_cli.frames.repeats import Repeat
from oppload_cli.models.bank import DetectorBank
from oppload_cli.models.detector import Box
from oppload_cli.models.registry import detector_of
from oppload_cli.motion.flow import DenseFlow, Flow
from oppload_cli.results.record import DetectorRecord, FrameRecord

if TYPE_CHECKING:
    from collections.abc import Sequence
    from fractions import Fraction

    from oppload_cli.detection.alarm import AlarmParams
    from oppload_cli.detection.contact import PlaceParams
    from oppload_cli.detection.places import Detection
    from oppload_cli.frames.repeats import Repeats
    from oppload_cli.models.detector import Response
    from oppload_cli.models.dpc import Map
    from oppload_cli.models.timebase import TimeParams
    from oppload_cli.motion.rmo import RmoParams
    from oppload_cli.schema import Parameters
    from oppload_cli.video.frames import Frame, InputFacts, WorkingSize
    from oppload_cli.video.optics import Optics


class PassParams(NamedTuple):
    """The parameters of one pass."""

    params: Sequence[Parameters]  # one set for each detector
    alarm: AlarmParams
    places: PlaceParams | None  # None: looming objects are not looked for
    time: TimeParams  # auto: each detector has its own time base
    rmo: RmoParams | None  # None: RMO is not measured
    repeats: Repeats  # recognises the repeats of this pass

    def preparation(self, rate: Fraction | None, tick_s: Fraction | None = None) -> Preparation:
        """Return the work on frames before the detectors; arguments as for `FrameTimes`."""
        per_second = self.time.per_second
        flow = DenseFlow(1 / per_second if per_second else 0) if self.needs_flow else None
        return Preparation(FrameTimes(rate, tick_s), self.repeats, flow, self.rmo)

    @property
    def needs_flow(self) -> bool:
        """Whether RMO, a detector's objects or pictures in between need the flow of each frame."""
        kinds = map(detector_of, self.params)
        return self.rmo is not None or any(kind.places or kind.interpolates for kind in kinds)


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
        self._first = 0  # ticks
        self._cuts = Cuts(chosen.alarm)
        self._alarms = {name: Alarm(name, chosen.alarm) for name in self._bank.detectors}
        detectors = self._bank.detectors.values()
        interpolates = {detector.shape for detector in detectors if detector.interpolates}
        self._interpolations = {shape: Interpolation() for shape in interpolates}
        self._latest: FrameRecord | None = None  # the row that a repeat in a cadence repeats
        self._index = -1  # number of the frame before
        # Of the latest frame that the detectors saw: when it was presented, and its picture taken.
        self._before = self._taken = 0  # ticks
        self._too_slow = False  # whether a frame after that one was dropped
        self._passed_over: list[int] = []  # times in ticks of the frames after that one
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
            for earlier in prepared.again:
                self.step(earlier)
        time, repeat = prepared.frame.time, prepared.repeat
        if not self._count:
            self._first = time
        elif self._facts.real_time and prepared.frame.index > self._index + 1:
            self._too_slow = True
        self._index = prepared.frame.index
        self._count += 1
        if repeat.held and self._latest is not None:
            return _held(self._latest, prepared)
        blind = "" if repeat.passed_over else self._see(prepared)
        responses = self._responses(prepared)
        self._latest = FrameRecord(
            frame=prepared.frame.index,
            time_s=prepared.frame.time_s,
            luma_change=0.0 if repeat.kind else self._bank.luma_change,
            detectors=self._judged(responses, prepared, blind),
            rmo=prepared.rmo,
            repeat=repeat.kind,
            blind=blind,
        )
        return self._latest

    def _see(self, prepared: Prepared) -> str:
        """Show the detectors a frame, after all pictures before it that they have not seen.

        Return why the frame is blind; empty for a frame that counts.
        """
        (frame, repeat, flow), bank = prepared[:3], self._bank
        luma, taken = frame.luma, frame.time + repeat.shift
        if self._chosen.needs_flow:  # without it, detectors that use the flow measure it
            bank.give(None)
        if repeat.still_begins:
            # The frames that were passed over are no repeats: the detectors get them now.
            for passed_over in self._passed_over:
                bank.see(luma, seconds_of(passed_over))
                bank.respond(frame.lumas, seconds_of(passed_over))
                self._before = self._taken = passed_over
        stood_still = bool(self._passed_over)
        self._passed_over.clear()
        elapsed = seconds_of(taken - self._taken) * (self._per_second or 0)
        if self._too_slow:  # pictures in between take time, so that one gap would lead to the next
            elapsed, self._too_slow = 0.0, False
        pictures = self._pictures_between(frame, elapsed, flow)
        if pictures:
            bank.separate()
        bank.see(luma, seconds_of(taken))
        change = 0.0 if repeat.kind else bank.luma_change
        blind = self._cuts.step(bank.photoreceptors, change, frame.time_s, stood_still=stood_still)
        times = (self._before, frame.time), (self._taken, taken)
        for share, lumas in pictures:
            shown_at, of = (then + round(share * (now - then)) for then, now in times)
            responses = bank.respond(lumas, seconds_of(of), between=True)
            between = replace(frame, time=shown_at)
            shown = Prepared(between, Repeat(shift=of - shown_at), None, None)
            self._judged(responses, shown, blind)
        if self._chosen.needs_flow:
            bank.give(flow)
        self._before, self._taken = frame.time, taken
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
        bank, time, repeat = self._bank, prepared.frame.time, prepared.repeat
        responses: dict[str, Response | None] = {}
        if repeat.passed_over:
            self._passed_over.append(time)
        else:
            responses = bank.respond(prepared.frame.lumas, seconds_of(time + repeat.shift))
        if not repeat.kind and not prepared.undecided:
            return responses
        # If nothing changed, or it is not known how long the change took, every detector responds
        # with 0, whatever its earlier responses.
        return bank.at_rest(self._count - 1, seconds_of(time - self._first))

    def _judged(
        self, responses: dict[str, Response | None], prepared: Prepared, blind: str
    ) -> dict[str, DetectorRecord]:
        """Return what the detectors say of a frame, or of a picture between frames."""
        time_s, said = prepared.frame.time_s, {}
        for name, response in responses.items():
            judge = self._alarms[name]
            objects: tuple[Detection, ...] = ()
            if name in self._places and not prepared.repeat.kind:
                objects = self._objects(name, response, prepared)
            alarm = response is not None and judge.step(
                response.response, time_s, blind=bool(blind)
            )
            if name in self._places:
                objects = self._places[name].with_alarm(
                    objects, alarm=alarm, threshold=judge.threshold
                )
            evidence = judge.evidence if response else None
            answer = _in_source(response, self._sizes[name])
            said[name] = DetectorRecord(answer, alarm, judge.threshold, evidence, objects)
        return said

    def _objects(
        self, name: str, response: Response | None, prepared: Prepared
    ) -> tuple[Detection, ...]:
        if response is None:
            return ()
        places, units = self._places[name], self._bank.units_of(name)
        shift_s = seconds_of(prepared.repeat.shift)
        if units is None:
            detections = places.of_box(response)
        else:
            # Growth is measured between the times at which pictures were taken. But the time to
            # contact counts from the presentation time of the frame.
            taken_s = seconds_of(prepared.frame.time + prepared.repeat.shift)
            scale = self._sizes[name].height / self._working.height
            flow = prepared.flow and prepared.flow.scaled(scale)
            detections = places.step(units, flow, taken_s)
            if shift_s:
                detections = tuple(detection.after(-shift_s) for detection in detections)
        if not self._optics:
            return detections
        return tuple(detection.seen_through(self._optics) for detection in detections)


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
        detectors={name: said.after(passed_s) for name, said in record.detectors.items()},
    )


def _in_source(response: Response | None, working: WorkingSize) -> Response | None:
    """Convert the box of a response to source pixels."""
    if response is None or response.box is None:
        return response
    box, x, y = response.box, working.scale_x, working.scale_y
    return replace(response, box=Box(box.x * x, box.y * y, box.width * x, box.height * y))
