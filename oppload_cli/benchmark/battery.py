"""The battery of stimuli that every detector is shown."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

from oppload_cli.errors import ParameterError
from oppload_cli.stimulus.catalogue import find

if TYPE_CHECKING:
    from collections.abc import Sequence

    from oppload_cli.stimulus.protocol import Protocol

LOOM = "klapoetke2017/loom-l-over-v"
L_OVER_V = "disk.growth.l_over_v_ms"
LOOMING, CONTROL = "looming", "control"
SELECTIVITY, POLARITY, CONTRAST, NOISE = "selectivity", "polarity", "contrast", "noise"
SPEED, SIZE, PLACE, BACKGROUND = "speed", "size", "place", "background"


class Table(NamedTuple):
    """One table of the benchmark.

    Attributes
    ----------
    name : str
        As in the files.
    title : str
        For the reader.
    axis : str
        The quantity that its columns vary, with its unit.
    """

    name: str
    title: str
    axis: str


TABLES = (
    Table(SELECTIVITY, "Kinds of motion", "kind of motion"),
    Table(POLARITY, "Polarity: a dark and a bright approach", "polarity"),
    Table(CONTRAST, "Contrast of the approaching disk", "contrast with the ground"),
    Table(NOISE, "Noise over an approach", "standard deviation of the noise, share of white"),
    Table(SPEED, "Speed of the approach", "l/v (ms)"),
    Table(SIZE, "Angular size at which the approach ends", "size (deg)"),
    Table(PLACE, "Place of the approach", "right, up of the centre (deg)"),
    Table(BACKGROUND, "Motion behind the approach", "ground"),
)


@dataclass(frozen=True)
class Column:
    """One column of a table: stimuli of one kind.

    Attributes
    ----------
    table : str
        Name of the table.
    label : str
        Heading of the column.
    stimulus : str
        Name in the catalogue.
    settings : dict
        Values of its keys; a list of values is a sweep over them, and all of its members count.
    kind : str
        ``looming``, where an alarm is right, or ``control``, where it is false.
    """

    table: str
    label: str
    stimulus: str
    settings: dict[str, Any] = field(default_factory=dict)
    kind: str = LOOMING

    def protocols(self) -> list[Protocol]:
        """Return the protocols of its stimuli, one per value of the sweep."""
        entry = find(self.stimulus)[0]
        return entry.with_settings(self.settings).protocols()


def _control(label: str, stimulus: str, **settings: Any) -> Column:
    keys = {name.replace("__", "."): value for name, value in settings.items()}
    return Column(SELECTIVITY, label, stimulus, keys, CONTROL)


_QUARTERS = [0, 45, 90, 135]
_KINDS = (
    Column(SELECTIVITY, "looming disk", LOOM, {L_OVER_V: 40}),
    Column(SELECTIVITY, "looming square", "controls/looming-square"),
    Column(SELECTIVITY, "looming patch", "controls/looming-patch"),
    _control("receding disk", "controls/receding-disk", disk__growth__l_over_v_ms=40),
    _control("receding patch", "controls/receding-patch"),
    _control("near miss", "controls/near-miss"),
    _control(
        "translating disk",
        "controls/translating-disk-speed",
        disk__motion__speed_deg_s=[20, 40, 80],
    ),
    _control("translating bar", "controls/translating-bar-speed"),
    _control("turning bar", "controls/rotating-bar"),
    _control("grating", "controls/square-grating", grating__axis_deg=_QUARTERS),
    _control("plaid", "controls/plaid"),
    _control("pan", "controls/texture-pan", ground__motion__direction_deg=_QUARTERS),
    _control("roll", "controls/texture-rotation"),
    _control("forward and backward", "controls/texture-zoom"),
    _control("drifting dots", "controls/dots-drift"),
    _control("shake", "controls/camera-shake"),
    _control("flicker", "controls/flicker"),
    _control("luminance step", "controls/luminance-step"),
    _control("dimming, brightening", "controls/luminance-ramp"),
    _control("appearing disk", "controls/appearing-disk"),
    _control("noise", "controls/static-texture", effects__noise=0.05),
)


def _series() -> tuple[Column, ...]:
    dark = {"display.background": 0.5}
    rows = [
        Column(POLARITY, "dark", LOOM, {L_OVER_V: 40}),
        Column(POLARITY, "bright", "klapoetke2017/loom-bright", {L_OVER_V: 40}),
        Column(PLACE, "0, 0", LOOM, {L_OVER_V: 40, "disk.growth.most_deg": 40}),
    ]
    rows += [
        Column(
            CONTRAST,
            f"{contrast:g}",
            "controls/looming-contrast",
            dark | {"disk.luminance": round(0.5 * (1 - contrast), 6)},
        )
        for contrast in (0.1, 0.2, 0.3, 0.5, 0.7, 1.0)
    ]
    rows += [
        Column(NOISE, f"{noise:g}", "controls/looming-noise", {"effects.noise": noise})
        for noise in (0.0, 0.02, 0.05, 0.1, 0.2)
    ]
    rows += [
        Column(SPEED, f"{ratio}", LOOM, {L_OVER_V: ratio})
        for ratio in (10, 20, 40, 60, 80, 100, 140, 200)
    ]
    rows += [
        Column(SIZE, f"{size}", LOOM, {L_OVER_V: 40, "disk.growth.most_deg": size})
        for size in (10, 20, 30, 45, 60)
    ]
    rows += [
        Column(
            PLACE,
            f"{x}, {y}",
            LOOM,
            {L_OVER_V: 40, "disk.growth.most_deg": 40, "disk.centre_deg": [x, y]},
        )
        for x, y in ((10, 0), (20, 0), (0, 10), (-10, 0), (0, -10), (14, 14))
    ]
    moving = "controls/looming-on-moving-texture"
    rows.append(Column(BACKGROUND, "still texture", "controls/looming-on-static-texture"))
    rows += [
        Column(
            BACKGROUND,
            f"pan {speed} deg/s",
            moving,
            {"ground.motion.speed_deg_s": speed, "ground.motion.direction_deg": 0},
        )
        for speed in (5, 15, 30)
    ]
    rows += [
        Column(BACKGROUND, "forward motion", "controls/looming-on-zooming-texture"),
        Column(BACKGROUND, "shake", "controls/looming-with-shake"),
    ]
    return tuple(rows)


BATTERY: tuple[Column, ...] = (*_KINDS, *_series())


def columns_of(tables: Sequence[str]) -> list[Column]:
    """Return the columns of some tables, in their order; of all where none is named.

    Raises
    ------
    ParameterError
        If a table has no such name.
    """
    names = [table.name for table in TABLES]
    for name in tables:
        if name not in names:
            raise ParameterError(f"no table '{name}'; choose from {', '.join(names)}")
    # Responses are given over that to the looming disk, which is always shown.
    return [
        column for column in BATTERY if not tables or column.table in tables or column is BATTERY[0]
    ]
