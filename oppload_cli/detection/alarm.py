"""The alarm: on if a response is far above recent responses, or if contact is near."""

from __future__ import annotations

import math
from collections import deque
from fractions import Fraction
from itertools import islice
from statistics import median
from typing import TYPE_CHECKING

import numpy as np

from oppload_cli.detection.parameters import AlarmParams
from oppload_cli.models.presets import REFERENCE_INTERVAL
from oppload_cli.models.timebase import ROUNDING_S, Background

if TYPE_CHECKING:
    from oppload_cli.models.dpc import Map


_LATEST_STEPS = 15  # the usual step is the median of the latest 15 steps between frames
_FIRST_STEP_S = 0.1  # the usual step before any step is known
_INTERVAL_S = float(Fraction(REFERENCE_INTERVAL))
_SAME_S = 1e-6  # sums and differences of times are equal if they differ by less
_GAP = 2.0  # a step longer than 2 usual steps is a gap: frames are missing


class _Steps:
    """Finds gaps, at which frames are missing, from the times of the frames."""

    def __init__(self) -> None:
        self.before_s = -math.inf  # time of the frame before
        self._latest: deque[float] = deque(maxlen=_LATEST_STEPS)

    def gap_s(self, time_s: float) -> float:
        """Return the time since the frame before if frames are missing in between, else 0."""
        before_s, self.before_s = self.before_s, time_s
        if before_s == -math.inf:
            return 0.0
        step_s = time_s - before_s
        usual_s = median(self._latest) if self._latest else _FIRST_STEP_S
        self._latest.append(step_s)
        return step_s if step_s > _GAP * usual_s + ROUNDING_S else 0.0


class Alarm:
    """The alarm of one detector over one video.

    The alarm uses past frames only, so that a robot and a video file give the same alarms. A frame
    counts if its evidence (:meth:`AlarmParams.evidence`) is above the threshold. The threshold is
    `factor` times the median response of the background, and at least the detector's floor. The
    background is `background_s` seconds long and ends `guard_s` before the frame.

    Parameters
    ----------
    name : str
        Name of the detector.
    params : AlarmParams, optional
        Parameters, as returned by :func:`~oppload_cli.detection.parameters.alarm_params`.

    Attributes
    ----------
    threshold : float
        The threshold at the latest frame. Evidence above it starts an alarm; evidence above
        `release` times the threshold keeps the alarm on. Infinite if `params` has alarms off.
    evidence : float
        The evidence of the latest frame.

    Raises
    ------
    ParameterError
        If no detector has that name.

    Source: ``docs/alarms.md``.

    Examples
    --------
    >>> import oppload_cli as oppload
    >>> alarm = oppload.Alarm("opplod", oppload.alarm_params("default"))
    >>> alarm.step(0.0, time_s=0.0), alarm.step(0.5, time_s=0.1), alarm.threshold
    (False, True, 0.06)
    """

    def __init__(self, name: str, params: AlarmParams | None = None) -> None:
        self.params = params or AlarmParams()
        self._floor = self.params.floor_of(name) if self.params.on else math.inf
        self._background = Background(self.params.background_s, self.params.guard_s)
        self._above: deque[tuple[float, float]] = deque()
        self._steps = _Steps()
        self._until_s = self._ready_s = -math.inf
        self._on = self._counted = False
        self.threshold = self._floor
        self.evidence = 0.0

    def step(
        self,
        response: float,
        time_s: float,
        *,
        contact_s: float | None = None,
        blind: bool = False,
        sudden: bool = False,
    ) -> bool:
        """Take the response to the next frame.

        Parameters
        ----------
        response : float
            The detector's response, at least 0.
        time_s : float
            The frame's presentation time in seconds.
        contact_s : float, optional
            Time to contact in seconds of the object with the largest response, above 0; None if
            not known.
        blind : bool
            Whether the frame does not count (see :class:`Cuts`).
        sudden : bool
            Whether no alarm may start with the response
            (:attr:`~oppload_cli.models.detector.Response.sudden`).

        Returns
        -------
        bool
            Whether the alarm is on. In the first frame after the end of an alarm it is off, even if
            this frame has enough evidence: the next alarm starts in a later frame.
        """
        before_s = self._steps.before_s
        is_gap = self._steps.gap_s(time_s) > 0
        held = time_s <= self._until_s + ROUNDING_S
        ended = self._on and not held and (is_gap or not self._counted)
        background = self._background.step(response, time_s)
        self.threshold = max(self._floor, self.params.factor * background)
        share = self.params.release if self._on and not ended else 1.0
        self.evidence = self.params.evidence(response, contact_s)
        above = self.evidence > share * self.threshold and not blind and (self._on or not sudden)
        enough = self._long_enough(above, time_s, before_s)
        self._counted = enough and not ended and time_s >= self._ready_s - ROUNDING_S
        if self._counted:
            self._until_s = time_s + self.params.hold_s
        was_on, self._on = self._on, self._counted or held
        if was_on and not self._on:
            self._ready_s = (self._until_s if is_gap else time_s) + self.params.refractory_s
        return self._on

    def _long_enough(self, above: bool, time_s: float, before_s: float) -> bool:
        oldest = time_s - self.params.window_s
        if self.params.enough_s:  # keep the frame before, also if frames come rarely
            oldest = min(oldest - _SAME_S, before_s)
        while self._above and self._above[0][0] < oldest:
            self._above.popleft()
        if above:
            self._above.append((time_s, time_s - before_s))
        # Evidence lasts from its first frame to its latest one: the step to the first is left out.
        lasted_s = math.fsum(lasted for _, lasted in islice(self._above, 1, None))
        return bool(self._above) and lasted_s >= self.params.enough_s - _SAME_S


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

    MEMORY_S = 0.18  # a luminance change is compared with the changes of this latest time
    # At least this number of latest changes is kept, whatever their age. Noise does not grow with
    # the time between frames, so that the change per interval is small after lost frames. If only
    # this small change were kept, the next, ordinary change would look like a cut.
    LEAST_KEPT = 3

    def __init__(self, params: AlarmParams) -> None:
        self._params = params
        self._changes: deque[tuple[float, float]] = deque()
        self._steps = _Steps()
        self._cut_s, self._cause = -math.inf, ""

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
            Mean of P over the frame, 0 to 1; None for the first frame.
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
        before_s = self._steps.before_s
        least_s = max(self._params.hold_s, self._params.blind_s)
        is_gap = self._steps.gap_s(time_s) > least_s + ROUNDING_S
        if change is None:  # a detector may respond to the first frame too
            return "start" if self._params.cut_ratio and self._params.blind_s else ""
        while len(self._changes) > self.LEAST_KEPT and self._changes[0][0] < time_s - self.MEMORY_S:
            self._changes.popleft()
        if cause := "gap" if is_gap else self._cause_in(photoreceptors, change):
            # The cut lies after the frame before, at every frame rate. But a video starts with its
            # first frame.
            from_first = cause == "start" and not stood_still
            self._cut_s = before_s if from_first else max(before_s, time_s - _INTERVAL_S)
            self._cause = cause
        self._changes.append((time_s, change))
        return self._cause if time_s - self._cut_s < self._params.blind_s else ""

    def _cause_in(self, photoreceptors: Map, change: float) -> str:
        before = max((earlier for _, earlier in self._changes), default=0.0)
        if not self._params.cut_ratio or change <= self._params.cut_ratio * before:
            return ""
        if before <= self._params.rest:
            return "rest" if self._changes else "start"
        # In a cut most pixels change by about the mean change. If an object approaches, few pixels
        # change much.
        changed = np.count_nonzero(photoreceptors > change / 4)
        return "cut" if changed >= self._params.cut_share * photoreceptors.size else ""
