"""What a run says of each model in the end, gathered row by row."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from oppload_cli.results.record import FrameRecord


@dataclass
class ModelSummary:
    """Summary of one model over one input.

    Attributes
    ----------
    frames : int
        Frames with a response.
    peak : float or None
        Largest response; None where there was none.
    peak_frame, peak_time_s
        When it was first reached.
    first_response_frame, first_response_time_s
        When the response was first above 0.
    first_alarm_frame, first_alarm_time_s
        When the alarm first went on.
    alarm_frames : int
        Frames with the alarm on.
    """

    frames: int = 0
    peak: float | None = None
    peak_frame: int | None = None
    peak_time_s: float | None = None
    first_response_frame: int | None = None
    first_response_time_s: float | None = None
    first_alarm_frame: int | None = None
    first_alarm_time_s: float | None = None
    alarm_frames: int = 0

    def add(self, record: FrameRecord, model: str) -> None:
        """Take one frame's record.

        Parameters
        ----------
        record : FrameRecord
            The frame.
        model : str
            Which model this summary is of.
        """
        answer = record.responses[model]
        if answer is None:
            return
        self.frames += 1
        if self.peak is None or answer.response > self.peak:
            self.peak, self.peak_frame, self.peak_time_s = (
                answer.response,
                record.frame,
                record.time_s,
            )
        if answer.response > 0 and self.first_response_frame is None:
            self.first_response_frame, self.first_response_time_s = record.frame, record.time_s
        if record.alarms[model]:
            self.alarm_frames += 1
            if self.first_alarm_frame is None:
                self.first_alarm_frame, self.first_alarm_time_s = record.frame, record.time_s

    def as_dict(self) -> dict[str, Any]:
        """Return the summary ready for JSON.

        Returns
        -------
        dict
        """
        return asdict(self)
