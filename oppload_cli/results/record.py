"""What is known of one frame once every model has answered."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from oppload_cli.models.opplod import OpplodResponse

if TYPE_CHECKING:
    from oppload_cli.models.dlgmd import DlgmdResponse
    from oppload_cli.results.table import Value


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
    repeat : bool
        Whether the frame is an exact repeat of the one before.
    """

    frame: int
    time_s: float
    luma_change: float | None
    responses: dict[str, OpplodResponse | DlgmdResponse | None]
    alarms: dict[str, bool] = field(default_factory=dict)
    repeat: bool = False

    def row(self) -> list[Value]:
        """Return the values in the order of :func:`oppload_cli.results.columns.columns_for`.

        Returns
        -------
        list of float, int or None
        """
        row: list[Value] = [self.frame, self.time_s, self.luma_change]
        for model, response in self.responses.items():
            row += [response.response if response else None, self.alarms.get(model)]
            if model == "opplod":
                row += _box(response)
            else:
                row.append(None if response is None else getattr(response, "s", None))
        return row


def _box(response: OpplodResponse | DlgmdResponse | None) -> list[Value]:
    if not isinstance(response, OpplodResponse) or response.box is None:
        return [None] * 4
    return [response.box.x, response.box.y, response.box.width, response.box.height]
