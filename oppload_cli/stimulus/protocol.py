"""Protocols: stimuli as frozen tables that check themselves, and their JSON Schema.

Angles are in degrees, counter-clockwise, 0 = right, 90 = up. Positions are ``[right, up]`` in
degrees from the middle of the display. Times are in seconds of the clip. Luminance is linear,
0 to 1. ``docs/stimulus-keys.md`` describes the keys.
"""

from __future__ import annotations

import itertools
import math
import re
import typing
from dataclasses import dataclass
from fractions import Fraction
from numbers import Real
from typing import TYPE_CHECKING, Any, Self

from oppload_cli.errors import StimulusError, faults_at, suggestion
from oppload_cli.schema import REQUIRED, DeclaredTable, Parameter
from oppload_cli.stimulus.kinematics import ROUNDING_S, pose_of
from oppload_cli.stimulus.objects import FIELDS, GRATINGS, PICTURE, Motion, Object
from oppload_cli.stimulus.protocol_tables import TABLES, ProtocolTables, Scene
from oppload_cli.stimulus.staging import check_stage, may_show

if TYPE_CHECKING:
    from collections.abc import Iterator


_MOST_FRAMES = 1_000_000
_MOST_ZOOM = 6.0  # the largest change of the logarithm of a pattern's scale
_LATE = "after the end of the motion and is never reached; correct it, or make the motion longer"
_RESERVED = (*TABLES, "object", "sweep", "seed")


@dataclass(frozen=True, kw_only=True)
class Protocol(ProtocolTables):
    """One stimulus: all values that its frames depend on, without a sweep."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.frame_count > _MOST_FRAMES:
            raise StimulusError(
                f"timing and frame_rate make {self.frame_count} frames; the most is {_MOST_FRAMES}"
            )
        self._check_ids()
        check_stage(self)
        for obj in self.objects:
            with faults_at(f"object '{obj.id}'"):
                _check_object_times(self, obj)
                _check_inside(self, obj)

    @classmethod
    def from_table(cls, table: object, where: str) -> Self:
        """Build a protocol from the contents of a TOML file without its sweep.

        Parameters
        ----------
        table : object
            The contents; it should be a dict with the list ``object``.
        where : str
            The file, for messages.

        Raises
        ------
        StimulusError
            If a value is not valid; the message names the key and the file.
        """
        if not isinstance(table, dict):
            raise StimulusError(f"{where} must be a table of keys, not {table!r}")
        top = dict(table)
        known = {"object", *cls.names()} - {"objects"}
        for key in top:  # before the objects: a stray [growth] leaves an object incomplete
            if key not in known:
                near = suggestion(str(key), (known | {"sweep"}) - {key})
                raise StimulusError(f"{where}: unknown key '{key}'{near}")
        listed = top.pop("object", [])
        scene = top.get("scene")
        staged = isinstance(scene, dict) and "background" in scene
        if not isinstance(listed, list) or not (listed or staged):
            raise StimulusError(f"{where}: there is no object; add one as [[object]]")
        top["objects"] = [
            Object.from_table(obj, f"{where}: {_called(obj, number)}")
            for number, obj in enumerate(listed, 1)
        ]
        return super().from_table(top, where)

    def as_table(self) -> dict[str, Any]:
        """Return the protocol as a table for JSON or TOML, which :meth:`from_table` can read."""
        table = super().as_table()
        table["object"] = table.pop("objects")
        return table

    def remarks(self) -> list[str]:
        """Return a sentence for each value that is valid, but that no frame can show."""
        return list(_remarks(self))

    def _check_ids(self) -> None:
        ids: set[str] = set()
        for obj in self.objects:
            if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_-]*", obj.id) or obj.id in _RESERVED:
                raise StimulusError(
                    f"object id '{obj.id}' must be a letter followed by letters, digits, '-' or "
                    f"'_', and none of {', '.join(_RESERVED)}"
                )
            if obj.id in ids:
                raise StimulusError(f"two objects have the id '{obj.id}'; rename one")
            ids.add(obj.id)


def check_protocol(protocol: object) -> None:
    """Raise a StimulusError for anything other than a protocol, such as its name."""
    if not isinstance(protocol, Protocol):
        raise StimulusError(
            f"{type(protocol).__name__}: is no stimulus; give what oppload_cli.stimulus.load "
            "returns for a name"
        )


def check_frame(protocol: Protocol, frame: int) -> None:
    """Raise a StimulusError if a protocol has no frame of this number."""
    check_protocol(protocol)
    given: object = frame  # a caller may give a text, in spite of the type
    if not isinstance(given, Real) or not 0 <= frame < protocol.frame_count:
        raise StimulusError(
            f"{protocol.name}: has no frame {frame!r:.60}; give a number from 0 to "
            f"{protocol.frame_count - 1}"
        )


def json_schema() -> dict[str, Any]:
    """Return the JSON Schema of a protocol file, for editors that complete and check TOML."""
    schema = _table_schema(Protocol)
    properties = schema["properties"]
    properties.pop("name")
    properties["object"] = properties.pop("objects")
    values = {
        "description": "lists of values by dotted key, e.g. bar.axis_deg = [0, 45, 90]",
        "type": "object",
        "additionalProperties": {
            "anyOf": [{"type": "array", "minItems": 1}, {"$ref": "#/$defs/nested"}]
        },
    }
    properties["sweep"] = values
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "oppload stimulus protocol",
        **schema,
        "$defs": {"nested": {key: value for key, value in values.items() if key != "description"}},
    }


def _called(table: object, number: int) -> str:
    """Return what a message calls an object of a file: its id, or else its number."""
    name = table.get("id") if isinstance(table, dict) else None
    return f"object number {number}" if name is None else f"object '{name}'"


def _check_object_times(protocol: Protocol, obj: Object) -> None:
    timing = protocol.timing
    if obj.onset_s >= timing.motion_s:
        raise StimulusError(
            f"onset_s = {obj.onset_s:g} must be below timing.motion_s = {timing.motion_s:g}"
        )
    if obj.duration_s is not None and (obj.onset_s + obj.duration_s > timing.motion_s * (1 + 1e-9)):
        raise StimulusError(
            f"onset_s + duration_s = {obj.onset_s + obj.duration_s:g} is after the motion's "
            f"end (timing.motion_s = {timing.motion_s:g}); shorten it"
        )
    zoom = obj.motion.zoom_per_s if obj.motion is not None else 0.0
    if abs(zoom) * timing.motion_s > _MOST_ZOOM:
        raise StimulusError(
            f"motion: zoom_per_s = {zoom:g} over {timing.motion_s:g} s scales by more than "
            f"{math.exp(_MOST_ZOOM):.0f}; keep it below {_MOST_ZOOM / timing.motion_s:.3g}"
        )
    if obj.growth is not None and obj.growth.contact_s is not None:
        _check_contact(protocol, obj, obj.growth.contact_s)


def _check_contact(protocol: Protocol, obj: Object, contact: float) -> None:
    start, end = protocol.motion_of(obj)
    total = protocol.timing.total_s
    slack = 1e-9 * max(1.0, total)
    where = ""
    if contact <= start:
        where = f"inside the pause before its motion (0 to {start:g} s)"
    elif contact < end - slack:
        where = f"before the end of its motion ({end:g} s)"
    elif end + slack < contact <= total:
        where = f"inside the pause after its motion ({end:g} to {total:g} s)"
    if where:
        raise StimulusError(
            f"growth: contact_s = {contact:g} lies {where}; leave it out for contact at the "
            "motion's end, or change timing"
        )


def _check_inside(protocol: Protocol, obj: Object) -> None:
    if obj.kind in FIELDS:
        return
    times = (protocol.time_of(frame) for frame in range(protocol.frame_count))
    if not any(may_show(protocol, obj, time) for time in times):
        display = protocol.display
        wide, high = map(display.angle_of, (display.width, display.height))
        empty, changed = " or of size 0", "centre_deg, its size or its motion"
        if obj.kind == PICTURE:
            empty, changed = "", "its course"
        raise StimulusError(
            f"it is outside the field ({wide:.4g} x {high:.4g} deg){empty} in every frame; "
            f"change {changed}"
        )


def _remarks(protocol: Protocol) -> Iterator[str]:
    scene, at_rest, timing = protocol.scene, Scene(), protocol.timing
    if scene.cut_s is not None and scene.cut_s >= timing.total_s - ROUNDING_S:
        yield "scene: cut_s is after the end of the clip, and has no effect; correct it"
    kinds = {obj.kind for obj in protocol.objects}
    moved = [
        f"scene.{key}"
        for key in ("centre_deg", "rotation_deg", "motion")
        if getattr(scene, key) != getattr(at_rest, key)
    ]
    if moved and (PICTURE in kinds or not kinds):
        yield (
            f"scene: pictures and backgrounds do not follow {' and '.join(moved)}; use a course "
            "and [camera]"
        )
    if protocol.objects and all(_like_ground(protocol, obj) for obj in protocol.objects):
        yield (
            "every object has the luminance of display.background, so that no frame shows it; "
            "change one of the two"
        )
    if _has_late_points(scene.motion, timing.motion_s):
        yield f"scene: a time of motion.path_s is {_LATE}"
    for obj in protocol.objects:
        for remark in (
            *_late_changes(protocol, obj),
            *_too_fast(protocol, obj),
            *_without_growth(protocol, obj),
            *_without_effect(obj),
        ):
            yield f"object '{obj.id}': {remark}"


def _like_ground(protocol: Protocol, obj: Object) -> bool:
    """Return whether an even ground hides an object, if there is no other object."""
    textured = obj.kind in {*FIELDS, "patch", PICTURE} or protocol.scene.background
    even = not (textured or obj.brightness)
    return even and obj.luminance == protocol.display.background


def _late_changes(protocol: Protocol, obj: Object) -> Iterator[str]:
    start, end = protocol.motion_of(obj)
    last_frame = protocol.time_of(protocol.frame_count - 1)
    shown = min(end, last_frame) - start + ROUNDING_S
    if obj.brightness is not None and obj.brightness.start_s > shown:
        yield f"brightness.start_s is {_LATE}"
    # In reverse, the first frame shows the end of the motion.
    steps_shown = end - start + ROUNDING_S if obj.reverse else shown
    if obj.growth is not None and max(obj.growth.times_s, default=-math.inf) > steps_shown:
        yield f"a time of growth.times_s is {_LATE}"
    if _has_late_points(obj.motion, end - start):
        yield f"a time of motion.path_s is {_LATE}"


def _has_late_points(motion: Motion | None, duration_s: float) -> bool:
    return motion is not None and max(motion.path_s, default=0.0) > duration_s + ROUNDING_S


def _too_fast(protocol: Protocol, obj: Object) -> Iterator[str]:
    if obj.kind in GRATINGS and _greatest_step(protocol, obj) >= 0.5 - 1e-9:
        yield (
            "it moves by half of its period or more from one frame to the next, so that its "
            "direction cannot be seen; lower its speed, or raise display.frame_rate"
        )
    brightness = obj.brightness
    if brightness is not None and (brightness.frequency_hz or 0) > protocol.display.frame_rate / 2:
        yield (
            "brightness.frequency_hz is above half of display.frame_rate, so that the frames "
            "flicker at a lower frequency; change one of them"
        )


def _without_growth(protocol: Protocol, obj: Object) -> Iterator[str]:
    """Yield a remark if the frames show an approach as a jump of the size, or not at all.

    Seconds or microseconds in place of the milliseconds of l/v have this effect.
    """
    if obj.growth is None or obj.growth.kind != "approach":
        return
    display = protocol.display
    diagonal = display.angle_of(math.hypot(display.width, display.height))
    # Before and after the motion the size stays the same.
    start, end = (float(display.frame_rate) * time for time in protocol.motion_of(obj))
    first = max(0, math.floor(start) - 1)
    last = min(math.ceil(end) + 1, protocol.frame_count - 1)
    times = [protocol.time_of(frame) for frame in range(first, last + 1)]
    sizes = [min(pose_of(protocol, obj, time).extent.size, diagonal) for time in times]
    grown = max(sizes) - min(sizes)
    jump = max((abs(b - a) for a, b in itertools.pairwise(sizes)), default=0.0)
    change = "change growth.l_over_v_ms, which is in milliseconds"
    if not grown:
        yield f"its size is the same in every frame; {change}, or its limits"
    elif jump > 0.9 * grown:  # it looks as if an object appeared
        yield (
            "it grows by nearly all of its growth from one frame to the next, so that no motion "
            f"can be seen; {change}, or raise display.frame_rate"
        )


def _without_effect(obj: Object) -> Iterator[str]:
    motion = obj.motion
    if motion is None or obj.coherence == 1:
        return
    travels = motion.speed_deg_s or motion.shake_deg or motion.path_deg
    if not travels and (motion.zoom_per_s or motion.rotation_deg_s):
        yield (
            "all dots take part in its zoom and its turn, so that coherence has no effect; give "
            "motion.speed_deg_s, or leave coherence out"
        )


def _greatest_step(protocol: Protocol, obj: Object) -> float:
    """Return the longest way of a grating from frame to frame along its axis, in periods."""
    turns = (-obj.plaid_deg / 2, obj.plaid_deg / 2) if obj.kind == "plaid" else (0.0,)
    times = (protocol.time_of(frame) for frame in range(protocol.frame_count))
    longest = 0.0
    for before, after in itertools.pairwise(pose_of(protocol, obj, time) for time in times):
        right, up = (b - a for a, b in zip(before.centre_deg, after.centre_deg, strict=True))
        for turn in turns:
            axis = math.radians(after.orientation_deg + turn)
            distance = abs(right * math.cos(axis) + up * math.sin(axis))
            longest = max(longest, distance / after.zoom / (obj.period_deg or 1.0))
    return longest


def _table_schema(table: type[DeclaredTable], kind: str | None = None) -> dict[str, Any]:
    keys = [key for key in table.declared() if not key.kinds or kind in (None, *key.kinds)]
    properties = {key.name: _key_schema(key) for key in keys}
    if kind is not None:
        properties["kind"] = {"const": kind}
    required = [key.name for key in keys if key.default is REQUIRED or kind in key.needed_by]
    return {
        "type": "object",
        "properties": properties,
        "required": required,
        "additionalProperties": False,
    }


def _key_schema(key: Parameter) -> dict[str, Any]:
    schema = _type_schema(key, key.type)
    unit = f" [{key.unit}]" if key.unit else ""
    schema["description"] = f"{key.meaning}{unit}"
    if isinstance(key.default, bool | int | float | str):
        schema["default"] = key.default
    return schema


def _type_schema(key: Parameter, kind: Any) -> dict[str, Any]:
    if typing.get_origin(kind) is tuple:
        members = typing.get_args(kind)
        listed: dict[str, Any] = {"type": "array", "items": _type_schema(key, members[0])}
        if members[-1] is not Ellipsis:
            listed |= {"minItems": len(members), "maxItems": len(members)}
        return listed
    if issubclass(kind, DeclaredTable):
        choices = [field.choices for field in kind.declared() if field.name == "kind"]
        if not choices:
            return _table_schema(kind)
        return {"oneOf": [_table_schema(kind, str(choice)) for choice in choices[0]]}
    if kind in {str, bool}:
        plain = {"type": "string" if kind is str else "boolean"}
        return plain | ({"enum": list(key.choices)} if key.choices else {})
    number: dict[str, Any] = {"type": "integer" if kind is int else "number"}
    bounds = {"minimum": key.low, "exclusiveMinimum": key.above, "maximum": key.high}
    number |= {name: bound for name, bound in bounds.items() if bound is not None}
    if kind is Fraction:
        return {"anyOf": [number, {"type": "string", "pattern": r"^[0-9]+([./][0-9]+)?$"}]}
    return number
