"""One row of ``frames.csv``, and the summary of a run."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any

from oppload_cli.models.registry import detector_named
from oppload_cli.results.columns import RMO, VIEW

if TYPE_CHECKING:
    from collections.abc import Mapping

    from oppload_cli.detection.places import Detection
    from oppload_cli.files.tables import Value
    from oppload_cli.models.detector import Box, Response
    from oppload_cli.motion.rmo import RmoMetrics


@dataclass(frozen=True)
class FrameRecord:
    """One row of ``frames.csv``.

    Attributes
    ----------
    frame : int
        Decode ordinal in the whole input, from 0.
    time_s : float
        Presentation time minus that of frame 0.
    luma_change : float or None
        Mean of P; None for the first frame.
    responses : mapping of str to Response or None
        By detector; None during warm-up. Boxes are in source pixels.
    alarms : dict of str to bool
        By detector; False during warm-up.
    rmo : RmoMetrics or None
        Radial motion opponency; None for the first frame, or if not measured.
    repeat : str
        ``exact`` or ``near`` for a frame that repeats the picture before it, else empty.
    thresholds : dict of str to float
        By detector, the response above which this frame sets the alarm off.
    detections : tuple of Detection
        The looming objects that the first detector with places sees, the largest response
        first.
    objects : dict of str to Detection or None
        By detector with places, its strongest looming object.
    blind : bool
        Whether the frame does not count for an alarm.

    Examples
    --------
    >>> import oppload_cli as oppload
    >>> first, *_, last = oppload.analyse("controls/looming-perspective", rmo=False)
    >>> first.values().keys() == last.values().keys()
    True
    >>> first.values()["opplod_response"] is None, last.alarms
    (True, {'opplod': True, 'dlgmd': True})
    """

    frame: int
    time_s: float
    luma_change: float | None
    responses: Mapping[str, Response | None]
    alarms: dict[str, bool] = field(default_factory=dict)
    rmo: RmoMetrics | None = None
    repeat: str = ""
    thresholds: dict[str, float] = field(default_factory=dict)
    detections: tuple[Detection, ...] = ()
    objects: dict[str, Detection | None] = field(default_factory=dict)
    blind: bool = False

    @property
    def boxes(self) -> dict[str, Box | None]:
        """By detector with places, the box of its strongest looming object in source pixels."""
        return {name: None if each is None else each.box for name, each in self.objects.items()}

    def over_threshold(self, model: str) -> float | None:
        """Return a detector's response over its threshold; None where there is no threshold."""
        response, threshold = self.responses.get(model), self.thresholds.get(model, 0.0)
        if response is None or not 0 < threshold < math.inf:
            return None
        return response.response / threshold

    def values(self) -> dict[str, Value]:
        """Return the values by column, the same columns for every frame.

        A missing value is None: a response during warm-up, a box where nothing looms, RMO
        where it was not measured, degrees where the field of view is not known.

        Returns
        -------
        dict of str to float, int or None
        """
        values: dict[str, Value] = {
            "frame": self.frame,
            "time_s": self.time_s,
            "luma_change": self.luma_change,
        }
        for name, response in self.responses.items():
            detector = detector_named(name)
            values[f"{name}_response"] = None if response is None else response.response
            values[f"{name}_alarm"] = self.alarms.get(name, False)
            if detector.places:
                found = self.objects.get(name)
                box = (None,) * 4 if found is None else found.box
                unit = (
                    (None,) * 2 if response is None or response.box is None else response.box.centre
                )
                sides = ("x", "y", "width", "height", "unit_x", "unit_y")
                values.update(
                    (f"{name}_{side}", value)
                    for side, value in zip(sides, (*box, *unit), strict=True)
                )
                view = None if found is None else found.view
                values.update(
                    (f"{name}_{each.name}", getattr(view, each.name, None)) for each in VIEW
                )
            for column in (*detector.columns, *detector.details):
                values[f"{name}_{column.name}"] = getattr(response, column.name, None)
        values.update({each.name: getattr(self.rmo, each.name, None) for each in RMO})
        return values


@dataclass
class ModelSummary:
    """Summary of one detector over one input.

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
            The detector that this summary is of.
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
