"""The columns of ``frames.csv``: those of every result, and those of a detector.

They are defined once: the table writes them, the registry refuses a detector whose columns are
taken, and the page on formats lists them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from oppload_cli.models.detector import Column

if TYPE_CHECKING:
    from collections.abc import Collection

    from oppload_cli.models.detector import Detector


COMMON = (
    Column("frame", "", "number of the frame in the complete input, from 0"),
    Column("time_s", "s", "presentation time of the frame, from frame 0 on"),
    Column(
        "luma_change",
        "0 to 1",
        "mean over the frame of P, the absolute luminance change; 0 for a repeat, empty for the "
        "first frame",
    ),
)
COMMON_DETAILS = (  # with `--columns all`
    Column(
        "blind",
        "text",
        "why no alarm counts this frame: start (of the video), cut (or flash), rest (that ended) "
        "or gap; empty where it counts",
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
# Of each detector with places: the box and the winning unit.
PLACE = (
    Column("x", "source px", "left edge of the strongest looming object's box"),
    Column("y", "source px", "top edge of the strongest looming object's box"),
    Column("width", "source px", "width of the strongest looming object's box"),
    Column("height", "source px", "height of the strongest looming object's box"),
    Column("unit_x", "source px", "centre of the winning unit's field, from the left"),
    Column("unit_y", "source px", "centre of the winning unit's field, from the top"),
)
# Of each detector with places, where the field of view is known (`--fov`).
VIEW = (
    Column("azimuth_deg", "deg", "direction of its focus of expansion, right of the middle"),
    Column(
        "elevation_deg", "deg", "direction of its focus of expansion, above the horizontal plane"
    ),
    Column("angular_width_deg", "deg", "horizontal angle that its box spans"),
    Column("angular_height_deg", "deg", "vertical angle that its box spans"),
    Column("angular_size_deg", "deg", "the larger of the two angles that its box spans"),
    Column(
        "angular_speed_deg_s",
        "deg/s",
        "growth of its angular size, from the time to contact; empty where that is not known",
    ),
)
# Of each detector, with `--columns all`; all but the first where it has places.
ALARM_DETAILS = (
    Column(
        "over_threshold", "", "response over the threshold of its alarm; empty where there is none"
    ),
    Column(
        "evidence_over_threshold",
        "",
        "the same for the evidence, which near a contact is larger than the response: above 1 the "
        "frame counts unless it is blind",
    ),
    Column(
        "time_to_contact_s", "s", "until the strongest looming object arrives; empty if not known"
    ),
    Column(
        "time_to_contact_error_s",
        "s",
        "error of that time; on rendered approaches the true time is usually within twice this",
    ),
)


def columns_of(
    detector: type[Detector],
    *,
    details: bool = False,
    degrees: bool = False,
    presets: Collection[str] | None = None,
) -> tuple[Column, ...]:
    """Return the columns of a detector: response, alarm, its box where it has one, its own.

    Parameters
    ----------
    detector : type of Detector
        Gives its own columns, and the name that all begin with.
    details : bool
        Whether its inner values and the values behind its alarm have columns too.
    degrees : bool
        Whether its strongest looming object has columns in degrees (``--fov``).
    presets : collection of str, optional
        Only columns that stand in the table under one of these; else all.
    """
    unit, meaning = detector.response_column
    alarm = f"1 while the alarm of {detector.label} is on, else 0"
    columns = [Column("response", unit, meaning), Column("alarm", "0 or 1", alarm)]
    if detector.places:
        columns += (*PLACE, *(VIEW if degrees else ()))
    columns += [
        column
        for column in (*detector.columns, *(detector.details if details else ()))
        if presets is None or not column.preset or column.preset in presets
    ]
    if details:
        columns += ALARM_DETAILS if detector.places else ALARM_DETAILS[:1]
    return tuple(each._replace(name=f"{detector.name}_{each.name}") for each in columns)
