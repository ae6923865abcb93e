"""What is known of one frame once every model has answered."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

from oppload_cli.models.dlgmd import DlgmdResponse

if TYPE_CHECKING:
    from oppload_cli.models.opplod import Box, OpplodResponse
    from oppload_cli.motion.rmo import RmoMetrics
    from oppload_cli.results.table import Value


class Detection(NamedTuple):
    """One looming object in one frame: a line of ``detections.jsonl``.

    Attributes
    ----------
    identity : int
        The same object has the same number in all its frames; from 1.
    box : Box
        Where it is, in source pixels, within the frame.
    centre_x, centre_y : float
        Focus of its expansion in source pixels.
    response : float
        OppLoD's enhanced response there, at least 0.
    alarm : bool
        Whether the alarm is on, and because of this object.
    time_to_contact_s : float or None
        Estimate in seconds, above 0; None where it is not determined.
    """

    identity: int
    box: Box
    centre_x: float
    centre_y: float
    response: float
    alarm: bool
    time_to_contact_s: float | None


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
    responses : dict of str to response or None
        By model; None during warm-up. Boxes are in source pixels.
    alarms : dict of str to bool
        By model, those that have answered.
    rmo : RmoMetrics or None
        Radial motion opponency; None for the first frame, or if not measured.
    repeat : bool
        Whether the frame is an exact repeat of the one before.
    thresholds : dict of str to float
        By model, the response above which this frame sets the alarm off.
    detections : tuple of Detection
        OppLoD's looming objects, the largest response first.
    """

    frame: int
    time_s: float
    luma_change: float | None
    responses: dict[str, OpplodResponse | DlgmdResponse | None]
    alarms: dict[str, bool] = field(default_factory=dict)
    rmo: RmoMetrics | None = None
    repeat: bool = False
    thresholds: dict[str, float] = field(default_factory=dict)
    detections: tuple[Detection, ...] = ()

    def values(self) -> dict[str, Value]:
        """Return the values by column; what is not there is an empty cell.

        Returns
        -------
        dict of str to float, int or None
        """
        values: dict[str, Value] = {
            "frame": self.frame,
            "time_s": self.time_s,
            "luma_change": self.luma_change,
        }
        for model, response in self.responses.items():
            if response is not None:
                values[f"{model}_response"] = response.response
                values[f"{model}_alarm"] = self.alarms[model]
            if isinstance(response, DlgmdResponse):
                values[f"{model}_s"] = response.s
            elif response is not None and response.box is not None:
                values.update((f"{model}_{side}", v) for side, v in response.box._asdict().items())
        if self.rmo is not None:
            values.update(self.rmo._asdict())
        return values
