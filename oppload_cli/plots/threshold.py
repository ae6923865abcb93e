"""The threshold of an alarm over time, from the responses alone."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from oppload_cli.detection.alarm import AlarmParams
from oppload_cli.errors import OpploadError, ResultError
from oppload_cli.models.background import Background

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from oppload_cli.results.reading import Result

    Series = NDArray[np.float64]


def alarm_threshold(time_s: Series, response: Series, params: AlarmParams, model: str) -> Series:
    """Return the threshold that each response was compared with to set the alarm off.

    Parameters
    ----------
    time_s, response : ndarray, shape (n,)
        Of one model; NaN during warm-up.
    params : AlarmParams
        Of its alarm.
    model : str
        Its name, which chooses the floor.

    Returns
    -------
    ndarray, shape (n,)
        `factor` times the median response of the background, at least the floor
        (``docs/alarms.md``); NaN during warm-up.
    """
    floor = float(getattr(params, f"{model}_floor"))
    valid = np.isfinite(response)
    background = Background(params.background_s, params.guard_s)
    threshold = np.full(time_s.shape, np.nan)
    threshold[valid] = [
        max(floor, params.factor * background.step(float(value), float(time)))
        for time, value in zip(time_s[valid], response[valid], strict=True)
    ]
    return threshold


def alarm_params(result: Result) -> AlarmParams:
    """Return the parameters that a result's alarms ran with.

    Parameters
    ----------
    result : Result
        With its sidecar; the default parameters without one.

    Returns
    -------
    AlarmParams

    Raises
    ------
    ResultError
        If the sidecar states what no alarm can have.
    """
    stated = result.sidecar.get("parameters", {}).get("alarm", {})
    try:
        return AlarmParams().replaced(**stated)
    except (OpploadError, TypeError) as error:
        raise ResultError(f"{result.path}: its sidecar has a wrong alarm ({error})") from error
