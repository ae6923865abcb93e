"""The tables of a protocol, and dotted keys of its values, such as ``disk.size_deg``."""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from typing import TYPE_CHECKING, Any

from oppload_cli.errors import ParameterError, StimulusError, nearest, suggestion
from oppload_cli.schema import REQUIRED, DeclaredTable, parameter
from oppload_cli.stimulus.objects import Motion, Object

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Mapping

TABLES = ("display", "timing", "scene", "camera", "effects")
SURROUNDINGS = ("plane", "street", "forest", "room", "sky")  # drawn by the package


@lru_cache(maxsize=1024)
def _exact_sum(*seconds: float) -> Fraction:
    """Return the exact sum of durations as they are written: 0.1 and 0.2 make 3/10.

    The time of a frame is a rounded fraction. A sum of floats could be slightly later than the
    frame at the same time.
    """
    return sum((Fraction(repr(value)) for value in seconds), Fraction(0))


@dataclass(frozen=True, kw_only=True)
class Display(DeclaredTable):
    """The screen: its size, its angle of view and its frame rate."""

    width: int = parameter(REQUIRED, "width of the picture", unit="px", low=8, high=8192)
    height: int = parameter(REQUIRED, "height of the picture", unit="px", low=8, high=8192)
    frame_rate: Fraction = parameter(
        Fraction(30),
        "frames per second, a number or a fraction as text",
        unit="Hz",
        above=0,
        high=10_000,
    )
    pixels_per_degree: float | None = parameter(
        None,
        "scale in the middle of the field; give this or field_of_view_deg",
        unit="px/deg",
        low=0.001,
        high=10_000,
    )
    field_of_view_deg: float | None = parameter(
        None, "angle that the width spans; give this or pixels_per_degree", low=0.001, high=360
    )
    projection: str = parameter(
        "flat",
        "flat: pixels per degree constant; perspective: pixels as the tangent of the angle",
        choices=("flat", "perspective"),
    )
    background: float = parameter(1.0, "luminance where there is no object", low=0, high=1)

    def __post_init__(self) -> None:
        super().__post_init__()
        if (self.pixels_per_degree is None) == (self.field_of_view_deg is None):
            raise StimulusError("give either pixels_per_degree or field_of_view_deg, and only one")
        wide = self.field_of_view_deg is not None and self.field_of_view_deg >= 179
        if self.projection == "perspective" and wide:
            raise StimulusError(
                "field_of_view_deg must be below 179 deg with projection = 'perspective'"
            )

    @property
    def scale(self) -> float:
        """Pixels per degree in the middle of the field."""
        if self.pixels_per_degree is not None:
            return self.pixels_per_degree
        view = self.field_of_view_deg or 0.0
        if self.projection == "flat":
            return self.width / view
        return self.width / 2 / math.tan(math.radians(view / 2)) * math.pi / 180

    def angle_of(self, pixels: float) -> float:
        """Return the degrees that a length in pixels spans about the middle of the field."""
        angle = pixels / self.scale
        if self.projection == "flat":
            return angle
        return 2 * math.degrees(math.atan(math.radians(angle / 2)))


@dataclass(frozen=True, kw_only=True)
class Timing(DeclaredTable):
    """The durations of the clip: a pause, the motion, a pause."""

    before_s: float = parameter(0.0, "pause before the motion", low=0, high=3600)
    motion_s: float = parameter(REQUIRED, "duration of the motion", above=0, high=3600)
    after_s: float = parameter(0.0, "pause after the motion", low=0, high=3600)

    @property
    def end_s(self) -> float:
        """When the motion ends, in seconds of the clip."""
        return float(_exact_sum(self.before_s, self.motion_s))

    @property
    def total_s(self) -> float:
        """The clip's duration in seconds."""
        return float(_exact_sum(self.before_s, self.motion_s, self.after_s))

    def elapsed(self, time: float) -> float:
        """Return the seconds of the motion that have passed at a time of the clip."""
        return min(max(time - self.before_s, 0.0), self.motion_s)


@dataclass(frozen=True, kw_only=True)
class Camera(DeclaredTable):
    """The camera of a staged scene: it looks straight ahead and moves while the motion lasts."""

    height_m: float = parameter(1.5, "height above the ground", above=0, high=10_000)
    forward_m_s: float = parameter(0.0, "speed ahead, over the ground", low=0, high=1000)
    pan_deg_s: float = parameter(
        0.0, "speed of turning to the right (negative: left)", low=-1000, high=1000
    )
    start_deg: float = parameter(
        0.0, "direction at the start, to the right of ahead", low=-60, high=60
    )
    shake_deg: float = parameter(0.0, "RMS angle of a shake from its middle", low=0, high=45)
    shake_hz: float = parameter(4.0, "middle frequency of the shake", above=0, high=500)
    looming_within_s: float = parameter(
        1.5,
        "time before contact from which a picture on a collision course counts as looming",
        above=0,
        high=3600,
    )

    @property
    def moves(self) -> bool:
        """Whether the camera moves, turns, or does not look straight ahead."""
        return bool(self.forward_m_s or self.pan_deg_s or self.shake_deg or self.start_deg)


@dataclass(frozen=True, kw_only=True)
class Scene(DeclaredTable):
    """A shift and a turn of all objects together, their common motion, and the background."""

    centre_deg: tuple[float, float] = parameter(
        (0.0, 0.0), "shift [right, up] of the complete scene", low=-360, high=360
    )
    rotation_deg: float = parameter(
        0.0, "turn of the complete scene about its middle, counter-clockwise"
    )
    motion: Motion | None = parameter(
        None, "common motion of all objects; the apertures of patterns stay"
    )
    background: str | None = parameter(
        None,
        f"drawn surroundings ({', '.join(SURROUNDINGS)}), an image or a video; default: "
        "the luminance display.background",
    )
    background_start_s: float | None = parameter(
        None, "time of the video at which it starts; default 0", low=0, high=1e6
    )
    background_end: str | None = parameter(
        None,
        "cut: a video that ends early is an error; loop: it starts again; default cut",
        choices=("cut", "loop"),
    )
    background_fit: str | None = parameter(
        None,
        "exact: a video of another size is an error; cover: it is scaled to cover the display; "
        "default exact",
        choices=("exact", "cover"),
    )
    background_rate: str | None = parameter(
        None,
        "same: a video of another rate is an error; own: each frame shows the picture of its "
        "time; default same",
        choices=("same", "own"),
    )
    cut_s: float | None = parameter(
        None, "time at which drawn surroundings change to others", above=0, high=3600
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.motion is not None and self.motion.zoom_per_s:
            raise StimulusError("motion: zoom_per_s is for patterns, not for the scene")
        if self.background is not None and (not self.background or "\0" in self.background):
            raise StimulusError(
                "background is empty or has a zero character; name drawn surroundings or a video, "
                "or leave it out"
            )
        for key in ("background_start_s", "background_end", "background_fit", "background_rate"):
            if getattr(self, key) is not None and not self.has_file:
                raise StimulusError(f"{key} goes with a video as background; remove it")
        if self.cut_s is not None and self.background not in SURROUNDINGS:
            raise StimulusError("cut_s goes with drawn surroundings as background; remove it")

    @property
    def has_file(self) -> bool:
        """Whether the background is an image or a video."""
        return self.background is not None and self.background not in SURROUNDINGS


@dataclass(frozen=True, kw_only=True)
class Effects(DeclaredTable):
    """Changes of the finished picture."""

    invert: bool = parameter(False, "swap dark and light (contrast polarity)")
    noise: float = parameter(0.0, "standard deviation of additive Gaussian noise", low=0, high=1)
    shutter: float = parameter(
        0.0, "motion blur: open shutter as a share of the frame time, centred on it", low=0, high=1
    )
    shutter_samples: int = parameter(8, "number of pictures averaged for the blur", low=2, high=64)
    jpeg: int | None = parameter(
        None,
        "quality of a JPEG compression of each frame, after everything else; default: none",
        low=1,
        high=100,
    )


@dataclass(frozen=True, kw_only=True)
class ProtocolTables(DeclaredTable):
    """The tables of a stimulus. Each table checks itself; `Protocol` checks them together."""

    name: str = parameter("stimulus", "its name")
    description: str = parameter("", "its content in one line")
    source: str = parameter("", "its publication or its purpose")
    tags: tuple[str, ...] = parameter((), "words to search for")
    seed: int = parameter(0, "seed of all its random numbers", low=0, high=2**32 - 1)
    display: Display = parameter(REQUIRED, "the screen")
    timing: Timing = parameter(REQUIRED, "pauses and duration")
    scene: Scene = parameter(Scene(), "shift, turn and motion of all objects together")
    camera: Camera | None = parameter(None, "the camera of a staged scene")
    effects: Effects = parameter(Effects(), "changes of the finished picture")
    objects: tuple[Object, ...] = parameter((), "drawn in this order, the first one at the back")

    @property
    def frame_count(self) -> int:
        """Number of frames: those whose time lies before the clip's end."""
        timing = self.timing
        total = _exact_sum(timing.before_s, timing.motion_s, timing.after_s)
        return math.ceil(total * self.display.frame_rate)

    def motion_of(self, obj: Object) -> tuple[float, float]:
        """Return when an object's motion starts and ends, in seconds of the clip."""
        start = _exact_sum(self.timing.before_s, obj.onset_s)
        if obj.duration_s is None:
            return float(start), self.timing.end_s
        return float(start), float(_exact_sum(self.timing.before_s, obj.onset_s, obj.duration_s))

    def time_of(self, frame: int) -> float:
        """Return the time of a frame (0-based), in seconds of the clip."""
        return float(frame / self.display.frame_rate)


# ---- Dotted keys, and the words that mean them -----------------------------------------------

# Of each pair of keys, a protocol has only one.
_PAIRS = (("pixels_per_degree", "field_of_view_deg"), ("file", "drawing"))
_OTHER_OF_PAIR = {one: other for pair in _PAIRS for one, other in (pair, pair[::-1])}
_SEED = "seed"  # the one key without a dot that can be swept
# The keys that each word may mean; {id} stands for the id of an object.
_DIRECTIONS = ("{id}.axis_deg", "{id}.motion.direction_deg", "scene.rotation_deg")
WORDS = {
    "axis": _DIRECTIONS,
    "direction": _DIRECTIONS,
    "speed": ("{id}.growth.speed_deg_s", "{id}.motion.speed_deg_s"),
    "width": ("{id}.width_deg",),
    "size": ("{id}.size_deg",),
    "l/v": ("{id}.growth.l_over_v_ms", "{id}.brightness.l_over_v_ms"),
    "position": ("{id}.centre_deg", "scene.centre_deg"),
}
# Keys that a word means only if the stimulus sweeps them.
_WHERE_SWEPT = {"size": ("{id}.growth.end_deg",)}


def key_of(
    word: str, name: str, table: Mapping[str, Any], sweep: Collection[str], option: str
) -> str:
    """Return the dotted key that a word of `WORDS` means in a stimulus; a key means itself.

    `table` and `sweep` are the contents of the stimulus's file and the keys that it sweeps; `name`
    and `option` name the stimulus and the user's option in messages.

    Raises
    ------
    ParameterError
        If there is no such word, or if it means no key of the stimulus, or several.
    """
    if "." in word or word == _SEED:
        return word
    if word not in WORDS:
        words = (*WORDS, _SEED)
        hint = _full_keys(word, table)
        if not hint:
            more = "" if nearest(word, words) else ", or a key such as ID.size_deg"
            hint = suggestion(word, words) + more
        raise ParameterError(f"{option} {word}: no parameter '{word}'{hint}")
    keys = _meant(word, table, sweep)
    if len(keys) == 1:
        return keys[0]
    if keys:
        raise ParameterError(
            f"{option} {word}: in {name} that is {' or '.join(keys)}; write a key in full"
        )
    names = dict.fromkeys(key.rpartition(".")[2] for key in WORDS[word])
    known = [other for other in WORDS if len(_meant(other, table, sweep)) == 1]
    raise ParameterError(
        f"{option} {word}: no object of {name} has {' or '.join(names)}; choose "
        f"{', '.join(known)}, or a full key such as scene.rotation_deg"
    )


def _meant(word: str, table: Mapping[str, Any], sweep: Collection[str]) -> list[str]:
    """Return the keys that a word may mean: keys that are swept, or else keys with a value."""
    objects = _objects_of(table)

    def keys(patterns: tuple[str, ...]) -> list[str]:
        return [pattern.format(id=one.get("id")) for one in objects for pattern in patterns]

    meant = dict.fromkeys(keys((*WORDS[word], *_WHERE_SWEPT.get(word, ()))))
    if swept := [key for key in meant if key in sweep]:
        return swept
    if word in {"axis", "direction"}:
        return ["scene.rotation_deg"]
    if word == "position" and objects:
        # An object without a position is in the middle.
        return keys(("{id}.centre_deg",)) if len(objects) == 1 else ["scene.centre_deg"]
    return [key for key in dict.fromkeys(keys(WORDS[word])) if value_at(table, key) is not None]


def _objects_of(table: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the objects in the table of a protocol that has not been checked."""
    listed = table.get("object", [])
    return [one for one in listed if isinstance(one, dict)] if isinstance(listed, list) else []


def _full_keys(word: str, table: Mapping[str, Any]) -> str:
    """Return a hint with the keys of a stimulus that end with a word; empty if there are none.

    The word may lack the unit: ``before`` stands for ``timing.before_s``.
    """
    owners: list[tuple[Any, type[DeclaredTable], Any]] = [
        (key.name, key.table, "") for key in ProtocolTables.declared() if key.table
    ]
    owners += [(one.get("id"), Object, one.get("kind")) for one in _objects_of(table)]
    keys = [
        f"'{owner}.{key.name}'"
        for owner, group, kind in owners
        for key in group.declared()
        if word == key.name or (key.unit and word == key.name.rsplit("_", 1)[0])
        if not key.table and (not key.kinds or kind in key.kinds)
    ]
    return f"; did you mean {' or '.join(keys)}?" if keys else ""


def value_at(table: Mapping[str, Any], key: str) -> Any:
    """Return the value of a dotted key in the table of a protocol, or None."""
    first, *rest = key.split(".")
    value = next((one for one in _objects_of(table) if one.get("id") == first), table.get(first))
    for word in rest:
        value = value.get(word) if isinstance(value, dict) else None
    return value


def excluded_by(dotted: str) -> str:
    """Return the dotted key that a dotted key excludes; empty if it excludes none."""
    owner, _, leaf = dotted.rpartition(".")
    return f"{owner}.{_OTHER_OF_PAIR[leaf]}" if leaf in _OTHER_OF_PAIR else ""


def with_value(
    table: dict[str, Any], dotted: str, value: object, where: str, words: Iterable[str] = ()
) -> dict[str, Any]:
    """Return a copy of a protocol's table with a value for ``seed``, ``ID.growth.end_deg``, ...

    `where` begins the message of an error, and `words` are what a user may write there in place of
    a key.
    """
    first, _, rest = dotted.partition(".")
    if dotted in {_SEED, "description", "source", "tags"}:
        return {**table, dotted: value}
    owners = (*TABLES, *(str(one.get("id")) for one in _objects_of(table)))
    if first not in owners or not rest:
        keys = ", ".join(f"{name}.KEY" for name in owners)
        hint = f"a key starts with {keys}, or is {' or '.join((_SEED, *words))}"
        if rest and (near := nearest(first, (*owners, _SEED))):
            hint = f"did you mean '{near}'?"
        meant = "" if rest else _full_keys(dotted, table)
        raise StimulusError(f"{where}: no key '{dotted}'{meant or f'; {hint}'}")
    return _with_owner(table, first, lambda owner: _put(owner, rest, value, where))


def without(table: dict[str, Any], dotted: str) -> dict[str, Any]:
    """Return a copy of a protocol's table without a key of one of its tables or objects."""
    first, _, leaf = dotted.partition(".")

    def cut(owner: Any) -> Any:
        if not isinstance(owner, dict):
            return owner
        return {key: value for key, value in owner.items() if key != leaf}

    return _with_owner(table, first, cut)


def _with_owner(table: dict[str, Any], name: str, change: Callable[[Any], Any]) -> dict[str, Any]:
    """Return a copy of a protocol's table in which one of its tables or objects is changed."""
    if name in TABLES:
        return {**table, name: change(table.get(name, {}))}
    chosen = [one for one in _objects_of(table) if one.get("id") == name]
    if not chosen:
        return table
    return {**table, "object": [change(one) if one in chosen else one for one in table["object"]]}


def _put(table: object, dotted: str, value: object, where: str) -> dict[str, Any]:
    if not isinstance(table, dict):
        raise StimulusError(f"{where}: '{dotted}' is within {table!r}, which is not a table")
    first, _, rest = dotted.partition(".")
    return {**table, first: _put(table.get(first, {}), rest, value, where) if rest else value}
