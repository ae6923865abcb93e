"""Protocols: what a stimulus shows, as frozen tables that check themselves.

Angles are in degrees, counter-clockwise, 0 = right, 90 = up; positions are
``[right, up]`` in degrees from the middle of the field; times are in seconds of the
clip. Luminance is linear, 0 to 1. The keys are described in ``docs/stimuli.md``.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, Self

from oppload_cli.errors import StimulusError, suggestion
from oppload_cli.stimulus.declare import Table, key
from oppload_cli.stimulus.kinematics import motion_times, pose_of, reaches_field
from oppload_cli.stimulus.objects import FIELDS, Object
from oppload_cli.stimulus.tables import Display, Effects, Scene, Timing

MOST_FRAMES = 1_000_000
# of the logarithm of a pattern's scale
MOST_ZOOM = 6.0
RESERVED = ("display", "timing", "scene", "effects", "object", "sweep", "seed")


@dataclass(frozen=True, kw_only=True)
class Protocol(Table):
    """One stimulus, resolved: everything that its frames follow from."""

    name: str = key("its name", default="stimulus")
    description: str = key("one line on what it shows", default="")
    source: str = key("where it was published or what it is for", default="")
    tags: tuple[str, ...] = key("words to find it by", default=())
    seed: int = key("of everything random in it", default=0, low=0, high=2**32 - 1)
    display: Display = key("the screen")  # noqa: RUF009
    timing: Timing = key("pauses and duration")  # noqa: RUF009
    scene: Scene = key("what all objects share", default=Scene())  # noqa: RUF009
    effects: Effects = key(  # noqa: RUF009
        "what happens to the finished picture", default=Effects()
    )
    objects: tuple[Object, ...] = key("drawn in this order, the first one at the back", default=())

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.frame_count > MOST_FRAMES:
            raise StimulusError(
                f"timing and frame_rate make {self.frame_count} frames; the most is {MOST_FRAMES}"
            )
        self._check_ids()
        for thing in self.objects:
            try:
                _check_object_times(self, thing)
                _check_inside(self, thing)
            except StimulusError as problem:
                raise StimulusError(f"object '{thing.id}': {problem}") from None

    @property
    def frame_count(self) -> int:
        """Number of frames: those whose time lies before the clip's end."""
        timing = self.timing
        total = sum(Fraction(repr(s)) for s in (timing.before_s, timing.motion_s, timing.after_s))
        return max(1, math.ceil(total * self.display.frame_rate))

    def time_of(self, frame: int) -> float:
        """Return the time of a frame.

        Parameters
        ----------
        frame : int
            0-based.

        Returns
        -------
        float
            Seconds of the clip.
        """
        return float(frame / self.display.frame_rate)

    @classmethod
    def from_table(cls, table: object, where: str) -> Self:
        """Build from what a TOML file holds, its sweep taken out.

        Parameters
        ----------
        table : object
            Should be a dict; the objects are the list ``object``.
        where : str
            The file, for the messages.

        Returns
        -------
        Protocol

        Raises
        ------
        StimulusError
            If anything in it is not valid; the message names the key and the file.
        """
        if not isinstance(table, dict):
            raise StimulusError(f"{where} must be a table of keys, not {table!r}")
        top = dict(table)
        if "objects" in top:
            raise StimulusError(f"{where}: unknown key 'objects'{suggestion('objects', RESERVED)}")
        listed = top.pop("object", [])
        if not isinstance(listed, list) or not listed:
            raise StimulusError(f"{where}: there is no object; add one as [[object]]")
        top["objects"] = [Object.from_table(one, _label(where, one)) for one in listed]
        return super().from_table(top, where)

    def as_table(self) -> dict[str, Any]:
        """Return the resolved protocol, ready for JSON or TOML.

        Returns
        -------
        dict
            :meth:`from_table` makes the same protocol of it.
        """
        table = super().as_table()
        table["object"] = table.pop("objects")
        return table

    def _check_ids(self) -> None:
        seen: set[str] = set()
        for thing in self.objects:
            if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_-]*", thing.id) or thing.id in RESERVED:
                raise StimulusError(
                    f"object id '{thing.id}' must be a letter followed by letters, digits, '-' or "
                    f"'_', and none of {', '.join(RESERVED)}"
                )
            if thing.id in seen:
                raise StimulusError(f"two objects have the id '{thing.id}'; rename one")
            seen.add(thing.id)


def _label(where: str, table: object) -> str:
    name = table.get("id", "?") if isinstance(table, dict) else "?"
    return f"{where}: object '{name}'"


def _check_object_times(protocol: Protocol, thing: Object) -> None:
    timing = protocol.timing
    if thing.onset_s >= timing.motion_s:
        raise StimulusError(
            f"onset_s = {thing.onset_s:g} must be below timing.motion_s = {timing.motion_s:g}"
        )
    if thing.duration_s is not None and (
        thing.onset_s + thing.duration_s > timing.motion_s * (1 + 1e-9)
    ):
        raise StimulusError(
            f"onset_s + duration_s = {thing.onset_s + thing.duration_s:g} is after the motion's "
            f"end (timing.motion_s = {timing.motion_s:g}); shorten it"
        )
    zoom = thing.motion.zoom_per_s if thing.motion is not None else 0.0
    if abs(zoom) * timing.motion_s > MOST_ZOOM:
        raise StimulusError(
            f"motion: zoom_per_s = {zoom:g} over {timing.motion_s:g} s scales by more than "
            f"{math.exp(MOST_ZOOM):.0f}; keep it below {MOST_ZOOM / timing.motion_s:.3g}"
        )
    if thing.growth is not None and thing.growth.contact_s is not None:
        _check_contact(protocol, thing, thing.growth.contact_s)


def _check_contact(protocol: Protocol, thing: Object, contact: float) -> None:
    start, end = motion_times(protocol.timing, thing)
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


def _check_inside(protocol: Protocol, thing: Object) -> None:
    if thing.kind in FIELDS:
        return
    times = (protocol.time_of(frame) for frame in range(protocol.frame_count))
    if not any(reaches_field(protocol, thing, pose_of(protocol, thing, time)) for time in times):
        wide, high = (
            size / protocol.display.scale
            for size in (protocol.display.width, protocol.display.height)
        )
        raise StimulusError(
            f"it is outside the field ({wide:.4g} x {high:.4g} deg) in every frame; "
            "change centre_deg, its size or its motion"
        )
