"""The alarm: on if a response is above a floor and far above recent responses."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, make_dataclass
from fractions import Fraction
from functools import cache
from itertools import islice
from statistics import median
from typing import TYPE_CHECKING, Any

import numpy as np

from oppload_cli.errors import ParameterError
from oppload_cli.frame_times import LATEST_STEPS, ticks
from oppload_cli.models.registry import detector_named, known_names
from oppload_cli.models.timebase import REFERENCE_INTERVAL, Background
from oppload_cli.schema import Parameters, parameter

if TYPE_CHECKING:
    from collections.abc import Sequence

    from oppload_cli.models.detector import AlarmRule, Detector
    from oppload_cli.models.dpc import Map


_FIRST_STEP = ticks(0.1)  # the usual step before any step is known
_INTERVAL = ticks(Fraction(REFERENCE_INTERVAL))
_GAP = 2.5  # a step longer than 2.5 usual steps is a gap: two frames or more are missing
_MEMORY = ticks(0.18)  # a cut depends on the luminance changes of this latest time
# At least this number of latest changes is kept, whatever their age. Noise does not grow with the
# time between frames, so that the change per interval is small after lost frames. If only this
# small change were kept, the next, ordinary change would look like a cut.
_LEAST_KEPT = 3


def _seconds(default: float | None, meaning: str) -> Any:
    return parameter(default, meaning, unit="s", low=0, high=60)


@dataclass(frozen=True, kw_only=True)
class AlarmParams(Parameters):
    """Parameters of the alarms; each detector has its own alarm with these parameters.

    :func:`alarm_params` adds the floor of each detector as ``NAME_floor``.

    Examples
    --------
    >>> import oppload_cli as oppload
    >>> oppload.AlarmParams(hold_s=1).hold_s
    1.0
    >>> oppload.AlarmParams(hold_s=-1)  # doctest: +ELLIPSIS
    Traceback (most recent call last):
    ...
    oppload_cli.errors.ParameterError: ...
    """

    on: bool = parameter(True, "whether there are alarms at all")
    factor: float | None = parameter(
        None,
        "the alarm's threshold is this many times the median response of the background, but at "
        "least the floor; auto: the detector's own, 8 of most and 0 of OppLoD",
        low=0,
        high=1e6,
    )
    background_s: float = parameter(
        4.0,
        "length of the background, which ends guard_s before the latest frame",
        low=0.1,
        high=3600,
    )
    guard_s: float = _seconds(0.2, "time before the latest frame that the background leaves out")
    enough_s: float | None = _seconds(
        None,
        "evidence must be above the threshold for this time before the alarm starts; 0: one frame "
        "is enough; auto: the detector's own, 0 of most",
    )
    window_s: float | None = _seconds(
        None,
        "length of the latest time in which evidence must be above the threshold for enough_s; "
        "auto: the detector's own",
    )
    release: float = parameter(
        0.5,
        "an alarm continues while evidence is above this share of the threshold",
        low=0,
        high=1,
    )
    hold_s: float = _seconds(
        0.5, "time for which an alarm continues after evidence was last above the release share"
    )
    refractory_s: float = _seconds(
        0.5, "time after the end of an alarm in which no other alarm starts"
    )
    cut_ratio: float = parameter(
        4.0,
        "a frame is a cut if its luminance change is above this many times the largest change of "
        "the 0.18 s before; 0: there are no cuts",
        low=0,
        high=1e6,
    )
    cut_share: float = parameter(
        0.5, "least share of the pixels that change in a cut", low=0, high=1
    )
    rest: float = parameter(
        5e-4, "a scene is at rest while its luminance change is at most this", low=0, high=1
    )
    blind_s: float = _seconds(
        0.35,
        "time in which frames do not count; it begins with the first frame of a video, or with the "
        "frame before a cut or the end of a rest, but at most 1/30 s earlier",
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.enough_s is not None and self.enough_s > (self.window_s or 0):
            raise ParameterError(
                "parameter 'enough_s' of alarm must be at most 'window_s' "
                f"({self.window_s or 0:g}), not {self.enough_s:g}"
            )

    def rule_of(self, name: str) -> AlarmRule:
        """Return the rule of a detector's alarm: its own, with the values that are set here.

        Raises ParameterError if its window is shorter than the time that it needs.
        """
        rule = detector_named(name).alarm
        set_here = {"floor": getattr(self, f"{name}_floor", None)}
        set_here |= {key: getattr(self, key) for key in ("factor", "enough_s", "window_s")}
        rule = rule._replace(**{k: value for k, value in set_here.items() if value is not None})
        if rule.enough_s > rule.window_s:
            raise ParameterError(
                f"parameter 'window_s' of alarm must be at least the 'enough_s' of {name}, "
                f"{rule.enough_s:g}, not {rule.window_s:g}"
            )
        return rule if self.on else rule._replace(floor=None, why_none="alarm.on is false")

    def __reduce__(self) -> tuple[object, ...]:
        # The class with the floors is made at run time, so that another process must make its own.
        names = tuple(name.removesuffix("_floor") for name in self.names() if "_floor" in name)
        return _with_floors, (names, self.as_dict())


def alarm_params(**values: float) -> AlarmParams:
    """Return the parameters of the alarms, with the floor of every detector.

    Parameters
    ----------
    **values : float
        Parameters that differ from the detectors' own, such as ``factor=10`` or
        ``opplod_floor=0.01``.

    Raises
    ------
    ParameterError
        If a name is unknown, or a value is out of range.

    Examples
    --------
    >>> import oppload_cli as oppload
    >>> oppload.alarm_params().rule_of("opplod_reference").factor
    30.0
    >>> oppload.alarm_params(opplod_floor=0.1).rule_of("opplod").floor
    0.1
    """
    return alarm_params_with(known_names()).replaced(**values)


def alarm_params_with(names: Sequence[str], **values: float) -> AlarmParams:
    """Return the parameters of the alarms, with the floors of some detectors."""
    floors = {f"{name}_floor": detector_named(name).alarm.floor for name in names}
    return _with_floors(tuple(names), {**floors, **values})


@cache  # by classes, not by names: a notebook may define a detector again under the same name
def _alarm_class(kinds: tuple[type[Detector], ...]) -> type[AlarmParams]:
    """Return the class of the alarms' parameters with a floor for each detector."""
    floors = [
        (
            f"{kind.name}_floor",
            float | None,
            parameter(
                kind.alarm.floor,
                f"an alarm of {kind.label} needs a response above this; auto: no alarm",
                low=0,
                high=1e9,
            ),
        )
        for kind in kinds
    ]
    return make_dataclass("AlarmParams", floors, bases=(AlarmParams,), frozen=True, kw_only=True)


def _with_floors(names: tuple[str, ...], values: dict[str, float | None]) -> AlarmParams:
    kinds = tuple(map(detector_named, names))
    return (_alarm_class(kinds) if kinds else AlarmParams)(**values)  # type: ignore[arg-type]


class _Steps:
    """Finds gaps, at which frames are missing, from the times of the frames."""

    def __init__(self) -> None:
        self.before: int | None = None  # time of the frame before
        self._latest: deque[int] = deque(maxlen=LATEST_STEPS)

    def gap(self, time: int) -> int:
        """Return the time since the frame before if frames are missing in between, else 0."""
        before, self.before = self.before, time
        if before is None:
            return 0
        step = time - before
        usual = median(self._latest) if self._latest else _FIRST_STEP
        self._latest.append(step)
        return step if step > _GAP * usual else 0


class Alarm:
    """The alarm of one detector over one video.

    The alarm uses past frames only, so that a robot and a video file give the same alarms. A frame
    counts if its evidence (the response; in a blind frame 0) is above the threshold. The threshold
    is `factor` times the median response of the background, and at least the detector's floor. The
    background is `background_s` seconds long and ends `guard_s` before the frame.

    Parameters
    ----------
    name : str
        Name of the detector.
    params : AlarmParams, optional
        Parameters, as returned by :func:`alarm_params`.

    Attributes
    ----------
    threshold : float
        The threshold at the latest frame. Evidence above it starts an alarm; evidence above
        `release` times the threshold keeps the alarm on. Infinite if the detector has no alarm.
    evidence : float
        The evidence of the latest frame.

    Raises
    ------
    ParameterError
        If no detector has that name, or `params` are no AlarmParams.

    Source: ``docs/alarms.md``.

    Examples
    --------
    >>> import oppload_cli as oppload
    >>> alarm = oppload.Alarm("opplod", oppload.alarm_params())
    >>> alarm.step(0.0, time_s=0.0), alarm.step(0.5, time_s=0.1), alarm.threshold
    (False, True, 0.09)
    """

    def __init__(self, name: str, params: AlarmParams | None = None) -> None:
        if not isinstance(params, AlarmParams | None):
            raise ParameterError(
                f"params must not be {params!r:.60}; give oppload_cli.alarm_params()"
            )
        self.params = params or AlarmParams()
        self._rule = self.params.rule_of(name)
        self._floor = math.inf if self._rule.floor is None else self._rule.floor
        self._background = Background(ticks(self.params.background_s), ticks(self.params.guard_s))
        # Of each recent frame with evidence above the threshold: its time, and the step to it.
        self._above: deque[tuple[int, int]] = deque()
        self._steps = _Steps()
        self._until: int | None = None  # the alarm is held until this time
        self._ready: int | None = None  # the next alarm may start from this time on
        self._on = False
        self._counted = False  # whether the latest frame began or prolonged the alarm
        self.threshold = self._floor
        self.evidence = 0.0

    def step(
        self,
        response: float,
        time_s: float,
        *,
        blind: bool = False,
    ) -> bool:
        """Take the response to the next frame.

        Parameters
        ----------
        response : float
            The detector's response, at least 0.
        time_s : float
            The frame's presentation time in seconds.
        blind : bool
            Whether the frame does not count (see :class:`Cuts`).

        Returns
        -------
        bool
            Whether the alarm is on. In the first frame after the end of an alarm it is off, even if
            this frame has enough evidence: the next alarm starts in a later frame.
        """
        time, before = ticks(time_s), self._steps.before
        is_gap = self._steps.gap(time) > 0
        held = self._until is not None and time <= self._until
        ended = self._on and not held and (is_gap or not self._counted)
        background = self._background.step(response, time)
        self.threshold = max(self._floor, self._rule.factor * background)
        share = self.params.release if self._on and not ended else 1.0
        self.evidence = 0.0 if blind else response
        above = self.evidence > share * self.threshold
        enough = self._long_enough(above, time, before)
        ready = self._ready is None or time >= self._ready
        self._counted = enough and not ended and ready
        if self._counted:
            self._until = time + ticks(self.params.hold_s)
        was_on, self._on = self._on, self._counted or held
        if was_on and not self._on:
            end = self._until if is_gap and self._until is not None else time
            self._ready = end + ticks(self.params.refractory_s)
        return self._on

    def _long_enough(self, above: bool, time: int, before: int | None) -> bool:
        oldest = time - ticks(self._rule.window_s)
        if self._rule.enough_s and before is not None:  # keep it, also if frames come rarely
            oldest = min(oldest, before)
        while self._above and self._above[0][0] < oldest:
            self._above.popleft()
        if above:
            self._above.append((time, 0 if before is None else time - before))
        # Evidence lasts from its first frame to its latest one: the step to the first is left out.
        lasted = sum(step for _, step in islice(self._above, 1, None))
        return bool(self._above) and lasted >= ticks(self._rule.enough_s)


class Cuts:
    """Finds blind frames: those after a cut, flash, luminance step, end of a rest, or gap.

    A cut, a flash or a luminance step changes most of the frame at once, far more than the frames
    before; an approaching object takes many frames to fill the frame. After a rest there is no
    inhibition yet: motion in any direction then excites all pathways for as long as the detectors
    look back. After a gap longer than `hold_s` and `blind_s` the detectors compare frames of
    different scenes, as at the start of a video.

    Parameters
    ----------
    params : AlarmParams
        The parameters `cut_ratio`, `cut_share`, `rest`, `blind_s` and `hold_s` are used.

    Source: ``docs/alarms.md``.
    """

    def __init__(self, params: AlarmParams) -> None:
        self._params = params
        self._changes: deque[tuple[int, float]] = deque()
        self._steps = _Steps()
        self._cut, self._cause = 0, ""  # the time in ticks of the latest cause, and the cause

    def step(
        self,
        photoreceptors: Map,
        change: float | None,
        time_s: float,
        *,
        stood_still: bool = False,
    ) -> str:
        """Take the next frame.

        Parameters
        ----------
        photoreceptors : ndarray of float32, shape (height, width)
            P(t), 0 to 1.
        change : float or None
            Mean of P over the frame, 0 to 1, converted to an interval of 1/30 s; None as long as
            no frames were compared.
        time_s : float
            The frame's presentation time in seconds.
        stood_still : bool
            Whether the picture stood still before, in frames that were left out as exact repeats.

        Returns
        -------
        str
            Why the frame is blind, because of this or a recent frame: ``start`` of the video,
            ``cut`` (or a flash, or a luminance step), ``rest`` (which ended), or ``gap``. Empty for
            a frame that counts.
        """
        time, before, params = ticks(time_s), self._steps.before, self._params
        is_gap = self._steps.gap(time) > ticks(max(params.hold_s, params.blind_s))
        if change is None:  # a detector may respond to the first frame too
            return "start" if params.cut_ratio and params.blind_s else ""
        oldest = time - _MEMORY
        while len(self._changes) > _LEAST_KEPT and self._changes[0][0] < oldest:
            self._changes.popleft()
        if cause := "gap" if is_gap else self._cause_in(photoreceptors, change):
            # The cut lies after the frame before, at every frame rate. But a video starts with its
            # first frame.
            from_first = cause == "start" and not stood_still
            before = time if before is None else before
            self._cut = before if from_first else max(before, time - _INTERVAL)
            self._cause = cause
        self._changes.append((time, change))
        return self._cause if time - self._cut < ticks(params.blind_s) else ""

    def _cause_in(self, photoreceptors: Map, change: float) -> str:
        before = max((earlier for _, earlier in self._changes), default=0.0)
        if not self._params.cut_ratio or change <= self._params.cut_ratio * before:
            return ""
        if before <= self._params.rest:
            return "rest" if self._changes else "start"
        # In a cut most pixels change by about the mean change. If an object approaches, few pixels
        # change much. `change` is that of an interval of 1/30 s; P may span a longer one.
        changed = np.count_nonzero(photoreceptors > photoreceptors.mean(dtype=np.float64) / 4)
        return "cut" if changed >= self._params.cut_share * photoreceptors.size else ""
