"""A causal alarm: a response far above what the video has shown so far."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

from oppload_cli.errors import ParameterError, suggestion
from oppload_cli.models.background import Background
from oppload_cli.parameters import Parameters, parameter


@dataclass(frozen=True, kw_only=True)
class AlarmParams(Parameters):
    """Parameters of the alarm; each model has its own alarm with these."""

    opplod_floor: float = parameter(
        8e-4, "response of OppLoD at or below which it never alarms", low=0, high=1e9
    )
    dlgmd_floor: float = parameter(
        0.01, "response of D-LGMD at or below which it never alarms", low=0, high=1e9
    )
    factor: float = parameter(
        30.0, "response over the median of the background that alarms", low=0, high=1e6
    )
    background_s: float = parameter(
        4.0, "how far back the background reaches", unit="s", low=0.1, high=3600
    )
    guard_s: float = parameter(
        0.2, "the latest time that is not yet background", unit="s", low=0, high=60
    )
    enough: int = parameter(2, "frames above the threshold that alarm", unit="frames", low=1)
    window: int = parameter(3, "latest frames among which they are", unit="frames", low=1, high=999)
    release: float = parameter(
        0.5, "share of the threshold above which an alarm stays on", low=0, high=1
    )
    hold_s: float = parameter(
        0.5, "how long an alarm stays on after its last frame above", unit="s", low=0, high=60
    )
    refractory_s: float = parameter(
        0.5, "how long no alarm goes on once one has gone off", unit="s", low=0, high=60
    )
    cut_ratio: float = parameter(
        4.0,
        "luminance change over the largest of the 5 frames before that is a cut; 0: none is",
        low=0,
        high=1e6,
    )
    cut_share: float = parameter(0.5, "share of the frame that a cut changes", low=0, high=1)
    rest: float = parameter(5e-4, "luminance change up to which a scene is at rest", low=0, high=1)
    blind: int = parameter(
        10,
        "frames from a cut or the end of a rest that do not count",
        unit="frames",
        low=0,
        high=1000,
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.enough > self.window:
            raise ParameterError(
                f"parameter 'enough' of alarm must be at most 'window' ({self.window}), "
                f"not {self.enough}"
            )


# By preset: their responses differ in size.
ALARMS = {
    "default": AlarmParams(),
    "paper": AlarmParams(),
    "robust": AlarmParams(opplod_floor=0.02, factor=8.0, enough=1, window=1),
}


class Alarm:
    """The alarm of one model over one video.

    It knows only frames that have passed, so that it says the same on a robot as
    on a file. A frame counts when its response is above the threshold: `factor`
    times the median response of the background, the last `background_s` seconds
    without the latest `guard_s`, and at least the model's floor.

    Parameters
    ----------
    model : str
        Whose responses these are: ``opplod`` or ``dlgmd``.
    params : AlarmParams, optional
        Its parameters.

    Attributes
    ----------
    threshold : float
        The response above which the latest frame sets the alarm off; above `release`
        times this it keeps it on.

    Raises
    ------
    ParameterError
        If there is no such model.

    Source: ``docs/alarms.md``.
    """

    def __init__(self, model: str, params: AlarmParams | None = None) -> None:
        self.params = params or AlarmParams()
        floors = {"opplod": self.params.opplod_floor, "dlgmd": self.params.dlgmd_floor}
        if model not in floors:
            raise ParameterError(f"no model '{model}' has an alarm{suggestion(model, floors)}")
        self._floor = floors[model]
        self._background = Background(self.params.background_s, self.params.guard_s)
        self._above: deque[bool] = deque(maxlen=self.params.window)
        self._until_s = self._ready_s = -math.inf
        self._on = False
        self.threshold = self._floor

    def step(self, response: float, time_s: float, *, blind: bool = False) -> bool:
        """Take the response to the next frame.

        Parameters
        ----------
        response : float
            The model's response, at least 0.
        time_s : float
            The frame's presentation time in seconds.
        blind : bool
            Whether the frame shall not count (see :class:`oppload_cli.detection.cuts.Cuts`).

        Returns
        -------
        bool
            Whether the alarm is on.
        """
        background = self._background.step(response, time_s)
        self.threshold = max(self._floor, self.params.factor * background)
        share = self.params.release if self._on else 1.0
        self._above.append(response > share * self.threshold and not blind)
        if sum(self._above) >= self.params.enough and (self._on or time_s >= self._ready_s):
            self._until_s = time_s + self.params.hold_s
        was_on, self._on = self._on, time_s <= self._until_s
        if was_on and not self._on:
            self._ready_s = time_s + self.params.refractory_s
        return self._on
