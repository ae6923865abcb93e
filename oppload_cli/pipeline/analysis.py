"""One pass over a video: every frame through every detector and its alarm."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

from oppload_cli.detection.alarm import Alarm, Cuts
from oppload_cli.detection.parameters import alarm_params_with, place_params
from oppload_cli.detection.places import Detections
from oppload_cli.models.detector import Box
from oppload_cli.models.presets import DEFAULT_PRESET, PRESETS
from oppload_cli.models.registry import DetectorBank, default_names, detector_of, parameters_of
from oppload_cli.models.timebase import NEARLY_ONE, FrameTimes, TimeParams, time_params
from oppload_cli.motion.flow import DenseFlow
from oppload_cli.motion.rmo import DEFAULT_RMO, RmoMetrics
from oppload_cli.pipeline.repeats import Repeat, RepeatParams, Repeats
from oppload_cli.pipeline.sources import open_source
from oppload_cli.processes.threads import Prefetch
from oppload_cli.results.table import FrameRecord
from oppload_cli.video.frames import frames_ahead

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from fractions import Fraction

    from oppload_cli.detection.parameters import AlarmParams, PlaceParams
    from oppload_cli.detection.places import Detection
    from oppload_cli.models.detector import Response
    from oppload_cli.motion.rmo import RmoParams
    from oppload_cli.pipeline.sources import Source
    from oppload_cli.schema import Parameters
    from oppload_cli.video.frames import Frame, FrameSource, WorkingSize
    from oppload_cli.video.optics import Optics


def analyse(
    source: Source,
    params: Sequence[Parameters] | None = None,
    *,
    preset: str | None = None,
    rate: float | Fraction | None = None,
    height: int | str | None = None,
    alarm: AlarmParams | None = None,
    places: PlaceParams | bool | None = True,
    rmo: RmoParams | bool | None = True,
    repeats: RepeatParams | Repeats | None = None,
    time: TimeParams | None = None,
    optics: Optics | None = None,
) -> Iterator[FrameRecord]:
    """Run detectors over a video, a stimulus or an array in one pass, frame by frame.

    Parameters
    ----------
    source : str, Path, FrameSource, Protocol or array
        As :func:`oppload_cli.open_source` takes it; an open video is iterated, not closed.
    params : sequence of Parameters, optional
        One set for each detector, such as ``[OpplodParams(), DlgmdParams()]``; OppLoD and
        D-LGMD of the preset if left out.
    preset : str, optional
        Name of the preset, which gives the alarm and the working height too; else the one that
        `params` belong to, or else ``default``.
    rate, height
        As of :func:`oppload_cli.open_source`.
    alarm : AlarmParams, optional
        Parameters of every detector's alarm; else those of the preset.
    places : PlaceParams or bool, optional
        Parameters of the looming objects, or whether to look for them; without them the alarm
        knows no time to contact.
    rmo : RmoParams or bool, optional
        Parameters of radial motion opponency, or whether to measure it.
    repeats : RepeatParams or Repeats, optional
        How repeats are taken; a `Repeats` knows the cadence in the end.
    time : TimeParams, optional
        The time base; else that of the preset.
    optics : Optics, optional
        Gives the looming objects in degrees too.

    Yields
    ------
    FrameRecord
        One per frame; responses are None during warm-up.

    Raises
    ------
    SourceError
        If nothing can be read from the source.
    ParameterError
        If a name or a value is wrong.

    Examples
    --------
    >>> import oppload_cli as oppload
    >>> for record in oppload.analyse("controls/looming-perspective", rmo=False):
    ...     if record.alarms["opplod"]:
    ...         print(f"alarm at {record.time_s:.2f} s")
    ...         break
    alarm at 1.07 s
    """
    preset = preset or _preset_of(params or ())
    chosen = params or [parameters_of(name, preset) for name in default_names()]
    alarm = alarm or alarm_params_with([detector_of(each).name for each in chosen], preset)
    places = place_params(preset) if places is True else places or None
    rmo = DEFAULT_RMO if rmo is True else rmo or None
    copies = repeats if isinstance(repeats, Repeats) else Repeats(repeats or RepeatParams())
    with open_source(source, rate=rate, height=height, preset=preset) as video:
        time = time or time_params(preset)
        detectors = _Detectors(video, chosen, alarm, places, time=time, optics=optics)
        yield from _records(video, detectors, _seen(video, rmo, copies))


def _preset_of(params: Sequence[Parameters]) -> str:
    """Return the preset that has these parameters; the default one where none has them."""
    for preset in PRESETS:
        if all(parameters_of(detector_of(each).name, preset) == each for each in params):
            return preset
    return DEFAULT_PRESET


def _records(
    video: FrameSource, detectors: _Detectors, frames: Iterator[_Seen]
) -> Iterator[FrameRecord]:
    # The flow runs in a thread of its own: it costs about as much as the detectors.
    ahead = frames_ahead(video.facts, video.working)
    seen = Prefetch(frames, ahead)
    try:
        for count, each in enumerate(seen):
            yield detectors.answer(each, count)
    finally:
        seen.close()


class _Seen(NamedTuple):
    """A frame, the picture that it repeats, and its radial motion opponency."""

    frame: Frame
    repeat: Repeat
    opponency: RmoMetrics | None


def _seen(video: FrameSource, rmo: RmoParams | None, repeats: Repeats) -> Iterator[_Seen]:
    flow = DenseFlow(rmo) if rmo else None
    for frame in video:
        repeat = repeats.step(frame.luma, frame.time_s)
        opponency = flow.step(frame.luma) if flow and not repeat.passed_over else None
        if flow and repeat.kind:
            opponency = RmoMetrics()
        yield _Seen(frame, repeat, opponency)


class _Detectors:
    """The detectors over one video, with their alarms and the places of looming objects."""

    def __init__(
        self,
        video: FrameSource,
        params: Sequence[Parameters],
        alarm: AlarmParams,
        places: PlaceParams | None,
        *,
        time: TimeParams,
        optics: Optics | None,
    ) -> None:
        stated, self._working, self._optics = video.facts.frame_rate, video.working, optics
        rate = float(stated) if stated else None
        self._bank = DetectorBank(video.working.shape, params, rate, time)
        self._times, self._per_second = FrameTimes(rate), time.per_second
        self._first_s: float | None = None
        self._cuts = Cuts(alarm)
        self._alarms = {name: Alarm(name, alarm) for name in self._bank.detectors}
        self._latest: FrameRecord | None = None  # of a frame that the detectors saw
        self._passed_s: list[float] = []  # times of the frames since then
        self._places = {
            name: Detections(self._working, places, 1 / time.per_second if time.per_second else 0)
            for name, each in self._bank.detectors.items()
            if each.places and places
        }

    def answer(self, seen: _Seen, count: int) -> FrameRecord:
        """Take the next frame; `count` frames came before it."""
        time_s = self._times.step(seen.frame.time_s)
        if seen.repeat.held and self._latest is not None:
            return _held(self._latest, seen)
        answers = self._answers(seen, count, time_s)
        change = 0.0 if seen.repeat.kind else self._bank.luma_change
        blind = False
        if change is not None and not seen.repeat.passed_over:
            blind = self._cuts.step(self._bank.photoreceptors, change, time_s)
        found = {
            name: () if seen.repeat.kind else self._found(name, answers[name], seen, time_s)
            for name in self._places
        }
        alarms = {
            name: answer is not None
            and self._alarms[name].step(
                answer.response, time_s, contact_s=_contact_s(found.get(name)), blind=blind
            )
            for name, answer in answers.items()
        }
        thresholds = {name: alarm.threshold for name, alarm in self._alarms.items()}
        found = {
            name: self._places[name].with_alarm(
                each, alarm=alarms[name], threshold=thresholds[name]
            )
            for name, each in found.items()
        }
        record = FrameRecord(
            seen.frame.index,
            seen.frame.time_s,
            change,
            {name: _in_source(answer, self._working) for name, answer in answers.items()},
            alarms,
            seen.opponency,
            seen.repeat.kind,
            thresholds,
            next(iter(found.values()), ()),
            {name: each[0] if each else None for name, each in found.items()},
            blind,
        )
        if not seen.repeat.passed_over:
            self._latest = record
        return record

    def _answers(self, seen: _Seen, count: int, time_s: float) -> dict[str, Response | None]:
        bank, luma = self._bank, seen.frame.luma
        if self._first_s is None:
            self._first_s = time_s
        answers: dict[str, Response | None] = {}
        if seen.repeat.passed_over:
            self._passed_s.append(time_s)
        else:
            if seen.repeat.still_begins:
                # No repeats after all: the detectors are now shown the frames that they missed.
                for passed_s in self._passed_s:
                    bank.step(luma, passed_s)
            self._passed_s.clear()
            answers = bank.step(luma, time_s + seen.repeat.shift_s)
        if not seen.repeat.kind:
            return answers
        # Where nothing changed every detector answers 0, whatever came before.
        lasted = (time_s - self._first_s) * self._per_second if self._per_second else count
        return bank.at_rest(lasted + NEARLY_ONE)

    def _found(
        self, name: str, answer: Response | None, seen: _Seen, time_s: float
    ) -> tuple[Detection, ...]:
        if answer is None:
            return ()
        places, units = self._places[name], self._bank.detectors[name].units
        if units is None:
            found = places.of_box(answer)
        else:
            # An object grows from picture to picture; its contact counts from the frame on.
            shift_s = seen.repeat.shift_s
            shown = places.step(units, seen.frame.luma, time_s + shift_s)
            found = tuple(each.after(-shift_s) for each in shown) if shift_s else shown
        return tuple(each.seen_through(self._optics) for each in found) if self._optics else found


def _contact_s(found: Sequence[Detection] | None) -> float | None:
    """Return the time to contact of the object with the largest response."""
    return found[0].time_to_contact_s if found else None


def _held(record: FrameRecord, seen: _Seen) -> FrameRecord:
    """Return the record of a frame that repeats the picture of an earlier record."""
    passed_s = seen.frame.time_s - record.time_s
    return replace(
        record,
        frame=seen.frame.index,
        time_s=seen.frame.time_s,
        luma_change=0.0,
        repeat=seen.repeat.kind,
        detections=tuple(each.after(passed_s) for each in record.detections),
        objects={name: each and each.after(passed_s) for name, each in record.objects.items()},
    )


def _in_source(answer: Response | None, working: WorkingSize) -> Response | None:
    """Return an answer with its box in source pixels."""
    if answer is None or answer.box is None:
        return answer
    box, x, y = answer.box, working.scale_x, working.scale_y
    return replace(answer, box=Box(box.x * x, box.y * y, box.width * x, box.height * y))
