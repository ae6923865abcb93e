"""The columns of ``frames.csv``: those of every result, and those of a detector.

The table, the registry and the page on formats use these definitions. The columns that only one
detector has are defined in its class.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from oppload_cli.models.detector import Column

if TYPE_CHECKING:
    from oppload_cli.models.detector import Detector


COMMON = (
    Column("frame", "", "number of the frame in the complete input, from 0"),
    Column("time_s", "s", "presentation time of the frame, from frame 0 on"),
    Column(
        "luma_change",
        "0 to 1",
        "mean over the frame of P, the absolute luminance change in an interval; 0 for a repeat, "
        "empty as long as no frames can be compared",
    ),
)
COMMON_DETAILS = (  # with `--columns all`
    Column(
        "blind",
        "text",
        "why the frame does not count for alarms: start (of the video), cut (or flash), rest (that "
        "ended) or gap; empty if it counts",
    ),
)
RMO = (
    Column(
        "flow_vectors",
        "",
        "number of motion vectors that were kept; this column and the next five are empty for the "
        "first frame",
    ),
    Column("rom_pairs", "", "number of pairs of vectors that are opposite and point outward"),
    Column("rom_share", "0 to 1", "share of these pairs among all pairs of kept vectors"),
    Column("rmo_mean", "0 to 1", "mean radial motion opponency over these pairs"),
    Column("rmo_max", "0 to 1", "largest radial motion opponency"),
    Column(
        "rmo_index",
        "-1 to 1",
        "balance of outward and inward opponency: 1 for expansion, -1 for contraction, "
        "0 for translation, rotation and noise",
    ),
)
# Columns of each detector with places: the box and the winning unit.
PLACE = (
    Column("x", "source px", "left edge of the strongest looming object's box"),
    Column("y", "source px", "top edge of the strongest looming object's box"),
    Column("width", "source px", "width of the strongest looming object's box"),
    Column("height", "source px", "height of the strongest looming object's box"),
    Column("unit_x", "source px", "centre of the winning unit's field, from the left"),
    Column("unit_y", "source px", "centre of the winning unit's field, from the top"),
)
# Columns of each detector with places, if the field of view is known (`--fov`).
VIEW = (
    Column("azimuth_deg", "deg", "direction of the focus of expansion, right of the middle"),
    Column(
        "elevation_deg", "deg", "direction of the focus of expansion, above the horizontal plane"
    ),
    Column("angular_width_deg", "deg", "horizontal angle that the box spans"),
    Column("angular_height_deg", "deg", "vertical angle that the box spans"),
    Column("angular_size_deg", "deg", "the larger of the two angles that the box spans"),
    Column(
        "angular_speed_deg_s",
        "deg/s",
        "growth of the angular size, computed from the time to contact; empty if that is not known",
    ),
)
# Columns with `--columns all`: the first for every detector, the others for those with places.
ALARM_DETAILS = (
    Column("over_threshold", "", "response divided by the alarm's threshold; empty without one"),
    Column(
        "evidence_over_threshold",
        "",
        "evidence divided by the alarm's threshold; evidence is the response, and 0 in a blind "
        "frame. If this is above 1 the frame counts for the alarm",
    ),
    Column("time_to_contact_s", "s", "time to contact of the strongest looming object, if known"),
    Column(
        "time_to_contact_error_s",
        "s",
        "error of the time to contact; on rendered approaches the true time is usually within "
        "twice this error",
    ),
)


def columns_of(
    detector: type[Detector],
    *,
    details: bool = False,
    degrees: bool = False,
) -> tuple[Column, ...]:
    """Return the columns of a detector: response, alarm, box (if it has places), its own columns.

    Parameters
    ----------
    detector : type of Detector
        Its name is the start of all names of the columns.
    details : bool
        Whether to include the inner values and the values behind the alarm (``--columns all``).
    degrees : bool
        Whether to include the columns in degrees of the strongest looming object (``--fov``).
    """
    unit, meaning = detector.response_column
    alarm = f"1 while the alarm of {detector.label} is on, else 0"
    columns = [Column("response", unit, meaning), Column("alarm", "0 or 1", alarm)]
    if detector.places:
        columns += (*PLACE, *(VIEW if degrees else ()))
    columns += (*detector.columns, *(detector.details if details else ()))
    if details:
        columns += ALARM_DETAILS if detector.places else ALARM_DETAILS[:1]
    return tuple(column._replace(name=f"{detector.name}_{column.name}") for column in columns)
