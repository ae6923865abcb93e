"""The threshold of an alarm over time, from the responses alone."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from oppload_cli.detection.alarm import AlarmParams
from oppload_cli.errors import OpploadError, ResultError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from oppload_cli.results.reading import Result

    Series = NDArray[np.float64]


def alarm_threshold(time_s: Series, response: Series, params: AlarmParams, model: str) -> Series:
    """Return the threshold that the next response was compared with, frame by frame.

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
        `factor` times the largest response of the background, at least the floor;
        NaN before there is a background (``docs/model.md``, "Alarms").
    """
    floor = float(getattr(params, f"{model}_floor"))
    valid = np.isfinite(response)
    times, values = time_s[valid], response[valid]
    first = np.searchsorted(times, times - params.background_s)
    last = np.searchsorted(times, times - params.guard_s)
    threshold = np.full(time_s.shape, np.nan)
    threshold[valid] = [
        max(floor, params.factor * float(values[a:b].max())) if b > a else np.nan
        for a, b in zip(first, last, strict=True)
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
