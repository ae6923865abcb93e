"""What is known of one frame: the record that tables, plots, pages and videos read."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from oppload_cli.errors import ParameterError, suggestion
from oppload_cli.models.columns import FRAME, columns_of
from oppload_cli.models.registry import detector_named, placing_detector

if TYPE_CHECKING:
    from collections.abc import Mapping

    from oppload_cli.detection.places import Detection
    from oppload_cli.files.tables import Cell
    from oppload_cli.models.detector import Box, Response
    from oppload_cli.motion.rmo import RmoMetrics


@dataclass(frozen=True)
class DetectorRecord:
    """What one detector says of one frame.

    Attributes
    ----------
    answer : Response or None
        Everything that the detector returned, its box in source pixels; None during warm-up.
    alarm : bool
        Whether the alarm is on; False during warm-up.
    threshold : float
        The threshold of the alarm in this frame; infinite if the detector has no alarm.
    evidence : float or None
        The number that the alarm compares with the threshold: the response, and 0 in a blind frame.
    objects : tuple of Detection
        The looming objects, the largest response first; empty for a detector without places.

    Examples
    --------
    >>> import oppload_cli as oppload
    >>> records = list(oppload.analyse("controls/looming-perspective", rmo=False))
    >>> said = records[90]["opplod"]
    >>> said.alarm, said.response > said.threshold
    (True, True)
    """

    answer: Response | None = None
    alarm: bool = False
    threshold: float = math.inf
    evidence: float | None = None
    objects: tuple[Detection, ...] = ()

    @property
    def response(self) -> float | None:
        """The response, at least 0; None during warm-up."""
        return None if self.answer is None else self.answer.response

    @property
    def object(self) -> Detection | None:
        """The strongest looming object; None if there is none."""
        return self.objects[0] if self.objects else None

    @property
    def box(self) -> Box | None:
        """The box of the strongest looming object in source pixels; None if there is none."""
        return None if self.object is None else self.object.box

    @property
    def contact_s(self) -> float | None:
        """Time to contact of the strongest looming object in seconds, above 0; None if unknown."""
        return None if self.object is None else self.object.time_to_contact_s

    @property
    def over_threshold(self) -> float | None:
        """The response divided by the threshold; None without a response or a threshold."""
        return self.multiple(self.response)

    def multiple(self, value: float | None) -> float | None:
        """Return a value divided by the threshold; None if one of them is missing."""
        has_threshold = 0 < self.threshold < math.inf
        return value / self.threshold if value is not None and has_threshold else None

    def after(self, passed_s: float) -> DetectorRecord:
        """Return the same record for a repeat, `passed_s` seconds later."""
        return replace(self, objects=tuple(found.after(passed_s) for found in self.objects))


@dataclass(frozen=True)
class FrameRecord:
    """One row of ``frames.csv``; ``record["opplod"]`` is what a detector says of the frame.

    Attributes
    ----------
    frame : int
        Number of the frame in the complete input, in the order of decoding, from 0.
    time_s : float
        Presentation time minus that of frame 0, in seconds.
    luma_change : float or None
        Mean of P; None for the first frame.
    detectors : mapping of str to DetectorRecord
        What each detector says, by its name.
    rmo : RmoMetrics or None
        Radial motion opponency; None for the first frame, or if not measured.
    repeat : str
        ``exact`` or ``near`` for a frame that repeats the picture before it, else empty.
    blind : str
        Why the frame does not count for an alarm: ``start``, ``cut``, ``rest`` or ``gap`` (see
        ``docs/alarms.md``); empty if it counts.

    Examples
    --------
    >>> import oppload_cli as oppload
    >>> first, *_, last = oppload.analyse("controls/looming-perspective", rmo=False)
    >>> first.values().keys() == last.values().keys()
    True
    >>> first["opplod"].response is None, last["opplod"].alarm, last["dlgmd"].alarm
    (True, True, True)
    """

    frame: int
    time_s: float
    luma_change: float | None
    detectors: Mapping[str, DetectorRecord] = field(default_factory=dict)
    rmo: RmoMetrics | None = None
    repeat: str = ""
    blind: str = ""

    def __getitem__(self, name: str) -> DetectorRecord:
        """Return what a detector says; one that did not run is a ParameterError."""
        name = str(name)  # a caller may give a list or an array, in spite of the type
        if name not in self.detectors:
            raise ParameterError(
                f"'{name}' has no response in this record{suggestion(name, self.detectors)}"
            )
        return self.detectors[name]

    @property
    def detections(self) -> tuple[Detection, ...]:
        """The looming objects of the first detector that has places, largest response first."""
        placing = placing_detector(self.detectors)
        return self.detectors[placing.name].objects if placing else ()

    def values(self) -> dict[str, Cell]:
        """Return the values by column; the columns are the same for every frame.

        A missing value is None: a response during warm-up, a box if nothing looms, RMO if it was
        not measured, degrees if the field of view is not known. An alarm is 0 or 1, as in the
        table.
        """
        values: dict[str, Cell] = {column.name: column.value(self) for column in FRAME}
        for name, said in self.detectors.items():
            columns = columns_of(detector_named(name), details=True, degrees=True)
            values.update((column.name, column.value(said)) for column in columns)
        return values
