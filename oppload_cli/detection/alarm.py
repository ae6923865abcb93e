"""A causal alarm: a response far above what the video has shown so far."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

from oppload_cli.errors import ParameterError
from oppload_cli.parameters import Parameters, parameter


@dataclass(frozen=True, kw_only=True)
class AlarmParams(Parameters):
    """Parameters of the alarm; each model has its own alarm with these."""

    factor: float = parameter(
        4.0, "response over the largest one of the background that alarms", low=1, high=1e6
    )
    background_s: float = parameter(
        4.0, "how far back the background reaches", unit="s", low=0.1, high=3600
    )
    guard_s: float = parameter(
        0.3, "the latest time that is not yet background", unit="s", low=0, high=60
    )
    opplod_floor: float = parameter(
        3e-5, "response of OppLoD at or below which it never alarms", low=0, high=1e9
    )
    dlgmd_floor: float = parameter(
        1e-3, "response of D-LGMD at or below which it never alarms", low=0, high=1e9
    )
    enough: int = parameter(3, "frames above the threshold that alarm", unit="frames", low=1)
    window: int = parameter(3, "latest frames among which they are", unit="frames", low=1, high=999)
    hold_s: float = parameter(
        0.5, "how long an alarm stays on after its last frame above", unit="s", low=0, high=60
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.enough > self.window:
            raise ParameterError(
                f"parameter 'enough' of alarm must be at most 'window' ({self.window}), "
                f"not {self.enough}"
            )


class Alarm:
    """The alarm of one model over one video.

    It knows only frames that have passed, so that it says the same on a robot as
    on a file. The threshold is `factor` times the largest response of the
    background: the last `background_s` seconds without the latest `guard_s`.

    Parameters
    ----------
    model : str
        Whose responses these are: ``opplod`` or ``dlgmd``.
    params : AlarmParams, optional
        Its parameters.

    Attributes
    ----------
    threshold : float or None
        What the latest response was held against; None without a background.
    """

    def __init__(self, model: str, params: AlarmParams | None = None) -> None:
        self.params = params or AlarmParams()
        self._floor: float = getattr(self.params, f"{model}_floor")
        # Bounded, in case times stand still.
        self._guard: deque[tuple[float, float]] = deque(maxlen=1 << 16)
        # Times and responses of the background that a later one has not outdone:
        # the first is the largest.
        self._largest: deque[tuple[float, float]] = deque()
        self._above: deque[bool] = deque(maxlen=self.params.window)
        self._until = -math.inf
        self.threshold: float | None = None

    def step(self, response: float, time_s: float) -> bool:
        """Take the response to the next frame.

        Parameters
        ----------
        response : float
            The model's response, at least 0.
        time_s : float
            The frame's presentation time in seconds.

        Returns
        -------
        bool
            Whether the alarm is on.
        """
        threshold = self._threshold(time_s)
        self.threshold = None if threshold == math.inf else threshold
        self._above.append(response > threshold)
        self._guard.append((time_s, response))
        if sum(self._above) >= self.params.enough:
            self._until = time_s + self.params.hold_s
        return time_s <= self._until

    def _threshold(self, time_s: float) -> float:
        while self._guard and self._guard[0][0] < time_s - self.params.guard_s:
            time, response = self._guard.popleft()
            while self._largest and self._largest[-1][1] <= response:
                self._largest.pop()
            self._largest.append((time, response))
        while self._largest and self._largest[0][0] < time_s - self.params.background_s:
            self._largest.popleft()
        if not self._largest:
            return math.inf  # nothing to compare with yet
        background = self._largest[0][1]
        return max(self._floor, self.params.factor * background)
