"""Thresholds of a result's alarms and true sizes from its ground truth, row by row."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from oppload_cli.detection.alarm import Alarm
from oppload_cli.detection.parameters import AlarmParams, alarm_params
from oppload_cli.errors import OpploadError, ResultError
from oppload_cli.files.reading import is_file
from oppload_cli.results.writing import SCHEMA
from oppload_cli.stimulus.truth import read_ground_truth

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from oppload_cli.results.reading import Result

    Series = NDArray[np.float64]
    Truth = dict[str, Any]


def result_threshold(result: Result, name: str) -> Series:
    """Return the threshold of a detector's alarm in each frame of a result.

    Parameters
    ----------
    result : Result
        Holds the detector's responses.
    name : str
        Of the detector.

    Returns
    -------
    ndarray, shape (n,)
        As from :func:`alarm_threshold`, by the alarm of the result's sidecar.

    Raises
    ------
    ResultError
        If the sidecar states an alarm that does not exist.
    """
    time_s = result.frames["time_s"].to_numpy(float)
    response = result.frames[f"{name}_response"].to_numpy(float)
    return alarm_threshold(time_s, response, _alarm_params(result), name)


def alarm_threshold(time_s: Series, response: Series, params: AlarmParams, name: str) -> Series:
    """Return the threshold that the alarm of a detector held each response against.

    Parameters
    ----------
    time_s, response : ndarray, shape (n,)
        Times and responses of the detector; NaN during warm-up.
    params : AlarmParams
        Of the alarm.
    name : str
        Of the detector.

    Returns
    -------
    ndarray, shape (n,)
        As ``docs/alarms.md`` defines it; NaN during warm-up.
    """
    alarm = Alarm(name, params)
    threshold = np.full(time_s.shape, np.nan)
    for frame in np.flatnonzero(np.isfinite(response)):
        alarm.step(float(response[frame]), float(time_s[frame]))
        threshold[frame] = alarm.threshold
    return threshold


def find_truth(result: Result) -> Truth | None:
    """Read the ground truth that belongs to a result.

    Parameters
    ----------
    result : Result
        Its sidecar may name a file under ``stimulus.path``, or hold the content under
        ``stimulus``; else ``{stem}.stimulus.json`` may be beside the result.

    Returns
    -------
    dict or None
        As :func:`oppload_cli.stimulus.ground_truth` gives it; None without a ground truth.

    Raises
    ------
    StimulusError
        If that file is not a ground truth.
    """
    stated = result.sidecar.get("stimulus")
    if isinstance(stated, dict):
        if isinstance(stated.get("frames"), list):
            return stated
        stated = stated.get("path")
    named = [Path(stated), result.path.parent / stated] if isinstance(stated, str) else []
    for path in (*named, result.path.with_name(f"{result.stem}.stimulus.json")):
        if is_file(path):
            return read_ground_truth(path)
    return None


def check_schema(result: Result) -> None:
    """Raise a ResultError if the sidecar of a result is that of another version."""
    schema = result.sidecar.get("schema", SCHEMA)
    if schema != SCHEMA:
        raise ResultError(
            f"{result.path}: its sidecar is of schema {schema}, not {SCHEMA}; run the input "
            "again, or remove the sidecar to read the table alone"
        )


def _alarm_params(result: Result) -> AlarmParams:
    """Return the parameters of a result's alarms; the default ones without a sidecar."""
    check_schema(result)
    stated = result.part("parameters").get("alarm", {})
    try:
        return alarm_params(**stated)
    except (OpploadError, TypeError) as error:
        raise ResultError(f"{result.path}: its sidecar has a wrong alarm ({error})") from error
