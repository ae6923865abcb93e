"""The columns of ``frames.csv``, defined once for the writer, the reader and the docs."""

from __future__ import annotations

from typing import TYPE_CHECKING

from oppload_cli.models.detector import Column
from oppload_cli.models.registry import detector_named

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

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


def columns_of(
    name: str,
    *,
    details: bool = False,
    degrees: bool = False,
    presets: Collection[str] | None = None,
) -> tuple[Column, ...]:
    """Return the columns of a detector: response, alarm, its box where it has one, its own.

    Parameters
    ----------
    name : str
        The detector.
    details : bool
        Whether its inner values have columns too.
    degrees : bool
        Whether its strongest looming object has columns in degrees (``--fov``).
    presets : collection of str, optional
        Only columns that stand in the table under one of these; else all.
    """
    detector = detector_named(name)
    unit, meaning = detector.response_column
    alarm = f"1 while the alarm of {detector.label} is on, else 0"
    columns = [Column("response", unit, meaning), Column("alarm", "0 or 1", alarm)]
    if detector.places:
        box, unit = "of the strongest looming object's box", "of the winning unit's field"
        columns += [
            Column("x", "source px", f"left edge {box}"),
            Column("y", "source px", f"top edge {box}"),
            Column("width", "source px", f"width {box}"),
            Column("height", "source px", f"height {box}"),
            Column("unit_x", "source px", f"centre {unit}, from the left"),
            Column("unit_y", "source px", f"centre {unit}, from the top"),
        ]
        columns += VIEW if degrees else ()
    columns += [
        column
        for column in (*detector.columns, *(detector.details if details else ()))
        if presets is None or not column.preset or column.preset in presets
    ]
    return tuple(each._replace(name=f"{name}_{each.name}") for each in columns)


def columns_for(
    models: Sequence[str],
    *,
    rmo: bool,
    details: bool = False,
    degrees: bool = False,
    presets: Collection[str] | None = None,
) -> tuple[Column, ...]:
    """Return the columns of a result, in their order.

    Parameters
    ----------
    models : sequence of str
        Names of the detectors that were run.
    rmo : bool
        Whether radial motion opponency was measured.
    details : bool
        Whether the inner values of the detectors have columns too (``--columns all``).
    degrees : bool
        Whether the field of view is known, so that there are columns in degrees.
    presets : collection of str, optional
        Only columns that stand in the table under one of these; else all.

    Returns
    -------
    tuple of Column
        ``frame``, ``time_s`` and ``luma_change``, then those of each detector, then those of
        RMO.
    """
    of_models = tuple(
        column
        for name in models
        for column in columns_of(name, details=details, degrees=degrees, presets=presets)
    )
    return COMMON + of_models + (RMO if rmo else ())
