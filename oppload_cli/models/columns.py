"""The columns of ``frames.csv``: name, unit, meaning, and where a record has the value.

A column that all results have, or all detectors, is declared here and nowhere else. The columns
that only one detector has are declared in its class.
"""

from __future__ import annotations

from functools import cache
from operator import attrgetter
from typing import TYPE_CHECKING, Any, NamedTuple

from oppload_cli.files.tables import Seconds

if TYPE_CHECKING:
    from collections.abc import Callable

    from oppload_cli.files.tables import Cell
    from oppload_cli.models.detector import Column, Detector

    # Takes a FrameRecord or a DetectorRecord of :mod:`oppload_cli.results.record`.
    Value = Callable[[Any], Cell]

USUAL, ALL, DEGREES = "usual", "all", "degrees"  # the tables that have a column


class RecordColumn(NamedTuple):
    """A column, with a function that takes its value from a record."""

    name: str
    unit: str
    meaning: str
    value: Value
    of: str = USUAL  # all: with ``--columns all``; degrees: if the field of view is known


def _time(record: Any) -> Seconds:
    return Seconds(record.time_s)


def _rmo(name: str) -> Value:
    return lambda record: getattr(record.rmo, name, None)


def _box(name: str) -> Value:
    return lambda said: getattr(said.box, name, None)


def _unit(axis: int) -> Value:
    def value(said: Any) -> Cell:
        box = said.answer and said.answer.box
        return float(box.centre[axis]) if box else None

    return value


def _object(name: str) -> Value:
    return lambda said: getattr(said.object, name, None)


def _view(name: str) -> Value:
    return lambda said: getattr(said.object and said.object.view, name, None)


def _inner(name: str) -> Value:
    return lambda said: getattr(said.answer, name, None)


COMMON = (
    RecordColumn(
        "frame", "", "number of the frame in the complete input, from 0", attrgetter("frame")
    ),
    RecordColumn("time_s", "s", "presentation time of the frame, from frame 0 on", _time),
    RecordColumn(
        "luma_change",
        "0 to 1",
        "mean over the frame of P, the absolute luminance change in an interval; 0 for a repeat, "
        "empty as long as no frames can be compared",
        attrgetter("luma_change"),
    ),
    RecordColumn(
        "blind",
        "text",
        "why the frame does not count for alarms: start (of the video), cut (or flash), rest (that "
        "ended) or gap; empty if it counts",
        attrgetter("blind"),
        ALL,
    ),
)
RMO = (
    RecordColumn(
        "flow_vectors",
        "",
        "number of motion vectors that were kept; this column and the next five are empty for the "
        "first frame",
        _rmo("flow_vectors"),
    ),
    RecordColumn(
        "rom_pairs",
        "",
        "number of pairs of vectors that are opposite and point outward",
        _rmo("rom_pairs"),
    ),
    RecordColumn(
        "rom_share", "0 to 1", "share of these pairs among all pairs of kept vectors",
        _rmo("rom_share"),
    ),
    RecordColumn(
        "rmo_mean", "0 to 1", "mean radial motion opponency over these pairs", _rmo("rmo_mean")
    ),
    RecordColumn("rmo_max", "0 to 1", "largest radial motion opponency", _rmo("rmo_max")),
    RecordColumn(
        "rmo_index",
        "-1 to 1",
        "balance of outward and inward opponency: 1 for expansion, -1 for contraction, "
        "0 for translation, rotation and noise",
        _rmo("rmo_index"),
    ),
)  # fmt: skip
FRAME = COMMON + RMO
# Columns of each detector; `response` and `alarm` have the unit and meaning of the detector.
_RESPONSE = RecordColumn("response", "", "", attrgetter("response"))
_JUDGED = (
    RecordColumn(
        "threshold",
        "",
        "threshold of the alarm in this frame; empty without an alarm",
        lambda said: said.threshold if said.threshold < float("inf") else None,
    ),
    RecordColumn("alarm", "0 or 1", "", lambda said: int(said.alarm)),
)
# Columns of each detector with places: the box, the winning unit and the time to contact.
PLACE = (
    RecordColumn("x", "source px", "left edge of the strongest looming object's box", _box("x")),
    RecordColumn("y", "source px", "top edge of the strongest looming object's box", _box("y")),
    RecordColumn(
        "width", "source px", "width of the strongest looming object's box", _box("width")
    ),
    RecordColumn(
        "height", "source px", "height of the strongest looming object's box", _box("height")
    ),
    RecordColumn(
        "unit_x", "source px", "centre of the winning unit's field, from the left", _unit(0)
    ),
    RecordColumn(
        "unit_y", "source px", "centre of the winning unit's field, from the top", _unit(1)
    ),
    RecordColumn(
        "contact_s",
        "s",
        "time to contact of the strongest looming object; empty if it is not known",
        attrgetter("contact_s"),
    ),
    RecordColumn(
        "azimuth_deg",
        "deg",
        "direction of the focus of expansion, right of the middle",
        _view("azimuth_deg"),
        DEGREES,
    ),
    RecordColumn(
        "elevation_deg",
        "deg",
        "direction of the focus of expansion, above the horizontal plane",
        _view("elevation_deg"),
        DEGREES,
    ),
    RecordColumn(
        "angular_width_deg",
        "deg",
        "horizontal angle that the box spans",
        _view("angular_width_deg"),
        DEGREES,
    ),
    RecordColumn(
        "angular_height_deg",
        "deg",
        "vertical angle that the box spans",
        _view("angular_height_deg"),
        DEGREES,
    ),
    RecordColumn(
        "angular_size_deg",
        "deg",
        "the larger of the two angles that the box spans",
        _view("angular_size_deg"),
        DEGREES,
    ),
    RecordColumn(
        "angular_speed_deg_s",
        "deg/s",
        "growth of the angular size, computed from the time to contact; empty if that is not known",
        _view("angular_speed_deg_s"),
        DEGREES,
    ),
)
VIEW = tuple(column for column in PLACE if column.of == DEGREES)
_OVER_THRESHOLD = RecordColumn(
    "over_threshold",
    "",
    "response divided by the alarm's threshold; empty without one",
    attrgetter("over_threshold"),
    ALL,
)
_PLACE_DETAILS = (
    RecordColumn(
        "evidence_over_threshold",
        "",
        "evidence divided by the alarm's threshold; evidence is the response, and 0 in a blind "
        "frame. If this is above 1 the frame counts for the alarm",
        lambda said: said.multiple(said.evidence),
        ALL,
    ),
    RecordColumn(
        "contact_error_s",
        "s",
        "error of the time to contact; on rendered approaches the true time is usually within "
        "twice this error",
        _object("time_to_contact_error_s"),
        ALL,
    ),
)


@cache
def columns_of(
    detector: type[Detector], *, details: bool = False, degrees: bool = False
) -> tuple[RecordColumn, ...]:
    """Return the columns of a detector; their names begin with its name.

    Parameters
    ----------
    detector : type of Detector
        Its response and its own columns are among them; if it has places, the box too.
    details : bool
        Whether to include the inner values and the values behind the alarm (``--columns all``).
    degrees : bool
        Whether to include the columns in degrees of the strongest looming object (``--fov``).
    """
    tables = {USUAL, *((ALL,) if details else ()), *((DEGREES,) if degrees else ())}
    unit, meaning = detector.response_column
    threshold, alarm = _JUDGED
    columns = [
        _RESPONSE._replace(unit=unit, meaning=meaning),
        threshold,
        alarm._replace(meaning=f"1 while the alarm of {detector.label} is on, else 0"),
    ]
    if detector.places:
        columns += PLACE
    columns += (_own(column, USUAL) for column in detector.columns)
    columns += (_own(column, ALL) for column in detector.details)
    columns.append(_OVER_THRESHOLD)
    if detector.places:
        columns += _PLACE_DETAILS
    return tuple(
        column._replace(name=f"{detector.name}_{column.name}")
        for column in columns
        if column.of in tables
    )


def _own(column: Column, of: str) -> RecordColumn:
    return RecordColumn(*column, _inner(column.name), of)
