"""Shows a stimulus to detectors and measures the responses; no video is written."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from oppload_cli.pipeline.analysis import analyse
from oppload_cli.pipeline.sources import StimulusVideo
from oppload_cli.stimulus.truth import contact_time, display_facts, frame_truth
from oppload_cli.video.optics import Optics

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from oppload_cli.pipeline.settings import Settings
    from oppload_cli.stimulus.protocol import Protocol

    Series = NDArray[np.float64]


_ONSET_SHARE = 0.1  # of the peak, which the response reaches at its onset


@dataclass(frozen=True)
class Responses:
    """The responses of one detector to the n frames of one stimulus."""

    frame: Series  # (n,)
    time_s: Series  # (n,)
    response: Series  # (n,); NaN during warm-up
    # (n, 4): the receptive field of the winning unit: left, top, width and height in stimulus
    # pixels; NaN without one.
    box: Series

    @property
    def centre(self) -> Series:
        """Centres of the winning units, (n, 2): (x, y) in stimulus pixels."""
        return self.box[:, :2] + self.box[:, 2:] / 2

    @property
    def peak(self) -> int | None:
        """Position of the largest response, the first one of equals; None without a response."""
        if not np.isfinite(self.response).any():
            return None
        return int(np.nanargmax(self.response))

    @property
    def largest(self) -> float:
        """The largest response; 0 without a response."""
        return 0.0 if self.peak is None else float(self.response[self.peak])

    def presentations(self, protocol: Protocol) -> list[Responses]:
        """Return the responses to each presentation, with frames and times of the first one.

        The responses in the pause before the motion are left out: the object of the presentation
        before vanishes there, and detectors respond to that too.
        """
        count = protocol.frame_count
        moving = self.time_s[:count] >= protocol.timing.before_s
        return [
            Responses(
                self.frame[:count],
                self.time_s[:count],
                np.where(moving, self.response[first : first + count], np.nan),
                self.box[first : first + count],
            )
            for first in range(0, len(self.frame), count)
        ]


def present(
    protocol: Protocol, settings: Settings, times: int = 1, indicator_s: float = 0.0
) -> dict[str, Responses]:
    """Show a stimulus to the detectors, and return the responses by detector.

    Without an indicator, the responses are those that ``oppload run`` writes for the stimulus's
    lossless video.

    Parameters
    ----------
    protocol : Protocol
        The stimulus.
    settings : Settings
        Detectors, their parameters and the working height.
    times : int
        Number of presentations in a row.
    indicator_s : float
        Time constant in s of a calcium indicator that shows the responses; 0 for none.
    """
    video = StimulusVideo(protocol, settings.pixels, times, settings.other_heights)
    settings = seen_in(video, settings)
    params, repeats, time = settings.model_params(), settings.repeats, settings.time
    records = list(analyse(video, params, places=None, repeats=repeats, rmo=None, time=time))
    frame = np.array([record.frame for record in records], float)
    time_s = np.array([record.time_s for record in records])
    by_detector = {}
    for detector in settings.models:
        answers = [record[detector].answer for record in records]
        boxes = np.array([(answer and answer.box) or [None] * 4 for answer in answers], float)
        response = np.array([answer and answer.response for answer in answers], float)
        signal = low_passed(response, time_s, indicator_s)
        response = np.where(np.isnan(response), np.nan, signal)
        by_detector[detector] = Responses(frame, time_s, response, boxes)
    return by_detector


def seen_in(video: StimulusVideo, settings: Settings) -> Settings:
    """Return settings with the sizes in degrees converted to pixels of a stimulus's frames."""
    display = video.protocol.display
    optics = Optics.of_display(display_facts(display), display.width, display.height)
    return settings.seen_through(optics, video.working)


def low_passed(values: Series, time_s: Series, constant_s: float) -> Series:
    """Return responses as a calcium indicator shows them: after a first-order low-pass filter.

    Parameters
    ----------
    values : ndarray, shape (n, ...)
        The responses; NaN counts as 0.
    time_s : ndarray, shape (n,)
        Rising times in s.
    constant_s : float
        Time constant in s; 0 for none.
    """
    filled = np.nan_to_num(values)
    if not constant_s:
        return filled
    signal = np.zeros_like(filled)
    for index in range(1, len(filled)):
        share = 1 - math.exp(-(time_s[index] - time_s[index - 1]) / constant_s)
        signal[index] = signal[index - 1] + share * (filled[index] - signal[index - 1])
    return signal


@dataclass(frozen=True)
class Measures:
    """One row of a tuning table without its condition (``docs/tuning.md``)."""

    peak: float | None = None  # None if the stimulus ends during the warm-up
    peak_frame: int | None = None  # the first frame with the peak
    peak_time_s: float | None = None
    mean: float | None = None  # over the frames with a response
    area: float | None = None  # integral over time by trapezoids: response times seconds
    onset_frame: int | None = None  # the first frame with 10 % of a peak above 0
    onset_time_s: float | None = None
    centre_x: float | None = None  # of the winning unit at the peak, in stimulus pixels
    centre_y: float | None = None
    peak_before_contact_s: float | None = None  # below 0 after contact; None without a contact
    size_at_peak_deg: float | None = None  # of the largest object in the frame of the peak


@dataclass(frozen=True)
class Condition:
    """One stimulus of a sweep with its measures."""

    stimulus: str
    values: dict[str, Any]  # of the swept parameters, by dotted key
    measures: dict[str, Measures]  # by detector


def measure(responses: Responses, protocol: Protocol) -> Measures:
    """Measure the responses of one detector to a stimulus."""
    best = responses.peak
    if best is None:
        return Measures()
    valid = np.isfinite(responses.response)
    values, times = responses.response[valid], responses.time_s[valid]
    peak = float(responses.response[best])
    area = float(np.sum((values[1:] + values[:-1]) / 2 * np.diff(times)))
    if peak <= 0:  # a peak of 0 has no time
        return Measures(peak=peak, mean=float(values.mean()), area=area)
    frame, time_s = int(responses.frame[best]), float(responses.time_s[best])
    onset = int(np.argmax(responses.response >= _ONSET_SHARE * peak))
    x, y = (None if np.isnan(value) else float(value) for value in responses.centre[best])
    contact = contact_time(protocol)
    objects = frame_truth(protocol, frame).objects
    sizes = (shown.angular_size_deg for shown in objects if shown.visible)
    return Measures(
        peak=peak,
        peak_frame=frame,
        peak_time_s=time_s,
        mean=float(values.mean()),
        area=area,
        onset_frame=int(responses.frame[onset]),
        onset_time_s=float(responses.time_s[onset]),
        centre_x=x,
        centre_y=y,
        peak_before_contact_s=None if contact is None else contact - time_s,
        size_at_peak_deg=max((size for size in sizes if size is not None), default=None),
    )
