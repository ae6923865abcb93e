"""Runs detectors and their alarms on frames: on all frames of a video, or one by one."""

from __future__ import annotations

import math
import threading
import warnings
from contextlib import closing
from numbers import Real
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np

from oppload_cli.detection.alarm import AlarmParams, alarm_params_with
from oppload_cli.detection.contact import PlaceParams
from oppload_cli.errors import FrameError, ParameterError, counted
from oppload_cli.frame_times import ticks
from oppload_cli.frames.repeats import RepeatParams, Repeats
from oppload_cli.models.detector import checked_shape
from oppload_cli.models.registry import (
    default_names,
    detector_of,
    names_of,
    other_heights,
    parameters_of,
)
from oppload_cli.models.timebase import TimeParams
from oppload_cli.motion.rmo import RmoParams
from oppload_cli.pipeline.one_pass import DetectorPass, PassParams
from oppload_cli.pipeline.sources import ArrayLuminance, open_source
from oppload_cli.processes.threads import Prefetch
from oppload_cli.schema import Parameters
from oppload_cli.video.frames import (
    AUTO,
    MAX_PIXELS,
    Frame,
    InputFacts,
    WorkingSize,
    frames_ahead,
    max_pixels,
    other_sizes,
    parse_height,
    pixels_of,
    sizes_in_words,
    too_large,
)
from oppload_cli.video.inputs import checked_rate
from oppload_cli.video.optics import Optics, parse_fov

if TYPE_CHECKING:
    from collections.abc import Generator, Iterator, Sequence
    from fractions import Fraction
    from types import UnionType

    from numpy.typing import NDArray

    from oppload_cli.pipeline.sources import Source, Times
    from oppload_cli.results.record import FrameRecord
    from oppload_cli.video.frames import FrameSource


_FEW_FRAMES = 10  # after this number of frames a wrong unit of the times gives a warning
_HEIGHT_FIRST = "the shape of an Analysis is its height and its width, as in frame.shape[:2]"
_LONGEST_STEP_S = 1.0  # a larger usual step suggests that times are not in seconds


class Analysis:
    """Runs detectors on frames that your program gives one by one, for example from a camera.

    The results are those of :func:`analyse` for a video of the same frames: responses, alarms, and
    looming objects with boxes and times to contact. An `Analysis` cannot be copied or pickled.
    Several threads may share one, which takes one frame after the other; give the frames in the
    order of their times. Objects in different threads do not disturb each other.

    Parameters
    ----------
    shape : tuple of int
        Height and width of the frames in pixels.
    models : sequence of str or Parameters, optional
        As for :func:`analyse`, like `height`, `alarm`, `places`, `repeats` and `time`.
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
    >>> record["opplod"].alarm, round(record["opplod"].object.time_to_contact_s, 2)
    (True, 0.18)
    """

    def __init__(
        self,
        shape: tuple[int, int],
        models: Sequence[Parameters | str] | None = None,
        *,
        rate: float | Fraction | None = None,
        height: int | str | None = None,
        alarm: AlarmParams | None = None,
        places: PlaceParams | bool | None = True,
        rmo: RmoParams | bool | None = False,
        repeats: RepeatParams | Repeats | None = None,
        time: TimeParams | None = None,
        fov: float | None = None,
    ) -> None:
        rows, columns = checked_shape(shape)
        if too_large(columns, rows):
            raise ParameterError(
                f"shape must have at most {max_pixels()} pixels, not {rows} x {columns}; give "
                f"smaller frames, or set {MAX_PIXELS} higher"
            )
        chosen = pass_params(
            models, alarm=alarm, places=places, time=time, rmo=rmo, repeats=repeats
        )
        facts = InputFacts("frames", "array", columns, rows, checked_rate(rate), None)
        size = parse_height(AUTO if height is None else height)
        working = WorkingSize.of(facts, pixels_of(size))
        names = [detector_of(params).name for params in chosen.params]
        others = other_sizes(facts, working, other_heights(names) if size == AUTO else ())
        optics = None if fov is None else Optics.of_fov(columns, rows, parse_fov(fov))
        self._shape, self._working = (rows, columns), working
        self._description = f"{sizes_in_words(facts, working)}, {', '.join(names)}"
        self._luminance = ArrayLuminance(working)
        self._others = {size.shape: ArrayLuminance(size) for size in others}
        self._preparation = chosen.preparation(facts.frame_rate)
        self._detectors = DetectorPass(working, others, facts, chosen, optics)
        self._count, self._first = 0, 0  # number of frames so far, and the time of the first
        self._lock = threading.Lock()

    def __repr__(self) -> str:
        return f"Analysis({self._description}; {counted(self._count, 'frame')} so far)"

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

        Notes
        -----
        After such an error go on with the next frame: a refused frame leaves no trace.
        """
        with self._lock:  # the compiled loops of two frames would write into the same memory
            record = self._step(frame, time_s)
        if self._count == _FEW_FRAMES:
            for remark in self._unit_remarks():
                warnings.warn(remark, stacklevel=2)
        return record

    def _step(self, frame: NDArray[Any], time_s: float) -> FrameRecord:
        count, values = self._count, np.asarray(frame)
        shape, (rows, columns) = self._shape, self._shape
        if values.shape not in {shape, (*shape, 3)}:
            remedies = {
                (*shape, 1): "give frame[..., 0]",
                (*shape, 2): "give the luma, which is frame[..., 0] of YUYV",
                (*shape, 4): "give frame[..., :3]",
                (3, *shape): "give frame.transpose(1, 2, 0)",
                **dict.fromkeys(((columns, rows), (columns, rows, 3)), _HEIGHT_FIRST),
                (rows * 3 // 2, columns): f"give the luma, which is frame[:{rows}] of NV12 or I420",
            }
            if not values.shape:
                remedy = "give an array of NumPy, such as umat.get() of a UMat"
                if values.item() is None:
                    remedy = "OpenCV gives None where it could read no frame"
                raise FrameError(
                    f"frame {count}: a frame must be an array, not {frame!r:.60}; {remedy}"
                )
            another_size = "make another Analysis for frames of another size"
            raise FrameError(
                f"frame {count}: a frame must be of shape {shape}, with or without an axis of 3 "
                f"colours, not of shape {values.shape}; {remedies.get(values.shape, another_size)}"
            )
        given: object = time_s  # a caller may give None, in spite of the type
        # NumPy takes its durations for integers, but they are no numbers of seconds.
        is_number = isinstance(given, Real) and not isinstance(given, np.timedelta64)
        if not is_number or not math.isfinite(time_s):
            raise FrameError(
                f"frame {count}: its time must be a finite number of seconds, not {time_s!r}"
            )
        if not count:
            self._first = ticks(float(time_s))
        name = f"frame {count}"
        luma = self._luminance(values, name)
        others = {shape: convert(values, name) for shape, convert in self._others.items()}
        self._count += 1
        taken = Frame(count, ticks(float(time_s)) - self._first, luma, others=others)
        return self._detectors.step(self._preparation.step(taken))

    @property
    def remarks(self) -> list[str]:
        """Sentences on faults of the frames so far, as in the sidecar.

        They report times that go back, frames in bursts, a frame rate that is or was too low or
        contradicts `rate`, times that seem to be in another unit than seconds, repeats, pictures
        that do not change, and frames that are too small.

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
        pictures = repeats.remarks()
        if not pictures and repeats.still_s:
            pictures = [f"the picture has stood still for the latest {repeats.still_s:.1f} s"]
        return [*times.remarks(), *self._unit_remarks(), *pictures, *self._working.remarks()]

    def _unit_remarks(self) -> list[str]:
        rate = self._preparation.times.rate
        if rate is None or rate * _LONGEST_STEP_S > 1:
            return []
        spacing = f"by their times, frames are {1 / rate:.3g} s apart"
        return [f"{spacing}; if that is wrong, give the times in seconds"]

    def __reduce_ex__(self, protocol: object) -> NoReturn:
        """Raise a TypeError: objects of C libraries cannot be copied or pickled."""
        raise TypeError(
            "an Analysis cannot be copied or pickled; make another one with the same arguments, "
            "also in another process"
        )


def _check_kind(name: str, value: object, kind: type | UnionType, give: str) -> None:
    if value is not None and not isinstance(value, kind):
        raise ParameterError(f"{name} must not be {value!r:.60}; give {give}")


def analyse(
    source: Source,
    models: Sequence[Parameters | str] | None = None,
    *,
    rate: float | Fraction | None = None,
    times: Times | None = None,
    height: int | str | None = None,
    alarm: AlarmParams | None = None,
    places: PlaceParams | bool | None = True,
    rmo: RmoParams | bool | None = True,
    repeats: RepeatParams | Repeats | None = None,
    time: TimeParams | None = None,
    fov: float | None = None,
) -> Iterator[FrameRecord]:
    """Run detectors over a video, a stimulus or an array in one pass, frame by frame.

    Parameters
    ----------
    source : str, Path, FrameSource, Protocol or array
        As for :func:`oppload_cli.open_source`; an open video is not closed.
    models : sequence of str or Parameters, optional
        The detectors: names, such as ``["opplod", "opplod_paper"]``, or sets of parameters, such as
        ``[OpplodParams(gain=2)]``. OppLoD and D-LGMD if left out.
    rate, times
        As for :func:`oppload_cli.open_source`.
    height : int or str, optional
        Working height in pixels for all detectors, or ``native``. If left out, each detector gets
        its own, and the frames themselves are measured at 240.
    alarm : AlarmParams, optional
        Parameters of all alarms; if left out, the detectors' own.
    places : PlaceParams or bool, optional
        Parameters of the looming objects, or whether to look for them. If False, the alarms have no
        time to contact.
    rmo : RmoParams or bool, optional
        Parameters of radial motion opponency, or whether to measure it.
    repeats : RepeatParams or Repeats, optional
        How to handle repeats. A `Repeats` object knows the cadence after the pass.
    time : TimeParams, optional
        The time base; if left out, that of each detector.
    fov : float, optional
        As for :class:`Analysis`.

    Yields
    ------
    FrameRecord
        One per frame; responses are None during warm-up.

    Raises
    ------
    SourceError
        If nothing can be read from the source.
    StimulusError
        If the stimulus of a TOML file is not valid, or if the file has several.
    ParameterError
        If a name or a value is wrong.

    Examples
    --------
    >>> import oppload_cli as oppload
    >>> for record in oppload.analyse("controls/looming-perspective", rmo=False):
    ...     if record["opplod"].alarm:
    ...         print(f"alarm at {record.time_s:.2f} s")
    ...         break
    alarm at 1.23 s
    """
    chosen = pass_params(models, alarm=alarm, places=places, time=time, rmo=rmo, repeats=repeats)
    names = [detector_of(params).name for params in chosen.params]
    others = other_heights(names) if height in {None, AUTO} else ()
    degrees = None if fov is None else parse_fov(fov)
    with open_source(source, rate=rate, times=times, height=height, others=others) as video:
        facts = video.facts
        optics = None if degrees is None else Optics.of_fov(facts.width, facts.height, degrees)
        with closing(side_by_side(video, [chosen], optics)) as records:
            for (record,) in records:
                yield record


def side_by_side(
    video: FrameSource, passes: Sequence[PassParams], optics: Optics | None = None
) -> Generator[list[FrameRecord], None, None]:
    """Make several passes over the frames of an open video at the same time.

    Parameters
    ----------
    video : FrameSource
        The open video, which is not closed.
    passes : sequence of PassParams
        The parameters of each pass, from :func:`pass_params`.
    optics : Optics, optional
        If given, looming objects are also described in degrees.

    Yields
    ------
    list of FrameRecord
        For each frame, the record of each pass.
    """
    facts, working = video.facts, video.working
    preparations = [params.preparation(facts.frame_rate, facts.tick_s) for params in passes]
    others: Sequence[WorkingSize] = getattr(video, "others", ())
    detectors = [DetectorPass(working, others, facts, params, optics) for params in passes]
    # A second thread prepares frames, because optical flow takes as long as the detectors.
    frames = ([chain.step(frame) for chain in preparations] for frame in video)
    prepared = Prefetch(frames, frames_ahead(facts, working))
    try:
        for of_passes in prepared:
            yield [
                detector_pass.step(frame)
                for detector_pass, frame in zip(detectors, of_passes, strict=True)
            ]
    finally:
        prepared.close()


def pass_params(
    models: Sequence[Parameters | str] | None = None,
    *,
    alarm: AlarmParams | None = None,
    places: PlaceParams | bool | None = True,
    time: TimeParams | None = None,
    rmo: RmoParams | bool | None = True,
    repeats: RepeatParams | Repeats | None = None,
) -> PassParams:
    """Return the parameters of a pass; the arguments and the error are those of :func:`analyse`."""
    _check_kind("models", models, list | tuple, f"a list, such as {[default_names()[0]]}")
    _check_kind("alarm", alarm, AlarmParams, "oppload_cli.alarm_params()")
    _check_kind("places", places, PlaceParams | bool, "True, False or oppload_cli.PlaceParams()")
    time_example = "oppload_cli.models.timebase.TimeParams(interval='frame')"
    _check_kind("time", time, TimeParams, time_example)
    _check_kind("rmo", rmo, RmoParams | bool, "True, or oppload_cli.RmoParams()")
    repeats_example = "oppload_cli.frames.repeats.RepeatParams(handling='exact')"
    _check_kind("repeats", repeats, RepeatParams | Repeats, repeats_example)
    for model in models or ():
        kinds = "names of detectors, or sets as parameters_of gives them"
        _check_kind("models", model, Parameters | str, kinds)
    chosen: list[Parameters] = []
    for model in models or default_names():
        if isinstance(model, str):
            chosen += [parameters_of(name) for name in names_of(model)]
        else:
            chosen.append(model)
    names = [detector_of(params).name for params in chosen]
    for name in names:
        if names.count(name) > 1:
            raise ParameterError(
                f"models must not hold two sets of '{name}'; give the second set to a second pass"
            )
    return PassParams(
        chosen,
        alarm or alarm_params_with(names),
        PlaceParams() if places is True else places or None,
        time or TimeParams(),
        RmoParams() if rmo is True else rmo or None,
        repeats if isinstance(repeats, Repeats) else Repeats(repeats or RepeatParams()),
    )
