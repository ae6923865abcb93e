"""What a tuning table says of one model and one condition."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from oppload_cli.tuning.present import Responses

ONSET_SHARE = 0.1


@dataclass(frozen=True)
class Measures:
    """One row of a tuning table without its condition (``docs/tuning.md``).

    Attributes
    ----------
    peak : float or None
        Largest response; None where the clip ends before there is one.
    peak_frame, peak_time_s
        When it was first reached.
    mean : float or None
        Mean over the frames with a response.
    area : float or None
        Integral of the response over time (trapezoids), response times seconds.
    onset_frame, onset_time_s
        When the response first was 10 % of the peak; None where it is always 0.
    centre_x, centre_y : float or None
        Centre of the unit that won at the peak, in stimulus pixels.
    """

    peak: float | None = None
    peak_frame: int | None = None
    peak_time_s: float | None = None
    mean: float | None = None
    area: float | None = None
    onset_frame: int | None = None
    onset_time_s: float | None = None
    centre_x: float | None = None
    centre_y: float | None = None


def measure(responses: Responses) -> Measures:
    """Measure one model's responses to one condition.

    Parameters
    ----------
    responses : Responses
        Over the clip.

    Returns
    -------
    Measures
    """
    best = responses.peak
    if best is None:
        return Measures()
    valid = np.isfinite(responses.response)
    values, times = responses.response[valid], responses.time_s[valid]
    peak = float(responses.response[best])
    onset = int(np.argmax(responses.response >= ONSET_SHARE * peak)) if peak > 0 else None
    x, y = responses.centre[best]
    return Measures(
        peak=peak,
        peak_frame=int(responses.frame[best]),
        peak_time_s=float(responses.time_s[best]),
        mean=float(values.mean()),
        area=float(np.sum((values[1:] + values[:-1]) / 2 * np.diff(times))),
        onset_frame=None if onset is None else int(responses.frame[onset]),
        onset_time_s=None if onset is None else float(responses.time_s[onset]),
        centre_x=None if np.isnan(x) else float(x),
        centre_y=None if np.isnan(y) else float(y),
    )
