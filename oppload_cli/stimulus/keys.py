"""Dotted keys of a protocol, such as ``disk.size_deg``: words that mean them, and their values."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from oppload_cli.errors import ParameterError, StimulusError, nearest, suggestion
from oppload_cli.stimulus.tables import TABLES

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Mapping

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
        hint = suggestion(word, words)
        hint += "" if nearest(word, words) else ", or a key such as ID.size_deg"
        raise ParameterError(f"{option} {word}: no parameter '{word}'{hint}")
    found = _meant(word, table, sweep)
    if len(found) == 1:
        return found[0]
    if found:
        raise ParameterError(
            f"{option} {word}: in {name} that is {' or '.join(found)}; write a key in full"
        )
    names = dict.fromkeys(key.rpartition(".")[2] for key in WORDS[word])
    known = [each for each in WORDS if len(_meant(each, table, sweep)) == 1]
    raise ParameterError(
        f"{option} {word}: no object of {name} has {' or '.join(names)}; choose "
        f"{', '.join(known)}, or a full key such as scene.rotation_deg"
    )


def _meant(word: str, table: Mapping[str, Any], sweep: Collection[str]) -> list[str]:
    """Return the keys that a word may mean: the only key that is swept, or keys with a value."""
    objects = _objects_of(table)

    def keys(patterns: tuple[str, ...]) -> list[str]:
        return [pattern.format(id=one.get("id")) for one in objects for pattern in patterns]

    swept = set(keys((*WORDS[word], *_WHERE_SWEPT.get(word, ())))) & set(sweep)
    if len(swept) == 1:
        return list(swept)
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
        raise StimulusError(f"{where}: no key '{dotted}'; {hint}")
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
