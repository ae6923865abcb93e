"""Runs detectors and their alarms on frames: on all frames of a video, or one by one."""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import replace
from numbers import Real
from typing import TYPE_CHECKING, Any, NamedTuple, NoReturn

import numpy as np

from oppload_cli.detection.alarm import Alarm, Cuts
from oppload_cli.detection.parameters import (
    AlarmParams,
    PlaceParams,
    alarm_params_with,
    place_params,
)
from oppload_cli.detection.places import Detections
from oppload_cli.errors import FrameError, ParameterError
from oppload_cli.models.detector import Box
from oppload_cli.models.presets import DEFAULT_PRESET, PRESETS, parse_height, preset_named
from oppload_cli.models.registry import DetectorBank, default_names, detector_of, parameters_of
from oppload_cli.models.timebase import NEARLY_ONE, TimeParams, time_params
from oppload_cli.motion.flow import DenseFlow, Interpolation
from oppload_cli.motion.rmo import DEFAULT_RMO, RmoMetrics, RmoParams
from oppload_cli.pipeline.repeats import Repeat, RepeatParams, Repeats
from oppload_cli.pipeline.sources import ArrayLuminance, checked_rate, open_source
from oppload_cli.processes.threads import Prefetch
from oppload_cli.results.table import FrameRecord
from oppload_cli.schema import Parameters
from oppload_cli.video.frames import (
    MAX_PIXELS,
    Frame,
    FrameTimes,
    InputFacts,
    WorkingSize,
    frames_ahead,
    is_integer,
    max_pixels,
    too_large,
)
from oppload_cli.video.optics import Optics, parse_fov

if TYPE_CHECKING:
    from collections.abc import Iterator
    from fractions import Fraction
    from types import UnionType

    from numpy.typing import NDArray

    from oppload_cli.detection.places import Detection
    from oppload_cli.models.detector import Response
    from oppload_cli.pipeline.sources import Source, Times


_FEW_FRAMES = 10  # after this number of frames a wrong unit of the times gives a warning
# A cadence that the first 0.6 s prove counts from the first frame on. For this their frames are
# kept, but not more than 64 MB.
_FIRST_S, _FIRST_BYTES = 0.6, 1 << 26
_LONGEST_STEP_S = 1.0  # a larger usual step suggests that times are not in seconds


class Analysis:
    """Runs detectors on frames that your program gives one by one, for example from a camera.

    The results are those of :func:`analyse` for a video of the same frames: responses, alarms, and
    looming objects with boxes and times to contact. An `Analysis` cannot be copied or pickled.

    Parameters
    ----------
    shape : tuple of int
        Height and width of the frames in pixels.
    params : sequence of Parameters, optional
        As for :func:`analyse`, like `preset`, `height`, `alarm`, `places`, `repeats` and `time`.
    rate : float or Fraction, optional
        Frames per second, if known. Most detectors use the time of each frame; those that count
        frames use the rate.
    rmo : RmoParams or bool, optional
        Parameters of radial motion opponency, or whether to measure it, which takes about as much
        time as the detectors.
    fov : float, optional
        Field of view across the width of the frame in degrees, between 0 and 180 (both excluded).
        With it, looming objects are also described in degrees.

    Raises
    ------
    ParameterError
        If a name or a value is wrong, or frames of that shape are too large.

    Examples
    --------
    >>> import numpy as np, oppload_cli as oppload
    >>> analysis = oppload.Analysis((90, 120), rate=30)
    >>> y, x = np.mgrid[:90, :120]
    >>> for frame in range(26):  # a black disk on white, 0.17 s before it arrives
    ...     white = np.clip(np.hypot(x - 60, y - 45) - 60 / (30 - frame), 0, 1)
    ...     record = analysis.step(white, time_s=100 + frame / 30)
    >>> record.alarms["opplod"], round(record.objects["opplod"].time_to_contact_s, 2)
    (True, 0.17)
    """

    def __init__(
        self,
        shape: tuple[int, int],
        params: Sequence[Parameters] | None = None,
        *,
        preset: str | None = None,
        rate: float | Fraction | None = None,
        height: int | str | None = None,
        alarm: AlarmParams | None = None,
        places: PlaceParams | bool | None = True,
        rmo: RmoParams | bool | None = False,
        repeats: RepeatParams | Repeats | None = None,
        time: TimeParams | None = None,
        fov: float | None = None,
    ) -> None:
        rows, columns = _checked_shape(shape)
        chosen = _resolved(
            params, preset, alarm=alarm, places=places, time=time, rmo=rmo, repeats=repeats
        )
        facts = InputFacts("frames", "array", columns, rows, checked_rate(rate), None)
        pixels = parse_height(preset_named(chosen.preset).height if height is None else height)
        working = WorkingSize.of(facts, pixels)
        optics = None if fov is None else Optics.of_fov(columns, rows, parse_fov(fov))
        self._shape, self._working = (rows, columns), working
        self._rate = float(facts.frame_rate) if facts.frame_rate else None
        self._luminance = ArrayLuminance(working)
        self._preparation = _Preparation(chosen, facts.frame_rate)
        self._detectors = _Detectors(working, facts.frame_rate, chosen, optics)
        self._first_s = 0.0

    def step(self, frame: NDArray[Any], time_s: float) -> FrameRecord:
        """Take the next frame.

        Parameters
        ----------
        frame : ndarray, shape (height, width) or (height, width, 3)
            Luma, or red, green and blue: uint8 or uint16 over their full range, or float from
            0 (black) to 1 (white). The array is not kept.
        time_s : float
            Time in seconds at which the frame was taken; zero is any moment.

        Returns
        -------
        FrameRecord
            `time_s` in it counts from the first frame; boxes are in pixels of the frame.

        Raises
        ------
        FrameError
            If the frame has another shape, or its time is not finite.
        SourceError
            If the array has another type, or floating values outside 0 to 1.
        """
        values, count = np.asarray(frame), self._detectors.count
        if values.shape not in {self._shape, (*self._shape, 3)}:
            raise FrameError(
                f"frame {count}: a frame must be of shape {self._shape}, with or without "
                f"an axis of 3 colours, not of shape {values.shape}"
            )
        given: object = time_s  # a caller may give None, in spite of the type
        # NumPy takes its durations for integers, but they are no numbers of seconds.
        number = isinstance(given, Real) and not isinstance(given, np.timedelta64)
        if not number or not math.isfinite(time_s):
            raise FrameError(
                f"frame {count}: its time must be a finite number of seconds, not {time_s}"
            )
        if not count:
            self._first_s = float(time_s)
        luma = self._luminance(values, f"frame {count}")
        prepared = self._preparation.step(Frame(count, float(time_s) - self._first_s, luma))
        record = self._detectors.step(prepared)
        if count + 1 == _FEW_FRAMES:
            for remark in self._unit_remarks():
                warnings.warn(remark, stacklevel=2)
        return record

    @property
    def remarks(self) -> list[str]:
        """Sentences on faults of the frames so far, as in the sidecar.

        They report times that go back, a frame rate that is too low or contradicts `rate`, times
        that seem to be in another unit than seconds, repeats, pictures that do not change, and
        frames that are too small.

        Examples
        --------
        >>> import numpy as np, oppload_cli as oppload
        >>> analysis = oppload.Analysis((90, 120), height=90)
        >>> for frame in range(3):
        ...     grey = np.full((90, 120), frame / 3)
        ...     record = analysis.step(grey, time_s=frame * 33.3)  # milliseconds
        >>> analysis.remarks[-1]
        'by their times, frames are 33.3 s apart; if that is wrong, give the times in seconds'
        """
        times, repeats = self._preparation.times, self._preparation.repeats
        pictures = repeats.remarks(times.rate or self._rate)
        if not pictures and repeats.still_s:
            pictures = [f"the picture has stood still for the latest {repeats.still_s:.1f} s"]
        return [*times.remarks(), *self._unit_remarks(), *pictures, *self._working.remarks()]

    def _unit_remarks(self) -> list[str]:
        rate = self._preparation.times.rate
        if rate is None or rate * _LONGEST_STEP_S > 1:
            return []
        apart = f"by their times, frames are {1 / rate:.3g} s apart"
        return [f"{apart}; if that is wrong, give the times in seconds"]

    def __reduce_ex__(self, protocol: object) -> NoReturn:
        """Raise a TypeError: objects of C libraries cannot be copied or pickled."""
        raise TypeError(
            "an Analysis cannot be copied or pickled; make another one with the same arguments, "
            "also in another process"
        )


def _checked_shape(shape: object) -> tuple[int, int]:
    """Return height and width as integers; `shape` may be a list, and hold NumPy integers."""
    sides = tuple(shape) if isinstance(shape, Sequence) and not isinstance(shape, str) else ()
    if len(sides) != 2 or not all(is_integer(side, 1) for side in sides):
        raise ParameterError(
            f"shape must be height and width in pixels, not {shape!r}; of an image in colour "
            "give image.shape[:2]"
        )
    rows, columns = map(int, sides)
    if too_large(columns, rows):
        raise ParameterError(
            f"shape must have at most {max_pixels()} pixels, not {rows} x {columns}; give smaller "
            f"frames, or set {MAX_PIXELS} higher"
        )
    return rows, columns


def _check_kind(name: str, value: object, kind: type | UnionType, give: str) -> None:
    if value is not None and not isinstance(value, kind):
        raise ParameterError(f"{name} must not be {value!r}; give {give}")


def analyse(
    source: Source,
    params: Sequence[Parameters] | None = None,
    *,
    preset: str | None = None,
    rate: float | Fraction | None = None,
    times: Times | None = None,
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
        As for :func:`oppload_cli.open_source`; an open video is not closed.
    params : sequence of Parameters, optional
        One set for each detector, such as ``[OpplodParams(), DlgmdParams()]``. If left out, OppLoD
        and D-LGMD run with the parameters of the preset.
    preset : str, optional
        Name of the preset, which also gives the alarm and the working height. If left out, the
        preset that has exactly these `params`, or else ``default``.
    rate, times, height
        As for :func:`oppload_cli.open_source`.
    alarm : AlarmParams, optional
        Parameters of all alarms; if left out, those of the preset.
    places : PlaceParams or bool, optional
        Parameters of the looming objects, or whether to look for them. If False, the alarms have no
        time to contact.
    rmo : RmoParams or bool, optional
        Parameters of radial motion opponency, or whether to measure it.
    repeats : RepeatParams or Repeats, optional
        How to handle repeats. A `Repeats` object gives the cadence afterwards.
    time : TimeParams, optional
        The time base; if left out, that of the preset.
    optics : Optics, optional
        If given, looming objects are also described in degrees.

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
    chosen = _resolved(
        params, preset, alarm=alarm, places=places, time=time, rmo=rmo, repeats=repeats
    )
    with open_source(source, rate=rate, times=times, height=height, preset=chosen.preset) as video:
        preparation = _Preparation(chosen, video.facts.frame_rate)
        detectors = _Detectors(video.working, video.facts.frame_rate, chosen, optics)
        # A second thread prepares frames, because optical flow takes as long as the detectors.
        frames = (preparation.step(frame) for frame in video)
        prepared = Prefetch(frames, frames_ahead(video.facts, video.working))
        try:
            for each in prepared:
                yield detectors.step(each)
        finally:
            prepared.close()


def _preset_of(params: Sequence[Parameters]) -> str:
    """Return the preset that has these parameters; the default preset if none has them."""
    for preset in PRESETS:
        if all(parameters_of(detector_of(each).name, preset) == each for each in params):
            return preset
    return DEFAULT_PRESET


class _Chosen(NamedTuple):
    """The parameters of one pass."""

    preset: str
    params: Sequence[Parameters]
    alarm: AlarmParams
    places: PlaceParams | None
    time: TimeParams
    rmo: RmoParams | None
    repeats: Repeats


def _resolved(
    params: Sequence[Parameters] | None,
    preset: str | None,
    *,
    alarm: AlarmParams | None,
    places: PlaceParams | bool | None,
    time: TimeParams | None,
    rmo: RmoParams | bool | None,
    repeats: RepeatParams | Repeats | None,
) -> _Chosen:
    _check_kind("params", params, list | tuple, "a list, as parameters_of(name) in brackets")
    _check_kind("alarm", alarm, AlarmParams, "oppload_cli.alarm_params()")
    _check_kind("places", places, PlaceParams | bool, "True, False or oppload_cli.PlaceParams()")
    time_example = "oppload_cli.models.timebase.TimeParams(interval='frame')"
    _check_kind("time", time, TimeParams, time_example)
    _check_kind("rmo", rmo, RmoParams | bool, "True, or oppload_cli.RmoParams()")
    repeats_example = "oppload_cli.pipeline.repeats.RepeatParams(handling='exact')"
    _check_kind("repeats", repeats, RepeatParams | Repeats, repeats_example)
    for each in params or ():
        _check_kind("params", each, Parameters, "sets of parameters, as parameters_of gives them")
    preset = preset or _preset_of(params or ())
    chosen = params or [parameters_of(name, preset) for name in default_names()]
    names = [detector_of(each).name for each in chosen]
    for name in names:
        if names.count(name) > 1:
            raise ParameterError(
                f"params must not hold two sets of '{name}'; give the second set to a second pass"
            )
    return _Chosen(
        preset,
        chosen,
        alarm or alarm_params_with(names, preset),
        place_params(preset) if places is True else places or None,
        time or time_params(preset),
        DEFAULT_RMO if rmo is True else rmo or None,
        repeats if isinstance(repeats, Repeats) else Repeats(repeats or RepeatParams()),
    )


class _Prepared(NamedTuple):
    """A frame with its corrected time, whether it is a repeat, and its RMO."""

    frame: Frame
    repeat: Repeat
    opponency: RmoMetrics | None
    # All frames before this one, if their repeats are now better known: the detectors begin again.
    again: Sequence[_Prepared] = ()


class _Preparation:
    """The work on a frame before the detectors: its time, repeats and RMO."""

    def __init__(self, chosen: _Chosen, rate: Fraction | None) -> None:
        self.times, self.repeats = FrameTimes(rate), chosen.repeats
        self._flow = DenseFlow(chosen.rmo) if chosen.rmo else None
        # The first frames of the video, until a cadence is known or there are too many.
        self._first: list[_Prepared] | None = []

    def step(self, frame: Frame) -> _Prepared:
        """Take the next frame."""
        # An open video has corrected its times already; the times from a caller may be wrong.
        time_s = self.times.step(frame.time_s)
        if time_s != frame.time_s:
            frame = replace(frame, time_s=time_s)
        repeat = self.repeats.step(frame.luma, time_s)
        opponency = None
        if self._flow:
            opponency = RmoMetrics() if repeat.kind else self._flow.step(frame.luma)
        prepared = _Prepared(frame, repeat, opponency)
        return prepared if self._first is None else self._again(self._first, prepared)

    def _again(self, first: list[_Prepared], latest: _Prepared) -> _Prepared:
        """Return the latest frame; if a cadence is known now, with the first frames once more."""
        first.append(latest)
        seconds = latest.frame.time_s - first[0].frame.time_s
        if seconds > _FIRST_S or len(first) * latest.frame.luma.nbytes > _FIRST_BYTES:
            self._first = None
            return latest
        if not self.repeats.is_cadence:
            return latest
        self._first = None
        found = self.repeats.again([(each.frame.luma, each.frame.time_s) for each in first])
        *again, latest = (each._replace(repeat=r) for each, r in zip(first, found, strict=True))
        return latest._replace(again=again)


class _Detectors:
    """The detectors over one video, with their alarms and the places of looming objects."""

    def __init__(
        self, working: WorkingSize, rate: Fraction | None, chosen: _Chosen, optics: Optics | None
    ) -> None:
        self._working, self._rate, self._chosen, self._optics = working, rate, chosen, optics
        self._begin()

    def _begin(self) -> None:
        working, chosen = self._working, self._chosen
        places, time = chosen.places, chosen.time
        stated = float(self._rate) if self._rate else None
        self.count = 0  # number of frames so far
        self._bank = DetectorBank(working.shape, chosen.params, stated, time)
        self._per_second = time.per_second
        self._first_s = 0.0
        self._cuts = Cuts(chosen.alarm)
        self._alarms = {name: Alarm(name, chosen.alarm) for name in self._bank.detectors}
        self._interpolation = Interpolation()
        self._interpolates = any(each.interpolated for each in self._bank.detectors.values())
        self._latest: FrameRecord | None = None  # of the latest frame that the detectors got
        self._before_s = self._taken_s = 0.0  # when this frame was presented, and taken
        self._passed_over_s: list[float] = []  # times of the frames after this one
        self._places = {
            name: Detections(working, places, 1 / time.per_second if time.per_second else 0)
            for name, each in self._bank.detectors.items()
            if each.places and places
        }

    def step(self, prepared: _Prepared) -> FrameRecord:
        """Take the next frame."""
        if prepared.again:
            responded = self._bank.responded
            self._begin()
            self._bank.responded = responded
            for each in prepared.again:
                self.step(each)
        time_s, repeat = prepared.frame.time_s, prepared.repeat
        if not self.count:
            self._first_s = time_s
        self.count += 1
        if repeat.held and self._latest is not None:
            return _held(self._latest, prepared)
        blind = "" if repeat.passed_over else self._see(prepared.frame, repeat)
        change = 0.0 if repeat.kind else self._bank.luma_change
        responses = self._responses(prepared)
        found, alarms = self._judged(responses, prepared.frame, repeat, blind)
        thresholds = {name: alarm.threshold for name, alarm in self._alarms.items()}
        found = {
            name: self._places[name].with_alarm(
                each, alarm=alarms[name], threshold=thresholds[name]
            )
            for name, each in found.items()
        }
        record = FrameRecord(
            prepared.frame.index,
            time_s,
            change,
            {name: _in_source(each, self._working) for name, each in responses.items()},
            alarms,
            prepared.opponency,
            repeat.kind,
            thresholds,
            next(iter(found.values()), ()),
            {name: each[0] if each else None for name, each in found.items()},
            blind,
            {name: self._alarms[name].evidence for name, each in responses.items() if each},
        )
        if not repeat.passed_over:
            self._latest = record
        return record

    def _see(self, frame: Frame, repeat: Repeat) -> str:
        """Show the detectors what comes before a frame; return why the frame is blind, if it is."""
        bank, luma, taken_s = self._bank, frame.luma, frame.time_s + repeat.shift_s
        if repeat.still_begins:
            # The frames that were passed over are no repeats: the detectors get them now.
            for passed_over_s in self._passed_over_s:
                bank.step(luma, passed_over_s)
                self._before_s = self._taken_s = passed_over_s
        self._passed_over_s.clear()
        bank.see(luma, taken_s)
        change = 0.0 if repeat.kind else bank.luma_change
        blind = self._cuts.step(bank.photoreceptors, change, frame.time_s)
        if self._per_second and self._interpolates:
            times_s = (self._before_s, frame.time_s), (self._taken_s, taken_s)
            elapsed = (taken_s - self._taken_s) * self._per_second
            for share, picture in self._interpolation.step(luma, elapsed):
                shown_s, time_s = (then + share * (now - then) for then, now in times_s)
                responses = bank.respond(picture, time_s, between=True)
                between = replace(frame, time_s=shown_s, luma=picture)
                self._judged(responses, between, Repeat(shift_s=time_s - shown_s), blind)
        self._before_s, self._taken_s = frame.time_s, taken_s
        return blind

    def _responses(self, prepared: _Prepared) -> dict[str, Response | None]:
        """Return the responses to a frame that the detectors have seen, or that is a repeat."""
        bank, time_s, repeat = self._bank, prepared.frame.time_s, prepared.repeat
        responses: dict[str, Response | None] = {}
        if repeat.passed_over:
            self._passed_over_s.append(time_s)
        else:
            responses = bank.respond(prepared.frame.luma, time_s + repeat.shift_s)
        if not repeat.kind:
            return responses
        # If nothing changed, every detector responds with 0, whatever its earlier responses.
        lasted = float(self.count - 1)  # intervals
        if self._per_second:
            lasted = (time_s - self._first_s) * self._per_second
        return bank.at_rest(lasted + NEARLY_ONE)

    def _judged(
        self, responses: dict[str, Response | None], frame: Frame, repeat: Repeat, blind: str
    ) -> tuple[dict[str, tuple[Detection, ...]], dict[str, bool]]:
        """Return the looming objects and the alarms at a frame, or at a picture between frames."""
        found = {
            name: () if repeat.kind else self._found(name, responses[name], frame, repeat.shift_s)
            for name in self._places
            if name in responses
        }
        # The alarm uses the time to contact of the object with the largest response.
        contacts = {name: each[0].time_to_contact_s for name, each in found.items() if each}
        alarms = {
            name: each is not None
            and self._alarms[name].step(
                each.response, frame.time_s, contact_s=contacts.get(name), blind=bool(blind)
            )
            for name, each in responses.items()
        }
        return found, alarms

    def _found(
        self, name: str, response: Response | None, frame: Frame, shift_s: float
    ) -> tuple[Detection, ...]:
        if response is None:
            return ()
        places, units = self._places[name], self._bank.detectors[name].units
        if units is None:
            found = places.of_box(response)
        else:
            # Growth is measured between the times at which pictures were taken. But the time to
            # contact counts from the presentation time of the frame.
            found = places.step(units, frame.luma, frame.time_s + shift_s)
            if shift_s:
                found = tuple(each.after(-shift_s) for each in found)
        return tuple(each.seen_through(self._optics) for each in found) if self._optics else found


def _held(record: FrameRecord, prepared: _Prepared) -> FrameRecord:
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
